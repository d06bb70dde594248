//! `tcgs info`: the contents of a `.tcgs` file, and the basics of any other scene.

mod basics;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Cursor;
use std::ops::Range;
use std::path::PathBuf;

use serde_json::{Map, Value, json};
use tcgs_codec::{
    CohortInfo, Contents, DecodeError, DecodeLimits, FileInfo, SceneFile, SectionInfo, application_data, inspect,
    inspect_cut, read_trust,
};
use tcgs_core::{open_file, read_file};
use tcgs_pipeline::OpenScene;

use self::basics::Bounds;
use crate::attribute_errors;
use crate::error::wrong_input;
use crate::options::JobOptions;
use crate::output::{show_bytes, show_color};
use crate::scene::{RecoverOption, SourceOptions, describe_loss, describe_trust, unreadable};
use crate::terminal::{note, say, write};

/// Show what is in a .tcgs file and whether it is whole, or the basics of any other scene
///
/// Every checksum of a .tcgs file is verified. The exit code is 2 if the file is damaged, or if it was cut and
/// --recover is not given. If a file has more than 64 MB, only its tables are read: tcgs verify reads all of it.
///
/// Other scenes are run folders, params.npz, .4dgs files, and PLY, SPZ, glTF or SOG files. Their basics are the kind,
/// the numbers of Gaussians and timesteps, the frame rate, the degree of spherical harmonics, antialiasing, the axes,
/// bounds and sizes. Bounds are those of the means at the first timestep.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs info scene.tcgs --json info.json
  tcgs info my_plys
  tcgs info scene.tcgs --data tcgs.credits > credits.json")]
pub struct Arguments {
    /// .tcgs file; or run folder, params.npz, .4dgs file, or PLY, SPZ, glTF or SOG files
    #[arg(value_name = "SCENE")]
    file: PathBuf,
    /// Write data that an application put into a .tcgs file, such as tcgs.credits, to the standard output, and nothing
    /// else
    #[arg(long, value_name = "NAME")]
    data: Option<String>,
    #[command(flatten)]
    source: SourceOptions,
    #[command(flatten)]
    recover: RecoverOption,
    #[command(flatten)]
    job: JobOptions,
}

/// Longest file that is read whole, bytes. A longer file has only its tables read.
const MOST_READ: u64 = 64_000_000;

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin(&[], &[&arguments.file])?;
    let path = arguments.file.display();
    if !OpenScene::is_tcgs(&arguments.file) {
        let result = basics::print(&arguments.file, arguments.source, arguments.data.as_deref())?;
        return arguments.job.write_json(&result);
    }
    let unreadable = |error| unreadable(&arguments.file, error, "a .tcgs file");
    let limits = DecodeLimits::default();
    let damaged =
        |error: DecodeError| arguments.recover.advise(&error, format!("{path}: {error}, expected a whole .tcgs file"));
    let open = || {
        let file = open_file(&arguments.file).map_err(unreadable)?;
        let open = if arguments.recover.recover { SceneFile::recover } else { SceneFile::open };
        open(file, &limits, 0).map_err(damaged)
    };
    if let Some(name) = &arguments.data {
        let data = open()?.application_data().map_err(damaged)?;
        let Some((_, bytes)) = data.iter().find(|(found, _)| found == name) else {
            let names: Vec<&str> = data.iter().map(|(name, _)| &name[..]).collect();
            let found = if names.is_empty() {
                "has no data of applications".into()
            } else {
                format!("has {}", names.join(", "))
            };
            return Err(wrong_input(format!("{path}: {found}, expected {name}")));
        };
        return write(bytes);
    }
    let length = open_file(&arguments.file).and_then(|file| file.metadata()).map_err(unreadable)?.len();
    let (info, data) = if length > MOST_READ {
        let mut file = open()?;
        tell_loss(arguments, &file);
        let data = file.application_data().map_err(damaged)?;
        (file.outline().map_err(damaged)?, data.into_iter().map(|(name, data)| (name, data.len() as u64)).collect())
    } else {
        let bytes = read_file(&arguments.file, MOST_READ).map_err(unreadable)?;
        let inspect = if arguments.recover.recover { inspect_cut } else { inspect };
        let info = inspect(&bytes, &limits).map_err(damaged)?;
        if info.bytes < info.bytes_before {
            tell_loss(arguments, &SceneFile::recover(Cursor::new(&bytes), &limits, 0).map_err(damaged)?);
        }
        let data = if info.checksums_ok() { application_data(&bytes, &limits).map_err(damaged)? } else { Vec::new() };
        (info, data.into_iter().map(|(name, data)| (name, data.len() as u64)).collect::<Vec<_>>())
    };
    say(&format!("{path}: version {}, {} ({} bytes)", info.version, show_bytes(info.bytes), info.bytes))?;
    let mut file = open().ok();
    let first = |file: &mut SceneFile<File>| Bounds::of(file.at(0).ok()?.means());
    let bounds = file.as_mut().filter(|_| is_known(&info)).and_then(first);
    let background = file.as_ref().map_or([0; 3], |file| file.layout().background());
    if is_known(&info) {
        print_scene(&info, background)?;
        bounds.as_ref().map_or(Ok(()), Bounds::print)?;
    }
    if let Some(contents) = &info.contents {
        print_contents(&info, contents)?;
    }
    if is_known(&info) && !info.declared_errors.is_empty() {
        attribute_errors::print(&info.declared_errors)?;
        say("")?;
    }
    for name in info.cohorts.first().map_or(&[][..], |cohort| &cohort.skipped) {
        say(&format!("left out: {name}, an optional attribute that only a newer version of this program can decode"))?;
    }
    let first_frame = info.scene.first_frame as usize;
    if let [cohort] = &info.cohorts[..] {
        print_segments(&info, cohort, first_frame)?;
    } else {
        print_cohorts(&info, first_frame)?;
    }
    let application_data = file.as_mut().and_then(|file| file.application_data().ok());
    if let Some(trust) = read_trust(&application_data.unwrap_or_default()) {
        say(&describe_trust(&trust))?;
    }
    for (name, bytes) in data {
        say(&format!("application data: {name}, {}", show_bytes(bytes)))?;
    }
    arguments.job.write_json(&machine_readable(&info, bounds, background))?;
    let damaged = info.sections.iter().filter(|s| s.is_whole && s.checksum_ok == Some(false));
    let damaged: Vec<String> = damaged.map(|s| described(s, info.cohorts.len())).collect();
    if !damaged.is_empty() {
        let problem = format!("the checksum of {} is wrong, expected a whole file", damaged.join(", "));
        return Err(wrong_input(format!("{path}: {problem}")));
    }
    if length > MOST_READ {
        say("only the tables were read; tcgs verify reads all")?;
    }
    Ok(())
}

/// Describes the rest of a file that was cut.
fn tell_loss<R>(arguments: &Arguments, file: &SceneFile<R>) {
    if let Some(loss) = file.loss() {
        let (num_gaussians, num_timesteps) = (file.info().num_gaussians, file.info().num_timesteps);
        note(&describe_loss(&arguments.file, loss, num_gaussians as usize, num_timesteps as usize));
    }
}

/// Whether the sections do not contradict the description of the scene: all of them decode, or none was read.
fn is_known(info: &FileInfo) -> bool {
    info.contents.is_some() || info.sections.iter().all(|section| section.is_whole && section.checksum_ok.is_none())
}

/// Whether the scene is antialiased; all cohorts are, or none is.
fn is_antialiased(info: &FileInfo) -> bool {
    info.cohorts.first().is_some_and(|cohort| cohort.layout.is_antialiased())
}

/// - `background`: of [`Layout`](tcgs_core::Layout)
fn print_scene(info: &FileInfo, background: [u8; 3]) -> anyhow::Result<()> {
    let scene = &info.scene;
    let name = if scene.name.is_empty() { "-" } else { &scene.name };
    let (first, last) =
        (u64::from(scene.first_frame), u64::from(scene.first_frame) + u64::from(scene.num_timesteps - 1));
    say(&format!("name          {name}"))?;
    say(&format!("Gaussians     {}", scene.num_gaussians))?;
    say(&format!("timesteps     {} (frames {first} to {last})", scene.num_timesteps))?;
    say(&match scene.frame_rate {
        0.0 => "frame rate    unknown".into(),
        rate => format!("frame rate    {rate} a second"),
    })?;
    say(&format!("downscale     {}", scene.downscale))?;
    if is_antialiased(info) {
        say("antialiased   yes")?;
    }
    if background != [0; 3] {
        say(&format!("background    {}", show_color(background)))?;
    }
    say(&format!("up            {}", scene.up.name()))
}

fn print_contents(info: &FileInfo, contents: &Contents) -> anyhow::Result<()> {
    let (raw, plain) = (contents.raw_bytes, contents.plain_bytes);
    say(&format!("as floats     {} ({:.1} times as much)", show_bytes(raw), raw as f64 / info.bytes as f64))?;
    say(&format!("not packed    {} ({:.1} times as much)", show_bytes(plain), plain as f64 / info.bytes as f64))?;

    say("\nattribute            bytes  keypoints a track  bits: share of the Gaussians")?;
    let contents = contents.keypoints_mean.iter().zip(&contents.bits_histogram);
    for ((name, bytes), ((_, keypoints), (_, histogram))) in info.bytes_by_attribute().iter().zip(contents) {
        let (bytes, shares) = (show_bytes(*bytes), shares(histogram));
        say(&format!("{name:<15}  {bytes:>9}  {keypoints:>17.2}  {shares}"))?;
    }
    say("")
}

/// Such as `4: 81.2%  5: 18.8%`.
fn shares(histogram: &BTreeMap<u8, usize>) -> String {
    let all = histogram.values().sum::<usize>() as f64;
    let share = |(bits, count): (&u8, &usize)| format!("{bits}: {:.1}%", 100.0 * *count as f64 / all);
    histogram.iter().map(share).collect::<Vec<_>>().join("  ")
}

/// Name of a section, with its cohort in a file of several.
fn described(section: &SectionInfo, num_cohorts: usize) -> String {
    match section.cohort {
        Some(cohort) if num_cohorts > 1 => format!("{} of cohort {cohort}", section.name),
        _ => section.name.clone(),
    }
}

/// Total size and common state of several sections.
fn summed<'a>(sections: impl Iterator<Item = &'a SectionInfo>) -> (String, &'static str) {
    let sections: Vec<_> = sections.collect();
    let checksums = if sections.iter().any(|s| s.is_whole && s.checksum_ok == Some(false)) {
        "WRONG"
    } else if sections.iter().any(|s| s.is_whole && s.checksum_ok.is_none()) {
        "not read"
    } else if sections.iter().all(|s| s.is_whole) {
        "right"
    } else if sections.iter().any(|s| s.is_whole) {
        "right, but the rest is missing"
    } else {
        "missing"
    };
    (show_bytes(sections.iter().map(|s| s.bytes).sum()), checksums)
}

fn show_layers(layers: &[u32]) -> String {
    layers.iter().map(u32::to_string).collect::<Vec<_>>().join(" + ")
}

/// Prints the segments of a file with one cohort.
///
/// - `first`: frame of the first timestep
fn print_segments(info: &FileInfo, cohort: &CohortInfo, first: usize) -> anyhow::Result<()> {
    say(&format!("layers        {} Gaussians", show_layers(&cohort.layers)))?;
    say("\npart                       bytes  checksums")?;
    let parts = std::iter::once((None, "shared".to_owned())).chain(
        cohort
            .segments
            .iter()
            .enumerate()
            .map(|(i, (t, _))| (Some(i), format!("frames {} to {}", first + t.start, first + t.end - 1))),
    );
    for (segment, name) in parts {
        let (bytes, checksums) = summed(info.sections.iter().filter(|s| s.segment == segment));
        say(&format!("{name:<21}  {bytes:>9}  {checksums}"))?;
    }
    Ok(())
}

/// Prints the cohorts of a file with several.
///
/// - `first`: frame of the first timestep
fn print_cohorts(info: &FileInfo, first: usize) -> anyhow::Result<()> {
    // Sections by cohort; the last entry holds those of the whole scene.
    let mut sections: Vec<Vec<&SectionInfo>> = vec![Vec::new(); info.cohorts.len() + 1];
    for section in &info.sections {
        sections[section.cohort.unwrap_or(info.cohorts.len())].push(section);
    }
    say("part                    Gaussians  segments      bytes  checksums  layers")?;
    let (bytes, checksums) = summed(sections[info.cohorts.len()].iter().copied());
    say(&format!("{:<21}  {:>10}  {:>8}  {bytes:>9}  {checksums}", "shared", "", ""))?;
    for (cohort, sections) in info.cohorts.iter().zip(&sections) {
        let (t, layers) = (&cohort.timesteps, show_layers(&cohort.layers));
        let name = format!("frames {} to {}", first + t.start, first + t.end - 1);
        let (num_gaussians, num_segments) = (cohort.layers.iter().sum::<u32>(), cohort.segments.len());
        let (bytes, checksums) = summed(sections.iter().copied());
        say(&format!("{name:<21}  {num_gaussians:>10}  {num_segments:>8}  {bytes:>9}  {checksums:<9}  {layers}"))?;
    }
    Ok(())
}

/// - `bounds`: at the first timestep; `None` if they cannot be read
fn machine_readable(info: &FileInfo, bounds: Option<Bounds>, background: [u8; 3]) -> Value {
    let contents = info.contents.as_ref();
    let scene = is_known(info).then_some(&info.scene);
    let was_read = info.sections.iter().all(|section| section.checksum_ok.is_some());
    let histogram = |bits: &BTreeMap<u8, usize>| {
        bits.iter().map(|(bits, &count)| (bits.to_string(), json!(count))).collect::<Map<_, _>>()
    };
    let has_cohorts = info.version > 1;
    let segment = |cohort: usize, (timesteps, bytes): &(Range<usize>, Range<u64>)| {
        let (first, count) = (timesteps.start, timesteps.len());
        let mut of = json!({ "first_timestep": first, "num_timesteps": count, "offset": bytes.start, "bytes": bytes.end - bytes.start });
        if has_cohorts {
            of["cohort"] = json!(cohort);
        }
        of
    };
    let of_cohort = |(index, cohort): (usize, &CohortInfo)| -> Vec<Value> {
        cohort.segments.iter().map(|found| segment(index, found)).collect()
    };
    let segments: Vec<Value> = info.cohorts.iter().enumerate().flat_map(of_cohort).collect();
    let mut result = json!({
        "kind": "compressed file",
        "version": info.version,
        "num_gaussians": scene.map(|s| s.num_gaussians),
        "num_timesteps": scene.map(|s| s.num_timesteps),
        "first_frame": scene.map(|s| s.first_frame),
        "frame_rate": scene.map(|s| s.frame_rate),
        "sh_degree": info.cohorts.first().filter(|_| scene.is_some()).map(|cohort| cohort.layout.sh_degree()),
        "antialiased": scene.map(|_| is_antialiased(info)),
        "background": scene.map(|_| background),
        "bounds": bounds.map(Bounds::into_json),
        "raw_bytes": contents.map(|contents| contents.raw_bytes),
        "bytes": info.bytes,
        "bytes_before": info.bytes_before,
        "bytes_by_attribute": info.bytes_by_attribute().into_iter().collect::<BTreeMap<_, _>>(),
        "segments": segments,
        "bits_histogram": contents.map(|c| by_name(&c.bits_histogram, &|bits| json!(histogram(bits)))),
        "keypoints_mean": contents.map(|c| by_name(&c.keypoints_mean, &|mean| json!(mean))),
        "checksums_ok": was_read.then_some(info.checksums_ok()),
    });
    if has_cohorts {
        let cohort = |cohort: &CohortInfo| {
            json!({
                "first_timestep": cohort.timesteps.start,
                "num_timesteps": cohort.timesteps.len(),
                "num_gaussians": cohort.layers.iter().sum::<u32>(),
                "layers": cohort.layers,
                "num_segments": cohort.segments.len(),
                "attributes": cohort.layout.columns().iter().map(|column| &column.name).collect::<Vec<_>>(),
                "skipped": cohort.skipped,
            })
        };
        result["declared_errors"] = attribute_errors::machine_readable(&info.declared_errors);
        result["cohorts"] = info.cohorts.iter().map(cohort).collect();
    }
    result
}

/// An object with a value for every attribute.
fn by_name<T>(values: &[(String, T)], show: &dyn Fn(&T) -> Value) -> Value {
    values.iter().map(|(name, value)| (name.clone(), show(value))).collect::<Map<_, _>>().into()
}

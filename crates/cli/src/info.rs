//! `tcgs info`: what is in a `.tcgs` file.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::ops::Range;
use std::path::PathBuf;

use serde_json::{Map, Value, json};
use tcgs_codec::{Contents, DecodeError, DecodeLimits, FileInfo, SceneFile, application_data, inspect, inspect_cut};
use tcgs_core::Attribute;

use crate::error::wrong_input;
use crate::options::JobOptions;
use crate::output::show_bytes;
use crate::scene::{RecoverOption, describe_loss, unreadable};
use crate::terminal::{note, say};

/// Show what is in a .tcgs file, and whether it is whole
///
/// Every checksum is verified; a damaged file exits with 2, and so does one that was cut, without --recover.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs info scene.tcgs --json info.json")]
pub struct Arguments {
    /// .tcgs file
    file: PathBuf,
    #[command(flatten)]
    recover: RecoverOption,
    #[command(flatten)]
    job: JobOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    let path = arguments.file.display();
    if arguments.file.is_dir() {
        return Err(wrong_input(format!("{path}: is a folder, expected a .tcgs file")));
    }
    let bytes = fs::read(&arguments.file).map_err(|error| unreadable(&arguments.file, error, "a .tcgs file"))?;
    let damaged =
        |error: DecodeError| arguments.recover.advise(&error, format!("{path}: {error}, expected a whole .tcgs file"));
    let limits = DecodeLimits::default();
    let inspect = if arguments.recover.recover { inspect_cut } else { inspect };
    let info = inspect(&bytes, &limits).map_err(damaged)?;
    let mut first_frame = info.contents.as_ref().map_or(0, |c| c.info.first_frame);
    if info.bytes < info.bytes_before {
        let left = SceneFile::recover(Cursor::new(&bytes), &limits, 0).map_err(damaged)?;
        if let Some(loss) = left.loss() {
            let (num_gaussians, num_timesteps) = (left.info().num_gaussians, left.info().num_timesteps);
            note(&describe_loss(&arguments.file, loss, num_gaussians as usize, num_timesteps as usize));
        }
        first_frame = left.info().first_frame;
    }
    say(&format!("{path}: version {}, {} ({} bytes)", info.version, show_bytes(info.bytes), info.bytes))?;
    if let Some(contents) = &info.contents {
        print_contents(&info, contents)?;
    }
    print_sections(&info, first_frame as usize)?;
    if info.checksums_ok() {
        for (name, data) in application_data(&bytes, &limits).map_err(damaged)? {
            say(&format!("application data: {name}, {}", show_bytes(data.len() as u64)))?;
        }
    }
    arguments.job.write_json(&machine_readable(&info))?;
    let damaged: Vec<&str> = info.sections.iter().filter(|s| s.is_whole && !s.checksum_ok).map(|s| s.name).collect();
    if !damaged.is_empty() {
        let problem = format!("the checksum of {} is wrong, expected a whole file", damaged.join(", "));
        return Err(wrong_input(format!("{path}: {problem}")));
    }
    Ok(())
}

fn print_contents(info: &FileInfo, contents: &Contents) -> anyhow::Result<()> {
    let scene = &contents.info;
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
    say(&format!("up            {}", scene.up.name()))?;
    let (raw, plain) = (contents.raw_bytes, contents.plain_bytes);
    say(&format!("as floats     {} ({:.1} times as much)", show_bytes(raw), raw as f64 / info.bytes as f64))?;
    say(&format!("not packed    {} ({:.1} times as much)", show_bytes(plain), plain as f64 / info.bytes as f64))?;

    say("\nattribute            bytes  keypoints a track  bits: share of the Gaussians")?;
    for (attribute, bytes) in Attribute::BASE.into_iter().zip(info.bytes_by_attribute()) {
        let index = attribute.index();
        say(&format!(
            "{:<15}  {:>9}  {:>17.2}  {}",
            attribute.name(),
            show_bytes(bytes),
            contents.keypoints_mean[index],
            shares(&contents.bits_histogram[index])
        ))?;
    }
    say("")
}

/// Such as `4: 81.2%  5: 18.8%`.
fn shares(histogram: &BTreeMap<u8, usize>) -> String {
    let all = histogram.values().sum::<usize>() as f64;
    let share = |(bits, count): (&u8, &usize)| format!("{bits}: {:.1}%", 100.0 * *count as f64 / all);
    histogram.iter().map(share).collect::<Vec<_>>().join("  ")
}

/// - `first`: frame of the first timestep
fn print_sections(info: &FileInfo, first: usize) -> anyhow::Result<()> {
    let layers: Vec<String> = info.layers.iter().map(u32::to_string).collect();
    say(&format!("layers        {} Gaussians", layers.join(" + ")))?;
    say("\npart                       bytes  checksums")?;
    let sum = |segment: Option<usize>| {
        let sections: Vec<_> = info.sections.iter().filter(|s| s.segment == segment).collect();
        let checksums = if sections.iter().any(|s| s.is_whole && !s.checksum_ok) {
            "WRONG"
        } else if sections.iter().all(|s| s.is_whole) {
            "right"
        } else if sections.iter().any(|s| s.is_whole) {
            "right, but the rest is missing"
        } else {
            "missing"
        };
        (sections.iter().map(|s| s.bytes).sum::<u64>(), checksums)
    };
    let parts = std::iter::once((None, "shared".to_owned())).chain(
        info.segments
            .iter()
            .enumerate()
            .map(|(i, (t, _))| (Some(i), format!("frames {} to {}", first + t.start, first + t.end - 1))),
    );
    for (segment, name) in parts {
        let (bytes, checksums) = sum(segment);
        say(&format!("{name:<21}  {:>9}  {checksums}", show_bytes(bytes)))?;
    }
    Ok(())
}

fn machine_readable(info: &FileInfo) -> Value {
    let by_attribute = |value: &dyn Fn(usize) -> Value| -> Value {
        Attribute::BASE.iter().map(|a| (a.name().to_owned(), value(a.index()))).collect::<Map<_, _>>().into()
    };
    let bytes = info.bytes_by_attribute();
    let contents = info.contents.as_ref();
    let scene = contents.map(|c| &c.info);
    let histogram = |c: &Contents, a: usize| -> Value {
        c.bits_histogram[a].iter().map(|(bits, &count)| (bits.to_string(), json!(count))).collect::<Map<_, _>>().into()
    };
    let segment = |(timesteps, bytes): &(Range<usize>, Range<u64>)| json!({ "first_timestep": timesteps.start, "num_timesteps": timesteps.len(), "offset": bytes.start, "bytes": bytes.end - bytes.start });
    let segments: Vec<Value> = info.segments.iter().map(segment).collect();
    json!({
        "version": info.version,
        "num_gaussians": scene.map(|s| s.num_gaussians),
        "num_timesteps": scene.map(|s| s.num_timesteps),
        "first_frame": scene.map(|s| s.first_frame),
        "frame_rate": scene.map(|s| s.frame_rate),
        "bytes": info.bytes,
        "bytes_before": info.bytes_before,
        "bytes_by_attribute": by_attribute(&|a| json!(bytes[a])),
        "segments": segments,
        "bits_histogram": contents.map(|c| by_attribute(&|a| histogram(c, a))),
        "keypoints_mean": contents.map(|c| by_attribute(&|a| json!(c.keypoints_mean[a]))),
        "checksums_ok": info.checksums_ok(),
    })
}

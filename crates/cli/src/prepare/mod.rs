//! `tcgs prepare`: initial points for own footage, and a doctor for captures.

mod check;
mod link;

use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use serde_json::json;
use tcgs_capture::{Capture, Origin, POINTS_FILE, PrepareSettings, Prepared, write_points};
use tcgs_interchange::is_unfinished;

use crate::error::wrong_input;
use crate::interrupt;
use crate::options::{self, JobOptions};
use crate::output::{NewFolder, check_file, is_empty_folder, parent, write_file_with, write_json};
use crate::progress::Progress;
use crate::terminal::say;

/// Written into every capture that this command makes: how it was made, and that it may be replaced.
const RECORD: &str = "prepare.json";
/// Steps of making points, for the progress bar.
const NUM_STEPS: usize = 7;

/// Make initial points for a capture from its images alone, or check a capture
///
/// Training starts from a cloud of coloured points. For a capture that has none, this finds the depth of every pixel
/// of the first frame's training images (multi-view stereo), keeps what three views or more agree on, limits the
/// foreground to what all masks allow, continues surfaces without texture, and puts a shell around the rest.
///
/// With --check nothing is made: a doctor looks for matrices the wrong way round, cameras in another order than their
/// images, wrong focal lengths and principal points, empty and inverted masks, and cameras whose clocks are wrong, and
/// says what would mend them.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs prepare my_footage --out my_capture
  tcgs prepare --check my_capture --sheet check.png

Exit codes of --check: 0 the capture is healthy or it cannot be told, 1 something was found, 2 wrong usage or input.")]
#[command(group = clap::ArgGroup::new("what").required(true).args(["out", "points_only", "check"]))]
pub struct Arguments {
    /// Folder of a capture with calibrated cameras, in any layout that tcgs train reads
    source: PathBuf,
    /// Capture to make: the source's files, linked where the file system can, else copied, and the points
    #[arg(long, value_name = "CAPTURE")]
    out: Option<PathBuf>,
    /// Write the points alone, as .npz
    #[arg(long, value_name = "FILE")]
    points_only: Option<PathBuf>,
    /// Check the capture instead
    #[arg(long)]
    check: bool,
    /// Write a picture (PNG) of what was checked: every camera's image with the points that fall on it, and below what
    /// the points look like from there
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "points_only"])]
    sheet: Option<PathBuf>,
    /// Points at most, about [default: 80000]
    #[arg(long, value_name = "N", value_parser = options::positive, conflicts_with = "check")]
    points: Option<usize>,
    /// Average images down to at most this width; smaller is faster, larger finds finer things [default: 400]
    #[arg(long, value_name = "PIXELS", value_parser = options::positive, conflicts_with = "check")]
    width: Option<usize>,
    #[command(flatten)]
    job: JobOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    if arguments.check {
        return check::run(&arguments.source, arguments.sheet.as_deref(), &arguments.job);
    }
    let force = arguments.job.force;
    if let Some(file) = &arguments.points_only {
        check_points_file(file, force)?;
    }
    if arguments.out.is_some() {
        interrupt::catch()?;
    }
    let folder = arguments.out.as_deref().map(|out| begin_capture(out, &arguments.source, force)).transpose()?;
    if let Some(folder) = &folder {
        interrupt::remove_at_end(folder.temporary())?;
    }
    let capture = Capture::open_unseen(&arguments.source)?;
    if capture.has_points() {
        say("the points that the source has are not used")?;
    }

    let defaults = PrepareSettings::default();
    let settings = PrepareSettings {
        num_points: arguments.points.unwrap_or(defaults.num_points),
        image_width: arguments.width.unwrap_or(defaults.image_width),
        seed: arguments.job.seed.unwrap_or(defaults.seed),
    };
    let begin = Instant::now();
    let mut progress = Progress::new("preparing", NUM_STEPS);
    let prepared = tcgs_capture::prepare(&capture, &settings, &mut |step| progress.step(|| step.into()))?;
    drop(progress);
    let seconds = begin.elapsed().as_secs_f64();
    say(&describe(&prepared, seconds))?;

    let count = |origin| prepared.count(origin);
    let result = json!({
        "source": arguments.source.display().to_string(),
        "out": arguments.out.as_ref().or(arguments.points_only.as_ref()).map(|out| out.display().to_string()),
        "num_points": prepared.cloud.points.len(),
        "num_foreground": num_foreground(&prepared),
        "origins": {
            "triangulated": count(Origin::Triangulated),
            "hull": count(Origin::Hull),
            "filled": count(Origin::Filled),
            "shell": count(Origin::Shell),
        },
        "agreement": prepared.agreement,
        "seconds": seconds,
    });
    let write = |file: &std::fs::File| write_points(BufWriter::new(file), &prepared.cloud);
    if let Some(folder) = folder {
        link::link_tree(&arguments.source, folder.path(), &[POINTS_FILE, RECORD])?;
        write_file_with(&folder.path().join(POINTS_FILE), false, write)?;
        write_json(&folder.path().join(RECORD), &result, false)?;
        folder.finish()?;
    }
    if let Some(file) = &arguments.points_only {
        write_file_with(file, force, write)?;
    }
    arguments.job.write_json(&result)?;
    match (&arguments.out, &arguments.points_only) {
        (Some(out), _) => say(&format!("next: tcgs train {} --out RUN", out.display())),
        (None, Some(file)) => {
            say(&format!("next: tcgs train {} --points {} --out RUN", arguments.source.display(), file.display()))
        }
        (None, None) => Ok(()),
    }
}

fn check_points_file(file: &Path, force: bool) -> anyhow::Result<()> {
    if file.extension().is_none_or(|extension| extension != "npz") {
        return Err(wrong_input(format!("{}: not a kind of file for points, expected NAME.npz", file.display())));
    }
    check_file(file, force)
}

/// A folder in the making, outside its source; one that exists is replaced only if this command made it.
fn begin_capture(out: &Path, source: &Path, force: bool) -> anyhow::Result<NewFolder> {
    if let (Ok(parent), Ok(source)) = (parent(out).canonicalize(), source.canonicalize())
        && parent.starts_with(&source)
    {
        let problem = format!("lies in {}, expected a place outside the source", source.display());
        return Err(wrong_input(format!("{}: {problem}", out.display())));
    }
    if force && out.exists() && !is_empty_folder(out) {
        if !out.join(RECORD).is_file() {
            let problem = "was not made by prepare, expected a new name or a folder of an earlier prepare";
            return Err(wrong_input(format!("{}: {problem}", out.display())));
        }
        for entry in std::fs::read_dir(out).with_context(|| format!("reading {}", out.display()))? {
            let name = entry?.file_name();
            let ours = [POINTS_FILE, RECORD].iter().any(|ours| name == *ours);
            if !ours && !is_unfinished(&name) && source.join(&name).symlink_metadata().is_err() {
                let problem = "is neither of the source nor of prepare, expected it to be moved away first";
                return Err(wrong_input(format!("{}: {problem}", out.join(name).display())));
            }
        }
    }
    NewFolder::begin(out, force, |_| true)
}

fn num_foreground(prepared: &Prepared) -> usize {
    prepared.cloud.foreground.iter().filter(|&&foreground| foreground).count()
}

fn describe(prepared: &Prepared, seconds: f64) -> String {
    let parts = [
        (Origin::Triangulated, "triangulated"),
        (Origin::Hull, "on the visual hull"),
        (Origin::Filled, "between them"),
        (Origin::Shell, "on a shell around"),
    ];
    let parts: Vec<String> = parts
        .into_iter()
        .map(|(origin, name)| (prepared.count(origin), name))
        .filter(|&(count, _)| count > 0)
        .map(|(count, name)| format!("{count} {name}"))
        .collect();
    let (points, foreground) = (prepared.cloud.points.len(), num_foreground(prepared));
    format!("{points} points, {foreground} of them foreground: {}; {seconds:.1} s", parts.join(", "))
}

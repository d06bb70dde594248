//! `tcgs prepare`: makes a capture with initial points from the user's footage, and checks captures.

mod cameras;
mod check;
mod colors;
mod link;
mod masks;
mod page;
mod points;
mod raw;

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError, DESCRIPTION_FILE, MASKS_FOLDER, POINTS_FILE};
use tcgs_interchange::is_unfinished;
use tcgs_prepare::RawFootage;

use crate::error::wrong_input;
use crate::next;
use crate::options::{self, JobOptions};
use crate::output::{NewFolder, check_files, check_folder, is_empty_folder, parent, write_json};
use crate::terminal::say;

/// Record in every capture that this command makes: how it was made, and that it may be replaced.
const RECORD: &str = "prepare.json";

/// Folder of COLMAP's cameras and points, in its text format.
const MODEL: &str = "colmap";

/// Make a capture of videos, make initial points for a capture, or check a capture
///
/// A folder of videos, one for each camera, becomes a capture that tcgs train reads. The command reads any video that
/// ffmpeg reads, and finds the offsets between the cameras' clocks by sound or motion. It writes its results to
/// capture.toml, where any line may be edited. A step whose result the output holds is skipped; to run it again, delete
/// the result or use --force.
///
/// A calibration in the folder is read. It is refined on points seen by several cameras, if that lowers its errors.
/// Without a calibration the program colmap finds the cameras from their images, if it is installed.
///
/// Cameras that differ in exposure or white balance get gains, if points that several of them see then agree better.
///
/// Training starts from a cloud of coloured points. For a capture without points, multi-view stereo finds the depth of
/// every pixel of the first frame's training images. Points that three views or more agree on are kept. The foreground
/// is limited to the visual hull of the masks, surfaces without texture are continued, and a shell surrounds the rest.
///
/// In every image it marks what moves, if the cameras stand still and the capture has no masks (--masks). A pixel is
/// marked if it differs from what its camera sees most of the time, and if the other cameras' differences allow motion
/// there. The masks are images that can be viewed and corrected: masks/CAMERA/FRAME.png beside capture.toml,
/// seg/CAMERA/FRAME.png of Panoptic Sports. Existing masks in the same place are used unchanged.
///
/// With --check nothing is made. The check looks for transposed or inverted matrices, cameras in another order than
/// their images, wrong focal lengths and principal points, empty and inverted masks, and wrong clocks. It prints how to
/// correct each. A new capture is checked in the same way as the last step: check.html in the capture shows every
/// camera.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  tcgs prepare my_videos --out my_capture                       videos, perhaps with a calibration, become a capture
  tcgs prepare my_videos --out my_capture --scale cam1,cam5,2.4 the lenses of cam1 and cam5 are 2.4 m apart
  tcgs prepare my_videos --out my_capture --dry-run             says what would be done
  tcgs prepare my_videos --out my_capture --from 12.5 --to 20   a part of long videos, seconds
  tcgs prepare my_footage --out my_capture                      points for a capture without
  tcgs prepare --check my_capture --page check.html

Exit codes of --check: 0 the capture is healthy or it cannot be told, 1 something was found, 2 wrong usage or input.")]
#[command(group = clap::ArgGroup::new("what").required(true).args(["out", "points_only", "check"]))]
pub struct Arguments {
    /// Folder of videos with a calibration, or of a capture in any layout that tcgs train reads
    source: PathBuf,
    /// Capture to make: the source's files, linked where the file system can, else copied, and the points
    #[arg(long, value_name = "CAPTURE")]
    out: Option<PathBuf>,
    /// Write the points alone, as .npz
    #[arg(long, value_name = "FILE")]
    points_only: Option<PathBuf>,
    /// Check the capture instead of making one
    #[arg(long)]
    check: bool,
    /// Write a picture (PNG) of the check: every camera's image with the points projected onto it, and below it the
    /// points alone, drawn from that camera
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "points_only"])]
    sheet: Option<PathBuf>,
    /// Write a page (HTML, with all images in it) of the check: every camera with its image, the points, masks, clocks
    /// and errors
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "points_only"])]
    page: Option<PathBuf>,
    /// Approximate maximal number of points [default: 80000]
    #[arg(long, value_name = "N", value_parser = options::up_to::<100_000_000>, conflicts_with = "check")]
    points: Option<usize>,
    /// Average images down to at most this width: smaller is faster, larger finds finer details [default: 400]
    #[arg(long, value_name = "PIXELS", value_parser = options::up_to::<16384>, conflicts_with = "check")]
    width: Option<usize>,
    /// Videos only: the calibration, if it is not in their folder or there are several [formats: OpenCV/EasyMocap,
    /// caliscope, Pose2Sim/aniposelib, Qualisys, COLMAP, nerfstudio]
    #[arg(long, value_name = "FILE", conflicts_with = "check")]
    calibration: Option<PathBuf>,
    /// Videos only: the measured distance between the lenses of two cameras, metres. All lengths are scaled to it
    /// [default: lengths as the calibration has them; in an unknown unit if colmap finds the cameras]
    #[arg(long, value_name = "CAMERA,CAMERA,METRES", conflicts_with = "check")]
    scale: Option<Scale>,
    /// Videos only: refine poses, focal lengths and distortion of the calibration on points that several cameras see,
    /// if that lowers the errors of held-out points: yes, no
    #[arg(long, value_name = "YES", default_value = "yes", value_parser = yes_or_no, action = clap::ArgAction::Set)]
    refine_calibration: bool,
    /// Videos only: measure differences in exposure and white balance between the cameras, and even them out if
    /// held-out points then agree better: yes, no
    #[arg(long, value_name = "YES", default_value = "yes", value_parser = yes_or_no, action = clap::ArgAction::Set)]
    colors: bool,
    /// Videos only: a text file with a line NAME SECONDS for each camera: the time of one common event in its video
    #[arg(long, value_name = "FILE", conflicts_with = "check")]
    offsets: Option<PathBuf>,
    /// Videos only: start this many seconds after the moment at which all cameras run
    #[arg(long, value_name = "SECONDS", value_parser = options::seconds, conflicts_with = "check")]
    from: Option<f64>,
    /// Videos only: end this many seconds after the moment at which all cameras run
    #[arg(long, value_name = "SECONDS", value_parser = options::seconds, conflicts_with = "check")]
    to: Option<f64>,
    /// Videos only: use every Nth frame
    #[arg(long, value_name = "N", value_parser = options::positive, conflicts_with = "check")]
    every: Option<usize>,
    /// Image folders only: frames per second [default: 30]
    #[arg(long, value_name = "RATE", value_parser = options::rate, conflicts_with = "check")]
    fps: Option<f64>,
    /// Videos only: a camera to hold out from training for evaluation; may be given several times [default: every
    /// eighth, of fewer than eight none]
    #[arg(long, value_name = "CAMERA", conflicts_with = "check")]
    hold_out: Vec<String>,
    /// Make masks of what moves if the capture has none; auto: if the cameras stand still, there are eight frames or
    /// more, and the layout has a place for masks
    #[arg(long, value_name = "WHETHER", default_value = "auto", conflicts_with_all = ["points_only", "check"])]
    masks: masks::Masks,
    /// Print which steps would run, and write nothing
    #[arg(long, conflicts_with = "check")]
    dry_run: bool,
    #[command(flatten)]
    job: JobOptions,
}

/// The names of two cameras and their distance.
#[derive(Clone)]
struct Scale {
    cameras: [String; 2],
    metres: f64,
}

impl std::str::FromStr for Scale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let problem = || "expected the names of two cameras and their distance in metres, such as cam1,cam5,2.4".into();
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let &[a, b, metres] = parts.as_slice() else { return Err(problem()) };
        let metres = metres.parse().ok().filter(|metres: &f64| metres.is_finite() && *metres > 0.0);
        let metres = metres.filter(|_| !a.is_empty() && !b.is_empty() && a != b).ok_or_else(problem)?;
        Ok(Self { cameras: [a.into(), b.into()], metres })
    }
}

fn yes_or_no(text: &str) -> Result<bool, String> {
    match text {
        "yes" => Ok(true),
        "no" => Ok(false),
        _ => Err("expected yes or no".into()),
    }
}

impl Arguments {
    /// Whether the source is a folder of videos and not a capture.
    fn is_raw(&self) -> anyhow::Result<bool> {
        let asked = self.calibration.is_some() || self.offsets.is_some() || !self.hold_out.is_empty();
        let asked = asked || self.from.is_some() || self.to.is_some() || self.every.is_some() || self.fps.is_some();
        let asked = asked || self.scale.is_some();
        Ok(asked || RawFootage::is_in(&self.source)?)
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let sources = [Some(arguments.source.as_path()), arguments.calibration.as_deref(), arguments.offsets.as_deref()];
    let sources: Vec<&Path> = sources.into_iter().flatten().collect();
    let pages: Vec<&Path> = [&arguments.sheet, &arguments.page].into_iter().filter_map(Option::as_deref).collect();
    arguments.job.begin(&pages, &sources)?;
    if arguments.check {
        return check::run(&arguments.source, arguments.sheet.as_deref(), arguments.page.as_deref(), &arguments.job);
    }
    if arguments.is_raw()? {
        return raw::run(arguments);
    }
    let force = arguments.job.force;
    if let Some(file) = &arguments.points_only {
        check_points_file(file, force)?;
    }
    if arguments.dry_run {
        if let Some(out) = &arguments.out {
            // The folder is removed again; an error here would also fail the command itself.
            drop(begin_capture(out, &arguments.source, force)?);
        }
        let capture = open(&arguments.source)?;
        if arguments.out.is_some() && !capture.has_segmentation() && arguments.masks.are_wanted(&capture)? {
            say(masks::WOULD)?;
        }
        say("points: would be made; cameras and clocks are taken as the capture has them")?;
        return if arguments.out.is_some() { say(check::WOULD) } else { Ok(()) };
    }
    let folder = arguments.out.as_deref().map(|out| begin_capture(out, &arguments.source, force)).transpose()?;
    let mut capture = open(&arguments.source)?;
    if capture.has_points() {
        say("the points that the source has are not used")?;
    }

    if let Some(folder) = &folder {
        link::link_tree(&arguments.source, folder.path(), &[POINTS_FILE, RECORD, check::PAGE])?;
    }
    let mut told_of_masks = Value::Null;
    if let Some(folder) = &folder {
        if capture.has_segmentation() {
            say("masks: taken as the capture has them")?;
        } else if arguments.masks.are_wanted(&capture)? {
            told_of_masks = masks::make(&capture, &arguments.source, folder.path())?;
            capture = Capture::open_unseen(folder.path())?;
        }
    }

    let (prepared, told) = points::make(&capture, arguments)?;
    let mut result = json!({
        "source": arguments.source.display().to_string(),
        "out": arguments.out.as_ref().or(arguments.points_only.as_ref()).map(|out| out.display().to_string()),
    });
    for (key, value) in told.as_object().into_iter().flatten() {
        result[key] = value.clone();
    }
    if !told_of_masks.is_null() {
        result["masks"] = told_of_masks;
    }
    if let Some(folder) = folder {
        points::write(&folder.path().join(POINTS_FILE), &prepared, false)?;
        write_json(&folder.path().join(RECORD), &result, false)?;
        folder.finish()?;
    }
    if let Some(file) = &arguments.points_only {
        points::write(file, &prepared, force)?;
    }
    if let Some(out) = &arguments.out {
        result["check"] = check::after_preparing(out)?;
    }
    arguments.job.write_json(&result)?;
    match (&arguments.out, &arguments.points_only) {
        (Some(out), _) => next::train(out, None),
        (None, Some(file)) => next::train(&arguments.source, Some(file)),
        (None, None) => Ok(()),
    }
}

/// Opens a source that is not a folder of videos.
fn open(source: &Path) -> anyhow::Result<Capture> {
    match Capture::open_unseen(source) {
        Err(CaptureError::NotCapture { path, .. }) if path.is_dir() => Err(no_videos(&path)),
        opened => Ok(opened?),
    }
}

fn no_videos(folder: &Path) -> anyhow::Error {
    let expected = "expected one for each camera, or a capture in a layout that tcgs train reads";
    wrong_input(format!("{}: no videos here, {expected}", folder.display()))
}

fn check_points_file(file: &Path, force: bool) -> anyhow::Result<()> {
    if file.extension().is_none_or(|extension| extension != "npz") {
        return Err(wrong_input(format!("{}: not a kind of file for points, expected NAME.npz", file.display())));
    }
    // The file may replace the capture's own points, which this command does not read.
    check_files(&[file], &[], force)
}

/// Begins a folder outside its source. It replaces an existing folder only if this command made that one.
fn begin_capture(out: &Path, source: &Path, force: bool) -> anyhow::Result<NewFolder> {
    check_folder(out, &[source])?;
    if let (Ok(parent), Ok(source)) = (parent(out).canonicalize(), source.canonicalize())
        && parent.starts_with(&source)
    {
        let problem = format!("lies in {}, expected a place outside the source", source.display());
        return Err(wrong_input(format!("{}: {problem}", out.display())));
    }
    if force && out.exists() && !is_empty_folder(out) {
        let record = std::fs::read(out.join(RECORD)).unwrap_or_default();
        if !serde_json::from_slice::<Value>(&record).is_ok_and(|record| record["source"].is_string()) {
            let problem = "was not made by prepare, expected a new name or a folder of an earlier prepare";
            return Err(wrong_input(format!("{}: {problem}", out.display())));
        }
        for entry in std::fs::read_dir(out).with_context(|| format!("reading {}", out.display()))? {
            let name = entry?.file_name();
            let ours = [POINTS_FILE, RECORD, DESCRIPTION_FILE, MODEL, MASKS_FOLDER, "seg", check::PAGE];
            let ours = ours.iter().any(|ours| name == *ours);
            if !ours && !is_unfinished(&name) && source.join(&name).symlink_metadata().is_err() {
                let problem = "is neither of the source nor of prepare, expected it to be moved away first";
                return Err(wrong_input(format!("{}: {problem}", out.join(name).display())));
            }
        }
    }
    NewFolder::begin(out, force, |_| true)
}

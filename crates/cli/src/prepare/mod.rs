//! `tcgs prepare`: makes a capture with initial points from the user's footage, and checks captures.

mod check;
mod page;
mod words;

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use tcgs_capture::write_prepared;
use tcgs_pipeline::{
    Event, FootageOptions, Observer, PipelineError, PrepareOptions, PrepareStep, PreparedCapture, WantMasks, Work,
    make_points, open_source,
};
use tcgs_prepare::StereoSettings;

use crate::error::wrong_input;
use crate::interrupt;
use crate::next;
use crate::options::{self, JobOptions};
use crate::output::{check_files, check_folder, write_file_with};
use crate::teller::Teller;
use crate::terminal::{note, say};
use words::Words;

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
/// every pixel of the first frame's training images. Points that three views or more agree on are kept. Where cameras
/// stand far apart two views have to do, which then must agree more closely. The foreground is limited to the visual
/// hull of the masks, surfaces without texture are continued, and a shell surrounds the rest.
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
    /// Cameras to hold out from training for evaluation: of videos [default: every eighth, of fewer than eight none].
    /// With --points-only: cameras of a capture to leave out of its points, as tcgs train --hold-out leaves them out
    #[arg(long, value_name = "CAMERA,...", value_delimiter = ',', conflicts_with = "check")]
    hold_out: Vec<String>,
    /// Make masks of what moves if the capture has none; auto: if the cameras stand still, there are eight frames or
    /// more, and the layout has a place for masks
    #[arg(long, value_name = "WHETHER", default_value = "auto", conflicts_with_all = ["points_only", "check"])]
    masks: Masks,
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

/// Whether to make masks of moving things.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Masks {
    /// Make them if possible
    Auto,
    /// Make them; fail if that is impossible
    Yes,
    No,
}

impl Arguments {
    fn options(&self) -> PrepareOptions {
        PrepareOptions {
            stereo: self.stereo(),
            masks: match self.masks {
                Masks::Auto => WantMasks::Auto,
                Masks::Yes => WantMasks::Yes,
                Masks::No => WantMasks::No,
            },
            replace: self.job.force,
            dry_run: self.dry_run,
            footage: FootageOptions {
                calibration: self.calibration.clone(),
                scale: self.scale.as_ref().map(|scale| (scale.cameras.clone(), scale.metres)),
                refine_calibration: self.refine_calibration,
                balance_colors: self.colors,
                offsets: self.offsets.clone(),
                from_secs: self.from,
                to_secs: self.to,
                every: self.every,
                images_fps: self.fps,
                hold_out: self.hold_out.clone(),
            },
        }
    }

    fn stereo(&self) -> StereoSettings {
        let defaults = StereoSettings::default();
        StereoSettings {
            num_points: self.points.unwrap_or(defaults.num_points),
            image_width: self.width.unwrap_or(defaults.image_width),
            seed: self.job.seed.unwrap_or(defaults.seed),
        }
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let source = arguments.source.as_path();
    let sources = [Some(source), arguments.calibration.as_deref(), arguments.offsets.as_deref()];
    let sources: Vec<&Path> = sources.into_iter().flatten().collect();
    let pages: Vec<&Path> = [&arguments.sheet, &arguments.page].into_iter().filter_map(Option::as_deref).collect();
    arguments.job.begin(&pages, &sources)?;
    if arguments.check {
        return check::run(source, arguments.sheet.as_deref(), arguments.page.as_deref(), &arguments.job);
    }
    let options = arguments.options();
    let is_footage = options.footage.is_footage(source)?;
    let mut words = Words::new(arguments, is_footage);
    let Some(out) = &arguments.out else {
        return points_only(arguments, &mut words);
    };
    check_folder(out, &[source])?;
    let prepared = watch(&mut words, |observer| tcgs_pipeline::prepare(source, out, &options, observer))?;
    let Some(PreparedCapture { capture, mut record, diagnosis, .. }) = prepared else {
        return Ok(()); // a dry run
    };
    record["check"] = check::after_preparing(out, &capture, &diagnosis)?;
    arguments.job.write_json(&record)?;
    next::train(out, None, &[])
}

/// Writes points of a capture, and nothing else.
fn points_only(arguments: &Arguments, words: &mut Words) -> anyhow::Result<()> {
    let (source, force) = (arguments.source.as_path(), arguments.job.force);
    let Some(file) = arguments.points_only.as_deref().filter(|_| !words.is_footage) else {
        let problem = "is a folder of videos, expected --out CAPTURE: its points need cameras and clocks";
        return Err(wrong_input(format!("{}: {problem}", source.display())));
    };
    check_points_file(file, force)?;
    let mut capture = open_source(source)?;
    if !arguments.hold_out.is_empty() {
        capture = capture.with_test_cameras(&arguments.hold_out)?;
    }
    if arguments.dry_run {
        return words.of(&PrepareStep::Planned(Work::MakingPoints)).iter().try_for_each(|line| say(line));
    }
    if capture.has_points() {
        words.of(&PrepareStep::PointsIgnored).iter().try_for_each(|line| say(line))?;
    }
    let (prepared, mut record) = watch(words, |observer| make_points(&capture, &arguments.stereo(), observer))?;
    record["source"] = source.display().to_string().into();
    record["out"] = file.display().to_string().into();
    write_file_with(file, force, |file| write_prepared(BufWriter::new(file), &prepared))?;
    arguments.job.write_json(&record)?;
    next::train(source, Some(file), &arguments.hold_out)
}

/// Makes a call whose steps are printed.
fn watch<T>(words: &mut Words, call: impl FnOnce(&mut dyn Observer) -> Result<T, PipelineError>) -> anyhow::Result<T> {
    let result = Teller::default().watch(|teller| {
        call(&mut |event: &Event| {
            if let Event::Begun { work, .. } = event {
                // COLMAP is a child process, which a signal must end first.
                interrupt::be_polite(*work == Work::FindingCameras);
            }
            let Event::Prepared(step) = event else { return teller.hear(event) };
            interrupt::be_polite(false);
            if let PrepareStep::LeftOver(warning) = step {
                note(warning);
            }
            teller.lines(&words.of(step))
        })
    });
    interrupt::be_polite(false);
    result
}

fn check_points_file(file: &Path, force: bool) -> anyhow::Result<()> {
    if file.extension().is_none_or(|extension| extension != "npz") {
        return Err(wrong_input(format!("{}: not a kind of file for points, expected NAME.npz", file.display())));
    }
    // The file may replace the capture's own points, which this command does not read.
    check_files(&[file], &[], force)
}

//! From footage to a capture that can be trained: the order of the steps, and which of them are skipped.
//!
//! What lives here: [`prepare`], and one file for each step.
//!
//! - `footage` makes cameras and clocks of videos, with the help of `cameras` and `colors`.
//! - `masks` marks what moves.
//! - `points` makes initial points.
//! - `link` brings the source's files into the capture.
//!
//! What does not: the methods (`tcgs_prepare`), and the words of the command line.

mod cameras;
mod colors;
mod footage;
mod link;
mod masks;
mod points;
mod steps;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError, DESCRIPTION_FILE, MASKS_FOLDER, POINTS_FILE};
use tcgs_interchange::{Existing, is_unfinished, parent_folder, write_whole};
use tcgs_prepare::{Diagnosis, PrepareError, RawFootage, StereoSettings};

use crate::error::PipelineError;
use crate::new_folder::NewFolder;
use crate::observe::{Event, Observer, PrepareStep, Work, tell};

pub use masks::WantMasks;
pub use points::make_points;
pub use steps::examine;

/// Record in every capture that [`prepare`] makes: how it was made, and that it may be replaced.
const RECORD: &str = "prepare.json";

/// Folder of COLMAP's cameras and points, in its text format.
const MODEL: &str = "colmap";

/// Name of the page of a check, which the command line puts into a capture.
pub const CHECK_PAGE: &str = "check.html";

/// Settings of [`prepare`].
#[derive(Clone, Debug)]
pub struct PrepareOptions {
    /// Number of points, width of the images that are searched for them, and seed.
    pub stereo: StereoSettings,
    /// Whether masks of what moves are made for a capture without masks.
    pub masks: WantMasks,
    /// Whether an existing capture that an earlier call made is replaced. Otherwise its results are used.
    pub replace: bool,
    /// Whether only [`PrepareStep::Planned`] says what would be done, and nothing is written.
    pub dry_run: bool,
    /// Settings for a folder of videos.
    pub footage: FootageOptions,
}

/// Settings of [`prepare`] for a folder of videos.
#[derive(Clone, Debug)]
pub struct FootageOptions {
    /// The calibration, if it is not in the folder of the videos or there are several.
    pub calibration: Option<PathBuf>,
    /// Names of two cameras and the distance between their lenses in metres, to which all lengths are scaled.
    pub scale: Option<([String; 2], f64)>,
    /// Whether a calibration is refined, if that lowers the errors of held-out points.
    pub refine_calibration: bool,
    /// Whether exposure and white balance are evened out, if held-out points then agree better.
    pub balance_colors: bool,
    /// A text file with a line `NAME SECONDS` for each camera: the time of one common event in its video.
    pub offsets: Option<PathBuf>,
    /// Start, seconds after the moment at which all cameras run.
    pub from_secs: Option<f64>,
    /// End, seconds after the moment at which all cameras run.
    pub to_secs: Option<f64>,
    /// Every so many frames are used.
    pub every: Option<usize>,
    /// Frames per second of folders of images; by default 30.
    pub images_fps: Option<f64>,
    /// The names of the cameras that are held out from training; if empty every eighth, of fewer than eight none.
    pub hold_out: Vec<String>,
}

impl Default for PrepareOptions {
    fn default() -> Self {
        Self {
            stereo: StereoSettings::default(),
            masks: WantMasks::Auto,
            replace: false,
            dry_run: false,
            footage: FootageOptions::default(),
        }
    }
}

impl PrepareOptions {
    /// Refuses numbers that no footage has.
    fn check(&self) -> Result<(), PipelineError> {
        let FootageOptions { scale, from_secs, to_secs, every, images_fps, .. } = &self.footage;
        let check = |name: &str, number: Option<f64>, is_such: fn(&f64) -> bool, expected: &str| {
            let wrong = number.filter(|number| !number.is_finite() || !is_such(number));
            wrong.map_or(Ok(()), |found| Err(PipelineError::input(name, format!("is {found}"), expected)))
        };
        let secs = |name, secs| check(name, secs, |&secs| secs >= 0.0, "seconds, 0 or more");
        let above_0 = |name, number| check(name, number, |&number| number > 0.0, "a number above 0");
        secs("from_secs", *from_secs)?;
        secs("to_secs", *to_secs)?;
        above_0("images_fps", *images_fps)?;
        above_0("scale", scale.as_ref().map(|(_, metres)| *metres))?;
        let counts = [("every", *every), ("num_points", Some(self.stereo.num_points))];
        for (name, count) in counts.into_iter().chain([("image_width", Some(self.stereo.image_width))]) {
            if count == Some(0) {
                return Err(PipelineError::input(name, "is 0", "1 or more"));
            }
        }
        Ok(())
    }
}

impl Default for FootageOptions {
    fn default() -> Self {
        Self {
            calibration: None,
            scale: None,
            refine_calibration: true,
            balance_colors: true,
            offsets: None,
            from_secs: None,
            to_secs: None,
            every: None,
            images_fps: None,
            hold_out: Vec::new(),
        }
    }
}

impl FootageOptions {
    /// Whether a source is a folder of videos and not a capture: it holds videos, or a setting is for videos only.
    ///
    /// # Errors
    /// [`PipelineError`] if the folder cannot be listed.
    pub fn is_footage(&self, source: &Path) -> Result<bool, PipelineError> {
        let asked = self.calibration.is_some() || self.offsets.is_some();
        let asked = asked || self.from_secs.is_some() || self.to_secs.is_some() || self.every.is_some();
        let asked = asked || self.images_fps.is_some() || self.scale.is_some();
        Ok(asked || RawFootage::is_in(source)?)
    }
}

/// What [`prepare`] made.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PreparedCapture {
    /// The new capture.
    pub capture: Capture,
    /// Everything about the steps, as the capture's `prepare.json` has it.
    pub record: Value,
    /// The check of the new capture.
    pub diagnosis: Diagnosis,
}

/// Makes a capture of a folder of videos, or of a capture without points: cameras, clocks, masks and points, and checks
/// the result. A step whose result `out` holds from an earlier call with the same source is skipped.
///
/// - `source`: a folder of videos, perhaps with a calibration, or a capture of any kind
/// - `out`: the capture to make; it has the source's files, linked where the file system can, else copied
/// - returns: `None` in a dry run
///
/// ```
/// use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
/// use tcgs_pipeline::{PrepareOptions, Unobserved, prepare};
/// use tcgs_prepare::StereoSettings;
/// let folder = tempfile::tempdir()?;
/// let (source, out) = (folder.path().join("footage"), folder.path().join("capture"));
/// write_synthetic(&source, &SyntheticSettings { num_timesteps: 1, ..Default::default() })?;
///
/// let stereo = StereoSettings { num_points: 2000, image_width: 64, ..Default::default() };
/// let options = PrepareOptions { stereo, ..Default::default() };
/// let prepared = prepare(&source, &out, &options, &mut Unobserved)?.expect("not a dry run");
/// assert!(prepared.record["num_points"].as_u64() > Some(1000) && Capture::open(&out)?.has_points());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PipelineError`] if the source holds neither videos nor a capture, or no capture can be made of it. Also if a file
/// cannot be read or written, or `out` exists and is not replaced. `out` is then as before, except that it may hold the
/// results of finished steps. [`PipelineError::Stopped`] if the observer stops the call.
pub fn prepare(
    source: &Path,
    out: &Path,
    options: &PrepareOptions,
    observer: &mut dyn Observer,
) -> Result<Option<PreparedCapture>, PipelineError> {
    options.check()?;
    let record = match options.footage.is_footage(source)? {
        true => of_footage(source, out, options, observer)?,
        false => of_capture(source, out, options, observer)?,
    };
    let Some(record) = record else {
        planned(observer, Work::Checking)?;
        return Ok(None);
    };
    let capture = Capture::open_unseen(out)?;
    let diagnosis = examine(&capture, observer)?;
    Ok(Some(PreparedCapture { capture, record, diagnosis }))
}

/// Makes a capture of a folder of videos.
///
/// - returns: the record; `None` in a dry run
fn of_footage(
    source: &Path,
    out: &Path,
    options: &PrepareOptions,
    observer: &mut dyn Observer,
) -> Result<Option<Value>, PipelineError> {
    let mut record = match footage::found_description(source, out, options)? {
        Some(description) => {
            say(observer, PrepareStep::Reused(&out.join(DESCRIPTION_FILE)))?;
            footage::record(source, out, &description, None, None)
        }
        None => match footage::describe(source, out, options, observer)? {
            Some(record) => record,
            // Masks and points of a dry run are announced.
            None => return Ok(None),
        },
    };
    let mut capture = Capture::open_unseen(out)?;
    if capture.has_segmentation() {
        say(observer, PrepareStep::MasksKept)?;
    } else if options.masks.are_wanted(&capture, observer)? {
        if options.dry_run {
            planned(observer, Work::Masking)?;
        } else {
            record["masks"] = masks::make_beside(&capture, out, observer)?;
            capture = Capture::open_unseen(out)?;
        }
    }
    if capture.has_points() {
        say(observer, PrepareStep::PointsKept)?;
    } else if options.dry_run {
        planned(observer, Work::MakingPoints)?;
    } else {
        let (prepared, of_points) = points::make_or_strew(&capture, &options.stereo, observer)?;
        points::write(&out.join(POINTS_FILE), &prepared)?;
        add(&mut record, of_points);
    }
    if options.dry_run {
        return Ok(None);
    }
    write_json(&out.join(RECORD), &record, Existing::Replace)?;
    Ok(Some(record))
}

/// Makes a capture with points of a capture.
///
/// - returns: the record; `None` in a dry run
fn of_capture(
    source: &Path,
    out: &Path,
    options: &PrepareOptions,
    observer: &mut dyn Observer,
) -> Result<Option<Value>, PipelineError> {
    if !options.footage.hold_out.is_empty() {
        let expected = "a folder of videos: the test cameras of a capture stand in its files";
        return Err(PipelineError::input("hold_out", "is given for a capture", expected));
    }
    let folder = begin_capture(source, out, options.replace)?;
    let mut capture = open_source(source)?;
    if options.dry_run {
        drop(folder);
        if !capture.has_segmentation() && options.masks.are_wanted(&capture, observer)? {
            planned(observer, Work::Masking)?;
        }
        planned(observer, Work::MakingPoints)?;
        return Ok(None);
    }
    if capture.has_points() {
        say(observer, PrepareStep::PointsIgnored)?;
    }
    link::link_tree(source, folder.path(), &[POINTS_FILE, RECORD, CHECK_PAGE])?;
    let mut of_masks = None;
    if capture.has_segmentation() {
        say(observer, PrepareStep::MasksKept)?;
    } else if options.masks.are_wanted(&capture, observer)? {
        of_masks = Some(masks::make(&capture, source, folder.path(), observer)?);
        capture = Capture::open_unseen(folder.path())?;
    }
    let (prepared, of_points) = make_points(&capture, &options.stereo, observer)?;
    let mut record = json!({ "source": source.display().to_string(), "out": out.display().to_string() });
    add(&mut record, of_points);
    if let Some(of_masks) = of_masks {
        record["masks"] = of_masks;
    }
    points::write(&folder.path().join(POINTS_FILE), &prepared)?;
    write_json(&folder.path().join(RECORD), &record, Existing::Keep)?;
    finish(folder, observer)?;
    Ok(Some(record))
}

/// Opens a source that is not a folder of videos, without asking whether its cameras see its points.
///
/// # Errors
/// [`PipelineError`] if the source is no capture, or cannot be read.
pub fn open_source(source: &Path) -> Result<Capture, PipelineError> {
    match Capture::open_unseen(source) {
        Err(CaptureError::NotCapture { path, .. }) if path.is_dir() => {
            Err(no_videos(&path, "one for each camera, or a capture in a layout that tcgs train reads"))
        }
        opened => Ok(opened?),
    }
}

fn no_videos(folder: &Path, expected: &str) -> PipelineError {
    PipelineError::input(folder.display(), "no videos here", expected)
}

/// Begins a folder outside its source. It replaces an existing folder only if [`prepare`] made that one.
fn begin_capture(source: &Path, out: &Path, replace: bool) -> Result<NewFolder, PipelineError> {
    if let (Ok(parent), Ok(source)) = (parent_folder(out).canonicalize(), source.canonicalize())
        && parent.starts_with(&source)
    {
        let found = format!("lies in {}", source.display());
        return Err(PipelineError::input(out.display(), found, "a place outside the source"));
    }
    if replace && out.exists() && !NewFolder::is_empty(out) {
        let record = std::fs::read(out.join(RECORD)).unwrap_or_default();
        if !serde_json::from_slice::<Value>(&record).is_ok_and(|record| record["source"].is_string()) {
            let expected = "a new name or a folder of an earlier prepare";
            return Err(PipelineError::input(out.display(), "was not made by prepare", expected));
        }
        let failed = |error| PipelineError::unreadable(out, error, "a folder that can be listed");
        for entry in std::fs::read_dir(out).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            let ours = [POINTS_FILE, RECORD, DESCRIPTION_FILE, MODEL, MASKS_FOLDER, "seg", CHECK_PAGE];
            let ours = ours.iter().any(|ours| name == *ours);
            if !ours && !is_unfinished(&name) && source.join(&name).symlink_metadata().is_err() {
                let (place, found) = (out.join(name), "is neither of the source nor of prepare");
                return Err(PipelineError::input(place.display(), found, "it to be moved away first"));
            }
        }
    }
    NewFolder::begin(out, replace, |_| true)
}

/// Moves a new folder to its place.
fn finish(folder: NewFolder, observer: &mut dyn Observer) -> Result<(), PipelineError> {
    match folder.finish()? {
        Some(warning) => say(observer, PrepareStep::LeftOver(&warning)),
        None => Ok(()),
    }
}

/// Reports the result of a step.
fn say(observer: &mut dyn Observer, step: PrepareStep) -> Result<(), PipelineError> {
    tell(observer, Event::Prepared(&step))
}

fn planned(observer: &mut dyn Observer, work: Work) -> Result<(), PipelineError> {
    say(observer, PrepareStep::Planned(work))
}

/// Adds the entries of an object.
fn add(record: &mut Value, more: Value) {
    for (key, value) in more.as_object().into_iter().flatten() {
        record[key] = value.clone();
    }
}

fn write_json(path: &Path, value: &Value, existing: Existing) -> Result<(), PipelineError> {
    write(path, format!("{value:#}\n").as_bytes(), existing)
}

fn write(path: &Path, bytes: &[u8], existing: Existing) -> Result<(), PipelineError> {
    write_whole(path, existing, |file| std::io::Write::write_all(file, bytes)).map_err(unwritable(path))
}

/// From an error of the system to one that names what was to be written.
fn unwritable(path: &Path) -> impl Fn(std::io::Error) -> PipelineError + '_ {
    |error| PipelineError::Unwritable { path: path.into(), error }
}

/// A fault of the source.
fn fault(source: &Path, problem: String) -> PipelineError {
    PrepareError::Invalid { path: source.into(), problem }.into()
}

//! From a folder of recordings to a description of a capture.
//!
//! What lives here: finding the recordings, looking at them, giving each its camera of a calibration (`matching`,
//! `fit`), and putting clocks and cameras together to a [`CaptureDescription`]. What does not: the formats of
//! calibrations (`calibration`) and the search for clocks (`clocks`). The program decides the order of the steps and
//! their words for people.

mod fit;
mod looked;
mod matching;

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tcgs_capture::{
    Calibration, CalibrationSource, CaptureDescription, CaptureKind, ClockSource, DescribedCamera, Recording, Role,
    VIDEO_ENDINGS, files, turned,
};

use crate::PrepareError;
use crate::clocks::Clocks;

use looked::Looked;

/// Folders that do not hold the recording of a camera.
const OTHER_FOLDERS: [&str; 9] =
    ["masks", "seg", "sparse", "colmap", "calibration", "points", "depth", "annots", "output"];
/// Folders in which recordings may lie together.
const INNER_FOLDERS: [&str; 2] = ["videos", "images"];
/// Frames per second of folders of images, by default.
const IMAGES_PER_SEC: f64 = 30.0;

/// The recordings of one scene, one for each camera.
#[derive(Debug)]
pub struct RawFootage {
    /// The folder that was searched.
    pub folder: PathBuf,
    recordings: Vec<Recording>,
    looked: Vec<Looked>,
    images_per_sec: f64,
}

/// Facts about one recording before anything is computed.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RawCamera {
    /// Name of the file without its ending, or of the folder.
    pub name: String,
    /// Path relative to the folder of the footage.
    pub file: PathBuf,
    /// Name of the codec; `images` for a folder of images.
    pub codec: String,
    /// Width and height in pixels as shown by players.
    pub size: (usize, usize),
    /// Clockwise turn in degrees for players, as the file says.
    pub turn_degrees: u16,
    /// The usual number of frames per second; `None` for a single frame.
    pub frame_rate: Option<f64>,
    /// Whether the gaps between frames differ.
    pub is_variable: bool,
    /// Number of frames.
    pub num_frames: usize,
    /// Time of the last frame, seconds.
    pub last_secs: f64,
}

/// Settings of [`RawFootage::describe`], beside the calibration and the clocks.
#[derive(Clone, Debug, Default)]
pub struct DescribeSettings {
    /// Start of the capture, seconds after the moment from which all cameras run; default 0.
    pub from_secs: f64,
    /// End of the capture, on the same clock; default the end of the recording that ends first.
    pub to_secs: Option<f64>,
    /// Use every n-th frame; 0, the default, stands for 1.
    pub every: usize,
    /// Frames per second before `every`; default the rate that most recordings have.
    pub frame_rate: Option<f64>,
    /// Names of the held-out cameras. By default every eighth camera is held out, and none of fewer than eight.
    pub test_cameras: Option<Vec<String>>,
}

/// The cameras of a calibration, one for each recording, fitted to the size of its images.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PlacedCameras {
    /// The format and the name of the file.
    pub source: CalibrationSource,
    in_metres: bool,
    cameras: Vec<fit::Fitted>,
}

impl PlacedCameras {
    /// Number of cameras.
    pub fn num_cameras(&self) -> usize {
        self.cameras.len()
    }
}

impl RawFootage {
    /// Whether a folder is one of recordings, and not a capture of a known kind. A kind that has images and no videos
    /// does not count where there are videos.
    ///
    /// # Errors
    /// [`PrepareError`] if the folder cannot be listed.
    pub fn is_in(folder: &Path) -> Result<bool, PrepareError> {
        if !folder.is_dir() {
            return Ok(false);
        }
        let recordings = search(folder)?;
        let has_videos = recordings.iter().any(|path| path.is_file());
        let of_images = [CaptureKind::NERFSTUDIO, CaptureKind::COLMAP, CaptureKind::MIDDLEBURY];
        Ok(match CaptureKind::of(folder)? {
            Some(kind) => has_videos && of_images.contains(&kind),
            None => !recordings.is_empty(),
        })
    }

    /// Finds and opens the recordings of a folder: its videos, else its folders of images, else those in `videos/` or
    /// `images/`. Decodes three frames of each to check that they show anything.
    ///
    /// - `folder`: one file or folder of images for each camera
    /// - `images_per_sec`: frames per second of folders of images; default 30
    /// - returns: `None` if there are no recordings
    ///
    /// # Errors
    /// [`PrepareError`] if a recording cannot be read or shows nothing, or if there is only one.
    pub fn find(folder: &Path, images_per_sec: Option<f64>) -> Result<Option<Self>, PrepareError> {
        let paths = search(folder)?;
        if paths.is_empty() {
            return Ok(None);
        }
        if let [only] = paths.as_slice() {
            let problem =
                format!("has one recording ({}), expected one for each of several cameras", files::name(only));
            return Err(PrepareError::invalid(folder, problem));
        }
        let images_per_sec = images_per_sec.unwrap_or(IMAGES_PER_SEC);
        // All recordings are opened before the first error is chosen, so that the error is always the same.
        let opened: Vec<_> = paths
            .par_iter()
            .map(|path| {
                let recording = Recording::open(path, images_per_sec)?;
                let looked = looked::look(&recording)?;
                Ok((recording, looked))
            })
            .collect();
        let opened = opened.into_iter().collect::<Result<Vec<_>, PrepareError>>()?;
        let (recordings, looked) = opened.into_iter().unzip();
        Ok(Some(Self { folder: folder.into(), recordings, looked, images_per_sec }))
    }

    /// The facts about each recording.
    pub fn cameras(&self) -> Vec<RawCamera> {
        let camera = |recording: &Recording| RawCamera {
            name: name_of(&recording.path),
            file: recording.path.strip_prefix(&self.folder).unwrap_or(&recording.path).into(),
            codec: recording.codec().to_owned(),
            size: turned(recording.size, recording.quarter_turns),
            turn_degrees: 90 * u16::from(recording.quarter_turns),
            frame_rate: recording.times.fps(),
            is_variable: recording.times.is_variable(),
            num_frames: recording.num_frames(),
            last_secs: recording.times.last_secs(),
        };
        self.recordings.iter().map(camera).collect()
    }

    /// Finds the clocks of the recordings against each other: by sound if all have it, else by motion. If neither is
    /// certain, all are assumed to begin at once.
    ///
    /// - `report`: called with the share of the work that is done, in `[0, 1]`, by any thread
    ///
    /// # Errors
    /// [`PrepareError`] if a recording cannot be decoded.
    pub fn measure_clocks(&self, report: &(dyn Fn(f64) + Sync)) -> Result<Clocks, PrepareError> {
        crate::clocks::measure(&self.recordings, report)
    }

    /// Gives each recording its camera of a calibration, by name or number, and fits the intrinsics to the size of its
    /// images.
    ///
    /// # Errors
    /// [`PrepareError`] if a recording has no camera, if several images of one camera have different poses, or if the
    /// calibration is of another resolution.
    pub fn place(&self, calibration: &Calibration) -> Result<PlacedCameras, PrepareError> {
        let invalid = |problem: String| PrepareError::invalid(&calibration.path, problem);
        let names: Vec<String> = self.recordings.iter().map(|recording| name_of(&recording.path)).collect();
        let (of_recording, unused) = matching::matched(&names, &calibration.cameras).map_err(invalid)?;
        let mut changes = Vec::new();
        if !unused.is_empty() {
            changes.push(format!("has no recording for {}, which are left out", unused.join(", ")));
        }
        let mut cameras = Vec::new();
        for ((camera, name), (recording, looked)) in
            of_recording.into_iter().zip(&names).zip(self.recordings.iter().zip(&self.looked))
        {
            let (fitted, change) = fit::fitted(camera, recording, looked)
                .map_err(|problem| invalid(format!("camera {name}: {problem}")))?;
            changes.extend(change.map(|change| format!("{name}: {change}")));
            cameras.push(fitted);
        }
        let (file, format) = (files::name(&calibration.path), calibration.format.to_owned());
        let source = CalibrationSource { file, format, changes };
        Ok(PlacedCameras { source, in_metres: calibration.in_metres, cameras })
    }

    /// Cameras of which only the size of their images is known, for [`find_cameras`](crate::find_cameras) to place. All
    /// stand at the origin, with a usual lens. Black bars are cropped.
    pub fn unplaced(&self) -> PlacedCameras {
        let placed = |(recording, looked): (&Recording, &Looked)| fit::unplaced(recording, looked);
        let cameras = self.recordings.iter().zip(&self.looked).map(placed).collect();
        PlacedCameras { source: CalibrationSource::default(), in_metres: false, cameras }
    }

    /// Puts cameras and clocks together.
    ///
    /// # Errors
    /// [`PrepareError`] if the recordings have no common time within the wanted span, or if a camera to be held out
    /// does not exist.
    pub fn describe(
        &self,
        placed: &PlacedCameras,
        clocks: &Clocks,
        settings: &DescribeSettings,
    ) -> Result<CaptureDescription, PrepareError> {
        let invalid = |problem: String| PrepareError::invalid(&self.folder, problem);
        let every = settings.every.max(1);
        let frame_rate = settings.frame_rate.unwrap_or_else(|| self.usual_rate()) / every as f64;
        let (starts, common_secs) = self.common_time(&clocks.event_secs).map_err(invalid)?;
        let end_secs = settings.to_secs.unwrap_or(common_secs).min(common_secs);
        let span_secs = end_secs - settings.from_secs;
        if span_secs < 0.0 || settings.from_secs < 0.0 {
            return Err(invalid(format!(
                "all cameras run for {common_secs:.3} s, expected a span within, found {} to {end_secs:.3} s",
                settings.from_secs
            )));
        }
        // The end is exclusive, except for the last frame of all. Clocks are not exact to the last bit, so a frame
        // whose moment is nearly reached counts.
        const NEARLY: f64 = 0.25;
        let num_frames = match settings.to_secs.filter(|to| *to < common_secs) {
            Some(_) => ((span_secs * frame_rate - NEARLY).ceil() as usize).max(1),
            None => (span_secs * frame_rate + NEARLY) as usize + 1,
        };
        let mut description = CaptureDescription::new(frame_rate, num_frames);
        description.in_metres = placed.in_metres;
        description.calibration = Some(placed.source.clone());
        description.clock = Some(ClockSource { from: clocks.from.name().into() });
        let names: Vec<String> = self.recordings.iter().map(|recording| name_of(&recording.path)).collect();
        let is_test = self.test_cameras(&names, settings).map_err(invalid)?;
        let ids = ids_of(&names);
        for (i, (recording, fitted)) in self.recordings.iter().zip(&placed.cameras).enumerate() {
            let file = recording.path.strip_prefix(&self.folder).unwrap_or(&recording.path);
            let parts: Vec<_> = file.components().map(|part| part.as_os_str().to_string_lossy()).collect();
            description.cameras.push(DescribedCamera {
                id: ids[i],
                name: names[i].clone(),
                file: parts.join("/"),
                role: if is_test[i] { Role::Test } else { Role::Train },
                start_secs: rounded(starts[i] + settings.from_secs),
                images_per_sec: recording.is_images().then_some(self.images_per_sec),
                turn_degrees: 90 * u16::from(fitted.quarter_turns),
                crop: fitted.crop,
                gains: [1.0; 3],
                offsets: [0.0; 3],
                size: fitted.size,
                focal: fitted.focal,
                principal: fitted.principal,
                distortion: fitted.distortion.to_vec(),
                camera_from_world: fitted.camera_from_world,
                error_px: None,
            });
        }
        Ok(description)
    }

    /// The rate of most recordings; of equally frequent rates the lowest.
    fn usual_rate(&self) -> f64 {
        let mut rates: Vec<f64> = self.recordings.iter().filter_map(|recording| recording.times.fps()).collect();
        rates.sort_by(f64::total_cmp);
        let near = |rate: f64| rates.iter().filter(|other| (*other / rate - 1.0).abs() < 2e-3).count();
        let usual = rates.iter().copied().reduce(|best, rate| if near(rate) > near(best) { rate } else { best });
        let usual = usual.unwrap_or(IMAGES_PER_SEC);
        // Times in a file are rounded: a rate close to a usual rate of cameras is that rate.
        let known = [usual.round(), 24_000.0 / 1001.0, 30_000.0 / 1001.0, 60_000.0 / 1001.0, 120_000.0 / 1001.0];
        known.into_iter().find(|rate| (usual / rate - 1.0).abs() < 2e-4).unwrap_or(usual)
    }

    /// The moment in each file from which all cameras run, and the length of this common time.
    ///
    /// - `event_secs`: the moment of one event in each file
    fn common_time(&self, event_secs: &[f64]) -> Result<(Vec<f64>, f64), String> {
        let begin =
            self.recordings.iter().zip(event_secs).map(|(recording, event)| recording.times.first_secs() - event);
        let begin = begin.fold(f64::NEG_INFINITY, f64::max);
        let end = self.recordings.iter().zip(event_secs).map(|(recording, event)| recording.times.last_secs() - event);
        let (i, end) = end.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, begin));
        if end < begin {
            let name = name_of(&self.recordings[i].path);
            return Err(format!(
                "{name} ends {:.3} s before another camera begins, expected a time at which all run",
                begin - end
            ));
        }
        Ok((event_secs.iter().map(|event| event + begin).collect(), end - begin))
    }

    fn test_cameras(&self, names: &[String], settings: &DescribeSettings) -> Result<Vec<bool>, String> {
        /// One of so many cameras is a test camera, as publications on scenes of COLMAP do.
        const TEST_STRIDE: usize = 8;
        let Some(wanted) = &settings.test_cameras else {
            return Ok((0..names.len()).map(|i| names.len() >= TEST_STRIDE && i % TEST_STRIDE == 0).collect());
        };
        if let Some(unknown) = wanted.iter().find(|name| !names.contains(name)) {
            return Err(format!("has no camera {unknown} to hold out, expected some of {}", names.join(", ")));
        }
        if wanted.len() >= names.len() {
            return Err("all cameras are to be held out, expected some for training".into());
        }
        Ok(names.iter().map(|name| wanted.contains(name)).collect())
    }
}

/// The recordings of a folder or of its inner folders.
fn search(folder: &Path) -> Result<Vec<PathBuf>, PrepareError> {
    let mut paths = recordings_in(folder)?;
    for inner in INNER_FOLDERS {
        let inner = folder.join(inner);
        if paths.is_empty() && inner.is_dir() {
            paths = recordings_in(&inner)?;
        }
    }
    Ok(paths)
}

/// The videos of a folder, else its folders of images.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, PrepareError> {
    let all = files::list(folder)?;
    let videos: Vec<PathBuf> =
        all.iter().filter(|path| path.is_file() && files::has_extension(path, &VIDEO_ENDINGS)).cloned().collect();
    if !videos.is_empty() {
        return Ok(videos);
    }
    let mut folders = Vec::new();
    for path in all.into_iter().filter(|path| path.is_dir() && !OTHER_FOLDERS.contains(&&*files::name(path))) {
        if !files::images(&path)?.is_empty() {
            folders.push(path);
        }
    }
    Ok(folders)
}

/// The name of a recording's camera. A folder's name may have dots, as `cam.01`.
fn name_of(path: &Path) -> String {
    if path.is_dir() { files::name(path) } else { files::stem(path) }
}

/// The number in each name if all names have different numbers, else the places in the order of names.
fn ids_of(names: &[String]) -> Vec<usize> {
    let numbers: Option<Vec<usize>> = names.iter().map(|name| matching::number_in(name)).collect();
    let differ = |ids: &Vec<usize>| (1..ids.len()).all(|i| !ids[..i].contains(&ids[i]));
    numbers.filter(differ).unwrap_or_else(|| (0..names.len()).collect())
}

/// Rounds to microseconds, which is finer than any camera's clock and short to read.
fn rounded(secs: f64) -> f64 {
    (secs * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests;

//! Captures that `capture.toml` describes: videos of any kind or folders of images, with clocks, calibration and gains
//! of colours.
//!
//! ```text
//! capture.toml         the description, docs/CAPTURE.md
//! cam01.mp4 …          what it names
//! masks/cam01/000000.png …  masks of what moves, of the training cameras at least, or none
//! init_pt_cld.npz …    points
//! ```
//!
//! What lives here: the way from the description and its files to a capture. Images are turned, cropped, evened out
//! (`recording::Take`) and straightened one at a time, when they are asked for.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::Camera;

use crate::checked::{FrameRate, InnerPath};
use crate::contents::{CameraSet, Contents, check_train_masks, find_masks};
use crate::description::{CaptureDescription, DESCRIPTION_FILE, DescribedCamera, Role};
use crate::footage::{ByFrame, Change, Footage, Images, Masks, Pixels};
use crate::kind::{CaptureFacts, CaptureKind};
use crate::lens::{Crop, Lens, MAX_SIDE};
use crate::names::{Files, Names};
use crate::recording::{ColorChange, Recording, Take, turned};
use crate::{CaptureError, points};

/// Folder of a described capture that holds the masks, a folder for each camera.
pub const MASKS_FOLDER: &str = "masks";

impl CaptureKind {
    /// `capture.toml`, which describes the files beside it.
    pub const DESCRIBED: Self = Self {
        name: "described",
        mark: "capture.toml",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises: |path| Ok(path.join(DESCRIPTION_FILE).exists()),
        open,
    };
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let file = path.join(DESCRIPTION_FILE);
    let description = CaptureDescription::read(&file)?;
    let frame_rate = FrameRate::new(description.frame_rate)
        .map_err(|problem| CaptureError::invalid(&file, format!("frame_rate {problem}")))?;
    // All footage is collected before the first error is chosen, so that the error is always the same.
    let footage: Vec<_> = description.cameras.par_iter().map(|camera| footage(path, &description, camera)).collect();
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (camera, footage) in description.cameras.iter().zip(footage) {
        match camera.role {
            Role::Train => train.push(footage?),
            Role::Test => test.push(footage?),
        }
    }
    let (mut train, mut test) = (CameraSet::constant(train), CameraSet::constant(test));
    let masks = |footage: &Footage, frames: &[usize]| masks_beside(path, &description, footage, frames);
    find_masks(&mut train, description.num_frames, masks);
    check_train_masks(&train, description.num_frames)?;
    find_masks(&mut test, description.num_frames, masks);
    Ok(Contents {
        num_frames: description.num_frames,
        frame_rate,
        usual_frames: 0..description.num_frames,
        train,
        test,
        cameras_files: [file.clone(), file],
        points: points::find(path, None),
    })
}

impl Take {
    /// The recording of a camera, on the clock of its description.
    ///
    /// - `folder`: the folder that the camera's file is relative to
    ///
    /// # Errors
    /// [`CaptureError`] if the recording cannot be read, or does not fit the description.
    pub fn open(
        folder: &Path,
        description: &CaptureDescription,
        camera: &DescribedCamera,
    ) -> Result<Self, CaptureError> {
        let invalid = |problem: String| invalid(folder, camera, problem);
        let inner =
            InnerPath::new(&camera.file, "the capture").map_err(|problem| invalid(format!("file {problem}")))?;
        let recording = Recording::open(&inner.below(folder), camera.images_per_sec.unwrap_or(description.frame_rate))?;
        check_times(&recording, description, camera)?;

        let quarter_turns = (camera.turn_degrees / 90) as u8;
        let whole = turned(recording.size, quarter_turns);
        let active =
            camera.crop.map_or(Crop::whole(whole), |[left, top, width, height]| Crop { left, top, width, height });
        if !active.is_within(whole) {
            return Err(invalid(format!("crop {:?} exceeds the image of {}x{} pixels", camera.crop, whole.0, whole.1)));
        }
        let [width, height] = camera.size;
        if (active.width, active.height) != (width, height) || width.max(height) > MAX_SIDE {
            let (found, cropped) =
                ((active.width, active.height), if camera.crop.is_some() { ", cropped" } else { "" });
            return Err(invalid(format!(
                "size is {width}x{height} pixels, but {} has {}x{}{cropped}, expected the same",
                camera.file, found.0, found.1
            )));
        }
        let colors = match description.colors.as_ref().is_none_or(|colors| colors.used) {
            true => ColorChange { gains: camera.gains, offsets: camera.offsets },
            false => ColorChange::NONE,
        };
        let (start_secs, fps) = (camera.start_secs, description.frame_rate);
        Ok(Self { recording: Arc::new(recording), quarter_turns, active, colors, start_secs, fps })
    }
}

fn invalid(folder: &Path, camera: &DescribedCamera, problem: String) -> CaptureError {
    CaptureError::invalid(folder.join(DESCRIPTION_FILE), format!("camera {}: {problem}", camera.name))
}

/// The mask files of a camera, if the camera has masks.
fn masks_beside(folder: &Path, description: &CaptureDescription, footage: &Footage, frames: &[usize]) -> Option<Files> {
    let camera = description.cameras.iter().find(|camera| camera.id == footage.camera_id)?;
    // A camera may have any name, but masks stay in their folder.
    InnerPath::new(&camera.name, "the masks").ok()?;
    let names: Vec<(usize, String)> =
        frames.iter().map(|&frame| (frame, format!("{}/{frame:06}.png", camera.name))).collect();
    Some(Files { folder: folder.join(MASKS_FOLDER), names: Names::of(&names) })
}

fn footage(folder: &Path, description: &CaptureDescription, camera: &DescribedCamera) -> Result<Footage, CaptureError> {
    let invalid = |problem: String| invalid(folder, camera, problem);
    let take = Take::open(folder, description, camera)?;
    let [width, height] = camera.size;
    let k: [f64; 8] = std::array::from_fn(|i| camera.distortion.get(i).copied().unwrap_or(0.0));
    let mut lens = Lens {
        width,
        height,
        focal: camera.focal,
        principal: camera.principal,
        radial: [k[0], k[1], k[4], k[5], k[6], k[7]],
        tangential: [k[2], k[3]],
        crop: Crop::default(),
    };
    lens.find_crop().map_err(invalid)?;
    let [x, y, z] = camera.camera_from_world;
    let pinhole =
        Camera::new(lens.crop.width, lens.crop.height, lens.straight_intrinsics(), [x, y, z, [0.0, 0.0, 0.0, 1.0]]);
    let pinhole = pinhole.map_err(|error| invalid(error.to_string()))?;
    let changes = ByFrame::constant(Change::for_lens(&Arc::new(lens)));
    Ok(Footage {
        camera_id: camera.id,
        name: camera.name.clone(),
        cameras: ByFrame::constant(pinhole),
        images: Images::Stored { pixels: Pixels::Take(Arc::new(take)), changes },
        masks: Masks::None,
    })
}

/// Checks that the recording runs while the capture does.
fn check_times(
    recording: &Recording,
    description: &CaptureDescription,
    camera: &DescribedCamera,
) -> Result<(), CaptureError> {
    let times = &recording.times;
    let begin = camera.start_secs;
    let end = begin + (description.num_frames - 1) as f64 / description.frame_rate;
    // A frame is shown until the next one; rounding moves both.
    let slack = 1.0 / times.fps().unwrap_or(description.frame_rate).min(description.frame_rate);
    let (first, last) = (times.first_secs(), times.last_secs());
    if begin < first - slack || end > last + slack {
        let problem = format!(
            "has frames from {first:.3} s to {last:.3} s, expected frames from {begin:.3} s to {end:.3} s: \
             {} frames at {} a second from start_secs on",
            description.num_frames, description.frame_rate
        );
        return Err(CaptureError::invalid(&recording.path, problem));
    }
    Ok(())
}

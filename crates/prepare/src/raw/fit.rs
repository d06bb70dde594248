//! Fits the intrinsics of a calibration to images of another size: scaled where this is exact, else refused.
//!
//! The first of these sizes that fits is used:
//!
//! 1. the size as players show it, also scaled;
//! 2. the size as stored, where the file asks players to turn the image by a quarter, also scaled;
//! 3. the part within black bars, also scaled.

use tcgs_capture::{CalibratedCamera, Crop, Recording, turned};

use super::looked::Looked;

/// A camera fitted to its images.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fitted {
    pub quarter_turns: u8,
    /// `left, top, width, height` of the turned image, if not all of it is used.
    pub crop: Option<[usize; 4]>,
    pub size: [usize; 2],
    pub focal: [f64; 2],
    pub principal: [f64; 2],
    pub distortion: [f64; 8],
    pub camera_from_world: [[f64; 4]; 3],
}

/// - returns: the camera, and the changes in words; or the fault
pub(super) fn fitted(
    camera: &CalibratedCamera,
    recording: &Recording,
    looked: &Looked,
) -> Result<(Fitted, Option<String>), String> {
    let turns = recording.quarter_turns;
    let shown = turned(recording.size, turns);
    let of_angle = camera.angle_x.map(|angle| {
        let focal = 0.5 * shown.0 as f64 / (0.5 * angle).tan();
        let principal = [shown.0, shown.1].map(|side| side as f64 / 2.0);
        CalibratedCamera { size: Some(shown), focal: [focal; 2], principal, ..camera.clone() }
    });
    let camera = of_angle.as_ref().unwrap_or(camera);
    let Some(size) = camera.size else {
        return with_size_of_video(camera, turns, shown);
    };
    let all = |quarter_turns| (quarter_turns, None, turned(recording.size, quarter_turns));
    let mut candidates = vec![all(turns)];
    if turns % 2 == 1 {
        candidates.push(all(0));
    }
    let bars = turned_within(looked.within_bars, recording.size, turns);
    if (bars.width, bars.height) != shown {
        candidates.push((turns, Some(bars), (bars.width, bars.height)));
    }
    for (quarter_turns, active, (width, height)) in candidates {
        if !is_scaled((width, height), size) {
            continue;
        }
        let scale = [width as f64 / size.0 as f64, height as f64 / size.1 as f64];
        let fitted = Fitted {
            quarter_turns,
            crop: active.map(|active| [active.left, active.top, active.width, active.height]),
            size: [width, height],
            focal: [camera.focal[0] * scale[0], camera.focal[1] * scale[1]],
            principal: [camera.principal[0] * scale[0], camera.principal[1] * scale[1]],
            distortion: camera.distortion,
            camera_from_world: camera.camera_from_world,
        };
        let mut changes = Vec::new();
        if let Some(active) = active {
            changes.push(format!(
                "black bars are cropped, which leaves {}x{} of {}x{} pixels",
                active.width, active.height, shown.0, shown.1
            ));
        }
        if quarter_turns != turns {
            changes.push("the calibration is of the image as stored, so it is not turned".into());
        }
        if (width, height) != size {
            changes.push(format!("the calibration of {}x{} pixels is scaled to {width}x{height}", size.0, size.1));
        }
        return Ok((fitted, (!changes.is_empty()).then(|| changes.join("; "))));
    }
    Err(format!(
        "is calibrated at {}x{} pixels, expected {}x{} as the recording has, or a size of which that is a scaled copy",
        size.0, size.1, shown.0, shown.1
    ))
}

/// A camera with unknown calibration: the part within black bars, behind a usual lens.
pub(super) fn unplaced(recording: &Recording, looked: &Looked) -> Fitted {
    /// Focal length over the longer side; COLMAP assumes the same.
    const USUAL_FOCAL: f64 = 1.2;
    let turns = recording.quarter_turns;
    let bars = turned_within(looked.within_bars, recording.size, turns);
    let size = [bars.width, bars.height];
    let is_whole = (bars.width, bars.height) == turned(recording.size, turns);
    Fitted {
        quarter_turns: turns,
        crop: (!is_whole).then_some([bars.left, bars.top, bars.width, bars.height]),
        size,
        focal: [USUAL_FOCAL * bars.width.max(bars.height) as f64; 2],
        principal: size.map(|side| 0.5 * side as f64),
        distortion: [0.0; 8],
        camera_from_world: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    }
}

/// Takes a calibration without size to be of the video's size, if its principal point allows that.
fn with_size_of_video(
    camera: &CalibratedCamera,
    quarter_turns: u8,
    (width, height): (usize, usize),
) -> Result<(Fitted, Option<String>), String> {
    let [cx, cy] = camera.principal;
    // Lenses are mounted within some per cent of the middle of the sensor.
    let is_near_middle = |center: f64, side: usize| (0.25..0.75).contains(&(center / side as f64));
    if !is_near_middle(cx, width) || !is_near_middle(cy, height) {
        return Err(format!(
            "has its principal point at {cx:.1} {cy:.1}, expected one near the middle of {width}x{height} pixels; the \
             calibration does not say of which size it is, and seems to be of another"
        ));
    }
    let fitted = Fitted {
        quarter_turns,
        crop: None,
        size: [width, height],
        focal: camera.focal,
        principal: camera.principal,
        distortion: camera.distortion,
        camera_from_world: camera.camera_from_world,
    };
    Ok((fitted, None))
}

/// Whether one size is a scaled copy of the other, up to rounding to whole or even pixels.
fn is_scaled((width, height): (usize, usize), of: (usize, usize)) -> bool {
    let (by_width, by_height) = (width as f64 / of.0 as f64, height as f64 / of.1 as f64);
    (by_width - by_height).abs() * of.0.max(of.1) as f64 <= by_width.max(by_height)
}

/// Converts a rectangle of the stored image to the turned image.
fn turned_within(active: Crop, (width, height): (usize, usize), quarter_turns: u8) -> Crop {
    let Crop { left, top, width: w, height: h } = active;
    let (right, bottom) = (width - left - w, height - top - h);
    match quarter_turns {
        1 => Crop { left: bottom, top: left, width: h, height: w },
        2 => Crop { left: right, top: bottom, width: w, height: h },
        3 => Crop { left: top, top: right, width: h, height: w },
        _ => active,
    }
}

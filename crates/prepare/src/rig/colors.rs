//! Exposure and white balance: differences in colour between a rig's cameras, measured at places that several cameras
//! see.
//!
//! What lives here: the places, their colours in each camera, and the judgement of the fitted gains and offsets
//! (`color_fit`) on held-out places.

use std::ops::ControlFlow;
use std::path::Path;

use image::RgbImage;
use rayon::prelude::*;
use tcgs_capture::CaptureDescription;
use tcgs_core::upper_median;

use super::bundle::{self, Track};
use super::camera::RigCamera;
use super::color_fit::{self, Line, Model, Seen};
use super::frames::Frames;
use super::refine::{
    BANDS, BETTER, MIN_JUDGES, MIN_TRACKS, NO_WORSE, held_out, is_beyond_chance, longer_side, moments_of, shots, tracks,
};
use crate::PrepareError;

/// Radius around a place over which colours are averaged, as a share of the longer side of the image that shows it
/// smallest.
const RADIUS: f64 = 0.006;
/// Largest radius in an image that shows a place larger, share of its longer side.
const MAX_RADIUS: f64 = 0.03;
/// Least search radius around the projection of a place, pixels: places in small images are not known better.
const MIN_BAND_PX: f64 = 1.0;
/// Values of 255 outside which a sensor, or the processing after it, is saturated.
const SATURATED: [u8; 2] = [4, 250];
/// Share of a place's pixels that may be saturated.
const MAX_SATURATED: f64 = 0.02;
/// Offsets are used besides gains if they reduce the errors of held-out places to this share of those with gains alone.
const BETTER_WITH_OFFSETS: f64 = 0.95;
/// Errors below this many levels of 255 need no correction.
const EXACT_LEVELS: f64 = 1.0;

/// Differences in colour between cameras, judged by places that were not fitted.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ColorBalance {
    /// Whether the found gains and offsets make the colours agree better, and were therefore used.
    pub is_taken: bool,
    /// Whether there are offsets besides gains.
    pub has_offsets: bool,
    /// Number of fitted places, and of judging places.
    pub num_places: [usize; 2],
    /// Mean of [`Self::camera_error_levels`].
    pub error_levels: [f64; 2],
    /// For each camera, in the description's order, the median difference between its colour of a place and that of the
    /// others, in levels of 255, before and after. If the result was not taken, "after" is the difference that it would
    /// have given. `None` where too few places judge.
    pub camera_error_levels: Vec<Option<[f64; 2]>>,
}

/// Measures gains and offsets between the cameras of a description, relative to the camera in the middle. They are
/// taken if held-out places agree better with them. A camera that too few places judge keeps its colours.
///
/// Places are corners that are matched between neighbouring cameras at several moments. A place's colour is the mean of
/// its surroundings. A quarter of the regions of every image is held out.
///
/// - `folder`: the folder that the description's files are relative to
/// - `tell`: called with a description of each step; a break ends the work
/// - returns: `None` if too little is seen by several cameras to judge, or if `tell` ended the work; the gains of the
///   description are then 1
///
/// # Errors
/// [`PrepareError`] if an image cannot be decoded.
pub fn balance_colors(
    folder: &Path,
    description: &mut CaptureDescription,
    tell: &mut dyn FnMut(&str) -> ControlFlow<()>,
) -> Result<Option<ColorBalance>, PrepareError> {
    description.cameras.iter_mut().for_each(|camera| (camera.gains, camera.offsets) = ([1.0; 3], [0.0; 3]));
    let cameras: Vec<RigCamera> = description.cameras.iter().map(RigCamera::new).collect();
    if cameras.len() < 2 || tell("reading images").is_break() {
        return Ok(None);
    }
    let frames = Frames::open(folder, description)?;
    let shots = shots(&frames, description.num_frames)?;
    if tell("matching").is_break() {
        return Ok(None);
    }
    let widest = cameras.iter().map(longer_side).fold(1.0, f64::max);
    let band = BANDS[2].max(MIN_BAND_PX / widest);
    let found = tracks(&cameras, &shots, band);
    if !is_beyond_chance(&cameras, &found, &shots, band) || tell("comparing colours").is_break() {
        return Ok(None);
    }
    drop(shots);
    let (judges, fitted) = held_out(found, &cameras);
    let [mut to_fit, mut to_judge] = [(); 2].map(|()| [(); 3].map(|()| Vec::new()));
    for ((frame, fitted), judges) in moments_of(description.num_frames).into_iter().zip(&fitted).zip(&judges) {
        let images = frames.at(frame)?;
        for (places, tracks) in [(&mut to_fit, fitted), (&mut to_judge, judges)] {
            for seen in tracks.par_iter().map(|track| colors_of(track, &cameras, &images, band)).collect::<Vec<_>>() {
                places.iter_mut().zip(seen).for_each(|(places, seen): (&mut Vec<Seen>, Seen)| places.push(seen));
            }
        }
    }
    let num_of = |places: &[Vec<Seen>; 3]| places[1].iter().filter(|seen| seen.len() >= 2).count();
    let num_places = [num_of(&to_fit), num_of(&to_judge)];
    if num_places[1] < MIN_JUDGES {
        return Ok(None);
    }
    Ok(Some(best_of(&to_fit, &to_judge, num_places, description)))
}

/// Fits, judges, and writes accepted gains and offsets into the description.
fn best_of(
    to_fit: &[Vec<Seen>; 3],
    to_judge: &[Vec<Seen>; 3],
    num_places: [usize; 2],
    description: &mut CaptureDescription,
) -> ColorBalance {
    let num_cameras = description.cameras.len();
    let judged = |lines: &[Vec<Line>; 3]| -> Vec<Option<f64>> {
        let errors = [0, 1, 2].map(|channel| color_fit::errors(&to_judge[channel], &lines[channel]));
        let of_camera = |camera: usize| {
            let errors = errors.each_ref().map(|of_channel| of_channel[camera].as_slice()).concat();
            (errors.len() >= 3 * MIN_TRACKS).then(|| 255.0 * upper_median(errors).unwrap_or_default())
        };
        (0..num_cameras).map(of_camera).collect()
    };
    let before = judged(&[(); 3].map(|()| vec![Line::NONE; num_cameras]));
    let lines_of = |model: Model| {
        to_fit.each_ref().map(|places| {
            let count = |camera: usize| {
                places.iter().filter(|seen| seen.len() >= 2 && seen.iter().any(|&(other, _)| other == camera)).count()
            };
            // A gain without a judging place is not applied.
            let is_free: Vec<bool> =
                (0..num_cameras).map(|camera| count(camera) >= MIN_TRACKS && before[camera].is_some()).collect();
            color_fit::fit(places, &is_free, model)
        })
    };
    let mean = |errors: &[Option<f64>]| {
        let known: Vec<f64> = errors.iter().flatten().copied().collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    };
    let gains = lines_of(Model::Gains);
    let with_offsets = lines_of(Model::GainsAndOffsets);
    let has_offsets = mean(&judged(&with_offsets)) < BETTER_WITH_OFFSETS * mean(&judged(&gains));
    let lines = if has_offsets { with_offsets } else { gains };
    let after = judged(&lines);
    let camera_error_levels: Vec<Option<[f64; 2]>> =
        before.iter().zip(&after).map(|(before, after)| before.zip(*after).map(|(a, b)| [a, b])).collect();
    let error_levels = [mean(&before), mean(&after)];
    let is_no_worse = |[old, new]: &[f64; 2]| *new <= NO_WORSE * old.max(EXACT_LEVELS);
    let is_better = error_levels[1] < BETTER * error_levels[0] && error_levels[0] > EXACT_LEVELS;
    // A gain of a tenth or less is a mismatch: no camera has it.
    let is_possible = lines.iter().flatten().all(|line| line.gain > 0.1 && line.offset.abs() < 0.5);
    let is_taken = is_better && is_possible && camera_error_levels.iter().flatten().all(is_no_worse);
    if is_taken {
        let rounded = |value: f64| ((1e4 * value).round() / 1e4) as f32;
        for (i, camera) in description.cameras.iter_mut().enumerate() {
            camera.gains = [0, 1, 2].map(|channel| rounded(lines[channel][i].gain));
            camera.offsets = [0, 1, 2].map(|channel| rounded(lines[channel][i].offset));
        }
    }
    ColorBalance { is_taken, has_offsets: is_taken && has_offsets, num_places, error_levels, camera_error_levels }
}

/// Colours of a place in all cameras, channel by channel, without saturated values.
///
/// - `images`: of all cameras
/// - `band`: largest reprojection error of the place, share of the longer side
fn colors_of(track: &Track, cameras: &[RigCamera], images: &[RgbImage], band: f64) -> [Seen; 3] {
    let mut colors: [Seen; 3] = Default::default();
    let errors = bundle::errors(cameras, track);
    // Pixels of an image per length of the scene.
    let scale = |camera: usize| cameras[camera].lens.focal[0] / cameras[camera].camera_point(track.point)[2];
    let length = |camera: usize| RADIUS * longer_side(&cameras[camera]) / scale(camera);
    // The radius in the scene is that of the image that shows the place smallest.
    let radius = track.seen.iter().map(|&(camera, _)| length(camera)).fold(0.0, f64::max);
    for (&(camera, pixel), error) in track.seen.iter().zip(errors) {
        let side = longer_side(&cameras[camera]);
        let radius_px = radius * scale(camera);
        if error > band * side || !(0.5..=MAX_RADIUS * side).contains(&radius_px) {
            continue;
        }
        for (colors, value) in colors.iter_mut().zip(mean_around(&images[camera], pixel, radius_px)) {
            colors.extend(value.map(|value| (camera, value)));
        }
    }
    colors
}

/// The mean of each channel within a circle, in `[0, 1]`; `None` of a channel that is saturated there.
fn mean_around(image: &RgbImage, [x, y]: [f64; 2], radius: f64) -> [Option<f64>; 3] {
    let (mut sums, mut saturated, mut count) = ([0.0; 3], [0.0; 3], 0.0);
    let range = |center: f64, side: u32| {
        (center - radius).floor().max(0.0) as u32..((center + radius).ceil().max(0.0) as u32).min(side)
    };
    for row in range(y, image.height()) {
        for column in range(x, image.width()) {
            if (f64::from(column) + 0.5 - x).hypot(f64::from(row) + 0.5 - y) > radius {
                continue;
            }
            count += 1.0;
            for (channel, value) in image.get_pixel(column, row).0.into_iter().enumerate() {
                sums[channel] += f64::from(value) / 255.0;
                saturated[channel] += f64::from(u8::from(value < SATURATED[0] || value > SATURATED[1]));
            }
        }
    }
    let is_whole = count > 2.0 * radius * radius;
    std::array::from_fn(|i| (is_whole && saturated[i] <= MAX_SATURATED * count).then(|| sums[i] / count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcgs_capture::{DescribedCamera, Role};

    #[test]
    fn a_gain_that_nothing_judges_is_not_applied() {
        let mut description = CaptureDescription::new(30.0, 1);
        description.cameras = (0..3)
            .map(|id| DescribedCamera {
                id,
                name: format!("cam{id}"),
                file: format!("cam{id}.mp4"),
                role: Role::Train,
                start_secs: 0.0,
                images_per_sec: None,
                turn_degrees: 0,
                crop: None,
                gains: [1.0; 3],
                offsets: [0.0; 3],
                size: [64, 48],
                focal: [60.0; 2],
                principal: [32.0, 24.0],
                distortion: Vec::new(),
                camera_from_world: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
                error_px: None,
            })
            .collect();
        // The second and the third camera are darker; no held-out place is seen by the third.
        let shown = [1.0, 0.6, 0.5];
        let place = |i: usize, cameras: &[usize]| -> Seen {
            let color = 0.2 + 0.6 * (i % 17) as f64 / 17.0;
            cameras.iter().map(|&camera| (camera, color * shown[camera])).collect()
        };
        let places = |cameras: &[usize]| [(); 3].map(|()| (0..80).map(|i| place(i, cameras)).collect::<Vec<Seen>>());
        let found = best_of(&places(&[0, 1, 2]), &places(&[0, 1]), [80, 80], &mut description);
        assert!(found.is_taken && found.camera_error_levels[2].is_none(), "{found:?}");
        let gains = |camera: usize| description.cameras[camera].gains[0];
        assert!((gains(1) / gains(0) - 1.0 / 0.6).abs() < 0.05, "{} {}", gains(0), gains(1));
        assert_eq!((description.cameras[2].gains, description.cameras[2].offsets), ([1.0; 3], [0.0; 3]));
    }
}

//! Foreground masks of cameras that stand still, without networks. A mask marks differences from the image that the
//! camera has most of the time, within the visual hull of all cameras' differences.
//!
//! What lives here: the order of the steps. `station` holds a camera's samples and its background, `difference`
//! compares an image with a background, `outline` makes a mask of the differences. The visual hull is that of
//! [`stereo_points`](crate::stereo_points).
//!
//! A person who stands in one place for half of the time is the median there. The hull of all cameras' differences is
//! right if most cameras are. It says which samples show the background, and the medians are taken again from these.

mod difference;
mod outline;
mod station;
#[cfg(test)]
mod tests;

use std::ops::ControlFlow;

use rayon::prelude::*;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Camera, Segmentation, View};

use crate::PrepareError;
use crate::stereo::hull::{Hull, Silhouette};
use difference::differences;
use station::{Pixels, Station};

/// Settings of [`make_masks`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaskSettings {
    /// Images are downscaled by a whole factor until they are at most this wide, pixels; default 320. Masks have the
    /// images' own size.
    pub image_width: usize,
}

impl Default for MaskSettings {
    fn default() -> Self {
        Self { image_width: 320 }
    }
}

/// Number of frames from which backgrounds are taken: enough for medians, and few enough to be held at once.
const NUM_SAMPLES: usize = 16;
/// Minimum number of frames for telling moving objects from the background.
const MIN_FRAMES: usize = 8;
/// Minimum number of cameras for a useful hull.
const MIN_CAMERAS: usize = 4;
/// How often backgrounds are taken again, without the samples that the hull covers.
const ROUNDS: usize = 3;
/// Edge of the hull's finest cubes, pixels.
const FINEST_PX: f32 = 1.5;
/// Share of the cameras with a place in view that may see no difference there. The first value is for the first round,
/// when people who stood still are part of the background; the second is for later rounds.
const MISS_SHARES: [f32; 2] = [0.3, 0.13];
/// Limits of the threshold: the distance of colours, in `[0, 1]`, above which a pixel is foreground.
const THRESHOLDS: [f32; 2] = [0.04, 0.1];
/// The threshold is a multiple of the distance that this share of the pixels outside the hull stay below: noise, and
/// shadows.
const STILL_SHARE: f64 = 0.95;
/// Factor of the threshold over that distance.
const ABOVE_STILL: f32 = 2.0;
/// Distance of a background sample from the hull, pixels.
const MARGIN_PX: usize = 2;

/// Why [`make_masks`] refuses a capture, if it does: too few frames, cameras that move, or missing images.
///
/// - returns: the fault and what was expected, as words to follow the capture's name
///
/// # Errors
/// [`PrepareError`] if the cameras of a frame cannot be read.
pub fn obstacle_to_masks(capture: &Capture) -> Result<Option<String>, PrepareError> {
    let num_frames = capture.num_frames();
    if num_frames < MIN_FRAMES {
        return Ok(Some(format!("has {num_frames} frames, expected at least {MIN_FRAMES} to tell what moves")));
    }
    let cameras = capture.cameras(Split::All, 0, 1)?;
    for frame in 1..num_frames {
        let found = capture.cameras(Split::All, frame, 1)?;
        if let Some(moving) = cameras.iter().position(|camera| !found.contains(camera)) {
            let name = capture.camera_names(Split::All, 0)?.swap_remove(moving);
            let problem = format!("moves or has no image at frame {frame}, expected cameras that stand still");
            return Ok(Some(format!("camera {name} {problem}")));
        }
    }
    Ok(None)
}

/// Marks moving objects in every image of a capture whose cameras stand still.
///
/// - `write`: called with frame, camera id and mask, `[H, W]` of the camera's size, frame by frame in the order of
///   [`Capture::views`]; a break ends the work without an error
/// - `report`: called with a description of each step, and the share of the work that is done
///
/// Memory: about the bytes of the images of 16 frames at the width of the settings, and two frames of decoded images.
/// Equal captures give equal masks, whatever the number of threads.
///
/// ```
/// use std::ops::ControlFlow;
/// use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
/// use tcgs_prepare::{MaskSettings, make_masks};
/// let folder = tempfile::tempdir()?;
/// let small = SyntheticSettings { width: 48, height: 36, num_timesteps: 8, ..Default::default() };
/// write_synthetic(folder.path(), &small)?;
/// let capture = Capture::open(folder.path())?;
/// let mut num_masks = 0;
/// let mut write = |_frame, _camera_id, mask: &tcgs_core::Segmentation| {
///     num_masks += usize::from((mask.width, mask.height) == (48, 36));
///     ControlFlow::Continue(())
/// };
/// make_masks(&capture, &MaskSettings::default(), &mut write, &mut |_, _| ())?;
/// assert_eq!(num_masks, 8 * 14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PrepareError`] if there is an [obstacle](obstacle_to_masks), or if an image cannot be decoded.
pub fn make_masks(
    capture: &Capture,
    settings: &MaskSettings,
    write: &mut dyn FnMut(usize, usize, &Segmentation) -> ControlFlow<()>,
    report: &mut dyn FnMut(&str, f64),
) -> Result<(), PrepareError> {
    if let Some(problem) = obstacle_to_masks(capture)? {
        return Err(PrepareError::invalid(capture.path(), problem));
    }
    let (num_frames, cameras) = (capture.num_frames(), capture.cameras(Split::All, 0, 1)?);
    let widest = cameras.iter().map(|(_, camera)| camera.width).max().unwrap_or(1);
    let narrowest = cameras.iter().map(|(_, camera)| camera.width.min(camera.height)).min().unwrap_or(1);
    let factor = widest.div_ceil(settings.image_width.max(1)).clamp(1, narrowest);
    let mut stations: Vec<Station> = cameras.iter().map(|(id, camera)| Station::new(*id, camera, factor)).collect();

    let num_samples = NUM_SAMPLES.min(num_frames);
    // Sampling and each round of finding backgrounds take about as long per sample.
    let total = (num_samples * (1 + ROUNDS) + num_frames) as f64;
    for i in 0..num_samples {
        report("sampling images", i as f64 / total);
        let images = images(capture, &cameras, (2 * i + 1) * num_frames / (2 * num_samples), factor)?;
        stations.iter_mut().zip(images).for_each(|(station, image)| station.samples.push(image));
    }
    stations.par_iter_mut().for_each(|station| station.find_background(None));
    let [mut threshold, mut miss_share] = [THRESHOLDS[1], MISS_SHARES[0]];
    for round in 0..ROUNDS {
        let mut still = [0_usize; 256];
        let mut covered: Vec<Vec<Vec<bool>>> = vec![Vec::new(); stations.len()];
        for i in 0..num_samples {
            report("finding backgrounds", (num_samples * (1 + round) + i) as f64 / total);
            let images: Vec<&Pixels> = stations.iter().map(|station| &station.samples[i]).collect();
            let (differences, covers) = compare(&stations, &images, threshold, miss_share);
            for (differences, cover) in differences.iter().zip(&covers) {
                let outside = differences.iter().zip(cover).filter(|(_, cover)| !**cover);
                outside.for_each(|(difference, _)| still[(difference * 255.0).min(255.0) as usize] += 1);
            }
            covered.iter_mut().zip(covers).for_each(|(covered, cover)| covered.push(cover));
        }
        stations.par_iter_mut().zip(&covered).for_each(|(station, covered)| station.find_background(Some(covered)));
        let below = |level: usize| still[..level].iter().sum::<usize>() as f64;
        let level = (0..256).find(|&level| below(level + 1) >= STILL_SHARE * below(256)).unwrap_or(255);
        threshold = (ABOVE_STILL * (level + 1) as f32 / 255.0).clamp(THRESHOLDS[0], THRESHOLDS[1]);
        miss_share = MISS_SHARES[1];
    }
    stations.iter_mut().for_each(|station| station.samples = Vec::new());

    for frame in 0..num_frames {
        report("marking what moves", (num_samples * (1 + ROUNDS) + frame) as f64 / total);
        let images = images(capture, &cameras, frame, factor)?;
        let (differences, covers) = compare(&stations, &images.iter().collect::<Vec<_>>(), threshold, miss_share);
        let masks: Vec<Segmentation> = (0..stations.len())
            .into_par_iter()
            .map(|i| outline::mask(&stations[i], &images[i], &differences[i], threshold, &covers[i]))
            .collect();
        for (station, mask) in stations.iter().zip(&masks) {
            if write(frame, station.camera_id, mask).is_break() {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// The reduced images of a frame. Only a few full images are held at a time.
fn images(
    capture: &Capture,
    cameras: &[(usize, Camera)],
    frame: usize,
    factor: usize,
) -> Result<Vec<Pixels>, PrepareError> {
    let found = capture.cameras(Split::All, frame, 1)?;
    let places: Vec<usize> =
        cameras.iter().filter_map(|camera| found.iter().position(|other| other == camera)).collect();
    let mut images = Vec::new();
    for some in places.chunks(rayon::current_num_threads().max(1)) {
        images.extend(capture.some_views(Split::All, frame, factor, some)?.iter().map(pixels));
    }
    Ok(images)
}

fn pixels(view: &View) -> Pixels {
    view.image.to_rgb8().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

/// Compares the images of one moment with the backgrounds.
///
/// - `images`: an image for each station
/// - `threshold`: the difference above which a pixel is foreground
/// - `miss_share`: share of the cameras with a place in view that may see no difference there
/// - returns: for each station the differences, `[H, W]`, as [`differences`] gives them, and the pixels that the hull
///   of all differences covers
fn compare(
    stations: &[Station],
    images: &[&Pixels],
    threshold: f32,
    miss_share: f32,
) -> (Vec<Vec<f32>>, Vec<Vec<bool>>) {
    let (found, masks): (Vec<Vec<f32>>, Vec<Vec<bool>>) = stations
        .par_iter()
        .zip(images)
        .map(|(station, image)| {
            let found = differences(image, &station.background);
            let differs: Vec<bool> = found.iter().map(|&difference| difference > threshold).collect();
            let mut mask = outline::majority(station.pinhole.width, &differs);
            // Where the background is never seen, nothing differs from it. A silhouette has no holes there.
            let known = &station.background.known;
            if known.contains(&false) {
                let filled = outline::filled(station.pinhole.width, &mask);
                mask.iter_mut().zip(filled).zip(known).for_each(|((mask, filled), known)| *mask |= filled && !known);
            }
            (found, mask)
        })
        .unzip();
    if stations.len() < MIN_CAMERAS {
        // Too few cameras for a hull: the differences are the mask.
        return (found, masks);
    }
    let silhouettes: Vec<Silhouette> =
        stations.iter().zip(&masks).map(|(station, mask)| Silhouette { pinhole: &station.pinhole, mask }).collect();
    let hull = Hull::carve_despite(&silhouettes, FINEST_PX, miss_share);
    let surface = hull.surface();
    let cover = |station: &Station| -> Vec<bool> {
        hull.depths(&surface, &station.pinhole).iter().map(|[near, far]| near < far).collect()
    };
    (found, stations.par_iter().map(cover).collect())
}

//! Finds cameras whose clocks are wrong: their silhouettes fit those of the others at another time.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Pinhole, View, upper_median};

use super::{Finding, FindingKind};
use crate::PrepareError;
use crate::stereo::{
    hull::{Hull, Silhouette},
    vantage::Vantage,
};

/// Largest width at which silhouettes are compared, pixels.
const WIDTH: usize = 160;
/// Largest shift that is tried, frames.
const MAX_SHIFT: usize = 8;
/// Maximum number of times that are compared.
const MAX_TIMES: usize = 4;
/// Number of frames from which the static background is taken if the capture has no masks.
const NUM_STILLS: usize = 9;
/// A pixel that differs from the static background by more than this is foreground.
const MOVED: f32 = 0.08;
/// Minimum gain of the silhouettes' overlap at another time, as mean of intersection over union. Without masks healthy
/// cameras gain up to 0.04.
const CLEARLY: f64 = 0.06;
/// Minimum number of cameras.
const MIN_CAMERAS: usize = 4;

/// A camera's silhouettes by frame.
struct Witness {
    camera_id: usize,
    silhouettes: BTreeMap<usize, (Pinhole<f32>, Vec<bool>)>,
}

/// - `suspects`: cameras that are wrong in another way, and are left out
pub(super) fn findings(capture: &Capture, suspects: &[usize]) -> Result<Vec<Finding>, PrepareError> {
    let num_frames = capture.num_frames();
    let reach = MAX_SHIFT.min(num_frames.saturating_sub(1) / 3);
    if reach == 0 {
        return Ok(Vec::new());
    }
    // Evenly spread times, each with room for early and late frames.
    let room = num_frames - 2 * reach;
    let num_times = MAX_TIMES.min(room);
    let times: Vec<usize> = (0..num_times).map(|i| reach + (2 * i + 1) * room / (2 * num_times)).collect();
    let mut witnesses: Vec<Witness> = witnesses(capture, &times, reach)?
        .into_iter()
        .filter(|witness| !suspects.contains(&witness.camera_id))
        .collect();
    // The worst camera is removed first, and the others are judged again without it: its silhouettes spoil their
    // reference.
    let mut found = Vec::new();
    while witnesses.len() >= MIN_CAMERAS {
        let shifts: Vec<Option<Shift>> =
            (0..witnesses.len()).into_par_iter().map(|i| best_shift(&witnesses, i, &times, reach as i32)).collect();
        let gain = |i: usize| shifts[i].map_or(0.0, |shift| shift.gain);
        let Some(worst) = (0..shifts.len()).max_by(|&a, &b| gain(a).total_cmp(&gain(b)).then(b.cmp(&a))) else { break };
        let Some(shift) = shifts[worst] else { break };
        found.push((witnesses.remove(worst).camera_id, shift));
    }
    found.sort_unstable_by_key(|(camera_id, _)| *camera_id);
    Ok(found.into_iter().map(|(camera_id, shift)| finding(camera_id, shift)).collect())
}

fn finding(camera_id: usize, Shift { frames: shift, overlap, gain }: Shift) -> Finding {
    let count = shift.unsigned_abs();
    let frames = if count == 1 { "frame" } else { "frames" };
    let (problem, fix) = if shift > 0 {
        (format!("{count} {frames} late: it shows in frame t+{count} what the others show in frame t"), "drop")
    } else {
        (format!("{count} {frames} early: it shows in frame t what the others show in frame t+{count}"), "repeat")
    };
    let before = overlap - gain;
    let problem = format!("{problem} (what moves then overlaps by {overlap:.2} and not by {before:.2}, of 1)");
    let fix = format!("{fix} {count} {frames} at its beginning");
    Finding::new(FindingKind::Unsynchronised, vec![camera_id], problem, fix)
}

/// Another time that fits better.
#[derive(Clone, Copy)]
struct Shift {
    /// Frames later.
    frames: i32,
    /// Mean of intersection over union, at this time.
    overlap: f64,
    /// Gain of the overlap against no shift.
    gain: f64,
}

/// Number of frames by which a camera shows the same later than the others; `None` if it is in time.
fn best_shift(witnesses: &[Witness], of: usize, times: &[usize], reach: i32) -> Option<Shift> {
    let num_shifts = (2 * reach + 1) as usize;
    // `[T][S]`
    let mut overlaps: Vec<Vec<f64>> = Vec::new();
    for &time in times {
        let others: Vec<Silhouette> = witnesses
            .iter()
            .enumerate()
            .filter(|&(i, _)| i != of)
            .filter_map(|(_, witness)| witness.silhouettes.get(&time))
            .map(|(pinhole, mask)| Silhouette { pinhole, mask })
            .collect();
        let hull = Hull::carve(&others, 1.5);
        let surface = hull.surface();
        let Some((pinhole, _)) = witnesses[of].silhouettes.get(&time) else { continue };
        let expected = hull.depths(&surface, pinhole);
        let overlap = |shift: i32| {
            let frame = (time as i32 + shift) as usize;
            let Some((_, mask)) = witnesses[of].silhouettes.get(&frame) else { return 0.0 };
            let (mut both, mut either) = (0.0, 0.0);
            for ([near, far], &marked) in expected.iter().zip(mask) {
                let expected = near < far;
                both += f64::from(u8::from(expected && marked));
                either += f64::from(u8::from(expected || marked));
            }
            if either > 0.0 { both / either } else { 0.0 }
        };
        overlaps.push((-reach..=reach).map(overlap).collect());
    }
    let mean = |shift: usize| overlaps.iter().map(|overlap| overlap[shift]).sum::<f64>() / overlaps.len().max(1) as f64;
    let in_time = reach as usize;
    let best = (0..num_shifts).max_by(|&a, &b| mean(a).total_cmp(&mean(b)).then(b.cmp(&a)))?;
    let better = overlaps.iter().filter(|overlap| overlap[best] > overlap[in_time]).count();
    let gain = mean(best) - mean(in_time);
    let clearly = gain > CLEARLY && 3 * better > 2 * overlaps.len();
    (best != in_time && clearly).then_some(Shift { frames: best as i32 - reach, overlap: mean(best), gain })
}

/// All cameras' silhouettes around some times: their masks, or differences from the static background.
fn witnesses(capture: &Capture, times: &[usize], reach: usize) -> Result<Vec<Witness>, PrepareError> {
    let mut frames: Vec<usize> = times.iter().flat_map(|&time| time - reach..=time + reach).collect();
    frames.sort_unstable();
    frames.dedup();
    let widest = capture.cameras(Split::All, 0, 1)?.iter().map(|(_, camera)| camera.width).max().unwrap_or(1);
    let downscale = widest.div_ceil(WIDTH).max(1);
    let stills = match capture.has_segmentation() {
        true => BTreeMap::new(),
        false => stills(capture, downscale)?,
    };
    let mut witnesses: BTreeMap<usize, Witness> = BTreeMap::new();
    for frame in frames {
        for view in capture.views(Split::All, frame, downscale)? {
            let Some(mask) = silhouette(&view, &stills) else { continue };
            let camera_id = view.camera_id;
            let witness =
                witnesses.entry(camera_id).or_insert_with(|| Witness { camera_id, silhouettes: BTreeMap::new() });
            witness.silhouettes.insert(frame, (Pinhole::new(&view.camera), mask));
        }
    }
    Ok(witnesses.into_values().collect())
}

fn silhouette(view: &View, stills: &BTreeMap<usize, Vec<[f32; 3]>>) -> Option<Vec<bool>> {
    if let Some(mask) = &view.segmentation {
        return Some(mask.foreground.clone());
    }
    let still = stills.get(&view.camera_id)?;
    let vantage = Vantage::new(view, 1);
    let moved = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).any(|(a, b)| (a - b).abs() > MOVED);
    Some(vantage.colors.iter().zip(still).map(moved).collect())
}

/// The median over time of every camera's pixels.
fn stills(capture: &Capture, downscale: usize) -> Result<BTreeMap<usize, Vec<[f32; 3]>>, PrepareError> {
    let num_frames = capture.num_frames();
    let count = NUM_STILLS.min(num_frames);
    let mut images: BTreeMap<usize, Vec<Vec<[f32; 3]>>> = BTreeMap::new();
    for i in 0..count {
        for view in capture.views(Split::All, i * (num_frames - 1) / (count - 1).max(1), downscale)? {
            images.entry(view.camera_id).or_default().push(Vantage::new(&view, 1).colors);
        }
    }
    let median = |images: &Vec<Vec<[f32; 3]>>| {
        let pixel = |pixel: usize| {
            let colors = images.iter().filter_map(|image| image.get(pixel));
            [0, 1, 2].map(|channel| upper_median(colors.clone().map(|color| color[channel])).unwrap_or_default())
        };
        (0..images[0].len()).into_par_iter().map(pixel).collect()
    };
    Ok(images.iter().map(|(&id, images)| (id, median(images))).collect())
}

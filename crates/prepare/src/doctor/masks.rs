//! Checks for masks that are empty, or the wrong way round.

use rayon::prelude::*;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Image, Pinhole, View};

use super::{Finding, FindingKind, splat::Splats};
use crate::PrepareError;

/// Foreground in sight below this share of the pixels may be missing from a mask.
const MIN_IN_SIGHT: f64 = 0.003;
/// A mask is inverted if its share of the background exceeds its share of the foreground by this.
const CLEARLY: f64 = 0.3;
/// Masks with a larger mean share than this are suspicious.
const MOST: f64 = 0.5;
/// Change of a pixel over time above which something moved there.
const MOVED: f32 = 0.1;

/// Compares masks with the points' foreground.
pub(super) fn findings(views: &[View], splats: &Splats) -> Vec<Finding> {
    let masked: Vec<&View> = views.iter().filter(|view| view.segmentation.is_some()).collect();
    let (mut empty, mut inverted) = (Vec::new(), Vec::new());
    if splats.has_both_labels() {
        let shares: Vec<Shares> = masked.par_iter().map(|view| Shares::new(view, splats)).collect();
        for (view, shares) in masked.iter().zip(&shares) {
            if shares.in_sight < MIN_IN_SIGHT {
                continue;
            }
            if shares.all == 0.0 {
                empty.push(view.camera_id);
            } else if shares.of_background > shares.of_foreground + CLEARLY {
                inverted.push(view.camera_id);
            }
        }
    }
    if empty.is_empty() && !masked.is_empty() && masked.iter().all(|view| share(view) == 0.0) {
        empty = masked.iter().map(|view| view.camera_id).collect();
    }
    let mut findings = Vec::new();
    if !empty.is_empty() {
        let problem = "the mask of the first frame is empty, though foreground is in sight";
        let fix = "segment these images again, or remove all masks";
        findings.push(Finding::new(FindingKind::EmptyMask, empty, problem, fix));
    }
    if !inverted.is_empty() {
        findings.push(wrong_way_round(inverted));
    }
    findings
}

/// Inverts masks that are the wrong way round in most images, before the points take their labels from them. Motion
/// decides, if the capture has at least two frames.
pub(super) fn turn_over(
    capture: &Capture,
    views: &mut [View],
    downscale: usize,
) -> Result<Option<Finding>, PrepareError> {
    let masked: Vec<f64> = views.iter().filter(|view| view.segmentation.is_some()).map(share).collect();
    if masked.iter().sum::<f64>() <= MOST * masked.len() as f64 || capture.num_frames() < 2 {
        return Ok(None);
    }
    let later = capture.views(Split::All, capture.num_frames() / 2, downscale)?;
    let inverted = moving_outside(views, &later);
    if 2 * inverted.len() <= masked.len() {
        return Ok(None);
    }
    for view in views.iter_mut().filter(|view| inverted.contains(&view.camera_id)) {
        let mask = view.segmentation.as_mut().map_or(&mut [][..], |mask| &mut mask.foreground);
        mask.iter_mut().for_each(|marked| *marked = !*marked);
    }
    Ok(Some(wrong_way_round(inverted)))
}

fn wrong_way_round(cameras: Vec<usize>) -> Finding {
    let problem = "the mask is the wrong way round: the background is marked";
    let fix = "swap black and white; foreground is what is not black";
    Finding::new(FindingKind::InvertedMask, cameras, problem, fix)
}

fn share(view: &View) -> f64 {
    let mask = view.segmentation.as_ref().map_or(&[][..], |mask| &mask.foreground);
    mask.iter().filter(|&&m| m).count() as f64 / mask.len().max(1) as f64
}

/// Shares that a mask marks of one image.
struct Shares {
    /// Marked share of the image.
    all: f64,
    /// Marked share of the points' foreground.
    of_foreground: f64,
    /// Marked share of the points' background.
    of_background: f64,
    /// Share of the image that the points say is foreground.
    in_sight: f64,
}

impl Shares {
    fn new(view: &View, splats: &Splats) -> Self {
        let drawing = splats.draw(&Pinhole::new(&view.camera));
        let mask = view.segmentation.as_ref().map_or(&[][..], |mask| &mask.foreground);
        // Drawn and marked, by label.
        let (mut drawn, mut marked) = ([0.0_f64; 2], [0.0_f64; 2]);
        for pixel in (0..mask.len()).filter(|&pixel| drawing.is_drawn(pixel)) {
            let label = usize::from(drawing.foreground[pixel]);
            drawn[label] += 1.0;
            marked[label] += f64::from(u8::from(mask[pixel]));
        }
        let of = |label: usize| if drawn[label] > 0.0 { marked[label] / drawn[label] } else { 0.0 };
        Self {
            all: share(view),
            of_foreground: of(1),
            of_background: of(0),
            in_sight: drawn[1] / mask.len().max(1) as f64,
        }
    }
}

/// Cameras whose images change more outside the mask than inside.
///
/// - `later`: the same views at another time
fn moving_outside(views: &[View], later: &[View]) -> Vec<usize> {
    let moved = |a: &Image, b: &Image, pixel: usize| {
        (0..3).any(|channel| (a.plane(channel)[pixel] - b.plane(channel)[pixel]).abs() > MOVED)
    };
    let outside = |(view, later): &(&View, &View)| {
        let Some(mask) = &view.segmentation else { return false };
        let (mut pixels, mut moving) = ([0.0_f64; 2], [0.0_f64; 2]);
        for (pixel, &marked) in mask.foreground.iter().enumerate() {
            pixels[usize::from(marked)] += 1.0;
            moving[usize::from(marked)] += f64::from(u8::from(moved(&view.image, &later.image, pixel)));
        }
        moving[0] / pixels[0].max(1.0) > moving[1] / pixels[1].max(1.0)
    };
    let pairs = views.iter().zip(later).filter(|(a, b)| a.camera_id == b.camera_id);
    pairs.filter(outside).map(|(view, _)| view.camera_id).collect()
}

//! Checks whether all cameras show the same colours. Each image is compared with the points as seen from its camera,
//! and each camera with the one in the middle. The source of the points' colours therefore does not matter.

use rayon::prelude::*;
use tcgs_core::{Pinhole, View, upper_median};

use super::geometry::{Judged, Verdict};
use super::splat::Splats;
use super::{Finding, FindingKind};
use crate::stereo::vantage::Vantage;

/// A camera is uneven if a channel is brighter or darker than the middle camera's by more than this. Training learns a
/// gain of each camera and absorbs small differences: up to 23 % on basketball cost 0.08 dB of PSNR, up to 43 % on
/// kitchen 1.7 dB.
const UNEVEN: f64 = 0.35;
/// Values of image and points that are compared. Outside this range sensors are saturated, or dark.
const COMPARED: std::ops::Range<f32> = 0.06..0.94;
/// Minimum number of compared pixels.
const MIN_PIXELS: usize = 200;
/// Minimum number of cameras for one to be in the middle.
const MIN_CAMERAS: usize = 3;

/// Brightness of each camera's red, green and blue over those of the camera in the middle.
///
/// - `judged`: of each view; only views that fit are compared
/// - returns: `None` for cameras that cannot be compared
pub(super) fn factors(views: &[View], splats: &Splats, judged: &[Judged]) -> Vec<Option<[f64; 3]>> {
    let fits = |i: usize| judged.get(i).is_some_and(|judged| judged.verdict == Verdict::Fits);
    let of_view = |i: usize| if fits(i) { from_points(&views[i], splats) } else { None };
    let logarithms: Vec<Option<[f64; 3]>> = (0..views.len()).into_par_iter().map(of_view).collect();
    let known: Vec<[f64; 3]> = logarithms.iter().flatten().copied().collect();
    if known.len() < MIN_CAMERAS {
        return vec![None; views.len()];
    }
    let middle = [0, 1, 2].map(|channel| upper_median(known.iter().map(|of| of[channel])).unwrap_or_default());
    let relative = |of: [f64; 3]| std::array::from_fn(|channel| (of[channel] - middle[channel]).exp());
    logarithms.into_iter().map(|of| of.map(relative)).collect()
}

/// Logarithm of the brightness of an image over that of the points as seen from its camera.
fn from_points(view: &View, splats: &Splats) -> Option<[f64; 3]> {
    let drawing = splats.draw(&Pinhole::new(&view.camera));
    let image = Vantage::new(view, 1).colors;
    let mut ratios: [Vec<f64>; 3] = Default::default();
    for pixel in (0..image.len()).filter(|&pixel| drawing.is_drawn(pixel)) {
        for (channel, ratios) in ratios.iter_mut().enumerate() {
            let (seen, drawn) = (image[pixel][channel], drawing.colors[pixel][channel]);
            if COMPARED.contains(&seen) && COMPARED.contains(&drawn) {
                ratios.push(f64::from(seen / drawn).ln());
            }
        }
    }
    let is_seen = ratios.iter().all(|ratios| ratios.len() >= MIN_PIXELS);
    is_seen.then(|| ratios.map(|ratios| upper_median(ratios).unwrap_or_default()))
}

/// Findings about cameras whose colours differ.
pub(super) fn findings(views: &[View], factors: &[Option<[f64; 3]>]) -> Vec<Finding> {
    let uneven = |(view, factors): (&View, &Option<[f64; 3]>)| {
        let factors = factors.filter(|of| of.iter().any(|factor| factor.ln().abs() > UNEVEN.ln_1p()))?;
        let shares = factors.map(|factor| format!("{:+.0} %", 100.0 * (factor - 1.0)));
        let problem =
            format!("red, green and blue differ by {} from those of the camera in the middle", shares.join(", "));
        let gains = factors.map(|factor| format!("{:.2}", 1.0 / factor));
        let fix = format!(
            "multiply by {} (gains in capture.toml), or let `tcgs prepare` measure gains on the videos",
            gains.join(", ")
        );
        Some(Finding::new(FindingKind::UnevenColors, vec![view.camera_id], problem, fix))
    };
    views.iter().zip(factors).filter_map(uneven).collect()
}

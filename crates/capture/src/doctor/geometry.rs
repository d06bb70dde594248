//! Do cameras and images fit together? Every suspicion is a hypothesis: another pose or another lens, under
//! which the points would fall on pixels of their colours. One that fits clearly better is the finding.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, View};

use super::{Finding, FindingKind, list, splat::Splats};
use crate::{points_in_view, prepare::vantage::Vantage};

/// By how much a hypothesis must fit better than what the capture says.
const CLEARLY: f64 = 0.12;
/// A hypothesis that fits less than this explains nothing.
const MIN_FIT: f64 = 0.35;
/// Below this a camera does not fit, whatever the reason.
const NO_FIT: f64 = 0.2;
/// Lenses that are tried: factors of the focal lengths.
const FOCAL_FACTORS: [f64; 16] =
    [0.25, 0.333, 0.4, 0.5, 0.571, 0.667, 0.75, 0.833, 0.91, 1.1, 1.2, 1.333, 1.5, 1.75, 2.0, 4.0];
/// Image sizes that intrinsics may have been meant for.
const SIZE_FACTORS: [f64; 6] = [0.25, 0.333, 0.5, 2.0, 3.0, 4.0];
/// How far principal points are moved, share of the image's width.
const MAX_SHIFT: f64 = 0.25;
/// A principal point that is off by less is as good as calibrations are, share of the image's width.
const MIN_SHIFT: f64 = 0.02;
/// Between poses of cameras closer than this share of the rig's size there is no telling.
const MIN_APART: f64 = 0.02;

/// How a camera fits, and what would fit better.
pub(super) struct Judged {
    pub fit: f64,
    pub finding: Option<Hypothesis>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Hypothesis {
    /// Matrix the wrong way round.
    Inverted,
    /// Pose and lens of another camera.
    PoseOf(usize),
    /// Intrinsics times this.
    MeantForSize(f64),
    /// Focal lengths times this.
    Focal(f64),
    /// Principal point that far away, pixels of the capture's images.
    Principal([f64; 2]),
}

/// - `views`: in the size they are compared at
/// - `pixels_per`: pixels of the capture's images for one of those
pub(super) fn judge(splats: &Splats, views: &[View], pixels_per: usize) -> Vec<Judged> {
    let vantages: Vec<Vantage> = views.par_iter().map(|view| Vantage::new(view, 1)).collect();
    let drawings: Vec<_> = vantages.par_iter().map(|vantage| splats.draw(&vantage.pinhole)).collect();
    (0..views.len())
        .into_par_iter()
        .map(|i| {
            let colors = &vantages[i].colors;
            let camera = &views[i].camera;
            let same_size = |j: usize| views[j].camera.width == camera.width && views[j].camera.height == camera.height;
            let fit = drawings[i].fit(colors, [0; 2], 1);
            let with = |camera: &Camera| splats.draw(&Pinhole::new(camera)).fit(colors, [0; 2], 1);
            let mut best = (fit + CLEARLY, None);
            let mut consider = |fit: f64, hypothesis: Hypothesis| {
                if fit > best.0 && fit > MIN_FIT {
                    best = (fit, Some(hypothesis));
                }
            };
            // From the likeliest to the least likely: of two that fit alike the first is kept.
            consider(with(&points_in_view::inverse(camera)), Hypothesis::Inverted);
            for j in (0..views.len()).filter(|&j| j != i && same_size(j) && is_apart(views, i, j)) {
                consider(drawings[j].fit(colors, [0; 2], 1), Hypothesis::PoseOf(j));
            }
            for factor in SIZE_FACTORS {
                consider(with(&scaled(camera, factor, factor)), Hypothesis::MeantForSize(factor));
            }
            for factor in FOCAL_FACTORS {
                consider(with(&scaled(camera, factor, 1.0)), Hypothesis::Focal(factor));
            }
            let most = (MAX_SHIFT * camera.width as f64) as i32;
            let (shift, shifted) = best_shift(most, |shift, step| drawings[i].fit(colors, shift, step));
            if f64::from(shift[0]).hypot(f64::from(shift[1])) >= MIN_SHIFT * camera.width as f64 {
                let shift = shift.map(|pixels| f64::from(pixels) * pixels_per as f64);
                consider(shifted, Hypothesis::Principal(shift));
            }
            Judged { fit, finding: best.1 }
        })
        .collect()
}

fn is_apart(views: &[View], i: usize, j: usize) -> bool {
    let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let centers: Vec<[f64; 3]> = views.iter().map(|view| view.camera.center()).collect();
    let size = centers.iter().map(|&center| distance(center, centers[0])).fold(0.0, f64::max);
    distance(centers[i], centers[j]) > MIN_APART * size
}

fn scaled(camera: &Camera, focal: f64, principal: f64) -> Camera {
    Camera {
        focal: camera.focal.map(|f| f * focal),
        principal: camera.principal.map(|c| c * principal),
        ..camera.clone()
    }
}

/// First in steps of four pixels, then of one around the best.
fn best_shift(most: i32, fit: impl Fn([i32; 2], usize) -> f64) -> ([i32; 2], f64) {
    let search = |around: [i32; 2], reach: i32, spacing: i32, step: usize| {
        let mut best = (around, f64::NEG_INFINITY);
        let steps = reach / spacing;
        for dy in -steps..=steps {
            for dx in -steps..=steps {
                let shift = [around[0] + dx * spacing, around[1] + dy * spacing];
                let found = fit(shift, step);
                if found > best.1 {
                    best = (shift, found);
                }
            }
        }
        best
    };
    let (coarse, _) = search([0; 2], most, 4, 2);
    search(coarse, 4, 1, 1)
}

/// What is said about hypotheses, those alike together.
pub(super) fn findings(views: &[View], judged: &[Judged]) -> Vec<Finding> {
    let id = |i: usize| views[i].camera_id;
    let of = |pick: &dyn Fn(&Hypothesis) -> bool| -> Vec<usize> {
        (0..views.len()).filter(|&i| judged[i].finding.as_ref().is_some_and(pick)).map(id).collect()
    };
    let mut findings = Vec::new();
    let inverted = of(&|h| *h == Hypothesis::Inverted);
    if !inverted.is_empty() {
        let fix = "write the inverse of these matrices: w2c maps the world to the camera";
        let problem = "the matrix is the wrong way round (it maps the camera to the world)";
        findings.push(Finding::new(FindingKind::InvertedExtrinsics, inverted, problem, fix));
    }
    let exchanged = of(&|h| matches!(h, Hypothesis::PoseOf(_)));
    if !exchanged.is_empty() {
        let pairs: Vec<String> = (0..views.len())
            .filter_map(|i| match judged[i].finding {
                Some(Hypothesis::PoseOf(j)) => Some(format!("{} from that of {}", id(i), id(j))),
                _ => None,
            })
            .collect();
        let problem = format!("the image is what is seen from another camera's place: {}", pairs.join(", "));
        let fix = "bring images and cameras into the same order; sorted as text, 10 comes before 2";
        findings.push(Finding::new(FindingKind::ExchangedCameras, exchanged, problem, fix));
    }
    for factor in SIZE_FACTORS {
        let cameras = of(&|h| *h == Hypothesis::MeantForSize(factor));
        if !cameras.is_empty() {
            let problem = format!("the intrinsics are those of images {} times as large", shown(1.0 / factor));
            let fix = format!("multiply fx, fy, cx and cy by {}", shown(factor));
            findings.push(Finding::new(FindingKind::ImageSize, cameras, problem, fix));
        }
    }
    for factor in FOCAL_FACTORS {
        let cameras = of(&|h| *h == Hypothesis::Focal(factor));
        if !cameras.is_empty() {
            let problem = match factor < 1.0 {
                true => format!("the focal lengths are about {} times too large", shown(1.0 / factor)),
                false => format!("the focal lengths are about {} times too small", shown(factor)),
            };
            let fix = format!("multiply fx and fy by about {}, or calibrate again", shown(factor));
            findings.push(Finding::new(FindingKind::Focal, cameras, problem, fix));
        }
    }
    for i in 0..views.len() {
        if let Some(Hypothesis::Principal([x, y])) = judged[i].finding {
            let problem = format!("everything is seen {} of where the principal point puts it", direction([x, y]));
            let fix = format!("add about {x:.0} to cx and {y:.0} to cy, or calibrate again: it may be turned a little");
            findings.push(Finding::new(FindingKind::PrincipalPoint, vec![id(i)], problem, fix));
        }
    }
    let lost: Vec<usize> =
        (0..views.len()).filter(|&i| judged[i].finding.is_none() && judged[i].fit < NO_FIT).map(id).collect();
    if !lost.is_empty() {
        let problem = "image and points do not fit, and no single mistake explains it";
        let fix = format!("look at the picture and calibrate {} again", list(&lost));
        findings.push(Finding::new(FindingKind::NoFit, lost, problem, fix));
    }
    findings
}

/// Two decimals at most.
fn shown(factor: f64) -> String {
    let text = format!("{factor:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn direction([x, y]: [f64; 2]) -> String {
    let part = |value: f64, less: &str, more: &str| {
        (value != 0.0).then(|| format!("{:.0} px {}", value.abs(), if value < 0.0 { less } else { more }))
    };
    let parts: Vec<String> = [part(x, "left", "right"), part(y, "up", "down")].into_iter().flatten().collect();
    parts.join(" and ")
}

//! The floor, by plane sweeping (Collins 1996; Gallup et al. 2007).
//!
//! A plane maps the pixels of one image to another, by a homography. On the right plane both images look alike, however
//! far apart the cameras stand. Cameras all around a scene share its floor, and often nothing else.

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_core::{View, add_scaled, cross, dot, mean_vector, normalize};

use super::hull::focus;
use super::patchmatch::SourceView;
use super::shell::Wall;
use super::vantage::Vantage;

/// Longer sides of the images in the search, pixels.
const LONGER_SIDES: [usize; 3] = [64, 128, 256];
/// Number of planes that are made more exact, for each size of the images.
const NUM_REFINED: [usize; 3] = [12, 12, 3];
/// Pixels from a window's middle to its edge.
const HALF_WINDOW: usize = 3;
/// Minimum share of a window that both images show.
const MIN_SHOWN: f32 = 0.7;
/// Variance of a grey level by noise. Windows of less are not compared.
const NOISE_VARIANCE: f32 = (2.0 / 255.0) * (2.0 / 255.0);
/// Maximum numbers of views that are compared with others, and of those others.
const NUM_COMPARED: [usize; 2] = [8, 3];
/// Angle of the floor's normal to the mean upward direction of the images: step and number of steps, degrees.
const TILTS: (f32, usize) = (5.0, 4);
/// Depths of the floor below the place that the cameras look at: from, to and step, as shares of its radius.
const DEPTHS: [f32; 3] = [-0.06, 0.81, 0.03];
/// Minimum [evidence](Sweep::evidence) for a floor.
const MIN_EVIDENCE: f32 = 18.0;

/// An image with what is needed to compare it.
struct Picture {
    vantage: Vantage,
    /// `[H, W]`, whether the pixel and all of those around it are background.
    is_background: Vec<bool>,
}

/// Images of one size.
struct Sweep {
    pictures: Vec<Picture>,
    /// Views and the others that each is compared with.
    pairs: Vec<(usize, Vec<usize>)>,
}

/// The floor on which images match best: a plane below all cameras.
///
/// - `views`: upright on average; what moves is left out, by their masks
/// - returns: `None` if images match on no plane, or if they have no common way up
pub(super) fn find_floor(views: &[View]) -> Option<Wall> {
    let sweeps = LONGER_SIDES.map(|longer_side| Sweep::new(views, longer_side));
    let coarse = &sweeps[0];
    let pinholes: Vec<_> = coarse.pictures.iter().map(|picture| &picture.vantage.pinhole).collect();
    let (place, reach) = focus(&pinholes)?;
    let up = mean_vector(pinholes.iter().map(|pinhole| pinhole.rotation[1].map(|x| -x)));
    // Images that lie on their sides cancel each other.
    if dot(up, up) < 0.25 {
        return None;
    }
    let [from, to, step] = DEPTHS.map(|depth| depth * reach);
    let num_depths = ((to - from) / step) as usize;
    let depths = |normal: [f32; 3]| {
        (0..num_depths).map(move |i| Wall { normal, offset: dot(normal, place) - from - step * i as f32 })
    };
    let up = normalize(up);
    let planes: Vec<Wall> = tilted(up).into_iter().flat_map(depths).collect();
    let judged: Vec<(Wall, f32)> = planes.into_par_iter().map(|plane| (plane, coarse.evidence(plane))).collect();

    let max_tilt = (TILTS.0 * (TILTS.1 + 1) as f32).to_radians();
    let mut steps = [TILTS.0.to_radians() / 2.0, step / 2.0];
    let is_near = |a: Wall, b: Wall| {
        dot(a.normal, b.normal) > (3.0 * steps[0]).cos()
            && (a.distance(place) - b.distance(place)).abs() < 4.0 * steps[1]
    };
    let mut best: Vec<(Wall, f32)> = Vec::new();
    for plane in sorted(judged) {
        if best.len() < NUM_REFINED[0] && best.iter().all(|other| !is_near(plane.0, other.0)) {
            best.push(plane);
        }
    }
    for (sweep, count) in sweeps.iter().zip(NUM_REFINED) {
        let refined = best.into_iter().take(count).map(|(plane, _)| sweep.refined(plane, place, steps));
        best = sorted(refined.filter(|(plane, _)| dot(plane.normal, up) > max_tilt.cos()).collect());
        steps = steps.map(|step| step / 2.0);
    }
    best.first().filter(|(_, evidence)| *evidence >= MIN_EVIDENCE).map(|&(plane, _)| plane)
}

/// Sorts planes by their evidence, the most first.
fn sorted(mut planes: Vec<(Wall, f32)>) -> Vec<(Wall, f32)> {
    planes.sort_by(|a, b| b.1.total_cmp(&a.1));
    planes
}

/// Unit vectors around another, up to the largest tilt.
fn tilted(axis: [f32; 3]) -> Vec<[f32; 3]> {
    let mut vectors = vec![axis];
    let [side, other] = sides(axis);
    for ring in 1..=TILTS.1 {
        let tilt = (TILTS.0 * ring as f32).to_radians();
        for i in 0..6 * ring {
            let (sin, cos) = (std::f32::consts::TAU * i as f32 / (6 * ring) as f32).sin_cos();
            let across: [f32; 3] = std::array::from_fn(|c| cos * side[c] + sin * other[c]);
            vectors.push(normalize(add_scaled(axis, tilt.tan(), across)));
        }
    }
    vectors
}

/// Two unit vectors across a third, at right angles.
fn sides(axis: [f32; 3]) -> [[f32; 3]; 2] {
    let least = (0..3).min_by(|&a, &b| axis[a].abs().total_cmp(&axis[b].abs())).unwrap_or_default();
    let mut unit = [0.0; 3];
    unit[least] = 1.0;
    let side = normalize(cross(axis, unit));
    [side, cross(axis, side)]
}

impl Sweep {
    fn new(views: &[View], longer_side: usize) -> Self {
        let picture = |view: &View| {
            let side = view.camera.width.max(view.camera.height);
            let factor = side.div_ceil(longer_side).clamp(1, view.camera.width.min(view.camera.height));
            Picture::new(Vantage::new(view, factor))
        };
        let pictures: Vec<Picture> = views.par_iter().map(picture).collect();
        let center = |i: usize| pictures[i].vantage.pinhole.center;
        let step = pictures.len().div_ceil(NUM_COMPARED[0]).max(1);
        let pairs = (0..pictures.len()).step_by(step).map(|i| {
            let apart = |j: usize| tcgs_core::distance(center(i), center(j));
            let mut others: Vec<usize> = (0..pictures.len()).filter(|&j| apart(j) > 0.0).collect();
            others.sort_by(|&a, &b| apart(a).total_cmp(&apart(b)).then(a.cmp(&b)));
            others.truncate(NUM_COMPARED[1]);
            (i, others)
        });
        Self { pairs: pairs.collect(), pictures }
    }

    /// How well the images match on a plane: the sum of the pixels' correlations over the root of their number; 0 if a
    /// camera is behind the plane. The floors of five captures have 27 to 85. The best plane has 5 to 12 if each
    /// camera has the place of another.
    fn evidence(&self, plane: Wall) -> f32 {
        if self.pictures.iter().any(|picture| plane.distance(picture.vantage.pinhole.center) <= 0.0) {
            return 0.0;
        }
        let (mut sum, mut number) = (0.0, 0.0_f32);
        let mut sums = Sums::default();
        for (of, others) in &self.pairs {
            let picture = &self.pictures[*of];
            let mut found = vec![[0.0_f32; 2]; picture.is_background.len()];
            for &other in others {
                picture.warp(&self.pictures[other], plane, &mut sums.moments);
                correlate(&mut sums, picture.vantage.pinhole.width, &mut found);
            }
            for [correlation, count] in found.into_iter().filter(|found| found[1] > 0.0) {
                sum += correlation / count;
                number += 1.0;
            }
        }
        sum / number.max(1.0).sqrt()
    }

    /// The plane nearby on which the images match best, by pattern search (Hooke and Jeeves 1961), and the evidence.
    ///
    /// - `place`: above the point about which planes turn
    /// - `steps`: of angles, radians, and of the offset; halved once
    fn refined(&self, plane: Wall, place: [f32; 3], steps: [f32; 2]) -> (Wall, f32) {
        let mut best = (plane, self.evidence(plane));
        for [turn, shift] in [steps, steps.map(|step| step / 2.0)] {
            loop {
                let from = best;
                let foot = add_scaled(place, -from.0.distance(place), from.0.normal);
                let turned = |across: [f32; 3], angle: f32| {
                    let normal = normalize(add_scaled(from.0.normal, angle.tan(), across));
                    Wall { normal, offset: dot(normal, foot) }
                };
                let shifted = |by: f32| Wall { offset: from.0.offset + by, ..from.0 };
                let [side, other] = sides(from.0.normal);
                let near = [
                    turned(side, turn),
                    turned(side, -turn),
                    turned(other, turn),
                    turned(other, -turn),
                    shifted(shift),
                    shifted(-shift),
                ];
                let judged: Vec<(Wall, f32)> =
                    near.into_par_iter().map(|plane| (plane, self.evidence(plane))).collect();
                best = judged.into_iter().fold(best, |best, plane| if plane.1 > best.1 { plane } else { best });
                if best.1 <= from.1 {
                    break;
                }
            }
        }
        best
    }
}

impl Picture {
    fn new(vantage: Vantage) -> Self {
        let (width, height) = (vantage.pinhole.width, vantage.pinhole.height);
        let is_background = |pixel: usize| {
            let (x, y) = (pixel % width, pixel / width);
            (y.saturating_sub(1)..(y + 2).min(height))
                .all(|y| (x.saturating_sub(1)..(x + 2).min(width)).all(|x| !vantage.is_foreground(y * width + x)))
        };
        let is_background = (0..width * height).map(is_background).collect();
        Self { vantage, is_background }
    }

    /// The grey levels of this image and of another that lie on each other by the homography of a plane.
    ///
    /// - `moments`: becomes `[H, W]`, of each pixel 1, both grey levels, their squares and their product; 0 where there
    ///   is no pair
    fn warp(&self, other: &Self, plane: Wall, moments: &mut Vec<Moments>) {
        let (me, them) = (&self.vantage.pinhole, &other.vantage.pinhole);
        // Linear in the pixel: a ray meets the plane where its way along the normal is the camera's distance.
        let inverse_depth = |place: [f32; 2]| dot(plane.normal, me.ray(place)) / -plane.distance(me.center);
        let start = inverse_depth([0.0; 2]);
        let gradient = [inverse_depth([1.0, 0.0]) - start, inverse_depth([0.0, 1.0]) - start];
        let homography = SourceView::new(&self.vantage, &other.vantage).homography(start, gradient);
        moments.clear();
        moments.resize(self.is_background.len(), Moments::default());
        let last = [them.width, them.height].map(|side| (side - 1) as f32);
        for (row, moments) in moments.chunks_exact_mut(me.width).enumerate() {
            let is_background = &self.is_background[row * me.width..];
            let gray = &self.vantage.gray[row * me.width..];
            for (column, moments) in moments.iter_mut().enumerate().filter(|&(column, _)| is_background[column]) {
                let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
                let [u, v, depth] = homography.map(|row| row[0] * x + row[1] * y + row[2]);
                let (u, v) = (u / depth - 0.5, v / depth - 0.5);
                let is_before = depth > 0.0 && start + gradient[0] * x + gradient[1] * y > 0.0;
                if !(is_before && u >= 0.0 && v >= 0.0 && u < last[0] && v < last[1]) {
                    continue;
                }
                let (left, top) = (u as usize, v as usize);
                let at = top * them.width + left;
                // The neighbours of such a pixel are background as well.
                if !other.is_background[at] {
                    continue;
                }
                let [a, b] = [0, 1].map(|right| other.vantage.gray[at + right]);
                let [c, d] = [0, 1].map(|right| other.vantage.gray[at + them.width + right]);
                let (right, down) = (u - left as f32, v - top as f32);
                let (above, below) = (a + right * (b - a), c + right * (d - c));
                let (mine, theirs) = (gray[column], above + down * (below - above));
                *moments = [1.0, mine, theirs, mine * mine, theirs * theirs, mine * theirs, 0.0, 0.0];
            }
        }
    }
}

/// Number of pairs of grey levels, and the sums of which correlations consist. Eight, for vectors.
type Moments = [f32; 8];

/// Memory for the sums over windows.
#[derive(Default)]
struct Sums {
    /// `[H, W]`, of single pixels.
    moments: Vec<Moments>,
    /// `[H, W]`, of the columns through windows' middles.
    columns: Vec<Moments>,
}

/// Correlations of the windows around all pixels.
///
/// - `found`: `[H, W]`, adds to each pixel the correlation of its window, and one; nothing to pixels without texture
#[multiversion(targets("x86_64+avx2"))]
fn correlate(sums: &mut Sums, width: usize, found: &mut [[f32; 2]]) {
    let Sums { moments, columns } = sums;
    let height = moments.len() / width;
    let span = |at: usize, size: usize| at.saturating_sub(HALF_WINDOW)..(at + HALF_WINDOW + 1).min(size);
    columns.clear();
    for y in 0..height {
        let start = columns.len();
        columns.resize(start + width, Moments::default());
        for row in span(y, height) {
            for (sum, moments) in columns[start..].iter_mut().zip(&moments[row * width..(row + 1) * width]) {
                add(sum, moments);
            }
        }
    }
    let least = MIN_SHOWN * ((2 * HALF_WINDOW + 1) * (2 * HALF_WINDOW + 1)) as f32;
    for (columns, found) in columns.chunks_exact(width).zip(found.chunks_exact_mut(width)) {
        for (x, found) in found.iter_mut().enumerate() {
            let mut sum = Moments::default();
            columns[span(x, width)].iter().for_each(|column| add(&mut sum, column));
            let [count, mine, theirs, mine2, theirs2, both, ..] = sum;
            if count < least {
                continue;
            }
            let (mean, their_mean) = (mine / count, theirs / count);
            let variance = mine2 / count - mean * mean;
            let their_variance = theirs2 / count - their_mean * their_mean;
            if variance > NOISE_VARIANCE && their_variance > NOISE_VARIANCE {
                let product = (variance + NOISE_VARIANCE) * (their_variance + NOISE_VARIANCE);
                found[0] += (both / count - mean * their_mean) / product.sqrt();
                found[1] += 1.0;
            }
        }
    }
}

#[inline(always)]
fn add(sum: &mut Moments, other: &Moments) {
    sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
}

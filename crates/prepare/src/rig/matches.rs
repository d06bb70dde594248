//! Matches places between the images of several cameras whose poses are roughly known.
//!
//! A corner of one camera is compared with the corners of another near its epipolar line. Each such pair is a place in
//! the scene. If a small plane is there, camera poses and the plane's direction predict the patch around the corner in
//! the other camera, however differently the two look at it. Several directions are tried. The best patch is then
//! shifted to where it fits best, also away from the epipolar line; bundle adjustment uses this shift.

use rayon::prelude::*;
use tcgs_core::{add_scaled, cross, distance, dot, length, sub};

use super::bundle::{Track, triangulate};
use super::camera::RigCamera;
use super::corners::{Corner, Pyramid};
use super::patch::{NUM_MIDDLE, Patch, Plane, shifted};

/// Correlation above which two patches show one place; then correlation above which a candidate is refined.
const MIN_CORRELATION: f32 = 0.8;
const PROMISING: f32 = 0.45;
/// Minimum correlations for trying further planes: of the plane that faces both cameras, then of the best one near it.
const UNLIKE: [f32; 2] = [-0.1, 0.2];
/// Ratio test: the best match's distance from a perfect correlation is at most this share of the second best's.
/// Repeated patterns therefore match nothing.
const MAX_RATIO: f32 = 0.75;
/// Smallest angle between two rays that gives depth, and largest angle at which patches still look alike; radians.
const MIN_ANGLE: f64 = 0.01;
const MAX_ANGLE: f64 = 1.9;
/// Largest distance between two corners that find each other, pixels of their levels.
const MUTUAL: f64 = 3.0;
/// Number of other cameras that each camera is compared with, nearest in place and direction.
const NUM_NEIGHBOURS: usize = 4;
/// Maximum number of candidates that are refined.
const MAX_REFINED: usize = 3;
/// Maximum number of candidates near the epipolar line that are compared.
const MAX_CANDIDATES: usize = 60;

/// One camera's picture at one moment.
#[derive(Clone, Debug)]
pub(super) struct Shot {
    pub pyramid: Pyramid,
    pub corners: Vec<Corner>,
}

impl Shot {
    pub fn new(image: &image::RgbImage) -> Self {
        let pyramid = Pyramid::new(image);
        let corners = pyramid.corners();
        Self { pyramid, corners }
    }
}

/// Finds tracks among the images of one moment.
///
/// - `band`: largest distance of a corner from its epipolar line, share of the longer side
/// - returns: tracks in the order of cameras and corners
pub(super) fn find(cameras: &[RigCamera], shots: &[Shot], band: f64) -> Vec<Track> {
    let rays: Vec<Vec<[f64; 3]>> = cameras
        .iter()
        .zip(shots)
        .map(|(camera, shot)| shot.corners.iter().map(|c| camera.ray(c.pixel)).collect())
        .collect();
    let mut pairs: Vec<(usize, usize)> = (0..cameras.len())
        .flat_map(|a| neighbours(cameras, a).into_iter().flat_map(move |b| [(a, b), (b, a)]))
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    let matched: Vec<Vec<(usize, [f64; 2])>> =
        pairs.par_iter().map(|&(a, b)| of_pair(cameras, shots, &rays, (a, b), band)).collect();
    let mut tracks = Vec::new();
    for a in 0..cameras.len() {
        let mut seen: Vec<Vec<(usize, [f64; 2])>> = shots[a].corners.iter().map(|c| vec![(a, c.pixel)]).collect();
        for (&(_, b), found) in pairs.iter().zip(&matched).filter(|((from, _), _)| *from == a) {
            let back = pairs.iter().position(|&pair| pair == (b, a)).map(|i| matched[i].as_slice()).unwrap_or_default();
            for &(corner, pixel) in
                found.iter().filter(|(corner, pixel)| is_mutual((shots, a, b), *corner, *pixel, back))
            {
                seen[corner].push((b, pixel));
            }
        }
        for seen in seen.into_iter().filter(|seen| seen.len() >= 2) {
            if let Some(point) = triangulate(cameras, &seen) {
                tracks.push(Track { point, seen });
            }
        }
    }
    tracks
}

/// Cross-check: whether a corner of `b` near the match of a corner of `a` matches that corner, too.
///
/// - `back`: corners of `b`, and their places in the image of `a`
fn is_mutual(
    (shots, a, b): (&[Shot], usize, usize),
    corner: usize,
    pixel: [f64; 2],
    back: &[(usize, [f64; 2])],
) -> bool {
    let from = shots[a].corners[corner];
    let reach = |shot: &Shot, corner: &Corner| MUTUAL * shot.pyramid.unit_of(corner.level);
    back.iter().any(|&(other, place)| {
        let to = shots[b].corners[other];
        apart_px(to.pixel, pixel) < reach(&shots[b], &to) && apart_px(place, from.pixel) < reach(&shots[a], &from)
    })
}

/// The cameras with the most similar views: near in direction and place.
fn neighbours(cameras: &[RigCamera], a: usize) -> Vec<usize> {
    let size = super::bundle::rig_size(cameras);
    let apart = |b: usize| {
        let turned = dot(cameras[a].forward(), cameras[b].forward()).clamp(-1.0, 1.0).acos();
        turned + 0.3 * distance(cameras[a].center(), cameras[b].center()) / size
    };
    let mut others: Vec<usize> = (0..cameras.len()).filter(|&b| b != a).collect();
    others.sort_by(|&b, &c| apart(b).total_cmp(&apart(c)));
    others.truncate(NUM_NEIGHBOURS);
    others
}

/// - returns: corners of `a`, and their places in the image of `b`
fn of_pair(
    cameras: &[RigCamera],
    shots: &[Shot],
    rays: &[Vec<[f64; 3]>],
    (a, b): (usize, usize),
    band: f64,
) -> Vec<(usize, [f64; 2])> {
    let (from, to) = (&cameras[a], &cameras[b]);
    let baseline = sub(to.center(), from.center());
    let band = band * to.lens.width.max(to.lens.height) as f64 / to.lens.focal[0];
    let mut best_of: Vec<Option<Found>> = Vec::new();
    for (corner, ray) in shots[a].corners.iter().zip(&rays[a]) {
        let normal = cross(*ray, baseline);
        let length = length(normal);
        if length < 1e-12 {
            best_of.push(None);
            continue;
        }
        let normal = normal.map(|x| x / length);
        let mut near: Vec<(f64, usize, [f64; 3])> = Vec::new();
        for (i, other) in rays[b].iter().enumerate() {
            let off = dot(*other, normal).abs();
            if off < band
                && let Some(point) = meeting(from.center(), *ray, to.center(), *other)
            {
                near.push((off, i, point));
            }
        }
        near.sort_by(|x, y| x.0.total_cmp(&y.0));
        near.truncate(MAX_CANDIDATES);
        let patch = Patch::new(from, &shots[a].pyramid, corner);
        best_of.push(patch.and_then(|patch| best_match((from, to), &patch, &shots[b], &near)));
    }
    // Several corners may find the same place: the best one keeps it.
    let mut found: Vec<(usize, Found)> =
        best_of.into_iter().enumerate().filter_map(|(corner, best)| best.map(|best| (corner, best))).collect();
    found.sort_by(|x, y| y.1.correlation.total_cmp(&x.1.correlation));
    let mut taken: Vec<[f64; 2]> = Vec::new();
    found.retain(|(corner, best)| {
        let unit = shots[a].pyramid.unit_of(shots[a].corners[*corner].level);
        let is_free = taken.iter().all(|other| apart_px(*other, best.pixel) > 1.5 * unit);
        if is_free {
            taken.push(best.pixel);
        }
        is_free
    });
    found.sort_by_key(|(corner, _)| *corner);
    found.into_iter().map(|(corner, best)| (corner, best.pixel)).collect()
}

fn apart_px(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The point on one ray that is nearest to another ray, if it lies before both cameras and the rays are not nearly
/// parallel.
fn meeting(a: [f64; 3], ray_a: [f64; 3], b: [f64; 3], ray_b: [f64; 3]) -> Option<[f64; 3]> {
    let along = dot(ray_a, ray_b);
    let angle = along.clamp(-1.0, 1.0).acos();
    if !(MIN_ANGLE..MAX_ANGLE).contains(&angle) {
        return None;
    }
    let between = sub(b, a);
    let (p, q) = (dot(between, ray_a), dot(between, ray_b));
    let share = 1.0 - along * along;
    let (s, t) = ((p - along * q) / share, (along * p - q) / share);
    (s > 0.0 && t > 0.0).then(|| add_scaled(a, s, ray_a))
}

struct Found {
    correlation: f32,
    /// Pixels of the other camera's image.
    pixel: [f64; 2],
}

/// The candidate that matches the patch, if only one does.
fn best_match(
    (from, to): (&RigCamera, &RigCamera),
    patch: &Patch,
    shot: &Shot,
    near: &[(f64, usize, [f64; 3])],
) -> Option<Found> {
    let mut ranked: Vec<(f32, usize, Plane)> = Vec::new();
    for (index, &(_, other, point)) in near.iter().enumerate() {
        let target = shot.corners[other].pixel;
        let judge = |plane: &Plane| patch.likeness(&plane.place((from, to), patch, &shot.pyramid, target)?, [0.0; 2]);
        let mut best: Option<(f32, Plane)> = None;
        for (i, plane) in Plane::directions(from, to, point).enumerate() {
            // A patch that is not alike at all in the middle directions is not alike in the others.
            let least = match i {
                1 => UNLIKE[0],
                NUM_MIDDLE => UNLIKE[1],
                _ => f32::NEG_INFINITY,
            };
            if i > 0 && best.is_none_or(|(correlation, _)| correlation < least) {
                break;
            }
            if let Some(correlation) = judge(&plane)
                && best.is_none_or(|(most, _)| most < correlation)
            {
                best = Some((correlation, plane));
            }
        }
        if let Some((correlation, plane)) = best.filter(|(c, _)| *c > PROMISING) {
            ranked.push((correlation, index, plane));
        }
    }
    ranked.sort_by(|x, y| y.0.total_cmp(&x.0));
    ranked.truncate(MAX_REFINED);
    let mut refined: Vec<Found> = Vec::new();
    for (_, index, plane) in ranked {
        let target = shot.corners[near[index].1].pixel;
        if let Some(found) = refine((from, to), patch, shot, target, plane) {
            refined.push(found);
        }
    }
    refined.sort_by(|x, y| y.correlation.total_cmp(&x.correlation));
    let best = refined.first()?;
    let second = refined.iter().find(|other| apart_px(other.pixel, best.pixel) > 4.0 * patch.unit);
    let is_alone = second.is_none_or(|second| 1.0 - best.correlation < MAX_RATIO * (1.0 - second.correlation));
    (best.correlation > MIN_CORRELATION && is_alone).then(|| refined.swap_remove(0))
}

/// Alternately tilts the plane and shifts the patch, until it fits best.
fn refine(
    pair: (&RigCamera, &RigCamera),
    patch: &Patch,
    shot: &Shot,
    target: [f64; 2],
    mut plane: Plane,
) -> Option<Found> {
    let mut place = plane.place(pair, patch, &shot.pyramid, target)?;
    let (mut shift, mut best) = shifted(patch, &place, [0.0; 2])?;
    for tilt in [0.2, 0.1] {
        if best < PROMISING {
            return None;
        }
        let mut turned = (patch.likeness(&place, shift)?, plane);
        for (i, j) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)] {
            let other = plane.tilted(tilt * f64::from(i), tilt * f64::from(j));
            let place = other.place(pair, patch, &shot.pyramid, target);
            let likeness = place.and_then(|place| patch.likeness(&place, shift));
            if let Some(likeness) = likeness.filter(|likeness| *likeness > turned.0) {
                turned = (likeness, other);
            }
        }
        let other = turned.1.place(pair, patch, &shot.pyramid, target)?;
        if let Some((found, correlation)) = shifted(patch, &other, shift).filter(|found| found.1 > best) {
            (shift, best, plane, place) = (found, correlation, turned.1, other);
        }
    }
    let pixel = [0, 1].map(|i| f64::from(place.middle[i] + shift[i]) * place.unit);
    // A larger shift would be another corner.
    (apart_px(pixel, target) < 3.0 * place.unit).then_some(Found { correlation: best, pixel })
}

//! Places of birth: points on which several views agree, among the pixels that the scene does not explain.
//!
//! A plane sweep (Collins 1996) with evidence. The ray of an unexplained pixel is walked from near to far. A depth
//! counts as far as other views see the same colour there and do not explain it either. A view that explains its pixel
//! at that place votes against anything new there. A surface without texture is thus found on the visual hull of the
//! unexplained pixels.

use std::collections::BTreeMap;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use tcgs_core::{Image, Pinhole, View, upper_median};

use crate::gate::Blocks;

/// Number of depths tested on a ray, evenly spaced in their inverse.
const DEPTHS: usize = 128;
/// Mean absolute difference of two views' colours up to which they may show the same point.
const SAME_COLOR: f32 = 0.08;
/// Number of views, besides a ray's own, that must agree on a depth.
const MIN_AGREEING: usize = 2;
/// Largest distance to a seed of another view, in distances between rays.
const SUPPORT: f32 = 2.0;
/// Share of the scene's points that may lie beyond the tested depths, at either end.
const BEYOND: f64 = 0.005;

/// A place at which a Gaussian is born.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seed {
    /// Scene units.
    pub position: [f32; 3],
    /// In `[0, 1]`.
    pub color: [f32; 3],
    /// Distance between the rays of neighbouring pixels there, scene units.
    pub spacing: f32,
    pub foreground: bool,
}

/// A view with the blocks that the scene does not explain.
struct Sight<'a> {
    view: &'a View,
    pinhole: Pinhole<f32>,
    unexplained: &'a Blocks,
}

/// Finds the places at which Gaussians are born.
///
/// - `views`: one per camera
/// - `unexplained`: `[views]`
/// - `means`: `[N, 3]` of the scene, for its range of depths
/// - `most`: approximate maximum number of places
pub(super) fn seeds(views: &[View], unexplained: &[Blocks], means: &[[f32; 3]], most: usize) -> Vec<Seed> {
    let sight = |(view, unexplained)| Sight { view, pinhole: Pinhole::new(&view.camera), unexplained };
    let sights: Vec<Sight<'_>> = views.iter().zip(unexplained).map(sight).collect();
    let found: Vec<Vec<Seed>> = (0..sights.len()).into_par_iter().map(|of| found_by(&sights, of, means)).collect();
    thinned(supported(&found), most)
}

/// The seeds that other views' rays support with a seed within [`SUPPORT`] times their spacing.
///
/// - `found`: `[views]`
fn supported(found: &[Vec<Seed>]) -> Vec<Seed> {
    let seeds = found.concat();
    let view_of: Vec<usize> =
        found.iter().enumerate().flat_map(|(view, seeds)| std::iter::repeat_n(view, seeds.len())).collect();
    let positions: Vec<[f32; 3]> = seeds.iter().map(|seed| seed.position).collect();
    if positions.is_empty() {
        return seeds;
    }
    let tree = ImmutableKdTree::new_from_slice(&positions).expect("finite points make a tree");
    let is_supported = |seed: &&Seed| {
        let reach = (SUPPORT * seed.spacing).powi(2);
        let near = tree.query(&seed.position).within::<SquaredEuclidean<f32>>(reach).execute();
        let mut views: Vec<usize> = near.iter().map(|found| view_of[found.item as usize]).collect();
        views.sort_unstable();
        views.dedup();
        views.len() > MIN_AGREEING
    };
    seeds.par_iter().filter(is_supported).copied().collect()
}

fn found_by(sights: &[Sight<'_>], of: usize, means: &[[f32; 3]]) -> Vec<Seed> {
    let me = &sights[of];
    if me.unexplained.is_marked.iter().all(|marked| !marked) {
        return Vec::new();
    }
    let Some([near, far]) = range(&me.pinhole, means) else { return Vec::new() };
    let (width, height) = (me.pinhole.width, me.pinhole.height);
    let mut seeds = Vec::new();
    for y in 0..height {
        for x in (0..width).filter(|&x| me.unexplained.at(x, y)) {
            let color = mean_color(&me.view.image, x, y);
            let place = [x as f32, y as f32];
            let depth = |i: usize| {
                let share = i as f32 / (DEPTHS - 1) as f32;
                1.0 / (1.0 / near + (1.0 / far - 1.0 / near) * share)
            };
            // Among equally good depths the nearest wins: the hull's surface.
            let mut best: Option<(f32, f32)> = None;
            for depth in (0..DEPTHS).map(depth) {
                let to_beat = best.map_or(f32::NEG_INFINITY, |(highest, _)| highest);
                if let Some(score) = score(sights, of, me.pinhole.unproject(place, depth), color, to_beat) {
                    best = Some((score, depth));
                }
            }
            if let Some((_, depth)) = best {
                let segmentation = me.view.segmentation.as_ref();
                seeds.push(Seed {
                    position: me.pinhole.unproject(place, depth),
                    color,
                    spacing: depth / me.pinhole.focal[0],
                    foreground: segmentation.is_none_or(|s| s.foreground[y * width + x]),
                });
            }
        }
    }
    seeds
}

/// Score of the other views' agreement that a point of this colour is new.
///
/// - `to_beat`: a score
/// - returns: none if the views disagree, or if the score is not above `to_beat`
fn score(sights: &[Sight<'_>], of: usize, point: [f32; 3], color: [f32; 3], to_beat: f32) -> Option<f32> {
    let (mut agreeing, mut against, mut difference) = (0, 0, 0.0);
    let is_won = |agreeing: usize, against: usize, difference: f32| {
        let is_agreed = agreeing >= MIN_AGREEING && 2 * against <= agreeing;
        Some(agreeing as f32 - against as f32 - difference).filter(|score| is_agreed && *score > to_beat)
    };
    for (i, other) in sights.iter().enumerate().filter(|(i, _)| *i != of) {
        // Not even if all views that are left agree.
        let left = sights.len() - i - usize::from(i < of);
        is_won(agreeing + left, against, difference)?;
        let Some((pixel, _)) = other.pinhole.pixel(point) else { continue };
        let [x, y] = [pixel % other.pinhole.width, pixel / other.pinhole.width];
        if !other.unexplained.at(x, y) {
            against += 1;
            continue;
        }
        let there = mean_color(&other.view.image, x, y);
        let distance = (0..3).map(|c| (there[c] - color[c]).abs()).sum::<f32>() / 3.0;
        // Another colour may be the other side of the same object.
        if distance < SAME_COLOR {
            agreeing += 1;
            difference += distance / SAME_COLOR;
        }
    }
    is_won(agreeing, against, difference)
}

/// The nearest and the farthest depth of the scene in a view; none if the view sees no part of it.
fn range(pinhole: &Pinhole<f32>, means: &[[f32; 3]]) -> Option<[f32; 2]> {
    let mut depths: Vec<f32> = means.iter().filter_map(|&mean| Some(pinhole.pixel(mean)?.1)).collect();
    depths.sort_by(f32::total_cmp);
    let beyond = (depths.len() as f64 * BEYOND) as usize;
    let (near, far) = (*depths.get(beyond)?, *depths.get(depths.len() - 1 - beyond)?);
    Some([0.5 * near, 1.2 * far])
}

/// The mean of a pixel and of its neighbours to the left and above, if any: the colour of a ray through their corner.
fn mean_color(image: &Image, x: usize, y: usize) -> [f32; 3] {
    let (left, above) = (x.saturating_sub(1), y.saturating_sub(1));
    std::array::from_fn(|channel| {
        let plane = image.plane(channel);
        let at = |x: usize, y: usize| plane[y * image.width + x];
        (at(x, y) + at(left, y) + at(x, above) + at(left, above)) / 4.0
    })
}

/// One seed per cell of a grid. The finest grid has cells as wide as the distance between rays; coarser ones follow
/// until the seeds are few enough.
///
/// - `most`: at least 1
fn thinned(seeds: Vec<Seed>, most: usize) -> Vec<Seed> {
    let Some(mut edge) = upper_median(seeds.iter().map(|seed| seed.spacing)) else { return seeds };
    // Starting at their corner: a grid as wide as the seeds has a single cell.
    let corner: [f32; 3] =
        std::array::from_fn(|i| seeds.iter().map(|seed| seed.position[i]).fold(f32::INFINITY, f32::min));
    loop {
        let mut cells: BTreeMap<[u64; 3], Vec<&Seed>> = BTreeMap::new();
        for seed in &seeds {
            let cell = std::array::from_fn(|i| ((seed.position[i] - corner[i]) / edge) as u64);
            cells.entry(cell).or_default().push(seed);
        }
        if cells.len() <= most {
            return cells.values().map(|cell| merged(cell, edge)).collect();
        }
        edge *= 1.3;
    }
}

fn merged(cell: &[&Seed], edge: f32) -> Seed {
    let mean = |of: &dyn Fn(&Seed) -> [f32; 3]| -> [f32; 3] {
        std::array::from_fn(|i| cell.iter().map(|seed| of(seed)[i]).sum::<f32>() / cell.len() as f32)
    };
    let of_foreground = cell.iter().filter(|seed| seed.foreground).count();
    Seed {
        position: mean(&|seed| seed.position),
        color: mean(&|seed| seed.color),
        spacing: cell.iter().map(|seed| seed.spacing).fold(edge, f32::max),
        foreground: 2 * of_foreground >= cell.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_seeds_stay_wherever_they_lie() {
        let at = |i: usize| [i as f32 - 20.0, 0.5 - (i % 2) as f32, (i % 7) as f32 - 3.0];
        let seed = |i| Seed { position: at(i), color: [0.5; 3], spacing: 0.1, foreground: i < 10 };
        let seeds: Vec<Seed> = (0..40).map(seed).collect();
        assert_eq!(thinned(seeds.clone(), 40).len(), 40);
        for most in [1, 2, 7] {
            let few = thinned(seeds.clone(), most);
            assert!((1..=most).contains(&few.len()), "{} of at most {most}", few.len());
            // No larger than the seeds that they stand for.
            assert!(few.iter().all(|seed| seed.spacing < 60.0), "{few:?}");
        }
        assert!(!thinned(seeds, 1)[0].foreground);
    }
}

//! Corrects the starts of a timestep by matches between its images and those of the timestep before.
//!
//! A timestep starts with every Gaussian at constant velocity. If that start is off by more than a few of a Gaussian's
//! own widths, no gradient leads back: thrown and caught objects, or captures of few frames a second. Small groups of
//! active Gaussians therefore search for the place at which the new images show what the previous images showed at
//! their old place. The search is a coarse-to-fine block matching (Lucas and Kanade 1981). Its displacements are in
//! space, not in an image, so that all views decide together. A Gaussian that its start explains has no say. If no
//! other place explains the rest much better, the group is not moved.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use tcgs_core::{Camera, Image, Pinhole, add_scaled, dot, squared_distance, upper_median};

/// Pixels from the centre of a group to its border, at each resolution.
const RADIUS: f32 = 6.0;
/// Least length of the shorter side of an image, pixels.
const SMALLEST: usize = 20;
/// Most Gaussians of a group that are compared.
const MOST_SAMPLES: usize = 24;
/// Most views in which they are compared: those that show the most of them.
const MOST_VIEWS: usize = 8;
/// Share of these views that count, best fits first; the Gaussians may be hidden in the others.
const COUNTED: f32 = 0.67;
/// Least blending weight of a group in a view, pixels.
const MIN_WEIGHT: f32 = 0.1;
/// Limit at which differences of colours are clamped.
const MOST_DIFFERENCE: f32 = 0.2;
/// Difference of colours at and above which a Gaussian counts as fully unexplained.
const UNEXPLAINED: f32 = 0.1;
/// A group with a smaller unexplained share than this is not moved.
const MIN_UNEXPLAINED: f32 = 0.02;
/// A group is moved if its difference of colours is below this share of the one at the start.
const BETTER: f32 = 0.7;
/// A moved Gaussian's own difference of colours may grow by this much.
const TOLERANCE: f32 = 0.02;
/// Search range at the lowest resolution, pixels in each direction.
const RANGE: i32 = 4;
/// Number of steps, of at most a pixel each, at every resolution.
const STEPS: usize = 6;
/// Directions of these steps.
const DIRECTIONS: [[f32; 3]; 6] =
    [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];

/// A Gaussian that may be moved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mover {
    /// Centre at the timestep before, scene units.
    pub mean: [f32; 3],
    /// Displacement at constant velocity, scene units.
    pub velocity: [f32; 3],
    pub foreground: bool,
}

/// The search for corrections, over all movers and views.
pub(super) struct Matches<'a> {
    movers: &'a [Mover],
    /// `[views][N]`
    weights: &'a [Vec<f32>],
    /// `[views]`
    sights: Vec<Sight<'a>>,
}

impl<'a> Matches<'a> {
    /// - `movers`: `[N]`
    /// - `weights`: `[views][N]`, blending weights at the timestep before, pixels
    /// - `before`, `now`: `[views]` images of the two timesteps, `[3 or more, H, W]`
    pub fn new(
        movers: &'a [Mover],
        weights: &'a [Vec<f32>],
        cameras: &[&Camera],
        before: &[&'a Image],
        now: &[&'a Image],
    ) -> Self {
        let sights = (cameras, before, now).into_par_iter().map(|(camera, before, now)| Sight {
            pinhole: Pinhole::new(camera),
            before: pyramid(before),
            now: pyramid(now),
        });
        Self { movers, weights, sights: sights.collect() }
    }

    /// Corrections to the starts at constant velocity.
    ///
    /// - returns: `[N]`, scene units; 0 for Gaussians that are not moved
    pub fn corrections(&self) -> Vec<[f32; 3]> {
        let Some(pixel) = self.pixel_extent() else { return vec![[0.0; 3]; self.movers.len()] };
        let num_levels = self.sights.iter().map(|sight| sight.before.len()).min().unwrap_or(0);
        let mut groups = Groups::default();
        for level in (0..num_levels).rev() {
            let extent = pixel * (1 << level) as f32;
            let mut finer = self.grouped(RADIUS * extent);
            let range = if level + 1 == num_levels { RANGE } else { 0 };
            finer.par_iter_mut().for_each(|group| {
                let hints = groups.around(group.center, group.foreground, 4).map(|(coarser, _)| coarser.displacement);
                let comparison = self.compared(&group.samples, level).of_unexplained();
                comparison.search(group, hints, extent, range);
            });
            groups = Groups::new(finer);
        }
        let radius = RADIUS * pixel;
        (0..self.movers.len()).into_par_iter().map(|i| self.correction(i, &groups, radius)).collect()
    }

    /// The mean correction of the groups around a Gaussian; 0 if that would make the Gaussian's own match worse.
    ///
    /// - `radius`: radius of the groups
    fn correction(&self, i: usize, groups: &Groups, radius: f32) -> [f32; 3] {
        let mover = &self.movers[i];
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for (group, distance) in groups.around(mover.mean, mover.foreground, 8) {
            let distance = distance / (radius * radius);
            let weight = if distance < 4.0 { (-distance).exp() } else { 0.0 };
            weights += weight;
            if group.is_off {
                (0..3).for_each(|a| sum[a] += weight * (group.displacement[a] - mover.velocity[a]));
            }
        }
        if sum == [0.0; 3] {
            return sum;
        }
        let correction = sum.map(|x| x / weights);
        let own = self.compared(&[i], 0);
        let there = own.difference(Some(std::array::from_fn(|a| mover.velocity[a] + correction[a])));
        let is_worse = !own.views.is_empty() && there > own.difference(None) + TOLERANCE;
        if is_worse { [0.0; 3] } else { correction }
    }

    /// Extent of a pixel at the Gaussians, scene units: the median over some of them and all views.
    fn pixel_extent(&self) -> Option<f32> {
        let some = self.movers.iter().step_by((self.movers.len() / 100).max(1));
        let extent = |pinhole: &Pinhole<f32>, point| Some(pinhole.project(point)?.1 / pinhole.focal[0]);
        upper_median(some.flat_map(|mover| self.sights.iter().filter_map(|sight| extent(&sight.pinhole, mover.mean))))
    }

    /// Groups of Gaussians: one around each cell of a grid that holds a visible one.
    fn grouped(&self, radius: f32) -> Vec<Group> {
        let mut cells: BTreeMap<(bool, [i32; 3]), Vec<usize>> = BTreeMap::new();
        for (i, mover) in self.movers.iter().enumerate() {
            if self.weights.iter().any(|weights| weights[i] > MIN_WEIGHT) {
                let cell = mover.mean.map(|x| (x / radius).floor() as i32);
                cells.entry((mover.foreground, cell)).or_default().push(i);
            }
        }
        let mean = |members: &[usize], of: &dyn Fn(&Mover) -> [f32; 3]| -> [f32; 3] {
            let sum = |a: usize| members.iter().map(|&i| of(&self.movers[i])[a]).sum::<f32>();
            std::array::from_fn(|a| sum(a) / members.len() as f32)
        };
        let group = |(&(foreground, cell), members): (&(bool, [i32; 3]), &Vec<usize>)| {
            let center = mean(members, &|mover| mover.mean);
            let mut near = Vec::new();
            for offset in 0..27 {
                let at = std::array::from_fn(|a| cell[a].saturating_add(offset / [1, 3, 9][a] % 3 - 1));
                let others = cells.get(&(foreground, at)).into_iter().flatten().copied();
                near.extend(others.filter(|&i| squared_distance(self.movers[i].mean, center) < radius * radius));
            }
            let every = near.len().div_ceil(MOST_SAMPLES).max(1);
            let samples: Vec<usize> = near.into_iter().step_by(every).collect();
            let velocity = mean(if samples.is_empty() { members } else { &samples }, &|mover| mover.velocity);
            Group { center, foreground, samples, velocity, displacement: velocity, is_off: false }
        };
        cells.par_iter().map(group).collect()
    }

    /// - `of`: indices of Gaussians
    /// - `level`: number of times that the images are halved
    fn compared(&self, of: &[usize], level: usize) -> Comparison<'_> {
        let mut seen: Vec<(f32, usize)> = (self.weights.iter().enumerate())
            .map(|(view, weights)| (of.iter().map(|&i| weights[i]).sum(), view))
            .filter(|(weight, _)| *weight > MIN_WEIGHT)
            .collect();
        seen.sort_by(|a, b| b.0.total_cmp(&a.0));
        seen.truncate(MOST_VIEWS);
        let view = |(_, view): (f32, usize)| {
            let sight = &self.sights[view];
            let sample = |&i: &usize| {
                let (mover, weight) = (&self.movers[i], self.weights[view][i]);
                let point = sight.pinhole.camera_point(mover.mean);
                let start = sight.pinhole.camera_point(std::array::from_fn(|a| mover.mean[a] + mover.velocity[a]));
                let color = color_at(&sight.before[level], sight.place(point)?, level)?;
                let now = color_at(&sight.now[level], sight.place(start)?, level)?;
                (weight > 0.0).then(|| Sample { point, weight, color, at_start: difference(color, now) })
            };
            (sight, of.iter().filter_map(sample).collect())
        };
        Comparison { level, views: seen.into_iter().map(view).collect() }
    }
}

/// Images of a camera at both timesteps, at full resolution and at halves of it.
struct Sight<'a> {
    pinhole: Pinhole<f32>,
    before: Vec<Cow<'a, Image>>,
    now: Vec<Cow<'a, Image>>,
}

impl Sight<'_> {
    /// Projects a point in camera space to pixels at full resolution; none if it is not before the camera.
    fn place(&self, [x, y, z]: [f32; 3]) -> Option<[f32; 2]> {
        let Pinhole { focal, principal, .. } = &self.pinhole;
        (z > 0.0).then(|| [focal[0] * x / z + principal[0], focal[1] * y / z + principal[1]])
    }
}

/// An image at full resolution and at halves of it; the halves have colours alone.
fn pyramid(image: &Image) -> Vec<Cow<'_, Image>> {
    let mut levels = vec![Cow::Borrowed(image)];
    while let Some(last) = levels.last().filter(|last| last.width.min(last.height) >= 2 * SMALLEST) {
        let data = last.data[..3 * last.num_pixels()].to_vec();
        let colors = Image { width: last.width, height: last.height, num_channels: 3, data };
        levels.push(Cow::Owned(colors.downscaled(2)));
    }
    levels
}

/// The colour of an image at a position between pixels; none outside the image.
///
/// - `place`: pixels at full resolution
/// - `level`: number of times that the image was halved
fn color_at(image: &Image, place: [f32; 2], level: usize) -> Option<[f32; 3]> {
    let (width, height) = (image.width, image.height);
    let scale = 1.0 / (1 << level) as f32;
    let [x, y] = place.map(|at| at * scale);
    // NaN compares false.
    let is_inside = x >= 0.0 && y >= 0.0 && x <= width as f32 && y <= height as f32;
    if !is_inside || width.min(height) < 2 {
        return None;
    }
    let (x, y) = ((x - 0.5).clamp(0.0, (width - 1) as f32), (y - 0.5).clamp(0.0, (height - 1) as f32));
    let (column, row) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
    let (u, v) = (x - column as f32, y - row as f32);
    Some(std::array::from_fn(|channel| {
        let upper = &image.plane(channel)[row * width + column..];
        let lower = &upper[width..];
        (upper[0] * (1.0 - u) + upper[1] * u) * (1.0 - v) + (lower[0] * (1.0 - u) + lower[1] * u) * v
    }))
}

/// Gaussians near each other, with their common displacement.
struct Group {
    center: [f32; 3],
    foreground: bool,
    /// Indices of the Gaussians that are compared.
    samples: Vec<usize>,
    /// Mean displacement at constant velocity.
    velocity: [f32; 3],
    displacement: [f32; 3],
    /// Whether the start is so much worse that the group is moved.
    is_off: bool,
}

/// The samples of some Gaussians that are compared: for some views, those that each view shows.
struct Comparison<'a> {
    level: usize,
    views: Vec<(&'a Sight<'a>, Vec<Sample>)>,
}

struct Sample {
    /// Position at the timestep before, in camera space.
    point: [f32; 3],
    weight: f32,
    /// Colour in the image of the timestep before.
    color: [f32; 3],
    /// Difference of colours at the start.
    at_start: f32,
}

impl Comparison<'_> {
    /// Weighs Gaussians by how badly their starts explain them; leaves no views if the starts explain nearly all.
    fn of_unexplained(mut self) -> Self {
        let (mut whole, mut unexplained) = (0.0, 0.0);
        for sample in self.views.iter_mut().flat_map(|(_, samples)| samples) {
            whole += sample.weight;
            sample.weight *= (sample.at_start / UNEXPLAINED).min(1.0).powi(2);
            unexplained += sample.weight;
        }
        if unexplained < MIN_UNEXPLAINED * whole {
            self.views.clear();
        }
        self
    }

    /// Mean difference of colours in the best-fitting views.
    ///
    /// - `displacement`: displacement of all samples; none leaves each at its start
    fn difference(&self, displacement: Option<[f32; 3]>) -> f32 {
        let of_view = |(sight, samples): &(&Sight, Vec<Sample>)| {
            let way: Option<[f32; 3]> = displacement.map(|by| sight.pinhole.rotation.map(|row| dot(row, by)));
            let of_sample = |sample: &Sample| {
                let Some(way) = way else { return Some(sample.at_start) };
                let place = sight.place(std::array::from_fn(|a| sample.point[a] + way[a]))?;
                Some(difference(color_at(&sight.now[self.level], place, self.level)?, sample.color))
            };
            let (mut sum, mut weights) = (0.0, 0.0);
            for (difference, weight) in samples.iter().filter_map(|sample| Some((of_sample(sample)?, sample.weight))) {
                sum += weight * difference.min(MOST_DIFFERENCE);
                weights += weight;
            }
            if weights > 0.0 { sum / weights } else { MOST_DIFFERENCE }
        };
        let mut of_views = [MOST_DIFFERENCE; MOST_VIEWS];
        of_views.iter_mut().zip(&self.views).for_each(|(difference, view)| *difference = of_view(view));
        let of_views = &mut of_views[..self.views.len()];
        of_views.sort_by(f32::total_cmp);
        let counted = &of_views[..(of_views.len() as f32 * COUNTED).ceil() as usize];
        counted.iter().sum::<f32>() / counted.len() as f32
    }

    /// Finds the displacement of a group.
    ///
    /// - `hints`: displacements of coarser groups
    /// - `extent`: extent of a pixel at this resolution, scene units
    /// - `range`: search range around the start, pixels
    fn search(&self, group: &mut Group, hints: impl Iterator<Item = [f32; 3]>, extent: f32, range: i32) {
        if self.views.len() < 2 {
            return;
        }
        let at_start = self.difference(None);
        let mut best = (at_start, group.velocity);
        let mut compare = |displacement: [f32; 3]| {
            let difference = self.difference(Some(displacement));
            if difference < best.0 {
                best = (difference, displacement);
            }
            best.1
        };
        // The first candidate: the group has stopped.
        let mut at = compare([0.0; 3]);
        for hint in hints {
            at = compare(hint);
        }
        let side = 2 * range + 1;
        for i in 0..side.pow(3) {
            let way = |a: usize| extent * (i / side.pow(a as u32) % side - range) as f32;
            at = compare(std::array::from_fn(|a| group.velocity[a] + way(a)));
        }
        let mut step = extent;
        for _ in 0..STEPS {
            let from = at;
            for direction in DIRECTIONS {
                at = compare(add_scaled(from, step, direction));
            }
            if at == from {
                step *= 0.5;
            }
        }
        group.displacement = at;
        group.is_off = best.0 < BETTER * at_start;
    }
}

/// Mean absolute difference of two colours.
fn difference(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f32>() / 3.0
}

/// Groups by position, foreground and background apart.
#[derive(Default)]
struct Groups {
    all: Vec<Group>,
    /// The background's tree, then the foreground's: the centres, and the indices of the groups.
    trees: [Option<(ImmutableKdTree<f32, 3>, Vec<usize>)>; 2],
}

impl Groups {
    fn new(all: Vec<Group>) -> Self {
        let trees = [false, true].map(|foreground| {
            let indices: Vec<usize> = (0..all.len()).filter(|&i| all[i].foreground == foreground).collect();
            let centers: Vec<[f32; 3]> = indices.iter().map(|&i| all[i].center).collect();
            let tree = || ImmutableKdTree::new_from_slice(&centers).expect("finite points make a tree");
            (!centers.is_empty()).then(|| (tree(), indices))
        });
        Self { all, trees }
    }

    /// The nearest groups, with squared distances.
    fn around(&self, point: [f32; 3], foreground: bool, count: usize) -> impl Iterator<Item = (&Group, f32)> {
        let nearest = |(tree, indices): &(ImmutableKdTree<f32, 3>, Vec<usize>)| -> Vec<(usize, f32)> {
            let count = NonZero::new(count.min(indices.len())).expect("a tree has a point");
            let found = tree.query(&point).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            found.iter().map(|found| (indices[found.item as usize], found.distance)).collect()
        };
        let found = self.trees[usize::from(foreground)].as_ref().map(nearest).unwrap_or_default();
        found.into_iter().map(|(i, distance)| (&self.all[i], distance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall with blots of many colours, and before it a board with other blots.
    fn color([x, y]: [f32; 2], board: [f32; 2]) -> [f32; 3] {
        let [u, v] = [x - board[0], y - board[1]];
        let (u, v, which) = if u.abs().max(v.abs()) < 0.3 { (u, v, 1) } else { (x, y, 2) };
        let (u, v) = (u / 0.08 + 100.0, v / 0.08 + 100.0);
        let (i, j) = (u as u64, v as u64);
        std::array::from_fn(|c| {
            let at = |i: u64, j: u64| {
                let hash = (i * 7919 + j * 104_729 + which * 1_299_709 + c as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
                (hash >> 40) as f32 / (1_u64 << 24) as f32
            };
            let across = |j: u64| at(i, j) + (at(i + 1, j) - at(i, j)) * u.fract();
            across(j) + (across(j + 1) - across(j)) * v.fract()
        })
    }

    fn image(camera: &Camera, board: [f32; 2]) -> Image {
        let pinhole = Pinhole::<f32>::new(camera);
        let mut image = Image::filled(camera.width, camera.height, 5, 0.0);
        for pixel in 0..image.num_pixels() {
            let ray = pinhole.ray(pinhole.pixel_center(pixel));
            let depth = -pinhole.center[2] / ray[2];
            let point: [f32; 3] = std::array::from_fn(|i| pinhole.center[i] + depth * ray[i]);
            let color = color([point[0], point[1]], board);
            (0..3).for_each(|c| image.plane_mut(c)[pixel] = color[c]);
        }
        image
    }

    /// Gaussians of the board, which moves right by half its width, and of the wall.
    #[test]
    fn what_went_further_than_its_velocity_is_found_and_what_did_not_stays() {
        let eyes = [[-0.5, 0.2, -2.0], [0.6, 0.3, -2.2], [0.1, -0.7, -2.0], [0.2, 0.6, -1.9]];
        let camera = |eye| Camera::look_at(eye, [0.0; 3], [0.0, -1.0, 0.0], 110.0, 128, 96);
        let cameras = eyes.map(camera);
        let gone = [0.3, 0.08, 0.0];
        let before = cameras.each_ref().map(|camera| image(camera, [-0.2, 0.0]));
        let now = cameras.each_ref().map(|camera| image(camera, [gone[0] - 0.2, gone[1]]));
        let from_board = |mean: [f32; 3]| (mean[0] + 0.2).abs().max(mean[1].abs());
        let run = |velocity_of_board: [f32; 3]| {
            let mover = |i: usize| {
                let mean = [(i % 50) as f32 * 0.04 - 1.0, (i / 50) as f32 * 0.04 - 0.5, 0.0];
                let velocity = if from_board(mean) < 0.3 { velocity_of_board } else { [0.0; 3] };
                Mover { mean, velocity, foreground: true }
            };
            let movers: Vec<Mover> = (0..1250).map(mover).collect();
            let weights = vec![vec![1.0; movers.len()]; cameras.len()];
            let matches = Matches::new(&movers, &weights, &cameras.each_ref(), &before.each_ref(), &now.each_ref());
            movers.iter().map(|mover| mover.mean).zip(matches.corrections()).collect::<Vec<_>>()
        };
        // A pixel is 0.018 wide.
        let is_near = |a: [f32; 3], b: [f32; 3]| a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 0.02);
        let inside = |(mean, _): &&([f32; 3], _)| from_board(*mean) < 0.22;
        let beside = |(mean, _): &&([f32; 3], _)| !(-0.85..0.75).contains(&mean[0]);

        let from_rest = run([0.0; 3]);
        assert_eq!(from_rest.iter().filter(inside).count(), 121);
        let well = from_rest.iter().filter(inside).filter(|(_, off)| is_near(*off, gone)).count();
        assert!(well >= 109, "{well} of 121");
        assert!(from_rest.iter().filter(beside).all(|(_, off)| *off == [0.0; 3]));

        let from_motion = run(gone);
        let well = from_motion.iter().filter(inside).filter(|(_, off)| is_near(*off, [0.0; 3])).count();
        assert!(well >= 118, "{well} of 121");
        assert!(from_motion.iter().filter(beside).all(|(_, off)| *off == [0.0; 3]));
    }
}

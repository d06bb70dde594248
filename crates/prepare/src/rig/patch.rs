//! The appearance of a corner's surroundings in another camera, for a small plane of any direction.

use tcgs_core::{add_scaled, cross, dot, normalize, sub};

use super::camera::RigCamera;
use super::corners::{Corner, Gray, Pyramid};

/// Half of a patch, pixels of the corner's level.
const HALF: i32 = 7;
const SIDE: usize = 2 * HALF as usize + 1;
/// Plane directions are tried on every second pixel of every second row.
const COARSE: usize = HALF as usize + 1;
/// Number of plane directions that are tried first.
pub(super) const NUM_MIDDLE: usize = 7;

/// Grey values around a corner, of mean 0 and length 1.
pub(super) struct Patch {
    values: [f32; SIDE * SIDE],
    coarse: [f32; COARSE * COARSE],
    /// Pixels of the camera's image for one of the patch.
    pub unit: f64,
    /// Unit directions in the world of the patch's middle, and of the pixels [`REACH`] to the right and below.
    rays: [[f64; 3]; 3],
}

/// Length in pixels over which the patch's step in another camera is measured.
const REACH: f64 = 4.0;

impl Patch {
    pub fn new(camera: &RigCamera, pyramid: &Pyramid, corner: &Corner) -> Option<Self> {
        let unit = pyramid.unit_of(corner.level);
        let [x, y] = corner.pixel.map(|p| p / unit);
        let value = |i, j| pyramid.levels[corner.level].at(x as f32 + i, y as f32 + j);
        let ray = |right: f64, down: f64| camera.ray([corner.pixel[0] + right * unit, corner.pixel[1] + down * unit]);
        let rays = [ray(0.0, 0.0), ray(REACH, 0.0), ray(0.0, REACH)];
        Some(Self { values: around(pyramid, corner)?, coarse: normalized(2, value)?, unit, rays })
    }

    fn correlation(&self, other: &[f32; SIDE * SIDE]) -> f32 {
        product(&self.values, other)
    }

    /// The correlation of every second pixel of every second row.
    pub fn likeness(&self, place: &Place<'_>, shift: [f32; 2]) -> Option<f32> {
        Some(product(&self.coarse, &place.every::<{ COARSE * COARSE }>(2, shift)?))
    }
}

fn product(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Correlation of the surroundings of a corner with another picture of the same camera; 0 for places without contrast.
pub(super) fn likeness(pyramid: &Pyramid, other: &Pyramid, corner: &Corner) -> f32 {
    let patches = around(pyramid, corner).zip(around(other, corner));
    patches.map_or(0.0, |(a, b)| product(&a, &b))
}

/// The patch of a corner, every pixel.
fn around(pyramid: &Pyramid, corner: &Corner) -> Option<[f32; SIDE * SIDE]> {
    let [x, y] = corner.pixel.map(|p| (p / pyramid.unit_of(corner.level)) as f32);
    normalized(1, |i, j| pyramid.levels[corner.level].at(x + i, y + j))
}

/// - `step`: every so many pixels of the patch
/// - `value`: at a place relative to the patch's middle
fn normalized<const N: usize>(step: usize, value: impl Fn(f32, f32) -> f32) -> Option<[f32; N]> {
    let mut values = [0.0_f32; N];
    let side = 2 * HALF as usize / step + 1;
    for (row, slots) in values.chunks_exact_mut(side).enumerate() {
        for (column, slot) in slots.iter_mut().enumerate() {
            *slot = value((column * step) as f32 - HALF as f32, (row * step) as f32 - HALF as f32);
        }
    }
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    for v in &mut values {
        *v -= mean;
    }
    let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    // Contrast of less than two grey values is noise.
    if length < 2.0 * (N as f32).sqrt() {
        return None;
    }
    for v in &mut values {
        *v /= length;
    }
    Some(values)
}

/// A patch in another image: a level of it, a place, and the patch's steps there.
pub(super) struct Place<'a> {
    gray: &'a Gray,
    /// Pixels of the camera's image for one of the level.
    pub unit: f64,
    /// Pixels of the level.
    pub middle: [f32; 2],
    /// `[2][2]`, columns are steps right and down of the patch.
    steps: [[f32; 2]; 2],
}

impl Place<'_> {
    fn values(&self, shift: [f32; 2]) -> Option<[f32; SIDE * SIDE]> {
        self.every(1, shift)
    }

    fn every<const N: usize>(&self, step: usize, shift: [f32; 2]) -> Option<[f32; N]> {
        let ([x, y], [[a, b], [c, d]]) = (self.middle, self.steps);
        let (x, y) = (x + shift[0], y + shift[1]);
        normalized(step, |i, j| self.gray.at(x + a * i + b * j, y + c * i + d * j))
    }
}

/// Shifts a place to the largest correlation: Gauss–Newton on the difference of normalised patches.
pub(super) fn shifted(patch: &Patch, place: &Place<'_>, mut shift: [f32; 2]) -> Option<([f32; 2], f32)> {
    let mut best = (shift, patch.correlation(&place.values(shift)?));
    for _ in 0..4 {
        let now = place.values(shift)?;
        let slope = |dx: f32, dy: f32| -> Option<[f32; SIDE * SIDE]> {
            let ahead = place.values([shift[0] + dx, shift[1] + dy])?;
            let back = place.values([shift[0] - dx, shift[1] - dy])?;
            Some(std::array::from_fn(|i| ahead[i] - back[i]))
        };
        let (sx, sy) = (slope(0.5, 0.0)?, slope(0.0, 0.5)?);
        let (mut xx, mut xy, mut yy, mut rx, mut ry) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for i in 0..now.len() {
            let error = patch.values[i] - now[i];
            xx += sx[i] * sx[i];
            xy += sx[i] * sy[i];
            yy += sy[i] * sy[i];
            rx += sx[i] * error;
            ry += sy[i] * error;
        }
        let determinant = xx * yy - xy * xy;
        if determinant <= 1e-6 * xx * yy {
            break; // an edge, along which there is no telling
        }
        let step = [(yy * rx - xy * ry) / determinant, (xx * ry - xy * rx) / determinant];
        shift = [0, 1].map(|i| (shift[i] + step[i].clamp(-1.0, 1.0)).clamp(-3.0, 3.0));
        let correlation = patch.correlation(&place.values(shift)?);
        if correlation > best.1 {
            best = (shift, correlation);
        }
        if step[0].abs() + step[1].abs() < 0.02 {
            break;
        }
    }
    Some(best)
}

/// A small plane in the scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    point: [f64; 3],
    /// Unit direction towards the cameras, and two others at right angles.
    axes: [[f64; 3]; 3],
}

impl Plane {
    /// Planes of all directions that both cameras may see: first the one that faces them, then [`NUM_MIDDLE`] - 1 near
    /// it.
    pub fn directions(from: &RigCamera, to: &RigCamera, point: [f64; 3]) -> impl Iterator<Item = Self> {
        let towards = |camera: &RigCamera| normalize(sub(camera.center(), point));
        let (a, b) = (towards(from), towards(to));
        let middle = normalize([0, 1, 2].map(|i| a[i] + b[i]));
        let side = cross(middle, if middle[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] });
        let side = normalize(side);
        let facing = Self { point, axes: [middle, side, cross(middle, side)] };
        let ring = move |(tilt, count): (f64, i32)| {
            (0..count).map(move |i| {
                let around = std::f64::consts::TAU * f64::from(i) / f64::from(count);
                facing.tilted(tilt * around.cos(), tilt * around.sin())
            })
        };
        let tilted = [(0.5, NUM_MIDDLE as i32 - 1), (1.0, 9)].into_iter().flat_map(ring);
        std::iter::once(facing)
            .chain(tilted.filter(move |plane| dot(plane.axes[0], a) > 0.15 && dot(plane.axes[0], b) > 0.15))
    }

    /// - `x`, `y`: radians
    pub fn tilted(&self, x: f64, y: f64) -> Self {
        let angle = x.hypot(y);
        if angle == 0.0 {
            return *self;
        }
        let [n, u, v] = self.axes;
        let towards: [f64; 3] = std::array::from_fn(|i| (x * u[i] + y * v[i]) / angle);
        let normal: [f64; 3] = normalize(std::array::from_fn(|i| angle.cos() * n[i] + angle.sin() * towards[i]));
        let along = dot(u, normal);
        let side = normalize(std::array::from_fn(|i| u[i] - along * normal[i]));
        Self { point: self.point, axes: [normal, side, cross(normal, side)] }
    }

    /// The plane's patch in the other image: around `target`, with the steps that the plane gives.
    pub fn place<'a>(
        &self,
        (from, to): (&RigCamera, &RigCamera),
        patch: &Patch,
        pyramid: &'a Pyramid,
        target: [f64; 2],
    ) -> Option<Place<'a>> {
        let center = from.center();
        let along = dot(sub(self.point, center), self.axes[0]);
        let image = |ray: [f64; 3]| {
            let facing = dot(ray, self.axes[0]);
            let depth = along / facing;
            (facing < -0.05 && depth > 0.0).then_some(())?;
            to.project(add_scaled(center, depth, ray))
        };
        let [middle, right, down] = patch.rays;
        let (middle, right, down) = (image(middle)?, image(right)?, image(down)?);
        let step = |end: [f64; 2], axis: usize| (end[axis] - middle[axis]) / REACH;
        let steps = [[step(right, 0), step(down, 0)], [step(right, 1), step(down, 1)]];
        let area = (steps[0][0] * steps[1][1] - steps[0][1] * steps[1][0]).abs();
        let finest = pyramid.unit_of(0);
        let size = area.sqrt() / finest;
        if !(0.25..24.0).contains(&size) {
            return None;
        }
        let level = (size.log2().round().max(0.0) as usize).min(pyramid.levels.len() - 1);
        let unit = pyramid.unit_of(level);
        let gray = &pyramid.levels[level];
        let middle = target.map(|p| (p / unit) as f32);
        Some(Place { gray, unit, middle, steps: steps.map(|row| row.map(|x| (x / unit) as f32)) })
    }
}

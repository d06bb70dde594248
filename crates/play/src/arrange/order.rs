//! The rows that may be visible from a camera, sorted by depth: a radix sort of the bits of the depths, which grow with
//! them, in three passes.
//!
//! Quads are blended from back to front. Rows of equal depth stand in the order that is the opposite of the training
//! renderer's, which blends from front to back.

use tcgs_core::Camera;
use tcgs_render::SplatCamera;
use tcgs_render::settings::{BLUR_VARIANCE, MIN_ALPHA, NEAR};

/// Bits of the digits of the passes. The sign of a depth is 0.
const DIGITS: [u32; 3] = [11, 10, 10];
/// Values of the longest digit.
const RADIX: usize = 1 << 11;
/// Tolerance of the test for visibility, pixels: for rounding here and in the vertex shader.
const MARGIN_PX: f32 = 0.5;

/// Memory of the sort.
#[derive(Debug, Default)]
pub(super) struct Order {
    /// Bits of the depth, row.
    keys: Vec<[u32; 2]>,
    other: Vec<[u32; 2]>,
    rows: Vec<u32>,
}

impl Order {
    /// The rows that may be visible, the farthest first.
    pub(super) fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Overwrites the order.
    ///
    /// - `gaussians`: `[N]` means, and largest standard deviations in scene units, negative for what is not drawn
    pub(super) fn sort_rows(&mut self, gaussians: impl Iterator<Item = ([f32; 3], f32)>, camera: &Camera) {
        let view = View::new(camera);
        self.keys.clear();
        let visible =
            (0..).zip(gaussians).filter_map(|(row, (mean, reach))| Some([view.depth(mean, reach)?.to_bits(), row]));
        self.keys.extend(visible);
        self.sort();
    }

    fn sort(&mut self) {
        let mut counts = [[0_u32; RADIX]; DIGITS.len()];
        for &[key, _] in &self.keys {
            let mut shift = 0;
            for (counts, bits) in counts.iter_mut().zip(DIGITS) {
                counts[digit(key, shift, bits)] += 1;
                shift += bits;
            }
        }
        self.other.resize(self.keys.len(), [0; 2]);
        let mut shift = 0;
        for (counts, bits) in counts.iter_mut().zip(DIGITS) {
            let mut sum = 0;
            for count in counts.iter_mut() {
                (*count, sum) = (sum, sum + *count);
            }
            for &pair in &self.keys {
                let place = &mut counts[digit(pair[0], shift, bits)];
                self.other[*place as usize] = pair;
                *place += 1;
            }
            std::mem::swap(&mut self.keys, &mut self.other);
            shift += bits;
        }
        self.rows.clear();
        self.rows.extend(self.keys.iter().rev().map(|&[_, row]| row));
    }
}

#[inline(always)]
fn digit(key: u32, shift: u32, bits: u32) -> usize {
    (key >> shift & ((1 << bits) - 1)) as usize
}

/// A camera's numbers for the test for visibility.
struct View {
    camera: SplatCamera<f32>,
    size: [f32; 2],
    /// Pixels from a splat's centre to its edge, for a standard deviation of a pixel and the highest opacity.
    deviations: f32,
}

impl View {
    fn new(camera: &Camera) -> Self {
        Self {
            size: [camera.width as f32, camera.height as f32],
            camera: SplatCamera::new(camera),
            deviations: (2.0 * (1.0 / MIN_ALPHA).ln()).sqrt() as f32,
        }
    }

    /// Depth of a Gaussian whose splat may hold the centre of a pixel. The splat is bounded by the circle that it fills
    /// with its largest standard deviation along all axes and the highest opacity.
    #[inline(always)]
    fn depth(&self, mean: [f32; 3], reach: f32) -> Option<f32> {
        if reach < 0.0 {
            return None;
        }
        let pinhole = &self.camera.pinhole;
        let point = pinhole.camera_point(mean);
        let depth = point[2];
        if !(depth > NEAR as f32 && depth.is_finite()) {
            return None;
        }
        for axis in 0..2 {
            let (per_depth, raw) = (pinhole.focal[axis] / depth, point[axis] / depth);
            // A row of the projection is focal / z (e_axis − slope e_z), whose squared length is this.
            let slope = raw.max(self.camera.slope_min[axis]).min(self.camera.slope_max[axis]);
            let deviation = per_depth * reach;
            let variance = deviation * deviation * (1.0 + slope * slope) + BLUR_VARIANCE as f32;
            let extent = self.deviations * variance.sqrt() + MARGIN_PX;
            let center = pinhole.focal[axis] * raw + pinhole.principal[axis];
            let is_inside = center + extent >= 0.0 && center - extent <= self.size[axis];
            if !is_inside {
                return None;
            }
        }
        Some(depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random.
    fn numbers(count: usize) -> impl Iterator<Item = f32> {
        let mut state = 1_u32;
        (0..count).map(move |_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        })
    }

    #[test]
    fn rows_stand_from_back_to_front_and_equal_depths_in_reverse() {
        for count in [0, 1, 2, 500, 5000] {
            // Some depths are equal.
            let depths: Vec<f32> = numbers(count).map(|x| (50.0 * x).exp2().min(1e20) * 0.25).collect();
            let depths: Vec<f32> = depths.iter().enumerate().map(|(i, &d)| if i % 3 == 0 { 7.5 } else { d }).collect();
            let mut order = Order::default();
            for _ in 0..2 {
                order.keys = (0..).zip(&depths).map(|(row, depth)| [depth.to_bits(), row]).collect();
                order.sort();
                let mut expected: Vec<u32> = (0..count as u32).collect();
                expected.sort_by(|&a, &b| depths[a as usize].total_cmp(&depths[b as usize]));
                expected.reverse();
                assert_eq!(order.rows, expected);
            }
        }
    }

    #[test]
    fn what_is_behind_beside_or_hidden_is_left_out() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
        let gaussians = [
            ([0.0, 0.0, 0.0], 0.1),
            ([0.0, 0.0, 2.0], 0.1),
            ([0.0, 0.0, -3.9], 0.1),
            ([0.0, 0.0, -9.0], 0.1),
            ([9.0, 0.0, 0.0], 0.1),
            ([9.0, 0.0, 0.0], 3.0),
            ([0.0, f32::NAN, 0.0], 0.1),
            ([0.0, 0.0, 1.0], -1.0),
            ([0.0, 0.0, 1.0], 0.0),
        ];
        let mut order = Order::default();
        order.sort_rows(gaussians.into_iter(), &camera);
        assert_eq!(order.rows(), [1, 8, 5, 0]);
    }
}

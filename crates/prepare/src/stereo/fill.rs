//! Depths of surfaces without texture, interpolated from their surroundings.

use super::{fuse::SureDepths, vantage::Vantage};

/// Inverse depth where a view is not sure of it; 0 where no sure depth is near.
///
/// Inverse depth is linear over the image of a plane, so a smooth filling of inverse depth continues floors and walls
/// as planes. Foreground neither gives nor receives depth.
///
/// Push and pull (Gortler et al. 1996): means over ever larger blocks, then missing values are filled from the largest
/// blocks down.
///
/// - `levels`: blocks grow to `2^levels` pixels
/// - returns: `[H, W]`, 0 where the view is sure, or shows foreground
pub(super) fn fill(vantage: &Vantage, sure: &SureDepths, levels: usize) -> Vec<f32> {
    let (width, height) = (vantage.pinhole.width, vantage.pinhole.height);
    let known = |pixel: usize| sure.depths[pixel] > 0.0 && !vantage.is_foreground(pixel);
    let finest = Level {
        width,
        height,
        weights: (0..width * height).map(|pixel| f32::from(u8::from(known(pixel)))).collect(),
        values: (0..width * height).map(|p| if known(p) { 1.0 / sure.depths[p] } else { 0.0 }).collect(),
    };
    let mut pyramid = vec![finest];
    for _ in 0..levels {
        let coarser = pyramid[pyramid.len() - 1].pushed();
        pyramid.push(coarser);
    }
    let mut coarse = pyramid.pop().unwrap_or_else(|| unreachable!("the finest level is there"));
    while let Some(mut fine) = pyramid.pop() {
        fine.pull(&coarse);
        coarse = fine;
    }
    let wanted = |pixel: usize| sure.depths[pixel] == 0.0 && !vantage.is_foreground(pixel);
    (0..width * height).map(|p| if wanted(p) && coarse.weights[p] > 0.0 { coarse.values[p] } else { 0.0 }).collect()
}

/// One resolution.
struct Level {
    width: usize,
    height: usize,
    /// Weight of the known values, 0 to 1.
    weights: Vec<f32>,
    /// Values where the weight is above 0.
    values: Vec<f32>,
}

impl Level {
    /// The level at half the size.
    fn pushed(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut half = Self { width, height, weights: vec![0.0; width * height], values: vec![0.0; width * height] };
        for at in 0..self.weights.len() {
            let (x, y) = (at % self.width, at / self.width);
            let to = y / 2 * width + x / 2;
            half.weights[to] += self.weights[at];
            half.values[to] += self.weights[at] * self.values[at];
        }
        for (weight, value) in half.weights.iter_mut().zip(&mut half.values) {
            if *weight > 0.0 {
                *value /= *weight;
            }
            *weight = weight.min(1.0);
        }
        half
    }

    /// Fills missing values from a coarser level, smoothly.
    fn pull(&mut self, coarse: &Self) {
        for at in 0..self.weights.len() {
            if self.weights[at] > 0.0 {
                continue;
            }
            let place = [at % self.width, at / self.width].map(|i| (i as f32 + 0.5) / 2.0 - 0.5);
            let (mut weight, mut sum) = (0.0, 0.0);
            for corner in 0..4 {
                let (mut share, mut index) = (1.0, [0; 2]);
                for axis in 0..2 {
                    let size = [coarse.width, coarse.height][axis];
                    let low = place[axis].floor();
                    let upper = corner >> axis & 1;
                    let fraction = place[axis] - low;
                    share *= if upper == 1 { fraction } else { 1.0 - fraction };
                    index[axis] = (low as i32 + upper).clamp(0, size as i32 - 1) as usize;
                }
                let from = index[1] * coarse.width + index[0];
                let known = share * coarse.weights[from];
                weight += known;
                sum += known * coarse.values[from];
            }
            if weight > 0.0 {
                (self.weights[at], self.values[at]) = (weight, sum / weight);
            }
        }
    }
}

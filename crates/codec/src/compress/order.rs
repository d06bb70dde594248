//! Importance of Gaussians, estimated from the first timestep. It determines factors of tolerances, layers, and the
//! order in which Gaussians are stored.

use rayon::prelude::*;
use tcgs_core::{Attribute, Gaussians, upper_median};

use super::CompressSettings;
use super::reduce::Reduced;
use crate::morton;
use crate::quantize::{MAX_BITS, Quantizers};

/// `[N]` factors of the tolerances; empty if all factors are 1.
///
/// An error changes a splat's image by about the error's size times the slope of the splat. Squared and summed over its
/// pixels, up to a constant, this is opacity squared, times a factor. The factor is the area for a colour, and the
/// ratio of the axes for a position. For a rotation it is the area times the squared deviation from a round shape.
/// Tolerances are divided by a power of this weight, relative to the median.
///
/// - `first`: the first timestep
pub(super) fn tolerance_factors(first: &Gaussians, attribute: Attribute, settings: &CompressSettings) -> Vec<f32> {
    if settings.importance == 0.0 {
        return Vec::new();
    }
    let weights: Vec<f64> = (0..first.num_gaussians()).map(|g| weight(first, attribute, g)).collect();
    let median = upper_median(weights.iter().copied()).unwrap_or(1.0);
    let factor = |w: f64| (median / w).powf(settings.importance.into()).clamp(1.0 / MAX_FACTOR, MAX_FACTOR) as f32;
    weights.into_iter().map(factor).collect()
}

/// Largest factor by which a tolerance changes.
const MAX_FACTOR: f64 = 16.0;

fn weight(first: &Gaussians, attribute: Attribute, gaussian: usize) -> f64 {
    let opacity = f64::from(tcgs_core::sigmoid(first.logit_opacities()[gaussian]));
    let mut scales = first.log_scales()[gaussian].map(|x| f64::from(x).exp());
    scales.sort_unstable_by(f64::total_cmp);
    let [thin, middle, long] = scales;
    let seen = opacity * opacity;
    let round = (long / thin.max(0.1 * long)).min(10.0);
    let weight = match attribute {
        Attribute::Color | Attribute::LogitOpacity | Attribute::LogScale | Attribute::Extra { .. } => {
            seen * middle * long
        }
        Attribute::Mean => seen * (long / middle.max(0.1 * long)).min(10.0),
        Attribute::Quat => seen * middle * long * (round - 1.0 / round).powi(2).max(1e-3),
    };
    weight.max(1e-30)
}

/// All Gaussians in descending order of the image area they cover, weighted by opacity.
fn by_weight(first: &Gaussians) -> Vec<usize> {
    let mut by_weight: Vec<usize> = (0..first.num_gaussians()).collect();
    let weights: Vec<f64> = by_weight.iter().map(|&g| weight(first, Attribute::Color, g)).collect();
    by_weight.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]));
    by_weight
}

/// For each Gaussian the share of Gaussians that cover more of an image.
pub(super) fn ranks(first: &Gaussians) -> Vec<f32> {
    let by_weight = by_weight(first);
    let mut ranks = vec![0.0; by_weight.len()];
    for (rank, &gaussian) in by_weight.iter().enumerate() {
        ranks[gaussian] = rank as f32 / by_weight.len() as f32;
    }
    ranks
}

/// Splits an order into layers by descending coverage of the image; the order holds within each layer. Also returns the
/// number of Gaussians of each layer.
pub(super) fn by_layer(order: Vec<usize>, first: &Gaussians, settings: &CompressSettings) -> (Vec<usize>, Vec<u32>) {
    let n = order.len();
    let by_weight = by_weight(first);
    let mut ends: Vec<usize> = Vec::new();
    for share in &settings.layers {
        let start = ends.last().copied().unwrap_or(0);
        ends.push((start + (f64::from(*share) * n as f64) as usize).min(n));
    }
    ends.push(n);
    ends.dedup();
    ends.retain(|&end| end > 0);
    let mut layer_of = vec![0; n];
    for (rank, &gaussian) in by_weight.iter().enumerate() {
        layer_of[gaussian] = ends.partition_point(|&end| end <= rank);
    }
    let mut layered = order;
    layered.sort_by_key(|&gaussian| layer_of[gaussian]);
    let sizes = ends.iter().scan(0, |start, &end| Some((end - std::mem::replace(start, end)) as u32)).collect();
    (layered, sizes)
}

/// Gaussians along a Morton curve of the codes of their first positions; ties stay in index order.
pub(super) fn morton_order(means: &Reduced, widths: &[u8], quantizers: &Quantizers) -> Vec<usize> {
    let table = quantizers.by_width(Attribute::Mean);
    let mut keys: Vec<(u64, usize)> = widths
        .iter()
        .enumerate()
        .map(|(gaussian, &width)| {
            let code = |channel: usize| {
                let quantizer = &table[usize::from(width)][channel];
                let code = quantizer.quantize(means.first(gaussian, channel)) - quantizer.min_code();
                // Coarser codes are scaled to the range of the finest, so that all lie on one curve.
                (code << (MAX_BITS - width)) as u16
            };
            (morton::interleave([code(0), code(1), code(2)]), gaussian)
        })
        .collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|(_, gaussian)| gaussian).collect()
}

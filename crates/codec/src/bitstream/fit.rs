//! The encoder's choice of predictors for first codes: least-squares weights and the mode that takes the fewest bytes.
//! The file holds the result, so a decoder does not need this module.

use tcgs_core::Attribute;

use super::coder::Encoder;
use super::neighbors::NONE;
use super::plan::{Mode, Plan, Predictor, num_weights};
use super::shared::{Features, FirstModels, MAX_FEATURES, Shared, value};

/// Ridge regularisation, relative to the squares of the features: keeps weights small where features are uninformative.
const RIDGE: f64 = 1e-4;
/// Largest number of Gaussians that weights are fitted to, evenly sampled.
const SAMPLE: usize = 1 << 16;

/// Predictors of an attribute: least-squares weights, and the modes that take the fewest bytes.
pub(super) fn predictors(attribute: Attribute, plan: &Plan, shared: &Shared) -> Vec<Predictor> {
    let components = attribute.components();
    let mut plan = plan.clone();
    let a = attribute.index();
    plan.predictors[a] = (0..components)
        .map(|channel| Predictor { mode: Mode::Code, weights: weights(attribute, channel, &plan, shared) })
        .collect();
    let bytes = |plan: &Plan| {
        let mut encoder = Encoder::default();
        let mut codes = shared.first_codes[a].clone();
        let layer = 0..shared.num_gaussians();
        let widths = &shared.bit_map.widths[a];
        FirstModels::new(plan, attribute).code(&mut encoder, plan, layer, &shared.neighbors, widths, &mut codes);
        encoder.finish().len()
    };
    let mut best = bytes(&plan);
    for channel in 0..components {
        for mode in Mode::ALL {
            let before = std::mem::replace(&mut plan.predictors[a][channel].mode, mode);
            let tried = bytes(&plan);
            if tried < best {
                best = tried;
            } else {
                plan.predictors[a][channel].mode = before;
            }
        }
    }
    std::mem::take(&mut plan.predictors[a])
}

fn weights(attribute: Attribute, channel: usize, plan: &Plan, shared: &Shared) -> Vec<f32> {
    let (a, components) = (attribute.index(), attribute.components());
    let (table, codes) = (plan.quantizers.by_width(attribute), &shared.first_codes[a]);
    let widths = &shared.bit_map.widths[a];
    let of = |g: usize, c: usize| {
        let quantizer = table[usize::from(widths[g])].get(c);
        quantizer.map_or(0.0, |quantizer| value(quantizer, codes[g * components + c]))
    };
    let count = num_weights(attribute, channel);
    let mut squares = [[0.0; MAX_FEATURES]; MAX_FEATURES];
    let mut products = [0.0; MAX_FEATURES];
    let n = shared.num_gaussians();
    for g in (0..n).step_by(n.div_ceil(SAMPLE).max(1)) {
        let [first, second] = shared.neighbors(g);
        if first == NONE || widths[g] == 0 {
            continue;
        }
        let second = if second == NONE { first } else { second };
        let mut features = Features::new(attribute);
        for (place, neighbor) in [first, second].into_iter().enumerate() {
            for c in 0..components {
                features.set_neighbor(place, c, of(neighbor as usize, c));
            }
        }
        for c in 0..channel {
            features.push(of(g, c));
        }
        let target = of(g, channel);
        let mut chosen = [0.0; MAX_FEATURES];
        let features = features.of_next(&mut chosen);
        for (i, x) in features.iter().enumerate() {
            products[i] += x * target;
            for (j, y) in features.iter().enumerate() {
                squares[i][j] += x * y;
            }
        }
    }
    for i in 0..count {
        squares[i][i] += RIDGE * squares[i][i] + f64::MIN_POSITIVE;
    }
    solve(&mut squares, &mut products, count);
    products[..count].iter().map(|&w| if w.is_finite() { (w as f32).clamp(-1e3, 1e3) } else { 0.0 }).collect()
}

/// Solves a symmetric positive definite system in place by Gaussian elimination.
fn solve(matrix: &mut [[f64; MAX_FEATURES]; MAX_FEATURES], right: &mut [f64; MAX_FEATURES], count: usize) {
    for i in 0..count {
        for j in i + 1..count {
            let factor = matrix[j][i] / matrix[i][i];
            for k in i..count {
                matrix[j][k] -= factor * matrix[i][k];
            }
            right[j] -= factor * right[i];
        }
    }
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|j| matrix[i][j] * right[j]).sum();
        right[i] = (right[i] - known) / matrix[i][i];
    }
}

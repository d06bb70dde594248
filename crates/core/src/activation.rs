//! From stored to drawn: unit quaternions, positive scales, opacities in (0, 1); and back for gradients.

use std::sync::Arc;

use crate::columns::select_rows;
use crate::parallel::{map, map_pairs};
use crate::{Attribute, GaussianGrads, Gaussians, Real, normalize, normalize_vjp};

/// Activated Gaussians, which a rasterizer draws. All arrays have length `N`; `colors` has `num_channels` per Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Activated {
    /// `[N, 3]` centres, scene units.
    pub means: Vec<[f32; 3]>,
    /// `[N, 4]` unit rotations, `w, x, y, z`.
    pub quats: Vec<[f32; 4]>,
    /// `[N, 3]` standard deviations, scene units.
    pub scales: Vec<[f32; 3]>,
    /// `[N]` in `[0, 1]`.
    pub opacities: Vec<f32>,
    /// `[N, num_channels]`; channels of any kind are blended like colour.
    pub colors: Vec<f32>,
    /// Channels of a Gaussian in `colors`.
    pub num_channels: usize,
    /// Whether splats are antialiased. An antialiased splat's opacity is multiplied by the square root of the ratio of
    /// its determinants before and after it is widened by a pixel's extent. So small splats do not grow beyond their
    /// own area (Yu et al. 2024, Mip-Splatting, Eq. 10).
    pub is_antialiased: bool,
    /// `[num_channels]` or fewer: colour behind all Gaussians. Channels that are left out are 0, which is black.
    pub background: Vec<f32>,
}

impl Activated {
    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.means.len()
    }

    /// The Gaussians at `indices`, in that order.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            means: indices.iter().map(|&i| self.means[i]).collect(),
            quats: indices.iter().map(|&i| self.quats[i]).collect(),
            scales: indices.iter().map(|&i| self.scales[i]).collect(),
            opacities: indices.iter().map(|&i| self.opacities[i]).collect(),
            colors: select_rows(&self.colors, self.num_channels, indices),
            num_channels: self.num_channels,
            is_antialiased: self.is_antialiased,
            background: self.background.clone(),
        }
    }

    /// Appends other Gaussians.
    ///
    /// # Panics
    /// If they have another number of channels.
    pub fn extend(&mut self, others: &Self) {
        assert_eq!(self.num_channels, others.num_channels, "channels of what is appended");
        self.means.extend_from_slice(&others.means);
        self.quats.extend_from_slice(&others.quats);
        self.scales.extend_from_slice(&others.scales);
        self.opacities.extend_from_slice(&others.opacities);
        self.colors.extend_from_slice(&others.colors);
    }
}

/// Gradients with respect to the fields of [`Activated`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActivatedGrads {
    /// `[N, 3]`
    pub v_means: Vec<[f32; 3]>,
    /// `[N, 4]`, with respect to the unit quaternion, without the constraint of unit length.
    pub v_quats: Vec<[f32; 4]>,
    /// `[N, 3]`
    pub v_scales: Vec<[f32; 3]>,
    /// `[N]`
    pub v_opacities: Vec<f32>,
    /// `[N, num_channels]`
    pub v_colors: Vec<f32>,
}

impl ActivatedGrads {
    /// The gradients to the Gaussians at `indices`, in that order.
    ///
    /// - `num_channels`: of a Gaussian in `v_colors`
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize], num_channels: usize) -> Self {
        Self {
            v_means: indices.iter().map(|&i| self.v_means[i]).collect(),
            v_quats: indices.iter().map(|&i| self.v_quats[i]).collect(),
            v_scales: indices.iter().map(|&i| self.v_scales[i]).collect(),
            v_opacities: indices.iter().map(|&i| self.v_opacities[i]).collect(),
            v_colors: select_rows(&self.v_colors, num_channels, indices),
        }
    }
}

/// Logistic function.
///
/// ```
/// assert_eq!(tcgs_core::sigmoid(0.0_f32), 0.5);
/// ```
#[inline(always)]
pub fn sigmoid<R: Real>(x: R) -> R {
    R::one() / (R::one() + (-x).exp())
}

/// VJP of [`sigmoid`].
///
/// - `value`: `sigmoid(x)`
#[inline(always)]
pub fn sigmoid_vjp<R: Real>(value: R, v_value: R) -> R {
    v_value * value * (R::one() - value)
}

/// Activates one timestep for drawing with its three colour channels. Colours are those of degree 0, whatever the
/// direction of view: [`seen_colors`](crate::seen_colors()) adds spherical harmonics of higher degree.
///
/// ```
/// use tcgs_core::{Gaussians, activate};
/// let mut gaussians = Gaussians::zeros(1);
/// gaussians.quats_mut()[0] = [2.0, 0.0, 0.0, 0.0];
/// let drawn = activate(&gaussians);
/// assert_eq!((drawn.quats[0][0], drawn.scales[0][0], drawn.opacities[0]), (1.0, 1.0, 0.5));
/// ```
pub fn activate(gaussians: &Gaussians) -> Activated {
    Activated {
        means: gaussians.means().to_vec(),
        quats: map(gaussians.quats(), |&q| normalize(q)),
        scales: map(gaussians.log_scales(), |s| s.map(f32::exp)),
        opacities: map(gaussians.logit_opacities(), |&o| sigmoid(o)),
        colors: gaussians.values(Attribute::Color).to_vec(),
        num_channels: 3,
        is_antialiased: gaussians.layout().is_antialiased(),
        background: gaussians.layout().background_color().to_vec(),
    }
}

/// Backward of [`activate`]: gradients to the stored values. Columns that are not drawn get zeros.
///
/// - `gaussians`, `activated`: as given to and returned by `activate`
/// - `grads`: with three colour channels
///
/// # Panics
/// If `grads` has another number of Gaussians or channels.
pub fn activate_bwd(gaussians: &Gaussians, activated: &Activated, grads: &ActivatedGrads) -> GaussianGrads {
    let n = gaussians.num_gaussians();
    assert_eq!(grads.v_colors.len(), 3 * n, "v_colors: [{}] against [{n}, 3]", grads.v_colors.len());
    let v_quats = map_pairs(gaussians.quats(), &grads.v_quats, |&q, &v| normalize_vjp(q, v));
    let v_log_scales = map_pairs(&activated.scales, &grads.v_scales, |s, v| [s[0] * v[0], s[1] * v[1], s[2] * v[2]]);
    let v_logit_opacities = map_pairs(&activated.opacities, &grads.v_opacities, |&o, &v| sigmoid_vjp(o, v));
    let mut values = vec![
        grads.v_means.as_flattened().to_vec(),
        v_quats.into_flattened(),
        v_log_scales.into_flattened(),
        v_logit_opacities,
        grads.v_colors.clone(),
    ];
    // The other columns are not drawn.
    let others = &gaussians.layout().columns()[values.len()..];
    values.extend(others.iter().map(|column| vec![0.0; n * column.components()]));
    GaussianGrads::new(Arc::clone(gaussians.layout()), n, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BaseColumns;

    #[test]
    fn sigmoid_vjp_matches_a_central_difference() {
        let (x, h) = (0.7_f64, 1e-6);
        let difference = (sigmoid(x + h) - sigmoid(x - h)) / (2.0 * h);
        assert!((sigmoid_vjp(sigmoid(x), 1.0) - difference).abs() < 1e-9);
    }

    #[test]
    fn activate_bwd_matches_central_differences() {
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[0.1, 0.2, 0.3]],
            quats: vec![[0.9, -0.2, 0.4, 0.3]],
            log_scales: vec![[-1.0, -2.0, 0.5]],
            logit_opacities: vec![0.7],
            colors: vec![[0.2, 0.4, 0.6]],
        });
        let grads = ActivatedGrads {
            v_means: vec![[1.0, 2.0, 3.0]],
            v_quats: vec![[0.3, -0.5, 0.2, 0.9]],
            v_scales: vec![[1.5, -0.5, 0.25]],
            v_opacities: vec![2.0],
            v_colors: vec![0.5, 0.25, -1.0],
        };
        let loss = |g: &Gaussians| -> f64 {
            let a = activate(g);
            let sum = |x: &[f32], v: &[f32]| -> f64 { x.iter().zip(v).map(|(x, v)| f64::from(x * v)).sum() };
            sum(a.means.as_flattened(), grads.v_means.as_flattened())
                + sum(a.quats.as_flattened(), grads.v_quats.as_flattened())
                + sum(a.scales.as_flattened(), grads.v_scales.as_flattened())
                + sum(&a.opacities, &grads.v_opacities)
                + sum(&a.colors, &grads.v_colors)
        };
        let v = activate_bwd(&gaussians, &activate(&gaussians), &grads);
        for attribute in Attribute::BASE {
            for i in 0..attribute.components() {
                let at = |d: f32| {
                    let mut moved = gaussians.clone();
                    moved.values_mut(attribute)[i] += d;
                    loss(&moved)
                };
                let difference = (at(1e-2) - at(-1e-2)) / 2e-2;
                let gradient = f64::from(v.values(attribute)[i]);
                assert!((difference - gradient).abs() < 2e-4, "{attribute:?} {i}: {difference} against {gradient}");
            }
        }
    }
}

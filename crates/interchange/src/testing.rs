//! Gaussians for tests of writers, and what comes back of them.

use tcgs_core::{Gaussians, Layout, normalize, sigmoid};

/// The largest errors of a kind of file.
pub struct Bounds {
    pub mean: [f64; 3],
    /// For the three stored components of a unit quaternion.
    pub quat: f64,
    pub log_scale: [f64; 3],
    /// Activated.
    pub opacity: f64,
    pub color: f64,
    pub harmonic: f64,
}

/// Numbers between 0 and 1, of a linear congruential generator.
struct Random(u64);

impl Random {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 40) as f32 / (1 << 24) as f32)
    }
}

/// Gaussians with positions from -1 to 1, log scales from -5 to -3, colours from 0 to 1 and coefficients from -0.9 to
/// 0.9.
pub fn random(num_gaussians: usize, sh_degree: usize) -> Gaussians {
    let mut random = Random(num_gaussians as u64);
    let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(sh_degree), num_gaussians);
    gaussians.means_mut().as_flattened_mut().iter_mut().for_each(|x| *x = random.between(-1.0, 1.0));
    gaussians.quats_mut().as_flattened_mut().iter_mut().for_each(|x| *x = random.between(-2.0, 2.0));
    gaussians.log_scales_mut().as_flattened_mut().iter_mut().for_each(|x| *x = random.between(-5.0, -3.0));
    gaussians.logit_opacities_mut().iter_mut().for_each(|x| *x = random.between(-8.0, 8.0));
    gaussians.colors_mut().as_flattened_mut().iter_mut().for_each(|x| *x = random.between(0.0, 1.0));
    for band in gaussians.layout().harmonics() {
        gaussians.values_mut(band).iter_mut().for_each(|x| *x = random.between(-0.9, 0.9));
    }
    gaussians
}

/// Gaussians with numbers at the ends of what floats and rotations can be.
pub fn awkward() -> Gaussians {
    let mut gaussians = random(9, 3);
    let base = gaussians.views_mut();
    base.means[0] = [f32::MAX, f32::MIN, f32::MIN_POSITIVE];
    base.means[1] = [-0.0, 1e-30, -1e30];
    base.quats[0] = [0.0; 4];
    base.quats[1] = [-0.5, 0.5, -0.5, 0.5];
    base.quats[2] = [0.0, 0.0, 0.0, -1e-20];
    base.quats[3] = [1e30, -1e30, 0.0, 0.0];
    base.log_scales[0] = [-87.0, 88.0, 0.0];
    base.log_scales[1] = [f32::MIN, f32::MAX, -0.0];
    base.logit_opacities[..2].copy_from_slice(&[f32::MAX, f32::MIN]);
    base.colors[0] = [f32::MAX, f32::MIN, 0.5];
    for band in gaussians.layout().harmonics() {
        gaussians.values_mut(band)[..3].copy_from_slice(&[f32::MAX, f32::MIN, -0.0]);
    }
    gaussians
}

/// Fails where an attribute errs more than it may; floats may round, too.
pub fn assert_near(found: &Gaussians, expected: &Gaussians, bounds: &Bounds) {
    assert_eq!((found.num_gaussians(), found.layout()), (expected.num_gaussians(), expected.layout()));
    let near = |what: &str, i: usize, found: f32, expected: f32, bound: f64| {
        let error = f64::from(found - expected).abs();
        let rounding = 4.0 * f64::from(f32::EPSILON) * f64::from(expected.abs()).max(1.0);
        assert!(error <= bound + rounding, "{what} of Gaussian {i}: {found}, expected {expected} within {bound}");
    };
    for i in 0..found.num_gaussians() {
        for c in 0..3 {
            near("mean", i, found.means()[i][c], expected.means()[i][c], bounds.mean[c]);
            near("log scale", i, found.log_scales()[i][c], expected.log_scales()[i][c], bounds.log_scale[c]);
            near("color", i, found.colors()[i][c], expected.colors()[i][c], bounds.color);
        }
        let opacity = |gaussians: &Gaussians| sigmoid(gaussians.logit_opacities()[i]);
        near("opacity", i, opacity(found), opacity(expected), bounds.opacity);
        // The square of the component that is not stored errs by at most the sum of what the others' squares err.
        let quat = |gaussians: &Gaussians| normalize(gaussians.quats()[i].map(f64::from));
        let (a, b) = (quat(found), quat(expected));
        let errs = |sign: f64| (0..4).map(|c| (a[c] * a[c].abs() - sign * b[c] * b[c].abs()).abs()).fold(0.0, f64::max);
        let (error, may) = (errs(1.0).min(errs(-1.0)), 2.0 * 3.0_f64.sqrt() * bounds.quat + 3.0 * bounds.quat.powi(2));
        assert!(error <= may + 1e-6, "quat of Gaussian {i}: {a:?}, expected {b:?}: {error}, may {may}");
    }
    for band in found.layout().harmonics() {
        for (k, (found, expected)) in found.values(band).iter().zip(expected.values(band)).enumerate() {
            near("harmonic", k / band.components(), *found, *expected, bounds.harmonic);
        }
    }
}

//! A whole scene over time.

use crate::{Attribute, Gaussians};

/// All timesteps of a scene. Means, rotations and colours vary with time; scales and opacities do not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DynamicGaussians {
    /// `[T][N, 3]` centres, scene units.
    pub means: Vec<Vec<[f32; 3]>>,
    /// `[T][N, 4]` rotations, `w, x, y, z`, unnormalised.
    pub quats: Vec<Vec<[f32; 4]>>,
    /// `[T][N, 3]` raw sRGB.
    pub colors: Vec<Vec<[f32; 3]>>,
    /// `[N, 3]` logarithms of the standard deviations.
    pub log_scales: Vec<[f32; 3]>,
    /// `[N]` inverse logistic of the opacities.
    pub logit_opacities: Vec<f32>,
}

impl DynamicGaussians {
    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.logit_opacities.len()
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        self.means.len()
    }

    /// The scene at one timestep.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`].
    pub fn at(&self, timestep: usize) -> Gaussians {
        Gaussians {
            means: self.means[timestep].clone(),
            quats: self.quats[timestep].clone(),
            log_scales: self.log_scales.clone(),
            logit_opacities: self.logit_opacities.clone(),
            colors: self.colors[timestep].clone(),
        }
    }

    /// Appends a timestep. Scales and opacities are taken from the first one pushed.
    ///
    /// # Panics
    /// If the number of Gaussians differs from the timesteps already there.
    pub fn push(&mut self, gaussians: Gaussians) {
        if self.means.is_empty() {
            self.log_scales = gaussians.log_scales;
            self.logit_opacities = gaussians.logit_opacities;
        }
        assert_eq!(gaussians.means.len(), self.num_gaussians(), "a timestep with another number of Gaussians");
        self.means.push(gaussians.means);
        self.quats.push(gaussians.quats);
        self.colors.push(gaussians.colors);
    }

    /// The Gaussians at `indices`, in that order, at every timestep.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        fn pick<T: Copy>(of: &[T], indices: &[usize]) -> Vec<T> {
            indices.iter().map(|&i| of[i]).collect()
        }
        Self {
            means: self.means.iter().map(|v| pick(v, indices)).collect(),
            quats: self.quats.iter().map(|v| pick(v, indices)).collect(),
            colors: self.colors.iter().map(|v| pick(v, indices)).collect(),
            log_scales: pick(&self.log_scales, indices),
            logit_opacities: pick(&self.logit_opacities, indices),
        }
    }

    /// All values of one attribute at one timestep, `[N * components]`; `timestep` does not matter
    /// for an attribute that does not vary.
    pub fn values(&self, attribute: Attribute, timestep: usize) -> &[f32] {
        match attribute {
            Attribute::Mean => self.means[timestep].as_flattened(),
            Attribute::Quat => self.quats[timestep].as_flattened(),
            Attribute::LogScale => self.log_scales.as_flattened(),
            Attribute::LogitOpacity => &self.logit_opacities,
            Attribute::Color => self.colors[timestep].as_flattened(),
        }
    }

    /// Size as plain 32-bit floats: `N * (40 * T + 16)`.
    ///
    /// ```
    /// use tcgs_core::{DynamicGaussians, Gaussians};
    /// let mut scene = DynamicGaussians::default();
    /// scene.push(Gaussians::zeros(10));
    /// scene.push(Gaussians::zeros(10));
    /// assert_eq!(scene.raw_bytes(), 10 * (40 * 2 + 16));
    /// ```
    pub fn raw_bytes(&self) -> u64 {
        let per_gaussian: usize =
            Attribute::ALL.iter().map(|a| 4 * a.components() * if a.varies() { self.num_timesteps() } else { 1 }).sum();
        self.num_gaussians() as u64 * per_gaussian as u64
    }
}

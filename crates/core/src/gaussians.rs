//! One timestep of a scene, as stored.

use crate::Attribute;

/// One timestep as stored, structure of arrays. All arrays have length `N`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// `[N, 3]` centres, scene units.
    pub means: Vec<[f32; 3]>,
    /// `[N, 4]` rotations, `w, x, y, z`, unnormalised.
    pub quats: Vec<[f32; 4]>,
    /// `[N, 3]` logarithms of the standard deviations.
    pub log_scales: Vec<[f32; 3]>,
    /// `[N]` inverse logistic of the opacities.
    pub logit_opacities: Vec<f32>,
    /// `[N, 3]` raw sRGB.
    pub colors: Vec<[f32; 3]>,
}

impl Gaussians {
    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.means.len()
    }

    /// All values of one attribute, `[N * components]`.
    pub fn values(&self, attribute: Attribute) -> &[f32] {
        match attribute {
            Attribute::Mean => self.means.as_flattened(),
            Attribute::Quat => self.quats.as_flattened(),
            Attribute::LogScale => self.log_scales.as_flattened(),
            Attribute::LogitOpacity => &self.logit_opacities,
            Attribute::Color => self.colors.as_flattened(),
        }
    }

    /// All values of one attribute, to change in place.
    pub fn values_mut(&mut self, attribute: Attribute) -> &mut [f32] {
        match attribute {
            Attribute::Mean => self.means.as_flattened_mut(),
            Attribute::Quat => self.quats.as_flattened_mut(),
            Attribute::LogScale => self.log_scales.as_flattened_mut(),
            Attribute::LogitOpacity => &mut self.logit_opacities,
            Attribute::Color => self.colors.as_flattened_mut(),
        }
    }

    /// `N` Gaussians with every stored value zero: the shape that gradients start from.
    pub fn zeros(num_gaussians: usize) -> Self {
        Self {
            means: vec![[0.0; 3]; num_gaussians],
            quats: vec![[0.0; 4]; num_gaussians],
            log_scales: vec![[0.0; 3]; num_gaussians],
            logit_opacities: vec![0.0; num_gaussians],
            colors: vec![[0.0; 3]; num_gaussians],
        }
    }

    /// The Gaussians at `indices`, in that order.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            means: indices.iter().map(|&i| self.means[i]).collect(),
            quats: indices.iter().map(|&i| self.quats[i]).collect(),
            log_scales: indices.iter().map(|&i| self.log_scales[i]).collect(),
            logit_opacities: indices.iter().map(|&i| self.logit_opacities[i]).collect(),
            colors: indices.iter().map(|&i| self.colors[i]).collect(),
        }
    }
}

/// The coloured points that training starts from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// `[P, 3]` positions, scene units.
    pub points: Vec<[f32; 3]>,
    /// `[P, 3]` sRGB in `[0, 1]`.
    pub colors: Vec<[f32; 3]>,
    /// `[P]` whether a point belongs to what moves (the segmentation's foreground).
    pub foreground: Vec<bool>,
}

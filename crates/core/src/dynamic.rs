//! A whole scene over time, in memory.

use std::sync::Arc;

use crate::columns::select_rows;
use crate::{Attribute, Gaussians, Layout};

/// All timesteps of a scene. A column that varies by its layout has a value for every timestep. Any other column has
/// either one value per timestep or one for all; training leaves one for all.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// for timestep in 0..3 {
///     let mut gaussians = Gaussians::zeros(2);
///     gaussians.means_mut()[1] = [timestep as f32, 0.0, 0.0];
///     scene.push(gaussians);
/// }
/// assert_eq!((scene.num_timesteps(), scene.means(2)[1][0]), (3, 2.0));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct DynamicGaussians {
    layout: Arc<Layout>,
    num_gaussians: usize,
    num_timesteps: usize,
    /// Indexed by [`Attribute::index`]: `[1 or T][N * components]`.
    samples: Vec<Vec<Vec<f32>>>,
}

impl Default for DynamicGaussians {
    /// No timestep, of the columns of [`Layout::base`].
    fn default() -> Self {
        Self::new(Layout::base())
    }
}

impl DynamicGaussians {
    /// No timestep yet, of the columns of `layout`.
    pub fn new(layout: Arc<Layout>) -> Self {
        let samples = vec![Vec::new(); layout.columns().len()];
        Self { layout, num_gaussians: 0, num_timesteps: 0, samples }
    }

    /// A scene from its samples.
    ///
    /// - `num_timesteps`: `T`, at least 1
    /// - `samples`: by [`Attribute::index`], `[T][N * components]`, or `[1][…]` of a column that does not vary
    ///
    /// # Panics
    /// If the samples do not fit the layout, `T` or one another.
    pub fn from_samples(layout: Arc<Layout>, num_timesteps: usize, samples: Vec<Vec<Vec<f32>>>) -> Self {
        assert_eq!(samples.len(), layout.columns().len(), "sampled columns against {layout}");
        let num_gaussians = samples[0].first().map_or(0, |values| values.len() / layout.columns()[0].components());
        for (column, samples) in layout.columns().iter().zip(&samples) {
            let (name, components) = (&column.name, column.components());
            let is_once = samples.len() == 1 && !column.varies;
            assert!(
                samples.len() == num_timesteps || is_once,
                "{} samples of {name} at {num_timesteps} timesteps",
                samples.len()
            );
            for values in samples {
                assert_eq!(values.len(), num_gaussians * components, "{name} against [{num_gaussians}, {components}]");
            }
        }
        Self { layout, num_gaussians, num_timesteps, samples }
    }

    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        self.num_timesteps
    }

    /// Which columns there are.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// Whether an attribute has a value for every timestep rather than one for all.
    pub fn varies(&self, attribute: Attribute) -> bool {
        self.layout.column(attribute).varies || self.samples[attribute.index()].len() > 1
    }

    /// Number of timesteps at which an attribute is stored: `T`, or 1 if it does not vary.
    pub fn num_samples(&self, attribute: Attribute) -> usize {
        if self.varies(attribute) { self.num_timesteps() } else { 1 }
    }

    /// The scene at one timestep.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`].
    pub fn at(&self, timestep: usize) -> Gaussians {
        let values = self.layout.attributes().map(|a| self.values(a, timestep).to_vec()).collect();
        Gaussians::new(Arc::clone(&self.layout), self.num_gaussians, values)
    }

    /// Appends a timestep. A column that does not vary by the layout starts to vary at the first timestep in which a
    /// bit of it differs.
    ///
    /// # Panics
    /// If the columns or the number of Gaussians differ from the timesteps already there.
    pub fn push(&mut self, gaussians: Gaussians) {
        let (n, t) = (gaussians.num_gaussians(), self.num_timesteps);
        assert!(t == 0 || n == self.num_gaussians, "a timestep of {n} Gaussians after {}", self.num_gaussians);
        assert_eq!(*gaussians.layout(), self.layout, "columns of a timestep against those before");
        let layout = Arc::clone(&self.layout);
        for (column, (samples, values)) in
            layout.columns().iter().zip(self.samples.iter_mut().zip(gaussians.into_values()))
        {
            if column.varies {
                samples.push(values);
            } else {
                push_sample(samples, values, t);
            }
        }
        (self.num_gaussians, self.num_timesteps) = (n, t + 1);
    }

    /// The Gaussians at `indices`, in that order, at every timestep.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        let select = |a: Attribute| -> Vec<Vec<f32>> {
            self.samples[a.index()].iter().map(|values| select_rows(values, a.components(), indices)).collect()
        };
        Self {
            layout: Arc::clone(&self.layout),
            num_gaussians: indices.len(),
            num_timesteps: self.num_timesteps,
            samples: self.layout.attributes().map(select).collect(),
        }
    }

    /// All values of one attribute at one timestep, `[N * components]`; `timestep` does not matter
    /// for an attribute that does not vary.
    ///
    /// # Panics
    /// If `timestep` is out of range for one that does.
    pub fn values(&self, attribute: Attribute, timestep: usize) -> &[f32] {
        match self.samples[attribute.index()].as_slice() {
            [all] if !self.varies(attribute) => all,
            samples => &samples[timestep],
        }
    }

    /// All values of one attribute at one timestep, to change in place; of one that does not vary, those of all
    /// timesteps.
    ///
    /// # Panics
    /// If `timestep` is out of range for one that varies.
    pub fn values_mut(&mut self, attribute: Attribute, timestep: usize) -> &mut [f32] {
        let sample = if self.varies(attribute) { timestep } else { 0 };
        &mut self.samples[attribute.index()][sample]
    }

    /// All stored values of one attribute: `[T][N * components]`, or `[1][…]` if it does not vary.
    pub fn samples(&self, attribute: Attribute) -> &[Vec<f32>] {
        &self.samples[attribute.index()]
    }

    /// `[N, 3]` centres at one timestep, scene units; see [`Self::values`].
    pub fn means(&self, timestep: usize) -> &[[f32; 3]] {
        self.values(Attribute::Mean, timestep).as_chunks().0
    }

    /// [`Self::means`], to change in place; see [`Self::values_mut`].
    pub fn means_mut(&mut self, timestep: usize) -> &mut [[f32; 3]] {
        self.values_mut(Attribute::Mean, timestep).as_chunks_mut().0
    }

    /// `[N, 4]` rotations at one timestep, `w, x, y, z`, unnormalised; see [`Self::values`].
    pub fn quats(&self, timestep: usize) -> &[[f32; 4]] {
        self.values(Attribute::Quat, timestep).as_chunks().0
    }

    /// [`Self::quats`], to change in place; see [`Self::values_mut`].
    pub fn quats_mut(&mut self, timestep: usize) -> &mut [[f32; 4]] {
        self.values_mut(Attribute::Quat, timestep).as_chunks_mut().0
    }

    /// `[N, 3]` logarithms of the standard deviations at one timestep; see [`Self::values`].
    pub fn log_scales(&self, timestep: usize) -> &[[f32; 3]] {
        self.values(Attribute::LogScale, timestep).as_chunks().0
    }

    /// [`Self::log_scales`], to change in place; see [`Self::values_mut`].
    pub fn log_scales_mut(&mut self, timestep: usize) -> &mut [[f32; 3]] {
        self.values_mut(Attribute::LogScale, timestep).as_chunks_mut().0
    }

    /// `[N]` inverse logistic of the opacities at one timestep; see [`Self::values`].
    pub fn logit_opacities(&self, timestep: usize) -> &[f32] {
        self.values(Attribute::LogitOpacity, timestep)
    }

    /// [`Self::logit_opacities`], to change in place; see [`Self::values_mut`].
    pub fn logit_opacities_mut(&mut self, timestep: usize) -> &mut [f32] {
        self.values_mut(Attribute::LogitOpacity, timestep)
    }

    /// `[N, 3]` raw sRGB at one timestep; see [`Self::values`].
    pub fn colors(&self, timestep: usize) -> &[[f32; 3]] {
        self.values(Attribute::Color, timestep).as_chunks().0
    }

    /// [`Self::colors`], to change in place; see [`Self::values_mut`].
    pub fn colors_mut(&mut self, timestep: usize) -> &mut [[f32; 3]] {
        self.values_mut(Attribute::Color, timestep).as_chunks_mut().0
    }

    /// Size as plain 32-bit floats: `N * (40 * T + 16)`, if scales and opacities do not vary.
    ///
    /// ```
    /// use tcgs_core::{DynamicGaussians, Gaussians};
    /// let mut scene = DynamicGaussians::default();
    /// scene.push(Gaussians::zeros(10));
    /// scene.push(Gaussians::zeros(10));
    /// assert_eq!(scene.raw_bytes(), 10 * (40 * 2 + 16));
    /// ```
    pub fn raw_bytes(&self) -> u64 {
        let per_gaussian: usize = self.layout.attributes().map(|a| 4 * a.components() * self.num_samples(a)).sum();
        self.num_gaussians() as u64 * per_gaussian as u64
    }
}

/// Appends the sample of timestep `timestep` to `[1 or T]` samples, compared by their bits: what is stored once must
/// come back as it was.
fn push_sample(samples: &mut Vec<Vec<f32>>, sample: Vec<f32>, timestep: usize) {
    if let [all] = samples.as_slice() {
        if all.iter().map(|x| x.to_bits()).eq(sample.iter().map(|x| x.to_bits())) {
            return;
        }
        let all = all.clone();
        samples.resize(timestep, all);
    }
    samples.push(sample);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_and_opacities_vary_from_the_timestep_on_in_which_they_differ() {
        let still = Gaussians::zeros(2);
        let mut scene = DynamicGaussians::default();
        for _ in 0..3 {
            scene.push(still.clone());
        }
        assert!(!scene.varies(Attribute::LogScale) && scene.num_samples(Attribute::LogScale) == 1);
        let mut grown = still.clone();
        grown.log_scales_mut()[1][2] = 0.5;
        scene.push(grown.clone());
        scene.push(still.clone());
        assert_eq!(scene.num_timesteps(), 5);
        assert_eq!(Attribute::BASE.map(|a| scene.num_samples(a)), [5, 5, 5, 1, 5]);
        assert_eq!([2, 3, 4].map(|t| scene.at(t)), [still.clone(), grown.clone(), still.clone()]);
        assert_eq!(scene.values(Attribute::LogScale, 3), [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
        assert_eq!(scene.values(Attribute::LogitOpacity, 3), [0.0, 0.0]);
        assert_eq!(scene.raw_bytes(), 2 * (52 * 5 + 4));
        assert_eq!(scene.select(&[1]).at(3), grown.select(&[1]));
        // Zeros of either sign are equal, but not the same.
        let mut negative = still.clone();
        negative.logit_opacities_mut()[0] = -0.0;
        let mut scene = DynamicGaussians::default();
        scene.push(still);
        scene.push(negative);
        assert!(scene.varies(Attribute::LogitOpacity) && scene.at(1).logit_opacities()[0].is_sign_negative());
    }

    #[test]
    #[should_panic(expected = "a timestep of 3 Gaussians after 2")]
    fn the_number_of_gaussians_stays() {
        let mut scene = DynamicGaussians::default();
        scene.push(Gaussians::zeros(2));
        scene.push(Gaussians::zeros(3));
    }
}

//! A whole scene over time.

use crate::{Attribute, Gaussians};

/// All timesteps of a scene. Means, rotations and colours have a value for every timestep; scales and
/// opacities one for each or one for all. Training leaves one for all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DynamicGaussians {
    /// `[T][N, 3]` centres, scene units.
    pub means: Vec<Vec<[f32; 3]>>,
    /// `[T][N, 4]` rotations, `w, x, y, z`, unnormalised.
    pub quats: Vec<Vec<[f32; 4]>>,
    /// `[T][N, 3]` raw sRGB.
    pub colors: Vec<Vec<[f32; 3]>>,
    /// `[1 or T][N, 3]` logarithms of the standard deviations.
    pub log_scales: Vec<Vec<[f32; 3]>>,
    /// `[1 or T][N]` inverse logistic of the opacities.
    pub logit_opacities: Vec<Vec<f32>>,
}

impl DynamicGaussians {
    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.means.first().map_or(0, Vec::len)
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        self.means.len()
    }

    /// Whether an attribute has a value for every timestep rather than one for all.
    pub fn varies(&self, attribute: Attribute) -> bool {
        match attribute {
            Attribute::Mean | Attribute::Quat | Attribute::Color => true,
            Attribute::LogScale => self.log_scales.len() > 1,
            Attribute::LogitOpacity => self.logit_opacities.len() > 1,
        }
    }

    /// At how many timesteps an attribute is held: `T`, or 1 if it does not vary.
    pub fn num_samples(&self, attribute: Attribute) -> usize {
        if self.varies(attribute) { self.num_timesteps() } else { 1 }
    }

    /// The scene at one timestep.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`].
    pub fn at(&self, timestep: usize) -> Gaussians {
        Gaussians {
            means: self.means[timestep].clone(),
            quats: self.quats[timestep].clone(),
            log_scales: sample(&self.log_scales, timestep).clone(),
            logit_opacities: sample(&self.logit_opacities, timestep).clone(),
            colors: self.colors[timestep].clone(),
        }
    }

    /// Appends a timestep. Scales, and likewise opacities, begin to vary with the first timestep in which a
    /// bit of them differs.
    ///
    /// # Panics
    /// If the number of Gaussians differs from the timesteps already there.
    pub fn push(&mut self, gaussians: Gaussians) {
        let (n, t) = (gaussians.means.len(), self.num_timesteps());
        assert!(t == 0 || n == self.num_gaussians(), "a timestep of {n} Gaussians after {}", self.num_gaussians());
        push_sample(&mut self.log_scales, gaussians.log_scales, t, <[[f32; 3]]>::as_flattened);
        push_sample(&mut self.logit_opacities, gaussians.logit_opacities, t, |values| values);
        self.means.push(gaussians.means);
        self.quats.push(gaussians.quats);
        self.colors.push(gaussians.colors);
    }

    /// The Gaussians at `indices`, in that order, at every timestep.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        fn pick<T: Copy>(of: &[Vec<T>], indices: &[usize]) -> Vec<Vec<T>> {
            of.iter().map(|values| indices.iter().map(|&i| values[i]).collect()).collect()
        }
        Self {
            means: pick(&self.means, indices),
            quats: pick(&self.quats, indices),
            colors: pick(&self.colors, indices),
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
            Attribute::LogScale => sample(&self.log_scales, timestep).as_flattened(),
            Attribute::LogitOpacity => sample(&self.logit_opacities, timestep),
            Attribute::Color => self.colors[timestep].as_flattened(),
        }
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
        let per_gaussian: usize = Attribute::ALL.iter().map(|&a| 4 * a.components() * self.num_samples(a)).sum();
        self.num_gaussians() as u64 * per_gaussian as u64
    }
}

/// Of `[1 or T]` samples the one that holds at a timestep.
fn sample<V>(samples: &[Vec<V>], timestep: usize) -> &Vec<V> {
    match samples {
        [all] => all,
        _ => &samples[timestep],
    }
}

/// Appends the sample of timestep `timestep` to `[1 or T]` samples.
///
/// - `floats`: a sample as numbers, compared by their bits: what is stored once must come back as it was
fn push_sample<V: Clone>(samples: &mut Vec<Vec<V>>, sample: Vec<V>, timestep: usize, floats: impl Fn(&[V]) -> &[f32]) {
    if let [all] = samples.as_slice() {
        if floats(all).iter().map(|x| x.to_bits()).eq(floats(&sample).iter().map(|x| x.to_bits())) {
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
        assert_eq!((scene.log_scales.len(), scene.num_samples(Attribute::LogScale)), (1, 1));
        let mut grown = still.clone();
        grown.log_scales[1][2] = 0.5;
        scene.push(grown.clone());
        scene.push(still.clone());
        assert_eq!(scene.num_timesteps(), 5);
        assert_eq!(Attribute::ALL.map(|a| scene.num_samples(a)), [5, 5, 5, 1, 5]);
        assert_eq!([2, 3, 4].map(|t| scene.at(t)), [still.clone(), grown.clone(), still.clone()]);
        assert_eq!(scene.values(Attribute::LogScale, 3), [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
        assert_eq!(scene.values(Attribute::LogitOpacity, 3), [0.0, 0.0]);
        assert_eq!(scene.raw_bytes(), 2 * (52 * 5 + 4));
        assert_eq!(scene.select(&[1]).at(3), grown.select(&[1]));
        // Zeros of either sign are equal, but not the same.
        let mut negative = still.clone();
        negative.logit_opacities[0] = -0.0;
        let mut scene = DynamicGaussians::default();
        scene.push(still);
        scene.push(negative);
        assert!(scene.varies(Attribute::LogitOpacity) && scene.at(1).logit_opacities[0].is_sign_negative());
    }

    #[test]
    #[should_panic(expected = "a timestep of 3 Gaussians after 2")]
    fn the_number_of_gaussians_stays() {
        let mut scene = DynamicGaussians::default();
        scene.push(Gaussians::zeros(2));
        scene.push(Gaussians::zeros(3));
    }
}

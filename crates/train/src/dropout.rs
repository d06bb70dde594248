//! Dropout: iterations of the first timestep and of a refinement leave out Gaussians at random, so that none relies on
//! a certain other one (Park et al. 2025, DropGaussian). Where few cameras see a place, this keeps Gaussians from
//! fitting single images.

/// The Gaussians that one iteration leaves out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dropout {
    /// Share of the Gaussians, below 1; 0 leaves out none.
    pub share: f32,
    /// Number of the random draw.
    pub draw: u32,
}

impl Dropout {
    /// The factor of a Gaussian's opacity: 0 for one that is left out. The others make up for these, so that the
    /// factor's mean is 1.
    pub fn factor(self, gaussian: u32) -> f32 {
        if unit(gaussian, self.draw) < self.share { 0.0 } else { 1.0 / (1.0 - self.share) }
    }
}

/// A random number in `[0, 1)` (PCG; Jarzynski and Olano 2020), as `dropout` in activate.wgsl draws it.
fn unit(gaussian: u32, draw: u32) -> f32 {
    let hash = |x: u32| {
        let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        (word >> 22) ^ word
    };
    (hash(gaussian.wrapping_add(hash(draw))) >> 8) as f32 / (1 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_is_left_out_and_the_mean_stays() {
        let none = Dropout::default();
        assert!((0..100).all(|i| none.factor(i) == 1.0));
        for draw in [0, 1, 777] {
            let dropout = Dropout { share: 0.2, draw };
            let factors: Vec<f32> = (0..10_000).map(|i| dropout.factor(i)).collect();
            let left_out = factors.iter().filter(|&&factor| factor == 0.0).count();
            assert!((1840..2160).contains(&left_out), "{left_out} of 10000 at a share of 0.2");
            assert!(factors.iter().all(|&factor| factor == 0.0 || factor == 1.25));
        }
        let [a, b] = [0, 1].map(|draw| Dropout { share: 0.5, draw });
        let both = (0..10_000).filter(|&i| a.factor(i) == 0.0 && b.factor(i) == 0.0).count();
        assert!((2300..2700).contains(&both), "{both} of 10000 are left out by both of two draws");
    }
}

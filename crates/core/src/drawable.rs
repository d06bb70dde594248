//! One timestep, ready to be drawn from anywhere.

use std::sync::Arc;

use crate::parallel::map;
use crate::{Activated, Camera, Gaussians, activate, color_in_direction, length, sub};

/// One timestep, activated once. With spherical harmonics each camera sees its own colours; without them all see the
/// same.
///
/// ```
/// use std::sync::Arc;
/// use tcgs_core::{Camera, Drawable, Gaussians, Layout};
/// let camera = |z| Camera::look_at([0.0, 0.0, z], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let same = Drawable::new(&Gaussians::zeros(1));
/// assert!(Arc::ptr_eq(&same.seen_by(&camera(-2.0)), &same.seen_by(&camera(2.0))));
///
/// let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(1), 1);
/// let sh1 = gaussians.layout().find("sh1").unwrap();
/// gaussians.values_mut(sh1)[3] = 1.0; // red, with the harmonic that grows along z
/// let other = Drawable::new(&gaussians);
/// assert!(other.seen_by(&camera(-2.0)).colors[0] > 0.4);
/// assert_eq!(other.seen_by(&camera(2.0)).colors[0], 0.0);
/// ```
#[derive(Clone, Debug)]
pub struct Drawable {
    /// With the colours of degree 0.
    activated: Arc<Activated>,
    /// Coefficients of the degrees from 1 on, `[N, 2 l + 1, 3]` each.
    bands: Vec<Vec<f32>>,
}

impl Drawable {
    /// Activates a timestep.
    pub fn new(gaussians: &Gaussians) -> Self {
        let bands = gaussians.layout().harmonics().into_iter().map(|band| gaussians.values(band).to_vec()).collect();
        Self { activated: Arc::new(activate(gaussians)), bands }
    }

    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.activated.num_gaussians()
    }

    /// The Gaussians as a camera sees them. Without harmonics they are always the same, and shared. With harmonics the
    /// colours are those in the directions from the camera to the centres, at least 0 ([`color_in_direction`]).
    ///
    /// Computed in `f64` and then rounded: other implementations are compared with this one.
    pub fn seen_by(&self, camera: &Camera) -> Arc<Activated> {
        if self.bands.is_empty() {
            return Arc::clone(&self.activated);
        }
        let position = camera.center();
        let all: Vec<usize> = (0..self.num_gaussians()).collect();
        let colors = map(&all, |&i| self.color(i, position)).into_flattened();
        Arc::new(Activated { colors, ..(*self.activated).clone() })
    }

    /// Colour of Gaussian `i` as seen from a position in the world.
    fn color(&self, i: usize, position: [f64; 3]) -> [f32; 3] {
        let (mean, color) = (self.activated.means[i], &self.activated.colors[3 * i..3 * i + 3]);
        let offset = sub(mean.map(f64::from), position);
        let distance = length(offset);
        // A Gaussian around the camera has no direction; it is nearer than any drawn one.
        let direction = if distance > 0.0 { offset.map(|x| x / distance) } else { [0.0; 3] };
        let mut sh = Vec::new();
        for band in &self.bands {
            let components = band.len() / self.num_gaussians();
            let row = &band[i * components..(i + 1) * components];
            sh.extend(row.as_chunks::<3>().0.iter().map(|sh| sh.map(f64::from)));
        }
        let color = std::array::from_fn(|channel| f64::from(color[channel]));
        color_in_direction(color, &sh, direction).map(|x| x as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BaseColumns, Layout, harmonics, normalize};

    fn camera(position: [f64; 3]) -> Camera {
        Camera::look_at(position, [0.0, 0.1, 0.0], [0.0, -1.0, 0.0], 50.0, 64, 48)
    }

    fn base() -> Gaussians {
        Gaussians::from(BaseColumns {
            means: vec![[0.1, 0.2, 0.3], [-0.4, 0.5, 0.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0], [0.3, 0.1, -2.0, 0.2]],
            log_scales: vec![[-1.0, -2.0, 0.5], [0.1, 0.2, 0.3]],
            logit_opacities: vec![0.7, -0.2],
            colors: vec![[-0.2, 0.4, 0.6], [0.9, 0.1, 1.7]],
        })
    }

    /// The colour of a Gaussian from its definition, for degree 3 with every coefficient different.
    #[test]
    fn every_coefficient_counts_where_it_stands() {
        let mut gaussians = base().extended(&Layout::with_harmonics(3));
        for (degree, band) in (1..).zip(gaussians.layout().harmonics()) {
            for (i, value) in gaussians.values_mut(band).iter_mut().enumerate() {
                *value = 0.05 * (i as f32 + degree as f32).sin();
            }
        }
        let position = [0.5, -0.7, -2.0];
        let seen = Drawable::new(&gaussians).seen_by(&camera(position));
        let plain = activate(&gaussians);
        assert_eq!((&seen.means, &seen.quats, &seen.scales), (&plain.means, &plain.quats, &plain.scales));
        assert_eq!(seen.opacities, plain.opacities);
        for i in 0..2 {
            let values = harmonics(normalize(sub(gaussians.means()[i].map(f64::from), position)));
            for channel in 0..3 {
                let mut sum = f64::from(gaussians.colors()[i][channel]);
                for l in 1..=3_usize {
                    let band = gaussians.layout().find(&format!("sh{l}")).unwrap();
                    for m in 0..2 * l + 1 {
                        let sh = gaussians.values(band)[(i * (2 * l + 1) + m) * 3 + channel];
                        sum += values[l * l + m] * f64::from(sh);
                    }
                }
                let found = f64::from(seen.colors[3 * i + channel]);
                assert!((found - sum.max(0.0)).abs() < 1e-7, "{i} {channel}: {found} against {sum}");
            }
        }
    }

    #[test]
    fn without_harmonics_every_bit_stays() {
        let drawable = Drawable::new(&base());
        let seen = drawable.seen_by(&camera([0.0, 0.0, -3.0]));
        assert_eq!(*seen, activate(&base()));
        assert!(seen.colors[0] < 0.0, "colours below zero are not clamped");
        assert!(Arc::ptr_eq(&seen, &drawable.seen_by(&camera([1.0, 0.0, -3.0]))));
    }

    #[test]
    fn a_camera_in_the_centre_sees_degree_0() {
        let mut gaussians = base().extended(&Layout::with_harmonics(2));
        for band in gaussians.layout().harmonics() {
            gaussians.values_mut(band).fill(0.3);
        }
        gaussians.means_mut()[1] = [0.0, 0.0, -3.0];
        let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
        assert_eq!(camera.center(), [0.0, 0.0, -3.0]);
        let seen = Drawable::new(&gaussians).seen_by(&camera);
        assert_eq!(seen.colors[3..], gaussians.colors()[1]);
        assert_eq!(Drawable::new(&gaussians.select(&[])).seen_by(&camera).num_gaussians(), 0);
    }
}

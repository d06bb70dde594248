//! The colours of a timestep's Gaussians as one camera sees them, forward and backward, for training.
//!
//! [`Drawable`](crate::Drawable) computes the same in `f64`, without gradients, for comparisons.

use crate::parallel::{for_each_row, map};
use crate::{Attribute, Camera, GaussianGrads, Gaussians, color_in_direction, color_in_direction_vjp, harmonics};
use crate::{normalize, normalize_vjp, sub};

/// Most coefficients of a channel, for the degrees from 1 on.
const MAX_COEFFICIENTS: usize = 15;

/// The inputs of a timestep's spherical harmonics.
struct Seen<'a> {
    gaussians: &'a Gaussians,
    /// Values of each band with its coefficients of a channel.
    bands: Vec<(&'a [f32], usize)>,
    /// Position of the camera in the world.
    position: [f64; 3],
}

impl<'a> Seen<'a> {
    fn new(gaussians: &'a Gaussians, camera: &Camera) -> Self {
        let band = |band: Attribute| (gaussians.values(band), band.components() / 3);
        let bands = gaussians.layout().harmonics().into_iter().map(band).collect();
        Self { gaussians, bands, position: camera.center() }
    }

    /// Vector from the camera to the centre of Gaussian `i`.
    fn offset(&self, i: usize) -> [f32; 3] {
        sub(self.gaussians.means()[i].map(f64::from), self.position).map(|x| x as f32)
    }

    /// Coefficients of Gaussian `i`, and their number per channel.
    fn coefficients(&self, i: usize) -> ([[f32; 3]; MAX_COEFFICIENTS], usize) {
        let (mut sh, mut count) = ([[0.0; 3]; MAX_COEFFICIENTS], 0);
        for &(values, num) in &self.bands {
            sh[count..count + num].copy_from_slice(&values.as_chunks::<3>().0[i * num..(i + 1) * num]);
            count += num;
        }
        (sh, count)
    }
}

/// Colours that a camera sees: in the direction from it to the centres, at least 0 ([`color_in_direction`]). For
/// layouts with harmonics only; without harmonics, colours are drawn as stored, and negative ones stay.
///
/// - `gaussians`: stored form
/// - returns: `[N, 3]`, in place of [`Activated::colors`](crate::Activated::colors)
///
/// ```
/// use tcgs_core::{Camera, Gaussians, Layout, seen_colors};
/// let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(1), 1);
/// let sh1 = gaussians.layout().find("sh1").unwrap();
/// gaussians.values_mut(sh1)[3] = 1.0; // red, with the harmonic that grows along z
/// let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// assert!((seen_colors(&gaussians, &camera)[0] - 0.4886).abs() < 1e-4);
/// ```
pub fn seen_colors(gaussians: &Gaussians, camera: &Camera) -> Vec<f32> {
    let seen = Seen::new(gaussians, camera);
    let stored = gaussians.colors();
    let mut colors = vec![0.0; 3 * gaussians.num_gaussians()];
    for_each_row(&mut colors, 3, |i, row| {
        let (sh, count) = seen.coefficients(i);
        row.copy_from_slice(&color_in_direction(stored[i], &sh[..count], normalize(seen.offset(i))));
    });
    colors
}

/// Backward of [`seen_colors`]. *Overwrites* the gradients of the colours and of the harmonics, and *accumulates* to
/// those of the means, on which the direction depends.
///
/// - `gaussians`, `camera`: as given to `seen_colors`
/// - `v_gaussians`: comes in with the gradient to the colours seen in the place of the colours
pub fn seen_colors_bwd(gaussians: &Gaussians, camera: &Camera, v_gaussians: &mut GaussianGrads) {
    let seen = Seen::new(gaussians, camera);
    let (stored, v_seen) = (gaussians.colors(), v_gaussians.colors());
    let all: Vec<usize> = (0..gaussians.num_gaussians()).collect();
    let back = map(&all, |&i| {
        if v_seen[i] == [0.0; 3] {
            return ([0.0; 3], [0.0; 3]);
        }
        let ((sh, count), offset) = (seen.coefficients(i), seen.offset(i));
        let (v_sum, v_direction) = color_in_direction_vjp(stored[i], &sh[..count], normalize(offset), v_seen[i]);
        (v_sum, normalize_vjp(offset, v_direction))
    });
    for (v_color, (v_sum, _)) in v_gaussians.colors_mut().iter_mut().zip(&back) {
        *v_color = *v_sum;
    }
    for (v_mean, (_, v_offset)) in v_gaussians.means_mut().iter_mut().zip(&back) {
        *v_mean = std::array::from_fn(|axis| v_mean[axis] + v_offset[axis]);
    }
    let mut first = 1;
    for band in gaussians.layout().harmonics() {
        let num = band.components() / 3;
        for_each_row(v_gaussians.values_mut(band), band.components(), |i, row| {
            let v_sum = back[i].0;
            if v_sum == [0.0; 3] {
                row.fill(0.0);
                return;
            }
            let values = harmonics(normalize(seen.offset(i)));
            for (v_sh, value) in row.as_chunks_mut::<3>().0.iter_mut().zip(&values[first..first + num]) {
                *v_sh = v_sum.map(|v| value * v);
            }
        });
        first += num;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BaseColumns, Drawable, Layout};

    fn some(degree: usize) -> Gaussians {
        let mut gaussians = Gaussians::from(BaseColumns {
            means: vec![[0.1, 0.2, 0.3], [-0.4, 0.5, 0.0], [0.7, -0.2, -0.9]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            log_scales: vec![[-1.0; 3]; 3],
            logit_opacities: vec![0.7; 3],
            colors: vec![[0.2, 0.4, 0.6], [0.9, -5.0, 1.7], [0.5, 0.5, 0.5]],
        })
        .extended(&Layout::with_harmonics(degree));
        for (l, band) in gaussians.layout().harmonics().into_iter().enumerate() {
            for (i, value) in gaussians.values_mut(band).iter_mut().enumerate() {
                *value = 0.05 * ((i + l) as f32).sin();
            }
        }
        gaussians
    }

    fn camera() -> Camera {
        Camera::look_at([0.4, -0.3, -2.0], [0.0, 0.1, 0.0], [0.0, -1.0, 0.0], 50.0, 64, 48)
    }

    #[test]
    fn colours_are_those_of_the_oracle() {
        for degree in 1..=3 {
            let gaussians = some(degree);
            let expected = Drawable::new(&gaussians).seen_by(&camera());
            let found = seen_colors(&gaussians, &camera());
            let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
            assert!(found.len() == 9 && found.iter().zip(&expected.colors).all(near), "degree {degree}: {found:?}");
            assert_eq!(found[4], 0.0);
        }
    }

    #[test]
    fn backward_matches_central_differences() {
        let v_seen = [0.3, -0.5, 0.2, 0.9, 1.5, -0.7, 0.0, 0.0, 0.0];
        for degree in 1..=3 {
            let gaussians = some(degree);
            let loss = |gaussians: &Gaussians| -> f64 {
                let seen = seen_colors(gaussians, &camera());
                seen.iter().zip(v_seen).map(|(x, v)| f64::from(*x) * f64::from(v)).sum()
            };
            let mut v = GaussianGrads::zeros_of(gaussians.layout(), 3);
            v.values_mut(Attribute::Color).copy_from_slice(&v_seen);
            v.means_mut()[2] = [7.0; 3];
            seen_colors_bwd(&gaussians, &camera(), &mut v);
            assert_eq!(v.means()[2], [7.0; 3], "accumulates, and an unseen Gaussian gets nothing");
            let columns = [Attribute::Mean, Attribute::Color].into_iter().chain(gaussians.layout().harmonics());
            for attribute in columns {
                for i in 0..2 * attribute.components() {
                    let at = |by: f32| {
                        let mut moved = gaussians.clone();
                        moved.values_mut(attribute)[i] += by;
                        loss(&moved)
                    };
                    let difference = (at(1e-2) - at(-1e-2)) / 2e-2;
                    let gradient = f64::from(v.values(attribute)[i]);
                    let difference_of = (difference - gradient).abs();
                    assert!(difference_of < 1e-4, "{degree}, {attribute:?} {i}: {difference} against {gradient}");
                }
            }
        }
    }
}

//! Directions of the axes: files of other programs in the axes of PLY files, and back.
//!
//! PLY files of 3D Gaussian splatting have the axes of COLMAP's cameras: x right, y down, z forward (RDF). Scenes here
//! have these axes, too. glTF has LUF (`y` is up, a model looks along `z`), OpenGL has RUB. SPZ files have any. Letters
//! say where an axis points: right or left, up or down, forward or back.

use std::fmt;
use std::str::FromStr;

use tcgs_core::{Gaussians, harmonics};

/// Directions of a file's axes, as three letters: right or left, up or down, forward or back.
///
/// ```
/// use tcgs_interchange::Axes;
/// assert_eq!("rub".parse(), Ok(Axes::RUB));
/// assert_eq!(Axes::RDF.to_string(), "rdf");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axes([bool; 3]);

/// Letters of each axis: of the direction in PLY files, and of the opposite one.
const LETTERS: [[char; 2]; 3] = [['r', 'l'], ['d', 'u'], ['f', 'b']];

impl Axes {
    /// Right, down, forward: PLY files, and scenes here.
    pub const RDF: Self = Self([false; 3]);
    /// Left, up, forward: glTF.
    pub const LUF: Self = Self([true, true, false]);
    /// Right, up, back: OpenGL, and SPZ according to its README.
    pub const RUB: Self = Self([false, true, true]);

    /// Each of the eight.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        (0..8).map(|bits| Self([bits & 1 != 0, bits & 2 != 0, bits & 4 != 0]))
    }

    /// Whether x points left, y up, and z back: against those of [`Self::RDF`].
    pub(crate) fn against_rdf(self) -> [bool; 3] {
        self.0
    }

    /// Rotates Gaussians from these axes to those of PLY files or back: the signs are the same.
    ///
    /// Nothing is rounded. The axes of a Gaussian itself rotate too, which does not change its shape.
    pub(crate) fn turn(self, gaussians: &mut Gaussians) {
        if self == Self::RDF {
            return;
        }
        let signs = self.0.map(|against| if against { -1.0_f32 } else { 1.0 });
        let [x, y, z] = signs;
        let base = gaussians.views_mut();
        for mean in base.means {
            *mean = std::array::from_fn(|c| mean[c] * signs[c]);
        }
        // F R F of a reflection F is a rotation; its axis is that of R times det(F) F.
        for [_, i, j, k] in base.quats {
            (*i, *j, *k) = (*i * y * z, *j * x * z, *k * x * y);
        }
        // Each harmonic is even or odd in each coordinate, so it keeps or changes its sign. No harmonic vanishes there.
        let direction = [0.48, 0.6, 0.64];
        let turned = std::array::from_fn(|c| direction[c] * signs[c]);
        let (before, after) = (harmonics(direction), harmonics(turned));
        for (l, band) in (1..).zip(gaussians.layout().harmonics()) {
            let values = gaussians.values_mut(band).as_chunks_mut::<3>().0;
            let of_band = l * l..(l + 1) * (l + 1);
            for (i, sh) in of_band.cycle().zip(values) {
                if before[i] * after[i] < 0.0 {
                    *sh = sh.map(|coefficient| -coefficient);
                }
            }
        }
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let letters = self.0.iter().zip(LETTERS).map(|(against, [along, other])| if *against { other } else { along });
        f.write_str(&letters.collect::<String>())
    }
}

impl FromStr for Axes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::all()
            .find(|axes| axes.to_string().eq_ignore_ascii_case(text))
            .ok_or_else(|| format!("{text:?} is no set of axes, expected three letters such as rdf, rub or luf"))
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Layout, color_in_direction, rotmat_from_quat};

    use super::*;

    /// `R S Sᵀ Rᵀ` of a Gaussian.
    fn covariance(gaussians: &Gaussians, i: usize) -> [[f32; 3]; 3] {
        let rotation = rotmat_from_quat(gaussians.quats()[i]);
        let variances = gaussians.log_scales()[i].map(|s| (2.0 * s).exp());
        let entry = |r: usize, c: usize| (0..3).map(|k| rotation[r][k] * variances[k] * rotation[c][k]).sum();
        std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)))
    }

    fn coefficients(gaussians: &Gaussians) -> Vec<[f32; 3]> {
        gaussians.layout().harmonics().iter().flat_map(|&band| gaussians.values(band).as_chunks().0.to_vec()).collect()
    }

    #[test]
    fn shapes_and_colours_turn_with_the_axes() {
        let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(3), 1);
        gaussians.means_mut()[0] = [1.0, 2.0, 3.0];
        gaussians.quats_mut()[0] = [0.3, -0.5, 0.7, 0.2];
        gaussians.log_scales_mut()[0] = [-1.0, 0.2, 0.9];
        for band in gaussians.layout().harmonics() {
            gaussians.values_mut(band).iter_mut().enumerate().for_each(|(i, x)| *x = (i as f32 * 1.3).sin());
        }
        for axes in Axes::all() {
            let sign: [f32; 3] = axes.0.map(|against| if against { -1.0 } else { 1.0 });
            let mut turned = gaussians.clone();
            axes.turn(&mut turned);
            assert_eq!(turned.means()[0], [sign[0], 2.0 * sign[1], 3.0 * sign[2]]);
            let (before, after) = (covariance(&gaussians, 0), covariance(&turned, 0));
            for r in 0..3 {
                for c in 0..3 {
                    assert!((after[r][c] - sign[r] * sign[c] * before[r][c]).abs() < 1e-5);
                }
            }
            for direction in [[0.6, 0.0, 0.8], [-0.36, 0.48, 0.8], [0.0, -0.6, -0.8]] {
                let there: [f32; 3] = std::array::from_fn(|c| direction[c] * sign[c]);
                let seen = color_in_direction([5.0; 3], &coefficients(&gaussians), direction);
                let seen_there = color_in_direction([5.0; 3], &coefficients(&turned), there);
                assert!((0..3).all(|c| (seen[c] - seen_there[c]).abs() < 1e-5), "{seen:?} {seen_there:?}");
            }
            axes.turn(&mut turned);
            assert_eq!(turned, gaussians);
        }
    }
}

//! Errors of decoded Gaussians against the compressed ones, for each attribute: the numbers that a file declares in
//! `INFO` (`docs/FORMAT.md`). This module does not know files.

use std::sync::Arc;

use tcgs_core::{Activation, Attribute, Column, Gaussians, Layout, SceneReader, distance, normalize};

use crate::compact::{CompactScene, unit_quat};
use crate::error::CompressError;

/// Relative and absolute margin of a declared error. Another computation in binary64 exceeds the error by at most
/// these.
const MARGIN: (f64, f64) = (1e-6, 1e-12);

/// Error of one attribute of one Gaussian, in f64.
///
/// - `original`, `decoded`: `[components]`, stored form
/// - returns, 0 or more; infinite if a value is not finite:
///   - of [`Attribute::Mean`] the distance, scene units
///   - of [`Attribute::Quat`] the angle of the rotation from one to the other, radians, at most π
///   - of an attribute with [`Activation::Sigmoid`] the largest difference of a component after the logistic function
///   - of any other the largest difference of a component in stored form
///
/// ```
/// use tcgs_codec::attribute_error;
/// use tcgs_core::{Attribute, Column};
/// let mean = Column::like(Attribute::Mean);
/// assert_eq!(attribute_error(&mean, &[0.0; 3], &[3.0, 0.0, -4.0]), 5.0);
/// // The same rotation: length and sign of a quaternion do not matter.
/// let quat = Column::like(Attribute::Quat);
/// assert_eq!(attribute_error(&quat, &[0.0, 2.0, 0.0, 0.0], &[0.0, -1.0, 0.0, 0.0]), 0.0);
/// ```
pub fn attribute_error(column: &Column, original: &[f32], decoded: &[f32]) -> f64 {
    let differences = original.iter().zip(decoded).map(|(&a, &b)| f64::from(a) - f64::from(b));
    let error = match (column.attribute, column.activation) {
        (Attribute::Mean, _) => differences.map(|d| d * d).sum::<f64>().sqrt(),
        (Attribute::Quat, _) => angle(original, decoded),
        (_, Activation::Sigmoid) => {
            let activated = original.iter().zip(decoded).map(|(&a, &b)| logistic(a) - logistic(b));
            largest(activated)
        }
        _ => largest(differences),
    };
    if error.is_nan() { f64::INFINITY } else { error }
}

/// The largest absolute value; NaN if any value is NaN.
fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most, x| if x.abs() > most || x.is_nan() { x.abs() } else { most })
}

fn logistic(x: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(x)).exp())
}

/// Angle of the rotation from one quaternion to another. Computed from the lengths of their difference and their sum:
/// the inner product of close quaternions is 1 up to rounding, so its arc cosine is inexact.
fn angle(original: &[f32], decoded: &[f32]) -> f64 {
    let unit = |quat: &[f32]| {
        let quat = [quat[0], quat[1], quat[2], quat[3]];
        // A quaternion that cannot be normalised counts as the identity, but non-finite values must not be hidden by
        // it.
        if quat.iter().all(|x| x.is_finite()) { normalize(unit_quat(quat).map(f64::from)) } else { [f64::NAN; 4] }
    };
    let (p, q) = (unit(original), unit(decoded));
    let (apart, together) = (distance(p, q), distance(p, q.map(|x| -x)));
    if apart <= together { 4.0 * apart.atan2(together) } else { 4.0 * together.atan2(apart) }
}

/// The largest error of each attribute so far.
///
/// ```
/// use tcgs_codec::AttributeErrors;
/// use tcgs_core::{Gaussians, Layout};
/// let mut decoded = Gaussians::zeros(2);
/// decoded.means_mut()[1] = [0.0, 0.25, 0.0];
/// let mut errors = AttributeErrors::none(&Layout::base());
/// errors.add(&Gaussians::zeros(2), &decoded);
/// assert_eq!(errors.by_name()[0], ("means", 0.25));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct AttributeErrors {
    layout: Arc<Layout>,
    /// Largest errors by [`Attribute::index`].
    largest: Vec<f64>,
}

impl AttributeErrors {
    /// Errors before the first Gaussian: all 0.
    pub fn none(layout: &Arc<Layout>) -> Self {
        Self { layout: Arc::clone(layout), largest: vec![0.0; layout.columns().len()] }
    }

    /// Errors of a compact scene against the scene it was made of, at all timesteps at which each Gaussian lives. Reads
    /// the scene once and holds one timestep.
    ///
    /// - `original`: the scene that was compressed; its timestep 0 is that of `compact`
    /// - `order`: Gaussian `i` of `compact` is Gaussian `order[i]` of `original`. Gaussians missing from `order` were
    ///   left out, which is no error
    ///
    /// # Errors
    /// [`CompressError::Read`] if the reader fails; [`CompressError::Layout`] if a timestep has other columns.
    ///
    /// # Panics
    /// If `original` has fewer timesteps than `compact`, or fewer Gaussians than `order` requires.
    pub fn of<R: SceneReader>(
        compact: &CompactScene,
        original: &mut R,
        order: &[usize],
    ) -> Result<Self, CompressError> {
        let mut errors = Self::none(&compact.layout);
        for timestep in 0..compact.num_timesteps() {
            let now =
                original.at(timestep).map_err(|error| CompressError::Read { timestep, error: Box::new(error) })?;
            if *now.layout() != compact.layout {
                let (found, expected) = (now.layout().to_string(), compact.layout.to_string());
                return Err(CompressError::Layout { timestep, found, expected });
            }
            let decoded = compact.at(timestep);
            let alive = order.iter().enumerate().filter(|&(g, _)| compact.is_alive(g, timestep));
            errors.add_rows(&now, &decoded, alive.map(|(g, &row)| (row, g)));
        }
        Ok(errors)
    }

    /// Adds Gaussians; equal rows belong together.
    ///
    /// # Panics
    /// If the numbers of Gaussians differ, or the columns are not those of the layout.
    pub fn add(&mut self, original: &Gaussians, decoded: &Gaussians) {
        let (found, expected) = (decoded.num_gaussians(), original.num_gaussians());
        assert_eq!(found, expected, "decoded Gaussians against those that were compressed");
        self.add_rows(original, decoded, (0..found).map(|row| (row, row)));
    }

    /// Adds pairs of Gaussians.
    ///
    /// - `pairs`: a row of `original` and one of `decoded`
    ///
    /// # Panics
    /// If a row is out of range, or the columns are not those of the layout.
    pub fn add_rows(
        &mut self,
        original: &Gaussians,
        decoded: &Gaussians,
        pairs: impl Iterator<Item = (usize, usize)> + Clone,
    ) {
        assert!(*original.layout() == self.layout && *decoded.layout() == self.layout, "columns of {}", self.layout);
        for (column, largest) in self.layout.columns().iter().zip(&mut self.largest) {
            let components = column.components();
            let (a, b) = (original.values(column.attribute), decoded.values(column.attribute));
            let row = |i: usize| i * components..(i + 1) * components;
            let error = |(i, j): (usize, usize)| attribute_error(column, &a[row(i)], &b[row(j)]);
            *largest = pairs.clone().map(error).fold(*largest, f64::max);
        }
    }

    /// Raises each error to that of `other` if the latter is larger.
    ///
    /// # Panics
    /// If the columns differ.
    pub fn extend(&mut self, other: &Self) {
        assert_eq!(self.layout, other.layout, "columns of errors");
        self.largest.iter_mut().zip(&other.largest).for_each(|(largest, other)| *largest = largest.max(*other));
    }

    /// Largest errors by name of the attribute, in the units of [`attribute_error`].
    pub fn by_name(&self) -> Vec<(&str, f64)> {
        let columns = self.layout.columns().iter();
        columns.zip(&self.largest).map(|(column, &error)| (&column.name[..], error)).collect()
    }

    /// The errors that a file may declare, by name of the attribute: no smaller than any computation in f64 would find.
    /// Errors beyond the range of `f32` are left out.
    pub fn declared(&self) -> Vec<(String, f32)> {
        let declared = self.by_name().into_iter().map(|(name, error)| (name.to_owned(), rounded_up(error)));
        declared.filter(|(_, error)| error.is_finite()).collect()
    }
}

/// An `f32` above an error by at least [`MARGIN`]; 0 if there is none.
fn rounded_up(error: f64) -> f32 {
    if error == 0.0 {
        return 0.0;
    }
    let above = error * (1.0 + MARGIN.0) + MARGIN.1;
    let rounded = above as f32;
    if f64::from(rounded) < above { rounded.next_up() } else { rounded }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn of(attribute: Attribute, original: &[f32], decoded: &[f32]) -> f64 {
        attribute_error(&Column::like(attribute), original, decoded)
    }

    #[test]
    fn each_attribute_has_its_error() {
        assert_eq!(of(Attribute::Mean, &[1.0, 2.0, 3.0], &[1.0, 5.0, 7.0]), 5.0);
        assert_eq!(of(Attribute::LogScale, &[0.0, -1.0, 2.0], &[0.25, -1.5, 2.0]), 0.5);
        assert_eq!(of(Attribute::Color, &[0.5, 0.5, 0.5], &[0.5, 0.75, 0.25]), 0.25);
        // The error of the activated opacity: from a half to three quarters, and almost none where both are nearly
        // opaque.
        let opacity = |a: f32, b: f32| of(Attribute::LogitOpacity, &[a], &[b]);
        assert!((opacity(0.0, 3.0_f32.ln()) - 0.25).abs() < 1e-7);
        assert!(opacity(20.0, 30.0) < 1e-8 && opacity(-20.0, 20.0) > 0.999_999);
    }

    #[test]
    fn a_rotation_errs_by_its_angle() {
        let about_z = |angle: f64| [(angle / 2.0).cos() as f32, 0.0, 0.0, (angle / 2.0).sin() as f32];
        for angle in [1e-5, 0.01, 0.5, PI / 2.0, 3.0, PI] {
            for sign in [1.0, -2.5] {
                let found = of(Attribute::Quat, &about_z(0.3), &about_z(0.3 + angle).map(|x| sign * x));
                assert!((found - angle).abs() < 3e-7, "{angle}: {found}");
            }
        }
        // More than half a turn is less than half a turn the other way.
        assert!((of(Attribute::Quat, &about_z(0.0), &about_z(4.0)) - (2.0 * PI - 4.0)).abs() < 3e-7);
        assert_eq!(of(Attribute::Quat, &[0.0; 4], &[-1.0, 0.0, 0.0, 0.0]), 0.0);
    }

    #[test]
    fn what_is_not_finite_is_infinitely_wrong() {
        for attribute in Attribute::BASE {
            let zeros = vec![0.0; attribute.components()];
            for wrong in [f32::NAN, f32::INFINITY] {
                let mut decoded = zeros.clone();
                decoded[0] = wrong;
                let error = of(attribute, &zeros, &decoded);
                let is_bounded = attribute == Attribute::LogitOpacity && wrong.is_infinite();
                assert!(if is_bounded { error == 0.5 } else { error.is_infinite() }, "{attribute:?} {wrong}: {error}");
            }
        }
        let (mut errors, mut decoded) = (AttributeErrors::none(&Layout::base()), Gaussians::zeros(1));
        decoded.colors_mut()[0][1] = f32::INFINITY;
        errors.add(&Gaussians::zeros(1), &decoded);
        assert!(errors.declared().iter().all(|(name, error)| name != "colors" && *error == 0.0));
        assert_eq!(errors.declared().len(), 4);
    }

    #[test]
    fn what_is_declared_is_no_smaller() {
        for error in [1e-30, 1e-7, 0.1, 0.3, 1.0 / 3.0, 7e5, f64::from(f32::MAX) / 2.0] {
            let declared = f64::from(rounded_up(error));
            assert!(
                declared >= error * (1.0 + MARGIN.0) && declared <= error * 1.000_002 + 2e-12,
                "{error}: {declared}"
            );
        }
        assert_eq!((rounded_up(0.0), rounded_up(f64::from(f32::MAX))), (0.0, f32::INFINITY));
    }

    #[test]
    fn the_largest_of_all_rows_counts_and_pairs_may_cross() {
        let mut original = Gaussians::zeros(3);
        original.means_mut()[2] = [4.0, 0.0, 0.0];
        let mut decoded = Gaussians::zeros(2);
        decoded.means_mut()[0] = [4.5, 0.0, 0.0];
        let mut errors = AttributeErrors::none(&Layout::base());
        errors.add_rows(&original, &decoded, [(2, 0), (0, 1)].into_iter());
        assert_eq!(errors.by_name()[0], ("means", 0.5));
        let mut more = AttributeErrors::none(&Layout::base());
        more.add_rows(&original, &decoded, [(0, 0)].into_iter());
        errors.extend(&more);
        assert_eq!(errors.by_name()[0], ("means", 4.5));
    }
}

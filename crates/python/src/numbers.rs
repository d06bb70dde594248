//! Numbers of a caller, of any size and kind, with errors that name the argument.

use std::fmt::Display;
use std::ops::RangeInclusive;

use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;

/// A number of Python as `T`; one that overflows is the least or the largest.
fn saturating<'a, 'py, T>(given: Borrowed<'a, 'py, PyAny>, [least, largest]: [T; 2]) -> PyResult<T>
where
    T: FromPyObject<'a, 'py, Error = PyErr>,
{
    match T::extract(given) {
        Err(error) if error.is_instance_of::<PyOverflowError>(given.py()) => {
            Ok(if given.lt(0)? { least } else { largest })
        }
        extracted => extracted,
    }
}

/// A whole number as Python has it; one beyond 128 bits is the largest or smallest of these.
#[derive(Clone, Copy, Debug)]
pub struct Whole(i128);

impl FromPyObject<'_, '_> for Whole {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        saturating(given, [i128::MIN, i128::MAX]).map(Self)
    }
}

impl Whole {
    /// A default.
    pub const fn of(value: i128) -> Self {
        Self(value)
    }

    /// The number, within a range.
    ///
    /// - `name`: of the argument
    ///
    /// # Errors
    /// `ValueError` if it is not within the range.
    pub fn within<T: TryFrom<i128> + PartialOrd + Display>(self, name: &str, range: RangeInclusive<T>) -> PyResult<T> {
        T::try_from(self.0).ok().filter(|found| range.contains(found)).ok_or_else(|| {
            let (Self(found), least, most) = (self, range.start(), range.end());
            PyValueError::new_err(format!("{name}: is {found}, expected {least} to {most}"))
        })
    }

    /// The number as an index, in range or not.
    pub fn index(self) -> isize {
        self.0.clamp(isize::MIN as i128, isize::MAX as i128) as isize
    }
}

/// Two whole numbers of 0 or more.
///
/// # Errors
/// As of [`Whole::within`].
pub fn check_pair(name: &str, (first, second): (Whole, Whole)) -> PyResult<(usize, usize)> {
    Ok((first.within(name, 0..=usize::MAX)?, second.within(name, 0..=usize::MAX)?))
}

/// A number as Python has it; a whole number beyond a float's range is infinite.
#[derive(Clone, Copy, Debug)]
pub struct Number(f64);

impl FromPyObject<'_, '_> for Number {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        saturating(given, [f64::NEG_INFINITY, f64::INFINITY]).map(Self)
    }
}

impl Number {
    /// A default.
    pub const fn of(value: f64) -> Self {
        Self(value)
    }

    /// The number, if it is finite and fulfils a condition.
    ///
    /// - `name`: of the argument
    /// - `expected`: the condition, in words
    ///
    /// # Errors
    /// `ValueError` if it does not.
    pub fn such(self, name: &str, expected: &str, is_such: impl Fn(f64) -> bool) -> PyResult<f64> {
        let Self(found) = self;
        if found.is_finite() && is_such(found) {
            return Ok(found);
        }
        Err(PyValueError::new_err(format!("{name}: is {found}, expected {expected}")))
    }
}

/// The given one of two arguments with one meaning, and its name. The second is gsplat's.
///
/// # Errors
/// `TypeError` if both are given, or none.
pub fn one_of<T>([name, other]: [&'static str; 2], given: [Option<T>; 2]) -> PyResult<(&'static str, T)> {
    match given {
        [Some(given), None] => Ok((name, given)),
        [None, Some(given)] => Ok((other, given)),
        [None, None] => Err(PyTypeError::new_err(format!("{name}: missing, expected {name} or {other}"))),
        [Some(_), Some(_)] => {
            Err(PyTypeError::new_err(format!("{name} and {other}: both given, expected one of them")))
        }
    }
}

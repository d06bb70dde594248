//! Arrays of a checkpoint as name, shape and values, whatever their meaning. What lives here: reading and writing one
//! array, and finding the rows in which two arrays differ. What does not: the list of arrays (`checkpoint`), and the
//! distribution of arrays over files (`chain`).

use std::collections::BTreeMap;
use std::io::{self, Seek, Write};
use std::sync::Arc;

use tcgs_interchange::{InterchangeError, NpyValue, NpzReader, NpzWriter};

/// Arrays by name. Arrays that do not change from one timestep to the next are shared.
pub(crate) type Arrays = BTreeMap<String, Arc<Array>>;

/// A dense array in C order.
#[derive(Clone, Debug)]
pub(crate) struct Array {
    /// Size along each axis, at least one.
    pub shape: Vec<usize>,
    pub values: Values,
}

/// Values of one of the types that checkpoints hold.
#[derive(Clone, Debug)]
pub(crate) enum Values {
    F32(Vec<f32>),
    U64(Vec<u64>),
    U8(Vec<u8>),
}

/// A type of values.
pub(crate) trait Value: NpyValue {
    fn wrap(values: Vec<Self>) -> Values;
    fn unwrap(values: &Values) -> Option<&[Self]>;
    /// The bits: numbers that compare equal may differ in them, and the reverse.
    fn bits(self) -> u64;
}

macro_rules! impl_value {
    ($($type:ty, $variant:ident, |$x:ident| $bits:expr);*) => {$(
        impl Value for $type {
            fn wrap(values: Vec<Self>) -> Values {
                Values::$variant(values)
            }
            fn unwrap(values: &Values) -> Option<&[Self]> {
                if let Values::$variant(values) = values { Some(values) } else { None }
            }
            fn bits(self) -> u64 {
                let $x = self;
                $bits
            }
        }
    )*};
}
impl_value!(f32, F32, |x| x.to_bits().into(); u64, U64, |x| x; u8, U8, |x| x.into());

/// Evaluates an expression on the values, whatever their type.
macro_rules! with_values {
    ($values:expr, |$x:ident| $body:expr) => {
        match $values {
            Values::F32($x) => $body,
            Values::U64($x) => $body,
            Values::U8($x) => $body,
        }
    };
}

/// The rows of an array that differ from an earlier one of the same shape.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    /// Indices along the first axis, ascending.
    pub rows: Vec<usize>,
    /// `[rows, …]` their values.
    pub values: Array,
}

impl Array {
    pub fn new<T: Value>(shape: &[usize], values: Vec<T>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "values for the shape {shape:?}");
        Self { shape: shape.to_vec(), values: T::wrap(values) }
    }

    /// Values in a row: all but the first axis.
    fn row_len(&self) -> usize {
        self.shape[1..].iter().product()
    }

    /// Rows whose bits differ from those of `before`, and rows that `before` lacks. None if its shape or type differs,
    /// or if it is longer.
    pub fn changed_rows(&self, before: &Self) -> Option<Vec<usize>> {
        fn compare<T: Value>(values: &[T], before: &Values, row_len: usize) -> Option<Vec<usize>> {
            let before = T::unwrap(before)?;
            let differs = |(a, b): (&[T], &[T])| a.iter().zip(b).any(|(a, b)| a.bits() != b.bits());
            let rows = values.chunks(row_len.max(1)).zip(before.chunks(row_len.max(1)));
            Some(rows.enumerate().filter(|&(_, rows)| differs(rows)).map(|(i, _)| i).collect())
        }
        if self.shape[1..] != before.shape[1..] || self.shape[0] < before.shape[0] {
            return None;
        }
        let mut rows = with_values!(&self.values, |values| compare(values, &before.values, self.row_len()))?;
        rows.extend(before.shape[0]..self.shape[0]);
        Some(rows)
    }

    /// Some rows.
    pub fn select(&self, rows: &[usize]) -> Self {
        fn take<T: Value>(values: &[T], rows: &[usize], row_len: usize) -> Values {
            T::wrap(rows.iter().flat_map(|&row| &values[row * row_len..][..row_len]).copied().collect())
        }
        let mut shape = self.shape.clone();
        shape[0] = rows.len();
        Self { shape, values: with_values!(&self.values, |values| take(values, rows, self.row_len())) }
    }

    /// Replaces rows, and appends those after the last.
    ///
    /// # Errors
    /// A message if the patch does not belong to an array of this shape and type.
    pub fn apply(&mut self, patch: &Patch) -> Result<(), String> {
        fn put<T: Value>(values: &mut Vec<T>, patch: &Patch, row_len: usize) -> Option<()> {
            let new = T::unwrap(&patch.values.values)?;
            // Appended rows are the last ones, and the patch overwrites each of them.
            if let Some(&last) = patch.rows.last()
                && let Some(&value) = new.first()
            {
                values.resize(values.len().max((last + 1) * row_len), value);
            }
            for (&row, new) in patch.rows.iter().zip(new.chunks(row_len.max(1))) {
                values[row * row_len..][..row_len].copy_from_slice(new);
            }
            Some(())
        }
        let (num_rows, row_len) = (self.shape[0], self.row_len());
        // Appended rows must leave no gap.
        let num_inside = patch.rows.partition_point(|&row| row < num_rows);
        let new_rows = num_rows + patch.rows.len() - num_inside;
        if let Some(row) = patch.rows.last().filter(|&&row| row >= new_rows) {
            return Err(format!("changes row {row}, expected one below {new_rows}"));
        }
        if patch.values.shape[0] != patch.rows.len() || patch.values.shape[1..] != self.shape[1..] {
            let (found, rows) = (&patch.values.shape, patch.rows.len());
            return Err(format!(
                "changes {rows} rows by values of the shape {found:?}, expected rows of {row_len} values"
            ));
        }
        with_values!(&mut self.values, |values| put(values, patch, row_len)).ok_or("changes its type")?;
        self.shape[0] = new_rows;
        Ok(())
    }

    /// Bytes of the values.
    pub fn bytes(&self) -> usize {
        fn of<T: NpyValue>(values: &[T]) -> usize {
            values.len() * T::BYTES
        }
        with_values!(&self.values, |values| of(values))
    }

    /// - `name`: of the array
    pub fn write<W: Write + Seek>(&self, npz: &mut NpzWriter<W>, name: &str) -> io::Result<()> {
        with_values!(&self.values, |values| npz.array(name, &self.shape, [&values[..]]))
    }

    /// # Errors
    /// A message about the array; it begins with the array's name.
    pub fn read(npz: &mut NpzReader, name: &str) -> Result<Self, String> {
        fn of<T: Value>(npz: &mut NpzReader, name: &str) -> Result<Array, String> {
            let array = npz.array_of::<T>(name).map_err(problem_of)?;
            let shape = if array.shape.is_empty() { vec![1] } else { array.shape };
            Ok(Array { shape, values: T::wrap(array.values) })
        }
        match npz.type_of(name).map_err(problem_of)?.as_str() {
            u8::DESCR => of::<u8>(npz, name),
            u64::DESCR => of::<u64>(npz, name),
            _ => of::<f32>(npz, name),
        }
    }
}

/// Values of an array of the type `T`.
///
/// # Errors
/// A message if there is no such array or it is of another type.
pub(crate) fn get<'a, T: Value>(arrays: &'a Arrays, name: &str) -> Result<&'a [T], String> {
    let missing = || format!("{name} is missing, found {}", arrays.keys().cloned().collect::<Vec<_>>().join(", "));
    let array = arrays.get(name).ok_or_else(missing)?;
    T::unwrap(&array.values).ok_or_else(|| format!("{name} has another type, expected {}", T::DESCR))
}

/// The message of an error about a checkpoint, without its path.
pub(crate) fn problem_of(error: InterchangeError) -> String {
    match error {
        InterchangeError::Read { error, .. } | InterchangeError::Write { error, .. } => error.to_string(),
        InterchangeError::Archive { problem, .. } => problem,
        InterchangeError::Array { key, problem, .. } => format!("{key} {problem}"),
        other => other.to_string(),
    }
}

/// Packs ascending indices as the gaps between them, in LEB128: seven bits per byte, lowest first, the eighth set while
/// more follow. An index takes one byte if at least every 128th row is listed.
pub(crate) fn pack_rows(rows: &[usize]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(rows.len());
    let mut next = 0;
    for &row in rows {
        let mut gap = row - next;
        next = row + 1;
        while gap >= 0x80 {
            bytes.push(gap as u8 | 0x80);
            gap >>= 7;
        }
        bytes.push(gap as u8);
    }
    bytes
}

/// The indices that [`pack_rows`] packed; none for any other bytes.
pub(crate) fn unpack_rows(bytes: &[u8]) -> Option<Vec<usize>> {
    let (mut rows, mut next) = (Vec::with_capacity(bytes.len()), 0_usize);
    let (mut gap, mut shift) = (0_usize, 0);
    for &byte in bytes {
        // More rows than 32 bits count cannot be in memory.
        if shift > 28 {
            return None;
        }
        gap |= usize::from(byte & 0x7f).checked_shl(shift)?;
        shift += 7;
        if byte < 0x80 {
            let row = next.checked_add(gap)?;
            rows.push(row);
            next = row.checked_add(1)?;
            (gap, shift) = (0, 0);
        }
    }
    (shift == 0).then_some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_packed_and_unpacked() {
        for rows in [vec![], vec![0], vec![0, 1, 2], vec![5, 132, 133, 261, 20_000, 3_000_000]] {
            assert_eq!(unpack_rows(&pack_rows(&rows)), Some(rows));
        }
        assert_eq!(pack_rows(&[3, 4, 200]), [3, 0, 0x80 | 67, 1]);
        assert_eq!(unpack_rows(&[0x80]), None, "ends within an index");
        assert_eq!(unpack_rows(&[0xff; 9]), None, "no index is as large");
    }

    #[test]
    fn rows_differ_by_bits_and_a_patch_brings_them_over() {
        let before = Array::new(&[4, 2], vec![0.0_f32, 1.0, f32::NAN, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let after = Array::new(&[4, 2], vec![-0.0_f32, 1.0, f32::NAN, 2.0, 3.0, 4.0, 5.0, 7.0]);
        let rows = after.changed_rows(&before).unwrap();
        assert_eq!(rows, [0, 3], "NaN is the same to the bit, minus zero is not");
        let patch = Patch { values: after.select(&rows), rows };
        let mut patched = before.clone();
        patched.apply(&patch).unwrap();
        assert_eq!(after.changed_rows(&patched), Some(vec![]));
        assert_eq!(after.changed_rows(&Array::new(&[8], vec![0.0_f32; 8])), None);
        assert_eq!(after.changed_rows(&Array::new(&[4, 2], vec![0_u8; 8])), None);
        let too_far = Patch { rows: vec![5], values: after.select(&[0]) };
        assert_eq!(patched.apply(&too_far).unwrap_err(), "changes row 5, expected one below 5");
        let narrow = Patch { rows: vec![1], values: Array::new(&[1, 1], vec![0.0_f32]) };
        assert!(patched.apply(&narrow).unwrap_err().contains("expected rows of 2 values"));
        let bytes = Patch { rows: vec![1], values: Array::new(&[1, 2], vec![0_u8; 2]) };
        assert_eq!(patched.apply(&bytes).unwrap_err(), "changes its type");
        // New rows follow the others.
        let longer = Array::new(&[6, 2], (0..12).map(|i| i as f32).collect());
        let rows = longer.changed_rows(&patched).unwrap();
        assert_eq!(rows[rows.len() - 2..], [4, 5]);
        patched.apply(&Patch { values: longer.select(&rows), rows }).unwrap();
        assert_eq!((longer.changed_rows(&patched), patched.changed_rows(&after).is_some()), (Some(vec![]), true));
        assert_eq!(after.changed_rows(&patched), None);
    }
}

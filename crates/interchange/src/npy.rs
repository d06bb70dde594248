//! One NumPy array: the header of the `.npy` format, and its values in C order.
//!
//! Source: NumPy Enhancement Proposal 1, "A Simple File Format for NumPy Arrays", versions 1 to 3.
//! Supported types are the little-endian ones that model files and checkpoints hold: see [`NpyValue`].

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

use crate::{InterchangeError, input};

/// Longest header that is read. Headers of plain arrays have 128 bytes.
const MAX_HEADER_BYTES: usize = 4096;

/// Bytes read at a time; a multiple of every item size.
const BUFFER_BYTES: usize = 1 << 16;

/// A dense array in C order (the last index runs fastest).
#[derive(Clone, Debug, PartialEq)]
pub struct NpyArray<T = f32> {
    /// Size along each axis; empty for a scalar.
    pub shape: Vec<usize>,
    /// The values in C order, as many as the product of `shape`.
    pub values: Vec<T>,
}

/// An element type of arrays: `f32`, `f64`, `u8`, `u64`, `i64` or `bool`. The trait is sealed.
pub trait NpyValue: Copy + sealed::Sealed {
    /// NumPy's type string (`descr` in the header), such as `<f4`.
    const DESCR: &str;
    /// Size of one value in bytes, at most 8.
    const BYTES: usize;

    /// The value that little-endian bytes encode.
    ///
    /// # Panics
    /// If the slice does not hold exactly [`Self::BYTES`] bytes.
    fn read_le(bytes: &[u8]) -> Self;

    /// Writes the value's little-endian bytes into a slice.
    ///
    /// # Panics
    /// If the slice does not hold exactly [`Self::BYTES`] bytes.
    fn write_le(self, bytes: &mut [u8]);
}

mod sealed {
    pub trait Sealed {}
}

macro_rules! impl_npy_value {
    ($($type:ty => $descr:literal),*) => {$(
        impl sealed::Sealed for $type {}
        impl NpyValue for $type {
            const DESCR: &str = $descr;
            const BYTES: usize = size_of::<$type>();
            fn read_le(bytes: &[u8]) -> Self {
                let mut own = [0; size_of::<$type>()];
                own.copy_from_slice(bytes);
                Self::from_le_bytes(own)
            }
            fn write_le(self, bytes: &mut [u8]) {
                bytes.copy_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}
impl_npy_value!(f32 => "<f4", f64 => "<f8", u8 => "|u1", u64 => "<u8", i64 => "<i8");

impl sealed::Sealed for bool {}
impl NpyValue for bool {
    const DESCR: &str = "|b1";
    const BYTES: usize = 1;
    fn read_le(bytes: &[u8]) -> Self {
        u8::read_le(bytes) != 0
    }
    fn write_le(self, bytes: &mut [u8]) {
        u8::from(self).write_le(bytes);
    }
}

/// Reads a `.npy` file of float32 or float64, stored in C or Fortran order, as float32 in C order. Nothing in such a
/// file is compressed, so its length bounds the memory.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::Npy`] if the array is of another type or
/// damaged, or holds a number that is not finite.
pub fn read_npy(path: &Path) -> Result<NpyArray, InterchangeError> {
    let (file, held) = input::open(path)?;
    let mut reader = BufReader::new(file);
    let read = |reader: &mut BufReader<File>| {
        let header = Header::read(reader)?;
        let (held, promised) = (held.saturating_sub(header.header_bytes as u64), header.value_bytes()?);
        if held != promised {
            return Err(format!("holds {held} bytes of values, its header promises {promised}"));
        }
        header.read_floats(reader)
    };
    read(&mut reader).map_err(|problem| InterchangeError::Npy { path: path.into(), problem })
}

/// The header of a `.npy` file.
#[derive(Debug, PartialEq)]
pub(crate) struct Header {
    pub shape: Vec<usize>,
    pub fortran_order: bool,
    /// NumPy's name of the type.
    pub descr: String,
    /// Product of `shape`.
    pub num_values: usize,
    /// Bytes from the start of the array's file to the first value.
    pub header_bytes: usize,
}

/// Largest item size of the types that are read.
const MAX_VALUE_BYTES: usize = 8;

impl Header {
    /// Reads up to the first value.
    pub fn read(from: &mut impl Read) -> Result<Self, String> {
        let mut start = [0; 8];
        read_exact(from, &mut start, "header")?;
        if &start[..6] != b"\x93NUMPY" {
            return Err("does not begin with \\x93NUMPY, expected a NumPy array".into());
        }
        // Version 1 counts the text in two bytes, later versions in four.
        let (count_bytes, text_bytes) = if start[6] == 1 {
            let mut count = [0; 2];
            read_exact(from, &mut count, "header")?;
            (2, usize::from(u16::from_le_bytes(count)))
        } else {
            let mut count = [0; 4];
            read_exact(from, &mut count, "header")?;
            (4, u32::from_le_bytes(count) as usize)
        };
        if text_bytes > MAX_HEADER_BYTES {
            return Err(format!("has a header of {text_bytes} bytes, expected at most {MAX_HEADER_BYTES}"));
        }
        let mut text = vec![0; text_bytes];
        read_exact(from, &mut text, "header")?;
        let text = String::from_utf8_lossy(&text);
        Self::parse(&text, 8 + count_bytes + text_bytes)
    }

    fn parse(text: &str, header_bytes: usize) -> Result<Self, String> {
        let descr = quoted(value_of(text, "descr")?).ok_or("has a structured type, expected float32 or float64")?;
        let order = value_of(text, "fortran_order")?;
        let fortran_order = order.starts_with("True");
        if !fortran_order && !order.starts_with("False") {
            return Err("has a damaged header: fortran_order is neither True nor False".into());
        }
        let shape = parse_shape(value_of(text, "shape")?).ok_or("has a damaged header: shape is not a tuple")?;
        let num_values = shape
            .iter()
            .try_fold(1_usize, |product, &size| product.checked_mul(size))
            .filter(|count| count.checked_mul(MAX_VALUE_BYTES).is_some())
            .ok_or_else(|| format!("has the shape {}, more than can be addressed", show_shape(&shape)))?;
        Ok(Self { shape, fortran_order, descr: descr.into(), num_values, header_bytes })
    }

    /// Bytes of all values, if their type is one that is read.
    pub fn value_bytes(&self) -> Result<u64, String> {
        let types = [
            (f32::DESCR, f32::BYTES),
            (f64::DESCR, f64::BYTES),
            (u8::DESCR, u8::BYTES),
            (u64::DESCR, u64::BYTES),
            (i64::DESCR, i64::BYTES),
            (bool::DESCR, bool::BYTES),
        ];
        let found = types.into_iter().find(|(descr, _)| *descr == self.descr);
        found.map(|(_, bytes)| (self.num_values * bytes) as u64).ok_or_else(|| self.not_floats())
    }

    fn not_floats(&self) -> String {
        format!("has the type {}, expected float32 or float64 (<f4, <f8)", self.descr)
    }

    /// Reads all values, which must be float32 or float64, finite, and the last thing in `from`.
    pub fn read_floats(self, from: &mut impl Read) -> Result<NpyArray, String> {
        let array = match self.float_bytes()? {
            f32::BYTES => self.read_converted(f32::BYTES, f32::read_le, from)?,
            _ => self.read_converted(f64::BYTES, narrowed, from)?,
        };
        check_finite(&array.shape, 0, &array.values)?;
        Ok(array)
    }

    /// Reads through all values and keeps none: they must be what [`Self::read_floats`] asks for, in C order.
    pub fn check_floats(&self, from: &mut impl Read) -> Result<(), String> {
        let mut num_checked = 0;
        let item_bytes = self.float_bytes()?;
        self.for_each_buffer(item_bytes, from, |bytes| {
            let values = floats_of(bytes, item_bytes);
            check_finite(&self.shape, num_checked, &values)?;
            num_checked += values.len();
            Ok(())
        })
    }

    /// Reads some values that [`Self::check_floats`] has passed.
    ///
    /// - `array`: the array's file, header included
    /// - `values`: positions in C order
    pub fn read_some_floats(&self, array: &mut (impl Read + Seek), values: Range<usize>) -> Result<Vec<f32>, String> {
        let item_bytes = self.float_bytes()?;
        let first_byte = self.header_bytes + values.start * item_bytes;
        array.seek(SeekFrom::Start(first_byte as u64)).map_err(|error| format!("is damaged: {error}"))?;
        let mut bytes = vec![0; values.len() * item_bytes];
        read_exact(array, &mut bytes, "values")?;
        let found = floats_of(&bytes, item_bytes);
        check_finite(&self.shape, values.start, &found)?;
        Ok(found)
    }

    /// Size of one value, if it is float32 or float64.
    fn float_bytes(&self) -> Result<usize, String> {
        match self.descr.as_str() {
            f32::DESCR => Ok(f32::BYTES),
            f64::DESCR => Ok(f64::BYTES),
            _ => Err(self.not_floats()),
        }
    }

    /// Reads all values as they are stored, which must be of this type and the last thing in `from`.
    pub fn read_values<T: NpyValue>(self, from: &mut impl Read) -> Result<NpyArray<T>, String> {
        if self.descr != T::DESCR {
            return Err(format!("has the type {}, expected {}", self.descr, T::DESCR));
        }
        self.read_converted(T::BYTES, T::read_le, from)
    }

    /// - `convert`: from the bytes of one value
    fn read_converted<T: Copy>(
        self,
        item_bytes: usize,
        convert: impl Fn(&[u8]) -> T,
        from: &mut impl Read,
    ) -> Result<NpyArray<T>, String> {
        let mut values = Vec::with_capacity(self.num_values);
        self.for_each_buffer(item_bytes, from, |bytes| {
            values.extend(bytes.chunks_exact(item_bytes).map(&convert));
            Ok(())
        })?;
        if self.fortran_order {
            values = c_from_fortran_order(&self.shape, &values);
        }
        Ok(NpyArray { shape: self.shape, values })
    }

    /// Passes the bytes of all values on, whole values at a time; they must be the last thing in `from`.
    fn for_each_buffer(
        &self,
        item_bytes: usize,
        from: &mut impl Read,
        mut take: impl FnMut(&[u8]) -> Result<(), String>,
    ) -> Result<(), String> {
        let mut buffer = vec![0; BUFFER_BYTES];
        let mut left = self.num_values * item_bytes;
        while left > 0 {
            let bytes = &mut buffer[..left.min(BUFFER_BYTES)];
            read_exact(from, bytes, "values")?;
            take(bytes)?;
            left -= bytes.len();
        }
        // Reaching the end is also what makes the archive verify its checksum.
        match from.read(&mut [0]) {
            Ok(0) => Ok(()),
            Ok(_) => Err(format!("goes on after the values of the shape {}", show_shape(&self.shape))),
            Err(error) => Err(format!("is damaged: {error}")),
        }
    }
}

fn narrowed(bytes: &[u8]) -> f32 {
    f64::read_le(bytes) as f32
}

/// - `item_bytes`: of float32 or float64
fn floats_of(bytes: &[u8], item_bytes: usize) -> Vec<f32> {
    let convert = if item_bytes == f32::BYTES { f32::read_le } else { narrowed };
    bytes.chunks_exact(item_bytes).map(convert).collect()
}

/// - `first`: position of the first of `values` in the array, in C order
fn check_finite(shape: &[usize], first: usize, values: &[f32]) -> Result<(), String> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(i) => Err(format!("{} is {}, expected a finite number", show_index(shape, first + i), values[i])),
        None => Ok(()),
    }
}

/// `[i, j, …]` of the value at a position in C order.
fn show_index(shape: &[usize], position: usize) -> String {
    let mut rest = position;
    let mut index: Vec<String> = shape
        .iter()
        .rev()
        .map(|&size| {
            let i = rest % size;
            rest /= size;
            i.to_string()
        })
        .collect();
    index.reverse();
    format!("[{}]", index.join(", "))
}

/// Everything before the values of a C-ordered array, version 1, padded to 64 bytes as NumPy does.
pub(crate) fn header_bytes<T: NpyValue>(shape: &[usize]) -> Vec<u8> {
    const BEFORE_TEXT: usize = 10;
    let (descr, shape) = (T::DESCR, show_shape(shape));
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    let padding = 63 - (BEFORE_TEXT + text.len()) % 64;
    text.push_str(&" ".repeat(padding));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// A shape as Python writes it: `(2, 3)`, `(2,)`, `()`.
pub(crate) fn show_shape(shape: &[usize]) -> String {
    match shape {
        [single] => format!("({single},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

fn read_exact(from: &mut impl Read, bytes: &mut [u8], what: &str) -> Result<(), String> {
    from.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => format!("ends inside its {what}"),
        _ => format!("is damaged: {error}"),
    })
}

/// The text after `'key':` in a header's dictionary.
fn value_of<'a>(text: &'a str, key: &str) -> Result<&'a str, String> {
    let quoted = format!("'{key}'");
    let after = text.find(&quoted).map(|at| text[at + quoted.len()..].trim_start());
    after
        .and_then(|rest| rest.strip_prefix(':'))
        .map(str::trim_start)
        .ok_or_else(|| format!("has a damaged header: no {key}"))
}

fn quoted(text: &str) -> Option<&str> {
    text.strip_prefix('\'')?.split_once('\'').map(|(inside, _)| inside)
}

fn parse_shape(text: &str) -> Option<Vec<usize>> {
    let (inside, _) = text.strip_prefix('(')?.split_once(')')?;
    let inside = inside.trim();
    if inside.is_empty() {
        return Some(Vec::new());
    }
    inside.strip_suffix(',').unwrap_or(inside).split(',').map(|size| size.trim().parse().ok()).collect()
}

fn c_from_fortran_order<T: Copy>(shape: &[usize], values: &[T]) -> Vec<T> {
    let strides: Vec<usize> = shape
        .iter()
        .scan(1, |stride, &size| {
            let own = *stride;
            *stride *= size;
            Some(own)
        })
        .collect();
    let mut index = vec![0; shape.len()];
    let mut out = Vec::with_capacity(values.len());
    for _ in 0..values.len() {
        out.push(values[index.iter().zip(&strides).map(|(i, stride)| i * stride).sum::<usize>()]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            if index[axis] < shape[axis] {
                break;
            }
            index[axis] = 0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(text: &str) -> Result<Header, String> {
        Header::parse(text, 0)
    }

    #[test]
    fn written_headers_are_aligned_and_read_back() {
        for shape in [vec![], vec![7], vec![2, 3], vec![150, 341_877, 4]] {
            let bytes = header_bytes::<f32>(&shape);
            assert_eq!(bytes.len() % 64, 0);
            let header = Header::read(&mut bytes.as_slice()).unwrap();
            assert_eq!((header.shape, header.descr.as_str(), header.header_bytes), (shape, "<f4", bytes.len()));
        }
    }

    #[test]
    fn a_fortran_ordered_f64_array_is_reordered() {
        let header = header("{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }").unwrap();
        // numpy: np.asfortranarray([[0, 1, 2], [3, 4, 5]]).tobytes('A')
        let bytes: Vec<u8> = [0.0_f64, 3.0, 1.0, 4.0, 2.0, 5.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let array = header.read_floats(&mut bytes.as_slice()).unwrap();
        assert_eq!((array.shape, array.values), (vec![2, 3], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]));
    }

    #[test]
    fn a_file_holds_what_its_header_promises() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut bytes = header_bytes::<f32>(&[2, 2]);
        bytes.extend([1.0_f32, 2.0, 3.0, 4.0].iter().flat_map(|v| v.to_le_bytes()));
        std::fs::write(file.path(), &bytes).unwrap();
        assert_eq!(read_npy(file.path()).unwrap().values, [1.0, 2.0, 3.0, 4.0]);
        std::fs::write(file.path(), &bytes[..bytes.len() - 1]).unwrap();
        let message = read_npy(file.path()).unwrap_err().to_string();
        assert!(message.ends_with(": holds 15 bytes of values, its header promises 16"), "{message}");
    }

    #[test]
    fn values_must_be_whole_and_finite() {
        let read = |values: &[f32]| {
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            let header = header("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2)}").unwrap();
            header.read_floats(&mut bytes.as_slice()).map(|a| a.values)
        };
        assert_eq!(read(&[1.0, 2.0, 3.0, 4.0]).unwrap(), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(read(&[1.0, 2.0, 3.0]).unwrap_err(), "ends inside its values");
        assert_eq!(read(&[0.0; 5]).unwrap_err(), "goes on after the values of the shape (2, 2)");
        assert_eq!(read(&[0.0, 0.0, f32::NAN, 0.0]).unwrap_err(), "[1, 0] is NaN, expected a finite number");
    }

    #[test]
    fn bad_headers_are_named() {
        let problem = |text: &str| header(text).and_then(|header| header.read_floats(&mut [].as_slice())).unwrap_err();
        let dict = |descr: &str, shape: &str| format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}");
        assert!(problem(&dict("'<i8'", "(2,)")).contains("the type <i8, expected float32 or float64"));
        assert!(problem(&dict("[('a', '<f4')]", "(2,)")).contains("structured"));
        assert!(problem(&dict("'<f4'", "(-1,)")).contains("shape is not a tuple"));
        assert!(problem(&dict("'<f4'", "(2")).contains("shape is not a tuple"));
        assert!(problem(&dict("'<f4'", "(9223372036854775807, 7)")).contains("more than can be addressed"));
        assert!(problem("{}").contains("no descr"));
        assert!(Header::read(&mut b"PK\x03\x04    ".as_slice()).unwrap_err().contains("NUMPY"));
        assert!(Header::read(&mut b"\x93NUMPY\x02\x00\xff\xff\xff\xff".as_slice()).unwrap_err().contains("at most"));
    }
}

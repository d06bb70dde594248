//! Archives of NumPy arrays (`.npz`): a zip archive that holds one `.npy` file per array.
//!
//! What lives here: the archive, its table of contents, and the bounds that a damaged archive cannot exceed. What does
//! not: the header and the values of one array (`npy`).

use std::{
    fs::File,
    io::{self, BufReader, ErrorKind, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter, read::ZipFile, write::SimpleFileOptions};

use crate::{
    InterchangeError, NpyArray, ReadLimits, input,
    npy::{Header, NpyValue, header_bytes},
};

/// Deflate cannot shrink by more than this, so a larger claim is false (RFC 1951: 258 bytes from 2 bits).
const MAX_DEFLATE_RATIO: u64 = 1032;

/// Reads the arrays of an npz archive, one array per call: an array's values are in memory only once it is asked for.
///
/// Limits are compared with the sizes of all arrays together when an archive is opened, since a caller may keep all. An
/// archive that is not compressed takes no more than its length, so limits never refuse a checkpoint of a run.
///
/// ```
/// use tcgs_interchange::{NpzReader, NpzWriter};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("arrays.npz");
/// let mut writer = NpzWriter::new(std::fs::File::create(&path)?);
/// writer.array("data", &[2, 3], [&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0][..]])?;
/// writer.finish()?;
///
/// let mut reader = NpzReader::open(&path)?;
/// let data = reader.array("data")?;
/// assert_eq!((&data.shape[..], data.values[5]), (&[2, 3][..], 6.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct NpzReader {
    path: PathBuf,
    file_bytes: u64,
    limits: ReadLimits,
    archive: ZipArchive<BufReader<File>>,
}

impl NpzReader {
    /// Opens an archive under the default [`ReadLimits`], and reads its table of contents.
    ///
    /// # Errors
    /// As [`Self::open_with`].
    pub fn open(path: &Path) -> Result<Self, InterchangeError> {
        Self::open_with(path, ReadLimits::default())
    }

    /// Opens an archive and reads its table of contents.
    ///
    /// # Errors
    /// [`InterchangeError::Read`] if the file cannot be opened; [`InterchangeError::Archive`] if the file is not a
    /// complete zip archive; [`InterchangeError::Limit`] if its arrays together are larger than `limits` allow.
    pub fn open_with(path: &Path, limits: ReadLimits) -> Result<Self, InterchangeError> {
        let (file, file_bytes) = input::open(path)?;
        let mut archive = ZipArchive::new(BufReader::new(file))
            .map_err(|error| InterchangeError::Archive { path: path.into(), problem: lowercase(&error.to_string()) })?;
        let sizes = (0..archive.len()).filter_map(|index| Some(archive.by_index_raw(index).ok()?.size()));
        limits.check_bytes(path, file_bytes, sizes.fold(0, u64::saturating_add))?;
        Ok(Self { path: path.into(), file_bytes, limits, archive })
    }

    /// Refuses an array if several copies of it do not fit the limits: for a caller that converts it.
    ///
    /// - `copies`: number of copies of the array's bytes in memory at once
    ///
    /// # Errors
    /// [`InterchangeError::Limit`]; [`InterchangeError::Array`] if the array is missing or its header is damaged.
    pub fn check_copies(&mut self, key: &str, copies: u64) -> Result<(), InterchangeError> {
        let bytes = self.read(key, |header, _| header.value_bytes())?;
        self.limits.check_bytes(&self.path, self.file_bytes, bytes.saturating_mul(copies))
    }

    /// Reads one array of float32 or float64, stored in C or Fortran order, as float32 in C order.
    ///
    /// - `key`: name of the array, without `.npy`
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if the array is missing, of another type or damaged, or holds a number that is not
    /// finite; [`InterchangeError::Limit`] if it is in Fortran order and too large to be sorted.
    pub fn array(&mut self, key: &str) -> Result<NpyArray, InterchangeError> {
        self.check_order(key)?;
        self.read(key, |header, entry| header.read_floats(entry))
    }

    /// Reads one array of the type `T` without conversion. NaN and infinities are allowed.
    ///
    /// - `key`: name of the array, without `.npy`
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if the array is missing, of another type, or damaged; [`InterchangeError::Limit`] as
    /// of [`Self::array`].
    pub fn array_of<T: NpyValue>(&mut self, key: &str) -> Result<NpyArray<T>, InterchangeError> {
        self.check_order(key)?;
        self.read(key, |header, entry| header.read_values(entry))
    }

    /// Prepares one array of float32 or float64 for [`Self::row`], which reads a part of it: reads through the array
    /// once, and checks its values and the archive's checksum.
    ///
    /// Only an uncompressed array (`numpy.savez`) in C order stays on disk. A compressed one (`numpy.savez_compressed`)
    /// has no random access, so it is held in memory.
    ///
    /// - `key`: name of the array, without `.npy`
    ///
    /// # Errors
    /// As [`Self::array`].
    pub(crate) fn rows(&mut self, key: &str) -> Result<NpzRows, InterchangeError> {
        self.check_order(key)?;
        self.read(key, |header, entry| {
            if entry.compression() != CompressionMethod::Stored || header.fortran_order {
                let NpyArray { shape, values } = header.read_floats(entry)?;
                return Ok(NpzRows { key: key.into(), shape, values: RowValues::InMemory(values) });
            }
            header.check_floats(entry)?;
            Ok(NpzRows { key: key.into(), shape: header.shape.clone(), values: RowValues::OnDisk(header) })
        })
    }

    /// The values at one index of the first axis, in C order.
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if the file has changed since, or cannot be read.
    ///
    /// # Panics
    /// If there is no such index.
    pub(crate) fn row(&mut self, rows: &NpzRows, index: usize) -> Result<Vec<f32>, InterchangeError> {
        assert!(index < rows.shape[0], "row {index} of {}", rows.shape[0]);
        let row_len: usize = rows.shape[1..].iter().product();
        let values = index * row_len..(index + 1) * row_len;
        let header = match &rows.values {
            RowValues::InMemory(all) => return Ok(all[values].to_vec()),
            RowValues::OnDisk(header) => header,
        };
        let array = self.archive.by_name_seek(&format!("{}.npy", rows.key));
        let found = array
            .map_err(|error| format!("is damaged: {}", lowercase(&error.to_string())))
            .and_then(|mut array| header.read_some_floats(&mut array, values));
        found.map_err(|problem| InterchangeError::Array { path: self.path.clone(), key: rows.key.clone(), problem })
    }

    /// Whether the archive has an array named `key` (without `.npy`).
    pub fn contains(&self, key: &str) -> bool {
        self.archive.index_for_name(&format!("{key}.npy")).is_some()
    }

    /// NumPy's type string of an array, such as `<f4`, from its header.
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if the array is missing or its header is damaged.
    pub fn type_of(&mut self, key: &str) -> Result<String, InterchangeError> {
        self.read(key, |header, _| Ok(header.descr))
    }

    /// Names of the arrays without `.npy`, in the order of the archive.
    pub fn array_names(&self) -> impl Iterator<Item = String> {
        self.archive.file_names().flatten().filter_map(|name| name.strip_suffix(".npy").map(str::to_owned))
    }

    /// An array in Fortran order is held twice while it is sorted.
    fn check_order(&mut self, key: &str) -> Result<(), InterchangeError> {
        let is_fortran = self.read(key, |header, _| Ok(header.fortran_order))?;
        if is_fortran { self.check_copies(key, 2) } else { Ok(()) }
    }

    fn read<T>(
        &mut self,
        key: &str,
        read: impl FnOnce(Header, &mut ZipFile<'_, BufReader<File>>) -> Result<T, String>,
    ) -> Result<T, InterchangeError> {
        let found = self.try_read(key, read);
        found.map_err(|problem| InterchangeError::Array { path: self.path.clone(), key: key.into(), problem })
    }

    fn try_read<T>(
        &mut self,
        key: &str,
        read: impl FnOnce(Header, &mut ZipFile<'_, BufReader<File>>) -> Result<T, String>,
    ) -> Result<T, String> {
        if !self.contains(key) {
            return Err(format!("is missing, found {}", self.array_names().collect::<Vec<_>>().join(", ")));
        }
        let entry = self.archive.by_name(&format!("{key}.npy"));
        let mut entry = entry.map_err(|error| format!("is damaged: {}", lowercase(&error.to_string())))?;
        let header = Header::read(&mut entry)?;
        let (held, promised) = (entry.size().saturating_sub(header.header_bytes as u64), header.value_bytes()?);
        let possible = entry.compressed_size().min(self.file_bytes).saturating_mul(MAX_DEFLATE_RATIO);
        if held != promised || promised > possible {
            return Err(format!("holds {held} bytes of values, its header promises {promised}"));
        }
        read(header, &mut entry)
    }

    /// Path of the archive, as given to [`Self::open`].
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// One array of an archive whose rows [`NpzReader::row`] reads; a row has the values at one index of the first axis.
#[derive(Debug)]
pub(crate) struct NpzRows {
    key: String,
    /// Size along each axis.
    pub(crate) shape: Vec<usize>,
    values: RowValues,
}

impl NpzRows {
    #[cfg(test)]
    pub(crate) fn is_on_disk(&self) -> bool {
        matches!(self.values, RowValues::OnDisk(_))
    }
}

#[derive(Debug)]
enum RowValues {
    OnDisk(Header),
    InMemory(Vec<f32>),
}

/// Writes an npz archive, uncompressed. Equal arrays give equal bytes: no time of writing is stored.
///
/// ```
/// let mut npz = tcgs_interchange::NpzWriter::new(std::io::Cursor::new(Vec::new()));
/// npz.array("data", &[2, 3], [&[1.0, 2.0, 3.0][..], &[4.0, 5.0, 6.0]])?;
/// let bytes = npz.finish()?.into_inner();
/// assert!(bytes.starts_with(b"PK"));
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct NpzWriter<W: Write + Seek> {
    zip: ZipWriter<FailsOnce<W>>,
}

impl<W: Write + Seek> NpzWriter<W> {
    /// Starts an archive without arrays.
    ///
    /// - `writer`: should be buffered
    pub fn new(writer: W) -> Self {
        Self { zip: ZipWriter::new(FailsOnce { writer, failed: None, position: 0 }) }
    }

    /// Adds an array, not compressed, as `numpy.savez` does.
    ///
    /// - `key`: name of the array, without `.npy`
    /// - `shape`: size along each axis
    /// - `parts`: slices whose concatenation is the array's values in C order
    ///
    /// # Errors
    /// The errors of the writer.
    ///
    /// # Panics
    /// If `parts` together do not hold as many values as the product of `shape`.
    pub fn array<'a, T: NpyValue + 'a>(
        &mut self,
        key: &str,
        shape: &[usize],
        parts: impl IntoIterator<Item = &'a [T]>,
    ) -> io::Result<()> {
        self.array_with(key, shape, |put: &mut dyn FnMut(&[T]) -> io::Result<()>| parts.into_iter().try_for_each(put))
    }

    /// Adds an array whose parts need not be in memory together; otherwise as [`Self::array`].
    ///
    /// - `write`: calls the function that it is given with one part after another
    ///
    /// # Errors
    /// The errors of the writer and of `write`.
    ///
    /// # Panics
    /// If the parts together do not hold as many values as the product of `shape`.
    pub fn array_with<T: NpyValue>(
        &mut self,
        key: &str,
        shape: &[usize],
        write: impl FnOnce(&mut dyn FnMut(&[T]) -> io::Result<()>) -> io::Result<()>,
    ) -> io::Result<()> {
        let num_values: usize = shape.iter().product();
        let header = header_bytes::<T>(shape);
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file((T::BYTES * num_values) as u64 + header.len() as u64 > u64::from(u32::MAX));
        self.zip.start_file(format!("{key}.npy"), options)?;
        self.zip.write_all(&header)?;
        let mut bytes = [0; 1 << 14];
        let mut written = 0;
        write(&mut |values| {
            for chunk in values.chunks(bytes.len() / T::BYTES) {
                for (slot, value) in bytes.chunks_exact_mut(T::BYTES).zip(chunk) {
                    value.write_le(slot);
                }
                self.zip.write_all(&bytes[..T::BYTES * chunk.len()])?;
            }
            written += values.len();
            Ok(())
        })?;
        assert_eq!(written, num_values, "{key}: {written} values for the shape {shape:?}");
        Ok(())
    }

    /// Writes the table of contents and returns the writer. Without this call the archive is incomplete.
    ///
    /// # Errors
    /// The errors of the writer.
    pub fn finish(self) -> io::Result<W> {
        let FailsOnce { writer, failed, .. } = self.zip.finish()?;
        failed.map_or(Ok(writer), |kind| Err(kind.into()))
    }
}

/// A writer that reports its first error and then discards all bytes. A dropped [`ZipWriter`] tries to complete the
/// archive and prints its error on standard error; by then the caller has the error.
struct FailsOnce<W> {
    writer: W,
    failed: Option<ErrorKind>,
    /// The writer's position, bytes.
    position: u64,
}

impl<W> FailsOnce<W> {
    fn note<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        if let Err(error) = &result
            && error.kind() != ErrorKind::Interrupted
        {
            self.failed = Some(error.kind());
        }
        result
    }
}

impl<W: Write> Write for FailsOnce<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = if self.failed.is_some() { Ok(bytes.len()) } else { self.writer.write(bytes) };
        let written = self.note(written)?;
        self.position += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        let flushed = if self.failed.is_some() { Ok(()) } else { self.writer.flush() };
        self.note(flushed)
    }
}

impl<W: Seek> Seek for FailsOnce<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let sought = match (self.failed, to) {
            (None, to) => self.writer.seek(to),
            (Some(_), SeekFrom::Start(position)) => Ok(position),
            (Some(_), SeekFrom::Current(by) | SeekFrom::End(by)) => Ok(self.position.saturating_add_signed(by)),
        };
        self.position = self.note(sought)?;
        Ok(self.position)
    }
}

fn lowercase(message: &str) -> String {
    let mut chars = message.chars();
    chars.next().map(|first| first.to_lowercase().chain(chars).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(arrays: &[(&str, &[usize], &[f32])]) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut npz = NpzWriter::new(file.as_file_mut());
        for &(key, shape, values) in arrays {
            npz.array(key, shape, [values]).unwrap();
        }
        npz.finish().unwrap();
        file
    }

    #[test]
    fn arrays_read_back() {
        let long: Vec<f32> = (0..40_000).map(|i| i as f32).collect();
        let file = write(&[("a", &[2, 2], &[1.0, 2.0, 3.0, 4.0]), ("long", &[40_000], &long)]);
        let mut npz = NpzReader::open(file.path()).unwrap();
        assert_eq!(npz.array("long").unwrap().values, long);
        assert_eq!(npz.array("a").unwrap(), NpyArray { shape: vec![2, 2], values: vec![1.0, 2.0, 3.0, 4.0] });
    }

    #[test]
    fn every_type_reads_back_as_it_is() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut npz = NpzWriter::new(file.as_file_mut());
        npz.array("f4", &[3], [[1.5_f32, f32::NEG_INFINITY, -0.0].as_slice()]).unwrap();
        npz.array("f8", &[1], [[1e300_f64].as_slice()]).unwrap();
        npz.array("u1", &[2, 2], [[0_u8, 255].as_slice(), &[7, 8]]).unwrap();
        npz.array("u8", &[1], [[u64::MAX].as_slice()]).unwrap();
        npz.array("i8", &[2], [[i64::MIN, -1].as_slice()]).unwrap();
        npz.array("b1", &[2], [[true, false].as_slice()]).unwrap();
        npz.array::<u8>("none", &[0], []).unwrap();
        npz.finish().unwrap();
        let mut npz = NpzReader::open(file.path()).unwrap();
        let f4 = npz.array_of::<f32>("f4").unwrap();
        assert_eq!((f4.shape, f4.values.iter().map(|x| x.to_bits()).collect::<Vec<_>>()), {
            (vec![3], [1.5, f32::NEG_INFINITY, -0.0].map(f32::to_bits).to_vec())
        });
        assert_eq!(npz.array_of::<f64>("f8").unwrap().values, [1e300]);
        assert_eq!(npz.array_of::<u8>("u1").unwrap(), NpyArray { shape: vec![2, 2], values: vec![0, 255, 7, 8] });
        assert_eq!(npz.array_of::<u64>("u8").unwrap().values, [u64::MAX]);
        assert_eq!(npz.array_of::<i64>("i8").unwrap().values, [i64::MIN, -1]);
        assert_eq!(npz.array_of::<bool>("b1").unwrap().values, [true, false]);
        assert!(npz.array_of::<u8>("none").unwrap().values.is_empty());
        assert_eq!(["f4", "u8", "b1"].map(|key| npz.type_of(key).unwrap()), ["<f4", "<u8", "|b1"]);
        let error = npz.array_of::<f32>("f8").unwrap_err().to_string();
        assert!(error.ends_with(": f8 has the type <f8, expected <f4"), "{error}");
        assert!(npz.array("f4").unwrap_err().to_string().contains("[1] is -inf, expected a finite number"));
        assert!(npz.array("u8").unwrap_err().to_string().contains("the type <u8, expected float32 or float64"));
    }

    #[test]
    fn a_missing_array_lists_those_found() {
        let file = write(&[("a", &[1], &[1.0]), ("b", &[1], &[1.0])]);
        let error = NpzReader::open(file.path()).unwrap().array("c").unwrap_err().to_string();
        assert_eq!(error, format!("{}: c is missing, found a, b", file.path().display()));
    }

    #[test]
    fn a_flipped_bit_in_the_values_is_noticed() {
        let file = write(&[("a", &[4], &[1.0, 2.0, 3.0, 4.0])]);
        let mut bytes = std::fs::read(file.path()).unwrap();
        let at = bytes.windows(4).position(|w| w == 3.0_f32.to_le_bytes()).unwrap();
        bytes[at] ^= 1;
        std::fs::write(file.path(), bytes).unwrap();
        let error = NpzReader::open(file.path()).unwrap().array("a").unwrap_err().to_string();
        assert!(error.contains("a is damaged: ") && error.to_lowercase().contains("checksum"), "{error}");
    }

    #[test]
    fn what_is_no_archive_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), b"not a zip").unwrap();
        assert!(matches!(NpzReader::open(file.path()), Err(InterchangeError::Archive { .. })));
        assert!(matches!(NpzReader::open(Path::new("/nowhere.npz")), Err(InterchangeError::Read { .. })));
    }

    /// A file on a disk with room for some bytes.
    struct Full(io::Cursor<Vec<u8>>, u64);

    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let room = (self.1.saturating_sub(self.0.position()) as usize).min(bytes.len());
            if room == 0 { Err(ErrorKind::StorageFull.into()) } else { self.0.write(&bytes[..room]) }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Seek for Full {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.0.seek(to)
        }
    }

    /// A test of the command line checks that a full disk gives one line and no other output.
    #[test]
    fn a_writer_that_fails_is_reported_once() {
        let write = |room| {
            let mut npz = NpzWriter::new(Full(io::Cursor::default(), room));
            npz.array("a", &[8], [[0.5_f32; 8].as_slice()]).and_then(|()| npz.finish().map(drop))
        };
        let whole = (0..).find(|&room| write(room).is_ok()).unwrap();
        assert!((100..1000).contains(&whole), "{whole}");
        for room in 0..whole {
            assert_eq!(write(room).unwrap_err().kind(), ErrorKind::StorageFull, "{room}");
        }
        let mut npz = NpzWriter::new(Full(io::Cursor::default(), 20));
        assert!(npz.array("a", &[1], [[0.5_f32].as_slice()]).is_err());
        assert_eq!(
            npz.finish().err().map(|error| error.kind()),
            Some(ErrorKind::StorageFull),
            "what is lost stays lost"
        );
    }

    #[test]
    #[should_panic(expected = "3 values for the shape [2, 2]")]
    fn writing_another_number_of_values_is_a_mistake() {
        write(&[("a", &[2, 2], &[0.0; 3])]);
    }
}

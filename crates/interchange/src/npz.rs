//! Archives of NumPy arrays: a zip archive with one `.npy` file an array.

use std::{
    fs::File,
    io::{self, BufReader, Seek, Write},
    path::{Path, PathBuf},
};

use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter, result::ZipError, write::SimpleFileOptions};

use crate::{
    InterchangeError, NpyArray,
    npy::{Header, header_bytes},
};

/// Deflate cannot shrink by more than this, so a larger promise is a lie (RFC 1951: 258 bytes from 2 bits).
const MAX_DEFLATE_RATIO: u64 = 1032;

/// Reads the arrays of an archive, one when asked for.
#[derive(Debug)]
pub struct NpzReader {
    path: PathBuf,
    file_bytes: u64,
    archive: ZipArchive<BufReader<File>>,
}

impl NpzReader {
    /// Opens an archive and reads its table of contents.
    ///
    /// # Errors
    /// [`InterchangeError::Io`] if there is no such file, [`InterchangeError::Archive`] if it is not a
    /// whole archive.
    pub fn open(path: &Path) -> Result<Self, InterchangeError> {
        let failed = |error| InterchangeError::Io { path: path.into(), action: "opening", error };
        let file = File::open(path).map_err(failed)?;
        let file_bytes = file.metadata().map_err(failed)?.len();
        let archive = ZipArchive::new(BufReader::new(file))
            .map_err(|error| InterchangeError::Archive { path: path.into(), problem: lowercase(&error.to_string()) })?;
        Ok(Self { path: path.into(), file_bytes, archive })
    }

    /// Reads one array of float32 or float64, in C or Fortran order.
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if it is missing, of another type, damaged, or holds a number that
    /// is not finite.
    pub fn array(&mut self, key: &str) -> Result<NpyArray, InterchangeError> {
        let found = self.read(key);
        found.map_err(|problem| InterchangeError::Array { path: self.path.clone(), key: key.into(), problem })
    }

    /// Whether there is an array of that name.
    pub fn contains(&self, key: &str) -> bool {
        self.archive.index_for_name(&format!("{key}.npy")).is_some()
    }

    fn read(&mut self, key: &str) -> Result<NpyArray, String> {
        let keys: Vec<String> =
            self.archive.file_names().flatten().map(|name| name.trim_end_matches(".npy").to_owned()).collect();
        let mut entry = self.archive.by_name(&format!("{key}.npy")).map_err(|error| match error {
            ZipError::FileNotFound => format!("is missing, found {}", keys.join(", ")),
            other => format!("is damaged: {}", lowercase(&other.to_string())),
        })?;
        let header = Header::read(&mut entry)?;
        let (held, promised) = (entry.size().saturating_sub(header.header_bytes as u64), header.value_bytes());
        let possible = entry.compressed_size().min(self.file_bytes).saturating_mul(MAX_DEFLATE_RATIO);
        if held != promised || promised > possible {
            return Err(format!("holds {held} bytes of values, its header promises {promised}"));
        }
        header.read_values(&mut entry)
    }

    /// The file being read.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Writes an archive of float32 arrays. Same arrays, same bytes: no time of writing is stored.
///
/// ```
/// let mut npz = tcgs_interchange::NpzWriter::new(std::io::Cursor::new(Vec::new()));
/// npz.array("data", &[2, 3], [&[1.0, 2.0, 3.0][..], &[4.0, 5.0, 6.0]])?;
/// let bytes = npz.finish()?.into_inner();
/// assert!(bytes.starts_with(b"PK"));
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct NpzWriter<W: Write + Seek> {
    zip: ZipWriter<W>,
}

impl<W: Write + Seek> NpzWriter<W> {
    /// An empty archive.
    pub fn new(writer: W) -> Self {
        Self { zip: ZipWriter::new(writer) }
    }

    /// Adds an array, not compressed, as `numpy.savez` does.
    ///
    /// - `parts`: slices that make up the values, C order, one after another
    ///
    /// # Errors
    /// What the writer reports.
    ///
    /// # Panics
    /// If `parts` together hold another number of values than `shape`.
    pub fn array<'a>(
        &mut self,
        key: &str,
        shape: &[usize],
        parts: impl IntoIterator<Item = &'a [f32]>,
    ) -> io::Result<()> {
        let num_values: usize = shape.iter().product();
        let header = header_bytes(shape);
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file(4 * num_values as u64 + header.len() as u64 > u64::from(u32::MAX));
        self.zip.start_file(format!("{key}.npy"), options)?;
        self.zip.write_all(&header)?;
        let mut bytes = [0; 1 << 14];
        let mut written = 0;
        for values in parts {
            for chunk in values.chunks(bytes.len() / 4) {
                for (slot, value) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(chunk) {
                    *slot = value.to_le_bytes();
                }
                self.zip.write_all(&bytes[..4 * chunk.len()])?;
            }
            written += values.len();
        }
        assert_eq!(written, num_values, "{key}: {written} values for the shape {shape:?}");
        Ok(())
    }

    /// Writes the table of contents and gives the writer back.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn finish(self) -> io::Result<W> {
        Ok(self.zip.finish()?)
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
        assert!(matches!(NpzReader::open(Path::new("/nowhere.npz")), Err(InterchangeError::Io { .. })));
    }

    #[test]
    #[should_panic(expected = "3 values for the shape [2, 2]")]
    fn writing_another_number_of_values_is_a_mistake() {
        write(&[("a", &[2, 2], &[0.0; 3])]);
    }
}

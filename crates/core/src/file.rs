//! Files that a user names: only regular ones, up to a size.
//!
//! What lives here: opening and reading whole files. A device or a pipe may never end, and opening a pipe waits for its
//! writer. What does not: the formats of files.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Opens a regular file for reading, or a link to one.
///
/// ```
/// let error = tcgs_core::open_file(std::env::temp_dir().as_ref()).unwrap_err();
/// assert_eq!(error.to_string(), "is a folder");
/// ```
///
/// # Errors
/// Those of the operating system; `InvalidInput` for anything but a regular file.
pub fn open_file(path: &Path) -> io::Result<File> {
    // Checked before opening: opening a pipe would wait for its writer.
    let kind = fs::metadata(path)?.file_type();
    if kind.is_dir() {
        return Err(io::Error::new(ErrorKind::IsADirectory, "is a folder"));
    }
    if !kind.is_file() {
        return Err(io::Error::new(ErrorKind::InvalidInput, "is a device or a pipe"));
    }
    File::open(path)
}

/// Reads a regular file whole.
///
/// - `max_bytes`: most bytes of the file
///
/// # Errors
/// As [`open_file`]; `InvalidData` for a larger file, of which no more than `max_bytes` are read.
pub fn read_file(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open_file(path)?;
    let too_large = |bytes: u64| {
        io::Error::new(ErrorKind::InvalidData, format!("has {bytes} bytes, of which at most {max_bytes} are read"))
    };
    let found = file.metadata()?.len();
    if found > max_bytes {
        return Err(too_large(found));
    }
    let mut bytes = Vec::new();
    // Files of /proc have no length, and others may grow.
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes { Err(too_large(bytes.len() as u64)) } else { Ok(bytes) }
}

/// Reads a regular file of UTF-8 whole.
///
/// - `max_bytes`: most bytes of the file
///
/// # Errors
/// As [`read_file`]; `InvalidData` for text that is not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    let bytes = read_file(path, max_bytes)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        io::Error::new(ErrorKind::InvalidData, format!("is no text in UTF-8 from byte {at} on"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_bound() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "four").unwrap();
        assert_eq!(read_text(&path, 4).unwrap(), "four");
        let error = read_file(&path, 3).unwrap_err();
        assert_eq!(
            (error.kind(), error.to_string().as_str()),
            (ErrorKind::InvalidData, "has 4 bytes, of which at most 3 are read")
        );
        fs::write(&path, b"a\xff").unwrap();
        assert_eq!(read_text(&path, 4).unwrap_err().to_string(), "is no text in UTF-8 from byte 1 on");
        // A length alone takes no time.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(read_file(&path, 1 << 20).is_err());
        assert_eq!(read_file(&folder.path().join("b"), 4).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[cfg(unix)]
    #[test]
    fn what_may_never_end_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [Path::new("/dev/zero"), &pipe] {
            let error = open_file(path).unwrap_err();
            assert_eq!((error.kind(), error.to_string().as_str()), (ErrorKind::InvalidInput, "is a device or a pipe"));
        }
        assert_eq!(read_file(folder.path(), 4).unwrap_err().kind(), ErrorKind::IsADirectory);
    }
}

//! Opens other programs' files. A file of known length bounds what its reader may allocate.

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use tcgs_core::open_file;

use crate::InterchangeError;

/// Opens a regular file, and returns its length.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be opened; [`InterchangeError::File`] if it is a device or a pipe,
/// which may never end.
pub(crate) fn open(path: &Path) -> Result<(File, u64), InterchangeError> {
    let opened = open_file(path).and_then(|file| Ok((file.metadata()?.len(), file)));
    match opened {
        Ok((length, file)) => Ok((file, length)),
        Err(error) if error.kind() == ErrorKind::InvalidInput => {
            Err(InterchangeError::File { path: path.into(), problem: format!("{error}, expected a file") })
        }
        Err(error) => Err(InterchangeError::Read { path: path.into(), error }),
    }
}

//! Opens other programs' files. A file of known length bounds what its reader may allocate.

use std::fs::{self, File};
use std::path::Path;

use crate::InterchangeError;

/// Opens a regular file, and tells its length.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be opened; [`InterchangeError::File`] if it is a device or a pipe,
/// which may never end.
pub(crate) fn open(path: &Path) -> Result<(File, u64), InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    // Opening a pipe waits for a writer.
    let metadata = fs::metadata(path).map_err(failed)?;
    if !metadata.is_file() && !metadata.is_dir() {
        let problem = "is a device or a pipe, expected a file".into();
        return Err(InterchangeError::File { path: path.into(), problem });
    }
    let file = File::open(path).map_err(failed)?;
    Ok((file, metadata.len()))
}

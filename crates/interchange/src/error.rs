//! The crate's error: the problem with another program's file.

use std::{fmt, io, path::PathBuf};

/// Why a file could not be read or written. Every message is one line and begins with the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterchangeError {
    /// The operating system failed to open or read a file or folder.
    #[error("{}: reading failed: {error}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// The operating system failed to write a file.
    #[error("{}: writing failed: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// The file is not a complete zip archive.
    #[error("{}: {}, expected a complete npz archive", path.display(), OneLine(problem))]
    Archive {
        /// The file.
        path: PathBuf,
        /// The message of the zip reader.
        problem: String,
    },
    /// A file of Gaussians or points is damaged, lacks something or holds a number that is not finite; or the files of
    /// a folder are no sequence.
    #[error("{}: {}", path.display(), OneLine(problem))]
    File {
        /// The first file that is wrong, or the folder.
        path: PathBuf,
        /// The content that was found, and the expected one.
        problem: String,
    },
    /// A file claims more than [`ReadLimits`](crate::ReadLimits) allow. Nothing was allocated for the claim.
    #[error("{}: needs {needed} {unit}, limit is {limit}", path.display())]
    Limit {
        /// The file.
        path: PathBuf,
        /// `bytes of memory` or `timesteps`.
        unit: &'static str,
        /// The file's claim.
        needed: u64,
        /// The most for a file of its length.
        limit: u64,
    },
    /// A `.npy` file is damaged, of a type that is not supported, or holds a number that is not finite.
    #[error("{}: {}", path.display(), OneLine(problem))]
    Npy {
        /// The file.
        path: PathBuf,
        /// The content that was found, and the expected one.
        problem: String,
    },
    /// One array of an npz archive is missing, damaged, of the wrong type or shape, or holds values out of range.
    #[error("{}: {} {}", path.display(), OneLine(key), OneLine(problem))]
    Array {
        /// The file.
        path: PathBuf,
        /// Name of the array, without `.npy`.
        key: String,
        /// The content that was found, and the expected one.
        problem: String,
    },
}

/// A text that may contain names and types of the file, and with them line breaks.
struct OneLine<'a>(&'a str);

impl fmt::Display for OneLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.split(['\n', '\r']).enumerate().try_for_each(|(i, part)| {
            f.write_str(if i > 0 { " " } else { "" })?;
            f.write_str(part)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_type_with_a_line_break_leaves_a_message_of_one_line() {
        let problem = "has the type <\n4, expected float32 or float64 (<f4, <f8)".into();
        let error = InterchangeError::Array { path: "a.npz".into(), key: "means\r3D".into(), problem };
        assert_eq!(error.to_string(), "a.npz: means 3D has the type < 4, expected float32 or float64 (<f4, <f8)");
    }
}

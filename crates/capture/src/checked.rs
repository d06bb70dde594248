//! Checks of a capture's files, for captures of every kind: valid JSON, sensible frame rates, names inside the
//! capture's folder. The types here hold only checked values, and [`Contents`] takes no others: a new kind of capture
//! cannot skip the checks.
//!
//! [`Contents`]: crate::contents::Contents

use std::ops::RangeInclusive;
use std::path::{Component, Path, PathBuf};

use serde::de::DeserializeOwned;
use tcgs_core::read_file;

use crate::CaptureError;
use crate::files::MAX_JSON_BYTES;

/// Frames a second: in [`Self::RANGE`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameRate(f64);

impl FrameRate {
    /// The rate of all published captures whose files do not say one: CMU Panoptic's cameras, Technicolor's, those of
    /// Neural 3D Video. A static scene has this rate, too: its only frame fits any.
    pub const USUAL: Self = Self(30.0);

    /// A picture in eleven days, and a million a second.
    const RANGE: RangeInclusive<f64> = 1e-6..=1e6;

    /// - returns: the rate, or the fault as words to follow the rate's name
    pub fn new(fps: f64) -> Result<Self, String> {
        match Self::RANGE.contains(&fps) {
            true => Ok(Self(fps)),
            false if fps.is_finite() && fps > 0.0 => Err(format!("is {fps:e}, expected 1e-6 to 1e6")),
            false => Err(format!("is {fps}, expected more than 0")),
        }
    }

    /// The `fps` that a file has or lacks.
    pub fn of_file(fps: Option<f64>, file: &Path) -> Result<Self, CaptureError> {
        let checked = |fps| Self::new(fps).map_err(|problem| CaptureError::invalid(file, format!("fps {problem}")));
        fps.map_or(Ok(Self::USUAL), checked)
    }

    /// Frames a second.
    pub fn fps(self) -> f64 {
        self.0
    }
}

/// A path below some folder, which it cannot leave: no `..`, not absolute, not empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct InnerPath(String);

impl InnerPath {
    /// - `folder`: the folder that the path is relative to, in words
    /// - returns: the path, or the fault as words to follow the place that names it
    pub fn new(path: &str, folder: &str) -> Result<Self, String> {
        let parts = || Path::new(path).components();
        let stays = parts().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        if stays && parts().any(|part| matches!(part, Component::Normal(_))) {
            Ok(Self(path.to_owned()))
        } else {
            Err(format!("is {path:?}, expected the path of a file inside {folder}"))
        }
    }

    /// The name of a file that was found by listing a folder, relative to this folder.
    pub fn of_listed(file: &Path) -> Self {
        Self(crate::files::name(file))
    }

    /// The same file below `folder`.
    pub fn below(&self, folder: &Path) -> PathBuf {
        folder.join(&self.0)
    }

    pub fn as_path(&self) -> &Path {
        Path::new(&self.0)
    }

    /// The same path with `extension` if it has none.
    pub fn or_extension(self, extension: &str) -> Self {
        match self.as_path().extension() {
            Some(_) => self,
            None => Self(self.as_path().with_extension(extension).to_string_lossy().into_owned()),
        }
    }

    pub fn into_name(self) -> String {
        self.0
    }
}

/// Reads a file of JSON; an error names the place in it.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, CaptureError> {
    let text = read_file(path, MAX_JSON_BYTES).map_err(|error| CaptureError::Io { path: path.into(), error })?;
    parse_json(&text).map_err(|problem| CaptureError::invalid(path, problem))
}

fn parse_json<T: DeserializeOwned>(text: &[u8]) -> Result<T, String> {
    let mut json = serde_json::Deserializer::from_slice(text);
    let value = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let (place, error) = (error.path().to_string(), error.inner());
        let place = if place == "." { String::new() } else { format!("{place}: ") };
        match not_finite_at(text, error.line(), error.column()) {
            Some(found) if error.is_syntax() => {
                format!("{place}{found} at line {} column {}, expected a finite number", error.line(), error.column())
            }
            _ => format!("{place}{error}"),
        }
    })?;
    json.end().map_err(|error| error.to_string())?;
    Ok(value)
}

/// The non-finite literal at which a JSON reader stopped, if there is one. JSON has no such literals, but Python's
/// `json` writes them.
fn not_finite_at(text: &[u8], line: usize, column: usize) -> Option<&'static str> {
    let line = text.split(|&byte| byte == b'\n').nth(line.checked_sub(1)?)?;
    // The reader has read the first letter, of "-Infinity" perhaps the second.
    let starts = [column.checked_sub(2), column.checked_sub(1), Some(column)];
    starts.into_iter().flatten().find_map(|start| {
        let rest = line.get(start..)?;
        ["NaN", "-Infinity", "Infinity"].into_iter().find(|literal| rest.starts_with(literal.as_bytes()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_finite_and_more_than_0() {
        for fps in [f64::NAN, f64::INFINITY, -25.0, 0.0, -0.0] {
            let expected = format!("/x/a.json: fps is {fps}, expected more than 0");
            assert_eq!(FrameRate::of_file(Some(fps), Path::new("/x/a.json")).unwrap_err().to_string(), expected);
        }
        assert_eq!(FrameRate::new(1e300).unwrap_err(), "is 1e300, expected 1e-6 to 1e6");
        assert_eq!(FrameRate::of_file(Some(29.97), Path::new("a")).unwrap().fps(), 29.97);
        assert_eq!(FrameRate::of_file(None, Path::new("a")).unwrap(), FrameRate::USUAL);
    }

    #[test]
    fn a_path_stays_inside() {
        for path in ["../a.png", "/a.png", "", ".", "./", "..", "a/../../b.png", "a/../b.png"] {
            let problem = InnerPath::new(path, "images/").unwrap_err();
            assert_eq!(problem, format!("is {path:?}, expected the path of a file inside images/"));
        }
        for path in ["a.png", "./a.png", "1/2/..a.png", "a b.png"] {
            assert_eq!(InnerPath::new(path, "images/").unwrap().as_path(), Path::new(path));
        }
    }
}

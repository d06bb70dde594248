//! `train_meta.json` and `test_meta.json`: cameras and file names, as text.

use std::path::Path;

use serde::Deserialize;

use crate::CaptureError;

/// What a meta file holds. All lists are `[T][C]`, `C` may change with time; that they agree is
/// for the reader to check.
#[derive(Debug, Deserialize)]
pub(crate) struct Meta {
    /// Width of every image, pixels.
    pub w: usize,
    /// Height of every image, pixels.
    pub h: usize,
    /// Intrinsics, `[3][3]` row-major, pixels.
    pub k: Vec<Vec<[[f64; 3]; 3]>>,
    /// `camera_from_world`, `[4][4]` row-major.
    pub w2c: Vec<Vec<[[f64; 4]; 4]>>,
    /// Images, relative to `ims/`.
    #[serde(rename = "fn")]
    pub file_names: Vec<Vec<String>>,
    /// Names of the cameras.
    pub cam_id: Vec<Vec<usize>>,
    /// Frames a second; an addition of ours.
    pub fps: Option<f64>,
}

impl Meta {
    pub fn read(path: &Path) -> Result<Self, CaptureError> {
        let text = std::fs::read(path).map_err(|error| CaptureError::Io { path: path.into(), error })?;
        Self::parse(&text).map_err(|problem| CaptureError::invalid(path, problem))
    }

    fn parse(text: &[u8]) -> Result<Self, String> {
        let mut json = serde_json::Deserializer::from_slice(text);
        let meta = serde_path_to_error::deserialize(&mut json).map_err(|error| {
            let (place, error) = (error.path().to_string(), error.inner());
            let place = if place == "." { String::new() } else { format!("{place}: ") };
            match not_finite_at(text, error.line(), error.column()) {
                Some(found) if error.is_syntax() => format!(
                    "{place}{found} at line {} column {}, expected a finite number",
                    error.line(),
                    error.column()
                ),
                _ => format!("{place}{error}"),
            }
        })?;
        json.end().map_err(|error| error.to_string())?;
        Ok(meta)
    }
}

/// The literal at which a JSON reader stopped, if it is one that Python's `json` writes for a number
/// that is not finite, though JSON has none.
fn not_finite_at(text: &[u8], line: usize, column: usize) -> Option<&'static str> {
    let line = text.split(|&byte| byte == b'\n').nth(line.checked_sub(1)?)?;
    // The reader has looked at the first letter, of "-Infinity" perhaps at the second.
    let starts = [column.checked_sub(2), column.checked_sub(1), Some(column)];
    starts.into_iter().flatten().find_map(|start| {
        let rest = line.get(start..)?;
        ["NaN", "-Infinity", "Infinity"].into_iter().find(|literal| rest.starts_with(literal.as_bytes()))
    })
}

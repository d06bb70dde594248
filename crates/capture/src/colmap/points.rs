//! `points3D` of a model, `.bin` or `.txt`.

use std::path::{Path, PathBuf};

use tcgs_core::PointCloud;

use super::MODEL_FOLDERS;
use super::bytes::{Bytes, lines, number, numbers};
use crate::{CaptureError, files};

/// The points of a model in a capture's folder.
pub(crate) fn points_file(capture: &Path) -> Option<PathBuf> {
    MODEL_FOLDERS.iter().find_map(|folder| points_in(&capture.join(folder)))
}

/// The points of the model in a folder.
pub(crate) fn points_in(folder: &Path) -> Option<PathBuf> {
    ["points3D.bin", "points3D.txt"].iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// Reads points. All are foreground, since a model does not say which of them move.
pub(crate) fn read_points(path: &Path) -> Result<PointCloud, CaptureError> {
    let bytes = files::bytes(path)?;
    let read = if path.extension().is_some_and(|e| e == "txt") {
        text(&String::from_utf8_lossy(&bytes))
    } else {
        binary(Bytes(&bytes))
    };
    let points = read.map_err(|problem| CaptureError::invalid(path, problem))?;
    if points.is_empty() {
        return Err(CaptureError::invalid(path, "has no points, expected at least one"));
    }
    Ok(PointCloud {
        points: points.iter().map(|(point, _)| point.map(|x| x as f32)).collect(),
        colors: points.iter().map(|(_, color)| color.map(|c| f32::from(c) / 255.0)).collect(),
        foreground: vec![true; points.len()],
    })
}

type Points = Vec<([f64; 3], [u8; 3])>;

fn binary(mut from: Bytes<'_>) -> Result<Points, String> {
    /// An image that shows the point: the image's number, and the number of the point in it.
    const TRACK_BYTES: usize = 8;
    let mut points = Points::new();
    for _ in 0..from.count(51)? {
        from.u64()?;
        points.push((from.f64s()?, from.u8s()?));
        from.f64s::<1>()?;
        let track = from.count(TRACK_BYTES)?;
        from.skip(track * TRACK_BYTES)?;
    }
    Ok(points)
}

fn text(text: &str) -> Result<Points, String> {
    let mut points = Points::new();
    for (i, line) in lines(text).filter(|(_, line)| !line.is_empty()) {
        let problem = |problem: String| format!("line {i}: {problem}");
        let mut words = line.split_whitespace().skip(1);
        let place = numbers(&mut words, "x y z").map_err(problem)?;
        let mut color = [0; 3];
        for value in &mut color {
            *value = number(words.next(), "a colour of 0 to 255").map_err(problem)?;
        }
        points.push((place, color));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_hold_the_same() {
        let text_points = text("# c\n7 1.5 -2 3 255 0 51 0.7 1 2 3 4\n").unwrap();
        let mut bytes = 1_u64.to_le_bytes().to_vec();
        bytes.extend(7_u64.to_le_bytes());
        bytes.extend([1.5_f64, -2.0, 3.0].iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([255, 0, 51]);
        bytes.extend(0.7_f64.to_le_bytes());
        bytes.extend(2_u64.to_le_bytes());
        bytes.extend([1_u32, 2, 3, 4].iter().flat_map(|x| x.to_le_bytes()));
        assert_eq!(binary(Bytes(&bytes)).unwrap(), text_points);
        assert_eq!(text_points, [([1.5, -2.0, 3.0], [255, 0, 51])]);
        for length in 0..bytes.len() {
            assert!(binary(Bytes(&bytes[..length])).unwrap_err().starts_with("ends early"), "{length}");
        }
        assert_eq!(text("1 2 3 4 256 0 0").unwrap_err(), "line 1: found 256, expected a colour of 0 to 255");
    }
}

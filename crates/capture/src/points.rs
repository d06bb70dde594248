//! The initial points: `init_pt_cld.npz` of Dynamic 3D Gaussians.

use std::path::Path;

use tcgs_core::PointCloud;
use tcgs_interchange::NpzReader;

use crate::CaptureError;

/// Columns of a row: position, colour, foreground.
const COLUMNS: usize = 7;

/// How far beyond `[0, 1]` a colour may lie before it is taken for another scale than for rounding.
const COLOR_TOLERANCE: f32 = 0.01;

/// Reads the array `data` `[P, 7]`: `x, y, z` in scene units, `r, g, b` in `[0, 1]`, foreground 0 or 1.
pub(crate) fn read(path: &Path) -> Result<PointCloud, CaptureError> {
    let data = NpzReader::open(path)?.array("data")?;
    let invalid = |problem: String| CaptureError::invalid(path, format!("data {problem}"));
    let &[num_points, COLUMNS] = data.shape.as_slice() else {
        return Err(invalid(format!("has the shape {:?}, expected [points, {COLUMNS}]: x y z r g b seg", data.shape)));
    };
    if num_points == 0 {
        return Err(invalid("has no points, expected at least one".into()));
    }
    let rows = data.values.as_chunks::<COLUMNS>().0;
    let range = -COLOR_TOLERANCE..=1.0 + COLOR_TOLERANCE;
    for (row, values) in rows.iter().enumerate() {
        if let Some(color) = values[3..6].iter().find(|&color| !range.contains(color)) {
            return Err(invalid(format!("has the colour {color} in row {row}, expected 0 to 1")));
        }
    }
    Ok(PointCloud {
        points: rows.iter().map(|&[x, y, z, ..]| [x, y, z]).collect(),
        colors: rows.iter().map(|&[_, _, _, r, g, b, _]| [r, g, b].map(|c| c.clamp(0.0, 1.0))).collect(),
        foreground: rows.iter().map(|row| row[6] > 0.5).collect(),
    })
}

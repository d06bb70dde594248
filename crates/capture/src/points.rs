//! The initial points of a capture, and how each was made, where the file says it. They are read from `init_pt_cld.npz`
//! of Dynamic 3D Gaussians, PLY or a COLMAP model, and written as `init_pt_cld.npz`.

use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_core::{MAX_COORDINATE, PointCloud};
use tcgs_interchange::{NpzReader, NpzWriter, ReadLimits, read_ply_points};

use crate::{CaptureError, Origin, Prepared, colmap, files};

/// File name of the initial points in the form of Dynamic 3D Gaussians (Luiten et al. 2024). A capture of any kind may
/// have this file; its points precede all others.
pub const POINTS_FILE: &str = "init_pt_cld.npz";

/// Files that a capture of any kind may have beside its own; the first that exists counts. The preparation of Neural 3D
/// Video for 4D Gaussian Splatting leaves the last one.
const FILES: [&str; 3] = [POINTS_FILE, "points3D.ply", "points3D_downsample2.ply"];

/// The array with the origin of each point, beside `data`, which other programs read.
const ORIGINS: &str = "origin";

/// Columns of a row: position, colour, foreground.
const COLUMNS: usize = 7;

/// Tolerance of colours beyond `[0, 1]`: less is rounding, more is another scale.
const COLOR_TOLERANCE: f32 = 0.01;

/// Source of the initial points of a capture.
#[derive(Clone, Debug)]
pub(crate) enum Points {
    File(PathBuf),
    InMemory(Arc<PointCloud>),
}

/// Finds the points of a capture.
///
/// - `own`: the file of points that this kind of capture has; the files that every kind may have precede it
pub(crate) fn find(capture: &Path, own: Option<PathBuf>) -> Option<Points> {
    FILES.iter().map(|name| capture.join(name)).find(|path| path.is_file()).or(own).map(Points::File)
}

/// Reads points, by the kind of the file.
pub(crate) fn read(path: &Path) -> Result<PointCloud, CaptureError> {
    let cloud = read_unchecked(path)?;
    let far = |point: &[f32; 3]| point.iter().copied().find(|x| !x.is_finite() || f64::from(x.abs()) > MAX_COORDINATE);
    match cloud.points.iter().enumerate().find_map(|(i, point)| Some((i, far(point)?))) {
        Some((i, found)) => Err(CaptureError::invalid(
            path,
            format!("point {i} has the coordinate {found:e}, expected {MAX_COORDINATE:e} or less in magnitude"),
        )),
        None => Ok(cloud),
    }
}

fn read_unchecked(path: &Path) -> Result<PointCloud, CaptureError> {
    if path.is_dir() {
        let file = colmap::points_in(path).ok_or_else(|| {
            CaptureError::invalid(path, "has no points3D.bin or points3D.txt, expected the folder of a COLMAP model")
        })?;
        return colmap::read_points(&file);
    }
    let name = files::name(path);
    let read = match name.rsplit('.').next().unwrap_or_default() {
        "npz" => read_npz,
        "ply" => |path: &Path| Ok(read_ply_points(path, ReadLimits::default())?),
        "bin" | "txt" => colmap::read_points,
        _ => {
            let problem = "is of no known kind, expected points as .npz, .ply, or points3D.bin or .txt of COLMAP";
            return Err(CaptureError::invalid(path, problem));
        }
    };
    files::check_regular(path)?;
    read(path)
}

/// Writes a point cloud as [`POINTS_FILE`]: an npz archive with the array `data`, `[P, 7]` float32, whose columns are
/// `x, y, z` in scene units, `r, g, b` in `[0, 1]`, and foreground, 0 or 1. Equal clouds give equal bytes.
///
/// - `writer`: the file; `write_points` flushes it
/// - `cloud`: `P` points with as many colours and labels
///
/// ```
/// use tcgs_core::PointCloud;
/// use tcgs_capture::{POINTS_FILE, write_points};
/// let folder = tempfile::tempdir()?;
/// let cloud = PointCloud { points: vec![[0.0, 1.0, 2.0]], colors: vec![[0.5; 3]], foreground: vec![true] };
/// let file = std::fs::File::create(folder.path().join(POINTS_FILE))?;
/// write_points(std::io::BufWriter::new(file), &cloud)?;
/// # Ok::<(), std::io::Error>(())
/// ```
///
/// # Errors
/// The errors of `writer`.
///
/// # Panics
/// If the cloud has fewer colours or labels than points.
pub fn write_points(writer: impl Write + Seek, cloud: &PointCloud) -> io::Result<()> {
    write(writer, cloud, &[])
}

/// As [`write_points`], with a second array `origin`, `[P]` uint8: the index of each point's [`Origin`] in
/// [`Origin::ALL`]. Programs that read `data` alone are not affected.
///
/// # Errors
/// The errors of `writer`.
///
/// # Panics
/// If the prepared points have fewer colours, labels or origins than points.
pub fn write_prepared(writer: impl Write + Seek, prepared: &Prepared) -> io::Result<()> {
    assert_eq!(prepared.origins.len(), prepared.cloud.points.len(), "origins and points");
    write(writer, &prepared.cloud, &prepared.origins)
}

/// - `origins`: of all points; if empty, no origins are written
fn write(writer: impl Write + Seek, cloud: &PointCloud, origins: &[Origin]) -> io::Result<()> {
    let num_points = cloud.points.len();
    let rows: Vec<f32> = (0..num_points)
        .flat_map(|i| {
            let ([x, y, z], [r, g, b]) = (cloud.points[i], cloud.colors[i]);
            [x, y, z, r, g, b, f32::from(u8::from(cloud.foreground[i]))]
        })
        .collect();
    let mut npz = NpzWriter::new(writer);
    npz.array("data", &[num_points, COLUMNS], [&rows[..]])?;
    if !origins.is_empty() {
        let codes: Vec<u8> = origins.iter().map(|&origin| origin as u8).collect();
        npz.array(ORIGINS, &[num_points], [&codes[..]])?;
    }
    npz.finish()?.flush()
}

/// The origin of each point of a file; `None` if the file has no origins.
pub(crate) fn read_origins(path: &Path) -> Result<Option<Vec<Origin>>, CaptureError> {
    if files::name(path).rsplit('.').next() != Some("npz") {
        return Ok(None);
    }
    files::check_regular(path)?;
    let mut npz = NpzReader::open(path)?;
    if !npz.contains(ORIGINS) {
        return Ok(None);
    }
    npz.check_copies(ORIGINS, 2)?;
    let codes = npz.array_of::<u8>(ORIGINS)?;
    let invalid = |found: String, expected: String| {
        CaptureError::invalid(path, format!("{ORIGINS} {found}, expected {expected}"))
    };
    let [num_points] = codes.shape[..] else {
        return Err(invalid(format!("has the shape {:?}", codes.shape), "[points]".into()));
    };
    debug_assert_eq!(num_points, codes.values.len());
    let origin = |&code: &u8| {
        let known = Origin::ALL.get(usize::from(code)).copied();
        known.ok_or_else(|| invalid(format!("has the code {code}"), format!("0 to {}", Origin::ALL.len() - 1)))
    };
    codes.values.iter().map(origin).collect::<Result<_, _>>().map(Some)
}

/// Reads the array `data` `[P, 7]`: `x, y, z` in scene units, `r, g, b` in `[0, 1]`, foreground 0 or 1.
fn read_npz(path: &Path) -> Result<PointCloud, CaptureError> {
    let mut npz = NpzReader::open(path)?;
    // The array, and the points made of it.
    npz.check_copies("data", 2)?;
    let data = npz.array("data")?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_come_back_and_unknown_ones_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(POINTS_FILE);
        let num_points = Origin::ALL.len();
        let cloud = PointCloud {
            points: vec![[1.0; 3]; num_points],
            colors: vec![[0.5; 3]; num_points],
            foreground: vec![true; num_points],
        };
        let prepared = Prepared { cloud, origins: Origin::ALL.into(), agreement: 0.5 };
        write_prepared(std::fs::File::create(&path).unwrap(), &prepared).unwrap();
        assert_eq!(read_origins(&path).unwrap(), Some(Origin::ALL.into()));
        assert_eq!(read(&path).unwrap().points.len(), num_points);
        write_points(std::fs::File::create(&path).unwrap(), &prepared.cloud).unwrap();
        assert_eq!(read_origins(&path).unwrap(), None);
        let mut npz = NpzWriter::new(std::fs::File::create(&path).unwrap());
        npz.array(ORIGINS, &[2], [&[0_u8, 9][..]]).unwrap();
        npz.finish().unwrap();
        let refused = read_origins(&path).unwrap_err().to_string();
        assert!(refused.ends_with("origin has the code 9, expected 0 to 4"), "{refused}");
    }
}

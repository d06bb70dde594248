//! Calibrations that other programs wrote, in the conventions of this project.
//!
//! What lives here: one file for each format, with the meaning of the format's numbers, and the choice among the
//! formats. What does not: the assignment of cameras to videos, and the check of sizes (`raw`).
//!
//! Formats differ in the origin of pixels, the unit, the direction of the transform and the order of the distortion.
//! Every reader returns the same convention: pixel centres at +0.5, `camera_from_world`, camera axes x right, y down, z
//! forward, OpenCV's order of the distortion.

mod aniposelib;
mod caliscope;
mod colmap;
mod nerfstudio;
mod numbers;
mod opencv;
mod qualisys;

use std::path::{Path, PathBuf};

use crate::{CaptureError, files};

/// The cameras of one calibration.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Short name of the format, such as `qualisys`.
    pub format: &'static str,
    /// The file or folder that was read.
    pub path: PathBuf,
    /// Whether lengths are in metres, as the format promises or after conversion.
    pub in_metres: bool,
    /// The cameras, in the order of the file.
    pub cameras: Vec<CalibratedCamera>,
}

/// One camera of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedCamera {
    /// The names of videos to which the camera may belong, the most telling first.
    pub names: Vec<String>,
    /// Width and height in pixels of the images that the calibration was made with, if the file says.
    pub size: Option<(usize, usize)>,
    /// Horizontal angle of view in radians, where the file gives this and no size. Focal lengths and principal point
    /// are then zero, and follow from the size of the images.
    pub angle_x: Option<f64>,
    /// Focal lengths `fx, fy`, pixels.
    pub focal: [f64; 2],
    /// Principal point `cx, cy`, pixels; pixel centres at +0.5.
    pub principal: [f64; 2],
    /// `k1, k2, p1, p2, k3, k4, k5, k6` of OpenCV's model.
    pub distortion: [f64; 8],
    /// `[3][4]` row-major rigid transform, camera axes x right, y down, z forward.
    pub camera_from_world: [[f64; 4]; 3],
}

/// One format of calibrations.
pub(crate) struct Format {
    pub name: &'static str,
    /// The files by which a person recognises the format.
    pub mark: &'static str,
    /// The calibrations of this format in a folder.
    pub find: fn(&Path) -> Result<Vec<PathBuf>, CaptureError>,
    /// Whether a file or folder is a calibration of this format.
    pub is: fn(&Path) -> bool,
    pub read: fn(&Path) -> Result<Vec<CalibratedCamera>, CaptureError>,
    pub in_metres: bool,
}

/// All formats. The order decides only the order in messages.
const FORMATS: [Format; 6] =
    [opencv::FORMAT, caliscope::FORMAT, aniposelib::FORMAT, qualisys::FORMAT, colmap::FORMAT, nerfstudio::FORMAT];

impl Calibration {
    /// Finds and reads the calibration that lies in a folder.
    ///
    /// - returns: `None` if the folder holds no calibration of a known format
    ///
    /// # Errors
    /// [`CaptureError`] if there are several, or if the one that is there cannot be read.
    pub fn find(folder: &Path) -> Result<Option<Self>, CaptureError> {
        let mut found = Vec::new();
        for format in &FORMATS {
            found.extend((format.find)(folder)?.into_iter().map(|path| (format, path)));
        }
        match found.as_slice() {
            [] => Ok(None),
            [(format, path)] => format.calibration(path).map(Some),
            several => {
                let names: Vec<String> = several.iter().map(|(_, path)| files::name(path)).collect();
                Err(CaptureError::invalid(
                    folder,
                    format!("has several calibrations ({}), expected one, or to be told which", names.join(", ")),
                ))
            }
        }
    }

    /// Reads a calibration of any known format.
    ///
    /// - `path`: the file, or the folder of a COLMAP model or of `intri.yml` and `extri.yml`
    ///
    /// # Errors
    /// [`CaptureError`] if the format is unknown, or the file is damaged or holds what no pinhole camera has.
    pub fn read(path: &Path) -> Result<Self, CaptureError> {
        if !path.exists() {
            return Err(CaptureError::invalid(path, "no such file, expected a calibration"));
        }
        let format = FORMATS.iter().find(|format| (format.is)(path)).ok_or_else(|| {
            CaptureError::invalid(path, format!("is no calibration of a known format, expected {}", Self::marks()))
        })?;
        format.calibration(path)
    }

    /// The files by which the known formats are recognised, for messages.
    pub fn marks() -> String {
        FORMATS.map(|format| format.mark).join(", ")
    }
}

impl Format {
    fn calibration(&self, path: &Path) -> Result<Calibration, CaptureError> {
        let cameras = (self.read)(path)?;
        if cameras.is_empty() {
            return Err(CaptureError::invalid(path, "has no cameras, expected at least one"));
        }
        Ok(Calibration { format: self.name, path: path.into(), in_metres: self.in_metres, cameras })
    }
}

/// The files of a folder whose name `is` accepts.
fn files_named(folder: &Path, is: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, CaptureError> {
    let mut paths = files::list(folder)?;
    paths.retain(|path| path.is_file() && is(&files::name(path)));
    Ok(paths)
}

#[cfg(test)]
mod tests;

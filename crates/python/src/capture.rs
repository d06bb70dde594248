//! Captures: cameras and images.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};

use crate::arrays::{array, pixels};
use crate::camera::PyCamera;
use crate::detached::detached;
use crate::errors::exception;
use crate::memory::{MAX_SIDE, image_size};
use crate::numbers::Whole;
use crate::save::write_folder;

/// Images of synchronized cameras: a folder of one of the kinds that `tcgs train` takes. Each image is decoded on
/// request.
///
/// - path: str or os.PathLike of the folder
#[pyclass(name = "Capture", module = "tcgs", frozen)]
pub struct PyCapture {
    pub capture: Capture,
    pub path: PathBuf,
}

/// A capture, or the name of its folder.
#[derive(FromPyObject)]
pub enum CaptureLike<'py> {
    /// Open already.
    Open(PyRef<'py, PyCapture>),
    /// `str` or `os.PathLike`.
    Path(PathBuf),
}

impl CaptureLike<'_> {
    /// The folder.
    pub fn path(&self) -> &Path {
        match self {
            Self::Open(capture) => &capture.path,
            Self::Path(path) => path,
        }
    }

    /// The capture, opened if need be.
    pub fn open(&self, py: Python<'_>) -> PyResult<Capture> {
        match self {
            Self::Open(capture) => Ok(capture.capture.clone()),
            Self::Path(path) => detached(py, || Capture::open(path)).map_err(exception),
        }
    }
}

/// The cameras of a name.
///
/// - `name`: name of the argument
///
/// # Errors
/// `ValueError` for another name.
pub fn split(name: &str, cameras: &str) -> PyResult<Split> {
    match cameras {
        "test" => Ok(Split::Test),
        "train" => Ok(Split::Train),
        "all" => Ok(Split::All),
        other => Err(PyValueError::new_err(format!("{name}: is {other}, expected test, train or all"))),
    }
}

fn check_frame(frame: Whole) -> PyResult<usize> {
    frame.within("frame", 0..=usize::MAX)
}

/// Factor by which images are shrunk; it may still be too large for them.
pub fn check_downscale(downscale: Whole) -> PyResult<usize> {
    downscale.within("downscale", 1..=MAX_SIDE)
}

#[pymethods]
impl PyCapture {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let capture = detached(py, || Capture::open(&path)).map_err(exception)?;
        Ok(Self { capture, path })
    }

    /// Number of frames.
    fn __len__(&self) -> usize {
        self.capture.num_frames()
    }

    /// Frames a second.
    #[getter]
    fn fps(&self) -> f64 {
        self.capture.frame_rate()
    }

    /// Kind of the folder, such as "panoptic".
    #[getter]
    fn kind(&self) -> &'static str {
        self.capture.kind().name
    }

    /// The folder as given.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// The cameras of one frame by their numbers. Decodes no image.
    ///
    /// - which: "train", "test" (held out from training) or "all"
    /// - frame: from 0
    /// - downscale: factor by which images are shrunk
    #[pyo3(signature = (which = "test", *, frame = Whole::of(0), downscale = Whole::of(1)),
        text_signature = "($self, which='test', *, frame=0, downscale=1)")]
    fn cameras(&self, which: &str, frame: Whole, downscale: Whole) -> PyResult<BTreeMap<usize, PyCamera>> {
        let (split, frame, downscale) = (split("which", which)?, check_frame(frame)?, check_downscale(downscale)?);
        let cameras = self.capture.cameras(split, frame, downscale).map_err(exception)?;
        Ok(cameras.into_iter().map(|(id, camera)| (id, PyCamera(camera))).collect())
    }

    /// The images of one frame by the numbers of their cameras, [height, width, 3] float32 in [0, 1].
    ///
    /// The arguments are those of `cameras`.
    #[pyo3(signature = (which = "test", *, frame = Whole::of(0), downscale = Whole::of(1)),
        text_signature = "($self, which='test', *, frame=0, downscale=1)")]
    fn images<'py>(
        &self,
        py: Python<'py>,
        which: &str,
        frame: Whole,
        downscale: Whole,
    ) -> PyResult<BTreeMap<usize, Bound<'py, PyArrayDyn<f32>>>> {
        let (split, frame, downscale) = (split("which", which)?, check_frame(frame)?, check_downscale(downscale)?);
        let views = detached(py, || self.capture.views(split, frame, downscale)).map_err(exception)?;
        let image = |image: &tcgs_core::Image| array(py, pixels(image), &[image.height, image.width, 3]);
        Ok(views.iter().map(|view| (view.camera_id, image(&view.image))).collect())
    }

    fn __repr__(&self) -> String {
        let (path, kind, frames) = (self.path.display(), self.kind(), self.__len__());
        format!("Capture({path}, {kind}: {frames} frames, {} fps)", self.fps())
    }
}

/// Ray-traces the capture of `tcgs demo` into a new folder: moving objects in a room, seen by 12 training and 2 test
/// cameras.
///
/// - width, height: size of the images, pixels
/// - frames: number of frames per camera, up to 65,536
/// - points: number of initial points for training, up to 16,777,216
/// - seed: seed of their positions
#[pyfunction]
#[pyo3(signature = (path, *, width = Whole::of(128), height = Whole::of(96), frames = Whole::of(24),
    points = Whole::of(8000), seed = Whole::of(0)),
    text_signature = "(path, *, width=128, height=96, frames=24, points=8000, seed=0)")]
pub fn make_demo_capture(
    py: Python<'_>,
    path: PathBuf,
    width: Whole,
    height: Whole,
    frames: Whole,
    points: Whole,
    seed: Whole,
) -> PyResult<()> {
    let [width, height] = image_size(width, height)?;
    let settings = SyntheticSettings {
        width,
        height,
        num_timesteps: frames.within("frames", 1..=1 << 16)?,
        num_points: points.within("points", 1..=1 << 24)?,
        seed: seed.within("seed", 0..=u64::MAX)?,
        ..Default::default()
    };
    let write = || write_folder(&path, |new| Ok(write_synthetic(new, &settings)?));
    detached(py, write).map_err(exception)
}

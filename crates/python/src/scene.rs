//! Scenes over time.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyRange, PyString};
use tcgs_core::{SceneReader, Tour};
use tcgs_interchange::{Axes, HigherHarmonics, ReadLimits, ReadSettings};
use tcgs_pipeline::{CutFiles, OpenScene, OpenSettings};

use crate::arrays::ArrayLike;
use crate::camera::PyCamera;
use crate::detached::detached;
use crate::errors::exception;
use crate::floats::floats;
use crate::gaussians::PyGaussians;
use crate::memory::image_size;
use crate::numbers::{Number, Whole};
use crate::save::{check_out, save};
use crate::watch::Watch;

/// Most cameras of an orbit: they take some 500 MB as objects of Python.
const MAX_CAMERAS: usize = 1_000_000;

/// A scene over time: Gaussians at every timestep. `tcgs.open` opens one, `Scene.from_arrays` makes one.
///
/// Timesteps are read, and segments of a .tcgs file decoded, on request.
#[pyclass(name = "Scene", module = "tcgs", frozen, weakref)]
pub struct PyScene(pub Arc<OpenScene>);

/// A scene, its arrays, or the name of a file or folder that holds one.
#[derive(FromPyObject)]
pub enum SceneLike<'py> {
    /// Open already.
    Open(PyRef<'py, PyScene>),
    /// Keyed by the argument names of `Scene.from_arrays`.
    Arrays(Bound<'py, PyDict>),
    /// `str` or `os.PathLike`.
    Path(PathBuf),
}

impl SceneLike<'_> {
    /// The scene, opened if need be.
    pub fn open(&self, py: Python<'_>) -> PyResult<Arc<OpenScene>> {
        match self {
            Self::Open(scene) => Ok(Arc::clone(&scene.0)),
            Self::Arrays(arrays) => {
                let scene = py.get_type::<PyScene>().call_method("from_arrays", (), Some(arrays))?;
                Ok(Arc::clone(&scene.extract::<PyRef<'_, PyScene>>()?.0))
            }
            Self::Path(path) => open_path(py, path, OpenSettings::default()).map(Arc::new),
        }
    }
}

fn open_path(py: Python<'_>, path: &Path, settings: OpenSettings) -> PyResult<OpenScene> {
    if ["http://", "https://"].iter().any(|scheme| path.to_string_lossy().starts_with(scheme)) {
        let expected = "a file or folder of this machine; tcgs.open opens an address";
        return Err(PyValueError::new_err(format!("{}: is an address, expected {expected}", path.display())));
    }
    detached(py, || OpenScene::open(path, settings)).map_err(exception)
}

/// A file or folder, or several: the chapters of one scene.
pub enum OneOrMore {
    /// `str` or `os.PathLike`.
    One(PathBuf),
    /// Several of these.
    More(Vec<PathBuf>),
}

impl FromPyObject<'_, '_> for OneOrMore {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        if let Ok(path) = given.extract() {
            return Ok(Self::One(path));
        }
        // Read one by one, because the length that an object declares may exceed any memory.
        let mut paths = Vec::new();
        for path in given.try_iter()? {
            paths.push(path?.extract()?);
        }
        Ok(Self::More(paths))
    }
}

/// Opens a scene of this machine; `tcgs.open` has the rest.
#[pyfunction]
#[pyo3(signature = (path, *, drop_sh = false, axes = None, recover = false, no_limits = false, fps = None,
    segment_length = None))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn open(
    py: Python<'_>,
    path: OneOrMore,
    drop_sh: bool,
    axes: Option<&str>,
    recover: bool,
    no_limits: bool,
    fps: Option<Number>,
    segment_length: Option<Whole>,
) -> PyResult<PyScene> {
    let axes =
        axes.map(|letters| letters.parse::<Axes>().map_err(|error| PyValueError::new_err(format!("axes: {error}"))));
    let settings = OpenSettings {
        read: ReadSettings {
            higher_harmonics: if drop_sh { HigherHarmonics::Drop } else { HigherHarmonics::Keep },
            axes: axes.transpose()?,
            limits: if no_limits { ReadLimits::NONE } else { ReadLimits::default() },
        },
        cut_files: if recover { CutFiles::Recover } else { CutFiles::Refuse },
    };
    let fps = fps.map(check_fps).transpose()?;
    let segment_length = segment_length.map(check_segment_length).transpose()?;
    let mut scene = match path {
        OneOrMore::One(path) => open_path(py, &path, settings)?,
        OneOrMore::More(paths) if paths.is_empty() => {
            return Err(PyValueError::new_err("open: no path, expected at least one"));
        }
        OneOrMore::More(paths) => {
            let chapters = paths.iter().map(|path| open_path(py, path, settings)).collect::<PyResult<_>>()?;
            detached(py, || OpenScene::join(chapters, segment_length)).map_err(exception)?
        }
    };
    if let Some(fps) = fps {
        scene.frame_rate = fps;
    }
    Ok(PyScene(scene.into()))
}

fn check_fps(fps: Number) -> PyResult<f64> {
    fps.such("fps", "a number of 0 or more", |fps| fps >= 0.0)
}

/// Most timesteps of a segment.
pub fn check_segment_length(length: Whole) -> PyResult<u32> {
    length.within("segment_length", 1..=1 << 16)
}

#[pymethods]
impl PyScene {
    /// A scene from arrays, in memory. T is the number of timesteps, N that of Gaussians.
    ///
    /// - means: [T, N, 3], scene units
    /// - quats: [T, N, 4], w, x, y, z, of any length but zero
    /// - colors: [T, N, 3], sRGB
    /// - scales or log_scales: [N, 3] or [T, N, 3], standard deviations in scene units, or their natural logarithms
    /// - opacities or logit_opacities: [N] or [T, N], in (0, 1), or their inverse logistic
    /// - harmonics: [N, K, 3] or [T, N, K, 3] with K of 3, 8 or 15: coefficients of degrees 1 to 1, 2 or 3
    /// - fps: timesteps a second; 0: unknown
    /// - name: name of the scene in messages
    #[staticmethod]
    #[pyo3(signature = (means, quats, colors, *, scales = None, log_scales = None, opacities = None,
        logit_opacities = None, harmonics = None, fps = Number::of(30.0), name = "arrays"),
        text_signature = "(means, quats, colors, *, scales=None, log_scales=None, opacities=None, \
        logit_opacities=None, harmonics=None, fps=30.0, name='arrays')")]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn from_arrays(
        means: ArrayLike<'_>,
        quats: ArrayLike<'_>,
        colors: ArrayLike<'_>,
        scales: Option<ArrayLike<'_>>,
        log_scales: Option<ArrayLike<'_>>,
        opacities: Option<ArrayLike<'_>>,
        logit_opacities: Option<ArrayLike<'_>>,
        harmonics: Option<ArrayLike<'_>>,
        fps: Number,
        name: &str,
    ) -> PyResult<Self> {
        let fps = check_fps(fps)?;
        let scales = [log_scales, scales];
        let opacities = [logit_opacities, opacities];
        let floats = floats(&means, &quats, &colors, scales, opacities, harmonics)?;
        Ok(Self(Arc::new(OpenScene::of_floats(Path::new(name), floats, fps))))
    }

    fn __len__(&self) -> usize {
        self.0.num_timesteps()
    }

    /// The Gaussians of one timestep, with colours as drawn. For a run these are all Gaussians, including those that
    /// its masks leave out.
    ///
    /// - timestep: from 0; negative ones count from the end
    fn at(&self, py: Python<'_>, timestep: Whole) -> PyResult<PyGaussians> {
        let timestep = self.timestep(timestep.index())?;
        detached(py, || self.0.lit(timestep)).map(PyGaussians::new).map_err(exception)
    }

    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let timesteps = PyRange::new(slf.py(), 0, slf.get().0.num_timesteps() as isize)?;
        slf.py().import("builtins")?.call_method1("map", (slf.getattr("at")?, timesteps))
    }

    fn __getitem__(&self, py: Python<'_>, timestep: Whole) -> PyResult<PyGaussians> {
        self.at(py, timestep)
    }

    /// Number of Gaussians at a timestep. For a .tcgs file in which Gaussians are born or die it is an upper bound: the
    /// length of `at(timestep)` is exact.
    fn num_gaussians_at(&self, timestep: Whole) -> PyResult<usize> {
        Ok(self.0.num_gaussians_at(self.timestep(timestep.index())?))
    }

    /// Number of Gaussians that live at some timestep. None if files do not identify Gaussians across timesteps, and
    /// their number changes.
    #[getter]
    fn num_identities(&self) -> Option<usize> {
        self.0.num_identities()
    }

    /// Timesteps a second; 0: unknown.
    #[getter]
    fn fps(&self) -> f64 {
        self.0.frame_rate
    }

    /// File or folder as given.
    #[getter]
    fn path(&self) -> PathBuf {
        self.0.path.clone()
    }

    /// Kind of scene, in words, such as "compressed file".
    #[getter]
    fn kind(&self) -> &'static str {
        self.0.kind()
    }

    /// Name of the capture in a .tcgs file; empty for anything else.
    #[getter]
    fn name(&self) -> String {
        self.0.name().unwrap_or_default().into()
    }

    /// Length of a .tcgs file, bytes; for anything else the size of the scene as plain float32.
    #[getter]
    fn bytes(&self) -> u64 {
        self.0.bytes
    }

    /// Frame of the capture that timestep 0 shows.
    #[getter]
    fn first_frame(&self) -> usize {
        self.0.first_frame
    }

    /// Factor by which the capture's images were shrunk for training.
    #[getter]
    fn downscale(&self) -> usize {
        self.0.downscale
    }

    /// Whether the scene is drawn with antialiasing: a splat that is widened by a pixel's extent loses as much opacity.
    #[getter]
    fn antialiased(&self) -> bool {
        self.0.layout().is_antialiased()
    }

    /// Colour behind all Gaussians: red, green and blue, sRGB in [0, 1]. The Gaussians were trained on it.
    #[getter]
    fn background(&self) -> (f32, f32, f32) {
        self.0.layout().background_color().into()
    }

    /// Highest degree of the spherical harmonics; 0 without any.
    #[getter]
    fn sh_degree(&self) -> usize {
        self.0.layout().sh_degree()
    }

    /// The axis of the world that points up: x, y, z, -x, -y, -z; empty if unknown.
    #[getter]
    fn up(&self) -> &'static str {
        if self.0.up() == tcgs_codec::UpAxis::Unknown { "" } else { self.0.up().name() }
    }

    /// Assumptions at the opening of another program's file, and replacements at the timesteps that were read so far.
    /// Empty for anything else.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.0.notes().iter().map(ToString::to_string).collect()
    }

    /// Largest error of each attribute against the compressed scene, as a .tcgs file declares it: means in scene units,
    /// quats in radians, log_scales as stored, logit_opacities as opacity, colors of 1. Empty for anything else.
    #[getter]
    fn declared_errors(&self) -> BTreeMap<String, f32> {
        self.0.declared_errors().into_iter().collect()
    }

    /// Cameras of the capture that a .tcgs file offers as start views, by name; empty for anything else.
    #[getter]
    fn cameras(&self, py: Python<'_>) -> PyResult<BTreeMap<String, PyCamera>> {
        let cameras = detached(py, || self.0.cameras()).map_err(exception)?;
        Ok(cameras.into_iter().map(|named| (named.name, PyCamera(named.camera))).collect())
    }

    /// Cameras at equal steps on the path of `tcgs render --path orbit`. The path leads around the moving part of the
    /// scene. If nothing moves, it leads around the point at which the capture's cameras look. Without such cameras it
    /// is a circle.
    ///
    /// - count: up to 1,000,000
    /// - width, height: size of their images, pixels
    #[pyo3(signature = (count, *, width = Whole::of(640), height = Whole::of(360)),
        text_signature = "($self, count, *, width=640, height=360)")]
    fn orbit(&self, py: Python<'_>, count: Whole, width: Whole, height: Whole) -> PyResult<Vec<PyCamera>> {
        let (count, size) = (count.within("count", 0..=MAX_CAMERAS)?, image_size(width, height)?);
        let cameras = detached(py, || self.0.tour(Tour::Orbit, 0, count, size)).map_err(exception)?;
        Ok(cameras.into_iter().map(PyCamera).collect())
    }

    /// Writes the scene in the format that the ending of `path` names. .tcgs is compressed as by `compress`, or copied
    /// if the scene is compressed. .npz is params.npz of Dynamic 3D Gaussians. .4dgs and .usda hold all timesteps.
    /// .ply, .compressed.ply, .spz, .glb and .sog hold one. A name without an ending becomes a new folder with a PLY
    /// file for each timestep. Gaussians that the masks of a run leave out over time are not written.
    ///
    /// - overwrite: replace a file that exists; folders are never replaced
    #[pyo3(signature = (path, *, overwrite = false, progress = true, callback = None))]
    fn save(
        &self,
        py: Python<'_>,
        path: PathBuf,
        overwrite: bool,
        progress: bool,
        callback: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        check_out(&path, overwrite)?;
        Watch::call(py, callback, progress, |watch| save(&self.0, &path, overwrite, watch))
    }

    /// Shows the player in a cell of Jupyter, served by this process until it ends. A scene that is not compressed is
    /// shown as a compressed copy. The player needs a browser with WebGPU or WebGL2 on this machine; if the kernel runs
    /// elsewhere, forward the port of `address`.
    ///
    /// - height: height of the cell, pixels
    ///
    /// Raises RuntimeError if this package was built without the player.
    #[pyo3(signature = (*, height = Whole::of(480)), text_signature = "($self, *, height=480)")]
    fn show<'py>(slf: Bound<'py, Self>, height: Whole) -> PyResult<Bound<'py, PyAny>> {
        let height = height.within("height", 1..=u32::MAX)?;
        slf.py().import("tcgs._show")?.call_method1("show", (slf, height))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let path = PyString::new(py, &self.0.path.to_string_lossy()).repr()?.to_string();
        let n = self.0.num_identities().unwrap_or_else(|| self.0.max_gaussians());
        let (kind, t) = (self.0.kind(), self.0.num_timesteps());
        Ok(format!("Scene({path}, {kind}: {n} Gaussians, {t} timesteps, {} fps)", self.0.frame_rate))
    }
}

impl PyScene {
    /// Checks a timestep, and returns it as an index from 0.
    pub fn timestep(&self, timestep: isize) -> PyResult<usize> {
        let count = self.0.num_timesteps();
        let from_start = if timestep < 0 { timestep.saturating_add_unsigned(count) } else { timestep };
        usize::try_from(from_start).ok().filter(|&found| found < count).ok_or_else(|| {
            let path = self.0.path.display();
            PyIndexError::new_err(format!("{path}: no timestep {timestep}, expected one below {count}"))
        })
    }
}

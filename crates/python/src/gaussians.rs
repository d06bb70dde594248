//! One timestep of a scene as arrays.

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;
use tcgs_core::{Activated, Attribute, Gaussians, activate};

use crate::arrays::frozen;
use crate::detached::detached;

type Array = Py<PyArrayDyn<f32>>;

/// The Gaussians of one timestep, as stored and as drawn. Arrays are float32 and read-only; copy one to change it.
#[pyclass(name = "Gaussians", module = "tcgs", frozen)]
pub struct PyGaussians {
    stored: Gaussians,
    activated: PyOnceLock<Activated>,
    /// Requested arrays, by name.
    arrays: [PyOnceLock<Array>; NUM_ARRAYS],
    extra: PyOnceLock<Vec<(String, Array)>>,
}

const NUM_ARRAYS: usize = 9;

impl PyGaussians {
    pub fn new(stored: Gaussians) -> Self {
        let arrays = [const { PyOnceLock::new() }; NUM_ARRAYS];
        Self { stored, activated: PyOnceLock::new(), arrays, extra: PyOnceLock::new() }
    }

    fn len(&self) -> usize {
        self.stored.num_gaussians()
    }

    fn activated(&self, py: Python<'_>) -> &Activated {
        self.activated.get_or_init(py, || detached(py, || activate(&self.stored)))
    }

    /// The array at `place`, created on the first request.
    fn array(&self, py: Python<'_>, place: usize, components: usize, values: impl FnOnce() -> Vec<f32>) -> Array {
        let shape = [self.len(), components];
        let shape = if components == 1 { &shape[..1] } else { &shape[..] };
        self.arrays[place].get_or_init(py, || frozen(py, values(), shape)).clone_ref(py)
    }

    fn further(&self, py: Python<'_>, attribute: Attribute) -> Array {
        let shape = [self.len(), attribute.components()];
        let shape = if attribute.components() == 1 { &shape[..1] } else { &shape[..] };
        frozen(py, self.stored.values(attribute).to_vec(), shape)
    }

    fn stored(&self, py: Python<'_>, attribute: Attribute) -> Array {
        self.array(py, attribute.index(), attribute.components(), || self.stored.values(attribute).to_vec())
    }
}

#[pymethods]
impl PyGaussians {
    fn __len__(&self) -> usize {
        self.len()
    }

    /// [N, 3] centres, scene units.
    #[getter]
    fn means(&self, py: Python<'_>) -> Array {
        self.stored(py, Attribute::Mean)
    }

    /// [N, 4] rotations w, x, y, z as stored, of any length but zero.
    #[getter]
    fn quats(&self, py: Python<'_>) -> Array {
        self.stored(py, Attribute::Quat)
    }

    /// [N, 3] natural logarithms of the standard deviations along the local axes, of scene units.
    #[getter]
    fn log_scales(&self, py: Python<'_>) -> Array {
        self.stored(py, Attribute::LogScale)
    }

    /// [N] inverse logistic of the opacities.
    #[getter]
    fn logit_opacities(&self, py: Python<'_>) -> Array {
        self.stored(py, Attribute::LogitOpacity)
    }

    /// [N, 3] sRGB, not clamped; with harmonics the colour of degree 0.
    #[getter]
    fn colors(&self, py: Python<'_>) -> Array {
        self.stored(py, Attribute::Color)
    }

    /// [N, 4] rotations w, x, y, z of length 1.
    #[getter]
    fn unit_quats(&self, py: Python<'_>) -> Array {
        self.array(py, 5, 4, || self.activated(py).quats.as_flattened().to_vec())
    }

    /// [N, 3] standard deviations along the local axes, scene units.
    #[getter]
    fn scales(&self, py: Python<'_>) -> Array {
        self.array(py, 6, 3, || self.activated(py).scales.as_flattened().to_vec())
    }

    /// [N] opacities in [0, 1].
    #[getter]
    fn opacities(&self, py: Python<'_>) -> Array {
        self.array(py, 7, 1, || self.activated(py).opacities.clone())
    }

    /// [N, (degree + 1)² - 1, 3] coefficients of the spherical harmonics of the degrees from 1 on, with red, green and
    /// blue of each together; [N, 0, 3] without harmonics.
    #[getter]
    fn harmonics(&self, py: Python<'_>) -> Array {
        self.arrays[8].get_or_init(py, || frozen_harmonics(py, &self.stored)).clone_ref(py)
    }

    /// Names of all columns in the order of files; those of harmonics are sh1, sh2, sh3.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.stored.layout().columns().iter().map(|column| column.name.clone()).collect()
    }

    /// Further columns by name, [N, components] each, as stored; [N] of one component.
    #[getter]
    fn extra<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let make = || {
            let layout = self.stored.layout();
            let harmonics = layout.harmonics();
            let further = layout.columns()[Attribute::BASE.len()..].iter();
            let others = further.filter(|column| !harmonics.contains(&column.attribute));
            others.map(|column| (column.name.clone(), self.further(py, column.attribute))).collect()
        };
        let all: &Vec<(String, Array)> = self.extra.get_or_init(py, make);
        let dict = PyDict::new(py);
        all.iter().try_for_each(|(name, array)| dict.set_item(name, array.clone_ref(py)))?;
        Ok(dict)
    }

    fn __repr__(&self) -> String {
        format!("Gaussians({}, {})", self.len(), self.stored.layout())
    }
}

/// The bands of all degrees side by side.
fn frozen_harmonics(py: Python<'_>, stored: &Gaussians) -> Array {
    let bands = stored.layout().harmonics();
    let coefficients: usize = bands.iter().map(|band| band.components() / 3).sum();
    let num_gaussians = stored.num_gaussians();
    let mut values = Vec::with_capacity(num_gaussians * coefficients * 3);
    for i in 0..num_gaussians {
        for &band in &bands {
            let components = band.components();
            values.extend_from_slice(&stored.values(band)[i * components..(i + 1) * components]);
        }
    }
    frozen(py, values, &[num_gaussians, coefficients, 3])
}

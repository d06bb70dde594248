//! The functions that JavaScript calls.

use js_sys::{Array, Error, Float32Array, Object, Reflect, Uint8Array};
use tcgs_codec::{DecodeError, DecodeLimits, SceneFile, SegmentCache};
use tcgs_core::{SceneReader, activate};
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsCast, JsValue};

use crate::Arrived;

/// Bytes of a file that are kept for the next timestep, which often lies in the same part.
const MAX_HELD: usize = 1 << 26;

/// A scene whose bytes arrive in parts. A call that returns nothing lacked bytes: `missing` says which.
#[wasm_bindgen]
pub struct Decoder {
    arrived: Arrived,
    file: Option<SceneFile<Arrived>>,
}

#[wasm_bindgen]
impl Decoder {
    /// - `length`: bytes of the file
    #[wasm_bindgen(constructor)]
    pub fn new(length: f64) -> Self {
        Self { arrived: Arrived::new(length as u64), file: None }
    }

    /// The first missing byte of the last call, and the end of the missing range; nothing if no byte was missing.
    pub fn missing(&self) -> Option<Vec<f64>> {
        self.arrived.missing().map(|range| vec![range.start as f64, range.end as f64])
    }

    /// Adds bytes of the file, from `offset` on.
    pub fn arrive(&self, offset: f64, bytes: Vec<u8>) {
        self.arrived.arrive(offset as u64, bytes);
    }

    /// The file's description of its scene.
    pub fn info(&mut self) -> Result<Option<Object>, JsValue> {
        if self.file.is_none() {
            let opened = SceneFile::open(self.arrived.clone(), &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES);
            self.file = patient(opened)?;
        }
        let Some(file) = &self.file else { return Ok(None) };
        let (info, bounds) = (file.info(), file.archive().bounds());
        Ok(Some(object([
            ("name", info.name.as_str().into()),
            ("numTimesteps", info.num_timesteps.into()),
            ("maxGaussians", (file.max_gaussians() as u32).into()),
            ("frameRate", info.frame_rate.into()),
            ("shDegree", (file.layout().sh_degree() as u32).into()),
            ("antialiased", file.layout().is_antialiased().into()),
            ("background", Float32Array::from(&file.layout().background_color()[..]).into()),
            ("up", Float32Array::from(&info.up.direction().map(|x| x as f32)[..]).into()),
            ("boundsMin", Float32Array::from(&bounds[0][..]).into()),
            ("boundsMax", Float32Array::from(&bounds[1][..]).into()),
        ])))
    }

    /// Data that programs attached to the scene: pairs of a name and bytes.
    pub fn data(&mut self) -> Result<Option<Array>, JsValue> {
        let Some(data) = patient(self.opened()?.application_data())? else { return Ok(None) };
        let pair = |(name, bytes): (String, Vec<u8>)| Array::of2(&name.into(), &Uint8Array::from(&bytes[..]).into());
        Ok(Some(data.into_iter().map(pair).collect()))
    }

    /// The Gaussians that live at a timestep, ready to be drawn.
    ///
    /// - `timestep`: below the number of timesteps of `info`, which must have been called
    pub fn at(&mut self, timestep: u32) -> Result<Option<Object>, JsValue> {
        let Some(gaussians) = patient(self.opened()?.lit(timestep as usize))? else { return Ok(None) };
        if self.arrived.held() > MAX_HELD {
            self.arrived.forget();
        }
        let drawn = activate(&gaussians);
        let floats = |values: &[f32]| JsValue::from(Float32Array::from(values));
        Ok(Some(object([
            ("numGaussians", (drawn.num_gaussians() as u32).into()),
            ("means", floats(drawn.means.as_flattened())),
            ("quats", floats(drawn.quats.as_flattened())),
            ("scales", floats(drawn.scales.as_flattened())),
            ("opacities", floats(&drawn.opacities)),
            ("colors", floats(&drawn.colors)),
            ("harmonics", floats(&gaussians.harmonic_rows())),
        ])))
    }
}

impl Decoder {
    fn opened(&mut self) -> Result<&mut SceneFile<Arrived>, JsValue> {
        self.file.as_mut().ok_or_else(|| Error::new("call info first").into())
    }
}

/// Nothing if bytes are missing.
fn patient<T>(done: Result<T, DecodeError>) -> Result<Option<T>, JsValue> {
    match done {
        Ok(done) => Ok(Some(done)),
        Err(DecodeError::Io(_)) => Ok(None),
        Err(error) => Err(Error::new(&error.to_string()).into()),
    }
}

fn object<const K: usize>(properties: [(&str, JsValue); K]) -> Object {
    let object = Object::new();
    for (name, value) in properties {
        // This fails only on frozen objects.
        let _ = Reflect::set(object.unchecked_ref(), &name.into(), &value);
    }
    object
}

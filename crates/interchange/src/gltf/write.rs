//! Writes Gaussians as a `.glb` file: one primitive, one buffer, all numbers floats.

use std::io::{self, Write};

use serde_json::{Value, json};
use tcgs_core::{Gaussians, normalize, sigmoid};

use super::{BIN, EXTENSION, JSON, attribute, harmonic};
use crate::axes::Axes;
use crate::stored::sh0_from_color;

/// An attribute of the primitive.
struct Written {
    name: String,
    components: usize,
    bytes: Vec<u8>,
    /// 5126 for floats, 5121 for normalised bytes.
    component_type: u32,
}

/// Writes the Gaussians of one timestep as a `.glb` file with `KHR_gaussian_splatting`, with the harmonics that their
/// layout has, for viewers of glTF. Further columns are left out. Equal Gaussians give equal bytes.
///
/// - `writer`: should be buffered
/// - `gaussians`: `[N]`, stored form, in the axes of PLY files; at least one
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{ReadSettings, read_gaussians, write_glb_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.glb");
/// let mut gaussians = Gaussians::zeros(5);
/// gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
/// gaussians.means_mut()[3] = [1.0, 2.0, 3.0];
/// write_glb_to(std::fs::File::create(&path)?, &gaussians)?;
/// assert_eq!(read_gaussians(&path, ReadSettings::default())?.means(), gaussians.means());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of `writer`; [`io::ErrorKind::InvalidInput`] if there are more than 4 GiB, which is all that such a file
/// holds.
pub fn write_glb_to(mut writer: impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let written = attributes(gaussians);
    let (document, num_bytes) = document(gaussians, &written);
    let mut json = serde_json::to_vec(&document)?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = |length: usize| {
        let too_long = || io::Error::new(io::ErrorKind::InvalidInput, "a .glb file holds at most 4 GiB");
        u32::try_from(length).map_err(|_| too_long())
    };
    let whole = length(12 + 8 + json.len() + 8 + num_bytes)?;
    for number in [u32::from_le_bytes(*b"glTF"), 2, whole, length(json.len())?, JSON] {
        writer.write_all(&number.to_le_bytes())?;
    }
    writer.write_all(&json)?;
    for number in [length(num_bytes)?, BIN] {
        writer.write_all(&number.to_le_bytes())?;
    }
    written.iter().try_for_each(|attribute| writer.write_all(&attribute.bytes))
}

fn attributes(gaussians: &Gaussians) -> Vec<Written> {
    let mut turned = gaussians.clone();
    Axes::LUF.turn(&mut turned);
    let floats = |name: String, components: usize, values: Vec<f32>| {
        let bytes = values.into_iter().flat_map(f32::to_le_bytes).collect();
        Written { name, components, bytes, component_type: 5126 }
    };
    // A rotation without a direction becomes the identity, as in renderers.
    let rotation = |quat: &[f32; 4]| match normalize(quat.map(f64::from)) {
        [0.0, 0.0, 0.0, 0.0] => [0.0, 0.0, 0.0, 1.0],
        [w, x, y, z] => [x, y, z, w].map(|x| x as f32),
    };
    let colors = turned.colors().iter().zip(turned.logit_opacities());
    let byte = |x: f32| (x.clamp(0.0, 1.0) * 255.0).round() as u8;
    let color_bytes = colors.flat_map(|(&[r, g, b], &opacity)| [r, g, b, sigmoid(opacity)].map(byte)).collect();
    let mut written = vec![
        floats("POSITION".into(), 3, turned.means().as_flattened().to_vec()),
        Written { name: "COLOR_0".into(), components: 4, bytes: color_bytes, component_type: 5121 },
        floats(attribute("ROTATION"), 4, turned.quats().iter().flat_map(rotation).collect()),
        floats(
            attribute("SCALE"),
            3,
            turned
                .log_scales()
                .as_flattened()
                .iter()
                .map(|s| f64::from(*s).exp().min(f32::MAX.into()) as f32)
                .collect(),
        ),
        floats(
            attribute("OPACITY"),
            1,
            turned.logit_opacities().iter().map(|&o| sigmoid(f64::from(o)) as f32).collect(),
        ),
        floats(harmonic(0, 0), 3, turned.colors().as_flattened().iter().map(|&c| sh0_from_color(c)).collect()),
    ];
    for (l, band) in (1..).zip(turned.layout().harmonics()) {
        for n in 0..=2 * l {
            let rows = turned.values(band).chunks_exact(band.components());
            written.push(floats(harmonic(l, n), 3, rows.flat_map(|row| row[3 * n..3 * n + 3].to_vec()).collect()));
        }
    }
    written
}

/// The JSON, and the length of the buffer.
fn document(gaussians: &Gaussians, written: &[Written]) -> (Value, usize) {
    let mut num_bytes = 0;
    let (mut views, mut accessors, mut attributes) = (vec![], vec![], serde_json::Map::new());
    for (i, Written { name, components, bytes, component_type }) in written.iter().enumerate() {
        // Numbers of four bytes, or four of one, so all begin at a multiple of four.
        views.push(json!({ "buffer": 0, "byteOffset": num_bytes, "byteLength": bytes.len(), "target": 34962 }));
        num_bytes += bytes.len();
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"][components - 1];
        let count = gaussians.num_gaussians();
        let mut accessor = json!({ "bufferView": i, "componentType": component_type, "count": count, "type": shape });
        if *component_type == 5121 {
            accessor["normalized"] = true.into();
        }
        accessors.push(accessor);
        attributes.insert(name.clone(), i.into());
    }
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for &[x, y, z] in gaussians.means() {
        for (c, value) in [-x, -y, z].into_iter().enumerate() {
            (low[c], high[c]) = (low[c].min(value), high[c].max(value));
        }
    }
    (accessors[0]["min"], accessors[0]["max"]) = (json!(low), json!(high));
    let extension = json!({
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    });
    let document = json!({
        "asset": { "version": "2.0", "generator": concat!("tcgs ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "mode": 0, "extensions": { EXTENSION: extension } }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": num_bytes }],
    });
    (document, num_bytes)
}

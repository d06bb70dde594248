//! The weights of the networks, from a safetensors file.
//!
//! `<network>.conv<i>.kernel` `[size, size, in, out]`, `<network>.conv<i>.bias` `[out]` and `<network>.head<j>`
//! `[channels]`, all f32, `<network>` being `vgg` or `alex`. `scripts/fetch_lpips_weights.py` makes such a file.

use std::path::Path;

use safetensors::{Dtype, SafeTensors};
use tcgs_core::read_file;

use super::backbone::{Backbone, Step};
use super::layers::Convolution;
use super::network::Network;
use crate::MetricsError;

/// Most bytes of the file, which has 69 million.
const MAX_BYTES: u64 = 1 << 28;

/// Reads both networks.
pub fn read(path: &Path) -> Result<[Network; 2], MetricsError> {
    let bytes = read_file(path, MAX_BYTES).map_err(|error| MetricsError::Io { path: path.into(), error })?;
    let problem = |problem: String| MetricsError::Weights { path: path.into(), problem };
    let tensors = SafeTensors::deserialize(&bytes).map_err(|error| problem(format!("not safetensors ({error})")))?;
    let [vgg, alex] = Backbone::ALL.map(|backbone| network(backbone, &tensors).map_err(problem));
    Ok([vgg?, alex?])
}

fn network(backbone: Backbone, tensors: &SafeTensors<'_>) -> Result<Network, String> {
    let tensor = |name: &str, shape: &[usize]| tensor(tensors, &format!("{}.{name}", backbone.name()), shape);
    let mut network = Network { backbone, convolutions: Vec::new(), heads: Vec::new() };
    let mut in_channels = 3;
    for step in backbone.steps() {
        let Step::Convolve(shape) = step else { continue };
        let (index, out_channels) = (network.convolutions.len(), shape.channels);
        network.convolutions.push(Convolution {
            size: shape.size,
            stride: shape.stride,
            padding: shape.padding,
            in_channels,
            out_channels,
            kernel: tensor(&format!("conv{index}.kernel"), &[shape.size, shape.size, in_channels, out_channels])?,
            bias: tensor(&format!("conv{index}.bias"), &[out_channels])?,
        });
        if shape.compared {
            network.heads.push(tensor(&format!("head{}", network.heads.len()), &[out_channels])?);
        }
        in_channels = out_channels;
    }
    Ok(network)
}

fn tensor(tensors: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
    let found = tensors.tensor(name).map_err(|_| format!("has no tensor {name}"))?;
    if found.dtype() != Dtype::F32 || found.shape() != shape {
        return Err(format!("{name} is {:?} {:?} where F32 {shape:?} belongs", found.dtype(), found.shape()));
    }
    let values: Vec<f32> = found.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    if values.iter().any(|v| !v.is_finite()) {
        return Err(format!("{name} holds a value that is not finite"));
    }
    Ok(values)
}

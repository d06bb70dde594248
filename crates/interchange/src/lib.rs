//! Other programs' model files, both ways.
//!
//! What lives here: `params.npz` of Dynamic 3D Gaussians, and the npz archives it is one of. What
//! does not: our own format (the codec), images and cameras (the capture).

mod error;
mod npy;
mod npz;
mod params_npz;

pub use error::InterchangeError;
pub use npy::NpyArray;
pub use npz::{NpzReader, NpzWriter};
pub use params_npz::{ParamsExtras, read_params_npz, write_params_npz, write_params_npz_to};

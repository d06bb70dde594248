//! Other programs' model files, both ways.
//!
//! What lives here: `params.npz` of Dynamic 3D Gaussians, and the npz archives it is one of; PLY files of 3D
//! Gaussian splatting, one a timestep, and of points; and how files come to be whole or not at all ([`write_whole`]), for
//! all that writes them. What does not: our own format (the codec), images and cameras (the capture).

mod error;
mod npy;
mod npz;
mod params_npz;
mod ply;
mod ply_points;
mod ply_sequence;
mod unfinished;

pub use error::InterchangeError;
pub use npy::{NpyArray, NpyValue, read_npy};
pub use npz::{NpzReader, NpzWriter};
pub use params_npz::{
    ParamsExtras, ParamsOrigin, read_params_npz, read_params_origin, write_params_npz, write_params_npz_to,
};
pub use ply::{HigherHarmonics, read_ply, write_ply_to};
pub use ply_points::read_ply_points;
pub use ply_sequence::{PlyFiles, PlySequence, read_ply_sequence};
pub use unfinished::{Existing, Unfinished, is_unfinished, remove_unfinished, write_whole};

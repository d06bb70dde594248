//! Reads and writes other programs' model files.
//!
//! | files | reading | writing |
//! |---|---|---|
//! | `params.npz` of Dynamic 3D Gaussians | [`read_params_npz`], [`ParamsNpz`], [`read_params_origin`], [`read_params_foreground`] | [`write_params_npz`] |
//! | PLY of 3D Gaussian splatting, one file per timestep | [`read_ply_sequence`], [`PlyFiles`] | [`write_ply_to`] |
//! | PLY of points | [`read_ply_points`] | – |
//! | npz archives and npy arrays of any content | [`NpzReader`], [`read_npy`] | [`NpzWriter`] |
//!
//! What lives here: these formats, and atomic writing of files ([`write_whole`], [`Unfinished`]) for every crate that
//! writes any. What does not: the format `.tcgs` (the codec), images and cameras (the capture).

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
    ParamsExtras, ParamsNpz, ParamsOrigin, read_params_foreground, read_params_npz, read_params_origin,
    write_params_npz, write_params_npz_from, write_params_npz_to,
};
pub use ply::{HigherHarmonics, read_ply, write_ply_to};
pub use ply_points::read_ply_points;
pub use ply_sequence::{PlyFiles, PlySequence, read_ply_sequence};
pub use unfinished::{Existing, Unfinished, is_unfinished, remove_unfinished, write_whole};

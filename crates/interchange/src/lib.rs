//! Reads and writes other programs' model files.
//!
//! | files | reading | writing |
//! |---|---|---|
//! | `params.npz` of Dynamic 3D Gaussians | [`read_params_npz`], [`ParamsNpz`], [`read_params_origin`], [`read_params_foreground`] | [`write_params_npz`] |
//! | one file per timestep: any of the following, also of several kinds | [`TimestepFiles`], [`read_gaussians`] | – |
//! | PLY of 3D Gaussian splatting | [`read_ply`] | [`write_ply_to`] |
//! | compressed PLY of `SuperSplat` and splat-transform | [`read_ply`] | [`write_compressed_ply_to`] |
//! | SPZ, versions 2 to 4 | [`read_gaussians`] | [`write_spz_to`], version 3 or 4 |
//! | glTF with `KHR_gaussian_splatting`, `.glb` and `.gltf` | [`read_gaussians`] | [`write_glb_to`], `.glb` |
//! | SOG, version 2, `.sog` | [`read_gaussians`] | [`write_sog_to`] |
//! | unpacked SOG, `meta.json` beside images | [`read_gaussians`] | [`sog_files`] |
//! | animated USD, `.usda`, a whole scene | – | [`write_usda_to`] |
//! | `.4dgs`, a whole scene | [`FourdgsFile`] | [`fourdgs_bytes`] |
//! | PLY of points | [`read_ply_points`] | – |
//! | npz archives and npy arrays of any content | [`NpzReader`], [`read_npy`] | [`NpzWriter`] |
//! | `.splat` of antimatter15's viewer | [`read_gaussians`] | – |
//! | `.ksplat` of `GaussianSplats3D`, version 0.1 | [`read_gaussians`] | – |
//! | other archives | recognised alone: [`UnreadKind`] | – |
//!
//! What lives here: these formats, and atomic writing of files ([`write_whole`], [`Unfinished`]) for every crate that
//! writes any. What does not: the format `.tcgs` (the codec), images and cameras (the capture).

mod axes;
mod error;
mod fourdgs;
mod gaussian_file;
mod gltf;
mod input;
mod ksplat;
mod notes;
mod npy;
mod npz;
mod params_npz;
mod ply;
mod ply_points;
mod settings;
mod sog;
mod space_order;
mod splat;
mod spz;
mod stored;
#[cfg(test)]
mod testing;
mod timestep_files;
mod unfinished;
mod unread;
mod usd;

pub use axes::Axes;
pub use error::InterchangeError;
pub use fourdgs::{FourdgsFile, fourdgs_bytes};
pub use gaussian_file::read_gaussians;
pub use gltf::write_glb_to;
pub use notes::ReadNote;
pub use npy::{NpyArray, NpyValue, read_npy};
pub use npz::{NpzReader, NpzWriter};
pub use params_npz::{
    ParamsExtras, ParamsNpz, ParamsOrigin, read_params_foreground, read_params_npz, read_params_origin,
    write_params_npz, write_params_npz_from, write_params_npz_to,
};
pub use ply::{read_ply, write_compressed_ply_to, write_ply_to};
pub use ply_points::read_ply_points;
pub use settings::{HigherHarmonics, ReadLimits, ReadSettings};
pub use sog::{is_sog_file, sog_files, write_sog_to};
pub use space_order::space_order;
pub use spz::{SpzVersion, write_spz_to};
pub use timestep_files::TimestepFiles;
pub use unfinished::{
    ABANDONED, Existing, Kept, Unfinished, create_folders, is_unfinished, moving, parent_folder, remove_held,
    remove_unfinished, write_whole,
};
pub use unread::UnreadKind;
pub use usd::write_usda_to;

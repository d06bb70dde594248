//! The `.tcgs` format, version 1 (`docs/FORMAT.md`): lossless conversion between a compact scene and the bytes of a
//! file.
//!
//! - `container`, `section`: header, table of contents, checksums; a cursor over the fields of a section
//! - `head`: the sections `INFO` and `PLAN`
//! - `coder`, `number`: adaptive entropy coding (rANS) of symbols and numbers
//! - `neighbors`, `shared`: the shared layers: widths and first codes, predicted from Gaussians nearby
//! - `keypoints`: the sections of segments: times and codes of keypoints, predicted from earlier and neighbouring
//!   motion
//! - `encode`, `fit`: a compact scene to a file
//! - `archive`, `reader`, `segment`: parts of a file to codes and floats
//! - `decode`, `push`, `inspect`: a whole file at once, a file in pieces, a description of a file
//!
//! Version 1 of the format has exactly the columns of [`Attribute::BASE`](tcgs_core::Attribute::BASE), in this order: the
//! arrays of length 5 in this folder are by [`Attribute::index`](tcgs_core::Attribute::index) of these columns. An encoder
//! refuses a [`Layout`](tcgs_core::Layout) with others.
//!
//! `shared` and `keypoints` describe the coded symbols once for both directions (see `coder`). Only this folder depends
//! on the layout of a file.

mod archive;
mod coder;
mod container;
mod decode;
#[cfg(feature = "encode")]
mod encode;
#[cfg(feature = "encode")]
mod fit;
mod head;
mod inspect;
mod keypoints;
mod neighbors;
mod number;
mod push;
mod reader;
mod section;
mod segment;
mod shared;

pub use archive::{Archive, Opening};
pub use container::MAGIC;
pub use decode::decode;
pub(crate) use decode::end_of_file;
#[cfg(feature = "encode")]
pub use encode::{encode, encode_to, encode_with};
pub use inspect::{Contents, FileInfo, SectionInfo, application_data, inspect, inspect_cut};
pub use push::{Decoder, Event};
pub use segment::{Keypoints, Sampler, Segment};

/// Version of the format that this crate writes, and the only version that it reads.
pub const FORMAT_VERSION: u16 = 1;

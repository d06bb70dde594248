//! The `.tcgs` format (`docs/FORMAT.md`), versions 1 and 2: lossless conversion between compact scenes and the bytes of
//! a file. Both versions code symbols alike; they differ in their containers and in what these may hold.
//!
//! - `container`, `section`: positions of sections in a file, checksums; a cursor over the fields of a section
//! - `head`, `plan`: descriptions of a scene, and of a cohort of its Gaussians
//! - `coder`, `number`: adaptive entropy coding (rANS) of symbols and numbers
//! - `neighbors`, `shared`: the shared layers: widths and first codes, predicted from Gaussians nearby
//! - `keypoints`: the sections of segments: times and codes of keypoints, predicted from earlier and neighbouring
//!   motion
//! - `encode`, `fit`: compact scenes to a file
//! - `archive`, `cohort`, `reader`, `segment`: parts of a file to codes and floats
//! - `decode`, `push`, `inspect`: a whole file at once, a file in pieces, a description of a file
//!
//! `shared` and `keypoints` describe the coded symbols once for both directions (see `coder`). Only this folder depends
//! on the layout of a file.

mod archive;
mod coder;
mod cohort;
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
mod plan;
mod push;
mod reader;
mod section;
mod segment;
mod shared;

pub use archive::{Archive, Opening};
pub use cohort::Cohort;
pub use container::MAGIC;
pub use decode::{decode, decode_cohorts};
pub(crate) use decode::{decode_archive, end_of_file, other_attributes};
#[cfg(feature = "encode")]
pub use encode::{FileWriter, encode, encode_cohorts, encode_to, encode_with};
pub use inspect::{CohortInfo, Contents, FileInfo, SectionInfo, application_data, inspect, inspect_cut};
pub use push::{Decoder, Event};
pub use segment::{Keypoints, Sampler, Segment};

/// The newest version of the format that this crate writes and reads; it also reads and writes all older versions.
pub const FORMAT_VERSION: u16 = 2;

//! Between symbols and bytes: the `.tcgs` container, version 1 (`docs/FORMAT.md`).
//!
//! - `container`, `section`: magic, version, table of contents, checksums; reading one field after another
//! - `head`: what is known before any symbol
//! - `coder`, `number`: adaptive entropy coding of symbols and numbers
//! - `neighbors`, `shared`: layers: widths, first codes, predicted from Gaussians nearby
//! - `keypoints`: segments: times and codes of keypoints, predicted from motion before and nearby
//! - `encode`, `fit`: a scene to bytes
//! - `archive`, `reader`, `segment`: parts of a file to codes and floats; `decode`, `push`: the whole
//!
//! What `shared` and `keypoints` code is written once for both directions (see `coder`). Nothing outside
//! this folder knows bytes.

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
pub use inspect::{Contents, FileInfo, SectionInfo, application_data, inspect};
pub use push::{Decoder, Event};
pub use segment::{Keypoints, Sampler, Segment};

/// Version that is written, and the only one read.
pub const FORMAT_VERSION: u16 = 1;

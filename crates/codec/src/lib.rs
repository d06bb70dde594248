//! Compression of dynamic Gaussians and the `.tcgs` container.
//!
//! Three layers, strictly apart: a scene of floats (`tcgs_core::DynamicGaussians`) · its symbols
//! ([`CompactScene`]: codes at keypoints, bit widths, quantizers) · bytes ([`encode`], [`decode`]).
//! [`compress`] and [`CompactScene::reconstruct`] join the first two and lose information; the bytes
//! lose none. This crate reads bytes that nobody vouches for: no unsafe code, every allocation under
//! [`DecodeLimits`].

#![forbid(unsafe_code)]
// Both directions are written side by side; for decoding alone one of them is idle.
#![cfg_attr(not(feature = "encode"), allow(dead_code))]

mod accounting;
mod bits;
mod bitstream;
mod cache;
mod compact;
#[cfg(feature = "encode")]
mod compress;
mod error;
mod keypoints;
mod limits;
mod morton;
mod parallel;
mod quantize;
mod scene_file;
mod views;

pub use bits::{BitMap, BitMapping, BitSettings, assign_bits};
pub use bitstream::{
    Archive, Contents, Decoder, Event, FORMAT_VERSION, FileInfo, Keypoints, MAGIC, Opening, Sampler, SectionInfo,
    Segment, application_data, decode, inspect,
};
#[cfg(feature = "encode")]
pub use bitstream::{encode, encode_to, encode_with};
pub use cache::{Eviction, Playback, SegmentCache};
pub use compact::{ColorSpace, CompactScene, SceneInfo, Tracks, UpAxis};
#[cfg(feature = "encode")]
pub use compress::{CompressSettings, compress, compress_ordered, compress_reader};
pub use error::{CompressError, DecodeError};
pub use keypoints::{interpolate, select as select_keypoints};
pub use limits::DecodeLimits;
pub use quantize::{MAX_BITS, Quantizer, Quantizers, lsq_step};
pub use scene_file::SceneFile;
pub use views::{FileCamera, VIEWS, read_views, write_views};

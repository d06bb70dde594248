//! Compression of dynamic Gaussians and the `.tcgs` container.
//!
//! A scene has three representations. Floats are [`tcgs_core::DynamicGaussians`]. Codes are [`CompactScene`]
//! (keypoints, bit widths, quantizers), and [`CompactFile`] for several of them. Bytes are a `.tcgs` file
//! (`docs/FORMAT.md`). [`compress()`] and [`CompactScene::reconstruct`] convert between floats and codes;
//! [`compress()`] is lossy. [`encode`] and [`decode`] convert between codes and bytes without loss.
//!
//! | a program wants to | entry point |
//! |---|---|
//! | make a file | [`assign_bits`] or [`BitMap::uniform`], [`compress()`], [`encode`] |
//! | read a whole file | [`decode`] |
//! | read single timesteps of a file, or what is left of a file that was cut | [`SceneFile`] |
//! | decode while bytes arrive | [`Decoder`] |
//! | fetch only the byte ranges that a timestep needs | [`Archive`] |
//! | describe a file | [`inspect`] |
//!
//! ```
//! use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode};
//! use tcgs_core::{DynamicGaussians, Gaussians};
//! let mut scene = DynamicGaussians::default();
//! scene.push(Gaussians::zeros(3)); // timestep 0
//! scene.push(Gaussians::zeros(3)); // timestep 1
//!
//! let bit_map = BitMap::uniform(3, 16, 6);
//! let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
//! let file: Vec<u8> = encode(&compact)?;
//!
//! let decoded = decode(&file, &DecodeLimits::default())?;
//! assert_eq!(decoded.reconstruct().means(1), scene.means(1));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The crate decodes untrusted bytes: it has no unsafe code, and every allocation whose size a file controls is charged
//! against [`DecodeLimits`] first. Without the feature `encode` only decoding is compiled; the feature `parallel`
//! decodes with several threads.

#![forbid(unsafe_code)]
// Code for both directions is written once, so decoding alone leaves some of it unused.
#![cfg_attr(not(feature = "encode"), allow(dead_code))]

mod accounting;
mod attached;
mod attribute_errors;
mod bits;
mod bitstream;
mod cache;
mod compact;
mod compact_file;
#[cfg(feature = "encode")]
mod compress;
mod error;
mod keypoints;
mod labels;
mod limits;
mod morton;
mod parallel;
mod quantize;
mod scene_file;
mod views;

pub use attached::{
    BACKGROUND, CREDITS, Credits, LIGHT, Light, SOUND, TIMES, TRUST, read_background, read_credits, read_light,
    read_times, read_trust, write_background, write_trust,
};
pub use attribute_errors::{AttributeErrors, attribute_error};
pub use bits::{BitMap, BitMapping, BitSettings, assign_bits};
pub use bitstream::{
    Archive, Cohort, CohortInfo, Contents, Decoder, Event, FORMAT_VERSION, FileInfo, Keypoints, MAGIC, Opening,
    Sampler, SectionInfo, Segment, application_data, decode, decode_cohorts, inspect, inspect_cut,
};
#[cfg(feature = "encode")]
pub use bitstream::{FileWriter, encode, encode_cohorts, encode_to, encode_with};
pub use cache::SegmentCache;
pub use compact::{ColorSpace, CompactScene, SceneInfo, Tracks, UpAxis};
pub use compact_file::CompactFile;
#[cfg(feature = "encode")]
pub use compress::{
    CompressSettings, Contemporaries, Followed, FollowedParts, compress, compress_ordered, compress_reader,
    contemporaries,
};
pub use error::{CompressError, DecodeError};
pub use keypoints::{interpolate, locate, select as select_keypoints};
pub use labels::{FOREGROUND, LABELS, Labels, read_labels};
pub use limits::DecodeLimits;
pub use quantize::{MAX_BITS, Quantizer, Quantizers, lsq_step};
pub use scene_file::{Loss, SceneFile};
pub use views::{FileCamera, VIEWS, read_views, write_views};

//! Between symbols and bytes: the `.tcgs` container, version 1 (`docs/FORMAT.md`).
//!
//! - `container`: magic, version, table of contents, checksums; knows no content
//! - `section`: which sections there are, and reading one field after another
//! - `stream`: many symbols as compressed bytes
//! - `residual`: symbols relative to a prediction
//! - `encode`, `decode`: what the sections say
//!
//! Nothing outside this folder knows bytes; nothing inside touches a float of a scene but the
//! quantizers' own.

mod container;
mod decode;
mod encode;
mod inspect;
mod residual;
mod section;
mod stream;

pub use decode::decode;
pub use encode::encode;
pub use inspect::{Contents, FileInfo, SectionInfo, inspect};

/// Version that is written, and the only one read.
pub const FORMAT_VERSION: u16 = 1;

use tcgs_core::Attribute;

use residual::Transform;

/// Gaussians of equal width in one attribute, in their order; widths ascending. Codes are stored group
/// by group: those of one width have one distribution.
fn groups_by_width(widths: &[u8]) -> Vec<(u8, Vec<usize>)> {
    let mut groups = std::collections::BTreeMap::new();
    for (gaussian, &width) in widths.iter().enumerate() {
        groups.entry(width).or_insert_with(Vec::new).push(gaussian);
    }
    groups.into_iter().collect()
}

/// Bytes of a symbol that takes `bits`.
fn bytes_of_bits(bits: u32) -> usize {
    bits.div_ceil(8) as usize
}

/// Bytes of a keypoint's count (less one) or time.
fn bytes_of_time(num_timesteps: usize) -> usize {
    if num_timesteps > 255 { 2 } else { 1 }
}

/// Of the first codes of tracks; the code before is that of the track before.
const FIRST_CODES: [Transform; 2] = [Transform::Plain, Transform::Difference];
/// Of the other codes; the code before is that of the same track.
const LATER_CODES: [Transform; 3] = [Transform::Plain, Transform::Difference, Transform::Motion];

/// Whether the first codes of an attribute are stored as gaps along the Morton curve.
fn along_curve(attribute: Attribute) -> bool {
    attribute == Attribute::Mean
}

//! The radix sort without a device: its sizes, the uniform of a pass, the shader. `gpu/radix.rs` explains the
//! algorithm.

use bytemuck::{Pod, Zeroable};

use super::dispatch::MAX_GROUPS;
use super::renderer::source;

/// Keys that one workgroup counts and scatters.
pub const SORT_BLOCK: usize = 1024;

/// Bits of a digit; a pass sorts by one digit.
const DIGIT_BITS: u32 = 8;

/// Values of a digit, and threads of a workgroup.
pub const NUM_DIGITS: usize = 1 << DIGIT_BITS;

/// Up to this many blocks, one workgroup scans all counts. One workgroup per digit would take longer because of its
/// barriers: on a processor that acts as a GPU, many times as long as everything else.
pub const FEW_BLOCKS: usize = 32;

/// Most keys that can be sorted: one workgroup per block, along x.
pub const MAX_KEYS: usize = MAX_GROUPS * SORT_BLOCK;

/// One pass of the sort, as `Sort` in `radix.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct SortUniform {
    /// Position of the digit's lowest bit in a key.
    pub shift: u32,
    /// Capacity of the buffers, keys.
    pub capacity: u32,
    /// Blocks of a full buffer, which is the length of a row of the table of counts.
    pub stride: u32,
    /// Not read.
    pub padding: u32,
}

/// The passes that sort keys by their lowest `bits`, in order.
///
/// - `capacity`: capacity of the buffers, keys
///
/// # Panics
/// If `bits` exceeds the 32 of a key.
pub fn sort_passes(capacity: usize, bits: u32) -> Vec<SortUniform> {
    assert!(bits <= u32::BITS, "keys of {bits} bits");
    let stride = capacity.div_ceil(SORT_BLOCK) as u32;
    let pass = |pass| SortUniform { shift: pass * DIGIT_BITS, capacity: capacity as u32, stride, padding: 0 };
    (0..bits.div_ceil(DIGIT_BITS)).map(pass).collect()
}

/// The source of the kernels `radix_count`, `radix_scan` and `radix_scatter`.
pub fn sort_source() -> String {
    source(1).constant("DIGITS", NUM_DIGITS).constant("FEW", FEW_BLOCKS).part(include_str!("radix.wgsl")).finish()
}

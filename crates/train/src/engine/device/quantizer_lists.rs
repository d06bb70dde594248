//! Members of each group of learned quantizers, as a device walks them.
//!
//! A group is one attribute at one bit width. A workgroup sums over the quantizers of one group only and writes one row
//! for each: no atomics, and every sum has a fixed order.

use super::packing::Packing;
use crate::fake_quant::FakeQuantizers;

/// Most members of a group that one workgroup handles.
const CHUNK: usize = 1024;

/// Most groups: a byte names one.
const MAX_GROUPS: usize = 256;

/// Tables of Q quantizers of N Gaussians.
#[derive(Debug, PartialEq)]
pub(crate) struct QuantizerLists {
    /// `[words, N]` position in [`FakeQuantizers::groups`] for each quantised column, a byte each; see
    /// [`Packing::group_byte`].
    pub groups: Vec<u32>,
    /// `[256]` first quantizer of a group; that of component `c` comes `c` later.
    pub group_starts: Vec<u32>,
    /// `[Q + 1]` first row of each quantizer in the partial sums, and the end.
    pub rows: Vec<u32>,
    /// Gaussians of all groups, group by group, ascending.
    pub members: Vec<u32>,
    /// First word of the column, components, first member, members; first quantizer, first row, rows from one component
    /// to the next, 0.
    pub chunks: Vec<[u32; 8]>,
}

impl QuantizerLists {
    /// Lists for `quantizers`; they may be none at all.
    ///
    /// # Panics
    /// If a Gaussian has a width that no group has, or there are more groups than a byte can name.
    pub fn new(packing: &Packing, quantizers: &FakeQuantizers) -> Self {
        let num_gaussians = quantizers.bit_map.num_gaussians();
        let places: Vec<_> = packing.quantized().collect();
        assert!(quantizers.groups.len() <= MAX_GROUPS, "{} groups of quantizers", quantizers.groups.len());
        let mut lists = Self {
            groups: vec![0; packing.group_words() * num_gaussians],
            group_starts: vec![0; MAX_GROUPS],
            rows: vec![0],
            members: Vec::new(),
            chunks: Vec::new(),
        };
        // First Gaussian, and what the shader reads.
        let mut chunks: Vec<(u32, [u32; 8])> = Vec::new();
        let mut first_quantizer = 0;
        for (group, &(attribute, width)) in quantizers.groups.iter().enumerate() {
            let widths = &quantizers.bit_map.widths[attribute.index()];
            let place = places.iter().position(|&a| a == attribute).expect("a group of a column that is quantised");
            let components = attribute.components() as u32;
            let first_word = (packing.offset(attribute) * num_gaussians) as u32;
            let first_member = lists.members.len();
            for i in (0..num_gaussians).filter(|&i| widths[i] == width) {
                let (word, shift) = Packing::group_byte(place, i, num_gaussians);
                lists.groups[word] |= (group as u32) << shift;
                lists.members.push(i as u32);
            }
            let num_chunks = (lists.members.len() - first_member).div_ceil(CHUNK) as u32;
            let first_row = lists.rows[first_quantizer as usize];
            for (i, chunk) in lists.members[first_member..].chunks(CHUNK).enumerate() {
                let first = (first_member + i * CHUNK) as u32;
                let [members, row] = [chunk.len() as u32, first_row + i as u32];
                chunks.push((chunk[0], [first_word, components, first, members, first_quantizer, row, num_chunks, 0]));
            }
            lists.group_starts[group] = first_quantizer;
            lists.rows.extend((1..=components).map(|c| first_row + c * num_chunks));
            first_quantizer += components;
        }
        assert_eq!(lists.members.len(), places.len() * num_gaussians, "members of all groups against Gaussians");
        // Chunks in the order of their first Gaussians, so that chunks that need the same memory find it in the cache.
        chunks.sort_by_key(|&(first, chunk)| (chunk[0], first));
        lists.chunks = chunks.into_iter().map(|(_, chunk)| chunk).collect();
        lists
    }

    /// Rows of all partial sums.
    pub fn num_rows(&self) -> usize {
        self.rows.last().map_or(0, |&rows| rows as usize)
    }
}

/// `[Q]` step, offset, lowest code, highest code, as the shaders read quantizers.
pub(crate) fn quantizer_rows(quantizers: &FakeQuantizers) -> Vec<[f32; 4]> {
    let row = |q: &tcgs_codec::Quantizer| [q.step, q.offset, q.min_code() as f32, q.max_code() as f32];
    quantizers.quantizers.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use tcgs_codec::BitMap;
    use tcgs_core::{Attribute, Gaussians, Layout};

    use super::*;

    #[test]
    fn chunks_cover_every_member_once() {
        let n = 3000;
        let mut bit_map = BitMap::uniform(n, 16, 6);
        bit_map.widths[Attribute::Quat.index()].iter_mut().step_by(3).for_each(|width| *width = 8);
        let quantizers = FakeQuantizers::new(bit_map, &Gaussians::zeros(n), true).unwrap();
        let lists = QuantizerLists::new(&Packing::new(&Layout::base()), &quantizers);
        // 2000 rotations have 6 bits and 1000 have 8.
        let of_quats: Vec<u32> = lists.chunks.iter().filter(|chunk| chunk[1] == 4).map(|chunk| chunk[3]).collect();
        assert_eq!(of_quats.iter().sum::<u32>(), 3000);
        assert_eq!(of_quats.len(), 3);
        let covered: u32 = lists.chunks.iter().map(|chunk| chunk[3]).sum();
        assert_eq!((covered as usize, lists.members.len()), (4 * n, 4 * n));
        assert_eq!((lists.rows.len(), lists.num_rows()), (quantizers.quantizers.len() + 1, 4 * 3 + 3 * 3 + 3 + 3 * 3));
        assert_eq!(lists.groups[0] & 255, 1);
        assert_eq!(lists.groups[1] & 255, 0);
    }
}

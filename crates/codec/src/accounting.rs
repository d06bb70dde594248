//! Sizes of a scene without entropy coding, as the paper counts sizes.
//!
//! The three sizes of [`CompactScene`] here separate the gain of quantisation and keypoints from the gain of the
//! entropy coder. The size of a `.tcgs` file is the length of the bytes that [`encode`](crate::encode()) returns.

use tcgs_core::Attribute;

use crate::compact::CompactScene;

/// A step and an offset, 32-bit floats each.
const QUANTIZER_BITS: u64 = 64;

impl CompactScene {
    /// Size of the reconstructed scene as 32-bit floats, in bytes: [`tcgs_core::DynamicGaussians::raw_bytes`] of
    /// [`Self::reconstruct`].
    pub fn raw_bytes(&self) -> u64 {
        let samples = |a: Attribute| if self.varies[a.index()] { self.num_timesteps() } else { 1 };
        let per_gaussian: usize = self.layout.attributes().map(|a| 4 * a.components() * samples(a)).sum();
        self.num_gaussians() as u64 * per_gaussian as u64
    }

    /// Size in the paper's sparse form without entropy coding, in bytes.
    ///
    /// - a track of an attribute that varies: one byte for the number of keypoints, or two bytes if any track of the
    ///   scene has more than 255. Each keypoint takes `ceil(log2 T)` bits for the timestep and the width of the code
    /// - a track of another attribute: the width of one code
    /// - the bit map: `ceil(log2(number of widths in use))` bits for each Gaussian and attribute
    /// - a quantizer: 64 bits, for step and offset
    pub fn plain_bytes(&self) -> u64 {
        let longest = self.tracks.iter().flat_map(|t| (0..t.len()).map(|i| t.track(i).0.len())).max();
        let count_bits = if longest.unwrap_or(0) > 255 { 16 } else { 8 };
        let time_bits = ceil_log2(self.num_timesteps());
        self.bytes_with(|attribute| {
            let varies = self.varies[attribute.index()];
            move |keypoints, width| {
                if varies { count_bits + keypoints as u64 * (time_bits + width) } else { width }
            }
        })
    }

    /// Size in bytes if every timestep of every attribute that varies were stored as a code, without keypoints or
    /// entropy coding. The bit map and the quantizers count as in [`Self::plain_bytes`].
    pub fn quantized_bytes(&self) -> u64 {
        let num_timesteps = self.num_timesteps() as u64;
        self.bytes_with(|attribute| {
            let samples = if self.varies[attribute.index()] { num_timesteps } else { 1 };
            move |_, width| samples * width
        })
    }

    /// Sum of the bits of all tracks, the bit map and the quantizers, in bytes.
    ///
    /// - `track_bits`: for an attribute, the bits of a track from its number of keypoints and its width
    fn bytes_with<F: Fn(usize, u64) -> u64>(&self, track_bits: impl Fn(Attribute) -> F) -> u64 {
        let histogram = self.bit_map.histogram();
        let bits: u64 = self
            .layout
            .attributes()
            .map(|attribute| {
                let index = attribute.index();
                let (components, widths) = (attribute.components(), &self.bit_map.widths[index]);
                let track_bits = track_bits(attribute);
                let tracks: u64 = (0..self.tracks[index].len())
                    .map(|i| track_bits(self.tracks[index].track(i).0.len(), u64::from(widths[i / components])))
                    .sum();
                let map = widths.len() as u64 * ceil_log2(histogram[index].len());
                let quantizers: u64 = self.quantizers.attributes[index]
                    .values()
                    .map(|channels| channels.len() as u64 * QUANTIZER_BITS)
                    .sum();
                tracks + map + quantizers
            })
            .sum();
        bits.div_ceil(8)
    }
}

/// `ceil(log2(count))`: the bits of an index below `count`; 0 for a count of 0.
fn ceil_log2(count: usize) -> u64 {
    u64::from(count.max(1).next_power_of_two().trailing_zeros())
}

#[cfg(test)]
mod tests {
    use tcgs_core::{DynamicGaussians, Gaussians};

    use super::*;
    use crate::{BitMap, CompressSettings, SceneInfo, compress};

    #[test]
    fn bits_tell_things_apart() {
        assert_eq!([1, 2, 3, 4, 5, 24, 150, 256, 257].map(ceil_log2), [0, 1, 2, 2, 3, 5, 8, 8, 9]);
    }

    #[test]
    fn sizes_are_those_counted_by_hand() {
        let mut scene = DynamicGaussians::default();
        for _ in 0..5 {
            let mut gaussians = Gaussians::zeros(2);
            gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
            scene.push(gaussians);
        }
        let mut bit_map = BitMap::uniform(2, 16, 4);
        bit_map.widths[Attribute::Color.index()] = vec![4, 8];
        let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::paper()).unwrap();
        // Five timesteps need 3 bits; every track keeps its two ends.
        let track = |width: u64| 8 + 2 * (3 + width);
        let tracks = 6 * track(16) + 8 * track(4) + 3 * track(4) + 3 * track(8) + 8 * 4;
        let quantizers = 64 * (3 + 4 + 3 + 1 + 2 * 3);
        assert_eq!(compact.plain_bytes(), (tracks + 2 + quantizers as u64).div_ceil(8));
        let samples = 5 * (6 * 16 + 8 * 4 + 3 * 4 + 3 * 8) + 8 * 4;
        assert_eq!(compact.quantized_bytes(), (samples + 2 + quantizers as u64).div_ceil(8));
        assert_eq!(compact.raw_bytes(), scene.raw_bytes());
    }
}

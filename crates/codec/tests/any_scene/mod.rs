//! Any scene that the format can say.

use std::collections::BTreeSet;

use tcgs_codec::{BitMap, ColorSpace, CompactScene, Quantizer, Quantizers, SceneInfo, Tracks, UpAxis};
use tcgs_core::{Attribute, Layout};

/// splitmix64 (Steele et al. 2014).
pub struct Numbers(pub u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    pub fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }

    /// In `[-1, 1)`.
    fn float(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

/// Widths, layers, segments, times and codes at random; codes are sometimes steady, as real ones are.
pub fn any_scene(num_gaussians: usize, num_timesteps: usize, seed: u64) -> CompactScene {
    let random = &mut Numbers(seed);
    let mut cuts: BTreeSet<usize> =
        (0..random.below(4)).map(|_| random.below(1 + num_gaussians as u64) as usize).collect();
    cuts.extend([0, num_gaussians]);
    let cuts: Vec<usize> = cuts.into_iter().collect();
    let mut scene = CompactScene {
        info: SceneInfo {
            num_gaussians: num_gaussians as u32,
            num_timesteps: num_timesteps as u32,
            first_frame: random.next() as u32,
            frame_rate: 30.0 + 30.0 * random.float(),
            downscale: 1 + random.below(8) as u32,
            name: ["", "basketball", "Küche"][random.below(3) as usize].to_owned(),
            generator: ["", "a test"][random.below(2) as usize].to_owned(),
            color_space: [ColorSpace::Srgb, ColorSpace::LinearSrgb][random.below(2) as usize],
            up: [UpAxis::Unknown, UpAxis::MinusY, UpAxis::PlusZ][random.below(3) as usize],
        },
        bit_map: BitMap::default(),
        quantizers: Quantizers::default(),
        // The others always vary in scenes of floats, but the format does not ask for it.
        varies: [8, 8, 2, 2, 8].map(|bound| random.below(bound) > 0).to_vec(),
        layers: cuts.windows(2).map(|pair| (pair[1] - pair[0]) as u32).collect(),
        segment_length: [1, 2, 7, 30, 65_536][random.below(5) as usize],
        tracks: vec![Tracks::default(); 5],
        layout: Layout::base(),
    };
    for attribute in Attribute::BASE {
        let (index, components) = (attribute.index(), attribute.components());
        let highest = 1 + random.below(16);
        let widths: Vec<u8> = (0..num_gaussians).map(|_| (1 + random.below(highest)) as u8).collect();
        let quantizer = |bits: u8, random: &mut Numbers| {
            Quantizer::new(random.float().abs() + 0.01, random.float(), bits).expect("a legal quantizer")
        };
        scene.quantizers.attributes[index] =
            widths.iter().map(|&bits| (bits, (0..components).map(|_| quantizer(bits, random)).collect())).collect();
        let joint = random.below(2) == 0;
        let (still, steady) = (random.below(4), random.below(2) == 0);
        let mut times = vec![0];
        for track in 0..num_gaussians * components {
            if !joint || track % components == 0 {
                times = any_times(num_timesteps, scene.varies[index] && random.below(4) >= still, random);
            }
            let width = widths[track / components];
            let half = 1_i64 << (width - 1);
            let mut code = random.below(2 * half as u64) as i64 - half;
            let codes: Vec<i16> = times
                .iter()
                .map(|_| {
                    let next = if steady {
                        code + random.below(3) as i64 - 1
                    } else {
                        random.below(2 * half as u64) as i64 - half
                    };
                    code = next.clamp(-half, half - 1);
                    code as i16
                })
                .collect();
            scene.tracks[index].push(&times, &codes);
        }
        scene.bit_map.widths[index] = widths;
    }
    scene
}

fn any_times(num_timesteps: usize, moves: bool, random: &mut Numbers) -> Vec<u16> {
    if !moves || num_timesteps == 1 {
        return vec![0];
    }
    let (share, last) = (random.below(4), num_timesteps - 1);
    let inner = (1..last).filter(|_| random.below(3) < share);
    std::iter::once(0).chain(inner).chain([last]).map(|t| t as u16).collect()
}

//! Random scenes that cover all the format can express.

use std::collections::BTreeSet;
use std::sync::Arc;

use tcgs_codec::{BitMap, ColorSpace, CompactScene, Quantizer, Quantizers, SceneInfo, Tracks, UpAxis};
use tcgs_core::{Attribute, Column, Layout, Life, Lives};

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

/// Random widths, layers, segments, times and codes; codes are sometimes constant, as in real scenes.
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
        start: 0,
        lives: None,
        bit_map: BitMap::default(),
        quantizers: Quantizers::default(),
        // The others always vary in scenes of floats, but the format does not require it.
        varies: [8, 8, 2, 2, 8].map(|bound| random.below(bound) > 0).to_vec(),
        layers: cuts.windows(2).map(|pair| (pair[1] - pair[0]) as u32).collect(),
        segment_length: [1, 2, 7, 30, 65_536][random.below(5) as usize],
        tracks: vec![Tracks::default(); 5],
        layout: Layout::base(),
    };
    for attribute in Attribute::BASE {
        fill(&mut scene, attribute, 0, random);
    }
    scene
}

/// Fills an attribute with random widths, quantizers and tracks.
///
/// - `lacking`: approximate number of Gaussians in five that lack the attribute
fn fill(scene: &mut CompactScene, attribute: Attribute, lacking: u64, random: &mut Numbers) {
    let (num_gaussians, num_timesteps) = (scene.num_gaussians(), scene.num_timesteps());
    let (index, components) = (attribute.index(), attribute.components());
    let highest = 1 + random.below(16);
    let widths: Vec<u8> = (0..num_gaussians)
        .map(|_| if lacking > 0 && random.below(5) < lacking { 0 } else { (1 + random.below(highest)) as u8 })
        .collect();
    let quantizer = |bits: u8, random: &mut Numbers| {
        Quantizer::new(random.float().abs() + 0.01, random.float(), bits).expect("a legal quantizer")
    };
    scene.quantizers.attributes[index] = widths
        .iter()
        .filter(|&&bits| bits > 0)
        .map(|&bits| (bits, (0..components).map(|_| quantizer(bits, random)).collect()))
        .collect();
    let joint = random.below(2) == 0;
    let (still, steady) = (random.below(4), random.below(2) == 0);
    let mut times = vec![0];
    for track in 0..num_gaussians * components {
        if !joint || track % components == 0 {
            times = any_times(num_timesteps, scene.varies[index] && random.below(4) >= still, random);
        }
        let width = widths[track / components];
        if width == 0 {
            scene.tracks[index].push(&[0], &[0]);
            continue;
        }
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

/// [`any_scene`] with the additions of version 2: further attributes, which Gaussians may lack, and lives.
pub fn any_cohort(num_gaussians: usize, num_timesteps: usize, start: u32, seed: u64) -> CompactScene {
    let mut scene = CompactScene { start, ..any_scene(num_gaussians, num_timesteps, seed) };
    let random = &mut Numbers(!seed);
    let mut layout = Layout::default();
    for (name, components, varies) in [("sh1", 9, false), ("wetness", 2, true)] {
        let attribute = layout.push(name, components, Column { varies: false, ..Column::like(Attribute::Color) });
        scene.layout = Arc::new(layout.clone());
        scene.varies.push(varies);
        scene.tracks.push(Tracks::default());
        scene.quantizers.attributes.push(Default::default());
        let mut widths = scene.bit_map.widths.clone();
        widths.push(vec![1; num_gaussians]);
        scene.bit_map = BitMap::new(Arc::clone(&scene.layout), widths);
        fill(&mut scene, attribute, random.below(3), random);
    }
    if random.below(3) > 0 {
        live(&mut scene, random);
    }
    scene
}

/// Gives Gaussians their own lives, and moves keypoints into them.
fn live(scene: &mut CompactScene, random: &mut Numbers) {
    let last = scene.num_timesteps() as u64 - 1;
    let lives: Lives = (0..scene.num_gaussians())
        .map(|_| {
            let ends = [random.below(last + 1) as u32, random.below(last + 1) as u32];
            Life { birth: ends[0].min(ends[1]), death: ends[0].max(ends[1]) + 1 }
        })
        .collect();
    for attribute in scene.layout.attributes() {
        let mut moved = Tracks::default();
        let tracks = &scene.tracks[attribute.index()];
        for i in 0..tracks.len() {
            let (times, codes) = tracks.track(i);
            let life = lives[i / attribute.components()];
            let length = u64::from(life.death - 1 - life.birth);
            if times.len() == 1 || length == 0 {
                moved.push(&[0], &codes[..1]);
                continue;
            }
            let mut kept: Vec<(u16, i16)> = times
                .iter()
                .map(|&t| (u64::from(life.birth) + u64::from(t) * length / last) as u16)
                .zip(codes.iter().copied())
                .collect();
            kept.dedup_by_key(|(time, _)| *time);
            let (times, codes): (Vec<u16>, Vec<i16>) = kept.into_iter().unzip();
            moved.push(&times, &codes);
        }
        scene.tracks[attribute.index()] = moved;
    }
    scene.lives = Some(lives);
}

fn any_times(num_timesteps: usize, moves: bool, random: &mut Numbers) -> Vec<u16> {
    if !moves || num_timesteps == 1 {
        return vec![0];
    }
    let (share, last) = (random.below(4), num_timesteps - 1);
    let inner = (1..last).filter(|_| random.below(3) < share);
    std::iter::once(0).chain(inner).chain([last]).map(|t| t as u16).collect()
}

/// Random cohorts, by ascending start, and their common description.
pub fn any_cohorts(count: usize, seed: u64) -> (SceneInfo, Vec<CompactScene>) {
    let random = &mut Numbers(seed);
    let info = any_scene(1, 1, seed).info;
    let mut start = 0;
    let mut cohorts = Vec::new();
    for i in 0..count {
        start += random.below(8) as u32;
        let [num_gaussians, num_timesteps] = [1 + random.below(9), 1 + random.below(30)].map(|n| n as usize);
        let mut cohort = any_cohort(num_gaussians, num_timesteps, start, seed ^ i as u64);
        // All cohorts share the description of the whole scene.
        cohort.info =
            SceneInfo { num_gaussians: num_gaussians as u32, num_timesteps: num_timesteps as u32, ..info.clone() };
        cohorts.push(cohort);
    }
    let num_gaussians = cohorts.iter().map(|cohort| cohort.info.num_gaussians).sum();
    let end = cohorts.iter().map(|cohort| cohort.start + cohort.info.num_timesteps).max();
    let num_timesteps = end.unwrap_or(0) + 1 + random.below(3) as u32;
    (SceneInfo { num_gaussians, num_timesteps, ..info }, cohorts)
}

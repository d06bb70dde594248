//! Sequences of other programs: harmonics, and Gaussians that change in number and order from timestep to timestep.

use std::convert::Infallible;
use std::io::Cursor;
use std::sync::Arc;

use tcgs_codec::{
    BitMap, CompactScene, CompressSettings, DecodeLimits, FollowedParts, SceneFile, SceneInfo, SegmentCache, compress,
    decode_cohorts, encode_cohorts,
};
use tcgs_core::{Attribute, DynamicGaussians, Gaussians, Layout, Life, SceneReader};

/// splitmix64 (Steele et al. 2014), as a number in [0, 1).
fn random(seed: u64) -> f32 {
    let mut z = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 40) as f32 / (1 << 24) as f32
}

/// A Gaussian of a synthetic scene at a timestep: it stands or moves along a line; a few have harmonics.
fn gaussian(id: u64, timestep: usize, layout: &Arc<Layout>) -> Gaussians {
    let mut one = Gaussians::zeros_of(layout, 1);
    let r = |i: u64| random(id * 64 + i);
    let speed = if id.is_multiple_of(3) { 0.02 } else { 0.0 };
    let mut mean = [0, 1, 2].map(|i| 4.0 * r(i) - 2.0);
    mean[0] += speed * timestep as f32;
    one.means_mut()[0] = mean;
    one.quats_mut()[0] = [1.0, r(3) - 0.5, r(4) - 0.5, r(5) - 0.5];
    one.log_scales_mut()[0] = [6, 7, 8].map(|i| -3.0 + r(i));
    one.logit_opacities_mut()[0] = 3.0 * r(9);
    one.colors_mut()[0] = [10, 11, 12].map(r);
    for attribute in layout.harmonics() {
        let shine = if id.is_multiple_of(4) { 0.2 } else { 1e-4 };
        for (i, x) in one.values_mut(attribute).iter_mut().enumerate() {
            *x = shine * (random(id * 1000 + (attribute.index() * 64 + i) as u64) - 0.5);
        }
    }
    one
}

/// Error of harmonics at which each coefficient stays within 0.03.
const FINE: f32 = 0.004;

/// A sequence in memory whose number of Gaussians may change.
struct Sequence {
    layout: Arc<Layout>,
    timesteps: Vec<Gaussians>,
}

impl SceneReader for Sequence {
    type Error = Infallible;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians_at(&self, timestep: usize) -> usize {
        self.timesteps[timestep].num_gaussians()
    }

    fn num_timesteps(&self) -> usize {
        self.timesteps.len()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, Infallible> {
        Ok(self.timesteps[timestep].clone())
    }
}

/// - `ids`: the Gaussians that live at a timestep, in order
fn sequence(num_timesteps: usize, degree: usize, ids: impl Fn(usize) -> Vec<u64>) -> Sequence {
    let layout = Layout::with_harmonics(degree);
    let timestep = |t| {
        let parts: Vec<Gaussians> = ids(t).into_iter().map(|id| gaussian(id, t, &layout)).collect();
        Gaussians::concat(&layout, &parts)
    };
    Sequence { timesteps: (0..num_timesteps).map(timestep).collect(), layout }
}

fn cohorts(source: &mut Sequence, max_timesteps: usize) -> Vec<CompactScene> {
    let parts = FollowedParts::new(source, max_timesteps);
    parts
        .map(|part| {
            let part = part.unwrap();
            let bits = BitMap::uniform_of(part.scene.layout(), part.lives.len(), 16, 8);
            let settings = CompressSettings { coarser: [0.0; 5], harmonic_error: FINE, ..CompressSettings::default() };
            let info = SceneInfo::of(&part.scene);
            let (compact, order) = tcgs_codec::compress_ordered(&part.scene, &bits, None, info, &settings).unwrap();
            CompactScene { start: part.start as u32, ..compact.with_lives(part.lives.select(&order)) }
        })
        .collect()
}

fn file(source: &Sequence, cohorts: &[CompactScene]) -> Vec<u8> {
    let num_gaussians = cohorts.iter().map(|cohort| cohort.info.num_gaussians).sum();
    let num_timesteps = source.timesteps.len() as u32;
    let info = SceneInfo { num_gaussians, num_timesteps, ..cohorts[0].info.clone() };
    let file = encode_cohorts(&info, cohorts, &[]).unwrap();
    assert_eq!(decode_cohorts(&file, &DecodeLimits::default()).unwrap().1, cohorts);
    file
}

/// Checks that every Gaussian of every timestep is found again, at its position and with its colour.
fn compare(source: &Sequence, file: &[u8]) {
    let mut reader = SceneFile::open(Cursor::new(file), &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES).unwrap();
    for (timestep, expected) in source.timesteps.iter().enumerate() {
        let found = reader.at(timestep).unwrap();
        assert_eq!(found.num_gaussians(), expected.num_gaussians(), "timestep {timestep}");
        for (g, mean) in expected.means().iter().enumerate() {
            let distance = |p: &[f32; 3]| (0..3).map(|i| (p[i] - mean[i]).powi(2)).sum::<f32>();
            let nearest = (0..found.num_gaussians())
                .min_by(|&a, &b| distance(&found.means()[a]).total_cmp(&distance(&found.means()[b])))
                .unwrap();
            assert!(distance(&found.means()[nearest]).sqrt() < 0.02, "timestep {timestep}, Gaussian {g}");
            let [a, b] = [found.colors()[nearest], expected.colors()[g]];
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 0.03), "timestep {timestep}, Gaussian {g}: {a:?}, {b:?}");
            for attribute in source.layout.harmonics() {
                let row = attribute.components();
                let [a, b] = [(&found, nearest), (expected, g)].map(|(of, g)| &of.values(attribute)[g * row..][..row]);
                let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(worst < 0.03, "timestep {timestep}, Gaussian {g}: {worst}");
            }
        }
    }
}

#[test]
fn harmonics_cost_what_they_show() {
    let source = sequence(1, 3, |_| (0..600).collect());
    let plain = sequence(1, 0, |_| (0..600).collect());
    let mut scene = DynamicGaussians::new(source.layout.clone());
    scene.push(source.timesteps[0].clone());
    let bits = BitMap::uniform_of(&source.layout, 600, 16, 8);
    let settings = CompressSettings { harmonic_error: FINE, ..CompressSettings::default() };
    let compact = compress(&scene, &bits, None, SceneInfo::of(&scene), &settings).unwrap();
    let of_degree_1 = &compact.bit_map.widths[Attribute::BASE.len()];
    let kept = of_degree_1.iter().filter(|&&width| width > 0).count();
    assert!((100..=150).contains(&kept), "{kept} of 600");
    compare(&source, &file(&source, &[compact]));
    // 45 coefficients of a quarter of the Gaussians, against 14 values of all.
    let lengths = [source, plain].map(|mut source| {
        let cohorts = cohorts(&mut source, 1);
        file(&source, &cohorts).len()
    });
    assert!(lengths[0] < 3 * lengths[1], "{lengths:?}");
}

#[test]
fn harmonics_err_less_where_images_depend_more_on_them() {
    let source = sequence(1, 1, |_| (0..600).map(|id| 4 * id).collect());
    let mut scene = DynamicGaussians::new(source.layout.clone());
    scene.push(source.timesteps[0].clone());
    let band = source.layout.harmonics()[0].index();
    let mut bits = BitMap::uniform_of(&source.layout, 600, 16, 8);
    bits.widths[band].iter_mut().step_by(2).for_each(|width| *width = 4);
    // For the Gaussians of 4 bits and of 8 bits: how many keep the band, and at which width.
    let kept = |importance: f32| {
        let settings = CompressSettings { harmonic_error: 0.028, importance, ..CompressSettings::default() };
        let (compact, order) =
            tcgs_codec::compress_ordered(&scene, &bits, None, SceneInfo::of(&scene), &settings).unwrap();
        [0, 1].map(|odd| {
            let widths = || order.iter().zip(&compact.bit_map.widths[band]).filter(|(g, w)| *g % 2 == odd && **w > 0);
            (widths().count(), widths().map(|(_, width)| *width).max().unwrap())
        })
    };
    let [(few, coarse), (many, fine)] = kept(0.5);
    assert!(few < 60 && many > 200 && coarse < fine, "{few} of {coarse} bits, {many} of {fine}");
    let [(even, coarse), (odd, fine)] = kept(0.0);
    assert!(even.abs_diff(odd) < 40 && even > 100 && coarse == fine, "{even} of {coarse} bits, {odd} of {fine}");
}

#[test]
fn gaussians_are_followed_through_changing_orders_and_numbers() {
    // Some Gaussians are born, some die, and every timestep has its own order.
    let ids = |t: usize| {
        let mut ids: Vec<u64> =
            (0..200).filter(|id: &u64| t < 9 || !id.is_multiple_of(10)).chain(200..200 + 5 * t as u64).collect();
        ids.sort_by_key(|&id| (random(id * 100 + t as u64) * 1e6) as u64);
        ids
    };
    let mut source = sequence(15, 1, ids);
    let cohorts = cohorts(&mut source, 50);
    assert_eq!(cohorts.len(), 1);
    assert_eq!(cohorts[0].num_gaussians(), 200 + 5 * 14, "each is followed over its whole life");
    let lives = cohorts[0].lives.as_ref().unwrap();
    assert_eq!(lives.iter().filter(|life| **life == Life { birth: 0, death: 9 }).count(), 20);
    let file = file(&source, &cohorts);
    compare(&source, &file);
    let raw: usize = source.timesteps.iter().map(|now| 4 * 23 * now.num_gaussians()).sum();
    assert!(file.len() * 20 < raw, "{} of {raw}", file.len());
}

#[test]
fn independent_frames_become_a_flip_book() {
    let mut source = sequence(6, 0, |t| (0..80 + t as u64).map(|id| 1000 * (t as u64 + 1) + id).collect());
    let cohorts = cohorts(&mut source, 50);
    assert_eq!(cohorts.iter().map(|cohort| cohort.start).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    compare(&source, &file(&source, &cohorts));
}

#[test]
fn parts_are_no_longer_than_was_asked() {
    let mut source = sequence(7, 0, |_| (0..50).collect());
    let parts: Vec<_> = FollowedParts::new(&mut source, 3).map(Result::unwrap).collect();
    assert!(parts.iter().all(tcgs_codec::Followed::all_live));
    assert_eq!(
        parts.iter().map(|part| (part.start, part.scene.num_timesteps())).collect::<Vec<_>>(),
        [(0, 3), (3, 3), (6, 1)]
    );
}

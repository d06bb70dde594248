//! Floats to symbols and back.

use std::sync::Arc;

use crate::support::scenes::{self, Random};
use tcgs_codec::{
    BitMap, CompactScene, CompressSettings, DecodeLimits, Quantizer, Quantizers, SceneInfo, compress, compress_ordered,
    compress_reader, decode, encode, encode_cohorts,
};
use tcgs_core::{Attribute, Column, DynamicGaussians, Gaussians, Layout, SceneReader, dot, normalize};

/// The default settings, with the widths of the bit map and equal tolerances.
fn as_told() -> CompressSettings {
    CompressSettings { coarser: [0.0; 5], position_fineness: 0.0, importance: 0.0, ..CompressSettings::default() }
}

fn compress_all(scene: &DynamicGaussians, bits: u8, settings: &CompressSettings) -> (CompactScene, Vec<usize>) {
    compress_ordered(scene, &BitMap::uniform(scene.num_gaussians(), 16, bits), None, SceneInfo::of(scene), settings)
        .expect("a legal scene")
}

/// Mean squared error of an attribute over all timesteps; quaternions are normalised, and their sign is ignored.
fn mse(attribute: Attribute, expected: &DynamicGaussians, found: &DynamicGaussians) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for timestep in 0..expected.num_timesteps() {
        let (e, f) = (expected.values(attribute, timestep), found.values(attribute, timestep));
        assert_eq!(e.len(), f.len());
        for (e, f) in e.chunks(attribute.components()).zip(f.chunks(attribute.components())) {
            if attribute == Attribute::Quat {
                let unit = normalize([e[0], e[1], e[2], e[3]]);
                let cosine = dot(unit, [f[0], f[1], f[2], f[3]]).abs();
                sum += f64::from(2.0 - 2.0 * cosine).max(0.0);
            } else {
                sum += e.iter().zip(f).map(|(e, f)| f64::from(e - f).powi(2)).sum::<f64>();
            }
            count += e.len();
        }
    }
    sum / count as f64
}

#[test]
fn reconstruction_stays_within_tolerance() {
    let scene = scenes::room(1500, 24);
    let settings = as_told();
    let (compact, order) = compress_all(&scene, 8, &settings);
    let (expected, found) = (scene.select(&order), compact.reconstruct());
    for attribute in Attribute::BASE {
        // Root mean square errors add at most linearly: the tolerance of the tracks, and rounding, step²/12.
        let steps = compact.quantizers.attributes[attribute.index()].values().flatten().map(|q| f64::from(q.step));
        let step = steps.fold(0.0, f64::max);
        let tolerance = if scene.varies(attribute) {
            f64::from(settings.max_mse[attribute.index()]).max((step / 4.0).powi(2))
        } else {
            0.0
        };
        let bound = (tolerance.sqrt() + step / 12.0_f64.sqrt()).powi(2);
        let error = mse(attribute, &expected, &found);
        assert!(error <= bound, "{attribute:?}: {error} against {bound}");
    }
    for quat in (0..found.num_timesteps()).flat_map(|timestep| found.quats(timestep)) {
        assert!((dot(*quat, *quat) - 1.0).abs() < 1e-5);
    }
}

#[test]
fn without_keypoints_only_rounding_is_left() {
    let scene = scenes::room(200, 9);
    let settings = CompressSettings { keypoints: false, ..as_told() };
    let (compact, order) = compress_all(&scene, 16, &settings);
    assert_eq!(compact.keypoints_mean(), [9.0, 9.0, 1.0, 1.0, 9.0]);
    let (expected, found) = (scene.select(&order), compact.reconstruct());
    for attribute in Attribute::BASE {
        let range = if attribute == Attribute::LogitOpacity { 20.0 } else { 8.0 };
        let error = mse(attribute, &expected, &found);
        assert!(error < (range / 65_536.0_f64).powi(2), "{attribute:?}: {error}");
    }
}

#[test]
fn one_timestep_is_the_scene_of_all() {
    let (compact, _) = compress_all(&scenes::room(300, 7), 6, &as_told());
    let scene = compact.reconstruct();
    for timestep in 0..7 {
        assert_eq!(compact.at(timestep), scene.at(timestep));
    }
}

#[test]
fn scales_and_opacities_may_vary() {
    let mut scene = scenes::room(200, 1);
    for timestep in 1..12 {
        let mut now = scene.at(0);
        for opacity in &mut now.logit_opacities_mut()[..50] {
            *opacity -= 0.5 * timestep as f32;
        }
        for scales in &mut now.log_scales_mut()[50..80] {
            *scales = scales.map(|s| s + 0.3 * (timestep as f32).sin());
        }
        scene.push(now);
    }
    let (compact, order) = compress_all(&scene, 8, &as_told());
    assert_eq!(compact.varies, [true; 5]);
    assert_eq!(compact.raw_bytes(), scene.raw_bytes());
    let decoded = decode(&encode(&compact).unwrap(), &DecodeLimits::default()).unwrap();
    assert_eq!(decoded, compact);
    let (expected, found) = (scene.select(&order), decoded.reconstruct());
    assert_eq!(found.at(7), decoded.at(7));
    for attribute in [Attribute::LogScale, Attribute::LogitOpacity] {
        assert_eq!(found.num_samples(attribute), 12);
        let error = mse(attribute, &expected, &found);
        assert!(error < 2e-3, "{attribute:?}: {error}");
    }
    // A line of 12 samples needs two keypoints; three quarters of the opacities are constant.
    let opacities = Attribute::LogitOpacity.index();
    assert!((compact.keypoints_mean()[opacities] - 1.25).abs() < 0.05, "{:?}", compact.keypoints_mean());
    // Sizes computed by hand, as floats and quantised.
    assert_eq!(scene.raw_bytes(), 200 * 56 * 12);
    let quantizers: u64 = 64 * 14;
    assert_eq!(compact.quantized_bytes(), (200 * 12 * (3 * 16 + 11 * 8) + quantizers).div_ceil(8));
}

#[test]
fn a_single_timestep_and_no_gaussians_work() {
    let scene = scenes::room(50, 1);
    for settings in [as_told(), CompressSettings::paper()] {
        let (compact, order) = compress_all(&scene, 8, &settings);
        assert_eq!(compact.keypoints_mean(), [1.0; 5]);
        assert!(mse(Attribute::Mean, &scene.select(&order), &compact.reconstruct()) < 1e-8);
        let mut empty = DynamicGaussians::default();
        empty.push(Gaussians::zeros(0));
        let (compact, order) = compress_all(&empty, 8, &settings);
        assert!(order.is_empty() && compact.plain_bytes() == 0);
        assert_eq!(compact.reconstruct(), empty);
    }
}

#[test]
fn what_stands_still_is_one_value() {
    let scene = scenes::room(500, 24);
    let (default, _) = compress_all(&scene, 6, &as_told());
    let mut settings = CompressSettings { constant_tracks: false, ..as_told() };
    let (lines, _) = compress_all(&scene, 6, &settings);
    let means = Attribute::Mean.index();
    let constant = (0..default.tracks[means].len()).filter(|&i| default.tracks[means].track(i).0.len() == 1).count();
    assert_eq!(constant, 3 * 400, "the tracks of the four fifths on the walls");
    assert!((0..lines.tracks[means].len()).all(|i| lines.tracks[means].track(i).0.len() >= 2));
    // 5 bits of a colour's range are coarser than the noise, so few keypoints are added to the two ends.
    let colors = Attribute::Color.index();
    settings.noise_floor = false;
    settings.max_mse = [1e-6; 5];
    let (restless, _) = compress_all(&scene, 5, &settings);
    settings.noise_floor = true;
    let (calm, _) = compress_all(&scene, 5, &settings);
    let (restless_mean, calm_mean) = (restless.keypoints_mean(), calm.keypoints_mean());
    assert!(restless_mean[colors] > 15.0 && calm_mean[colors] < 3.0, "{restless_mean:?} {calm_mean:?}");
    assert_eq!(restless_mean[means], calm_mean[means]);
}

#[test]
fn signs_of_quaternions_do_not_matter() {
    let scene = scenes::room(100, 12);
    let mut flipped = scene.clone();
    let random = &mut Random(3);
    for timestep in 0..flipped.num_timesteps() {
        for quat in flipped.quats_mut(timestep) {
            let factor = if random.uniform() < 0.5 { 2.0 } else { -0.5 };
            *quat = quat.map(|x| factor * x);
        }
    }
    let settings = as_told();
    assert_eq!(compress_all(&scene, 8, &settings), compress_all(&flipped, 8, &settings));
}

#[test]
fn a_learned_quantizer_is_kept_where_it_is_best() {
    let mut scene = scenes::room(400, 1);
    let learned_quantizer = Quantizer::new(0.071, -3.3, 5).unwrap();
    let opacities = Attribute::LogitOpacity;
    for x in scene.logit_opacities_mut(0) {
        *x = learned_quantizer.dequantize(learned_quantizer.quantize(*x));
    }
    let mut learned = Quantizers::default();
    learned.attributes[opacities.index()].insert(5, vec![learned_quantizer]);
    learned.attributes[Attribute::LogScale.index()].insert(5, vec![Quantizer::new(5.0, 0.0, 5).unwrap(); 3]);
    learned.attributes[Attribute::Mean.index()].insert(16, vec![Quantizer::new(1e-3, 0.0, 16).unwrap(); 3]);
    let bit_map = BitMap::uniform(400, 16, 5);
    let compress = |learned| compress(&scene, &bit_map, learned, SceneInfo::of(&scene), &as_told()).unwrap();
    let (with, without) = (compress(Some(&learned)), compress(None));
    assert_eq!(with.quantizers.get(opacities, 5, 0), Some(&learned_quantizer));
    for attribute in [Attribute::Mean, Attribute::LogScale] {
        let index = attribute.index();
        assert_eq!(with.quantizers.attributes[index], without.quantizers.attributes[index]);
    }
}

#[test]
fn gaussians_follow_a_curve_and_keep_their_values() {
    let scene = scenes::room(3000, 2);
    let (compact, order) = compress_all(&scene, 16, &CompressSettings { layers: Vec::new(), ..as_told() });
    let mut sorted = order.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, (0..3000).collect::<Vec<_>>());
    let step = |means: &[[f32; 3]]| -> f32 {
        means.windows(2).map(|pair| (0..3).map(|c| (pair[0][c] - pair[1][c]).powi(2)).sum::<f32>().sqrt()).sum()
    };
    let after = step(compact.at(0).means());
    assert!(after < 0.1 * step(scene.means(0)), "neighbours in the file are neighbours in space");
    assert!(mse(Attribute::LogScale, &scene.select(&order), &compact.reconstruct()) < 1e-8);
}

#[test]
fn layers_hold_the_most_important_first() {
    let scene = scenes::room(1000, 3);
    let settings = CompressSettings { layers: vec![0.1, 0.2], ..as_told() };
    let (compact, order) = compress_all(&scene, 8, &settings);
    assert_eq!(compact.layers, [100, 200, 700]);
    let area = |g: usize| {
        let mut axes = scene.log_scales(0)[g];
        axes.sort_by(f32::total_cmp);
        2.0 * tcgs_core::sigmoid(scene.logit_opacities(0)[g]).ln() + axes[1] + axes[2]
    };
    let lowest = |range: std::ops::Range<usize>| order[range].iter().map(|&g| area(g)).fold(f32::MAX, f32::min);
    let highest = |range: std::ops::Range<usize>| order[range].iter().map(|&g| area(g)).fold(f32::MIN, f32::max);
    assert!(lowest(0..100) >= highest(100..300) && lowest(100..300) >= highest(300..1000));
    // More layers than Gaussians, or shares that leave none.
    for layers in [vec![0.0, 1.0, 0.5], vec![1e-9; 9]] {
        let (compact, _) = compress_all(&scene.select(&[0, 1]), 8, &CompressSettings { layers, ..as_told() });
        assert_eq!(compact.layers, [2]);
    }
}

#[test]
fn components_share_their_times_and_segments_begin_anew() {
    let scene = scenes::room(300, 30);
    let settings = CompressSettings { segment_length: Some(12), ..as_told() };
    let (compact, _) = compress_all(&scene, 8, &settings);
    for attribute in [Attribute::Mean, Attribute::Quat, Attribute::Color] {
        let tracks = &compact.tracks[attribute.index()];
        for gaussian in 0..300 {
            let times = |c| tracks.track(gaussian * attribute.components() + c).0;
            assert!((1..attribute.components()).all(|c| times(c) == times(0)));
            if times(0).len() > 1 {
                assert!([0, 11, 12, 23, 24, 29].iter().all(|t| times(0).contains(t)), "{:?}", times(0));
            }
        }
    }
    let (apart, _) = compress_all(&scene, 8, &CompressSettings { joint: false, ..settings.clone() });
    assert!(encode(&compact).unwrap().len() < encode(&apart).unwrap().len());
}

#[test]
fn widths_are_lowered_and_positions_follow_the_splats() {
    let scene = scenes::room(500, 2);
    let settings = CompressSettings { coarser: [0.0, 2.0, 1.0, 9.0, 0.0], position_fineness: 4.0, ..as_told() };
    let (compact, order) = compress_all(&scene, 6, &settings);
    let width = |a: Attribute| *compact.bit_map.widths[a.index()].first().unwrap();
    assert_eq!(
        [Attribute::Quat, Attribute::LogScale, Attribute::LogitOpacity, Attribute::Color].map(width),
        [4, 5, 2, 6]
    );
    // About 6 m, a median axis of about 23 mm, a quarter of that along all axes: 1100 steps.
    assert_eq!(width(Attribute::Mean), 11);
    let steps = &compact.quantizers.attributes[Attribute::Mean.index()][&11];
    assert!(steps.iter().all(|q| (q.step - 0.0234 / 4.0).abs() < 1e-4 && q.step == steps[0].step), "{steps:?}");
    let error = mse(Attribute::Mean, &scene.select(&order), &compact.reconstruct());
    assert!(error < 1.1 * f64::from(steps[0].step).powi(2) / 12.0 + f64::from(settings.max_mse[0]), "{error}");
    let finer = CompressSettings { position_fineness: 8.0, ..settings };
    assert_eq!(compress_all(&scene, 6, &finer).0.bit_map.widths[0][0], 12);
}

#[test]
fn a_fraction_of_a_bit_goes_to_those_that_cover_most() {
    let scene = scenes::room(500, 2);
    let settings = CompressSettings { coarser: [0.0, 0.0, 0.0, 0.0, 0.75], ..as_told() };
    let (compact, order) = compress_all(&scene, 6, &settings);
    let widths = &compact.bit_map.widths[Attribute::Color.index()];
    assert_eq!(widths.iter().filter(|&&w| w == 6).count(), 125);
    assert!(widths.iter().all(|&w| w == 5 || w == 6));
    let area = |g: usize| {
        let mut scales = scene.log_scales(0)[order[g]];
        scales.sort_by(f32::total_cmp);
        2.0 * tcgs_core::sigmoid(scene.logit_opacities(0)[order[g]]).ln() + scales[1] + scales[2]
    };
    let least = (0..500).filter(|&g| widths[g] == 6).map(area).fold(f32::MAX, f32::min);
    assert!((0..500).filter(|&g| widths[g] == 5).all(|g| area(g) <= least));
}

#[test]
fn quality_orders_files_by_size_and_error() {
    let scene = scenes::room(1500, 24);
    let bit_map = scenes::mixed_widths(1500);
    let default = CompressSettings::default();
    assert_eq!(default.clone().with_quality(0.0), default);
    let outcome = |quality: f32| {
        let settings = default.clone().with_quality(quality);
        let (compact, order) = compress_ordered(&scene, &bit_map, None, SceneInfo::of(&scene), &settings).unwrap();
        let (expected, found) = (scene.select(&order), compact.reconstruct());
        (encode(&compact).unwrap().len(), Attribute::BASE.map(|a| mse(a, &expected, &found)))
    };
    let curve: Vec<_> = (-12..=16).map(|half| outcome(half as f32 / 2.0)).collect();
    for (i, pair) in curve.windows(2).enumerate() {
        let (bytes, better) = (pair[0].0, pair[1].0);
        assert!(bytes < better && better < 2 * bytes, "quality {}: {bytes} and {better} bytes", i as f32 / 2.0 - 6.0);
    }
    // Two steps of quality lower the error of every attribute.
    for (i, (worse, better)) in curve.iter().zip(&curve[4..]).enumerate() {
        for a in Attribute::BASE {
            let (worse, better) = (worse.1[a.index()], better.1[a.index()]);
            assert!(better <= worse, "{a:?} from quality {}: {worse} and {better}", i as f32 / 2.0 - 6.0);
        }
    }
}

#[test]
fn what_shows_is_followed_more_closely() {
    let mut scene = scenes::room(400, 24);
    for (i, opacity) in scene.logit_opacities_mut(0).iter_mut().enumerate() {
        *opacity = if i % 2 == 0 { 4.0 } else { -3.0 };
    }
    scene.log_scales_mut(0).fill([-3.8; 3]);
    let settings = CompressSettings { importance: 1.0, noise_floor: false, layers: Vec::new(), ..as_told() };
    let (compact, order) = compress_all(&scene, 16, &settings);
    let keypoints = |even: bool| -> usize {
        let tracks = &compact.tracks[Attribute::Mean.index()];
        let chosen = (0..400).filter(|&i| (order[i] % 2 == 0) == even);
        chosen.map(|i| tracks.track(3 * i).0.len()).sum()
    };
    assert!(keypoints(true) > keypoints(false), "{} {}", keypoints(true), keypoints(false));
}

#[test]
fn threads_do_not_matter() {
    let scene = scenes::room(700, 10);
    let bit_map = scenes::mixed_widths(700);
    let run = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        pool.install(|| {
            let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &as_told()).unwrap();
            (encode(&compact).unwrap(), compact)
        })
    };
    assert_eq!(run(1), run(5));
}

#[test]
fn more_timesteps_than_a_byte_counts_work() {
    let scene = scenes::room(20, 400);
    let settings = CompressSettings { keypoints: false, ..as_told() };
    let (compact, order) = compress_all(&scene, 12, &settings);
    let steps = &compact.quantizers.attributes[Attribute::Mean.index()][&16];
    let step = steps.iter().fold(0.0, |a, q| q.step.max(a));
    assert!(mse(Attribute::Mean, &scene.select(&order), &compact.reconstruct()) <= f64::from(step / 2.0).powi(2));
    // Two bytes for a count above 255, nine bits for a time.
    let varying: u64 = [(16, 3), (12, 4), (12, 3)].iter().map(|(bits, c)| c * (16 + 400 * (9 + bits))).sum();
    let constant = 12 * 4;
    assert_eq!(compact.plain_bytes(), (20 * (varying + constant) + 14 * 64).div_ceil(8));
}

/// A scene that counts its reads and does not declare which columns vary.
struct Counted<'a> {
    scene: &'a DynamicGaussians,
    num_reads: usize,
}

impl SceneReader for Counted<'_> {
    type Error = std::io::Error;

    fn layout(&self) -> &Arc<Layout> {
        self.scene.layout()
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.scene.num_gaussians()
    }

    fn num_timesteps(&self) -> usize {
        self.scene.num_timesteps()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, Self::Error> {
        self.num_reads += 1;
        if timestep == 99 { Err(std::io::Error::other("a hole in the disk")) } else { Ok(self.scene.at(timestep)) }
    }
}

#[test]
fn what_is_read_compresses_as_what_lies_in_memory() {
    let mut scene = scenes::room(300, 1);
    for timestep in 1..60 {
        let mut now = scenes::room(300, 1).at(0);
        now.means_mut()[7][0] += (0.1 * timestep as f32).sin();
        // One of the columns that are usually stored once varies, late.
        now.log_scales_mut()[9][1] += if timestep > 40 { 0.5 } else { 0.0 };
        scene.push(now);
    }
    let map = scenes::mixed_widths(300);
    let paper = CompressSettings::paper();
    let alone = CompressSettings { keypoints: false, ..CompressSettings::default() };
    for settings in [CompressSettings::default(), as_told(), paper, alone] {
        let mut reader = Counted { scene: &scene, num_reads: 0 };
        let read = compress_reader(&mut reader, &map, None, SceneInfo::of(&scene), &settings).unwrap();
        assert_eq!(read, compress_ordered(&scene, &map, None, SceneInfo::of(&scene), &settings).unwrap());
        assert_eq!(read.0.varies, [true, true, true, false, true]);
        assert_eq!(reader.num_reads, 2 * 60 + 1, "two readings, and the first timestep");
    }
    let long = scenes::room(2, 100);
    let mut reader = Counted { scene: &long, num_reads: 0 };
    let (map, settings) = (BitMap::uniform(2, 16, 8), CompressSettings::default());
    let error = compress_reader(&mut reader, &map, None, SceneInfo::of(&long), &settings).unwrap_err();
    assert_eq!(error.to_string(), "cannot read timestep 99: a hole in the disk");
}

#[test]
fn further_columns_are_compressed_but_not_encoded() {
    let mut layout = Layout::default();
    let wetness = layout.push("wetness", 2, Column::like(Attribute::Color));
    let rust = layout.push("rust", 5, Column::like(Attribute::LogitOpacity));
    let (layout, base) = (Arc::new(layout), scenes::room(200, 30));
    let mut scene = DynamicGaussians::new(Arc::clone(&layout));
    for timestep in 0..30 {
        let mut values = base.at(timestep).into_values();
        values.push((0..400).map(|i| (0.1 * (i + timestep) as f32).sin()).collect());
        values.push((0..1000).map(|i| (0.3 * i as f32).cos()).collect());
        scene.push(Gaussians::new(Arc::clone(&layout), 200, values));
    }
    let map = BitMap::uniform_of(&layout, 200, 16, 8);
    for settings in [as_told(), CompressSettings::paper(), CompressSettings::default()] {
        let (compact, order) = compress_ordered(&scene, &map, None, SceneInfo::of(&scene), &settings).unwrap();
        assert_eq!(compact.varies, [true, true, false, false, true, true, false]);
        let (expected, found) = (scene.select(&order), compact.reconstruct());
        assert_eq!((found.layout(), found.at(11)), (&layout, compact.at(11)));
        for attribute in [wetness, rust] {
            let error = mse(attribute, &expected, &found);
            assert!(error < 1e-3, "{}: {error}", layout.name(attribute));
        }
        // The format's own columns are the same without the others.
        let map = BitMap::uniform(200, 16, 8);
        let (alone, _) = compress_ordered(&base, &map, None, SceneInfo::of(&base), &settings).unwrap();
        assert_eq!(compact.tracks[..5], alone.tracks);
        let message = encode(&compact).unwrap_err().to_string();
        assert!(
            message.starts_with("version 1 of the format holds") && message.ends_with("found wetness"),
            "{message}"
        );
        let file = encode_cohorts(&compact.info, std::slice::from_ref(&compact), &[]).unwrap();
        assert_eq!(decode(&file, &DecodeLimits::default()).unwrap().tracks, compact.tracks);
    }
}

#[test]
fn what_cannot_be_compressed_is_refused() {
    let says = |scene: &DynamicGaussians, map: &BitMap, settings: &CompressSettings, message: &str| {
        let error = compress(scene, map, None, SceneInfo::of(scene), settings).unwrap_err();
        assert_eq!(error.to_string(), message);
    };
    let (scene, map) = (scenes::room(10, 2), BitMap::uniform(10, 16, 8));
    let mut broken = scene.clone();
    broken.colors_mut(1)[3][2] = f32::NAN;
    let message = "invalid colors of Gaussian 3 at timestep 1: found NaN, expected a finite number";
    says(&broken, &map, &as_told(), message);
    broken.colors_mut(1)[3][2] = f32::MAX;
    broken.colors_mut(0)[3][2] = f32::MIN;
    let error = compress(&broken, &BitMap::uniform(10, 16, 1), None, SceneInfo::of(&broken), &as_told()).unwrap_err();
    assert!(error.to_string().ends_with("the step is not a positive finite number"), "{error}");
    let message = "invalid number of bit widths of means: found 9, expected 10";
    says(&scene, &BitMap::uniform(9, 16, 8), &as_told(), message);
    let message = "invalid width of codes in bits: found 0, expected 1 to 16";
    says(&scene, &BitMap::uniform(10, 16, 0), &as_told(), message);
    let message = "invalid number of timesteps: found 0, expected 1 to 65536";
    says(&DynamicGaussians::default(), &BitMap::default(), &as_told(), message);
    let info = SceneInfo { num_timesteps: 3, ..SceneInfo::of(&scene) };
    let error = compress(&scene, &map, None, info, &as_told()).unwrap_err();
    assert_eq!(error.to_string(), "invalid number of timesteps in info: found 3, expected 2");

    let refuses = |settings: CompressSettings, message: &str| says(&scene, &map, &settings, message);
    let max_mse = [1e-5, 1e-5, -1.0, 1e-5, 1e-5];
    refuses(CompressSettings { max_mse, ..as_told() }, "invalid max_mse: found -1, expected 0 or more");
    let settings = CompressSettings { segment_length: Some(0), ..as_told() };
    refuses(settings, "invalid segment_length: found 0, expected 1 to 65536");
    let settings = CompressSettings { coarser: [f32::NAN; 5], ..as_told() };
    refuses(settings, "invalid coarser: found NaN, expected a finite number");
    let settings = CompressSettings { importance: f32::INFINITY, ..as_told() };
    refuses(settings, "invalid importance: found inf, expected a finite number");
    let settings = CompressSettings { position_fineness: f32::NAN, ..as_told() };
    refuses(settings, "invalid position_fineness: found NaN, expected a finite number");
    let settings = CompressSettings { layers: vec![0.5, 1.5], ..as_told() };
    refuses(settings, "invalid share of a layer: found 1.5, expected 0 to 1");
}

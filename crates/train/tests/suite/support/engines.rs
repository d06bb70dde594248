//! States, images and comparisons for tests that run both engines.

use std::sync::Arc;

use tcgs_codec::BitMap;
use tcgs_core::{Attribute, Camera, Image, Layout, PointCloud};
use tcgs_train::engine::{Step, Target};
use tcgs_train::{Dropout, FakeQuantizers, LossTerms, Optimizer, Parameters, Past, Pose, Rates, State, TrainConfig};

use super::{Random, relative_l2};

/// Default settings with masks: everything that an engine computes.
pub fn config() -> TrainConfig {
    let mut config = TrainConfig::default();
    config.mask.enabled = true;
    (config.weights.mask, config.weights.mask_consistency) = (0.05, 0.5);
    config
}

/// `n` random Gaussians.
pub fn state(n: usize, cameras: usize, is_foreground: impl Fn(usize) -> bool) -> State {
    let mut random = Random::new(n as u64);
    let cloud = PointCloud {
        points: (0..n).map(|_| random.row(1.0)).collect(),
        colors: (0..n).map(|_| random.row::<3>(0.5).map(|c| c + 0.5)).collect(),
        foreground: (0..n).map(is_foreground).collect(),
    };
    let mut state = State::new(Parameters::from_cloud(&cloud, cameras, 1.0));
    for i in 0..n {
        let g = &mut state.parameters.gaussians;
        g.log_scales_mut()[i] = random.row::<3>(1.0).map(|s| s - 2.0);
        g.quats_mut()[i] = random.row(1.0);
        g.logit_opacities_mut()[i] = random.within(3.0);
    }
    state
}

/// `state` with random harmonics up to `degree`.
pub fn with_harmonics(mut state: State, degree: usize) -> State {
    let mut random = Random::new(71);
    let mut gaussians = state.parameters.gaussians.extended(&Layout::with_harmonics(degree));
    for band in gaussians.layout().harmonics() {
        gaussians.values_mut(band).fill_with(|| random.within(0.3));
    }
    state.parameters.gaussians = gaussians;
    State::new(state.parameters)
}

/// A random image of a camera that sees the Gaussians of [`state`].
pub fn target([width, height]: [usize; 2], channels: usize, seed: u64) -> Target {
    let mut random = Random::new(seed);
    let x = random.within(1.0).into();
    let camera =
        Camera::look_at([x, 0.2, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 1.2 * width.max(height) as f64, width, height);
    let mut image = Image::filled(width, height, channels, 0.0);
    for value in &mut image.data {
        *value = random.below(256) as f32 / 255.0;
    }
    if channels == 5 {
        for i in 0..width * height {
            let f = f32::from(u8::from(random.below(2) == 0));
            image.plane_mut(3)[i] = f;
            image.plane_mut(4)[i] = 1.0 - f;
        }
    }
    Target { camera, image }
}

/// Adds a past to `state`, with slightly different poses.
pub fn with_past(mut state: State) -> State {
    let mut random = Random::new(99);
    let g = &state.parameters.gaussians;
    let first = Pose::of(g);
    let mut previous = g.clone();
    previous.means_mut().iter_mut().for_each(|mean| *mean = mean.map(|x| x + random.within(0.01)));
    let previous_mask_logits = Some(vec![0.5; g.num_gaussians()]);
    let past = Past::new(first, previous, &state.parameters.foreground);
    state.past = Some(Past { previous_mask_logits, ..past });
    state
}

/// An iteration that counts gradients and moves Gaussians.
pub fn step(camera: usize, rates: Rates, config: &TrainConfig) -> Step<'_> {
    let (weights, mask) = (&config.weights, &config.mask);
    Step { camera, rates, weights, mask, counts_gradients: true, dropout: Dropout::default(), moves_gaussians: true }
}

/// All data that outlives an iteration, bit for bit.
pub fn bits(state: &State) -> Vec<u32> {
    let (p, o) = (&state.parameters, &state.optimizer);
    let mut values: Vec<f32> = Attribute::BASE.iter().flat_map(|&a| p.gaussians.values(a).to_vec()).collect();
    values.extend(p.camera_gains.iter().chain(&p.camera_offsets).flatten());
    values.extend(p.mask_logits.iter().chain(&state.statistic.sum));
    let others = [&o.mask, &o.gains, &o.offsets, &o.quantizer_steps, &o.quantizer_offsets];
    for attribute in Attribute::BASE {
        values.extend(o.first.values(attribute).iter().chain(o.second.values(attribute)));
        values.push(o.steps[attribute.index()] as f32);
    }
    for moments in others {
        values.extend(moments.first.iter().chain(&moments.second));
        values.push(moments.step as f32);
    }
    values.extend(state.quantizers.iter().flat_map(|q| &q.quantizers).flat_map(|q| [q.step, q.offset]));
    values.iter().map(|v| v.to_bits()).chain(state.statistic.count.iter().copied()).collect()
}

/// Starts quantisation of `state`, with two widths of rotations.
pub fn quantized(mut state: State, learned_offset: bool) -> State {
    state.canonicalize_quats();
    let gaussians = &state.parameters.gaussians;
    let mut bit_map = BitMap::uniform_of(gaussians.layout(), gaussians.num_gaussians(), 16, 6);
    bit_map.widths[1].iter_mut().step_by(3).for_each(|width| *width = 8);
    let quantizers = FakeQuantizers::new(bit_map, gaussians, learned_offset).unwrap();
    state.start_quantization(quantizers);
    state
}

/// Asserts that two engines computed the same except for rounding.
///
/// - `expected`, `found`: losses and states
pub fn assert_same(
    name: &str,
    config: &TrainConfig,
    (expected, e): (&[LossTerms], &State),
    (found, f): (&[LossTerms], &State),
) {
    assert_eq!(found.len(), expected.len(), "{name}");
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        for ((term, f, _), (_, e, _)) in f.terms(&config.weights).into_iter().zip(e.terms(&config.weights)) {
            assert!((f - e).abs() <= 2e-3 * e.abs() + 1e-5, "{name}: {term} of iteration {i}: {f} against {e}");
        }
    }
    let counts = e.statistic.count.iter().zip(&f.statistic.count).filter(|(a, b)| a != b).count();
    assert!(counts * 100 <= e.statistic.count.len(), "{name}: {counts} counts differ");
    let layout = Arc::clone(e.parameters.gaussians.layout());
    for attribute in layout.attributes() {
        let [m, n] = [e, f].map(|s| &s.optimizer);
        assert_eq!(m.steps[attribute.index()], n.steps[attribute.index()]);
        let error = relative_l2(n.first.values(attribute), m.first.values(attribute));
        assert!(error < 2e-2, "{name}: first moments of {}: {error}", layout.name(attribute));
        let (m, n) = (e.parameters.gaussians.values(attribute), f.parameters.gaussians.values(attribute));
        let error = relative_l2(n, m);
        assert!(error < 1e-3, "{name}: {}: {error}", layout.name(attribute));
    }
    let quantizers = [f, e].map(|s| -> Vec<f32> {
        s.quantizers.iter().flat_map(|q| &q.quantizers).flat_map(|q| [q.step, q.offset]).collect()
    });
    assert!(relative_l2(&quantizers[0], &quantizers[1]) < 1e-3, "{name}: quantizers");
    let [m, n] = [e, f].map(|s| &s.optimizer);
    let counts = |o: &Optimizer| [&o.quantizer_steps, &o.quantizer_offsets].map(|m| m.step);
    assert_eq!(counts(n), counts(m), "{name}");
    assert_eq!([m.mask.step, m.gains.step, m.offsets.step], [n.mask.step, n.gains.step, n.offsets.step], "{name}");
    assert!(relative_l2(&n.mask.first, &m.mask.first) < 2e-2, "{name}: masks");
    assert!(relative_l2(&n.gains.first, &m.gains.first) < 2e-3, "{name}: gains");
}

//! From floats to symbols: keypoints, quantizers, order.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use tcgs_core::{Attribute, DynamicGaussians, dot};

use crate::bits::BitMap;
use crate::compact::{CompactScene, MAX_TIMESTEPS, SceneInfo, Tracks, unit_quat};
use crate::keypoints::{Selector, fit_values};
use crate::morton;
use crate::quantize::{MAX_BITS, Quantizer, Quantizers};

/// Settings of [`compress`].
#[derive(Clone, Debug, PartialEq)]
pub struct CompressSettings {
    /// Whether tracks are reduced to keypoints at all; if not, every timestep is stored and the other
    /// settings do not matter. Default true.
    pub keypoints: bool,
    /// Most keypoints of a track, at least 2. Default 60: the tolerance should decide, and the most
    /// restless colours of a long scene need more than the paper's 30.
    pub max_keypoints: usize,
    /// By [`Attribute::index`]: mean squared error of a track at which selection stops, in the squared
    /// unit of the attribute. Default 2.5e-6 for positions (1.6 mm in scenes in metres), 4e-5 for rotations
    /// (0.7 degrees), 2e-4 for colours (3.6 of 255), 1e-4 for scales (1 percent) and 1e-3 for opacities (at
    /// most 0.008 of 1): measured on basketball, finer ones cost bytes that do not show. The paper's is
    /// 1e-5 for all. Those of attributes that do not vary are unused.
    pub max_mse: [f32; 5],
    /// Whether a track within `max_mse` of its mean is stored as that one value rather than as a line
    /// from first to last. Default true; most of a scene stands still. The paper keeps two keypoints.
    pub constant_tracks: bool,
    /// Whether the tolerance is at least `(step/4)²`: an error below that of rounding to the
    /// quantizer, `step²/12`, is not worth a keypoint. Default true; not in the paper.
    pub noise_floor: bool,
    /// Timesteps of a segment, 1 to 65536.
    pub segment_length: u32,
    /// Whether the components of an attribute of a Gaussian share their keypoint times, every segment has
    /// keypoints of its own at its ends, and values at keypoints are those of least squared error rather
    /// than samples. Default true; not in the paper.
    pub joint: bool,
    /// How the tolerance follows what a Gaussian's error does to images: the power of its weight by
    /// opacity and size that the tolerance is divided by. Default 0.5; 0 in the paper.
    pub importance: f32,
    /// Gaussians of each layer but the last, as shares of all. Default a tenth and three tenths.
    pub layers: Vec<f32>,
    /// By [`Attribute::index`]: bits by which widths of the bit map are lowered, to 2 at least. Default 2 for
    /// rotations and 1 for opacities, which training gives as many as colours: on basketball that took
    /// 6 percent off the file and 0.01 dB.
    pub coarser: [u8; 5],
    /// If positive, positions get the fewest bits whose steps are the median Gaussian's middle axis (one
    /// standard deviation) divided by this, or finer. Default 8; if 0, what the bit map says.
    pub position_fineness: f32,
}

impl Default for CompressSettings {
    fn default() -> Self {
        Self {
            keypoints: true,
            max_keypoints: 60,
            max_mse: [2.5e-6, 4e-5, 1e-4, 1e-3, 2e-4],
            constant_tracks: true,
            noise_floor: true,
            segment_length: 50,
            joint: true,
            importance: 0.5,
            layers: vec![0.1, 0.3],
            coarser: [0, 2, 0, 1, 0],
            position_fineness: 8.0,
        }
    }
}

impl CompressSettings {
    /// The paper's for Panoptic Sports: 30 keypoints, 1e-5 for everything.
    pub fn paper() -> Self {
        Self {
            keypoints: true,
            max_keypoints: 30,
            max_mse: [1e-5; 5],
            constant_tracks: false,
            noise_floor: false,
            segment_length: 50,
            joint: false,
            importance: 0.0,
            layers: Vec::new(),
            coarser: [0; 5],
            position_fineness: 0.0,
        }
    }
}

/// Turns a scene into symbols: [`compress_ordered`] without the order.
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// scene.push(Gaussians::zeros(3));
/// let bit_map = BitMap::uniform(3, 16, 6);
/// let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default());
/// assert_eq!(compact.at(1).means, scene.means[1]);
/// ```
///
/// # Panics
/// As [`compress_ordered`].
pub fn compress(
    scene: &DynamicGaussians,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> CompactScene {
    compress_ordered(scene, bit_map, learned, info, settings).0
}

/// Turns a scene into symbols.
///
/// Quaternions are normalised and made sign-continuous over time; keypoints are selected, on every
/// scalar track by itself (paper 4.1.3) or for all components of an attribute together; positions get quantizers that cover all of them, every other
/// channel and width the learned quantizer, or a fitted one where that errs far less on the values stored.
///
/// - `bit_map`: for the Gaussians of `scene`, in its order
/// - `learned`: quantizers from training; those for positions are not used
/// - `info`: counts as `scene` has them
/// - returns: the compact scene, whose Gaussians lie in layers, in each along a Morton curve of their first
///   positions; and that order: Gaussian `i` of the compact scene is `order[i]` of `scene`
///
/// # Panics
/// If `scene`, `bit_map` and `info` disagree in a count, there is no timestep or more than 65536, a value
/// is not finite, or a width is not within 1 to 16.
pub fn compress_ordered(
    scene: &DynamicGaussians,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> (CompactScene, Vec<usize>) {
    check_arguments(scene, bit_map, &info);
    let bit_map = &adjusted(bit_map, scene, settings);
    let mut quantizers = Quantizers::default();
    let tracks: [Tracks<f32>; 5] = Attribute::ALL.map(|attribute| {
        let widths = &bit_map.widths[attribute.index()];
        let tolerances = tolerances(scene, attribute, widths, learned, settings);
        let slack = tolerance_factors(scene, attribute, settings);
        let tracks = float_tracks(scene, attribute, |values, gaussian, selector, out| {
            let tolerances: Vec<f32> = tolerances[usize::from(widths[gaussian])]
                .iter()
                .map(|&(max_mse, floor)| f32::max(max_mse * slack.get(gaussian).unwrap_or(&1.0), floor))
                .collect();
            if settings.joint && settings.keypoints && scene.varies(attribute) {
                reduce_jointly(values, &tolerances, settings, selector, out);
            } else {
                for (track, &max_mse) in values.chunks_exact(values.len() / tolerances.len()).zip(&tolerances) {
                    let (times, values) = reduce(track, max_mse, settings, selector);
                    out.push(&times, &values);
                }
            }
        });
        quantizers.attributes[attribute.index()] = quantizers_for(attribute, &tracks, widths, learned);
        tracks
    });
    let order = morton_order(&tracks[Attribute::Mean.index()], &bit_map.widths[Attribute::Mean.index()], &quantizers);
    let (order, layers) = by_layer(order, scene, settings);
    let bit_map = bit_map.select(&order);
    let codes = Attribute::ALL.map(|attribute| {
        let (components, table) = (attribute.components(), quantizers.by_width(attribute));
        let (mut codes, mut of_track) = (Tracks::default(), Vec::new());
        for (&gaussian, &width) in order.iter().zip(&bit_map.widths[attribute.index()]) {
            for (channel, quantizer) in table[usize::from(width)].iter().enumerate() {
                let (times, values) = tracks[attribute.index()].track(gaussian * components + channel);
                of_track.clear();
                of_track.extend(values.iter().map(|&x| quantizer.quantize(x) as i16));
                codes.push(times, &of_track);
            }
        }
        codes
    });
    let varies = Attribute::ALL.map(|attribute| scene.varies(attribute));
    let segment_length = settings.segment_length;
    (CompactScene { info, bit_map, quantizers, varies, layers, segment_length, tracks: codes }, order)
}

/// The bit map with what the settings change in it.
fn adjusted(bit_map: &BitMap, scene: &DynamicGaussians, settings: &CompressSettings) -> BitMap {
    let mut bit_map = bit_map.clone();
    for (widths, &coarser) in bit_map.widths.iter_mut().zip(&settings.coarser) {
        for width in widths {
            *width = width.saturating_sub(coarser).max(2.min(*width));
        }
    }
    let mut axes: Vec<f32> = scene.values(Attribute::LogScale, 0).as_chunks::<3>().0.iter().map(middle).collect();
    if settings.position_fineness > 0.0 && !axes.is_empty() {
        let half = axes.len() / 2;
        let axis = f64::from(*axes.select_nth_unstable_by(half, f32::total_cmp).1).exp();
        let (mut min, mut max) = ([f32::MAX; 3], [f32::MIN; 3]);
        for mean in scene.means.iter().flatten() {
            min = std::array::from_fn(|i| min[i].min(mean[i]));
            max = std::array::from_fn(|i| max[i].max(mean[i]));
        }
        let extent = (0..3).map(|i| f64::from(max[i]) - f64::from(min[i])).fold(0.0, f64::max);
        let levels = extent * f64::from(settings.position_fineness) / axis + 1.0;
        bit_map.widths[Attribute::Mean.index()].fill((levels.log2().ceil() as u8).clamp(1, MAX_BITS));
    }
    bit_map
}

/// The middle one of three.
fn middle(values: &[f32; 3]) -> f32 {
    let mut values = *values;
    values.sort_unstable_by(f32::total_cmp);
    values[1]
}

/// Splits an order into layers by how much of an image each Gaussian covers, the most first; the order holds
/// within each. Returns the number of Gaussians of each layer, too.
fn by_layer(order: Vec<usize>, scene: &DynamicGaussians, settings: &CompressSettings) -> (Vec<usize>, Vec<u32>) {
    let n = order.len();
    let mut by_weight: Vec<usize> = (0..n).collect();
    let weights: Vec<f64> = (0..n).map(|g| weight(scene, Attribute::Color, g)).collect();
    by_weight.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]));
    let mut ends: Vec<usize> = Vec::new();
    for share in &settings.layers {
        let start = ends.last().copied().unwrap_or(0);
        ends.push((start + (f64::from(*share) * n as f64) as usize).min(n));
    }
    ends.push(n);
    ends.dedup();
    ends.retain(|&end| end > 0);
    let mut layer_of = vec![0; n];
    for (rank, &gaussian) in by_weight.iter().enumerate() {
        layer_of[gaussian] = ends.partition_point(|&end| end <= rank);
    }
    let mut layered = order;
    layered.sort_by_key(|&gaussian| layer_of[gaussian]);
    let sizes = ends.iter().scan(0, |start, &end| Some((end - std::mem::replace(start, end)) as u32)).collect();
    (layered, sizes)
}

fn check_arguments(scene: &DynamicGaussians, bit_map: &BitMap, info: &SceneInfo) {
    let (n, t) = (scene.num_gaussians(), scene.num_timesteps());
    assert!(t > 0 && t <= MAX_TIMESTEPS as usize, "{t} timesteps, expected 1 to {MAX_TIMESTEPS}");
    assert_eq!(
        (info.num_gaussians as usize, info.num_timesteps as usize),
        (n, t),
        "Gaussians and timesteps of the info against those of the scene"
    );
    for attribute in Attribute::ALL {
        let (name, widths) = (attribute.name(), &bit_map.widths[attribute.index()]);
        assert_eq!(widths.len(), n, "bit widths of {name}: [{}] against [{n}] Gaussians", widths.len());
        let illegal = widths.iter().find(|w| !(1..=MAX_BITS).contains(*w));
        assert!(illegal.is_none(), "a width of {illegal:?} bits in {name}, expected 1 to {MAX_BITS}");
        for timestep in 0..scene.num_samples(attribute) {
            let values = scene.values(attribute, timestep);
            assert_eq!(values.len(), n * attribute.components(), "{name} at timestep {timestep}");
            if let Some(i) = values.iter().position(|x| !x.is_finite()) {
                let gaussian = i / attribute.components();
                panic!("{name} of Gaussian {gaussian} at timestep {timestep}: {}, expected a finite number", values[i]);
            }
        }
    }
}

/// Gaussians whose tracks are gathered from the timesteps together: a cache line or more of each.
const BLOCK: usize = 64;

/// Tracks of one attribute after `reduce(values, gaussian, selector, out)`, which is given the `[C, T]` values
/// of a Gaussian and adds a track for each component.
fn float_tracks(
    scene: &DynamicGaussians,
    attribute: Attribute,
    reduce: impl Fn(&[f32], usize, &mut Selector, &mut Tracks<f32>) + Sync,
) -> Tracks<f32> {
    let (n, components) = (scene.num_gaussians(), attribute.components());
    let samples = scene.num_samples(attribute);
    let blocks: Vec<Tracks<f32>> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(Selector::default, |selector, block| {
            let gaussians = block * BLOCK..((block + 1) * BLOCK).min(n);
            let values = gather(scene, attribute, gaussians.clone());
            let mut tracks = Tracks::default();
            for (gaussian, values) in gaussians.zip(values.chunks_exact(samples * components)) {
                reduce(values, gaussian, selector, &mut tracks);
            }
            tracks
        })
        .collect();
    let mut tracks = Tracks::default();
    for block in &blocks {
        tracks.append(block);
    }
    tracks
}

/// `[gaussians, components, T]` of one attribute; quaternions of unit length, neighbours in time in one
/// hemisphere, the first with `w >= 0`.
fn gather(scene: &DynamicGaussians, attribute: Attribute, gaussians: Range<usize>) -> Vec<f32> {
    let components = attribute.components();
    let samples = scene.num_samples(attribute);
    let mut tracks = vec![0.0; gaussians.len() * components * samples];
    for timestep in 0..samples {
        let values = &scene.values(attribute, timestep)[gaussians.start * components..gaussians.end * components];
        for (track, value) in tracks.chunks_exact_mut(samples).zip(values) {
            track[timestep] = *value;
        }
    }
    if attribute == Attribute::Quat {
        for tracks in tracks.chunks_exact_mut(4 * samples) {
            // Before the first: no rotation, so that w >= 0.
            let mut before = [1.0, 0.0, 0.0, 0.0];
            for timestep in 0..samples {
                let mut quat = unit_quat(std::array::from_fn(|c| tracks[c * samples + timestep]));
                if dot(quat, before) < 0.0 {
                    quat = quat.map(|x| -x);
                }
                for (channel, &x) in quat.iter().enumerate() {
                    tracks[channel * samples + timestep] = x;
                }
                before = quat;
            }
        }
    }
    tracks
}

/// Keypoints of one track.
fn reduce(track: &[f32], max_mse: f32, settings: &CompressSettings, selector: &mut Selector) -> (Vec<u16>, Vec<f32>) {
    if !settings.keypoints {
        return ((0..track.len()).map(|t| t as u16).collect(), track.to_vec());
    }
    if settings.constant_tracks {
        let count = track.len() as f64;
        let mean = (track.iter().map(|&x| f64::from(x)).sum::<f64>() / count) as f32;
        let mse = track.iter().map(|&x| (f64::from(x) - f64::from(mean)).powi(2)).sum::<f64>() / count;
        if mse <= f64::from(max_mse) {
            return (vec![0], vec![mean]);
        }
    }
    let indices = selector.select(track, settings.max_keypoints, max_mse);
    (indices.iter().map(|&i| i as u16).collect(), indices.iter().map(|&i| track[i]).collect())
}

/// Keypoints that all components of an attribute of a Gaussian share, segment by segment.
///
/// - `values`: `[C, T]`
/// - `tolerances`: `[C]`
fn reduce_jointly(
    values: &[f32],
    tolerances: &[f32],
    settings: &CompressSettings,
    selector: &mut Selector,
    out: &mut Tracks<f32>,
) {
    let num_timesteps = values.len() / tolerances.len();
    let tracks: Vec<&[f32]> = values.chunks_exact(num_timesteps).collect();
    let weights: Vec<f64> = tolerances.iter().map(|&t| 1.0 / f64::from(t).max(1e-30)).collect();
    if settings.constant_tracks && mean_error(&tracks, &weights) <= tracks.len() as f64 {
        tracks.iter().for_each(|track| out.push(&[0], &[mean(track)]));
        return;
    }
    let mut times: Vec<u16> = Vec::new();
    let mut at_keypoints: Vec<Vec<f32>> = vec![Vec::new(); tracks.len()];
    let length = settings.segment_length as usize;
    for start in (0..num_timesteps).step_by(length) {
        let span = start..(start + length).min(num_timesteps);
        let tracks: Vec<&[f32]> = tracks.iter().map(|track| &track[span.clone()]).collect();
        let still = settings.constant_tracks && mean_error(&tracks, &weights) <= tracks.len() as f64;
        let limit = FIT_GAIN * tracks.len() as f64;
        let indices = selector.select_joint(&tracks, &weights, if still { 2 } else { settings.max_keypoints }, limit);
        times.extend(indices.iter().map(|&i| (start + i) as u16));
        for (track, at_keypoints) in tracks.iter().zip(&mut at_keypoints) {
            if still {
                at_keypoints.extend(vec![mean(track); indices.len()]);
            } else {
                at_keypoints.extend(fit_values(track, indices));
            }
        }
    }
    at_keypoints.iter().for_each(|values| out.push(&times, values));
}

/// By how much the squared error through samples may exceed the tolerance, since fitted values lower it.
const FIT_GAIN: f64 = 1.5;

fn mean(track: &[f32]) -> f32 {
    (track.iter().map(|&x| f64::from(x)).sum::<f64>() / track.len() as f64) as f32
}

/// Mean over time of the weighted sum of squared distances to the means.
fn mean_error(tracks: &[&[f32]], weights: &[f64]) -> f64 {
    let error = |track: &&[f32]| {
        let mean = f64::from(mean(track));
        track.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / track.len() as f64
    };
    tracks.iter().zip(weights).map(|(track, weight)| weight * error(track)).sum()
}

/// What the tolerance of every Gaussian is multiplied by; empty if all are 1.
///
/// An error moves a splat's image by about as much as the error's size times the slope of the splat. Squared
/// and summed over its pixels that is, up to a constant, opacity squared, times the area for a colour, times
/// the ratio of the axes for a position, and for a rotation also times how far it is from round. Tolerances
/// are divided by a power of that, relative to the median.
fn tolerance_factors(scene: &DynamicGaussians, attribute: Attribute, settings: &CompressSettings) -> Vec<f32> {
    if settings.importance == 0.0 || !scene.varies(attribute) {
        return Vec::new();
    }
    let weights: Vec<f64> = (0..scene.num_gaussians()).map(|g| weight(scene, attribute, g)).collect();
    let mut sorted = weights.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
    let factor = |w: f64| (median / w).powf(settings.importance.into()).clamp(1.0 / MAX_FACTOR, MAX_FACTOR) as f32;
    weights.into_iter().map(factor).collect()
}

/// Tolerances change at most by this.
const MAX_FACTOR: f64 = 16.0;

fn weight(scene: &DynamicGaussians, attribute: Attribute, gaussian: usize) -> f64 {
    let opacity = f64::from(tcgs_core::sigmoid(scene.values(Attribute::LogitOpacity, 0)[gaussian]));
    let scales = &scene.values(Attribute::LogScale, 0)[3 * gaussian..3 * gaussian + 3];
    let mut scales = [0, 1, 2].map(|i| f64::from(scales[i]).exp());
    scales.sort_unstable_by(f64::total_cmp);
    let [thin, middle, long] = scales;
    let seen = opacity * opacity;
    let round = (long / thin.max(0.1 * long)).min(10.0);
    let weight = match attribute {
        Attribute::Color | Attribute::LogitOpacity | Attribute::LogScale => seen * middle * long,
        Attribute::Mean => seen * (long / middle.max(0.1 * long)).min(10.0),
        Attribute::Quat => seen * middle * long * (round - 1.0 / round).powi(2).max(1e-3),
    };
    weight.max(1e-30)
}

/// Tolerance of a track by width and channel, and the noise floor below which it never falls.
fn tolerances(
    scene: &DynamicGaussians,
    attribute: Attribute,
    widths: &[u8],
    learned: Option<&Quantizers>,
    settings: &CompressSettings,
) -> Vec<Vec<(f32, f32)>> {
    let max_mse = settings.max_mse[attribute.index()];
    let mut tolerances = vec![vec![(max_mse, 0.0); attribute.components()]; usize::from(MAX_BITS) + 1];
    if settings.keypoints && settings.noise_floor && scene.varies(attribute) {
        // The quantizers proper need the keypoints, which need the steps: those of three timesteps serve.
        let last = scene.num_timesteps() - 1;
        let samples = [0, last / 2, last];
        let tracks = float_tracks(scene, attribute, |values, _, _, out| {
            for track in values.chunks_exact(scene.num_timesteps()) {
                out.push(&samples.map(|t| t as u16), &samples.map(|t| track[t]));
            }
        });
        for (width, quantizers) in quantizers_for(attribute, &tracks, widths, learned) {
            tolerances[usize::from(width)] = quantizers.iter().map(|q| (max_mse, (q.step / 4.0).powi(2))).collect();
        }
    }
    tolerances
}

/// A learned quantizer is what the optimisation rounded to, and errs where that does not show, so it may
/// err more than the fitted one; by more than this, values have left its range since it was learned.
const LEARNED_ERROR_RATIO: f64 = 2.0;

/// Quantizers for every width in use.
fn quantizers_for(
    attribute: Attribute,
    tracks: &Tracks<f32>,
    widths: &[u8],
    learned: Option<&Quantizers>,
) -> BTreeMap<u8, Vec<Quantizer>> {
    let components = attribute.components();
    let mut groups: BTreeMap<u8, Vec<Vec<f32>>> = BTreeMap::new();
    for (gaussian, &width) in widths.iter().enumerate() {
        let group = groups.entry(width).or_insert_with(|| vec![Vec::new(); components]);
        for (channel, values) in group.iter_mut().enumerate() {
            values.extend_from_slice(tracks.track(gaussian * components + channel).1);
        }
    }
    let groups: Vec<_> = groups.into_iter().collect();
    groups
        .into_par_iter()
        .map(|(width, channels)| {
            let quantizers = channels.par_iter().enumerate().map(|(channel, values)| {
                if attribute == Attribute::Mean {
                    let (min, max) = values.iter().fold((f32::MAX, f32::MIN), |(a, b), &x| (a.min(x), b.max(x)));
                    return Quantizer::covering(min, max, width);
                }
                let fitted = Quantizer::fit(values, width);
                let learned = learned.and_then(|l| l.get(attribute, width, channel)).filter(|q| q.bits == width);
                match learned {
                    Some(q)
                        if q.problem().is_none()
                            && q.squared_error(values) <= LEARNED_ERROR_RATIO * fitted.squared_error(values) =>
                    {
                        *q
                    }
                    _ => fitted,
                }
            });
            (width, quantizers.collect())
        })
        .collect()
}

/// Gaussians along a Morton curve of the codes of their first positions; equal ones in their order.
fn morton_order(means: &Tracks<f32>, widths: &[u8], quantizers: &Quantizers) -> Vec<usize> {
    let table = quantizers.by_width(Attribute::Mean);
    let mut keys: Vec<(u64, usize)> = widths
        .iter()
        .enumerate()
        .map(|(gaussian, &width)| {
            let code = |channel: usize| {
                let quantizer = &table[usize::from(width)][channel];
                let code = quantizer.quantize(means.track(3 * gaussian + channel).1[0]) - quantizer.min_code();
                // Coarser codes fill the range of the finest, so that all lie on one curve.
                (code << (MAX_BITS - width)) as u16
            };
            (morton::interleave([code(0), code(1), code(2)]), gaussian)
        })
        .collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|(_, gaussian)| gaussian).collect()
}

//! From floats to symbols: keypoints, quantizers, order.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use tcgs_core::{Attribute, DynamicGaussians, dot};

use crate::bits::BitMap;
use crate::compact::{CompactScene, MAX_TIMESTEPS, SceneInfo, Tracks, unit_quat};
use crate::keypoints::Selector;
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
    /// unit of the attribute. Default 1e-5 for positions and rotations (the paper's for scenes in metres:
    /// 3 mm, 0.4 degrees) and 5e-5 for colours (1.8 of 255): what is followed below that is noise of
    /// the optimisation; 1e-4 for scales (1 percent) and 1e-3 for opacities (at most 0.008 of 1). Those of
    /// attributes that do not vary are unused.
    pub max_mse: [f32; 5],
    /// Whether a track within `max_mse` of its mean is stored as that one value rather than as a line
    /// from first to last. Default true; most of a scene stands still. The paper keeps two keypoints.
    pub constant_tracks: bool,
    /// Whether the tolerance is at least `(step/4)²`: an error below that of rounding to the
    /// quantizer, `step²/12`, is not worth a keypoint. Default true; not in the paper.
    pub noise_floor: bool,
    /// Timesteps of a segment, 1 to 65536.
    pub segment_length: u32,
}

impl Default for CompressSettings {
    fn default() -> Self {
        let mut max_mse = [1e-5; 5];
        max_mse[Attribute::Color.index()] = 5e-5;
        max_mse[Attribute::LogScale.index()] = 1e-4;
        max_mse[Attribute::LogitOpacity.index()] = 1e-3;
        Self { keypoints: true, max_keypoints: 60, max_mse, constant_tracks: true, noise_floor: true, segment_length: 50 }
    }
}

impl CompressSettings {
    /// The paper's for Panoptic Sports: 30 keypoints, 1e-5 for everything.
    pub fn paper() -> Self {
        Self { keypoints: true, max_keypoints: 30, max_mse: [1e-5; 5], constant_tracks: false, noise_floor: false, segment_length: 50 }
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
/// Quaternions are normalised and made sign-continuous over time; keypoints are selected on every
/// scalar track by itself (paper 4.1.3); positions get quantizers that cover all of them, every other
/// channel and width the learned quantizer, or a fitted one where that errs far less on the values stored.
///
/// - `bit_map`: for the Gaussians of `scene`, in its order
/// - `learned`: quantizers from training; those for positions are not used
/// - `info`: counts as `scene` has them
/// - returns: the compact scene, whose Gaussians follow a Morton curve of their first positions; and that
///   order: Gaussian `i` of the compact scene is `order[i]` of `scene`
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
    let mut quantizers = Quantizers::default();
    let tracks: [Tracks<f32>; 5] = Attribute::ALL.map(|attribute| {
        let widths = &bit_map.widths[attribute.index()];
        let tolerances = tolerances(scene, attribute, widths, learned, settings);
        let tracks = float_tracks(scene, attribute, |track, gaussian, channel, selector| {
            let max_mse = tolerances[usize::from(widths[gaussian])][channel];
            reduce(track, max_mse, settings, selector)
        });
        quantizers.attributes[attribute.index()] = quantizers_for(attribute, &tracks, widths, learned);
        tracks
    });
    let order = morton_order(&tracks[Attribute::Mean.index()], &bit_map.widths[Attribute::Mean.index()], &quantizers);
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
    let layers = if order.is_empty() { Vec::new() } else { vec![order.len() as u32] };
    let segment_length = settings.segment_length;
    (CompactScene { info, bit_map, quantizers, varies, layers, segment_length, tracks: codes }, order)
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

/// Tracks of one attribute after `reduce(track, gaussian, channel, selector) -> (times, values)`.
fn float_tracks(
    scene: &DynamicGaussians,
    attribute: Attribute,
    reduce: impl Fn(&[f32], usize, usize, &mut Selector) -> (Vec<u16>, Vec<f32>) + Sync,
) -> Tracks<f32> {
    let (n, components) = (scene.num_gaussians(), attribute.components());
    let samples = scene.num_samples(attribute);
    let blocks: Vec<Tracks<f32>> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(Selector::default, |selector, block| {
            let gaussians = block * BLOCK..((block + 1) * BLOCK).min(n);
            let values = gather(scene, attribute, gaussians.clone());
            let mut tracks = Tracks::default();
            for (i, track) in values.chunks_exact(samples).enumerate() {
                let (gaussian, channel) = (gaussians.start + i / components, i % components);
                let (times, values) = reduce(track, gaussian, channel, selector);
                tracks.push(&times, &values);
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

/// Tolerance of a track by width and channel.
fn tolerances(
    scene: &DynamicGaussians,
    attribute: Attribute,
    widths: &[u8],
    learned: Option<&Quantizers>,
    settings: &CompressSettings,
) -> Vec<Vec<f32>> {
    let max_mse = settings.max_mse[attribute.index()];
    let mut tolerances = vec![vec![max_mse; attribute.components()]; usize::from(MAX_BITS) + 1];
    if settings.keypoints && settings.noise_floor && scene.varies(attribute) {
        // The quantizers proper need the keypoints, which need the steps: those of three timesteps serve.
        let last = scene.num_timesteps() - 1;
        let samples = [0, last / 2, last];
        let tracks = float_tracks(scene, attribute, |track, _, _, _| {
            (samples.map(|t| t as u16).to_vec(), samples.map(|t| track[t]).to_vec())
        });
        for (width, quantizers) in quantizers_for(attribute, &tracks, widths, learned) {
            tolerances[usize::from(width)] = quantizers.iter().map(|q| max_mse.max((q.step / 4.0).powi(2))).collect();
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

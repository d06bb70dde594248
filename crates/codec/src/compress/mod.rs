//! From floats to symbols.
//!
//! - `settings`: what a user may choose
//! - `tracks`: values over time, and their keypoints
//! - `order`: who matters more, layers, and the curve along which Gaussians lie
//!
//! Here: quantizers and tolerances, and the steps one after another.

mod order;
mod settings;
mod tracks;

use std::collections::BTreeMap;

use rayon::prelude::*;
use tcgs_core::{Attribute, DynamicGaussians};

use self::order::{by_layer, morton_order, tolerance_factors};
use self::tracks::{float_tracks, reduce, reduce_jointly};
use crate::bits::BitMap;
use crate::compact::{CompactScene, MAX_TIMESTEPS, SceneInfo, Tracks};
use crate::error::CompressError;
use crate::quantize::{MAX_BITS, Quantizer, Quantizers, check_bits};

pub use self::settings::CompressSettings;

/// Turns a scene into symbols: [`compress_ordered`] without the order.
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// scene.push(Gaussians::zeros(3));
/// let bit_map = BitMap::uniform(3, 16, 6);
/// let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
/// assert_eq!(compact.at(1).means(), scene.means(1));
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// As [`compress_ordered`].
pub fn compress(
    scene: &DynamicGaussians,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> Result<CompactScene, CompressError> {
    Ok(compress_ordered(scene, bit_map, learned, info, settings)?.0)
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
/// # Errors
/// [`CompressError`] if `scene`, `bit_map` and `info` disagree in a count, there is no timestep or more than 65536, a
/// value is not finite, a width is not within 1 to 16, a setting is out of range, or values lie further apart than a
/// quantizer can say.
pub fn compress_ordered(
    scene: &DynamicGaussians,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> Result<(CompactScene, Vec<usize>), CompressError> {
    settings.check()?;
    check_arguments(scene, bit_map, &info)?;
    let bit_map = &settings.adjusted(bit_map, scene);
    let position_step = settings.position_step(scene);
    let segment_length = settings.segment_length_of(scene.num_gaussians(), scene.num_timesteps());
    let mut quantizers = Quantizers::default();
    let mut tracks: [Tracks<f32>; 5] = Default::default();
    for attribute in Attribute::BASE {
        let widths = &bit_map.widths[attribute.index()];
        let tolerances = tolerances(scene, attribute, widths, learned, position_step, settings)?;
        let slack = tolerance_factors(scene, attribute, settings);
        let of_attribute = float_tracks(scene, attribute, |values, gaussian, selector, out| {
            let tolerances: Vec<f32> = tolerances[usize::from(widths[gaussian])]
                .iter()
                .map(|&(max_mse, floor)| f32::max(max_mse * slack.get(gaussian).unwrap_or(&1.0), floor))
                .collect();
            if settings.joint && settings.keypoints && scene.varies(attribute) {
                reduce_jointly(values, &tolerances, segment_length as usize, settings, selector, out);
            } else {
                for (track, &max_mse) in values.chunks_exact(values.len() / tolerances.len()).zip(&tolerances) {
                    let (times, values) = reduce(track, max_mse, settings, selector);
                    out.push(&times, &values);
                }
            }
        });
        quantizers.attributes[attribute.index()] =
            quantizers_for(attribute, &of_attribute, widths, learned, position_step)?;
        tracks[attribute.index()] = of_attribute;
    }
    let order = morton_order(&tracks[Attribute::Mean.index()], &bit_map.widths[Attribute::Mean.index()], &quantizers);
    let (order, layers) = by_layer(order, scene, settings);
    let bit_map = bit_map.select(&order);
    let codes = Attribute::BASE.map(|attribute| {
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
    let varies = Attribute::BASE.map(|attribute| scene.varies(attribute));
    Ok((CompactScene { info, bit_map, quantizers, varies, layers, segment_length, tracks: codes }, order))
}

fn check_arguments(scene: &DynamicGaussians, bit_map: &BitMap, info: &SceneInfo) -> Result<(), CompressError> {
    let (n, t) = (scene.num_gaussians(), scene.num_timesteps());
    if !(1..=MAX_TIMESTEPS as usize).contains(&t) {
        return Err(CompressError::Value { what: "number of timesteps", found: t as f64, expected: "1 to 65536" });
    }
    let counts = |what: String, found: usize, expected: usize| {
        if found == expected { Ok(()) } else { Err(CompressError::Count { what, found, expected }) }
    };
    counts("Gaussians in info".into(), info.num_gaussians as usize, n)?;
    counts("timesteps in info".into(), info.num_timesteps as usize, t)?;
    for attribute in Attribute::BASE {
        let (name, widths) = (attribute.name(), &bit_map.widths[attribute.index()]);
        counts(format!("bit widths of {name}"), widths.len(), n)?;
        widths.iter().try_for_each(|&width| check_bits(width))?;
        for timestep in 0..scene.num_samples(attribute) {
            let values = scene.values(attribute, timestep);
            counts(format!("values of {name} at timestep {timestep}"), values.len(), n * attribute.components())?;
            if let Some(i) = values.iter().position(|x| !x.is_finite()) {
                return Err(CompressError::Gaussian {
                    what: name.to_owned(),
                    gaussian: i / attribute.components(),
                    timestep: Some(timestep),
                    found: values[i].into(),
                    expected: "a finite number",
                });
            }
        }
    }
    Ok(())
}

/// Tolerance of a track by width and channel, and the noise floor below which it never falls.
fn tolerances(
    scene: &DynamicGaussians,
    attribute: Attribute,
    widths: &[u8],
    learned: Option<&Quantizers>,
    position_step: Option<f64>,
    settings: &CompressSettings,
) -> Result<Vec<Vec<(f32, f32)>>, CompressError> {
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
        for (width, quantizers) in quantizers_for(attribute, &tracks, widths, learned, position_step)? {
            tolerances[usize::from(width)] = quantizers.iter().map(|q| (max_mse, (q.step / 4.0).powi(2))).collect();
        }
    }
    Ok(tolerances)
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
    position_step: Option<f64>,
) -> Result<BTreeMap<u8, Vec<Quantizer>>, CompressError> {
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
                    let covering = Quantizer::covering(min, max, width)?;
                    let step = position_step.filter(|&step| step > f64::from(covering.step));
                    return step.map_or(Ok(covering), |step| Quantizer::from_lowest(min, step, width));
                }
                let fitted = Quantizer::fit(values, width)?;
                let learned = learned.and_then(|l| l.get(attribute, width, channel)).filter(|q| q.bits == width);
                Ok(match learned {
                    Some(q)
                        if q.problem().is_none()
                            && q.squared_error(values) <= LEARNED_ERROR_RATIO * fitted.squared_error(values) =>
                    {
                        *q
                    }
                    _ => fitted,
                })
            });
            Ok((width, quantizers.collect::<Result<_, CompressError>>()?))
        })
        .collect()
}

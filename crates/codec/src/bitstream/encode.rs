//! Symbols to bytes.

use rayon::prelude::*;
use tcgs_core::Attribute;

use super::residual::{Neighbor, Transform};
use super::stream::{self, Planes};
use super::{FIRST_CODES, LATER_CODES, along_curve, bytes_of_bits, bytes_of_time, container, groups_by_width};
use crate::compact::{CompactScene, Tracks};
use crate::morton;

/// The `.tcgs` file of a scene. The same scene gives the same bytes.
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let bit_map = BitMap::uniform(3, 16, 6);
/// let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default());
/// assert_eq!(decode(&encode(&compact), &DecodeLimits::default())?, compact);
/// # Ok::<(), tcgs_codec::DecodeError>(())
/// ```
///
/// # Panics
/// If the scene breaks a rule of the format, such as a code outside its width; what [`crate::compress`]
/// or [`crate::decode`] returned never does.
pub fn encode(scene: &CompactScene) -> Vec<u8> {
    if let Err(violation) = scene.check() {
        panic!("a scene that cannot be encoded: {violation:?}");
    }
    let [means, quats, log_scales, logit_opacities, colors] = Attribute::ALL.map(|a| tracks_section(scene, a));
    container::write(&[
        info_section(scene),
        bit_map_section(scene),
        quantizers_section(scene),
        means,
        quats,
        log_scales,
        logit_opacities,
        colors,
    ])
}

fn info_section(scene: &CompactScene) -> Vec<u8> {
    let info = &scene.info;
    let mut bytes = Vec::new();
    for count in [info.num_gaussians, info.num_timesteps, info.first_frame, info.downscale] {
        bytes.extend(count.to_le_bytes());
    }
    bytes.extend(info.frame_rate.to_le_bytes());
    bytes.extend((info.name.len() as u16).to_le_bytes());
    bytes.extend(info.name.as_bytes());
    bytes.push(scene.varies.iter().enumerate().map(|(index, &varies)| u8::from(varies) << index).sum());
    bytes
}

fn bit_map_section(scene: &CompactScene) -> Vec<u8> {
    let mut section = Vec::new();
    for widths in &scene.bit_map.widths {
        match widths.first() {
            // A leading 0: one for each Gaussian follows.
            Some(first) if widths.iter().any(|w| w != first) => {
                section.push(0);
                let planes = Planes::new(widths.iter().map(|&w| u64::from(w)), widths.len(), 1);
                section.extend(stream::write(&[(Transform::Plain, planes)]));
            }
            first => section.push(first.copied().unwrap_or(1)),
        }
    }
    section
}

fn quantizers_section(scene: &CompactScene) -> Vec<u8> {
    let mut section = Vec::new();
    for by_width in &scene.quantizers.attributes {
        section.push(by_width.len() as u8);
        for (&width, channels) in by_width {
            section.push(width);
            for quantizer in channels {
                section.extend(quantizer.step.to_le_bytes());
                section.extend(quantizer.offset.to_le_bytes());
            }
        }
    }
    section
}

/// Counts, times, then by width the first code of every track and the codes after it.
fn tracks_section(scene: &CompactScene, attribute: Attribute) -> Vec<u8> {
    let tracks = &scene.tracks[attribute.index()];
    let components = attribute.components();
    let mut streams: Vec<Vec<(Transform, Planes)>> = Vec::new();
    if scene.varies[attribute.index()] {
        let symbol_bytes = bytes_of_time(scene.num_timesteps());
        streams.push(vec![(Transform::Plain, counts(tracks, symbol_bytes))]);
        streams.push(vec![(Transform::Plain, gaps(tracks, symbol_bytes))]);
    }
    for (width, gaussians) in groups_by_width(&scene.bit_map.widths[attribute.index()]) {
        if along_curve(attribute) {
            streams.push(vec![(Transform::Plain, curve_gaps(tracks, &gaussians, width))]);
        }
        for channel in 0..components {
            let of_channel = || gaussians.iter().map(|g| tracks.track(g * components + channel));
            let symbol_bytes = bytes_of_bits(width.into());
            if !along_curve(attribute) {
                streams.push(candidates(&FIRST_CODES, gaussians.len(), symbol_bytes, |transform| {
                    let mut before = 0;
                    of_channel().map(move |(_, codes)| {
                        transform.symbol(codes[0], std::mem::replace(&mut before, codes[0].into()), width)
                    })
                }));
            }
            if scene.varies[attribute.index()] {
                let count = of_channel().map(|(_, codes)| codes.len() - 1).sum();
                streams.push(candidates(&LATER_CODES, count, symbol_bytes, |transform| {
                    let mut neighbor = Neighbor::default();
                    of_channel().flat_map(move |(times, codes)| {
                        let symbols: Vec<u16> = (1..codes.len())
                            .map(|k| {
                                let prediction = neighbor.predict(transform, codes[k - 1], times[k - 1], times[k]);
                                transform.symbol(codes[k], prediction, width)
                            })
                            .collect();
                        neighbor.replace(times, codes);
                        symbols
                    })
                }));
            }
        }
    }
    streams.par_iter().map(|candidates| stream::write(candidates)).collect::<Vec<_>>().concat()
}

/// The same symbols by every transform.
fn candidates<S: Iterator<Item = u16>>(
    transforms: &[Transform],
    count: usize,
    symbol_bytes: usize,
    symbols: impl Fn(Transform) -> S,
) -> Vec<(Transform, Planes)> {
    transforms.iter().map(|&t| (t, Planes::new(symbols(t).map(u64::from), count, symbol_bytes))).collect()
}

/// Number of keypoints less one of every track.
fn counts(tracks: &Tracks<i16>, symbol_bytes: usize) -> Planes {
    let symbols = (0..tracks.len()).map(|i| tracks.track(i).0.len() as u64 - 1);
    Planes::new(symbols, tracks.len(), symbol_bytes)
}

/// Timesteps skipped before every keypoint but the first and the last of a track, which are known.
fn gaps(tracks: &Tracks<i16>, symbol_bytes: usize) -> Planes {
    let inner = || (0..tracks.len()).map(|i| tracks.track(i).0).filter(|times| times.len() > 2);
    let count = inner().map(|times| times.len() - 2).sum();
    let symbols = inner()
        .flat_map(|times| times[..times.len() - 1].windows(2).map(|pair| u64::from(pair[1]) - u64::from(pair[0]) - 1));
    Planes::new(symbols, count, symbol_bytes)
}

/// Steps along the Morton curve from Gaussian to Gaussian, modulo its length.
fn curve_gaps(tracks: &Tracks<i16>, gaussians: &[usize], width: u8) -> Planes {
    let mut before = 0;
    let bits = 3 * u32::from(width);
    let symbols = gaussians.iter().map(|g| {
        let coordinate = |channel| Transform::Plain.symbol(tracks.track(3 * g + channel).1[0], 0, width);
        let key = morton::interleave([coordinate(0), coordinate(1), coordinate(2)]);
        key.wrapping_sub(std::mem::replace(&mut before, key)) & ((1 << bits) - 1)
    });
    Planes::new(symbols, gaussians.len(), bytes_of_bits(bits))
}

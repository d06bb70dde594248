//! Lossy compression: from a scene of floats to a [`CompactScene`], in two passes over the timesteps.
//!
//! The first pass (`statistics`) collects ranges, means over time, the columns that vary, and the first timestep. Bit
//! widths, tolerances and the choice of constant tracks follow from these. The second pass (`reduce`) holds one segment
//! of timesteps at a time and selects the keypoints of moving tracks. Quantizers are then fitted to the keypoints.
//!
//! - `settings`: the settings of compression
//! - `statistics`: the first pass
//! - `gather`: tracks from timesteps
//! - `tolerances`: tolerance of each track, and quantizers
//! - `reduce`: the second pass
//! - `harmonics`: which Gaussians keep which bands of harmonics
//! - `levels`: which Gaussians of a long scene are described together
//! - `lives`: Gaussians that live for a part of the timesteps
//! - `sequence`: which Gaussian of a timestep is which of the next, where a source does not say
//! - `order`: importance of Gaussians, layers, and Morton order
//!
//! This file calls the steps in their order. Entropy coding is the subject of `bitstream`.

mod gather;
mod harmonics;
mod levels;
mod lives;
mod order;
mod reduce;
mod sequence;
mod settings;
mod statistics;
mod tolerances;

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{Attribute, DynamicGaussians, Layout, SceneReader};

use self::order::{by_layer, morton_order};
use self::reduce::Reduced;
use self::statistics::Statistics;
use self::tolerances::{Tolerances, quantizers_for};
use crate::bits::BitMap;
use crate::compact::{CompactScene, MAX_TIMESTEPS, SceneInfo, Tracks};
use crate::error::CompressError;
use crate::quantize::{Quantizers, check_bits};

pub use self::levels::{Contemporaries, contemporaries};
pub use self::sequence::{Followed, FollowedParts};
pub use self::settings::CompressSettings;

/// Compresses a scene in memory: [`compress_reader`] of `scene`, without the order of the Gaussians.
///
/// - `scene`: `T` timesteps of `N` Gaussians, in stored form
/// - `bit_map`, `learned`, `info`, `settings`: as in [`compress_reader`]
/// - returns: the compact scene; its Gaussians are in another order than those of `scene`
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
/// As [`compress_reader`].
pub fn compress(
    scene: &DynamicGaussians,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> Result<CompactScene, CompressError> {
    Ok(compress_ordered(scene, bit_map, learned, info, settings)?.0)
}

/// Compresses a scene in memory: [`compress_reader`] of `scene`.
///
/// - returns: the compact scene, and its order: Gaussian `i` of the compact scene is Gaussian `order[i]` of `scene`
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress_ordered};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let (map, info, settings) = (BitMap::uniform(3, 16, 6), SceneInfo::of(&scene), CompressSettings::default());
/// let (_, mut order) = compress_ordered(&scene, &map, None, info, &settings)?;
/// order.sort_unstable();
/// assert_eq!(order, [0, 1, 2]); // a permutation
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// As [`compress_reader`].
pub fn compress_ordered(
    scene: &DynamicGaussians,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> Result<(CompactScene, Vec<usize>), CompressError> {
    let varies: Vec<bool> = scene.layout().attributes().map(|attribute| scene.varies(attribute)).collect();
    compress_columns(&mut &*scene, &varies, bit_map, learned, info, settings)
}

/// Compresses a scene that is read a timestep at a time.
///
/// Quaternions are normalised and made sign-continuous over time. Keypoints are selected for all components of an
/// attribute together and segment by segment ([`CompressSettings::joint`]), or for every track alone (paper 4.1.3).
/// Quantizers of positions cover all positions. Every other component and width gets the learned quantizer, or a fitted
/// quantizer ([`Quantizer::fit`](crate::Quantizer::fit)) if the learned one has more than twice the squared error of
/// the fitted one on the keypoints.
///
/// With [`CompressSettings::joint`], which is the default, the scene is read twice, and memory holds one segment of
/// timesteps and the keypoints of moving tracks. Otherwise the scene is read once for the statistics and once for every
/// group of Gaussians whose whole tracks fit into memory together.
///
/// - `reader`: `T` timesteps of `N` Gaussians, in stored form
/// - `bit_map`: widths of the Gaussians, in the order of the scene; `settings` may change them
/// - `learned`: quantizers from training, if any; those of positions are not used
/// - `info`: counts of the scene, and provenance
/// - returns: the compact scene, and its order: Gaussian `i` of the compact scene is Gaussian `order[i]` of the scene.
///   The compact scene has the Gaussians in layers, and in each layer along a Morton curve of the first positions
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress, compress_reader};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let (map, info, settings) = (BitMap::uniform(3, 16, 6), SceneInfo::of(&scene), CompressSettings::default());
/// // Any `SceneReader`, such as a `SceneFile`; a scene in memory is one, too.
/// let (compact, order) = compress_reader(&mut &scene, &map, None, info.clone(), &settings)?;
/// assert_eq!((&compact, order.len()), (&compress(&scene, &map, None, info, &settings)?, 3));
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// - [`CompressError::Read`] if the reader fails, [`CompressError::Layout`] if a timestep has other columns
/// - [`CompressError::Count`] if the scene, `bit_map` and `info` disagree in a count, or the number of Gaussians
///   changes over time ([`FollowedParts`] is for such scenes)
/// - [`CompressError::Value`] if the number of timesteps is not within 1 to 65536, a width not within 1 to 16, or a
///   setting out of range
/// - [`CompressError::Gaussian`] if a value is not finite
/// - [`CompressError::Quantizer`] if the range of the values overflows an `f32`
pub fn compress_reader<R: SceneReader>(
    reader: &mut R,
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> Result<(CompactScene, Vec<usize>), CompressError> {
    let varies: Vec<bool> = reader.layout().columns().iter().map(|column| column.varies).collect();
    compress_columns(reader, &varies, bit_map, learned, info, settings)
}

/// - `varies`: by [`Attribute::index`]: whether a column is known to vary; the first pass finds whether other columns
///   do
fn compress_columns<R: SceneReader>(
    reader: &mut R,
    varies: &[bool],
    bit_map: &BitMap,
    learned: Option<&Quantizers>,
    info: SceneInfo,
    settings: &CompressSettings,
) -> Result<(CompactScene, Vec<usize>), CompressError> {
    settings.check()?;
    let layout = Arc::clone(reader.layout());
    let num_timesteps = reader.num_timesteps();
    let expected = reader.max_gaussians();
    check_arguments(&layout, [expected, num_timesteps], bit_map, &info)?;
    let counts = (0..num_timesteps).map(|timestep| reader.num_gaussians_at(timestep));
    if let Some((timestep, found)) = counts.enumerate().find(|(_, found)| *found != expected) {
        return Err(CompressError::Count { what: format!("Gaussians at timestep {timestep}"), found, expected });
    }
    let statistics = Statistics::read(reader, varies)?;
    let (first, varies) = (&statistics.first, |a: Attribute| statistics.columns[a.index()].varies);
    let measured = bit_map;
    let mut bit_map = settings.adjusted(measured, first, statistics.bounds);
    harmonics::set_widths(&mut bit_map, measured, &statistics, settings);
    let bit_map = &bit_map;
    let position_step = settings.position_step(first);
    let segment_length = settings.segment_length_of(first.num_gaussians(), num_timesteps);

    let tolerances = layout.columns().iter().filter(|column| varies(column.attribute)).map(|column| {
        let widths = &bit_map.widths[column.attribute.index()];
        let tolerances = Tolerances::new(&statistics, column, widths, learned, position_step, settings);
        tolerances.map(|tolerances| (column.attribute, tolerances))
    });
    let tolerances = tolerances.collect::<Result<Vec<_>, CompressError>>()?;
    let columns: Vec<(Attribute, &Tolerances<'_>)> = tolerances.iter().map(|(a, of)| (*a, of)).collect();
    let varying = if settings.joint && settings.keypoints {
        reduce::jointly(reader, &statistics, &columns, segment_length as usize, settings)?
    } else {
        reduce::apart(reader, &columns, settings)?
    };
    let mut varying = varying.into_iter();
    let mut reduced: Vec<Reduced> = Vec::new();
    for attribute in layout.attributes() {
        let next = if varies(attribute) { varying.next() } else { None };
        reduced.push(next.unwrap_or_else(|| reduce::constant(&statistics, attribute, settings)));
    }

    let mut quantizers = Quantizers::none(&layout);
    for (column, reduced) in layout.columns().iter().zip(&reduced) {
        let values = |gaussian: usize, channel: usize, values: &mut Vec<f32>| {
            reduced.append(gaussian, channel, None, values);
        };
        let a = column.attribute.index();
        let widths = &bit_map.widths[a];
        quantizers.attributes[a] = quantizers_for(column, values, widths, learned, position_step, settings)?;
    }
    let means = Attribute::Mean.index();
    let order = morton_order(&reduced[means], &bit_map.widths[means], &quantizers);
    let (order, layers) = by_layer(order, first, settings);
    let bit_map = bit_map.select(&order);
    let columns: Vec<(Attribute, Reduced)> = layout.attributes().zip(reduced).collect();
    let tracks = columns.into_par_iter().map(|(attribute, reduced)| {
        let table = quantizers.by_width(attribute);
        let (mut codes, mut times, mut values, mut of_track) = (Tracks::default(), vec![], vec![], vec![]);
        for (&gaussian, &width) in order.iter().zip(&bit_map.widths[attribute.index()]) {
            if width == 0 {
                (0..attribute.components()).for_each(|_| codes.push(&[0], &[0]));
            }
            for (channel, quantizer) in table[usize::from(width)].iter().enumerate() {
                times.clear();
                values.clear();
                of_track.clear();
                reduced.append(gaussian, channel, Some(&mut times), &mut values);
                of_track.extend(values.iter().map(|&x| quantizer.quantize(x) as i16));
                codes.push(&times, &of_track);
            }
        }
        codes
    });
    let tracks = tracks.collect();
    let varies = layout.attributes().map(varies).collect();
    let (start, lives) = (0, None);
    let scene =
        CompactScene { layout, info, start, lives, bit_map, quantizers, varies, layers, segment_length, tracks };
    Ok((scene, order))
}

fn check_arguments(
    layout: &Layout,
    [n, t]: [usize; 2],
    bit_map: &BitMap,
    info: &SceneInfo,
) -> Result<(), CompressError> {
    if !(1..=MAX_TIMESTEPS as usize).contains(&t) {
        return Err(CompressError::Value { what: "number of timesteps", found: t as f64, expected: "1 to 65536" });
    }
    let counts = |what: String, found: usize, expected: usize| {
        if found == expected { Ok(()) } else { Err(CompressError::Count { what, found, expected }) }
    };
    counts("Gaussians in info".into(), info.num_gaussians as usize, n)?;
    counts("timesteps in info".into(), info.num_timesteps as usize, t)?;
    counts("columns in the bit map".into(), bit_map.widths.len(), layout.columns().len())?;
    for (column, widths) in layout.columns().iter().zip(&bit_map.widths) {
        counts(format!("bit widths of {}", column.name), widths.len(), n)?;
        widths.iter().try_for_each(|&width| check_bits(width))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use tcgs_core::Gaussians;

    use super::*;

    /// Some stand still, some shake by about the tolerance, some move.
    fn scene() -> DynamicGaussians {
        let mut scene = DynamicGaussians::default();
        for timestep in 0..40 {
            let mut now = Gaussians::zeros(90);
            for attribute in [Attribute::Mean, Attribute::Quat, Attribute::Color] {
                for (i, x) in now.values_mut(attribute).iter_mut().enumerate() {
                    let gaussian = i / attribute.components();
                    let wave = (0.7 * timestep as f32 + i as f32).sin();
                    *x = 0.3 * (i as f32).cos() + [0.0, 0.002, 0.3][gaussian % 3] * wave * (gaussian as f32 / 45.0);
                }
            }
            scene.push(now);
        }
        scene
    }

    #[test]
    fn sums_and_exact_distances_find_the_same_to_be_constant() {
        let (scene, settings, map) = (scene(), CompressSettings::default(), BitMap::uniform(90, 16, 6));
        let attributes = [Attribute::Mean, Attribute::Quat, Attribute::Color];
        let reduced = |statistics: Statistics| -> Vec<(Vec<u16>, Vec<f32>)> {
            let tolerances = attributes.map(|attribute| {
                let (column, widths) = (scene.layout().column(attribute), &map.widths[attribute.index()]);
                Tolerances::new(&statistics, column, widths, None, None, &settings).unwrap()
            });
            let columns: Vec<_> = attributes.into_iter().zip(&tolerances).collect();
            let reduced = reduce::jointly(&mut &scene, &statistics, &columns, 15, &settings).unwrap();
            let mut tracks = Vec::new();
            for (attribute, reduced) in attributes.into_iter().zip(&reduced) {
                for track in 0..90 * attribute.components() {
                    let (mut times, mut values) = (Vec::new(), Vec::new());
                    let (gaussian, channel) = (track / attribute.components(), track % attribute.components());
                    reduced.append(gaussian, channel, Some(&mut times), &mut values);
                    assert_eq!(reduced.first(gaussian, channel), values[0]);
                    tracks.push((times, values));
                }
            }
            tracks
        };
        let statistics = || Statistics::read(&mut &scene, &[true, true, false, false, true]).unwrap();
        let fast = reduced(statistics());
        assert_eq!(fast, reduced(statistics().all_uncertain()));
        let constant = fast.iter().filter(|(times, _)| times.len() == 1).count();
        assert!(constant > 300 && constant < 600, "{constant} of {}", fast.len());
    }
}

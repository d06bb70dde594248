//! Encoding of a compact scene as a `.tcgs` file.

use std::io::{Cursor, Seek, Write};

use rayon::prelude::*;
use tcgs_core::Attribute;

use super::FORMAT_VERSION;
use super::coder::Encoder;
use super::container::{self, Part};
use super::fit;
use super::head::{Head, MAX_SEGMENTS, write_info, write_plan};
use super::keypoints::{KeypointModels, Motion, Scope, UnitTracks};
use super::section::{self, APPLICATION, INFO, MAPS, PLAN};
use super::shared::{CurveModels, FirstModels, MapModels, Plan, Shared};
use crate::compact::{CompactScene, Tracks};
use crate::error::CompressError;
use crate::limits::{Budget, DecodeLimits};

/// Encodes a scene as a `.tcgs` file (`docs/FORMAT.md`). Equal scenes give equal bytes.
///
/// - returns: all bytes of the file; [`encode_to`] writes them to a file without holding all of them in memory
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let bit_map = BitMap::uniform(3, 16, 6);
/// let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
/// assert_eq!(decode(&encode(&compact)?, &DecodeLimits::default())?, compact);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`CompressError::Scene`] if the scene breaks a rule of the format, such as a code outside its width
/// - [`CompressError::Unsupported`] if the scene has columns beyond [`Attribute::BASE`]
/// - [`CompressError::Count`] if the scene takes more segments (65,535), more sections (2^20) or a longer section
///   (4 GiB) than the format holds
pub fn encode(scene: &CompactScene) -> Result<Vec<u8>, CompressError> {
    encode_with(scene, &[])
}

/// [`encode`] with application data, which decoders skip if they do not know the name.
///
/// - `data`: name and content of each piece of application data, such as cameras ([`write_views`](crate::write_views)).
///   The file holds them near its start
///
/// ```
/// # use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode_with};
/// # use tcgs_core::{DynamicGaussians, Gaussians};
/// # let mut scene = DynamicGaussians::default();
/// # scene.push(Gaussians::zeros(3));
/// # let bit_map = BitMap::uniform(3, 16, 6);
/// # let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
/// let (file, limits) = (encode_with(&compact, &[("notes", b"a red ball")])?, DecodeLimits::default());
/// assert_eq!(tcgs_codec::application_data(&file, &limits)?, [("notes".to_owned(), &b"a red ball"[..])]);
/// assert_eq!(decode(&file, &limits)?, compact);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`encode`]; also [`CompressError::Count`] if a name is longer than 65535 bytes, or a name and its content
/// together take 4 GiB or more.
pub fn encode_with(scene: &CompactScene, data: &[(&str, &[u8])]) -> Result<Vec<u8>, CompressError> {
    let mut file = Cursor::new(Vec::new());
    encode_to(scene, data, &mut file)?;
    Ok(file.into_inner())
}

/// [`encode_with`] into a file, segment by segment: memory holds the bytes of some segments at a time.
///
/// - `data`: as in [`encode_with`]
/// - `file`: written from its current position, and left at the end of the written bytes; after an error its content is
///   useless
///
/// ```
/// # use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress, encode_to, encode_with};
/// # use tcgs_core::{DynamicGaussians, Gaussians};
/// # let mut scene = DynamicGaussians::default();
/// # scene.push(Gaussians::zeros(3));
/// # let bit_map = BitMap::uniform(3, 16, 6);
/// # let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
/// let mut file = std::io::Cursor::new(Vec::new()); // or a `std::fs::File`
/// encode_to(&compact, &[], &mut file)?;
/// assert_eq!(file.into_inner(), encode_with(&compact, &[])?);
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// As [`encode_with`]; also [`CompressError::Io`] if the file cannot be written.
pub fn encode_to<W: Write + Seek>(
    scene: &CompactScene,
    data: &[(&str, &[u8])],
    file: &mut W,
) -> Result<(), CompressError> {
    if let Some(column) = scene.layout.columns().get(Attribute::BASE.len()) {
        return Err(CompressError::Unsupported { version: FORMAT_VERSION, found: column.name.clone() });
    }
    scene.check()?;
    let mut head = Head {
        info: scene.info.clone(),
        plan: Plan {
            varies: Attribute::BASE.map(|a| scene.varies[a.index()]),
            joint: Attribute::BASE.map(|a| share_times(&scene.tracks[a.index()], a.components())),
            quantizers: scene.quantizers.clone(),
            predictors: Default::default(),
        },
        layers: scene.layers.clone(),
        segment_length: scene.segment_length,
        bounds: bounds(scene),
    };
    if !head.bounds.as_flattened().iter().all(|x| x.is_finite()) {
        let (section, field) = (Attribute::Mean.name(), "codes");
        return Err(CompressError::Scene { section, field, problem: "a code that stands for no finite number" });
    }
    if head.num_segments() > MAX_SEGMENTS {
        let what = "segments".into();
        return Err(CompressError::Count { what, found: head.num_segments(), expected: MAX_SEGMENTS });
    }
    let mut shared = shared_of(scene, &head);
    let predictors = |a: Attribute| if a == Attribute::Mean { vec![] } else { fit::predictors(a, &head.plan, &shared) };
    let predictors: Vec<_> = Attribute::BASE.into_par_iter().map(predictors).collect();
    head.plan.predictors = predictors.try_into().expect("five attributes");

    let mut parts = vec![Part::shared(INFO, 0, write_info(&head)), Part::shared(PLAN, 0, write_plan(&head.plan))];
    for (name, bytes) in data {
        let expected = usize::from(u16::MAX);
        let too_long = |_| CompressError::Count { what: "bytes of a name".into(), found: name.len(), expected };
        let length = u16::try_from(name.len()).map_err(too_long)?;
        parts.push(Part::shared(APPLICATION, 0, [&length.to_le_bytes(), name.as_bytes(), bytes].concat()));
    }
    parts.extend(shared_sections(&head, &mut shared));
    let varying: Vec<Attribute> = Attribute::BASE.into_iter().filter(|a| scene.varies[a.index()]).collect();
    let (num_segments, num_layers) = (head.num_segments(), head.layers.len());
    let mut writer = container::Writer::new(file, parts.len() + num_segments * num_layers * varying.len())?;
    parts.iter().try_for_each(|part| writer.section(part))?;
    // Enough segments together that no thread waits for long.
    let at_once = (JOBS_PER_THREAD * rayon::current_num_threads()).div_ceil(varying.len().max(1));
    for start in (0..num_segments).step_by(at_once) {
        let segments = start..(start + at_once).min(num_segments);
        let jobs: Vec<_> = segments.flat_map(|segment| varying.iter().map(move |&a| (segment, a))).collect();
        let by_job: Vec<Vec<Part>> =
            jobs.into_par_iter().map(|(segment, a)| segment_sections(scene, &head, &shared, segment, a)).collect();
        for of_segment in by_job.chunks(varying.len().max(1)) {
            for layer in 0..num_layers {
                of_segment.iter().try_for_each(|layers| writer.section(&layers[layer]))?;
            }
        }
    }
    writer.finish()
}

/// Segments and attributes that are encoded together, for each thread.
const JOBS_PER_THREAD: usize = 8;

/// Whether the components of each Gaussian have keypoints at the same times.
fn share_times(tracks: &Tracks<i16>, components: usize) -> bool {
    (0..tracks.len()).all(|i| i % components == 0 || tracks.track(i).0 == tracks.track(i - 1).0)
}

/// Bounding box of all means at all timesteps. Keypoints suffice: interpolated means lie between the means at
/// keypoints.
fn bounds(scene: &CompactScene) -> [[f32; 3]; 2] {
    let mut bounds = [[f32::MAX; 3], [f32::MIN; 3]];
    let mean = Attribute::Mean.index();
    let table = scene.quantizers.by_width(Attribute::Mean);
    for (g, &width) in scene.bit_map.widths[mean].iter().enumerate() {
        for channel in 0..3 {
            for &code in scene.tracks[mean].track(3 * g + channel).1 {
                let x = table[usize::from(width)][channel].dequantize(code.into());
                bounds[0][channel] = bounds[0][channel].min(x);
                bounds[1][channel] = bounds[1][channel].max(x);
            }
        }
    }
    if scene.num_gaussians() == 0 { [[0.0; 3]; 2] } else { bounds }
}

/// The shared layers of a scene in the form in which a decoder holds them.
fn shared_of(scene: &CompactScene, head: &Head) -> Shared {
    let mut shared = Shared { bit_map: scene.bit_map.clone(), ..Shared::default() };
    for attribute in Attribute::BASE {
        let a = attribute.index();
        let tracks = &scene.tracks[a];
        shared.first_codes[a] = (0..tracks.len()).map(|i| tracks.track(i).1[0]).collect();
        if scene.varies[a] {
            shared.moves[a] = (0..tracks.len()).map(|i| tracks.track(i).0.len() > 1).collect();
        }
    }
    for layer in 0..head.layers.len() {
        let layer = head.layer(layer);
        shared.count_units(&head.plan, &layer);
        let points: Vec<_> = shared.points(layer).collect();
        shared.neighbors.extend(points.into_iter());
    }
    shared
}

fn shared_sections(head: &Head, shared: &mut Shared) -> Vec<Part> {
    let mut maps = MapModels::new();
    let mut curve = CurveModels::new();
    let mut others: Vec<FirstModels> = Attribute::BASE[1..].iter().map(|&a| FirstModels::new(a)).collect();
    let mut parts = Vec::new();
    for index in 0..head.layers.len() {
        let layer = head.layer(index);
        let mut encoder = Encoder::default();
        maps.code(&mut encoder, &head.plan, layer.clone(), shared);
        parts.push(Part::shared(MAPS, index, encoder.finish()));
        let mut encoder = Encoder::default();
        curve.code(&mut encoder, &head.plan, layer.clone(), shared);
        parts.push(Part::shared(section::of_attribute(Attribute::Mean), index, encoder.finish()));
        let Shared { bit_map, neighbors, first_codes, .. } = shared;
        for (models, &attribute) in others.iter_mut().zip(&Attribute::BASE[1..]) {
            let a = attribute.index();
            let mut encoder = Encoder::default();
            let (widths, codes) = (&bit_map.widths[a], &mut first_codes[a]);
            models.code(&mut encoder, &head.plan, layer.clone(), neighbors, widths, codes);
            parts.push(Part::shared(section::of_attribute(attribute), index, encoder.finish()));
        }
    }
    parts
}

/// The keypoints of an attribute in a segment, layer by layer.
fn segment_sections(
    scene: &CompactScene,
    head: &Head,
    shared: &Shared,
    segment: usize,
    attribute: Attribute,
) -> Vec<Part> {
    let a = attribute.index();
    let mut models = KeypointModels::new(&head.plan, attribute);
    let mut units = UnitTracks::new(head.plan.channels(attribute));
    let unlimited = Budget::new(&DecodeLimits::none(), u64::MAX);
    let mut parts = Vec::new();
    for layer in 0..head.layers.len() {
        let place = Scope {
            plan: &head.plan,
            shared,
            attribute,
            layer: head.layer(layer),
            span: head.span(segment),
            num_timesteps: head.num_timesteps(),
            budget: &unlimited,
        };
        let tried = Motion::ALL.map(|motion| {
            let (mut models, mut units, mut encoder) = (models.clone(), units.clone(), Encoder::default());
            let coded = models.code(&mut encoder, &place, motion, Some(&scene.tracks[a]), &mut units);
            coded.expect("a scene that was checked");
            (motion, encoder.finish(), models, units)
        });
        let [first, others @ ..] = tried;
        let (motion, bytes, best_models, best_units) =
            others.into_iter().fold(first, |best, next| if next.1.len() < best.1.len() { next } else { best });
        (models, units) = (best_models, best_units);
        let bytes = [&[motion as u8][..], &bytes].concat();
        parts.push(Part { tag: section::of_attribute(attribute), segment: segment as u16, layer: layer as u16, bytes });
    }
    parts
}

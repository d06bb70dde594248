//! Encoding of compact scenes as `.tcgs` files of both versions.

use std::io::{Cursor, Seek, Write};
use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::Attribute;

use super::coder::Encoder;
use super::container::version_1::{Part, Writer as Writer1};
use super::container::version_2::{Encoded, Writer as Writer2};
use super::fit;
use super::head::{Head, Info, MAX_SEGMENTS, write_info_1};
use super::keypoints::{KeypointModels, Motion, Scope, UnitTracks};
use super::plan::{Plan, write_plan_1};
use super::section::{self, APPLICATION, INFO, MAPS, PLAN, Tag};
use super::shared::{CurveModels, FirstModels, MapModels, Shared};
use crate::compact::{CompactScene, SceneInfo, Tracks};
use crate::error::CompressError;
use crate::limits::{Budget, DecodeLimits};

/// Encodes a scene as a `.tcgs` file of version 1 (`docs/FORMAT.md`). Equal scenes give equal bytes.
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
/// - [`CompressError::Unsupported`] if the scene has columns beyond [`Attribute::BASE`] or lives
/// - [`CompressError::Count`] if the scene takes more segments (65,535), more sections (2^20) or a longer section
///   (4 GiB) than the format holds
pub fn encode(scene: &CompactScene) -> Result<Vec<u8>, CompressError> {
    encode_with(scene, &[])
}

/// [`encode`] with application data; decoders skip those whose names they do not know.
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

/// [`encode_with`] into a file, segment by segment: memory holds the bytes of a few segments at a time.
///
/// - `data`: as in [`encode_with`]
/// - `file`: written from its current position, and left at the end of the written bytes. After an error its content is
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
    let unsupported = |found: &str| CompressError::Unsupported { version: 1, found: found.into() };
    if let Some(column) = scene.layout.further() {
        return Err(unsupported(&column.name));
    }
    if scene.lives.is_some() || scene.start > 0 {
        return Err(unsupported("Gaussians that come and go"));
    }
    if scene.layout.is_antialiased() {
        return Err(unsupported("antialiasing"));
    }
    let (info, bounds) = (scene.info.clone(), bounds(scene)?);
    let Prepared { head, mut shared } = Prepared::new(scene, Info { scene: info, bounds, errors: Vec::new() }, &[])?;
    let mut parts =
        vec![Part::shared(INFO, 0, write_info_1(&head.info, &head)), Part::shared(PLAN, 0, write_plan_1(&head.plan))];
    parts.extend(application(data)?.into_iter().map(|(tag, bytes)| Part::shared(tag, 0, bytes)));
    let tags: Vec<Tag> =
        std::iter::once(MAPS).chain(head.plan.layout.attributes().map(section::of_attribute)).collect();
    for (i, bytes) in shared_sections(&head, &mut shared).into_iter().enumerate() {
        parts.push(Part::shared(tags[i % tags.len()], i / tags.len(), bytes));
    }
    let varying: Vec<Attribute> = head.plan.varying().collect();
    let num_sections = head.num_segments() * head.layers.len() * varying.len();
    let mut writer = Writer1::new(file, parts.len() + num_sections)?;
    parts.iter().try_for_each(|part| writer.section(part))?;
    segments(scene, &head, &shared, |segment, sections| {
        let of_layers = sections.into_iter().enumerate();
        of_layers.into_iter().try_for_each(|(i, bytes)| {
            let (layer, tag) = (i / varying.len(), section::of_attribute(varying[i % varying.len()]));
            writer.section(&Part { tag, segment: segment as u16, layer: layer as u16, bytes })
        })
    })?;
    writer.finish()
}

/// Encodes cohorts as a `.tcgs` file of version 2 (`docs/FORMAT.md`): [`FileWriter`] in memory. Equal scenes give equal
/// bytes.
///
/// - `info`: of the whole scene; its counts are those of all cohorts together
/// - `cohorts`: by ascending [`CompactScene::start`]
/// - `data`: as in [`encode_with`]
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, decode_cohorts, encode_cohorts};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let frame = |n| {
///     let mut scene = DynamicGaussians::default();
///     scene.push(Gaussians::zeros(n));
///     compress(&scene, &BitMap::uniform(n, 16, 6), None, SceneInfo::of(&scene), &CompressSettings::default())
/// };
/// // A sequence of two frames with other numbers of Gaussians.
/// let mut cohorts = vec![frame(3)?, frame(5)?];
/// cohorts[1].start = 1;
/// let info = SceneInfo { num_gaussians: 8, num_timesteps: 2, ..cohorts[0].info.clone() };
/// let file = encode_cohorts(&info, &cohorts, &[])?;
/// assert_eq!(decode_cohorts(&file, &DecodeLimits::default())?, (info, cohorts));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`FileWriter::add`].
///
/// # Panics
/// If the cohorts do not ascend.
pub fn encode_cohorts(
    info: &SceneInfo,
    cohorts: &[CompactScene],
    data: &[(&str, &[u8])],
) -> Result<Vec<u8>, CompressError> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = FileWriter::new(&mut file, info, data, cohorts.len())?;
    cohorts.iter().try_for_each(|cohort| writer.add(cohort))?;
    writer.finish()?;
    Ok(file.into_inner())
}

/// Writes a `.tcgs` file of version 2 cohort by cohort, so that memory need not hold a whole long scene.
///
/// After an error, or without [`Self::finish`], the content of the file is useless.
pub struct FileWriter<'a, W> {
    writer: Writer2<'a, W>,
    num_gaussians: u64,
}

impl<'a, W: Write + Seek> FileWriter<'a, W> {
    /// - `file`: written from its current position
    /// - `info`: of the whole scene; its counts are those of all cohorts together
    /// - `data`: name and content of each piece of application data
    /// - `num_cohorts`: number of cohorts to be added
    ///
    /// # Errors
    /// - [`CompressError::Scene`] if a field of `info` is not legal
    /// - [`CompressError::Count`] if there are more than 2^20 cohorts or a name is longer than 65535 bytes
    /// - [`CompressError::Io`] if the file cannot be written
    pub fn new(
        file: &'a mut W,
        info: &SceneInfo,
        data: &[(&str, &[u8])],
        num_cohorts: usize,
    ) -> Result<Self, CompressError> {
        Self::declaring(file, info, &[], data, num_cohorts)
    }

    /// A file that declares the largest errors of decoded values against the compressed ones.
    ///
    /// - `errors`: by name of the attribute, from [`AttributeErrors::declared`](crate::AttributeErrors::declared)
    /// - other arguments as in [`Self::new`]
    ///
    /// # Errors
    /// As [`Self::new`]; also [`CompressError::Value`] if an error is negative or not finite, and
    /// [`CompressError::Count`] if there are more than 255 errors.
    pub fn declaring(
        file: &'a mut W,
        info: &SceneInfo,
        errors: &[(String, f32)],
        data: &[(&str, &[u8])],
        num_cohorts: usize,
    ) -> Result<Self, CompressError> {
        info.check(2)?;
        check_errors(errors)?;
        let info = Info { scene: info.clone(), bounds: [[0.0; 3]; 2], errors: errors.to_vec() };
        Ok(Self { writer: Writer2::new(file, info, &application(data)?, num_cohorts)?, num_gaussians: 0 })
    }

    /// Replaces the declared errors of the same attributes, such as by errors measured cohort by cohort during writing.
    /// [`Self::finish`] writes them.
    ///
    /// # Errors
    /// As [`Self::declaring`]; also [`CompressError::Count`] if the attributes or their order differ from those given
    /// there: the space for their names is fixed by then.
    pub fn declare(&mut self, errors: &[(String, f32)]) -> Result<(), CompressError> {
        check_errors(errors)?;
        let declared = &mut self.writer.info_mut().errors;
        let agree = declared.iter().zip(errors).take_while(|(before, now)| before.0 == now.0).count();
        if agree < declared.len().max(errors.len()) {
            let what = "attributes with the names declared first".into();
            return Err(CompressError::Count { what, found: agree, expected: declared.len() });
        }
        declared.clone_from_slice(errors);
        Ok(())
    }

    /// Adds the next cohort.
    ///
    /// # Errors
    /// - [`CompressError::Scene`] if the cohort breaks a rule of the format, such as a code outside its width, or ends
    ///   after the scene
    /// - [`CompressError::Count`] if the cohort has no Gaussians, more segments (65,535), or a longer section (4 GiB)
    ///   than the format holds
    /// - [`CompressError::Io`] if the file cannot be written
    ///
    /// # Panics
    /// If the cohort begins before the one added last, or there are more cohorts than were announced to [`Self::new`].
    pub fn add(&mut self, cohort: &CompactScene) -> Result<(), CompressError> {
        let end = u64::from(cohort.start) + u64::from(cohort.info.num_timesteps);
        if end > u64::from(self.writer.info().scene.num_timesteps) {
            let (section, field) = ("cohorts", "num_timesteps");
            return Err(CompressError::Scene { section, field, problem: "beyond the end of the scene" });
        }
        if cohort.num_gaussians() == 0 {
            let what = "Gaussians of a cohort".into();
            return Err(CompressError::Count { what, found: 0, expected: 1 });
        }
        self.writer.extend_bounds(bounds(cohort)?);
        self.num_gaussians += cohort.num_gaussians() as u64;
        let plans: Vec<_> = self.writer.plans().map(Arc::clone).collect();
        let Prepared { head, mut shared } = Prepared::new(cohort, self.writer.info().clone(), &plans)?;
        let sections = shared_sections(&head, &mut shared);
        let mut of_segments = Vec::new();
        segments(cohort, &head, &shared, |_, sections| {
            of_segments.push(sections);
            Ok(())
        })?;
        self.writer.add(Encoded { head, shared: sections, segments: of_segments })
    }

    /// Completes the file and leaves the position at its end.
    ///
    /// # Errors
    /// - [`CompressError::Count`] if the cohorts together have another number of Gaussians than the scene
    /// - [`CompressError::Io`] if the file cannot be written
    ///
    /// # Panics
    /// If there are fewer cohorts than were announced to [`Self::new`].
    pub fn finish(self) -> Result<(), CompressError> {
        let expected = self.writer.info().scene.num_gaussians as usize;
        if self.num_gaussians != expected as u64 {
            let what = "Gaussians of all cohorts".into();
            return Err(CompressError::Count { what, found: self.num_gaussians as usize, expected });
        }
        self.writer.finish()
    }
}

/// Checks the errors to be declared.
fn check_errors(errors: &[(String, f32)]) -> Result<(), CompressError> {
    let count = |what: &str, found: usize, expected: usize| {
        let what = what.into();
        if found > expected { Err(CompressError::Count { what, found, expected }) } else { Ok(()) }
    };
    count("declared errors", errors.len(), u8::MAX.into())?;
    errors.iter().try_for_each(|(name, _)| count("bytes of a name", name.len(), u16::MAX.into()))?;
    let wrong = errors.iter().find(|(_, error)| !(error.is_finite() && *error >= 0.0));
    let expected = "a finite number, 0 or more";
    wrong.map_or(Ok(()), |(_, error)| {
        Err(CompressError::Value { what: "declared error", found: f64::from(*error), expected })
    })
}

/// Encodes sections of application data.
fn application(data: &[(&str, &[u8])]) -> Result<Vec<(Tag, Vec<u8>)>, CompressError> {
    let section = |&(name, bytes): &(&str, &[u8])| {
        let expected = usize::from(u16::MAX);
        let too_long = |_| CompressError::Count { what: "bytes of a name".into(), found: name.len(), expected };
        let length = u16::try_from(name.len()).map_err(too_long)?;
        Ok((APPLICATION, [&length.to_le_bytes(), name.as_bytes(), bytes].concat()))
    };
    data.iter().map(section).collect()
}

/// Least number of Gaussians of a cohort for its own predictors. A smaller cohort uses those of an earlier cohort if
/// possible: its own would take more bytes than they save.
const MIN_FITTED: usize = 2000;

/// A cohort that is ready for entropy coding.
struct Prepared {
    head: Head,
    shared: Shared,
}

impl Prepared {
    /// - `scene`: already checked by [`bounds`]
    /// - `plans`: those of earlier cohorts
    fn new(scene: &CompactScene, info: Info, plans: &[Arc<Plan>]) -> Result<Self, CompressError> {
        let layout = &scene.layout;
        let mut plan = Plan::new(Arc::clone(layout));
        plan.quantizers = scene.quantizers.clone();
        plan.varies = scene.varies.clone();
        let of = |attribute: Attribute| (&scene.tracks[attribute.index()], attribute.components());
        plan.joint = layout.attributes().map(of).map(|(tracks, count)| share_times(tracks, count)).collect();
        plan.sparse = scene.bit_map.widths.iter().map(|widths| widths.contains(&0)).collect();
        let mut head = Head {
            index: 0,
            info: Arc::new(info),
            plan: Arc::new(plan),
            start: scene.start as usize,
            num_timesteps: scene.num_timesteps(),
            num_gaussians: scene.num_gaussians(),
            has_lives: scene.lives.is_some(),
            layers: scene.layers.clone(),
            segment_length: scene.segment_length,
        };
        if head.num_segments() > MAX_SEGMENTS {
            let what = "segments".into();
            return Err(CompressError::Count { what, found: head.num_segments(), expected: MAX_SEGMENTS });
        }
        let shared = shared_of(scene, &head);
        let without_predictors = |plan: &Plan| Plan { predictors: head.plan.predictors.clone(), ..plan.clone() };
        let known = plans.iter().find(|plan| without_predictors(plan) == *head.plan);
        head.plan = match known.filter(|_| head.num_gaussians < MIN_FITTED) {
            Some(plan) => Arc::clone(plan),
            None => {
                let predictors = |a: Attribute| {
                    if a == Attribute::Mean { Vec::new() } else { fit::predictors(a, &head.plan, &shared) }
                };
                let attributes: Vec<Attribute> = layout.attributes().collect();
                let predictors = attributes.into_par_iter().map(predictors).collect();
                Arc::new(Plan { predictors, ..(*head.plan).clone() })
            }
        };
        Ok(Self { head, shared })
    }
}

/// Jobs for each thread that are encoded together; a job is one attribute of one segment.
const JOBS_PER_THREAD: usize = 8;

/// Encodes the segments of a cohort, in their order.
///
/// - `take`: receives the sections of each segment, layer by layer; not called if no attribute varies
fn segments(
    scene: &CompactScene,
    head: &Head,
    shared: &Shared,
    mut take: impl FnMut(usize, Vec<Vec<u8>>) -> Result<(), CompressError>,
) -> Result<(), CompressError> {
    let varying: Vec<Attribute> = head.plan.varying().collect();
    let num_segments = if varying.is_empty() { 0 } else { head.num_segments() };
    // Encodes enough segments at once to keep all threads busy.
    let at_once = (JOBS_PER_THREAD * rayon::current_num_threads()).div_ceil(varying.len().max(1));
    for start in (0..num_segments).step_by(at_once) {
        let segments = start..(start + at_once).min(num_segments);
        let jobs: Vec<_> = segments.clone().flat_map(|segment| varying.iter().map(move |&a| (segment, a))).collect();
        let by_job: Vec<Vec<Vec<u8>>> =
            jobs.into_par_iter().map(|(segment, a)| segment_sections(scene, head, shared, segment, a)).collect();
        let mut by_job = by_job.into_iter();
        for segment in segments {
            let mut of_attributes: Vec<_> = by_job.by_ref().take(varying.len()).map(Vec::into_iter).collect();
            let mut sections = Vec::new();
            for _ in 0..head.layers.len() {
                sections.extend(of_attributes.iter_mut().map(|layers| layers.next().expect("a section a layer")));
            }
            take(segment, sections)?;
        }
    }
    Ok(())
}

/// Whether the components of each Gaussian have keypoints at the same times.
fn share_times(tracks: &Tracks<i16>, components: usize) -> bool {
    (0..tracks.len()).all(|i| i % components == 0 || tracks.track(i).0 == tracks.track(i - 1).0)
}

/// Bounding box of all means at all timesteps. Keypoints suffice: interpolated means lie between the means at
/// keypoints.
///
/// # Errors
/// If the scene breaks a rule of the format, or a bound is not finite.
fn bounds(scene: &CompactScene) -> Result<[[f32; 3]; 2], CompressError> {
    scene.check()?;
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
    let bounds = if scene.num_gaussians() == 0 { [[0.0; 3]; 2] } else { bounds };
    if !bounds.as_flattened().iter().all(|x| x.is_finite()) {
        let (section, field) = (Attribute::Mean.name(), "codes");
        return Err(CompressError::Scene { section, field, problem: "a code that stands for no finite number" });
    }
    Ok(bounds)
}

/// The shared layers of a cohort in a decoder's representation.
fn shared_of(scene: &CompactScene, head: &Head) -> Shared {
    let empty = Shared::new(&head.plan, head.has_lives);
    let mut shared = Shared { bit_map: scene.bit_map.clone(), lives: scene.lives.clone(), ..empty };
    for attribute in head.plan.layout.attributes() {
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

/// Encodes the shared layers: for each its maps, and the first codes of every attribute.
fn shared_sections(head: &Head, shared: &mut Shared) -> Vec<Vec<u8>> {
    let plan = &*head.plan;
    let mut maps = MapModels::new(plan);
    let mut curve = CurveModels::new();
    let mut others: Vec<FirstModels> = plan.layout.attributes().skip(1).map(|a| FirstModels::new(plan, a)).collect();
    let mut sections = Vec::new();
    for index in 0..head.layers.len() {
        let layer = head.layer(index);
        let mut encoder = Encoder::default();
        maps.code(&mut encoder, plan, head.num_timesteps, layer.clone(), shared);
        sections.push(encoder.finish());
        let mut encoder = Encoder::default();
        curve.code(&mut encoder, plan, layer.clone(), shared);
        sections.push(encoder.finish());
        let Shared { bit_map, neighbors, first_codes, .. } = &mut *shared;
        for models in &mut others {
            let a = models.attribute().index();
            let mut encoder = Encoder::default();
            let (widths, codes) = (&bit_map.widths[a], &mut first_codes[a]);
            models.code(&mut encoder, plan, layer.clone(), neighbors, widths, codes);
            sections.push(encoder.finish());
        }
    }
    sections
}

/// Encodes the keypoints of an attribute in a segment, layer by layer.
fn segment_sections(
    scene: &CompactScene,
    head: &Head,
    shared: &Shared,
    segment: usize,
    attribute: Attribute,
) -> Vec<Vec<u8>> {
    let a = attribute.index();
    let mut models = KeypointModels::new(&head.plan, attribute);
    let mut units = UnitTracks::new(head.plan.channels(attribute));
    let unlimited = Budget::new(&DecodeLimits::none(), u64::MAX);
    let mut sections = Vec::new();
    for layer in 0..head.layers.len() {
        let place = Scope {
            plan: &head.plan,
            shared,
            attribute,
            layer: head.layer(layer),
            span: head.span(segment),
            num_timesteps: head.num_timesteps,
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
        sections.push([&[motion as u8][..], &bytes].concat());
    }
    sections
}

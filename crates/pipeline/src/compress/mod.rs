//! The steps from a scene of floats to the bytes of a `.tcgs` file, and what each leaves.

mod bits;
mod judge;
mod kept;
mod marks;
mod max_error;
mod parts;
mod rate;
mod refine;
mod seen;
mod settings;
mod target;
mod tune;
mod views;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_codec::{
    AttributeErrors, BitMap, BitMapping, CompactFile, CompactScene, CompressSettings, DecodeError, DecodeLimits,
    FORMAT_VERSION, LABELS, Light, MAX_BITS, Quantizers, SceneInfo, UpAxis, inspect,
};
use tcgs_core::{Attribute, Camera, DynamicGaussians, Layout, Life, Lives, SceneReader};

use self::bits::measured_bits;
use self::kept::Kept;
use self::parts::Parts;
use self::seen::{Seen, seen};
use self::views::TrainedFrom;
use crate::verify::whole_file_limits;
use crate::{OpenScene, PipelineError};

pub use judge::{Judge, JudgeImages};
pub use marks::Marks;
pub use max_error::{ErrorSearch, search_errors};
pub use rate::Allowance;
pub use refine::{RefineBudget, RefineOptions, Refined, RefinedWithin, refine, refine_within};
pub use settings::{CompressPreset, capture_kind_of, position_step_remark, settings_of};
pub use target::{QUALITY_RANGE, SearchResult, Target, search};
pub use tune::{Tuning, tune};
pub(crate) use views::up_axis;

/// How a scene is compressed.
#[derive(Clone, Debug)]
pub struct CompressOptions {
    /// Keypoints and quantizers.
    pub keypoints: CompressSettings,
    /// From sensitivity to bits, where bits are not learned.
    pub mapping: BitMapping,
    /// Fewest and most bits; none: those learned, else the default.
    pub bits: Option<(u8, u8)>,
    /// Of a position's coordinate; none: as learned, else the default.
    pub position_bits: Option<u8>,
    /// Mean mask from which on a Gaussian stays; none: the run's threshold.
    pub prune: Option<f32>,
    /// Share of the pixels of a timestep's training images below which a Gaussian is not seen. One that is never seen
    /// is left out, unless it is in none of the images; in version 2 one that is seen no more dies. 0: all stay. Not
    /// for Gaussians that change in number or order from timestep to timestep, of which all stay. Default 0.
    pub min_share: f32,
    /// Capture for measuring sensitivities; none: the run's, or cameras around the scene.
    pub capture: Option<PathBuf>,
    /// Whether the paper's form without entropy coding is a stage of its own.
    pub plain: bool,
    /// Direction that points up; none: derived from the capture's cameras.
    pub up: Option<UpAxis>,
    /// Version of the format: 1 or 2. Default: 2; version 1, for older readers, holds neither further columns nor
    /// Gaussians that come and go, and declares no errors.
    pub version: u16,
    /// Most cameras that the file gives players to start from.
    pub views: usize,
    /// Names and content of further application data (`docs/FORMAT.md`, "Application data").
    pub data: Vec<(String, Vec<u8>)>,
    /// Whether the file keeps the foreground marks of Gaussians. Default: it does not.
    pub marks: Marks,
    /// Raw size above which the timesteps of a run or of a `params.npz` are read from the disk, several times, instead
    /// of held in memory, bytes. The file is the same. Default: half a gigabyte.
    pub max_float_bytes: u64,
}

impl Default for CompressOptions {
    /// The codec's default settings, learned bits or bits of the default range, the run's mask threshold, eight
    /// cameras.
    fn default() -> Self {
        Self {
            keypoints: CompressSettings::default(),
            mapping: BitMapping::Log,
            bits: None,
            position_bits: None,
            prune: None,
            min_share: 0.0,
            capture: None,
            plain: false,
            up: None,
            version: FORMAT_VERSION,
            views: 8,
            data: Vec::new(),
            marks: Marks::Drop,
            max_float_bytes: 1 << 29,
        }
    }
}

impl CompressOptions {
    /// Bits that the codec knows, and shares that are some.
    fn check(&self) -> Result<(), PipelineError> {
        let expected = format!("1 to {MAX_BITS}, the fewest first");
        if let Some((min, max)) = self.bits
            && !(1 <= min && min <= max && max <= MAX_BITS)
        {
            return Err(PipelineError::input("fewest and most bits", format!("{min} and {max}"), expected));
        }
        if let Some(bits) = self.position_bits
            && !(1..=MAX_BITS).contains(&bits)
        {
            return Err(PipelineError::input("bits of a position", bits.to_string(), expected));
        }
        if !(0.0..1.0).contains(&self.min_share) {
            let found = self.min_share.to_string();
            return Err(PipelineError::input("least share of the images", found, "a number from 0 to less than 1"));
        }
        Marks::check(self)?;
        match self.prune {
            Some(share) if !(0.0..=1.0).contains(&share) => {
                Err(PipelineError::input("threshold of masks", share.to_string(), "a number from 0 to 1"))
            }
            _ => Ok(()),
        }
    }
}

/// A step of a compression and the size that it leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SizeStep {
    /// State of the scene after the step: `raw`, `pruned`, `quantised`, `keypoints`, `plain`, `file`.
    pub name: &'static str,
    /// Size of the scene after the step.
    pub bytes: u64,
}

/// A compressed scene.
#[derive(Clone, Debug)]
pub struct Compressed {
    /// Bytes of the `.tcgs` file.
    pub file: Vec<u8>,
    /// The same as symbols.
    pub compact: CompactFile,
    /// Number of identities before pruning; if they are unknown, the largest number of Gaussians at any timestep.
    pub num_gaussians_before: usize,
    /// From the raw floats, in order; the last is the file.
    pub stages: Vec<SizeStep>,
    /// By name of the attribute: bytes in the file.
    pub bytes_by_attribute: Vec<(String, u64)>,
}

/// A scene of floats of which all is known but the settings of keypoints and quantizers: compressing it again
/// with others does not measure its bits again.
#[derive(Clone, Debug)]
pub struct PrunedScene<'a> {
    content: Pruned<'a>,
    /// Of the scene.
    path: PathBuf,
    info: SceneInfo,
    /// Of the format.
    version: u16,
    num_gaussians_before: usize,
    raw_bytes: u64,
    /// Segment length of chapters, unless the settings have another.
    segment_length: Option<u32>,
    /// Application data: cameras for players first, then what was attached.
    data: Vec<(String, Vec<u8>)>,
    /// Where the bits come from, in words.
    pub bits_from: String,
}

/// Errors that a file declares.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Errors {
    /// True errors: the floats are read once more.
    Measured,
    /// 0 for all, while settings are searched.
    Zeros,
}

/// A pruned scene and its bits.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "a compression has one of it")]
enum Pruned<'a> {
    /// Gaussians that live in all timesteps, or from a birth on.
    Whole {
        kept: Kept<'a>,
        /// Lives of those that stay; none if all live at all timesteps.
        lives: Option<Lives>,
        bit_map: BitMap,
        learned: Option<Quantizers>,
        /// Whether each Gaussian that stays is foreground; none if that is not kept.
        foreground: Option<Vec<bool>>,
    },
    /// Gaussians that change in number or order from timestep to timestep: they are followed as far as they can be.
    Parts(Parts<'a>),
}

impl<'a> PrunedScene<'a> {
    /// Prunes a scene by its masks (paper Eq. 6), where it has masks, and assigns bits to what stays.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the scene is compressed already, holds a value that is not finite, or no mask is
    /// above the threshold; [`PipelineError`] if a file of the scene or the capture cannot be read.
    pub fn new(scene: &'a OpenScene, options: &CompressOptions) -> Result<Self, PipelineError> {
        options.check()?;
        if scene.num_timesteps() == 0 {
            return Err(PipelineError::input(scene.path.display(), "no timestep", "at least one"));
        }
        let from = TrainedFrom::open(scene, options)?;
        let up = options.up.unwrap_or_else(|| up_axis(&from.cameras));
        let mut pruned = Self {
            path: scene.path.clone(),
            info: info(scene, up),
            version: options.version,
            data: options.data.clone(),
            num_gaussians_before: scene.num_identities().unwrap_or_else(|| scene.max_gaussians()),
            raw_bytes: scene.bytes,
            segment_length: scene.segment_length(),
            bits_from: String::new(),
            content: Pruned::Parts(Parts::none(scene)),
        };
        if !parts::are_followed(scene)? {
            let parts = Parts::new(scene, options)?;
            pruned.bits_from = parts.bits_from.clone();
            return Ok(Self { content: Pruned::Parts(parts), ..pruned }.with_data(from.data(scene, options)?));
        }
        let learned = scene.learned_bits()?;
        let (kept, keep, raw_bytes) = if scene.is_on_disk() && scene.bytes > options.max_float_bytes {
            let keep = kept_gaussians(scene, options.prune)?;
            (Kept::OnDisk { scene, keep: keep.clone(), stand_ins: scene.stand_ins()? }, keep, scene.bytes)
        } else {
            let floats = scene.floats()?;
            check_finite(scene, &floats)?;
            let keep = kept_gaussians(scene, options.prune)?;
            (Kept::InMemory(floats.select(&keep)), keep, floats.raw_bytes())
        };
        let whole = Life { birth: 0, death: kept.num_timesteps() as u32 };
        let mut lives: Lives = match scene.lives() {
            Some(lives) => keep.iter().map(|&i| lives[i].within(0..whole.death)).collect(),
            None => Lives(vec![whole; keep.len()]),
        };
        let (kept, keep) = if options.min_share > 0.0 {
            let seen = seen_by_cameras(scene, &kept, &lives, &from.cameras, options.min_share)?;
            let is_needed = |seen: &Seen| seen.share >= options.min_share || !seen.is_in_images;
            let rows: Vec<usize> = (0..keep.len()).filter(|&row| is_needed(&seen[row])).collect();
            let seen_until = |row: usize| {
                let Life { birth, death } = lives[row];
                // Version 1 holds no lives: there only what the run says ends one.
                let is_cut = options.version > 1 && seen[row].is_in_images;
                Life { birth, death: if is_cut { seen[row].until.clamp(birth + 1, death) } else { death } }
            };
            lives = rows.iter().map(|&row| seen_until(row)).collect();
            (kept.select(&rows), rows.iter().map(|&row| keep[row]).collect())
        } else {
            (kept, keep)
        };
        let (bit_map, bits_from) = bits(scene, &kept, &keep, options, learned.as_ref())?;
        (pruned.raw_bytes, pruned.bits_from) = (raw_bytes, bits_from);
        (pruned.info.num_gaussians, pruned.info.num_timesteps) =
            (kept.num_gaussians() as u32, kept.num_timesteps() as u32);
        let lives = lives.iter().any(|&life| life != whole).then_some(lives);
        let foreground = options.marks.of(scene, &keep)?;
        let learned = learned.map(|(_, quantizers)| quantizers);
        pruned.content = Pruned::Whole { kept, lives, bit_map, learned, foreground };
        Ok(pruned.with_data(from.data(scene, options)?))
    }

    /// With these as its first application data.
    fn with_data(mut self, data: Vec<(String, Vec<u8>)>) -> Self {
        self.data.splice(0..0, data);
        self
    }

    /// Whether the file will say which Gaussians are foreground.
    pub fn has_marks(&self) -> bool {
        matches!(&self.content, Pruned::Whole { foreground: Some(_), .. })
    }

    /// Which columns its Gaussians have.
    pub(crate) fn layout(&self) -> Arc<Layout> {
        match &self.content {
            Pruned::Whole { kept, .. } => kept.layout(),
            Pruned::Parts(parts) => parts.layout(),
        }
    }

    /// The scene as symbols, and the bytes of its file. A file of version 2 declares its errors, which are measured for
    /// it: the floats are read once more.
    ///
    /// # Errors
    /// [`PipelineError`] if the codec refuses the scene or the settings.
    pub fn compress(&self, settings: &CompressSettings) -> Result<(CompactFile, Vec<u8>), PipelineError> {
        self.compress_with(settings, Errors::Measured, unchanged)
    }

    /// [`Self::compress`] for a search: what it declares is 0 instead of measured, and its file is as long.
    ///
    /// # Errors
    /// As there.
    fn try_out(&self, settings: &CompressSettings) -> Result<(CompactFile, Vec<u8>), PipelineError> {
        self.compress_with(settings, Errors::Zeros, unchanged)
    }

    /// The symbols, and which of the Gaussians that stay each of theirs is; none for [`Pruned::Parts`].
    fn symbols(&self, settings: &CompressSettings) -> Result<Option<(CompactScene, Vec<usize>)>, PipelineError> {
        let Pruned::Whole { kept, lives, bit_map, learned, .. } = &self.content else { return Ok(None) };
        let settings = &self.with_segments(settings);
        let (compact, order) = kept.compress(bit_map, learned.as_ref(), self.info.clone(), settings)?;
        let compact = match lives {
            Some(lives) => compact.with_lives(lives.select(&order)),
            None => compact,
        };
        Ok(Some((compact, order)))
    }

    /// Settings with the segment length of the chapters, unless they have their own.
    fn with_segments(&self, settings: &CompressSettings) -> CompressSettings {
        let segment_length = settings.segment_length.or(self.segment_length);
        CompressSettings { segment_length, ..settings.clone() }
    }

    /// Some of the Gaussians that stay; [`Pruned::Parts`] as they are.
    fn select(&self, rows: &[usize]) -> Self {
        let Pruned::Whole { kept, lives, bit_map, learned, foreground } = &self.content else { return self.clone() };
        Self {
            info: SceneInfo { num_gaussians: rows.len() as u32, ..self.info.clone() },
            content: Pruned::Whole {
                kept: kept.select(rows),
                lives: lives.as_ref().map(|lives| rows.iter().map(|&row| lives[row]).collect()),
                bit_map: bit_map.select(rows),
                learned: learned.clone(),
                foreground: foreground.as_ref().map(|marks| rows.iter().map(|&row| marks[row]).collect()),
            },
            path: self.path.clone(),
            data: self.data.clone(),
            bits_from: self.bits_from.clone(),
            ..*self
        }
    }

    /// - `change`: what happens to the symbols before they are encoded, and the light on them; not for
    ///   [`Pruned::Parts`]
    fn compress_with(
        &self,
        settings: &CompressSettings,
        errors: Errors,
        change: impl FnOnce(CompactScene) -> Result<(CompactScene, Light), PipelineError>,
    ) -> Result<(CompactFile, Vec<u8>), PipelineError> {
        let mut labels = None;
        let mut compact = match &self.content {
            Pruned::Whole { kept, foreground, .. } => {
                let (compact, order) = self.symbols(settings)?.expect("of followed Gaussians");
                labels = foreground.as_ref().map(|foreground| marks::labels(foreground, &order));
                let (compact, light) = change(compact)?;
                let mut compact = CompactFile { light, ..CompactFile::of(compact) };
                if self.version > 1 {
                    compact.declared_errors = match errors {
                        Errors::Measured => kept.errors_of(&compact.cohorts[0], &order)?.declared(),
                        Errors::Zeros => AttributeErrors::none(&kept.layout()).declared(),
                    };
                }
                compact
            }
            Pruned::Parts(parts) => parts.compress(&self.info, &self.with_segments(settings), errors)?,
        };
        let data = self.data.iter().map(|(name, data)| (&name[..], &data[..]));
        let data: Vec<_> = data.chain(labels.as_deref().map(|json| (LABELS, json))).collect();
        if self.version == 1 {
            compact.declared_errors.clear();
        }
        let file = compact.encode(self.version, &data)?;
        Ok((compact, file))
    }

    /// The sizes after every step, and by attribute. Decodes the file, so that only readable files are returned.
    ///
    /// - `options`: with which [`Self::compress`] gave the others
    ///
    /// # Errors
    /// [`PipelineError::Input`] if decoders would refuse `file`, such as for the memory that it takes;
    /// [`PipelineError::Decode`] if it is not a whole `.tcgs` file.
    pub fn account(
        self,
        options: &CompressOptions,
        compact: CompactFile,
        file: Vec<u8>,
    ) -> Result<Compressed, PipelineError> {
        let undecodable = |error| match error {
            DecodeError::Limit { .. } => PipelineError::input(
                self.path.display(),
                format!("decoders refuse its file of {} bytes: {error}", file.len()),
                "Gaussians that differ more, or fewer of them",
            ),
            error => PipelineError::Decode { path: self.path.clone(), error },
        };
        CompactFile::decode(&file, &whole_file_limits(file.len() as u64)).map_err(undecodable)?;
        let mut stages = vec![
            SizeStep { name: "raw", bytes: self.raw_bytes },
            SizeStep {
                name: "pruned",
                bytes: match &self.content {
                    Pruned::Whole { kept, .. } => {
                        kept.layout().raw_bytes(compact.num_identities(), kept.num_timesteps())
                    }
                    Pruned::Parts(_) => self.raw_bytes,
                },
            },
            SizeStep { name: "quantised", bytes: compact.quantized_bytes() },
        ];
        if options.keypoints.keypoints {
            stages.push(SizeStep { name: "keypoints", bytes: compact.plain_bytes() });
        }
        if options.plain {
            stages.push(SizeStep { name: "plain", bytes: compact.plain_bytes() });
        }
        stages.push(SizeStep { name: "file", bytes: file.len() as u64 });
        let bytes_by_attribute = inspect(&file, &DecodeLimits::none()).map_err(undecodable)?.bytes_by_attribute();
        Ok(Compressed { bytes_by_attribute, file, compact, num_gaussians_before: self.num_gaussians_before, stages })
    }
}

fn unchanged(compact: CompactScene) -> Result<(CompactScene, Light), PipelineError> {
    Ok((compact, Light::default()))
}

/// Compresses a scene of floats: [`PrunedScene::new`], [`PrunedScene::compress`] and [`PrunedScene::account`] in one.
///
/// # Errors
/// As these.
pub fn compress_scene(scene: &OpenScene, options: &CompressOptions) -> Result<Compressed, PipelineError> {
    let pruned = PrunedScene::new(scene, options)?;
    let (compact, file) = pruned.compress(&options.keypoints)?;
    pruned.account(options, compact, file)
}

/// Indices of the Gaussians that stay: all of a scene without masks, else those whose mean mask over time (paper Eq. 6)
/// is above the threshold.
///
/// - `threshold`: none for the run's
///
/// # Errors
/// [`PipelineError::Input`] if no mean mask is above the threshold; [`PipelineError`] if a file of the scene is
/// damaged.
pub fn kept_gaussians(scene: &OpenScene, threshold: Option<f32>) -> Result<Vec<usize>, PipelineError> {
    let num_gaussians = scene.num_identities().unwrap_or_else(|| scene.max_gaussians());
    let (Some(run), Some(means)) = (scene.run(), scene.mean_masks()?) else { return Ok((0..num_gaussians).collect()) };
    let threshold = threshold.unwrap_or(run.config().mask.threshold);
    let keep: Vec<usize> = (0..num_gaussians).filter(|&i| means[i] > threshold).collect();
    if keep.is_empty() {
        let largest = means.iter().fold(0.0_f32, |a, &b| a.max(b));
        let found = format!("its largest mean mask is {largest:.1e}");
        return Err(PipelineError::input(scene.path.display(), found, format!("one above the threshold {threshold}")));
    }
    Ok(keep)
}

/// How much the training cameras see of each Gaussian.
///
/// - `lives`: as [`seen`] takes them
/// - `cameras`: at the capture's full size
fn seen_by_cameras(
    scene: &OpenScene,
    kept: &Kept,
    lives: &Lives,
    cameras: &[(usize, Camera)],
    min_share: f32,
) -> Result<Vec<Seen>, PipelineError> {
    let refused = |found: String, expected: String| PipelineError::input(scene.path.display(), found, expected);
    if cameras.is_empty() {
        return Err(refused("no training cameras".into(), "a capture, whose cameras tell what is seen".into()));
    }
    let cameras: Vec<Camera> = cameras.iter().map(|(_, camera)| camera.downscaled(scene.downscale)).collect();
    let seen = seen(kept, lives, &cameras, min_share)?;
    let largest = seen.iter().fold(0.0_f32, |largest, seen| largest.max(seen.share));
    if largest < min_share {
        let found = format!("its largest Gaussian makes up {largest:.1e} of the images");
        return Err(refused(found, format!("{min_share} or more")));
    }
    Ok(seen)
}

/// Bits of the Gaussians that stay, and where they come from.
fn bits(
    scene: &OpenScene,
    kept: &Kept,
    keep: &[usize],
    options: &CompressOptions,
    learned: Option<&(BitMap, Quantizers)>,
) -> Result<(BitMap, String), PipelineError> {
    let (mut bit_map, from) = match (options.bits, learned) {
        (None, Some((bit_map, _))) => (bit_map.select(keep), "bits: learned by the run".into()),
        (Some((min, max)), _) if min == max => {
            let position_bits = options.position_bits.unwrap_or(tcgs_codec::BitSettings::default().position_bits);
            let bit_map = BitMap::uniform_of(SceneReader::layout(scene), kept.num_gaussians(), position_bits, min);
            (bit_map, format!("bits: {min} for every parameter"))
        }
        _ => measured_bits(scene, kept, options)?,
    };
    if let Some(position_bits) = options.position_bits {
        bit_map.widths[Attribute::Mean.index()].fill(position_bits);
    }
    Ok((bit_map, from))
}

/// The description of a scene without its counts.
fn info(scene: &OpenScene, up: UpAxis) -> SceneInfo {
    let source = scene.capture().map_or_else(|| scene.path.with_extension(""), Path::to_path_buf);
    SceneInfo {
        first_frame: scene.first_frame as u32,
        downscale: scene.downscale as u32,
        frame_rate: scene.frame_rate as f32,
        name: source.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        up,
        ..SceneInfo::of(&DynamicGaussians::default())
    }
}

/// Training may leave a value that nobody saw.
fn check_finite(scene: &OpenScene, floats: &DynamicGaussians) -> Result<(), PipelineError> {
    for column in floats.layout().columns() {
        let attribute = column.attribute;
        for timestep in 0..floats.num_samples(attribute) {
            let values = floats.values(attribute, timestep);
            if let Some(i) = values.iter().position(|x| !x.is_finite()) {
                let (name, value, gaussian) = (&column.name, values[i], i / attribute.components());
                let found = format!("{name} of Gaussian {gaussian} at timestep {timestep} is {value}");
                return Err(PipelineError::input(scene.path.display(), found, "a finite number"));
            }
        }
    }
    Ok(())
}

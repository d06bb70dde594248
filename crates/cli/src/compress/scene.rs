//! The steps from a trained scene to the bytes of a file, and what each leaves.

use std::path::PathBuf;

use tcgs_codec::{
    BitMap, BitMapping, CompactScene, CompressError, CompressSettings, DecodeLimits, Quantizers, SceneInfo, UpAxis,
    compress, encode_with, inspect,
};
use tcgs_core::{Attribute, DynamicGaussians};
use tcgs_pipeline::{OpenScene, SceneContent};

use super::bits::measured_bits;
use super::views::{self, VIEWS};
use crate::error::wrong_input;

/// How a scene is compressed.
pub struct Settings {
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
    /// Capture for measuring sensitivities; none: the run's, or cameras around the scene.
    pub capture: Option<PathBuf>,
    /// Whether the paper's form without entropy coding is a stage of its own.
    pub plain: bool,
    /// What points up; none: found by the capture's cameras.
    pub up: Option<UpAxis>,
    /// Most cameras that the file gives players to start from.
    pub views: usize,
}

/// A step and what it leaves.
pub struct Stage {
    /// What was done.
    pub name: &'static str,
    /// What the model then takes.
    pub bytes: u64,
}

/// A compressed scene.
pub struct Compressed {
    /// Bytes of the `.tcgs` file.
    pub file: Vec<u8>,
    /// The same as symbols.
    pub compact: CompactScene,
    /// Before pruning.
    pub num_gaussians_before: usize,
    /// From the raw floats, in order; the last is the file.
    pub stages: Vec<Stage>,
    /// By [`Attribute::index`]: bytes in the file.
    pub bytes_by_attribute: [u64; 5],
}

/// A scene of floats of which all is known but the settings of keypoints and quantizers: compressing it again
/// with others does not measure its bits again.
pub struct Prepared {
    pruned: DynamicGaussians,
    bit_map: BitMap,
    learned: Option<Quantizers>,
    info: SceneInfo,
    num_gaussians_before: usize,
    raw_bytes: u64,
    /// For players.
    views: Option<Vec<u8>>,
    /// Where the bits come from, in words.
    pub bits_from: String,
}

impl Prepared {
    /// Prunes a scene and gives it bits.
    pub fn new(scene: &OpenScene, settings: &Settings) -> anyhow::Result<Self> {
        let (floats, learned) = match &scene.content {
            SceneContent::Run(run) => (&run.1.scene, run.1.quantization.as_ref()),
            SceneContent::Floats { scene: floats, .. } => (&**floats, None),
            SceneContent::Compact(_) => {
                return Err(wrong_input(format!("{}: is compressed already, expected floats", scene.path.display())));
            }
        };
        check_finite(scene, floats)?;
        let keep = kept_gaussians(scene, settings.prune)?;
        let pruned = floats.select(&keep);
        let (bit_map, bits_from) = bits(scene, &pruned, &keep, settings, learned)?;
        let cameras = views::cameras(scene, settings)?;
        let up = settings.up.unwrap_or_else(|| views::up_axis(&cameras));
        Ok(Self {
            info: info(scene, &pruned, up),
            views: views::views(&cameras, settings),
            pruned,
            bit_map,
            learned: learned.map(|(_, quantizers)| quantizers.clone()),
            num_gaussians_before: floats.num_gaussians(),
            raw_bytes: floats.raw_bytes(),
            bits_from,
        })
    }

    /// Symbols and file.
    pub fn compress(&self, settings: &CompressSettings) -> Result<(CompactScene, Vec<u8>), CompressError> {
        let compact = compress(&self.pruned, &self.bit_map, self.learned.as_ref(), self.info.clone(), settings)?;
        let views = self.views.iter().map(|json| (VIEWS, &json[..]));
        let file = encode_with(&compact, &views.collect::<Vec<_>>())?;
        Ok((compact, file))
    }

    /// All that is to be known of a file.
    ///
    /// - `settings`: with which [`Self::compress`] gave the others
    pub fn account(self, settings: &Settings, compact: CompactScene, file: Vec<u8>) -> anyhow::Result<Compressed> {
        let mut stages = vec![
            Stage { name: "raw", bytes: self.raw_bytes },
            Stage { name: "pruned", bytes: self.pruned.raw_bytes() },
            Stage { name: "quantised", bytes: compact.quantized_bytes() },
        ];
        if settings.keypoints.keypoints {
            stages.push(Stage { name: "keypoints", bytes: compact.plain_bytes() });
        }
        if settings.plain {
            stages.push(Stage { name: "plain", bytes: compact.plain_bytes() });
        }
        stages.push(Stage { name: "file", bytes: file.len() as u64 });
        let bytes_by_attribute = inspect(&file, &DecodeLimits::none())?.bytes_by_attribute();
        Ok(Compressed { bytes_by_attribute, file, compact, num_gaussians_before: self.num_gaussians_before, stages })
    }
}

/// Compresses a scene of floats.
pub fn compress_scene(scene: &OpenScene, settings: &Settings) -> anyhow::Result<Compressed> {
    let prepared = Prepared::new(scene, settings)?;
    let (compact, file) = prepared.compress(&settings.keypoints)?;
    prepared.account(settings, compact, file)
}

/// Indices of the Gaussians that stay: all without masks, else those whose mean mask is above the threshold.
pub fn kept_gaussians(scene: &OpenScene, threshold: Option<f32>) -> anyhow::Result<Vec<usize>> {
    let all = || (0..scene.num_gaussians()).collect();
    let SceneContent::Run(run) = &scene.content else { return Ok(all()) };
    let mask = &run.0.config().mask;
    if !mask.enabled {
        return Ok(all());
    }
    let threshold = threshold.unwrap_or(mask.threshold);
    let means = tcgs_train::mean_masks(&run.1.mask_logits);
    let keep: Vec<usize> = (0..means.len()).filter(|&i| means[i] > threshold).collect();
    if keep.is_empty() {
        let largest = means.iter().fold(0.0_f32, |a, &b| a.max(b));
        let problem = format!("its largest mean mask is {largest:.1e}, expected one above the threshold {threshold}");
        return Err(wrong_input(format!("{}: {problem}", scene.path.display())));
    }
    Ok(keep)
}

/// Bits of the Gaussians that stay, and where they come from.
fn bits(
    scene: &OpenScene,
    pruned: &DynamicGaussians,
    keep: &[usize],
    settings: &Settings,
    learned: Option<&(BitMap, Quantizers)>,
) -> anyhow::Result<(BitMap, String)> {
    let (mut bit_map, from) = match (settings.bits, learned) {
        (None, Some((bit_map, _))) => (bit_map.select(keep), "bits: learned by the run".into()),
        (Some((min, max)), _) if min == max => {
            let position_bits = settings.position_bits.unwrap_or(tcgs_codec::BitSettings::default().position_bits);
            (BitMap::uniform(pruned.num_gaussians(), position_bits, min), format!("bits: {min} for every parameter"))
        }
        _ => measured_bits(scene, pruned, settings)?,
    };
    if let Some(position_bits) = settings.position_bits {
        bit_map.widths[Attribute::Mean.index()].fill(position_bits);
    }
    Ok((bit_map, from))
}

fn info(scene: &OpenScene, pruned: &DynamicGaussians, up: UpAxis) -> SceneInfo {
    let source = match &scene.content {
        SceneContent::Run(run) => PathBuf::from(&run.0.config().data.capture),
        _ => scene.path.with_extension(""),
    };
    SceneInfo {
        first_frame: scene.first_frame as u32,
        downscale: scene.downscale as u32,
        frame_rate: scene.frame_rate as f32,
        name: source.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        up,
        ..SceneInfo::of(pruned)
    }
}

/// Training may leave a value that nobody saw.
fn check_finite(scene: &OpenScene, floats: &DynamicGaussians) -> anyhow::Result<()> {
    for attribute in Attribute::ALL {
        for timestep in 0..floats.num_samples(attribute) {
            let values = floats.values(attribute, timestep);
            if let Some(i) = values.iter().position(|x| !x.is_finite()) {
                let (path, name, value) = (scene.path.display(), attribute.name(), values[i]);
                let gaussian = i / attribute.components();
                return Err(wrong_input(format!(
                    "{path}: {name} of Gaussian {gaussian} at timestep {timestep} is {value}, expected a finite number"
                )));
            }
        }
    }
    Ok(())
}

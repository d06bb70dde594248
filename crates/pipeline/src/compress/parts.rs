//! Scenes whose Gaussians change in number or order from timestep to timestep, as programs write them that make one
//! file a frame: part by part, with the Gaussians that are found again followed within a part.

use std::sync::Arc;

use tcgs_codec::{
    AttributeErrors, BitMap, CompactFile, CompressSettings, FollowedParts, Light, SceneInfo, compress_ordered,
};
use tcgs_core::{Gaussians, Layout, SceneReader};

use super::bits::measured_bits;
use super::kept::Kept;
use super::{CompressOptions, Errors, bits};
use crate::{OpenScene, PipelineError};

/// Most timesteps of a part.
const MAX_TIMESTEPS: usize = 50;
/// Floats of a part at most, about: longer ones of larger scenes would not fit into memory.
const MAX_FLOATS: usize = 1 << 28;
/// Number of pairs of successive timesteps that tell whether the files say which Gaussian is which.
const PAIRS: usize = 3;

/// A scene in parts.
#[derive(Clone, Debug)]
pub(super) struct Parts<'a> {
    scene: &'a OpenScene,
    max_timesteps: usize,
    /// Bit map of each part, in the order in which its Gaussians are followed.
    bit_maps: Vec<BitMap>,
    /// Where the bits come from, in words.
    pub bits_from: String,
}

/// Whether the Gaussians of successive timesteps are the same, in the same order: in number, and nearly in place.
pub(super) fn are_followed(scene: &OpenScene) -> Result<bool, PipelineError> {
    if !scene.has_loose_timesteps() || scene.num_timesteps() < 2 {
        return Ok(true);
    }
    if !scene.all_live() {
        return Ok(false);
    }
    for timestep in crate::spread::spread(scene.num_timesteps() - 1, PAIRS) {
        if !is_continued(&scene.at(timestep)?, &scene.at(timestep + 1)?) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Whether most Gaussians are nearer to those of the same row than half of the others would be by chance.
fn is_continued(before: &Gaussians, now: &Gaussians) -> bool {
    let n = before.num_gaussians();
    let squared = |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>();
    // As far as the rows of a sequence in another order would be apart.
    let apart: f64 = (0..n).map(|i| squared(before.means()[i], before.means()[(i * 7919 + n / 2) % n])).sum();
    let moved: f64 = (0..n).map(|i| squared(before.means()[i], now.means()[i])).sum();
    moved <= 0.05 * apart
}

impl<'a> Parts<'a> {
    /// No parts yet.
    pub fn none(scene: &'a OpenScene) -> Self {
        Self { scene, max_timesteps: 1, bit_maps: Vec::new(), bits_from: String::new() }
    }

    /// Finds the parts, and the bits of their Gaussians.
    pub fn new(scene: &'a OpenScene, options: &CompressOptions) -> Result<Self, PipelineError> {
        let floats = SceneReader::layout(scene).components() * scene.max_gaussians().max(1);
        let max_timesteps = (MAX_FLOATS / floats).clamp(1, MAX_TIMESTEPS);
        let mut parts = Self { max_timesteps, ..Self::none(scene) };
        for part in FollowedParts::new(&mut Reader(scene), max_timesteps) {
            let part = Kept::InMemory(part?.scene);
            let keep: Vec<usize> = (0..part.num_gaussians()).collect();
            let (bit_map, from) = match options.bits {
                Some((min, max)) if min == max => bits(scene, &part, &keep, options, None)?,
                _ => measured_bits(scene, &part, options)?,
            };
            parts.bit_maps.push(bit_map);
            parts.bits_from = from;
        }
        Ok(parts)
    }

    pub fn layout(&self) -> Arc<Layout> {
        Arc::clone(SceneReader::layout(self.scene))
    }

    /// The symbols of all parts, with their errors.
    ///
    /// - `info`: of the whole scene, but for its counts
    pub fn compress(
        &self,
        info: &SceneInfo,
        settings: &CompressSettings,
        declared: Errors,
    ) -> Result<CompactFile, PipelineError> {
        let mut cohorts = Vec::new();
        let mut errors = AttributeErrors::none(SceneReader::layout(self.scene));
        let mut reader = Reader(self.scene);
        for (part, bit_map) in FollowedParts::new(&mut reader, self.max_timesteps).zip(&self.bit_maps) {
            let part = part?;
            if part.lives.is_empty() {
                continue;
            }
            let counts = SceneInfo {
                num_gaussians: part.lives.len() as u32,
                num_timesteps: part.scene.num_timesteps() as u32,
                ..info.clone()
            };
            let (mut compact, order) = compress_ordered(&part.scene, bit_map, None, counts, settings)?;
            if !part.all_live() {
                compact = compact.with_lives(part.lives.select(&order));
            }
            if declared == Errors::Measured {
                errors.extend(&AttributeErrors::of(&compact, &mut &part.scene, &order)?);
            }
            compact.start = part.start as u32;
            cohorts.push(compact);
        }
        let num_gaussians = cohorts.iter().map(|cohort| cohort.info.num_gaussians).sum();
        let num_timesteps = self.scene.num_timesteps() as u32;
        let info = SceneInfo { num_gaussians, num_timesteps, ..info.clone() };
        Ok(CompactFile { info, cohorts, declared_errors: errors.declared(), light: Light::default() })
    }
}

struct Reader<'a>(&'a OpenScene);

impl SceneReader for Reader<'_> {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        SceneReader::layout(self.0)
    }

    fn num_identities(&self) -> Option<usize> {
        self.0.num_identities()
    }

    fn num_gaussians_at(&self, timestep: usize) -> usize {
        self.0.num_gaussians_at(timestep)
    }

    fn num_timesteps(&self) -> usize {
        self.0.num_timesteps()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        self.0.at(timestep)
    }
}

//! The Gaussians of a scene that stay, in memory or read from the disk a timestep at a time.

use std::ops::Range;
use std::sync::Arc;

use tcgs_codec::{
    AttributeErrors, BitMap, CompactScene, CompressSettings, Quantizers, SceneInfo, compress_ordered, compress_reader,
};
use tcgs_core::{DynamicGaussians, Gaussians, Layout, SceneReader};
use tcgs_train::StandIns;

use crate::{OpenScene, PipelineError};

/// The Gaussians that stay.
#[derive(Clone, Debug)]
pub(super) enum Kept<'a> {
    /// All timesteps.
    InMemory(DynamicGaussians),
    /// Timesteps are read, and read again, when the codec asks for them.
    OnDisk { scene: &'a OpenScene, keep: Vec<usize>, stand_ins: StandIns },
}

impl Kept<'_> {
    pub fn num_gaussians(&self) -> usize {
        match self {
            Self::InMemory(floats) => floats.num_gaussians(),
            Self::OnDisk { keep, .. } => keep.len(),
        }
    }

    /// Some of them.
    pub fn select(&self, rows: &[usize]) -> Self {
        match self {
            Self::InMemory(floats) => Self::InMemory(floats.select(rows)),
            Self::OnDisk { scene, keep, stand_ins } => {
                let keep = rows.iter().map(|&row| keep[row]).collect();
                Self::OnDisk { scene, keep, stand_ins: stand_ins.clone() }
            }
        }
    }

    pub fn num_timesteps(&self) -> usize {
        match self {
            Self::InMemory(floats) => floats.num_timesteps(),
            Self::OnDisk { scene, .. } => scene.num_timesteps(),
        }
    }

    pub fn layout(&self) -> Arc<Layout> {
        match self {
            Self::InMemory(floats) => Arc::clone(floats.layout()),
            Self::OnDisk { scene, .. } => Arc::clone(SceneReader::layout(*scene)),
        }
    }

    /// One timestep in stored form; who does not live then is there as it was born or died.
    pub fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        match self {
            Self::InMemory(floats) => Ok(floats.at(timestep)),
            Self::OnDisk { scene, keep, stand_ins } => {
                let gaussians = stand_ins.complete(scene.at(timestep)?, timestep);
                Ok(if keep.len() < gaussians.num_gaussians() { gaussians.select(keep) } else { gaussians })
            }
        }
    }

    /// The symbols, and which of these Gaussians each of theirs is; the same from memory and from the disk.
    pub fn compress(
        &self,
        bit_map: &BitMap,
        learned: Option<&Quantizers>,
        info: SceneInfo,
        settings: &CompressSettings,
    ) -> Result<(CompactScene, Vec<usize>), PipelineError> {
        Ok(match self {
            Self::InMemory(floats) => compress_ordered(floats, bit_map, learned, info, settings)?,
            Self::OnDisk { .. } => compress_reader(&mut Reader(self), bit_map, learned, info, settings)?,
        })
    }

    /// Errors of the symbols against these floats, which are read once more.
    ///
    /// - `order`: as [`Self::compress`] gave it
    pub fn errors_of(&self, compact: &CompactScene, order: &[usize]) -> Result<AttributeErrors, PipelineError> {
        Ok(AttributeErrors::of(compact, &mut Reader(self), order)?)
    }
}

struct Reader<'a>(&'a Kept<'a>);

impl SceneReader for Reader<'_> {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        match self.0 {
            Kept::InMemory(floats) => floats.layout(),
            Kept::OnDisk { scene, .. } => SceneReader::layout(*scene),
        }
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.0.num_gaussians()
    }

    fn num_timesteps(&self) -> usize {
        self.0.num_timesteps()
    }

    fn span(&self, timestep: usize) -> Range<usize> {
        timestep..timestep + 1
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        self.0.at(timestep)
    }
}

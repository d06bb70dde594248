//! Settings of the codec by preset and kind of capture, and tolerances by the extent of the scene.

use std::path::Path;

use tcgs_capture::{Capture, CaptureKind};
use tcgs_codec::{BitMapping, CompactFile, CompressSettings};
use tcgs_core::{Attribute, Extent};

use crate::{OpenScene, PipelineError};

/// Error of positions between keypoints, in the scene's radius, where the unit of lengths is not known: in the
/// 2.8 m of Panoptic Sports nearly the 1.6 mm of a run.
const POSITION_TOLERANCE: f32 = 5e-4;
/// Step of positions, in the scene's radius, from which on it is worth a remark: rounding errs as much as the
/// tolerance allows.
const MAX_POSITION_STEP: f32 = 3e-3;

/// Settings to start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CompressPreset {
    /// The paper's: linear bits, two keypoints at least.
    Paper,
    /// What measured better.
    Default,
}

/// The kind of capture that a scene was trained on: that of the capture given, else what the run says; where nothing is
/// known, the paper's main one.
///
/// # Errors
/// [`PipelineError::Capture`] if the capture cannot be opened.
pub fn capture_kind_of(scene: &OpenScene, capture: Option<&Path>) -> Result<CaptureKind, PipelineError> {
    if let Some(capture) = capture {
        return Ok(Capture::open(capture)?.kind());
    }
    let of_run = scene.run().and_then(|run| CaptureKind::named(&run.config().data.layout));
    Ok(of_run.unwrap_or(CaptureKind::PANOPTIC))
}

/// The settings of a preset for a scene that was trained on a kind of capture, and how bits follow from sensitivity.
///
/// The default preset's tolerance of positions follows the extent of the scene's first timestep where the unit of
/// lengths is unknown; the paper's settings differ between its data sets.
///
/// # Errors
/// [`PipelineError`] if the first timestep cannot be read.
pub fn settings_of(
    preset: CompressPreset,
    kind: CaptureKind,
    scene: &OpenScene,
) -> Result<(CompressSettings, BitMapping), PipelineError> {
    if preset == CompressPreset::Paper {
        return Ok((paper(kind), BitMapping::Linear));
    }
    let mut settings = CompressSettings::default();
    let of_unknown_unit = scene.run().is_none() || !kind.facts.in_metres;
    if of_unknown_unit {
        settings.max_mse[Attribute::Mean.index()] = (POSITION_TOLERANCE * radius(scene)?).powi(2);
    }
    Ok((settings, BitMapping::Log))
}

/// The paper's settings, which differ between its data sets.
fn paper(kind: CaptureKind) -> CompressSettings {
    let (max_keypoints, max_mse) = match kind.name {
        "panoptic" => (30, 1e-5),
        "technicolor" => (15, 1e-7),
        _ => (60, 1e-7),
    };
    CompressSettings { max_keypoints, max_mse: [max_mse; 5], ..CompressSettings::paper() }
}

/// The step that positions are rounded to and the radius of the scene, if rounding errs more than the tolerance of
/// positions allows: then some Gaussians are far away from the others.
///
/// # Errors
/// [`PipelineError`] if the first timestep cannot be read.
pub fn position_step_remark(scene: &OpenScene, compact: &CompactFile) -> Result<Option<(f32, f32)>, PipelineError> {
    let quantizers = compact.cohorts.iter().map(|cohort| &cohort.quantizers.attributes[Attribute::Mean.index()]);
    let steps = quantizers.flat_map(|of| of.values().flatten()).map(|q| q.step);
    let (step, radius) = (steps.fold(0.0, f32::max), radius(scene)?);
    Ok((step > MAX_POSITION_STEP * radius).then_some((step, radius)))
}

/// Radius of the first timestep, before pruning.
fn radius(scene: &OpenScene) -> Result<f32, PipelineError> {
    Ok(Extent::of(scene.at(0)?.means()).radius as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preset_paper_has_the_keypoints_and_tolerances_that_the_paper_prints() {
        let of = |name: &str| {
            let settings = paper(CaptureKind::named(name).unwrap());
            (settings.max_keypoints, settings.max_mse)
        };
        assert_eq!(of("panoptic"), (30, [1e-5; 5]));
        assert_eq!(of("technicolor"), (15, [1e-7; 5]));
        assert_eq!(of("neural3d"), (60, [1e-7; 5]));
        let paper = paper(CaptureKind::PANOPTIC);
        assert_eq!((paper.constant_tracks, paper.noise_floor, paper.importance), (false, false, 0.0));
        assert_eq!((paper.joint, paper.position_fineness, paper.layers.len()), (false, 0.0, 0));
    }
}

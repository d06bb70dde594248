//! The data that a decoder needs before any entropy-coded symbol: the section `INFO`, and the head of a cohort
//! (`docs/FORMAT.md`).

use std::ops::Range;
use std::sync::Arc;

use super::plan::Plan;
use super::section::{Cursor, SHARED};
use crate::compact::{ColorSpace, SceneInfo, UpAxis, Violation, check_division};
use crate::error::{DecodeError, NEWER};
use crate::limits::DecodeLimits;

/// Largest number of segments of a cohort.
pub(super) const MAX_SEGMENTS: usize = SHARED as usize;

/// Content of `INFO`: the description of the whole scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Info {
    pub(super) scene: SceneInfo,
    /// Smallest and largest coordinates of means.
    pub(super) bounds: [[f32; 3]; 2],
    /// By attribute name, the largest error against the compressed scene.
    pub(super) errors: Vec<(String, f32)>,
}

/// Description of a cohort.
#[derive(Clone, Debug)]
pub(super) struct Head {
    /// Index of the cohort in the file.
    pub(super) index: usize,
    /// Description of the whole scene.
    pub(super) info: Arc<Info>,
    pub(super) plan: Arc<Plan>,
    /// Timestep of the scene at which the cohort begins.
    pub(super) start: usize,
    /// Number of timesteps of the cohort, at most 65536.
    pub(super) num_timesteps: usize,
    /// Number of Gaussians of the cohort.
    pub(super) num_gaussians: usize,
    /// Whether Gaussians have lives of their own.
    pub(super) has_lives: bool,
    /// `[layers]`: number of Gaussians of each layer.
    pub(super) layers: Vec<u32>,
    /// `L` of the file; [`Self::segment_length`] is the effective length.
    pub(super) segment_length: u32,
}

impl Head {
    /// Length of the segments in timesteps. A cohort without Gaussians or without a varying attribute has one segment
    /// of all timesteps: otherwise a few bytes could claim 65,536 segments.
    pub(super) fn segment_length(&self) -> usize {
        let moves = self.num_gaussians > 0 && self.plan.listed_varying().next().is_some();
        if moves { self.segment_length as usize } else { self.num_timesteps }
    }

    pub(super) fn num_segments(&self) -> usize {
        self.num_timesteps.div_ceil(self.segment_length())
    }

    /// Timesteps of a segment, counted from the first of the cohort.
    pub(super) fn span(&self, segment: usize) -> Range<usize> {
        let length = self.segment_length();
        segment * length..((segment + 1) * length).min(self.num_timesteps)
    }

    /// Gaussians of a layer.
    pub(super) fn layer(&self, layer: usize) -> Range<usize> {
        let start = self.layers[..layer].iter().map(|&n| n as usize).sum();
        start..start + self.layers[layer] as usize
    }

    /// Checks the rules for the division of Gaussians into layers and of timesteps into segments.
    pub(super) fn check(&self) -> Result<(), Violation> {
        check_division(self.num_gaussians as u32, &self.layers, self.segment_length)?;
        if self.num_segments() > MAX_SEGMENTS {
            let problem = "more than 65535 segments";
            return Err(Violation { attribute: None, field: "segment_length", problem });
        }
        Ok(())
    }
}

/// Writes the fields of `INFO` that all versions have.
fn write_scene(info: &Info) -> Vec<u8> {
    let Info { scene, bounds, .. } = info;
    let mut bytes = Vec::new();
    for count in [scene.num_gaussians, scene.num_timesteps, scene.first_frame, scene.downscale] {
        bytes.extend(count.to_le_bytes());
    }
    bytes.extend(scene.frame_rate.to_le_bytes());
    for bound in bounds.as_flattened() {
        bytes.extend(bound.to_le_bytes());
    }
    bytes.extend([scene.color_space as u8, scene.up as u8]);
    for text in [&scene.name, &scene.generator] {
        write_text(&mut bytes, text);
    }
    bytes
}

/// Writes a text of at most 65535 bytes.
pub(super) fn write_text(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
}

/// Writes `INFO` of version 1, which includes the division of its only cohort.
pub(super) fn write_info_1(info: &Info, head: &Head) -> Vec<u8> {
    let mut bytes = write_scene(info);
    bytes.extend(head.segment_length.to_le_bytes());
    write_layers(&mut bytes, &head.layers);
    bytes
}

/// Writes `INFO` of version 2.
pub(super) fn write_info_2(info: &Info) -> Vec<u8> {
    let mut bytes = write_scene(info);
    bytes.push(info.errors.len() as u8);
    for (name, error) in &info.errors {
        write_text(&mut bytes, name);
        bytes.extend(error.to_le_bytes());
    }
    bytes
}

pub(super) fn write_layers(bytes: &mut Vec<u8>, layers: &[u32]) {
    bytes.extend((layers.len() as u16).to_le_bytes());
    bytes.extend(layers.iter().flat_map(|n| n.to_le_bytes()));
}

pub(super) fn read_layers(cursor: &mut Cursor<'_>) -> Result<Vec<u32>, DecodeError> {
    let num_layers = cursor.u16("number of layers")?;
    (0..num_layers).map(|_| cursor.u32("layers")).collect()
}

/// Reads the fields of `INFO` that all versions have.
fn read_scene(cursor: &mut Cursor<'_>, limits: &DecodeLimits) -> Result<Info, DecodeError> {
    let num_gaussians = cursor.u32("num_gaussians")?;
    let num_timesteps = cursor.u32("num_timesteps")?;
    let counts =
        [("Gaussians", num_gaussians, limits.max_gaussians), ("timesteps", num_timesteps, limits.max_timesteps)];
    for (unit, needed, limit) in counts {
        if needed > limit {
            return Err(DecodeError::Limit { what: "scene", unit, needed: needed.into(), limit: limit.into() });
        }
    }
    let first_frame = cursor.u32("first_frame")?;
    let downscale = cursor.u32("downscale")?;
    let frame_rate = cursor.f32("frame_rate")?;
    let mut bounds = [[0.0; 3]; 2];
    for bound in bounds.as_flattened_mut() {
        *bound = cursor.f32("bounds")?;
    }
    if !bounds.as_flattened().iter().all(|b| b.is_finite()) || (0..3).any(|i| bounds[0][i] > bounds[1][i]) {
        return Err(cursor.invalid("bounds", "not finite or not ascending"));
    }
    let color_space = ColorSpace::ALL.get(usize::from(cursor.u8("color_space")?)).copied();
    let color_space = color_space.ok_or_else(|| cursor.invalid("color_space", NEWER))?;
    let up = UpAxis::ALL.get(usize::from(cursor.u8("up")?)).copied();
    let up = up.ok_or_else(|| cursor.invalid("up", NEWER))?;
    let (name, generator) = (cursor.text("name")?, cursor.text("generator")?);
    let scene = SceneInfo {
        num_gaussians,
        num_timesteps,
        first_frame,
        frame_rate,
        downscale,
        name,
        generator,
        color_space,
        up,
    };
    Ok(Info { scene, bounds, errors: Vec::new() })
}

/// Reads `INFO` of version 1.
///
/// - returns: the description of the scene, the length of a segment, and the layers
pub(super) fn read_info_1(mut cursor: Cursor<'_>, limits: &DecodeLimits) -> Result<(Info, u32, Vec<u32>), DecodeError> {
    let info = read_scene(&mut cursor, limits)?;
    let segment_length = cursor.u32("segment_length")?;
    let layers = read_layers(&mut cursor)?;
    let legal = info.scene.check(1).and_then(|()| check_division(info.scene.num_gaussians, &layers, segment_length));
    legal.map_err(|violation| cursor.invalid(violation.field, violation.problem))?;
    cursor.finish()?;
    Ok((info, segment_length, layers))
}

/// Reads `INFO` of version 2.
pub(super) fn read_info_2(mut cursor: Cursor<'_>, limits: &DecodeLimits) -> Result<Info, DecodeError> {
    let mut info = read_scene(&mut cursor, limits)?;
    for _ in 0..cursor.u8("number of errors")? {
        let (name, error) = (cursor.text("name of an attribute")?, cursor.f32("error")?);
        if !(error.is_finite() && error >= 0.0) {
            return Err(cursor.invalid("error", "negative or not finite"));
        }
        info.errors.push((name, error));
    }
    info.scene.check(2).map_err(|violation| cursor.invalid(violation.field, violation.problem))?;
    cursor.finish()?;
    Ok(info)
}

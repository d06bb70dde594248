//! The sections `INFO` and `PLAN` (`docs/FORMAT.md`): counts, provenance, layers, quantizers and predictors, which a
//! decoder needs before any entropy-coded symbol.

use std::ops::Range;

use tcgs_core::Attribute;

use super::section::{Cursor, SHARED};
use super::shared::{Mode, Plan, Predictor, num_weights};
use crate::compact::{ColorSpace, SceneInfo, UpAxis, check_division};
use crate::error::DecodeError;
use crate::limits::DecodeLimits;
use crate::quantize::{Quantizer, Quantizers};

/// Most segments: the number 65535 stands for what all segments share.
pub(super) const MAX_SEGMENTS: usize = SHARED as usize;

/// Content of `INFO` and `PLAN`.
#[derive(Clone, Debug, Default)]
pub(super) struct Head {
    pub(super) info: SceneInfo,
    pub(super) plan: Plan,
    /// `[layers]`: number of Gaussians of each layer.
    pub(super) layers: Vec<u32>,
    /// `L` of the file; [`Self::segment_length`] is the length in effect.
    pub(super) segment_length: u32,
    /// Smallest and largest coordinates of means.
    pub(super) bounds: [[f32; 3]; 2],
}

impl Head {
    pub(super) fn num_timesteps(&self) -> usize {
        self.info.num_timesteps as usize
    }

    /// Length of the segments in timesteps. A scene without Gaussians or without an attribute that varies has one
    /// segment of all timesteps: otherwise a few bytes could claim 65,536 segments.
    pub(super) fn segment_length(&self) -> usize {
        let moves = self.info.num_gaussians > 0 && self.plan.varies.contains(&true);
        if moves { self.segment_length as usize } else { self.num_timesteps() }
    }

    pub(super) fn num_segments(&self) -> usize {
        self.num_timesteps().div_ceil(self.segment_length())
    }

    /// Timesteps of a segment.
    pub(super) fn span(&self, segment: usize) -> Range<usize> {
        let length = self.segment_length();
        segment * length..((segment + 1) * length).min(self.num_timesteps())
    }

    /// Gaussians of a layer.
    pub(super) fn layer(&self, layer: usize) -> Range<usize> {
        let start = self.layers[..layer].iter().map(|&n| n as usize).sum();
        start..start + self.layers[layer] as usize
    }
}

pub(super) fn write_info(head: &Head) -> Vec<u8> {
    let info = &head.info;
    let mut bytes = Vec::new();
    for count in [info.num_gaussians, info.num_timesteps, info.first_frame, info.downscale] {
        bytes.extend(count.to_le_bytes());
    }
    bytes.extend(info.frame_rate.to_le_bytes());
    for bound in head.bounds.as_flattened() {
        bytes.extend(bound.to_le_bytes());
    }
    bytes.extend([info.color_space as u8, info.up as u8]);
    for text in [&info.name, &info.generator] {
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
    }
    bytes.extend(head.segment_length.to_le_bytes());
    bytes.extend((head.layers.len() as u16).to_le_bytes());
    bytes.extend(head.layers.iter().flat_map(|n| n.to_le_bytes()));
    bytes
}

/// Fields of `INFO`, into a head without a plan.
pub(super) fn read_info(mut cursor: Cursor<'_>, limits: &DecodeLimits) -> Result<Head, DecodeError> {
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
    let color_space = color_space.ok_or_else(|| cursor.invalid("color_space", "unknown"))?;
    let up = UpAxis::ALL.get(usize::from(cursor.u8("up")?)).copied();
    let up = up.ok_or_else(|| cursor.invalid("up", "unknown"))?;
    let (name, generator) = (cursor.text("name")?, cursor.text("generator")?);
    let segment_length = cursor.u32("segment_length")?;
    let num_layers = cursor.u16("number of layers")?;
    let layers = (0..num_layers).map(|_| cursor.u32("layers")).collect::<Result<Vec<u32>, _>>()?;
    let info = SceneInfo {
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
    let legal = info.check().and_then(|()| check_division(num_gaussians, &layers, segment_length));
    legal.map_err(|violation| cursor.invalid(violation.field, violation.problem))?;
    cursor.finish()?;
    Ok(Head { info, layers, segment_length, bounds, plan: Plan::default() })
}

fn attribute_bits(flags: &[bool; 5]) -> u8 {
    flags.iter().enumerate().map(|(index, &flag)| u8::from(flag) << index).sum()
}

/// Interpolation between keypoints; only linear is known.
const LINEAR: u8 = 0;

pub(super) fn write_plan(plan: &Plan) -> Vec<u8> {
    let mut section = vec![attribute_bits(&plan.varies), attribute_bits(&plan.joint)];
    for attribute in Attribute::BASE {
        let a = attribute.index();
        section.push(LINEAR);
        section.push(plan.quantizers.attributes[a].len() as u8);
        for (&width, channels) in &plan.quantizers.attributes[a] {
            section.push(width);
            for quantizer in channels {
                section.extend(quantizer.step.to_le_bytes());
                section.extend(quantizer.offset.to_le_bytes());
            }
        }
        if attribute != Attribute::Mean {
            for predictor in &plan.predictors[a] {
                section.push(predictor.mode as u8);
                section.extend(predictor.weights.iter().flat_map(|w| w.to_le_bytes()));
            }
        }
    }
    section
}

pub(super) fn read_plan(mut cursor: Cursor<'_>) -> Result<Plan, DecodeError> {
    let varies = cursor.attributes("varying attributes")?;
    let joint = cursor.attributes("joint attributes")?;
    let mut quantizers = Quantizers::default();
    let mut predictors: [Vec<Predictor>; 5] = Default::default();
    for attribute in Attribute::BASE {
        let (a, components) = (attribute.index(), attribute.components());
        if cursor.u8("interpolation")? != LINEAR {
            return Err(cursor.invalid("interpolation", "unknown"));
        }
        let by_width = &mut quantizers.attributes[a];
        for _ in 0..cursor.u8("number of widths")? {
            let bits = cursor.u8("width")?;
            if by_width.last_key_value().is_some_and(|(&last, _)| last >= bits) {
                return Err(cursor.invalid("width", "not ascending"));
            }
            let mut channels = Vec::with_capacity(components);
            for _ in 0..components {
                let quantizer = Quantizer { step: cursor.f32("step")?, offset: cursor.f32("offset")?, bits };
                if let Some(problem) = quantizer.problem() {
                    return Err(cursor.invalid("quantizer", problem));
                }
                channels.push(quantizer);
            }
            by_width.insert(bits, channels);
        }
        if attribute != Attribute::Mean {
            for channel in 0..components {
                let mode = Mode::ALL.get(usize::from(cursor.u8("mode")?)).copied();
                let mode = mode.ok_or_else(|| cursor.invalid("mode", "unknown"))?;
                let mut weights = Vec::with_capacity(num_weights(components, channel));
                for _ in 0..weights.capacity() {
                    weights.push(cursor.f32("weight")?);
                }
                if weights.iter().any(|w| !w.is_finite()) {
                    return Err(cursor.invalid("weight", "not finite"));
                }
                predictors[a].push(Predictor { mode, weights });
            }
        }
    }
    cursor.finish()?;
    Ok(Plan { varies, joint, quantizers, predictors })
}

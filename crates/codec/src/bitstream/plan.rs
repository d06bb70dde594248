//! The plan of a cohort (`docs/FORMAT.md`, "Plan"): the attributes of its Gaussians, and the coding of their tracks. It
//! holds for all layers and segments.

use std::sync::Arc;

use tcgs_core::{Activation, Attribute, Column, Layout, Life};

use super::head::write_text;
use super::neighbors::Neighbors;
use super::section::{Cursor, SKIPPED, Tag, of_attribute};
use crate::error::{DecodeError, NEWER};
use crate::quantize::{Quantizer, Quantizers};

/// Largest number of components of an attribute.
pub(super) const MAX_COMPONENTS: usize = 32;
/// Number of preceding components from which an attribute beyond [`Attribute::BASE`] is predicted.
pub(super) const RECENT: usize = 3;
/// Interpolation between keypoints; linear is the only known kind.
const LINEAR: u8 = 0;
/// Number of flag bits of an attribute below its coding: it varies, is joint, may be lacking, is optional.
const NUM_FLAGS: u8 = 4;
/// The only known coding: codes of tracks, with quantizers and predictors in the plan.
const OF_TRACKS: u8 = 0;

/// Coding of the tracks of a cohort, the same for all layers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    pub(super) layout: Arc<Layout>,
    /// By attribute: whether it varies with time.
    pub(super) varies: Vec<bool>,
    /// By attribute: whether its components share their keypoint times.
    pub(super) joint: Vec<bool>,
    /// By attribute: whether some Gaussians lack it; a lacking attribute has width 0.
    pub(super) sparse: Vec<bool>,
    pub(super) quantizers: Quantizers,
    /// By attribute: predictors of first codes; empty for means.
    pub(super) predictors: Vec<Vec<Predictor>>,
    /// Optional attributes of unknown codings, by ascending place.
    pub(super) skipped: Vec<Skipped>,
}

/// An optional attribute whose coding this decoder does not know; its sections are skipped.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Skipped {
    /// Place in the list of attributes of the file.
    pub(super) place: usize,
    pub(super) name: String,
    pub(super) unit: String,
    /// Bytes of components, activation and coding in the file.
    pub(super) described: [u8; 3],
    /// Whether it has sections in segments.
    pub(super) varies: bool,
}

impl Skipped {
    /// Whether another cohort describes the same attribute.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        Self { varies: other.varies, ..self.clone() } == *other
    }
}

/// An attribute in the list of a plan.
pub(super) enum Listed<'a> {
    Known(Attribute),
    Skipped(&'a Skipped),
}

impl Listed<'_> {
    /// Tag of the attribute's sections.
    pub(super) fn tag(&self) -> Tag {
        match self {
            Self::Known(attribute) => of_attribute(*attribute),
            Self::Skipped(_) => SKIPPED,
        }
    }
}

impl Plan {
    /// A plan without quantizers in which no attribute varies.
    pub(super) fn new(layout: Arc<Layout>) -> Self {
        let num_columns = layout.columns().len();
        Self {
            varies: vec![false; num_columns],
            joint: vec![false; num_columns],
            sparse: vec![false; num_columns],
            quantizers: Quantizers::none(&layout),
            predictors: vec![Vec::new(); num_columns],
            skipped: Vec::new(),
            layout,
        }
    }

    /// All attributes in the order of the file, including skipped ones.
    pub(super) fn listed(&self) -> impl Iterator<Item = Listed<'_>> {
        let (mut known, mut skipped) = (self.layout.attributes(), self.skipped.iter().peekable());
        (0..self.num_listed()).map(move |place| match skipped.next_if(|skipped| skipped.place == place) {
            Some(skipped) => Listed::Skipped(skipped),
            None => Listed::Known(known.next().expect("an attribute at every place that is not skipped")),
        })
    }

    /// Number of all attributes in the file.
    pub(super) fn num_listed(&self) -> usize {
        self.layout.columns().len() + self.skipped.len()
    }

    /// The attributes of [`Self::listed`] that have sections in segments.
    pub(super) fn listed_varying(&self) -> impl Iterator<Item = Listed<'_>> {
        self.listed().filter(|listed| match listed {
            Listed::Known(attribute) => self.varies[attribute.index()],
            Listed::Skipped(skipped) => skipped.varies,
        })
    }

    /// Name of an attribute of the list.
    pub(super) fn name_of<'a>(&'a self, listed: Listed<'a>) -> &'a str {
        match listed {
            Listed::Known(attribute) => self.layout.name(attribute),
            Listed::Skipped(skipped) => &skipped.name,
        }
    }

    /// The attributes that vary with time.
    pub(super) fn varying(&self) -> impl Iterator<Item = Attribute> {
        self.layout.attributes().filter(|a| self.varies[a.index()])
    }

    /// Number of components of a unit of an attribute: those that share their times.
    pub(super) fn channels(&self, attribute: Attribute) -> usize {
        if self.joint[attribute.index()] { attribute.components() } else { 1 }
    }

    /// Memory per Gaussian of the shared layers, bytes.
    pub(super) fn bytes_per_gaussian(&self) -> usize {
        let attributes = self.layout.attributes().map(|attribute| {
            let components = attribute.components();
            let varying = components * size_of::<bool>() + components / self.channels(attribute) * size_of::<u32>();
            let varies = usize::from(self.varies[attribute.index()]);
            size_of::<u8>() + components * size_of::<i16>() + varies * varying
        });
        attributes.sum::<usize>() + size_of::<Life>() + Neighbors::BYTES_PER_GAUSSIAN
    }
}

/// Prediction of the first codes of a component.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Predictor {
    pub(super) mode: Mode,
    /// Weights of the features ([`Features`]).
    pub(super) weights: Vec<f32>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Mode {
    /// The code, in the context of its prediction.
    #[default]
    Code = 0,
    /// The difference to its prediction.
    Difference = 1,
    /// The code, in the context of `sqrt(1 - Σ x²)` over the components before: the length left in a unit vector.
    Length = 2,
}

impl Mode {
    pub(super) const ALL: [Self; 3] = [Self::Code, Self::Difference, Self::Length];
}

/// Number of features, and so of weights, of a component's predictor.
pub(super) fn num_weights(attribute: Attribute, channel: usize) -> usize {
    match attribute {
        Attribute::Extra { .. } => 3 + channel.min(RECENT),
        _ => 1 + 2 * attribute.components() + channel,
    }
}

/// Writes the plan of a file of version 1, which has the attributes of [`Attribute::BASE`].
pub(super) fn write_plan_1(plan: &Plan) -> Vec<u8> {
    let bits = |flags: &[bool]| flags.iter().enumerate().map(|(a, &flag)| u8::from(flag) << a).sum();
    let mut bytes = vec![bits(&plan.varies), bits(&plan.joint)];
    plan.layout.attributes().for_each(|attribute| write_attribute(&mut bytes, plan, attribute));
    bytes
}

/// Writes the plan of a cohort of version 2.
pub(super) fn write_plan_2(plan: &Plan) -> Vec<u8> {
    let mut bytes = vec![plan.layout.columns().len() as u8];
    for column in plan.layout.columns() {
        let a = column.attribute.index();
        write_text(&mut bytes, &column.name);
        write_text(&mut bytes, &column.unit);
        let activation = Activation::ALL.iter().position(|&known| known == column.activation);
        let flags = [plan.varies[a], plan.joint[a], plan.sparse[a]];
        let flags: u8 = flags.into_iter().enumerate().map(|(i, flag)| u8::from(flag) << i).sum();
        bytes.extend([column.components() as u8, activation.expect("one of all activations") as u8, flags]);
        write_attribute(&mut bytes, plan, column.attribute);
    }
    bytes
}

/// Writes quantizers and predictors of an attribute.
fn write_attribute(bytes: &mut Vec<u8>, plan: &Plan, attribute: Attribute) {
    let a = attribute.index();
    bytes.push(LINEAR);
    bytes.push(plan.quantizers.attributes[a].len() as u8);
    for (&width, channels) in &plan.quantizers.attributes[a] {
        bytes.push(width);
        for quantizer in channels {
            bytes.extend(quantizer.step.to_le_bytes());
            bytes.extend(quantizer.offset.to_le_bytes());
        }
    }
    if attribute != Attribute::Mean {
        for predictor in &plan.predictors[a] {
            bytes.push(predictor.mode as u8);
            bytes.extend(predictor.weights.iter().flat_map(|w| w.to_le_bytes()));
        }
    }
}

/// Reads the plan of a file of version 1.
pub(super) fn read_plan_1(mut cursor: Cursor<'_>) -> Result<Plan, DecodeError> {
    let mut plan = Plan::new(Layout::base());
    let mut flags = |field| {
        let bits = cursor.u8(field)?;
        if bits >> Attribute::BASE.len() > 0 {
            return Err(cursor.invalid(field, "more attributes than there are"));
        }
        Ok((0..Attribute::BASE.len()).map(|a| bits >> a & 1 > 0).collect::<Vec<bool>>())
    };
    plan.varies = flags("varying attributes")?;
    plan.joint = flags("joint attributes")?;
    for attribute in Attribute::BASE {
        read_attribute(&mut cursor, &mut plan, attribute)?;
    }
    cursor.finish()?;
    Ok(plan)
}

/// Reads the plan of a cohort of version 2.
pub(super) fn read_plan_2(cursor: &mut Cursor<'_>) -> Result<Plan, DecodeError> {
    let num_listed = usize::from(cursor.u8("number of attributes")?);
    let mut layout = Layout::default();
    let mut plan = Plan::new(Layout::base());
    for place in 0..num_listed {
        let (name, unit) = (cursor.text("name of an attribute")?, cursor.text("unit")?);
        let is_base = place < Attribute::BASE.len();
        if !is_base && (layout.find(&name).is_some() || plan.skipped.iter().any(|skipped| skipped.name == name)) {
            return Err(cursor.invalid("name of an attribute", "that of another attribute"));
        }
        let [components, activation] = [cursor.u8("components")?, cursor.u8("activation")?];
        let flags = cursor.u8("flags of an attribute")?;
        let [varies, joint, sparse, optional] = [0, 1, 2, 3].map(|i| flags >> i & 1 > 0);
        let coding = flags >> NUM_FLAGS;
        if coding != OF_TRACKS {
            if !optional || is_base {
                return Err(cursor.invalid("coding of an attribute", NEWER));
            }
            let bytes = cursor.u32("length of an attribute")?;
            cursor.take("length of an attribute", bytes as usize)?;
            plan.skipped.push(Skipped { place, name, unit, described: [components, activation, coding], varies });
            continue;
        }
        let (a, components) = (place - plan.skipped.len(), usize::from(components));
        let activation = Activation::ALL.get(usize::from(activation)).copied();
        let activation = activation.ok_or_else(|| cursor.invalid("activation", NEWER))?;
        let attribute = match Attribute::BASE.get(a) {
            Some(&attribute) => {
                let known = Column::like(attribute);
                if (name.as_str(), components, activation)
                    != (attribute.name(), attribute.components(), known.activation)
                {
                    return Err(cursor.invalid("name of an attribute", "not the attribute that is due"));
                }
                if sparse || optional {
                    let problem = "one that every Gaussian has may be lacking or left out";
                    return Err(cursor.invalid("flags of an attribute", problem));
                }
                attribute
            }
            None => {
                if !(1..=MAX_COMPONENTS).contains(&components) {
                    return Err(cursor.invalid("components", "not within 1 to 32"));
                }
                // Whether the attribute varies is a property of the plan, and may differ between cohorts.
                let column = Column { activation, unit, varies: false, ..Column::like(Attribute::Color) };
                layout.push(&name, components, column)
            }
        };
        if a >= plan.varies.len() {
            [&mut plan.varies, &mut plan.joint, &mut plan.sparse].into_iter().for_each(|flags| flags.push(false));
            plan.quantizers.attributes.push(Default::default());
            plan.predictors.push(Vec::new());
        }
        (plan.varies[a], plan.joint[a], plan.sparse[a]) = (varies, joint, sparse);
        read_attribute(cursor, &mut plan, attribute)?;
    }
    if num_listed < Attribute::BASE.len() {
        return Err(cursor.invalid("number of attributes", "fewer than every Gaussian has"));
    }
    plan.layout = Arc::new(layout);
    Ok(plan)
}

/// Reads quantizers and predictors of an attribute.
fn read_attribute(cursor: &mut Cursor<'_>, plan: &mut Plan, attribute: Attribute) -> Result<(), DecodeError> {
    let (a, components) = (attribute.index(), attribute.components());
    if cursor.u8("interpolation")? != LINEAR {
        return Err(cursor.invalid("interpolation", NEWER));
    }
    let by_width = &mut plan.quantizers.attributes[a];
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
            let mode = mode.ok_or_else(|| cursor.invalid("mode", NEWER))?;
            let mut weights = Vec::with_capacity(num_weights(attribute, channel));
            for _ in 0..weights.capacity() {
                weights.push(cursor.f32("weight")?);
            }
            if weights.iter().any(|w| !w.is_finite()) {
                return Err(cursor.invalid("weight", "not finite"));
            }
            plan.predictors[a].push(Predictor { mode, weights });
        }
    }
    Ok(())
}

//! The request of one iteration as the shaders read it, and the text that every shader starts with.

use tcgs_render::TILE;
use tcgs_render::device::{ViewPart, Wgsl};

use super::packing::{Packing, SmallGroup};
use super::scenery_lists::ListedView;
use crate::adam::{BETA1, BETA2, EPSILON, adam_factors};
use crate::engine::Step;
use crate::fake_quant::MIN_STEP_SHARE;
use crate::losses::{Loss, WeightConfig};
use crate::state::State;

/// Values per slot in the ring of losses: those of [`Loss::ALL`] before their weights, the status, zeros.
pub const LOSS_VALUES: usize = (Loss::ALL.len() + 1).next_multiple_of(16);

/// Position of the status in a row of losses: not 0 if the device had halted.
const STATUS: usize = Loss::ALL.len();

/// One iteration, written by the host before it; with its rates ([`Self::bytes`]) the twin of `Step` in `step.wgsl`.
///
/// Counts and positions are of elements.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct StepUniform {
    /// `N`
    pub num_gaussians: u32,
    /// `F`
    pub num_foreground: u32,
    /// Edges of a foreground Gaussian.
    pub per_node: u32,
    /// `B`
    pub num_background: u32,
    /// `K`
    pub num_cameras: u32,
    /// Position of this view's camera.
    pub camera: u32,
    /// Slot of this iteration in the ring of losses.
    pub slot: u32,
    /// Sum of [`Self::MASKED`] and the others.
    pub flags: u32,
    /// Width of this view's image, pixels.
    pub width: u32,
    /// Height of this view's image, pixels.
    pub height: u32,
    /// `Q`
    pub num_quantizers: u32,
    /// Position of this view's first value in the targets.
    pub target_offset: u32,
    /// Gaussians that move: the first ones.
    pub num_active: u32,
    /// Gaussians that are drawn, the state's first.
    pub num_drawn: u32,
    /// Tiles of this view's image that are drawn.
    pub num_tiles: u32,
    /// Blocks of this view's image that are compared: these tiles and those around them.
    pub num_blocks: u32,
    /// Position of this view's first slot in the lists.
    pub slots_at: u32,
    /// Position of this view's first value in the pictures.
    pub pictures_at: u32,
    /// Gaussians in this view's list.
    pub num_listed: u32,
    /// Position of this view's list in the lists.
    pub lists_at: u32,
    /// Position of this view's first value in the colours that views see.
    pub colors_at: u32,
    /// `x` of this view's camera in world space.
    pub eye_x: f32,
    /// `y` of this view's camera in world space.
    pub eye_y: f32,
    /// `z` of this view's camera in world space.
    pub eye_z: f32,
    /// `ε` of the masks.
    pub mask_threshold: f32,
    /// Smallest share of its initial value to which a quantizer's step may fall.
    pub step_min_share: f32,
    /// Share of the Gaussians that are left out.
    pub drop_share: f32,
    /// Number of the draw that chooses them.
    pub drop_draw: u32,
    /// [`WeightConfig::values`]; `floor` is 0 without segmentation.
    pub weights: [f32; Loss::ALL.len()],
}

/// The image that an iteration compares with, and its position in the device's memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ViewPlace {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Position of the camera in world space.
    pub eye: [f32; 3],
    /// Position of the image's first value.
    pub target_offset: u32,
    /// Whether all images have a segmentation.
    pub segmented: bool,
    /// The drawn part of the scene; none if everything is drawn.
    pub part: Option<PartPlace>,
}

/// A part of a scene and of an image, and the position of its lists in the device's memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PartPlace {
    /// As in [`StepUniform`].
    pub num_drawn: u32,
    /// The view's lists.
    pub view: ListedView,
}

impl StepUniform {
    /// Masks are on.
    pub const MASKED: u32 = 1;
    /// The densification statistic is counted.
    pub const COUNTS: u32 = 2;
    /// Gaussians move.
    pub const MOVES: u32 = 4;
    /// Fake quantisation is on.
    pub const QUANTIZED: u32 = 8;
    /// `L_mc` is on: there are mask logits of the timestep before.
    pub const COMPARES_MASKS: u32 = 16;
    /// Two channels of segmentation beside the colours.
    pub const SEGMENTED: u32 = 32;
    /// Losses on motion are on.
    pub const HAS_PRIOR: u32 = 64;
    /// Quantizers' offsets are learned.
    pub const LEARNED_OFFSET: u32 = 128;
    /// A part of the scene is trained.
    pub const LISTED: u32 = 256;
    /// The cameras' gains and offsets are centered.
    pub const CENTERS_CAMERAS: u32 = 512;

    /// Names of the flags in the shaders.
    const FLAGS: [(&str, u32); 10] = [
        ("MASKED", Self::MASKED),
        ("COUNTS", Self::COUNTS),
        ("MOVES", Self::MOVES),
        ("QUANTIZED", Self::QUANTIZED),
        ("COMPARES_MASKS", Self::COMPARES_MASKS),
        ("SEGMENTED", Self::SEGMENTED),
        ("HAS_PRIOR", Self::HAS_PRIOR),
        ("LEARNED_OFFSET", Self::LEARNED_OFFSET),
        ("LISTED", Self::LISTED),
        ("CENTERS_CAMERAS", Self::CENTERS_CAMERAS),
    ];

    /// The uniform of `step` for a state of this shape, with slot 0.
    pub(crate) fn of(step: &Step<'_>, view: ViewPlace, state: &State) -> Self {
        let (past, quantizers) = (state.past.as_ref(), state.quantizers.as_ref());
        let num_gaussians = state.parameters.num_gaussians();
        let num_foreground = past.map_or(0, |past| past.neighbors.foreground.len());
        let compares_masks = past.is_some_and(|past| past.previous_mask_logits.is_some());
        let flags = [
            (step.mask.enabled, Self::MASKED),
            (step.counts_gradients, Self::COUNTS),
            (step.moves_gaussians, Self::MOVES),
            (quantizers.is_some(), Self::QUANTIZED),
            (step.mask.enabled && compares_masks, Self::COMPARES_MASKS),
            (view.segmented, Self::SEGMENTED),
            (past.is_some(), Self::HAS_PRIOR),
            (quantizers.is_some_and(|q| q.learned_offset), Self::LEARNED_OFFSET),
            (view.part.is_some(), Self::LISTED),
            (step.rates.camera > 0.0 && step.rates.centers_cameras, Self::CENTERS_CAMERAS),
        ];
        let whole = num_gaussians as u32;
        let tiles = view.width.div_ceil(TILE as u32) * view.height.div_ceil(TILE as u32);
        let part = view.part.map(|part| (part.num_drawn, part.view));
        let [num_active, num_drawn, num_tiles, num_blocks] = match part {
            Some((num_drawn, view)) => [view.part.num_active, num_drawn, view.part.num_tiles, view.num_near],
            None => [state.num_trained() as u32, whole, tiles, tiles],
        };
        let [num_listed, lists_at, slots_at, pictures_at, colors_at] = part.map_or([0; 5], |(_, view)| {
            let ViewPart { num_listed, lists_at, .. } = view.part;
            [num_listed, lists_at, view.slots_at, view.pictures_at, view.colors_at]
        });
        let [eye_x, eye_y, eye_z] = view.eye;
        // Without segmentation the foreground, which alone stands on the floor, is unknown.
        let floor = if view.segmented { step.weights.floor } else { 0.0 };
        Self {
            num_gaussians: num_gaussians as u32,
            num_foreground: num_foreground as u32,
            per_node: past.map_or(0, |past| past.neighbors.per_node as u32),
            num_background: if past.is_some() { (num_gaussians - num_foreground) as u32 } else { 0 },
            num_cameras: state.parameters.camera_gains.len() as u32,
            camera: step.camera as u32,
            slot: 0,
            flags: flags.iter().map(|&(on, flag)| if on { flag } else { 0 }).sum(),
            width: view.width,
            height: view.height,
            num_quantizers: quantizers.map_or(0, |q| q.quantizers.len() as u32),
            target_offset: view.target_offset,
            num_active,
            num_drawn,
            num_tiles,
            num_blocks,
            slots_at,
            pictures_at,
            num_listed,
            lists_at,
            colors_at,
            eye_x,
            eye_y,
            eye_z,
            mask_threshold: step.mask.threshold,
            step_min_share: MIN_STEP_SHARE,
            drop_share: step.dropout.share,
            drop_draw: step.dropout.draw,
            weights: WeightConfig { floor, ..*step.weights }.values(),
        }
    }

    /// Whether a flag is set.
    pub(crate) fn has(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }

    /// Bytes of the uniform and of its rates.
    pub fn size(packing: &Packing) -> usize {
        size_of::<Self>().next_multiple_of(16) + 16 * packing.num_groups()
    }

    /// The uniform as the shaders read it.
    ///
    /// - `rates`: [`adam_rates`] of every group: the columns in their order, the mask logits, the cameras' gains and
    ///   offsets, quantizers' steps and offsets
    pub fn bytes(&self, rates: &[[f32; 4]]) -> Vec<u8> {
        let mut bytes = bytemuck::bytes_of(self).to_vec();
        bytes.resize(bytes.len().next_multiple_of(16), 0);
        bytes.extend_from_slice(bytemuck::cast_slice(rates));
        bytes
    }
}

/// Adam's factors for one group, as a shader reads them: `(step size, correction, ε, 0)`.
///
/// - `rate`: learning rate; 0 leaves the group as it is
/// - `count`: updates including this one, from 1
/// - `epsilon`: Adam's ε
pub fn adam_rates(rate: f32, count: u64, epsilon: f32) -> [f32; 4] {
    let [step_size, correction] = adam_factors(rate, count);
    [step_size, correction, epsilon, 0.0]
}

/// Counts an iteration for Adam; the device does not.
///
/// - returns: [`adam_rates`] of every group, 0 for a group that does not move
pub(crate) fn count_updates(step: &Step<'_>, packing: &Packing, state: &mut State) -> Vec<[f32; 4]> {
    let (has_quantizers, learned_offset) =
        state.quantizers.as_ref().map_or((false, false), |q| (!q.quantizers.is_empty(), q.learned_offset));
    let (o, rates, moves) = (&mut state.optimizer, &step.rates, step.moves_gaussians);
    let mut counted = vec![[0.0; 4]; packing.num_groups()];
    let mut count = |group: usize, updates: &mut u64, rate: f32, epsilon: f32, is_on: bool| {
        if is_on {
            *updates += 1;
            counted[group] = adam_rates(rate, *updates, epsilon);
        }
    };
    for column in packing.layout().columns() {
        let group = column.attribute.index();
        count(group, &mut o.steps[group], rates.of(column), rates.epsilon_of(column), moves);
    }
    let mut count = |group, updates: &mut u64, rate, is_on| count(group, updates, rate, EPSILON, is_on);
    let small = |group| packing.small_group(group);
    count(small(SmallGroup::Mask), &mut o.mask.step, rates.mask, moves && step.mask.enabled);
    count(small(SmallGroup::Gains), &mut o.gains.step, rates.camera, rates.camera > 0.0);
    count(small(SmallGroup::Offsets), &mut o.offsets.step, rates.camera, rates.camera > 0.0);
    count(small(SmallGroup::Steps), &mut o.quantizer_steps.step, rates.step, has_quantizers);
    let offsets = has_quantizers && learned_offset;
    count(small(SmallGroup::QuantizerOffsets), &mut o.quantizer_offsets.step, rates.step, offsets);
    counted
}

/// The values of [`Loss::ALL`] in a slot of the ring of losses; none if the device had halted.
pub(crate) fn losses_of(row: &[f32; LOSS_VALUES]) -> Option<[f64; Loss::ALL.len()]> {
    (row[STATUS] == 0.0).then(|| std::array::from_fn(|i| f64::from(row[i])))
}

/// A source with the uniform's declaration, its flags, Adam's constants, and the positions of columns and losses.
///
/// - `constants`: further constants of the shader
pub(crate) fn source(packing: &Packing, constants: Wgsl) -> Wgsl {
    let weights: Vec<String> = Loss::ALL.iter().map(|loss| format!("{}_weight: f32,", loss.name())).collect();
    let mut source = constants
        .part(&packing.constants().finish())
        .part(&include_str!("step.wgsl").replace("    WEIGHTS", &format!("    {}", weights.join("\n    "))));
    for (name, flag) in StepUniform::FLAGS {
        source = source.constant(name, flag);
    }
    for (place, loss) in Loss::ALL.iter().enumerate() {
        source = source.constant(&format!("LOSS_{}", loss.name().to_uppercase()), place);
    }
    source
        .constant("LOSS_STATUS", STATUS)
        .constant("LOSS_VALUES", LOSS_VALUES)
        .constant("BETA1", BETA1)
        .constant("BETA2", BETA2)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tcgs_core::{Attribute, Column, Gaussians, Layout};

    use super::*;
    use crate::config::TrainConfig;
    use crate::dropout::Dropout;
    use crate::parameters::Parameters;
    use crate::schedule::{Phase, Rates, Schedule};

    #[test]
    fn every_group_that_moves_is_counted() {
        let mut layout = Layout::default();
        layout.push("wetness", 2, Column { varies: false, ..Column::like(Attribute::Color) });
        let packing = Packing::new(&Arc::new(layout));
        let parameters = Parameters {
            gaussians: Gaussians::zeros_of(packing.layout(), 2),
            foreground: vec![true; 2],
            mask_logits: vec![0.0; 2],
            camera_gains: vec![[0.0; 3]],
            camera_offsets: vec![[0.0; 3]],
        };
        let (mut state, mut config) = (State::new(parameters), TrainConfig::default());
        config.mask.enabled = true;
        let rates = Rates { color_epsilon: 0.5, ..Schedule::new(&config, 1.0).rates(Phase::First, 0) };
        let (weights, mask) = (&config.weights, &config.mask);
        let step = Step {
            camera: 0,
            rates,
            weights,
            mask,
            counts_gradients: false,
            dropout: Dropout::default(),
            moves_gaussians: true,
        };
        let counted = count_updates(&step, &packing, &mut state);
        assert_eq!((counted.len(), &state.optimizer.steps[..]), (11, &[1; 6][..]));
        let (small, color) = (EPSILON, rates.color_epsilon);
        for (group, rate, epsilon) in
            [(0, rates.mean, small), (4, rates.color, color), (6, rates.mask, small), (7, rates.camera, small)]
        {
            assert_eq!(counted[group], adam_rates(rate, 1, epsilon), "{group}");
        }
        assert_eq!((counted[9], counted[10], state.optimizer.quantizer_steps.step), ([0.0; 4], [0.0; 4], 0));
        let still = Step { moves_gaussians: false, ..step };
        assert_eq!(count_updates(&still, &packing, &mut state)[0], [0.0; 4]);
        assert_eq!((state.optimizer.steps[0], state.optimizer.gains.step), (1, 2));
    }

    #[test]
    fn a_row_of_losses_tells_of_a_halt() {
        let mut row: [f32; LOSS_VALUES] = std::array::from_fn(|i| i as f32);
        assert_eq!(losses_of(&row), None);
        row[STATUS] = 0.0;
        assert_eq!(losses_of(&row).map(|values| values[9]), Some(9.0));
    }

    #[test]
    fn the_uniform_has_the_layout_of_the_shader() {
        let packing = Packing::new(&Layout::base());
        let source = source(&packing, Wgsl::new()).finish();
        let module = wgpu::naga::front::wgsl::parse_str(&source).expect("the shader parses");
        let (_, declared) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some("Step")).expect("a Step");
        let wgpu::naga::TypeInner::Struct { members, span } = &declared.inner else { panic!("not a struct") };
        assert_eq!(*span as usize, StepUniform::size(&packing));
        let rates = vec![[0.0; 4]; packing.num_groups()];
        assert_eq!(StepUniform::default().bytes(&rates).len(), *span as usize);
        // Every member but the last is one word, so names and order give the positions.
        let text = format!("{:?}", StepUniform::default());
        let (words, rates) = members.split_at(members.len() - 1);
        let (plain, weights) = words.split_at(words.len() - Loss::ALL.len());
        let mut rest = text.as_str();
        for (i, member) in plain.iter().enumerate() {
            let name = member.name.as_deref().expect("a name");
            let at = rest.find(&format!("{name}: ")).unwrap_or_else(|| panic!("{name} is missing or out of order"));
            rest = &rest[at + name.len()..];
            assert_eq!(member.offset as usize, 4 * i, "{name}");
        }
        for (i, (member, loss)) in weights.iter().zip(Loss::ALL).enumerate() {
            assert_eq!(member.name, Some(format!("{}_weight", loss.name())));
            assert_eq!(member.offset as usize, std::mem::offset_of!(StepUniform, weights) + 4 * i);
        }
        assert_eq!(rates[0].offset as usize, size_of::<StepUniform>().next_multiple_of(16));
    }
}

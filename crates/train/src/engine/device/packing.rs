//! Positions of a layout's columns in a device's memory, and the shaders' names for them.

use std::sync::Arc;

use tcgs_core::{Attribute, Columns, Layout};
use tcgs_render::device::Wgsl;

/// Groups of quantizers that one word holds: a byte each.
const GROUPS_A_WORD: usize = 4;

/// Names in the shaders of the columns that they know: `MEAN_AT` is where the means begin.
const NAMES: [(&str, Attribute); 5] = [
    ("MEAN", Attribute::Mean),
    ("QUAT", Attribute::Quat),
    ("LOG_SCALE", Attribute::LogScale),
    ("LOGIT_OPACITY", Attribute::LogitOpacity),
    ("COLOR", Attribute::Color),
];

/// Groups of Adam after those of the columns, in this order: one learning rate and one count of updates each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SmallGroup {
    /// Mask logits, which lie behind the columns.
    Mask,
    /// Logarithms of the cameras' gains.
    Gains,
    /// The cameras' offsets.
    Offsets,
    /// Quantizers' steps.
    Steps,
    /// Quantizers' offsets.
    QuantizerOffsets,
}

impl SmallGroup {
    const ALL: [(&str, Self); 5] = [
        ("ADAM_MASK", Self::Mask),
        ("ADAM_GAINS", Self::Gains),
        ("ADAM_OFFSETS", Self::Offsets),
        ("ADAM_STEPS", Self::Steps),
        ("ADAM_QUANTIZER_OFFSETS", Self::QuantizerOffsets),
    ];
}

/// How `N` Gaussians of a layout lie in one array of f32: column after column, each `[N, components]`, then `[N]` mask
/// logits. Parameters, gradients and both moments lie so.
///
/// ```
/// use tcgs_core::Layout;
/// use tcgs_train::engine::gpu::testing::Packing;
/// assert_eq!(Packing::new(&Layout::base()).values(), 15);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Packing {
    layout: Arc<Layout>,
}

impl Packing {
    /// Packs all columns of `layout`.
    pub fn new(layout: &Arc<Layout>) -> Self {
        Self { layout: Arc::clone(layout) }
    }

    /// The layout whose columns are packed.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// Values of one Gaussian: all columns, and the mask logit.
    pub fn values(&self) -> usize {
        self.layout.components() + 1
    }

    /// Values of one Gaussian before a column: the column begins at this many times `N`.
    pub fn offset(&self, attribute: Attribute) -> usize {
        self.layout.offset(attribute)
    }

    /// One array from columns and mask logits.
    ///
    /// - `columns`: of this layout
    /// - `mask`: `[N]`
    /// - returns: `[values * N]`
    pub fn pack<Role>(&self, columns: &Columns<Role>, mask: &[f32]) -> Vec<f32> {
        let mut packed = Vec::with_capacity(self.values() * mask.len());
        self.layout.attributes().for_each(|attribute| packed.extend_from_slice(columns.values(attribute)));
        packed.extend_from_slice(mask);
        packed
    }

    /// Overwrites columns and mask logits with what [`Self::pack`] makes of them.
    ///
    /// # Panics
    /// If lengths disagree.
    pub fn unpack<Role>(&self, mut packed: &[f32], columns: &mut Columns<Role>, mask: &mut [f32]) {
        for attribute in self.layout.attributes() {
            let values = columns.values_mut(attribute);
            let (own, rest) = packed.split_at(values.len());
            values.copy_from_slice(own);
            packed = rest;
        }
        mask.copy_from_slice(packed);
    }

    /// Values of one Gaussian in each group of Adam that moves Gaussians: the columns, then the mask.
    pub(crate) fn group_components(&self) -> impl Iterator<Item = usize> {
        self.layout.columns().iter().map(|column| column.components()).chain([1])
    }

    /// Number of all groups of Adam.
    pub fn num_groups(&self) -> usize {
        self.layout.columns().len() + SmallGroup::ALL.len()
    }

    /// Position of a group that is no column's; a column's is [`Attribute::index`].
    pub(crate) fn small_group(&self, group: SmallGroup) -> usize {
        self.layout.columns().len() + group as usize
    }

    /// The columns that training quantises, in the order of the bytes that name their groups of quantizers.
    pub(crate) fn quantized(&self) -> impl Iterator<Item = Attribute> {
        crate::fake_quant::quantized(&self.layout)
    }

    /// Words that hold a byte for each quantised column of one Gaussian.
    pub(crate) fn group_words(&self) -> usize {
        self.quantized().count().div_ceil(GROUPS_A_WORD).max(1)
    }

    /// Where the byte of the `place`th quantised column of Gaussian `n` lies: the word in `[words, N]`, and the shift.
    pub(crate) fn group_byte(place: usize, n: usize, num_gaussians: usize) -> (usize, usize) {
        (place / GROUPS_A_WORD * num_gaussians + n, 8 * (place % GROUPS_A_WORD))
    }

    /// The shaders' names for these positions.
    pub(crate) fn constants(&self) -> Wgsl {
        let mut source = Wgsl::new();
        for (name, attribute) in NAMES {
            source = source.constant(&format!("{name}_AT"), self.offset(attribute));
            if let Some(place) = self.quantized().position(|a| a == attribute) {
                source = source.constant(&format!("{name}_BYTE"), place);
            }
        }
        let known: usize = NAMES.iter().map(|(_, attribute)| attribute.components()).sum();
        let components: Vec<String> = self.group_components().map(|c| format!("{c}u")).collect();
        source = source
            .constant("FURTHER_AT", known)
            .constant("FURTHER_VALUES", self.layout.components() - known)
            .constant("MASK_AT", self.layout.components())
            .constant("GROUPS_A_WORD", GROUPS_A_WORD)
            .constant("ADAM_QUAT", Attribute::Quat.index())
            .constant("ADAM_GROUPS", self.num_groups());
        for (name, group) in SmallGroup::ALL {
            source = source.constant(name, self.small_group(group));
        }
        source.part(&format!("const COMPONENTS = array<u32, {}>({});", components.len(), components.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Column, Gaussians};

    use super::*;

    fn wet() -> (Packing, Attribute) {
        let mut layout = Layout::default();
        let wetness = layout.push("wetness", 2, Column::like(Attribute::Color));
        layout.push("age", 1, Column { quantized: false, ..Column::like(Attribute::LogScale) });
        (Packing::new(&Arc::new(layout)), wetness)
    }

    #[test]
    fn columns_come_back_as_they_were_packed() {
        let (packing, wetness) = wet();
        let mut gaussians = Gaussians::zeros_of(packing.layout(), 3);
        for attribute in packing.layout().attributes() {
            let first = 10.0 * attribute.index() as f32;
            gaussians.values_mut(attribute).iter_mut().enumerate().for_each(|(i, x)| *x = first + i as f32);
        }
        let packed = packing.pack(&gaussians, &[7.0, 8.0, 9.0]);
        assert_eq!(packed.len(), 3 * packing.values());
        assert_eq!(packed[3 * packing.offset(wetness)..][..6], [50.0, 51.0, 52.0, 53.0, 54.0, 55.0]);
        let (mut again, mut mask) = (Gaussians::zeros_of(packing.layout(), 3), vec![0.0; 3]);
        packing.unpack(&packed, &mut again, &mut mask);
        assert!(again == gaussians && mask == [7.0, 8.0, 9.0]);
    }

    #[test]
    fn groups_follow_the_columns() {
        let (packing, wetness) = wet();
        assert_eq!(packing.group_components().collect::<Vec<_>>(), [3, 4, 3, 1, 3, 2, 1, 1]);
        assert_eq!((packing.small_group(SmallGroup::Mask), packing.num_groups()), (7, 12));
        assert_eq!((packing.quantized().last(), packing.group_words()), (Some(wetness), 2));
        assert_eq!(Packing::group_byte(4, 2, 10), (12, 0));
        let text = packing.constants().finish();
        for line in ["MASK_AT: u32 = 17u", "FURTHER_VALUES: u32 = 3u", "COLOR_BYTE: u32 = 3u", "ADAM_GAINS: u32 = 8u"] {
            assert!(text.contains(line), "{line} in {text}");
        }
    }
}

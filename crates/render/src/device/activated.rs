//! Layout of activated Gaussians in a device's memory: column after column in one array of f32.

use tcgs_core::Activated;

use super::Wgsl;

/// Columns before the colours: name in WGSL, components of a Gaussian.
const COLUMNS: [(&str, usize); 4] = [("MEANS_AT", 3), ("QUATS_AT", 4), ("SCALES_AT", 3), ("OPACITIES_AT", 1)];

/// Values of an activated Gaussian before its colours: mean (3), unit quaternion (4), scale (3), opacity (1).
pub const ACTIVATED_VALUES: usize = {
    let (mut sum, mut i) = (0, 0);
    while i < COLUMNS.len() {
        sum += COLUMNS[i].1;
        i += 1;
    }
    sum
};

/// Values of all columns: `[(11 + C) N]`.
pub fn activated_len(num_gaussians: usize, num_channels: usize) -> usize {
    (ACTIVATED_VALUES + num_channels) * num_gaussians
}

/// `[(11 + C) N]` column after column, as the shaders read them: means, unit quats, scales, opacities, colors.
///
/// ```
/// let gaussians = tcgs_core::activate(&tcgs_core::Gaussians::zeros(2));
/// assert_eq!(tcgs_render::device::pack(&gaussians).len(), tcgs_render::device::activated_len(2, 3));
/// ```
///
/// # Panics
/// If arrays disagree in length.
pub fn pack(gaussians: &Activated) -> Vec<f32> {
    let n = gaussians.num_gaussians();
    let arrays: [(&str, &[f32], usize); 5] = [
        ("means", gaussians.means.as_flattened(), 3),
        ("quats", gaussians.quats.as_flattened(), 4),
        ("scales", gaussians.scales.as_flattened(), 3),
        ("opacities", &gaussians.opacities, 1),
        ("colors", &gaussians.colors, gaussians.num_channels),
    ];
    let mut packed = Vec::with_capacity(activated_len(n, gaussians.num_channels));
    for (name, values, components) in arrays {
        assert_eq!(values.len(), n * components, "{name} against [{n}, {components}]");
        packed.extend_from_slice(values);
    }
    packed
}

impl Wgsl {
    /// Declares where the columns of activated Gaussians begin: `MEANS_AT`, `QUATS_AT`, `SCALES_AT`, `OPACITIES_AT`,
    /// `COLORS_AT`, each times the number of Gaussians.
    #[must_use]
    pub fn activated_columns(self) -> Self {
        let (mut source, mut at) = (self, 0);
        for (name, components) in COLUMNS {
            source = source.constant(name, at);
            at += components;
        }
        source.constant("COLORS_AT", at)
    }
}

//! The attributes of a Gaussian: names of the columns of a [`crate::Layout`].

/// One attribute of a Gaussian, in its stored form: a column of a [`crate::Layout`].
///
/// Every layout starts with the five of [`Attribute::BASE`], which renderers and the losses know by name. Any other
/// attribute is an [`Attribute::Extra`]; its name, unit and activation are in the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Attribute {
    /// Centre in scene units.
    Mean,
    /// Rotation, `w, x, y, z`, unnormalised.
    Quat,
    /// Natural logarithm of the standard deviation along each local axis, in scene units.
    LogScale,
    /// Inverse logistic of the opacity.
    LogitOpacity,
    /// Raw sRGB, neither activated nor clamped.
    Color,
    /// A further column. [`crate::Layout::push`] makes these.
    Extra {
        /// Position after the five of [`Attribute::BASE`].
        place: u8,
        /// Scalars of one Gaussian at one timestep.
        components: u8,
    },
}

impl Attribute {
    /// The attributes that every layout starts with, in storage order.
    pub const BASE: [Self; 5] = [Self::Mean, Self::Quat, Self::LogScale, Self::LogitOpacity, Self::Color];

    /// Number of scalars of one Gaussian at one timestep.
    pub const fn components(self) -> usize {
        match self {
            Self::Mean | Self::LogScale | Self::Color => 3,
            Self::Quat => 4,
            Self::LogitOpacity => 1,
            Self::Extra { components, .. } => components as usize,
        }
    }

    /// Position of the column in its layout.
    pub fn index(self) -> usize {
        match self {
            Self::Mean => 0,
            Self::Quat => 1,
            Self::LogScale => 2,
            Self::LogitOpacity => 3,
            Self::Color => 4,
            Self::Extra { place, .. } => Self::BASE.len() + usize::from(place),
        }
    }

    /// Name of one of the five of [`Attribute::BASE`] in files and tables; `extra` for another column, whose name is in
    /// [`crate::Layout::name`].
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "means",
            Self::Quat => "quats",
            Self::LogScale => "log_scales",
            Self::LogitOpacity => "logit_opacities",
            Self::Color => "colors",
            Self::Extra { .. } => "extra",
        }
    }
}

//! The one table of what a Gaussian carries.

/// One attribute of a Gaussian, in its stored form. Loops iterate [`Attribute::ALL`]; nothing keeps
/// a parallel list.
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
}

impl Attribute {
    /// Every attribute, in storage order.
    pub const ALL: [Self; 5] = [Self::Mean, Self::Quat, Self::LogScale, Self::LogitOpacity, Self::Color];

    /// Name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "means",
            Self::Quat => "quats",
            Self::LogScale => "log_scales",
            Self::LogitOpacity => "logit_opacities",
            Self::Color => "colors",
        }
    }

    /// Number of scalars of one Gaussian at one timestep.
    pub fn components(self) -> usize {
        match self {
            Self::Mean | Self::LogScale | Self::Color => 3,
            Self::Quat => 4,
            Self::LogitOpacity => 1,
        }
    }

    /// Whether training gives every timestep a value of its own; the others are trained once. Scenes of
    /// other programs may differ: [`crate::DynamicGaussians::varies`].
    pub fn varies_in_training(self) -> bool {
        matches!(self, Self::Mean | Self::Quat | Self::Color)
    }

    /// Position in [`Attribute::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_size_counts_forty_bytes_a_timestep_and_sixteen_once() {
        let bytes = |varies| -> usize {
            Attribute::ALL.iter().filter(|a| a.varies_in_training() == varies).map(|a| 4 * a.components()).sum()
        };
        assert_eq!((bytes(true), bytes(false)), (40, 16));
        assert!(Attribute::ALL.iter().enumerate().all(|(i, a)| a.index() == i));
    }
}

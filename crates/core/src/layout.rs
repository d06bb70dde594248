//! The table of a Gaussian's attributes, built at run time.

use std::fmt;
use std::sync::{Arc, LazyLock};

use crate::Attribute;
use crate::harmonics::MAX_SH_DEGREE;

/// The function from a stored value to the drawn one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activation {
    /// Stored as drawn.
    Identity,
    /// Divided by the length of the row: unit quaternions.
    Normalize,
    /// `exp`, for positive values.
    Exp,
    /// Logistic function, for values in (0, 1).
    Sigmoid,
}

/// The learning rate of a column: a field of the training's rates, with its schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RateGroup {
    /// As centres, relative to the scene's extent.
    Mean,
    /// As rotations.
    Quat,
    /// As scales: in the first timestep alone.
    LogScale,
    /// As opacities: in the first timestep alone.
    LogitOpacity,
    /// As colours.
    Color,
}

impl Activation {
    /// Every activation; files name one by its variant.
    pub const ALL: [Self; 4] = [Self::Identity, Self::Normalize, Self::Exp, Self::Sigmoid];
}

impl RateGroup {
    /// Every group; files name one by its variant.
    pub const ALL: [Self; 5] = [Self::Mean, Self::Quat, Self::LogScale, Self::LogitOpacity, Self::Color];
}

/// One column of a [`Layout`].
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Column {
    /// Which column, and how many scalars of one Gaussian it has.
    pub attribute: Attribute,
    /// Name in files and tables, in the plural: `means`.
    pub name: String,
    /// The function from a stored value to the drawn one.
    pub activation: Activation,
    /// Whether training gives every timestep a value of its own; the others are trained once. Other programs' scenes
    /// may differ: [`crate::DynamicGaussians::varies`].
    pub varies: bool,
    /// Whether training quantises the column, with bits by sensitivity and learned steps. Positions are quantised
    /// afterwards.
    pub quantized: bool,
    /// The learning rate of the column.
    pub rate: RateGroup,
    /// Unit of a stored value, for tables and for people.
    pub unit: String,
}

/// The ordered columns of a scene. It determines loops, offsets, Adam's groups, the arrays of checkpoints and the
/// constants of shaders.
///
/// The first five columns are those of [`Attribute::BASE`].
///
/// ```
/// use tcgs_core::{Activation, Attribute, Column, Layout, RateGroup};
/// let mut layout = Layout::default();
/// assert_eq!((layout.columns().len(), layout.components()), (5, 14));
/// let wetness = layout.push("wetness", 2, Column::like(Attribute::Color));
/// assert_eq!((layout.name(wetness), layout.offset(wetness), layout.components()), ("wetness", 14, 16));
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Layout {
    columns: Vec<Column>,
    is_antialiased: bool,
    background: [u8; 3],
}

impl Column {
    /// A column treated like one of [`Attribute::BASE`]: the same activation, rate and unit.
    ///
    /// # Panics
    /// If `attribute` is not one of [`Attribute::BASE`].
    pub fn like(attribute: Attribute) -> Self {
        let (activation, varies, rate, unit) = match attribute {
            Attribute::Mean => (Activation::Identity, true, RateGroup::Mean, "scene units"),
            Attribute::Quat => (Activation::Normalize, true, RateGroup::Quat, "quaternion w, x, y, z"),
            Attribute::LogScale => (Activation::Exp, false, RateGroup::LogScale, "ln of scene units"),
            Attribute::LogitOpacity => (Activation::Sigmoid, false, RateGroup::LogitOpacity, "logit"),
            Attribute::Color => (Activation::Identity, true, RateGroup::Color, "sRGB"),
            Attribute::Extra { .. } => panic!("{attribute:?} is not one of Attribute::BASE"),
        };
        let quantized = attribute != Attribute::Mean;
        Self { attribute, name: attribute.name().into(), activation, varies, quantized, rate, unit: unit.into() }
    }

    /// Number of scalars of one Gaussian at one timestep.
    pub fn components(&self) -> usize {
        self.attribute.components()
    }
}

impl Default for Layout {
    /// The five columns of [`Attribute::BASE`].
    fn default() -> Self {
        Self { columns: Attribute::BASE.map(Column::like).into(), is_antialiased: false, background: [0; 3] }
    }
}

impl Layout {
    /// The five columns of [`Attribute::BASE`], shared.
    pub fn base() -> Arc<Self> {
        static BASE: LazyLock<Arc<Layout>> = LazyLock::new(Arc::default);
        Arc::clone(&BASE)
    }

    /// The five columns of [`Attribute::BASE`], then the coefficients of spherical harmonics of degrees 1 to `degree`,
    /// shared: `sh1[9]`, `sh2[15]`, `sh3[21]`. Colours then depend on the direction of view
    /// ([`Drawable`](crate::Drawable)).
    ///
    /// Within a column the coefficients are in the order of [`harmonics`](crate::harmonics()), red, green and blue of
    /// each together: `[2 l + 1, 3]`. They do not vary over time, unless a scene's values do.
    ///
    /// - `degree`: 0 to [`MAX_SH_DEGREE`]; 0 gives [`Self::base`]
    ///
    /// ```
    /// use tcgs_core::Layout;
    /// let layout = Layout::with_harmonics(2);
    /// assert_eq!(layout.to_string(), "means[3] quats[4] log_scales[3] logit_opacities[1] colors[3] sh1[9] sh2[15]");
    /// assert_eq!((layout.sh_degree(), Layout::base().sh_degree()), (2, 0));
    /// ```
    ///
    /// # Panics
    /// If `degree` is above [`MAX_SH_DEGREE`].
    pub fn with_harmonics(degree: usize) -> Arc<Self> {
        static LAYOUTS: LazyLock<[Arc<Layout>; MAX_SH_DEGREE + 1]> = LazyLock::new(|| {
            std::array::from_fn(|degree| {
                let mut layout = Layout::default();
                for l in 1..=degree {
                    let column = Column { varies: false, ..Column::like(Attribute::Color) };
                    layout.push(&band_name(l), 3 * (2 * l + 1), column);
                }
                Arc::new(layout)
            })
        });
        assert!(degree <= MAX_SH_DEGREE, "harmonics of degree {degree}, expected at most {MAX_SH_DEGREE}");
        Arc::clone(&LAYOUTS[degree])
    }

    /// The columns of spherical harmonics that there are, from degree 1 on without a gap, found by name and size.
    pub fn harmonics(&self) -> Vec<Attribute> {
        let band = |l| self.find(&band_name(l)).filter(|band| band.components() == 3 * (2 * l + 1));
        (1..=MAX_SH_DEGREE).map_while(band).collect()
    }

    /// Highest degree of the spherical harmonics, 0 without any.
    pub fn sh_degree(&self) -> usize {
        self.harmonics().len()
    }

    /// Appends a column.
    ///
    /// - `name`: in files and tables
    /// - `components`: scalars of one Gaussian at one timestep, at least 1
    /// - `column`: its treatment; its own name and attribute do not matter
    /// - returns: the attribute of the new column
    ///
    /// # Panics
    /// If the name is taken, `components` is 0 or above 255, or there are 255 further columns already.
    pub fn push(&mut self, name: &str, components: usize, column: Column) -> Attribute {
        assert!(self.find(name).is_none(), "a second column {name}");
        let place = u8::try_from(self.columns.len() - Attribute::BASE.len()).expect("at most 255 further columns");
        let components = u8::try_from(components).ok().filter(|&c| c > 0).expect("1 to 255 components");
        let attribute = Attribute::Extra { place, components };
        self.columns.push(Column { attribute, name: name.into(), ..column });
        attribute
    }

    /// The same columns, for Gaussians drawn with or without antialiasing ([`Self::is_antialiased`]).
    ///
    /// ```
    /// use tcgs_core::Layout;
    /// let layout = Layout::base().antialiased(true);
    /// assert!(layout.is_antialiased() && layout.is_base() && !layout.antialiased(false).is_antialiased());
    /// ```
    #[must_use]
    pub fn antialiased(self: &Arc<Self>, is_antialiased: bool) -> Arc<Self> {
        if self.is_antialiased == is_antialiased {
            return Arc::clone(self);
        }
        Arc::new(Self { is_antialiased, ..Self::clone(self) })
    }

    /// Whether a splat that is widened by a pixel's extent loses as much opacity, so that it covers as much as before
    /// at any resolution ([`Activated::is_antialiased`](crate::Activated)). Gaussians are to be drawn as they were
    /// trained.
    pub fn is_antialiased(&self) -> bool {
        self.is_antialiased
    }

    /// The same columns, for Gaussians drawn on a background ([`Self::background`]).
    ///
    /// - `background`: red, green and blue, sRGB of 255
    #[must_use]
    pub fn with_background(self: &Arc<Self>, background: [u8; 3]) -> Arc<Self> {
        if self.background == background {
            return Arc::clone(self);
        }
        Arc::new(Self { background, ..Self::clone(self) })
    }

    /// Colour behind all Gaussians: red, green and blue, sRGB of 255; black at first. Gaussians are to be drawn on
    /// the background on which they were trained.
    pub fn background(&self) -> [u8; 3] {
        self.background
    }

    /// [`Self::background`] in `[0, 1]`, as a renderer takes it.
    pub fn background_color(&self) -> [f32; 3] {
        self.background.map(|level| f32::from(level) / 255.0)
    }

    /// All columns, in storage order.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The attributes of all columns, in storage order.
    pub fn attributes(&self) -> impl DoubleEndedIterator<Item = Attribute> + ExactSizeIterator + Clone + use<'_> {
        self.columns.iter().map(|column| column.attribute)
    }

    /// The column of an attribute.
    ///
    /// # Panics
    /// If the layout does not have it.
    pub fn column(&self, attribute: Attribute) -> &Column {
        let column = self.columns.get(attribute.index()).filter(|column| column.attribute == attribute);
        column.unwrap_or_else(|| panic!("{attribute:?} is not a column of {self}"))
    }

    /// Name of a column in files and tables.
    ///
    /// # Panics
    /// If the layout does not have it.
    pub fn name(&self, attribute: Attribute) -> &str {
        &self.column(attribute).name
    }

    /// The column of a name, if there is one.
    pub fn find(&self, name: &str) -> Option<Attribute> {
        self.columns.iter().find(|column| column.name == name).map(|column| column.attribute)
    }

    /// Scalars of one Gaussian at one timestep, all columns together.
    pub fn components(&self) -> usize {
        self.columns.iter().map(Column::components).sum()
    }

    /// Scalars of one Gaussian in the columns before `attribute`.
    pub fn offset(&self, attribute: Attribute) -> usize {
        self.columns[..attribute.index()].iter().map(Column::components).sum()
    }

    /// Size as plain 32-bit floats of a scene in which only the columns that vary by the layout do vary:
    /// `N * (40 * T + 16)` for the five columns of [`Attribute::BASE`].
    ///
    /// ```
    /// assert_eq!(tcgs_core::Layout::base().raw_bytes(10, 3), 10 * (40 * 3 + 16));
    /// ```
    pub fn raw_bytes(&self, num_gaussians: usize, num_timesteps: usize) -> u64 {
        let samples = |column: &Column| if column.varies { num_timesteps } else { 1 };
        let per_gaussian: usize = self.columns.iter().map(|column| 4 * column.components() * samples(column)).sum();
        num_gaussians as u64 * per_gaussian as u64
    }

    /// [`Self::raw_bytes`] of a scene in which the number of Gaussians may change. If it does, every timestep has all
    /// columns, because Gaussians of different timesteps are not known to be the same.
    ///
    /// - `num_gaussians`: at every timestep
    ///
    /// ```
    /// let layout = tcgs_core::Layout::base();
    /// assert_eq!(layout.raw_bytes_of_changing(&[10, 12]), (10 + 12) * 56);
    /// assert_eq!(layout.raw_bytes_of_changing(&[10, 10]), layout.raw_bytes(10, 2));
    /// ```
    pub fn raw_bytes_of_changing(&self, num_gaussians: &[usize]) -> u64 {
        match num_gaussians {
            [first, others @ ..] if others.iter().all(|n| n == first) => self.raw_bytes(*first, num_gaussians.len()),
            _ => num_gaussians.iter().map(|n| *n as u64 * 4 * self.components() as u64).sum(),
        }
    }

    /// The first column beyond [`Attribute::BASE`], if there is one; formats of five columns cannot hold it.
    pub fn further(&self) -> Option<&Column> {
        self.columns.get(Attribute::BASE.len())
    }

    /// Whether [`Attribute::BASE`] are the only columns.
    pub fn is_base(&self) -> bool {
        self.further().is_none()
    }
}

/// Name of the column of the harmonics of degree `l`.
fn band_name(l: usize) -> String {
    format!("sh{l}")
}

impl fmt::Display for Layout {
    /// Names and components: `means[3] quats[4] …`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, column) in self.columns.iter().enumerate() {
            write!(f, "{}{}[{}]", if i > 0 { " " } else { "" }, column.name, column.components())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_size_counts_forty_bytes_a_timestep_and_sixteen_once() {
        let layout = Layout::base();
        let bytes = |varies| -> usize {
            layout.columns().iter().filter(|c| c.varies == varies).map(|c| 4 * c.components()).sum()
        };
        assert_eq!((bytes(true), bytes(false)), (40, 16));
        assert!(layout.attributes().eq(Attribute::BASE));
        assert!(layout.attributes().enumerate().all(|(i, a)| a.index() == i));
    }

    #[test]
    #[should_panic(expected = "a second column means")]
    fn a_name_is_taken_once() {
        Layout::default().push("means", 1, Column::like(Attribute::Color));
    }

    #[test]
    fn harmonics_are_found_by_name_and_size() {
        let sizes = |layout: &Layout| layout.harmonics().iter().map(|band| band.components()).collect::<Vec<_>>();
        assert_eq!((0..4).map(|d| Layout::with_harmonics(d).sh_degree()).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(sizes(&Layout::with_harmonics(3)), [9, 15, 21]);
        assert!(Layout::with_harmonics(0).is_base());
        let full = Layout::with_harmonics(3);
        let column = full.column(full.find("sh2").unwrap());
        assert_eq!((column.activation, &*column.unit, column.varies), (Activation::Identity, "sRGB", false));
        assert_eq!(full.raw_bytes(10, 3), 10 * (40 * 3 + 16 + 4 * 45));

        // Anywhere among other columns; not with another size, and not beyond a gap.
        let mut layout = Layout::default();
        layout.push("wetness", 1, Column::like(Attribute::Color));
        let sh1 = layout.push("sh1", 9, Column::like(Attribute::Color));
        layout.push("sh2", 9, Column::like(Attribute::Color));
        layout.push("sh3", 21, Column::like(Attribute::Color));
        assert_eq!(layout.harmonics(), [sh1]);
    }

    #[test]
    fn columns_are_found_by_name_and_said_in_order() {
        let mut layout = Layout::default();
        let harmonics = layout.push("harmonics", 45, Column { varies: false, ..Column::like(Attribute::Color) });
        assert_eq!(layout.find("harmonics"), Some(harmonics));
        assert_eq!((layout.offset(Attribute::Color), layout.offset(harmonics)), (11, 14));
        assert_eq!(layout.to_string(), "means[3] quats[4] log_scales[3] logit_opacities[1] colors[3] harmonics[45]");
        assert!(!layout.is_base() && layout.column(Attribute::Color).varies && !layout.column(harmonics).varies);
    }
}

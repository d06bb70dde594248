//! One flat array a column, with what its numbers mean in the type.

use std::borrow::Borrow;
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use crate::{Attribute, Layout};

/// Meanings of the numbers in [`Columns`]. Types of different roles do not mix: a gradient cannot replace a value.
pub mod role {
    /// Values as stored: before activation.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Stored {}
    /// `∂L/∂x` of stored values.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Gradient {}
    /// `S(θ)` of stored values, paper Eq. 7; at least 0.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Sensitivity {}
    /// Running mean of the gradient, by Adam.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum FirstMoment {}
    /// Running mean of the gradient's square, by Adam.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum SecondMoment {}
}

/// One timestep of a scene: one flat array a column of its [`Layout`], `[N * components]`, row by row.
///
/// `Role` is one of [`role`], and says what the numbers mean.
///
/// ```
/// use tcgs_core::{Attribute, BaseColumns, Gaussians};
/// let mut gaussians = Gaussians::zeros(2);
/// gaussians.means_mut()[1] = [1.0, 2.0, 3.0];
/// assert_eq!(gaussians.values(Attribute::Mean), [0.0, 0.0, 0.0, 1.0, 2.0, 3.0]);
/// assert_eq!(gaussians.select(&[1]).means(), [[1.0, 2.0, 3.0]]);
/// ```
pub struct Columns<Role> {
    layout: Arc<Layout>,
    num_gaussians: usize,
    /// By [`Attribute::index`].
    values: Vec<Vec<f32>>,
    role: PhantomData<fn() -> Role>,
}

/// One timestep as stored: what files, training and activation speak of.
pub type Gaussians = Columns<role::Stored>;
/// Gradients to the stored values of one timestep.
pub type GaussianGrads = Columns<role::Gradient>;
/// How much each stored value moves the pictures, `S(θ)`, paper Eq. 7.
pub type Sensitivity = Columns<role::Sensitivity>;

/// The five columns of [`Attribute::BASE`] as rows, from which [`Columns`] are made. All have length `N`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BaseColumns {
    /// `[N, 3]` centres, scene units.
    pub means: Vec<[f32; 3]>,
    /// `[N, 4]` rotations, `w, x, y, z`, unnormalised.
    pub quats: Vec<[f32; 4]>,
    /// `[N, 3]` logarithms of the standard deviations.
    pub log_scales: Vec<[f32; 3]>,
    /// `[N]` inverse logistic of the opacities.
    pub logit_opacities: Vec<f32>,
    /// `[N, 3]` raw sRGB.
    pub colors: Vec<[f32; 3]>,
}

/// The five columns of [`Attribute::BASE`] of some [`Columns`], to change in place. All have length `N`.
#[derive(Debug)]
pub struct BaseViewsMut<'a> {
    /// `[N, 3]`
    pub means: &'a mut [[f32; 3]],
    /// `[N, 4]`
    pub quats: &'a mut [[f32; 4]],
    /// `[N, 3]`
    pub log_scales: &'a mut [[f32; 3]],
    /// `[N]`
    pub logit_opacities: &'a mut [f32],
    /// `[N, 3]`
    pub colors: &'a mut [[f32; 3]],
}

impl<Role> From<BaseColumns> for Columns<Role> {
    /// # Panics
    /// If the lengths differ.
    fn from(base: BaseColumns) -> Self {
        let num_gaussians = base.means.len();
        let BaseColumns { means, quats, log_scales, logit_opacities, colors } = base;
        let values = vec![
            means.into_flattened(),
            quats.into_flattened(),
            log_scales.into_flattened(),
            logit_opacities,
            colors.into_flattened(),
        ];
        Self::new(Layout::base(), num_gaussians, values)
    }
}

impl<Role> Columns<Role> {
    /// Columns from their arrays.
    ///
    /// - `values`: by [`Attribute::index`], `[N * components]` each
    ///
    /// # Panics
    /// If the number of arrays or the length of one does not fit the layout.
    pub fn new(layout: Arc<Layout>, num_gaussians: usize, values: Vec<Vec<f32>>) -> Self {
        assert_eq!(values.len(), layout.columns().len(), "arrays against the columns of {layout}");
        for (column, values) in layout.columns().iter().zip(&values) {
            let (name, components) = (&column.name, column.components());
            assert_eq!(values.len(), num_gaussians * components, "{name} against [{num_gaussians}, {components}]");
        }
        Self { layout, num_gaussians, values, role: PhantomData }
    }

    /// `N` Gaussians of the five columns of [`Attribute::BASE`], every value zero.
    pub fn zeros(num_gaussians: usize) -> Self {
        Self::zeros_of(&Layout::base(), num_gaussians)
    }

    /// `N` Gaussians of a layout, every value zero: the initial value of sums and gradients.
    pub fn zeros_of(layout: &Arc<Layout>, num_gaussians: usize) -> Self {
        let values = layout.columns().iter().map(|c| vec![0.0; num_gaussians * c.components()]).collect();
        Self { layout: Arc::clone(layout), num_gaussians, values, role: PhantomData }
    }

    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    /// Which columns there are.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// All values of one attribute, `[N * components]`.
    ///
    /// # Panics
    /// If the layout does not have it.
    pub fn values(&self, attribute: Attribute) -> &[f32] {
        &self.values[attribute.index()]
    }

    /// All values of one attribute, to change in place.
    ///
    /// # Panics
    /// If the layout does not have it.
    pub fn values_mut(&mut self, attribute: Attribute) -> &mut [f32] {
        &mut self.values[attribute.index()]
    }

    /// The arrays of all columns, by [`Attribute::index`].
    pub fn into_values(self) -> Vec<Vec<f32>> {
        self.values
    }

    /// The same Gaussians with the columns of a longer layout; what is new is zero.
    ///
    /// # Panics
    /// If `layout` does not start with the columns that there are.
    pub fn extended(self, layout: &Arc<Layout>) -> Self {
        let known = self.layout.columns();
        assert!(layout.columns().starts_with(known), "columns {layout} do not start with {}", self.layout);
        let new = &layout.columns()[known.len()..];
        let mut values = self.values;
        values.extend(new.iter().map(|column| vec![0.0; self.num_gaussians * column.components()]));
        Self::new(Arc::clone(layout), self.num_gaussians, values)
    }

    /// The Gaussians at `indices`, in that order, repeated where an index is.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        let select = |attribute: Attribute| select_rows(self.values(attribute), attribute.components(), indices);
        Self {
            layout: Arc::clone(&self.layout),
            num_gaussians: indices.len(),
            values: self.layout.attributes().map(select).collect(),
            role: PhantomData,
        }
    }

    /// The Gaussians of all `parts`, one part after another.
    ///
    /// # Panics
    /// If a part does not have the columns of `layout`.
    pub fn concat(layout: &Arc<Layout>, parts: &[Self]) -> Self {
        assert!(parts.iter().all(|part| part.layout == *layout), "parts of other columns than {layout}");
        let column = |a: usize| parts.iter().flat_map(|part| &part.values[a]).copied().collect();
        let values = (0..layout.columns().len()).map(column).collect();
        Self::new(Arc::clone(layout), parts.iter().map(|part| part.num_gaussians).sum(), values)
    }

    /// Rows of several timesteps as one.
    ///
    /// - `timesteps`: of the same columns, at least one
    /// - `places`: timestep and row of each
    ///
    /// # Panics
    /// If an index is out of range.
    ///
    /// ```
    /// use tcgs_core::Gaussians;
    /// let mut later = Gaussians::zeros(2);
    /// later.means_mut()[1] = [1.0; 3];
    /// let gathered = Gaussians::gather(&[Gaussians::zeros(1), later], &[(1, 1), (0, 0)]);
    /// assert_eq!(gathered.means(), [[1.0; 3], [0.0; 3]]);
    /// ```
    pub fn gather<C: Borrow<Self>>(timesteps: &[C], places: &[(usize, usize)]) -> Self {
        let layout = &timesteps[0].borrow().layout;
        let column = |attribute: Attribute| {
            let components = attribute.components();
            let row =
                |&(t, row): &(usize, usize)| &timesteps[t].borrow().values(attribute)[row * components..][..components];
            places.iter().flat_map(row).copied().collect()
        };
        Self::new(Arc::clone(layout), places.len(), layout.attributes().map(column).collect())
    }

    /// The Gaussians at `rows`, in that order; zeros for a row without an index.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select_or_zero(&self, rows: &[Option<usize>]) -> Self {
        let mut selected = Self::zeros_of(&self.layout, rows.len());
        for (from, to) in self.values.iter().zip(&mut selected.values) {
            let components = to.len() / rows.len().max(1);
            for (to, row) in to.chunks_exact_mut(components.max(1)).zip(rows) {
                if let Some(i) = row {
                    to.copy_from_slice(&from[i * components..(i + 1) * components]);
                }
            }
        }
        selected
    }

    /// The coefficients of spherical harmonics from degree 1 on, in the order of other programs:
    /// `[N, (degree + 1)² - 1, 3]` with all degrees of one Gaussian together; empty without harmonics.
    ///
    /// ```
    /// use tcgs_core::{Gaussians, Layout};
    /// let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(2), 2);
    /// for band in gaussians.layout().harmonics() {
    ///     gaussians.values_mut(band).fill(band.components() as f32);
    /// }
    /// let rows = gaussians.harmonic_rows();
    /// assert_eq!((rows.len(), &rows[7..11], rows[24]), (2 * 8 * 3, &[9.0, 9.0, 15.0, 15.0][..], 9.0));
    /// ```
    pub fn harmonic_rows(&self) -> Vec<f32> {
        let bands: Vec<(&[f32], usize)> =
            self.layout.harmonics().into_iter().map(|band| (self.values(band), band.components())).collect();
        let of_gaussian = |i: usize| bands.iter().flat_map(move |(values, size)| &values[i * size..(i + 1) * size]);
        (0..self.num_gaussians).flat_map(of_gaussian).copied().collect()
    }

    /// The five columns of [`Attribute::BASE`], to change in place together.
    pub fn views_mut(&mut self) -> BaseViewsMut<'_> {
        let [means, quats, log_scales, logit_opacities, colors, ..] = self.values.as_mut_slice() else {
            unreachable!("every layout starts with the five of Attribute::BASE");
        };
        BaseViewsMut {
            means: means.as_chunks_mut().0,
            quats: quats.as_chunks_mut().0,
            log_scales: log_scales.as_chunks_mut().0,
            logit_opacities,
            colors: colors.as_chunks_mut().0,
        }
    }

    /// `[N, 3]` of [`Attribute::Mean`].
    pub fn means(&self) -> &[[f32; 3]] {
        self.values[0].as_chunks().0
    }

    /// `[N, 4]` of [`Attribute::Quat`].
    pub fn quats(&self) -> &[[f32; 4]] {
        self.values[1].as_chunks().0
    }

    /// `[N, 3]` of [`Attribute::LogScale`].
    pub fn log_scales(&self) -> &[[f32; 3]] {
        self.values[2].as_chunks().0
    }

    /// `[N]` of [`Attribute::LogitOpacity`].
    pub fn logit_opacities(&self) -> &[f32] {
        &self.values[3]
    }

    /// `[N, 3]` of [`Attribute::Color`].
    pub fn colors(&self) -> &[[f32; 3]] {
        self.values[4].as_chunks().0
    }

    /// [`Self::means`], to change in place.
    pub fn means_mut(&mut self) -> &mut [[f32; 3]] {
        self.values[0].as_chunks_mut().0
    }

    /// [`Self::quats`], to change in place.
    pub fn quats_mut(&mut self) -> &mut [[f32; 4]] {
        self.values[1].as_chunks_mut().0
    }

    /// [`Self::log_scales`], to change in place.
    pub fn log_scales_mut(&mut self) -> &mut [[f32; 3]] {
        self.values[2].as_chunks_mut().0
    }

    /// [`Self::logit_opacities`], to change in place.
    pub fn logit_opacities_mut(&mut self) -> &mut [f32] {
        &mut self.values[3]
    }

    /// [`Self::colors`], to change in place.
    pub fn colors_mut(&mut self) -> &mut [[f32; 3]] {
        self.values[4].as_chunks_mut().0
    }

    /// The same Gaussians, drawn on a background ([`Layout::background`]).
    #[must_use]
    pub fn with_background(self, background: [u8; 3]) -> Self {
        Self { layout: self.layout.with_background(background), ..self }
    }

    /// The same Gaussians in another light: colours and the coefficients of spherical harmonics are multiplied by one
    /// gain for each of red, green and blue.
    ///
    /// ```
    /// use tcgs_core::Gaussians;
    /// let mut gaussians = Gaussians::zeros(1);
    /// gaussians.colors_mut()[0] = [0.5, 0.5, 0.5];
    /// assert_eq!(gaussians.lit([1.0, 0.5, 2.0]).colors()[0], [0.5, 0.25, 1.0]);
    /// ```
    pub fn lit(mut self, gains: [f32; 3]) -> Self {
        if gains != [1.0; 3] {
            let bands = self.layout.harmonics();
            for attribute in std::iter::once(Attribute::Color).chain(bands) {
                for color in self.values_mut(attribute).as_chunks_mut::<3>().0 {
                    *color = std::array::from_fn(|channel| color[channel] * gains[channel]);
                }
            }
        }
        self
    }
}

/// Rows of a flat array, in the order of `indices`.
///
/// - `values`: `[rows * components]`
///
/// # Panics
/// If an index is out of range.
pub(crate) fn select_rows(values: &[f32], components: usize, indices: &[usize]) -> Vec<f32> {
    let mut selected = Vec::with_capacity(indices.len() * components);
    for &i in indices {
        selected.extend_from_slice(&values[i * components..(i + 1) * components]);
    }
    selected
}

// Derives would ask the same of `Role`, which has no values.
impl<Role> Clone for Columns<Role> {
    fn clone(&self) -> Self {
        Self {
            layout: Arc::clone(&self.layout),
            num_gaussians: self.num_gaussians,
            values: self.values.clone(),
            role: PhantomData,
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.layout.clone_from(&source.layout);
        self.num_gaussians = source.num_gaussians;
        self.values.clone_from(&source.values);
    }
}

impl<Role> Default for Columns<Role> {
    fn default() -> Self {
        Self::zeros(0)
    }
}

impl<Role> PartialEq for Columns<Role> {
    fn eq(&self, other: &Self) -> bool {
        self.layout == other.layout && self.values == other.values
    }
}

impl<Role> fmt::Debug for Columns<Role> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut map = f.debug_map();
        for column in self.layout.columns() {
            map.entry(&column.name, &self.values(column.attribute));
        }
        map.finish()
    }
}

/// The coloured points that training starts from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// `[P, 3]` positions, scene units.
    pub points: Vec<[f32; 3]>,
    /// `[P, 3]` sRGB in `[0, 1]`.
    pub colors: Vec<[f32; 3]>,
    /// `[P]` whether a point belongs to what moves (the segmentation's foreground).
    pub foreground: Vec<bool>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Column;

    #[test]
    fn further_columns_are_selected_with_the_others() {
        let mut layout = Layout::default();
        let wetness = layout.push("wetness", 2, Column::like(Attribute::Color));
        let mut gaussians = Gaussians::zeros_of(&Arc::new(layout), 3);
        gaussians.values_mut(wetness).copy_from_slice(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        gaussians.colors_mut()[2] = [0.5; 3];
        let selected = gaussians.select(&[2, 0, 2]);
        assert_eq!(selected.values(wetness), [4.0, 5.0, 0.0, 1.0, 4.0, 5.0]);
        assert_eq!((selected.num_gaussians(), selected.colors()[2]), (3, [0.5; 3]));
        let selected = gaussians.select_or_zero(&[None, Some(1)]);
        assert_eq!(
            (selected.values(wetness), selected.means()),
            ([0.0, 0.0, 2.0, 3.0].as_slice(), [[0.0; 3]; 2].as_slice())
        );
        assert_ne!(Gaussians::zeros(3), Gaussians::zeros_of(gaussians.layout(), 3));
    }

    #[test]
    #[should_panic(expected = "colors against [2, 3]")]
    fn lengths_agree() {
        let quats = vec![[1.0, 0.0, 0.0, 0.0]; 2];
        let rows = vec![[0.0; 3]; 2];
        let _ = Gaussians::from(BaseColumns {
            means: rows.clone(),
            quats,
            log_scales: rows,
            logit_opacities: vec![0.0; 2],
            colors: Vec::new(),
        });
    }
}

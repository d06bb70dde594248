//! Matches the Gaussians of a file with those of the compressed scene: one-to-one pairs within the declared errors.
//!
//! A file does not record the pairs. Encoders reorder Gaussians, and leave some out.

use tcgs_codec::attribute_error;
use tcgs_core::{Activation, Attribute, Column, Gaussians, upper_median};

use super::tree::Tree;

/// Differences of equal importance where no error is declared: of rotations in radians, of logarithms of scales, of
/// opacities from 0 to 1, of colours and all else. Positions are measured by the sizes of the Gaussians.
const TYPICAL: [f64; 4] = [0.3, 0.5, 0.2, 0.15];

/// Constants over all timesteps: the bounds within which two Gaussians make a pair.
pub struct Bounds {
    /// `[columns]` in the order of the layout: the largest error of a pair; infinite if none is declared.
    largest: Vec<f64>,
}

/// Pairs at a timestep.
#[derive(Default)]
pub struct Pairs {
    /// For each Gaussian of the file, its partner in the source, if one is left.
    pub partners: Vec<Option<u32>>,
    /// Gaussians of the file without a Gaussian of the source within the bounds.
    pub num_beyond: usize,
}

impl Bounds {
    /// - `declared`: by name of the attribute
    pub fn new(columns: &[Column], declared: &[(String, f32)]) -> Self {
        let of = |column: &Column| declared.iter().find(|(name, _)| *name == column.name);
        let bound = |column| of(column).map_or(f64::INFINITY, |(_, error)| f64::from(*error));
        Self { largest: columns.iter().map(bound).collect() }
    }

    /// Whether positions have a bound.
    fn is_known(&self) -> bool {
        self.largest[Attribute::Mean.index()].is_finite()
    }

    /// Finds the pairs of a timestep.
    ///
    /// - `before`: pairs of the timestep before; tried first, since most Gaussians keep their places in both
    pub fn pairs(&self, source: &Gaussians, file: &Gaussians, before: &Pairs) -> Pairs {
        let mut matching = Matching::new(self, source, file);
        if self.is_known() {
            matching.repeat(before);
        }
        matching.take_nearest(&self.largest);
        if self.is_known() {
            matching.augment();
        }
        let num_beyond = matching.partners.iter().filter(|partner| partner.is_none()).count();
        // The rest is paired only for the table.
        matching.take_nearest(&vec![f64::INFINITY; self.largest.len()]);
        Pairs { partners: matching.partners, num_beyond }
    }
}

/// Pairs under construction.
struct Matching<'a> {
    bounds: &'a Bounds,
    source: &'a Gaussians,
    file: &'a Gaussians,
    /// `[columns]` the unit in which differences are measured.
    units: Vec<f64>,
    /// For each Gaussian of the file, its partner in the source.
    partners: Vec<Option<u32>>,
    /// For each Gaussian of the source, its partner in the file.
    owners: Vec<Option<u32>>,
    /// A tree over the source's means, made on demand.
    tree: Option<Tree>,
}

impl<'a> Matching<'a> {
    fn new(bounds: &'a Bounds, source: &'a Gaussians, file: &'a Gaussians) -> Self {
        let unit = |(column, &bound): (&Column, &f64)| {
            if bound.is_finite() && bound > 0.0 { bound } else { typical_difference(column, source) }
        };
        Self {
            units: source.layout().columns().iter().zip(&bounds.largest).map(unit).collect(),
            partners: vec![None; file.num_gaussians()],
            owners: vec![None; source.num_gaussians()],
            tree: None,
            bounds,
            source,
            file,
        }
    }

    /// Sum of squares of the errors of a pair, each in its unit. None if an error exceeds its bound, or if the sum is
    /// not below `least`.
    fn cost(&self, row: usize, partner: usize, largest: &[f64], least: f64) -> Option<f64> {
        let mut cost = 0.0;
        for ((column, largest), unit) in self.source.layout().columns().iter().zip(largest).zip(&self.units) {
            let of = |gaussians: &'a Gaussians, row: usize| {
                &gaussians.values(column.attribute)[row * column.components()..][..column.components()]
            };
            let error = attribute_error(column, of(self.source, partner), of(self.file, row));
            cost += (error / unit).powi(2);
            if error > *largest || cost >= least {
                return None;
            }
        }
        Some(cost)
    }

    fn pair(&mut self, row: usize, partner: usize) {
        self.partners[row] = Some(partner as u32);
        self.owners[partner] = Some(row as u32);
    }

    /// Keeps pairs of the timestep before that are still within the bounds.
    fn repeat(&mut self, before: &Pairs) {
        for row in 0..self.partners.len().min(before.partners.len()) {
            let partner = before.partners[row].map(|partner| partner as usize);
            if let Some(partner) = partner.filter(|&partner| self.owners.get(partner).is_some_and(Option::is_none))
                && self.cost(row, partner, &self.bounds.largest, f64::INFINITY).is_some()
            {
                self.pair(row, partner);
            }
        }
    }

    /// Pairs each unpaired Gaussian of the file with the nearest unpaired one of the source.
    fn take_nearest(&mut self, largest: &[f64]) {
        if self.partners.iter().all(Option::is_some) {
            return;
        }
        let tree = self.tree.take().unwrap_or_else(|| Tree::new(self.source.means()));
        let mean = Attribute::Mean.index();
        for row in 0..self.partners.len() {
            if self.partners[row].is_some() {
                continue;
            }
            let mut best: (f64, Option<usize>) = (f64::INFINITY, None);
            tree.visit(self.file.means()[row], largest[mean], &mut |partner| {
                if self.owners[partner].is_none()
                    && let Some(cost) = self.cost(row, partner, largest, best.0)
                {
                    best = (cost, Some(partner));
                }
                // Beyond this distance, the distance alone costs more.
                largest[mean].min(self.units[mean] * best.0.sqrt())
            });
            if let Some(partner) = best.1 {
                self.pair(row, partner);
            }
        }
        self.tree = Some(tree);
    }

    /// Finds partners for the remaining Gaussians by moving others to another partner within the bounds: augmenting
    /// paths, depth first. The number of pairs is then maximal.
    fn augment(&mut self) {
        let Some(tree) = self.tree.take() else { return };
        let mut is_visited = vec![false; self.owners.len()];
        // The Gaussian of the file from which each one of the source was reached.
        let mut reached_from = vec![0; self.owners.len()];
        for row in 0..self.partners.len() {
            if self.partners[row].is_some() {
                continue;
            }
            let (mut visited, mut to_do, mut end) = (Vec::new(), vec![row], None);
            while let Some(row) = to_do.pop().filter(|_| end.is_none()) {
                let distance = self.bounds.largest[Attribute::Mean.index()];
                tree.visit(self.file.means()[row], distance, &mut |partner| {
                    let is_new = end.is_none() && !is_visited[partner];
                    if is_new && self.cost(row, partner, &self.bounds.largest, f64::INFINITY).is_some() {
                        is_visited[partner] = true;
                        reached_from[partner] = row;
                        visited.push(partner);
                        match self.owners[partner] {
                            Some(owner) => to_do.push(owner as usize),
                            None => end = Some(partner),
                        }
                    }
                    distance
                });
            }
            // Without a free end, no path through visited Gaussians leads to one later either.
            while let Some(partner) = end {
                let row_before = reached_from[partner];
                end = self.partners[row_before].map(|partner| partner as usize);
                self.pair(row_before, partner);
                if row_before == row {
                    visited.drain(..).for_each(|partner| is_visited[partner] = false);
                    end = None;
                }
            }
        }
        self.tree = Some(tree);
    }
}

/// The unit in which differences of a column are measured if no error is declared.
fn typical_difference(column: &Column, source: &Gaussians) -> f64 {
    let [rotation, scale, opacity, other] = TYPICAL;
    match (column.attribute, column.activation) {
        (Attribute::Mean, _) => {
            let sizes = source.log_scales().iter().map(|of| of[0].max(of[1]).max(of[2]));
            f64::from(upper_median(sizes).unwrap_or_default()).exp().clamp(1e-30, 1e30)
        }
        (Attribute::Quat, _) => rotation,
        (Attribute::LogScale, _) => scale,
        (_, Activation::Sigmoid) => opacity,
        _ => other,
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::Layout;

    use super::*;

    fn line(xs: &[f32]) -> Gaussians {
        let mut gaussians = Gaussians::zeros(xs.len());
        gaussians.means_mut().iter_mut().zip(xs).for_each(|(mean, &x)| mean[0] = x);
        gaussians
    }

    fn pairs(source: &[f32], file: &[f32], bound: f32) -> (Vec<Option<u32>>, usize) {
        let declared: Vec<(String, f32)> =
            Layout::base().columns().iter().map(|column| (column.name.clone(), bound)).collect();
        let bounds = Bounds::new(Layout::base().columns(), &declared);
        let found = bounds.pairs(&line(source), &line(file), &Pairs::default());
        (found.partners, found.num_beyond)
    }

    #[test]
    fn order_does_not_matter_and_some_are_left_out() {
        assert_eq!(pairs(&[0.0, 1.0, 2.0, 3.0], &[2.25, 0.0], 0.25), (vec![Some(2), Some(0)], 0));
        assert_eq!(pairs(&[], &[], 0.25), (vec![], 0));
        assert_eq!(pairs(&[0.5], &[], 0.0), (vec![], 0));
        // Equal Gaussians are interchangeable, but no two share a partner.
        let (partners, beyond) = pairs(&[1.0; 40], &[1.0; 40], 0.0);
        let mut partners: Vec<u32> = partners.into_iter().flatten().collect();
        partners.sort_unstable();
        assert!(beyond == 0 && partners.into_iter().eq(0..40));
    }

    #[test]
    fn the_nearest_gives_way_where_another_has_no_choice() {
        // 0.5 is nearest to the first, which is all that the second reaches; and so on along a chain.
        let source: Vec<f32> = (0..30).map(|i| i as f32).collect();
        let file: Vec<f32> = (0..30).map(|i| i as f32 + if i == 29 { -0.75 } else { 0.5 }).rev().collect();
        let (partners, beyond) = pairs(&source, &file, 0.8);
        assert_eq!(beyond, 0);
        for (row, partner) in partners.iter().enumerate() {
            let distance = (file[row] - source[partner.unwrap() as usize]).abs();
            assert!(distance <= 0.8, "{row}: {distance}");
        }
        // 0.4, 0.5 and 0.6 reach 0 and 1 only: one has no partner.
        assert_eq!(pairs(&[0.0, 1.0, 5.0], &[0.4, 0.5, 0.6], 0.8).1, 1);
    }

    #[test]
    fn what_is_beyond_the_bounds_is_counted_and_paired_for_the_table() {
        assert_eq!(pairs(&[0.0, 1.0], &[0.0, 1.5], 0.25), (vec![Some(0), Some(1)], 1));
        assert_eq!(pairs(&[0.0], &[0.0, 0.0], 0.25), (vec![Some(0), None], 1));
        assert_eq!(pairs(&[0.0], &[f32::NAN], 0.25).1, 1);
    }

    #[test]
    fn without_bounds_the_nearest_are_pairs() {
        let bounds = Bounds::new(Layout::base().columns(), &[]);
        let found = bounds.pairs(&line(&[0.0, 1.0, 2.0]), &line(&[1.9, 1.2]), &Pairs::default());
        assert_eq!((found.partners, found.num_beyond), (vec![Some(2), Some(1)], 0));
    }
}

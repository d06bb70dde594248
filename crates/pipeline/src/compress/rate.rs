//! Fewer bytes before a refinement: a quality as coarse, and Gaussians as few, as the images allow.
//!
//! Both are limited by the mean squared error of training images, relative to that of the floats. Where the floats
//! themselves err much, as with noisy cameras, fine codes store noise; where they err little, fine codes show.
//! Refinement takes back much of the allowed error.

use tcgs_codec::{CompactScene, CompressSettings};
use tcgs_core::{Gaussians, View};
use tcgs_train::{Removal, TimestepViews, judge_stride, needed};

use super::{Pruned, PrunedScene};
use crate::PipelineError;

/// Error that refinement is left to take back. Shares are of the mean squared error of training images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowance {
    /// Growth by rounding and keypoints: the quality is the lowest at which they cause about so much. None: settings
    /// stay. Default 0.15.
    pub rounding: Option<f32>,
    /// Growth by removal of Gaussians, of which those go first whose bytes lower the error least. Default 0.1; 0: all
    /// stay.
    pub removal: f32,
}

impl Default for Allowance {
    fn default() -> Self {
        Self { rounding: Some(0.15), removal: 0.1 }
    }
}

impl Allowance {
    /// Settings and Gaussians stay as they are.
    pub const NONE: Self = Self { rounding: None, removal: 0.0 };

    /// For a refinement of so many iterations: a short one takes less error back.
    pub(super) fn within(self, iterations: usize) -> Self {
        let share = (iterations as f32 / RECOVERY).min(1.0);
        Self { rounding: self.rounding.map(|rounding| share * rounding), removal: share * self.removal }
    }

    /// For settings of a given quality ([`CompressSettings::with_quality`]), which stay. Above 0 each step of 1 divides
    /// the allowed error by 4, as it does the error of rounding.
    pub fn at_quality(quality: f32) -> Self {
        Self { rounding: None, removal: Self::default().removal * 4.0_f32.powf(-quality.max(0.0)) }
    }
}

/// Fewest iterations of a refinement that takes back the whole allowance.
const RECOVERY: f32 = 1000.0;
/// Steps of quality to a quality of 1.
const QUALITY_STEPS: f32 = 4.0;
/// The lowest quality that is chosen, in steps. Below it SSIM falls faster than the squared error tells.
const LOWEST: i32 = -8;
/// The highest quality that is chosen, in steps. Where views are sparse it is 0: training fits their images more
/// closely than the scene, so rounding that shows in them need not show in others.
const HIGHEST: f32 = 8.0;
/// Largest share of the Gaussians that is removed.
const MOST_REMOVED: f32 = 0.6;
/// Bits that a keypoint after a track's first takes in the file, as a share of its width. Measured on basketball.
const LATER_SHARE: f32 = 0.4;

/// Training images of one timestep.
pub(super) struct Visit {
    pub timestep: usize,
    pub views: Vec<View>,
    /// `[views]` gain, as its logarithm, and offset of each view's camera.
    pub corrections: Vec<[[f32; 3]; 2]>,
}

/// Scenes that [`choose_quality`] measures at most: the floats, and a bisection of the qualities.
pub(super) const NUM_MEASURED: usize = 6;

/// The lowest quality at which rounding and keypoints let the error grow by at most about a share of it.
///
/// - `settings`: those of quality 0
/// - `sparsity`: of the views ([`view_sparsity`](tcgs_train::view_sparsity))
/// - `visited`: called after each visit of each scene that is measured
pub(super) fn choose_quality(
    pruned: &PrunedScene<'_>,
    settings: &CompressSettings,
    visits: &[Visit],
    share: f32,
    sparsity: f32,
    visited: &mut dyn FnMut(&Visit) -> Result<(), PipelineError>,
) -> Result<f32, PipelineError> {
    let mut scales = Scales { pruned, visits, visited };
    let most = f64::from(1.0 + share) * scales.error_of_floats()?;
    let quality = |step: i32| step as f32 / QUALITY_STEPS;
    // `high` is fine enough, or the finest there is; `low` is not fine enough.
    let (mut low, mut high) = (LOWEST - 1, highest(sparsity));
    while high - low > 1 {
        let middle = low.midpoint(high);
        let error = scales.error_of(&settings.clone().with_quality(quality(middle)))?;
        if error <= most { high = middle } else { low = middle }
    }
    Ok(quality(high))
}

/// The highest quality that is chosen, in steps.
fn highest(sparsity: f32) -> i32 {
    (HIGHEST * (1.0 - sparsity)).round() as i32
}

/// Weighs settings by training images.
struct Scales<'a> {
    pruned: &'a PrunedScene<'a>,
    visits: &'a [Visit],
    visited: &'a mut dyn FnMut(&Visit) -> Result<(), PipelineError>,
}

impl Scales<'_> {
    fn error_of_floats(&mut self) -> Result<f64, PipelineError> {
        let Pruned::Whole { kept, lives, .. } = &self.pruned.content else { return Ok(0.0) };
        self.sum(kept.num_gaussians(), &|timestep| kept.at(timestep), &|gaussian, timestep| {
            lives.as_ref().is_none_or(|lives| lives[gaussian].contains(timestep))
        })
    }

    fn error_of(&mut self, settings: &CompressSettings) -> Result<f64, PipelineError> {
        let Some((compact, _)) = self.pruned.symbols(settings)? else { return Ok(0.0) };
        let is_alive = |gaussian: usize, timestep: usize| compact.is_alive(gaussian, timestep);
        self.sum(compact.num_gaussians(), &|timestep| Ok(compact.at(timestep)), &is_alive)
    }

    /// Mean squared errors of some views, summed.
    fn sum(
        &mut self,
        num_gaussians: usize,
        at: &dyn Fn(usize) -> Result<Gaussians, PipelineError>,
        is_alive: &dyn Fn(usize, usize) -> bool,
    ) -> Result<f64, PipelineError> {
        let stride = judge_stride(self.visits.iter().map(|visit| visit.views.len()).sum());
        let mut sum = 0.0;
        for visit in self.visits {
            let is_hidden: Vec<bool> = (0..num_gaussians).map(|gaussian| !is_alive(gaussian, visit.timestep)).collect();
            sum += visit.with(&at(visit.timestep)?, &is_hidden).error_without(&[], stride);
            (self.visited)(visit)?;
        }
        Ok(sum)
    }
}

/// The scene without the Gaussians whose bytes lower the error least. A Gaussian that lives at no visit stays.
///
/// - `share`: by how much the error may grow, as a share of it
pub(super) fn without_costly<'a>(
    pruned: &PrunedScene<'a>,
    settings: &CompressSettings,
    visits: &[Visit],
    share: f32,
) -> Result<PrunedScene<'a>, PipelineError> {
    let Some((compact, order)) = pruned.symbols(settings)? else { return Ok(pruned.select(&[])) };
    let of_visit = |visit: &Visit| {
        let is_hidden = (0..compact.num_gaussians()).map(|gaussian| !compact.is_alive(gaussian, visit.timestep));
        (compact.at(visit.timestep), is_hidden.collect())
    };
    let states: Vec<(Gaussians, Vec<bool>)> = visits.iter().map(of_visit).collect();
    let timesteps: Vec<TimestepViews<'_>> =
        visits.iter().zip(&states).map(|(visit, (gaussians, is_hidden))| visit.with(gaussians, is_hidden)).collect();
    let removal = Removal { share, most: MOST_REMOVED, costs: Some(&costs(&compact)), seed: 0 };
    let mut stays: Vec<bool> =
        (0..order.len()).map(|gaussian| states.iter().all(|(_, is_hidden)| is_hidden[gaussian])).collect();
    needed(&timesteps, &removal).rows.into_iter().for_each(|gaussian| stays[gaussian] = true);
    let mut rows: Vec<usize> = order.into_iter().zip(stays).filter_map(|(row, stays)| stays.then_some(row)).collect();
    rows.sort_unstable();
    Ok(pruned.select(&rows))
}

impl Visit {
    fn with<'a>(&'a self, gaussians: &'a Gaussians, is_hidden: &'a [bool]) -> TimestepViews<'a> {
        TimestepViews { gaussians, is_hidden, views: &self.views, corrections: &self.corrections }
    }
}

/// `[N]` about how many bits each Gaussian takes in the file.
fn costs(compact: &CompactScene) -> Vec<f32> {
    let mut costs = vec![0.0; compact.num_gaussians()];
    for attribute in compact.layout.attributes() {
        let components = attribute.components();
        let tracks = &compact.tracks[attribute.index()];
        for (gaussian, cost) in costs.iter_mut().enumerate() {
            let width = f32::from(compact.bit_map.widths[attribute.index()][gaussian]);
            for track in gaussian * components..(gaussian + 1) * components {
                *cost += width * (1.0 + LATER_SHARE * (tracks.track(track).0.len() - 1) as f32);
            }
        }
    }
    costs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sparse_views_choose_no_finer_quality_than_0() {
        assert_eq!([0.0, 0.5, 1.0].map(highest), [8, 4, 0]);
    }
}

//! Prepares timesteps for a renderer that draws quads from back to front: rows of activated Gaussians, and the order in
//! which they are drawn from a camera. It runs in the worker of a page, on one thread.
//!
//! The values are those of [`tcgs_codec::Sampler`], activated as [`tcgs_core::activate`] does; with spherical harmonics
//! the colours are those that the camera sees.
//!
//! - `mod`: the rows of the cohorts that live at a timestep
//! - `rows`: one row; `order`: which rows are drawn, and in which order

mod order;
mod rows;

use std::sync::Arc;

use tcgs_codec::{Sampler, Segment};
use tcgs_core::{Attribute, Camera, Gaussians, Life, seen_colors, sigmoid};

use crate::holdings::Moment;
use order::Order;
pub use rows::{LINE, ROW_WORDS, ground};
use rows::{Row, reach};

/// Rows of a timestep, and their order from a camera.
///
/// ```
/// use tcgs_core::Camera;
/// use tcgs_play::{Arranger, BytesSource, Player, PlayerSettings, ROW_WORDS};
/// let file = include_bytes!("../../../../testdata/bitstream/v1/room_default.tcgs");
/// let mut player = Player::new(BytesSource::new(*file), PlayerSettings::default(), 0);
/// while player.current().is_none_or(|moment| !moment.is_whole) {
///     player.update(0.0)?;
/// }
/// let moment = player.current().expect("it is whole");
/// let camera = Camera::look_at([0.0, -1.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 300.0, 640, 360);
/// let mut arranger = Arranger::default();
/// assert!(arranger.arrange(&moment, &camera).has_new_rows);
/// assert!(arranger.rows().len() >= ROW_WORDS * moment.gaussians().num_gaussians());
/// assert!(!arranger.order().is_empty());
/// assert!(!arranger.arrange(&moment, &camera).has_new_order, "it is there already");
/// # Ok::<(), tcgs_play::PlayError>(())
/// ```
#[derive(Default)]
pub struct Arranger {
    cohorts: Vec<CohortRows>,
    /// `[N]` rows of all cohorts, and unused ones up to a whole number of lines.
    rows: Vec<Row>,
    /// `[N]` largest standard deviation of each Gaussian, scene units; negative if it is not drawn at the timestep.
    reaches: Vec<f32>,
    order: Order,
    /// The camera of the order.
    camera: Option<Camera>,
}

/// What [`Arranger::arrange`] changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Changes {
    /// Whether a row changed; the order is new then, too.
    pub has_new_rows: bool,
    /// Whether the order is new.
    pub has_new_order: bool,
}

/// A cohort with one of its segments.
struct CohortRows {
    segment: Arc<Segment>,
    sampler: Sampler,
    /// The timestep in the rows.
    timestep: usize,
    /// Position of the camera for which the colours were computed, if the cohort has spherical harmonics.
    eye: Option<[f64; 3]>,
    /// Attributes that move, each with the Gaussians of which it moves, ascending.
    moving: Vec<(Attribute, Vec<u32>)>,
}

impl Arranger {
    /// Writes the rows of a timestep, and their order, as a camera sees it.
    pub fn arrange(&mut self, moment: &Moment, camera: &Camera) -> Changes {
        let has_new_rows = self.load(moment, camera);
        let has_new_order = has_new_rows || self.camera.as_ref() != Some(camera);
        if has_new_order {
            let Self { rows, reaches, order, .. } = self;
            order.sort_rows(rows.iter().map(Row::mean).zip(reaches.iter().copied()), camera);
            self.camera = Some(camera.clone());
        }
        Changes { has_new_rows, has_new_order }
    }

    /// Writes the rows of a timestep; returns whether a row changed.
    fn load(&mut self, moment: &Moment, camera: &Camera) -> bool {
        let is_same = |cohort: &CohortRows, segment: &Arc<Segment>| Arc::ptr_eq(&cohort.segment, segment);
        let is_loaded = self.cohorts.len() == moment.segments.len()
            && self.cohorts.iter().zip(&moment.segments).all(|(cohort, segment)| is_same(cohort, segment));
        if !is_loaded {
            let mut before = std::mem::take(&mut self.cohorts);
            for segment in &moment.segments {
                let held = before.iter().position(|cohort| is_same(cohort, segment));
                let cohort = held.map(|index| before.swap_remove(index));
                self.cohorts.push(cohort.unwrap_or_else(|| CohortRows::new(segment)));
            }
            let num_rows: usize = moment.segments.iter().map(|segment| segment.num_gaussians()).sum();
            self.rows.clear();
            self.rows.resize(num_rows.next_multiple_of(LINE), Row::default());
            self.reaches.clear();
            self.reaches.resize(num_rows, -1.0);
        }
        let (mut has_changed, mut first) = (!is_loaded, 0);
        for cohort in &mut self.cohorts {
            let rows = first..first + cohort.segment.num_gaussians();
            first = rows.end;
            let (reaches, rows) = (&mut self.reaches[rows.clone()], &mut self.rows[rows]);
            has_changed |= cohort.load(moment.timestep, camera, !is_loaded, rows, reaches);
        }
        has_changed
    }

    /// The rows of the last [`Self::arrange`], [`ROW_WORDS`] words each. The number of rows is a multiple of [`LINE`].
    ///
    /// - words 0 to 3: bits of the mean, halves of red and green
    /// - words 4 to 7: bits of the unit quaternion `w, x, y, z`
    /// - words 8 to 11: bits of the scales, halves of blue and opacity
    pub fn rows(&self) -> &[u32] {
        bytemuck::cast_slice(&self.rows)
    }

    /// Indices of the rows that may be visible, the farthest first.
    pub fn order(&self) -> &[u32] {
        self.order.rows()
    }
}

impl CohortRows {
    fn new(segment: &Arc<Segment>) -> Self {
        let moving = segment.layout().attributes().filter(|&attribute| segment.keypoints(attribute).is_some());
        let moving = moving.map(|attribute| {
            let components = attribute.components() as u32;
            let mut gaussians: Vec<u32> =
                segment.moving_units(attribute).map(|(place, _)| place / components).collect();
            gaussians.dedup();
            (attribute, gaussians)
        });
        Self {
            segment: Arc::clone(segment),
            sampler: Sampler::new(segment),
            timestep: usize::MAX,
            eye: None,
            moving: moving.collect(),
        }
    }

    /// Writes what has changed, or all; returns whether anything was written.
    fn load(&mut self, timestep: usize, camera: &Camera, all: bool, rows: &mut [Row], reaches: &mut [f32]) -> bool {
        let has_harmonics = !self.segment.layout().harmonics().is_empty();
        let has_moved = self.timestep != timestep;
        let has_turned = has_harmonics && self.eye != Some(camera.center());
        if !all && !has_moved && !has_turned {
            return false;
        }
        let first = self.segment.start();
        let now = self.sampler.at(timestep);
        let lives = self.segment.lives();
        if all {
            for attribute in Attribute::BASE {
                write(attribute, now, 0..now.num_gaussians(), rows);
            }
        } else if has_moved {
            for (attribute, gaussians) in &self.moving {
                write(*attribute, now, gaussians.iter().map(|&g| g as usize), rows);
            }
        }
        let resizes = |attribute: &Attribute| matches!(*attribute, Attribute::LogScale | Attribute::LogitOpacity);
        if all || has_moved && (lives.is_some() || self.moving.iter().any(|(attribute, _)| resizes(attribute))) {
            let lives_now = |g: usize| lives.is_none_or(|lives: &[Life]| lives[g].contains(timestep - first));
            for (g, (reaches, row)) in reaches.iter_mut().zip(&*rows).enumerate() {
                *reaches = if lives_now(g) { reach(row) } else { -1.0 };
            }
        }
        if has_harmonics {
            for (row, color) in rows.iter_mut().zip(seen_colors(now, camera).as_chunks::<3>().0) {
                row.set_color(*color);
            }
            self.eye = Some(camera.center());
        }
        self.timestep = timestep;
        true
    }
}

/// Writes the activated values of an attribute of some Gaussians.
fn write(attribute: Attribute, now: &Gaussians, gaussians: impl Iterator<Item = usize>, rows: &mut [Row]) {
    match attribute {
        Attribute::Mean => gaussians.for_each(|g| rows[g].set_mean(now.means()[g])),
        // The sampler normalises them.
        Attribute::Quat => gaussians.for_each(|g| rows[g].set_quat(now.quats()[g])),
        Attribute::LogScale => gaussians.for_each(|g| rows[g].set_scale(now.log_scales()[g].map(f32::exp))),
        Attribute::LogitOpacity => gaussians.for_each(|g| rows[g].set_opacity(sigmoid(now.logit_opacities()[g]))),
        Attribute::Color => gaussians.for_each(|g| rows[g].set_color(now.colors()[g])),
        // Harmonics change the colours, and what a renderer does not know is not drawn.
        Attribute::Extra { .. } => {}
    }
}

//! The gate: chooses the Gaussians and the tiles that a timestep trains.
//!
//! Between two frames of most captures almost nothing changes. The gate compares a timestep's images with the state
//! before it and decides what changed:
//!
//! 1. **Evidence** (`evidence`): blocks of a view whose image differs from the previous image by more than the camera's
//!    noise. Also tiles in which the error of the scene's picture has grown since they were last trained.
//! 2. **Activity** (`activity`): a Gaussian is *active* if a large enough share of its contribution to all pictures
//!    falls on blocks with evidence. Every other Gaussian is *locked* and keeps every bit. A Gaussian's contribution is
//!    its blending weight, the gradient of a picture to its colour.
//! 3. **Matches** (`matches`): the start of active Gaussians whose motion differs from constant velocity.
//! 4. The timestep then trains a small state, the active Gaussians, in the tiles with evidence, against the `Scenery`
//!    of everything else ([`crate::engine::Scenery`]).
//! 5. The losses decide the number of iterations (`pace`).
//!
//! The reference, and the presets `d3dgs` and `paper`, train everything everywhere.

mod activity;
mod evidence;
mod matches;
mod pace;

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{Activated, Camera, Image, View, upper_median};
use tcgs_render::{CpuRasterizer, Laps, RenderSettings, Scope, TileMask, tiles_reached};

pub use self::activity::Trained;
pub(crate) use self::activity::{Activity, Shares, scenery_of};
#[cfg(test)]
pub(crate) use self::evidence::NOISE_DEVIATIONS;
pub(crate) use self::evidence::{Blocks, CONTRAST, tiles_of};
use self::evidence::{changed_blocks, differences, noise_level, tile_errors};
use self::matches::{Matches, Mover};
pub(crate) use self::pace::Pace;
#[cfg(test)]
pub(crate) use self::pace::SETTLED_PACE;
use crate::TrainError;
use crate::config::{GateConfig, MaskConfig};
use crate::engine::cpu::Drawn;
use crate::engine::{LookRenderer, Target};
use crate::state::State;

/// The number of noise estimates of a camera whose median counts.
const NOISE_ESTIMATES: usize = 9;
/// A tile's mean absolute error may grow by this much since the tile was last trained without being evidence, in units
/// of colour.
pub(crate) const GROWTH: f32 = 0.006;
/// A tile's error may grow by this share of the noise level without being evidence, beyond [`GROWTH`]. A tile has
/// sixteen blocks.
const GROWTH_NOISE: f32 = 0.1;
/// A block is unexplained if its error exceeds this multiple of its tile's error when that was last explained, beyond
/// [`UNEXPLAINED_CONTRAST`].
const UNEXPLAINED_GROWTH: f32 = 1.5;
/// Least mean absolute error of an unexplained block, beyond the camera's noise and the error that its tile had when it
/// was last explained; in units of colour.
pub(crate) const UNEXPLAINED_CONTRAST: f32 = 0.02;
/// When training could not lower a tile's error, the gate accepts this share of the growth per timestep. Until then the
/// tile still has evidence, because uncovered content has blending weights only from the next timestep on.
const PATIENCE: f32 = 0.25;

/// Newborn Gaussians start at constant velocity in this many timesteps after the one of their birth. An entering object
/// is seen only in part at first, and its visible end, the edge of its occluder, does not move.
const ENTRY: u32 = 2;

/// State of the gate at the end of a timestep that cannot be measured again: part of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GateRecord {
    /// `[cameras][up to 9]` the last noise estimates of each camera, newest last: the mean absolute difference up to
    /// which noise explains a block, in units of colour.
    pub noise: Vec<Vec<f32>>,
    /// `[cameras][tiles]` mean absolute error of the scene's picture in each tile, when it was last trained.
    pub errors: Vec<Vec<f32>>,
}

/// The gate's memory of each view from one timestep to the next.
#[derive(Clone, Debug)]
struct Memory {
    /// The images of the previous timestep; none while a timestep is trained.
    before: Arc<[Target]>,
    /// `[C, H, W]`, the scene as it is now, before the cameras' gain and offset.
    pictures: Vec<Image>,
}

/// The gate of a run.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    config: GateConfig,
    mask: MaskConfig,
    record: GateRecord,
    memory: Option<Memory>,
}

/// The evidence of one view.
struct Evidence {
    blocks: Blocks,
    tiles: TileMask,
}

impl Gate {
    /// - `record`: from the checkpoint that the run resumes from; empty at the start of a run
    pub fn new(config: &GateConfig, mask: &MaskConfig, record: GateRecord) -> Self {
        Self { config: config.clone(), mask: mask.clone(), record, memory: None }
    }

    /// Whether the gate has a record but lacks the images that belong to it.
    pub fn forgot(&self) -> bool {
        self.memory.is_none() && !self.record.errors.is_empty()
    }

    pub fn record(&self) -> &GateRecord {
        &self.record
    }

    /// Takes the images of the timestep from which a run resumes.
    pub fn recall(&mut self, state: &State, targets: Arc<[Target]>) {
        if self.record.errors.len() == targets.len() {
            self.remember(state, targets);
        }
    }

    /// Starts from the result of a timestep that trained everything.
    pub fn begin(&mut self, state: &State, targets: Arc<[Target]>) {
        self.record = GateRecord { noise: vec![Vec::new(); targets.len()], ..GateRecord::default() };
        self.remember(state, targets);
        let views = self.memory.iter().flat_map(|memory| memory.pictures.iter().zip(&*memory.before));
        self.record.errors = views.enumerate().map(|(i, (p, target))| errors(state, i, p, &target.image)).collect();
    }

    fn remember(&mut self, state: &State, before: Arc<[Target]>) {
        let with_segmentation = before.iter().all(|target| target.image.num_channels > 3);
        let drawn = Drawn::new(state, &self.mask, with_segmentation);
        let pictures = before.par_iter().map(|target| {
            let (width, height) = (target.image.width, target.image.height);
            let mut picture = Image::filled(width, height, drawn.activated().num_channels, 0.0);
            redraw(&drawn, &target.camera, &TileMask::all(width, height), &mut picture);
            picture
        });
        let pictures = pictures.collect();
        self.memory = Some(Memory { before, pictures });
    }

    /// Finds what a timestep must train, and lets go of the images of the previous timestep. Called once a timestep.
    ///
    /// - `state`: after the previous timestep, with its past
    /// - returns: `None` if the gate does not know the previous images; everything then counts as changed
    ///
    /// # Errors
    /// Those of the renderer.
    pub fn look(
        &mut self,
        renderer: &dyn LookRenderer,
        state: &State,
        targets: &[Target],
    ) -> Result<Option<Activity>, TrainError> {
        let size = |target: &Target| [target.image.width, target.image.height];
        let fits = |memory: &&mut Memory| memory.before.iter().map(size).eq(targets.iter().map(size));
        let Some(memory) = self.memory.as_mut().filter(fits) else { return Ok(None) };
        let all_before = std::mem::take(&mut memory.before);
        let config = &self.config;
        let evidence: Vec<Evidence> =
            (&mut self.record.noise, &self.record.errors, &*all_before, &memory.pictures, targets)
                .into_par_iter()
                .enumerate()
                .map(|(i, (estimates, reference, before, picture, target))| {
                    let differences = differences(&before.image, &target.image);
                    estimates.push(noise_level(&differences));
                    let too_many = estimates.len().saturating_sub(NOISE_ESTIMATES);
                    estimates.drain(..too_many);
                    let level = upper_median(estimates.iter().copied()).unwrap_or_default();
                    let (width, height) = (target.image.width, target.image.height);
                    let mut blocks = changed_blocks(&differences, level + CONTRAST, width, height);
                    let limit = GROWTH + GROWTH_NOISE * level;
                    let tiles = TileMask::none(width, height);
                    for (tile, error) in errors(state, i, picture, &target.image).into_iter().enumerate() {
                        if error > reference[tile] + limit {
                            let [columns, rows] = tiles.pixels(tile, width, height);
                            blocks.mark(columns, rows);
                        }
                    }
                    Evidence { tiles: tiles_of(&blocks, width, height), blocks }
                })
                .collect();
        let mut activity = Activity::new(renderer, state, &self.mask, targets, evidence, &memory.pictures, config)?;
        if config.matches {
            activity.corrections = corrections(state, &activity, &all_before, targets);
        }
        Ok(Some(activity))
    }

    /// `[cameras]`, the scene as it is now, before the cameras' gain and offset; none before [`Self::begin`].
    pub fn pictures(&self) -> &[Image] {
        self.memory.as_ref().map_or(&[], |memory| &memory.pictures)
    }

    /// The state as drawn, with as many channels as the pictures.
    pub fn drawn(&self, state: &State) -> Drawn {
        let with_segmentation = self.memory.as_ref().is_some_and(|memory| memory.pictures[0].num_channels > 3);
        Drawn::new(state, &self.mask, with_segmentation)
    }

    /// Redraws the pictures where the Gaussians of an activity changed.
    ///
    /// - `state`: after the timestep
    pub fn redraw(&mut self, state: &State, views: &[View], activity: &Activity) {
        self.redraw_rows(state, views, &activity.active, &activity.before);
    }

    /// Draws the Gaussians born at the end of a timestep.
    ///
    /// - `count`: their number; they are the last ones of `state`
    pub fn welcome(&mut self, state: &State, views: &[View], count: usize) {
        let n = state.parameters.num_gaussians();
        let channels = self.memory.as_ref().map_or(3, |memory| memory.pictures[0].num_channels);
        let nothing = Activated { num_channels: channels, ..Activated::default() };
        self.redraw_rows(state, views, &(n - count..n).collect::<Vec<_>>(), &nothing);
    }

    /// Redraws the tiles that some Gaussians reach.
    ///
    /// - `rows`: indices of these Gaussians
    /// - `before`: these Gaussians as drawn before
    pub fn redraw_rows(&mut self, state: &State, views: &[View], rows: &[usize], before: &Activated) {
        if rows.is_empty() && before.num_gaussians() == 0 {
            return;
        }
        let all = self.drawn(state);
        let Some(memory) = &mut self.memory else { return };
        let after = all.activated().select(rows);
        (&mut memory.pictures, views).into_par_iter().for_each(|(picture, view)| {
            let mut tiles = tiles_reached(before, &view.camera);
            tiles.union(&tiles_reached(&after, &view.camera));
            redraw(&all, &view.camera, &tiles, picture);
        });
    }

    /// Blocks of each view that the scene does not explain, among the tiles trained in a timestep.
    ///
    /// A block is unexplained if its mean absolute error exceeds [`UNEXPLAINED_GROWTH`] times the error that its tile
    /// had when it was last explained, by more than [`UNEXPLAINED_CONTRAST`] and the camera's noise.
    ///
    /// - `state`: after the timestep; [`Self::redraw`] has drawn its pictures
    pub fn unexplained(&self, state: &State, views: &[View], activity: &Activity) -> Vec<Blocks> {
        let Some(memory) = &self.memory else { return Vec::new() };
        let p = &state.parameters;
        let of_view = |(i, view): (usize, &View)| {
            let (width, height) = (view.image.width, view.image.height);
            let seen = p.seen_by_camera(i, memory.pictures[i].clone());
            let mut blocks = Blocks::none(width, height);
            let differences = differences(&seen, &view.image);
            let level = upper_median(self.record.noise[i].iter().copied()).unwrap_or_default() + UNEXPLAINED_CONTRAST;
            for (index, difference) in differences.into_iter().enumerate() {
                let tile = activity.tiles[i].of_pixel(blocks.pixel(index));
                let limit = UNEXPLAINED_GROWTH * self.record.errors[i][tile] + level;
                blocks.is_marked[index] = activity.tiles[i].contains(tile) && difference > limit;
            }
            blocks.with_around(2).and(&blocks)
        };
        views.par_iter().enumerate().map(of_view).collect()
    }

    /// Takes the images and updates the reference errors after a timestep that trained an activity.
    ///
    /// - `state`: after the timestep; [`Self::redraw`] has drawn its pictures
    pub fn end(&mut self, state: &State, targets: Arc<[Target]>, activity: &Activity) {
        let Some(memory) = &mut self.memory else { return };
        memory.before = targets;
        let of_views =
            (&mut self.record.errors, &memory.pictures, &*memory.before, &activity.tiles).into_par_iter().enumerate();
        of_views.filter(|(_, (.., tiles))| !tiles.is_empty()).for_each(|(i, (reference, picture, target, tiles))| {
            let errors = errors(state, i, picture, &target.image);
            for tile in tiles.iter() {
                let grown = errors[tile] - reference[tile];
                reference[tile] += if grown > 0.0 { PATIENCE * grown } else { grown };
            }
        });
    }
}

/// Corrections to the start of active Gaussians at constant velocity, from matches between the images of two timesteps.
///
/// - `state`: after the previous timestep, with its past
/// - `before`: `[cameras]`, of the previous timestep
/// - returns: `[active, 3]`, scene units
fn corrections(state: &State, activity: &Activity, before: &[Target], targets: &[Target]) -> Vec<[f32; 3]> {
    let Some(past) = &state.past else { return Vec::new() };
    let (means, earlier) = (state.parameters.gaussians.means(), past.previous.means());
    let mover = |&i: &usize| Mover {
        mean: means[i],
        velocity: std::array::from_fn(|a| means[i][a] - earlier[i][a]),
        foreground: state.parameters.foreground[i],
    };
    let movers: Vec<Mover> = activity.active.iter().map(mover).collect();
    let cameras: Vec<&Camera> = targets.iter().map(|target| &target.camera).collect();
    let [before, now] = [before, targets].map(|all| all.iter().map(|target| &target.image).collect::<Vec<_>>());
    let births = state.lifetimes.births();
    let mut corrections = Matches::new(&movers, &activity.weights, &cameras, &before, &now).corrections();
    for (correction, &i) in corrections.iter_mut().zip(&activity.active) {
        let birth = births[i];
        if birth > 0 && (state.timestep as u32) < birth + ENTRY {
            *correction = [0.0; 3];
        }
    }
    corrections
}

/// See [`tile_errors`].
fn errors(state: &State, camera: usize, picture: &Image, target: &Image) -> Vec<f32> {
    let p = &state.parameters;
    tile_errors(picture, target, p.camera_gains[camera], p.camera_offsets[camera])
}

fn redraw(drawn: &Drawn, camera: &Camera, tiles: &TileMask, picture: &mut Image) {
    if !tiles.is_empty() {
        let drawn = drawn.seen_by(camera);
        let (settings, laps) = (RenderSettings::default(), &mut Laps::begin());
        CpuRasterizer.forward_in(&drawn, camera, &settings, Scope::Tiles(tiles), picture, laps);
    }
}

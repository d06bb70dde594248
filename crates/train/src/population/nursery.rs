//! The nursery: newborn and young Gaussians learn all their attributes, alone. The engine draws the tiles that they
//! reach, with the rest of the scene held.

use std::ops::ControlFlow;
use std::sync::Arc;

use tcgs_core::{Camera, View};
use tcgs_render::{TileMask, tiles_reached};

use crate::TrainError;
use crate::engine::Scenery;
use crate::engine::cpu::Drawn;
use crate::gate::{Blocks, Gate, Pace, Shares, scenery_of, tiles_of};
use crate::parameters::Parameters;
use crate::schedule::Phase;
use crate::solver::{Asked, Part, Solver};
use crate::state::State;

/// The surroundings of a few Gaussians that learn all their attributes.
pub(super) struct Nursery {
    scenery: Scenery,
    /// Positions of the views in which something is drawn.
    cameras: Vec<usize>,
}

impl Nursery {
    /// - `gate`: holds the pictures of the scene
    /// - `all`: the scene, including the Gaussians that learn
    /// - `rows`: indices of the Gaussians that learn
    /// - `unexplained`: `[views]`, drawn in addition to the tiles that they reach
    pub fn new(gate: &Gate, all: &Drawn, rows: &[usize], views: &[View], unexplained: Option<&[Blocks]>) -> Self {
        let few = all.activated().select(rows);
        let of_view = |(i, view): (usize, &View)| {
            let mut tiles = tiles_reached(&few, &view.camera);
            if let Some(unexplained) = unexplained {
                tiles.union(&tiles_of(&unexplained[i], view.image.width, view.image.height));
            }
            tiles
        };
        let tiles: Vec<TileMask> = views.iter().enumerate().map(of_view).collect();
        let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
        let scenery = scenery_of(all, rows, rows.len(), &tiles, gate.pictures(), &cameras);
        Self { scenery, cameras: (0..views.len()).filter(|&i| !tiles[i].is_empty()).collect() }
    }

    /// Trains all attributes of a few Gaussians, and leaves the engine's state as it was.
    ///
    /// - `small`: these Gaussians alone
    /// - `rows`: their indices in the scene; none if they have not joined it
    /// - `asks`: of each iteration
    /// - returns: their trained values
    pub fn train(
        self,
        solver: &mut Solver,
        phase: Phase,
        small: State,
        rows: Option<&[usize]>,
        asks: impl Fn(usize) -> Asked,
    ) -> Result<State, TrainError> {
        let shares = Shares::of(&small.parameters.foreground, &solver.engine.state()?.parameters.foreground);
        let whole = std::mem::replace(solver.engine.state_mut()?, small);
        let part = Part { shares, of: rows.map(|rows| (&whole.parameters, rows)) };
        let num_views = solver.targets.len();
        solver.engine.begin(Arc::clone(&solver.targets), Some(self.scenery))?;
        let length = (solver.schedule.iterations(phase) * self.cameras.len()).div_ceil(num_views);
        let pace = Pace::even(length, self.cameras.len());
        let mut iterations = solver.iterations(phase, self.cameras, pace, Some(part));
        let ignore = &mut |_: &_| ControlFlow::Continue(());
        while let Some(iteration) = solver.next(&mut iterations) {
            solver.step(&mut iterations, iteration, asks(iteration), ignore)?;
        }
        solver.finish(iterations, ignore)?;
        let trained = std::mem::replace(solver.engine.state_mut()?, whole);
        solver.engine.end();
        Ok(trained)
    }
}

/// A state of the newborn or the young without the scene.
pub(super) fn alone(few: Parameters, scene: &State) -> State {
    let count = few.num_gaussians();
    let quantizers = scene.quantizers.clone().map(|mut quantizers| {
        let before = quantizers.bit_map.num_gaussians();
        quantizers.append(count);
        quantizers.select(&(before..before + count).collect::<Vec<_>>());
        quantizers
    });
    let mut state = State::new(few);
    state.timestep = scene.timestep;
    if let Some(quantizers) = quantizers {
        state.start_quantization(quantizers);
    }
    state
}

//! Youth: Gaussians born at the last few timesteps go on learning all their attributes.
//!
//! An entering object is first seen by few views, or from one side. For `births.youth` timesteps the young therefore
//! learn all their attributes after each timestep that trained them. Then they settle: opacity, scales and harmonics
//! stay, like those of all others. A checkpoint holds the values learned at its timestep. A scene has the settled
//! values at all timesteps ([`crate::StandIns`]).

use tcgs_core::View;

use super::nursery::{Nursery, alone};
use crate::TrainError;
use crate::gate::{Activity, Gate};
use crate::schedule::Phase;
use crate::solver::{Asked, Solver};

/// Trains all attributes of the young that a timestep trained.
///
/// - `youth`: timesteps after its birth in which a Gaussian is young
///
/// # Errors
/// As [`Trainer::fit`](crate::Trainer::fit).
pub(super) fn raise_young(
    youth: usize,
    solver: &mut Solver,
    gate: &mut Gate,
    views: &[View],
    activity: &Activity,
) -> Result<(), TrainError> {
    let timestep = solver.timestep;
    let state = solver.engine.state()?;
    let births = state.lifetimes.births();
    let is_young = |&i: &usize| births[i] > 0 && births[i] as usize + youth >= timestep;
    let young: Vec<usize> = activity.active.iter().copied().filter(is_young).collect();
    if young.is_empty() {
        return Ok(());
    }
    let small = alone(state.parameters.select(&young), state);
    let all = gate.drawn(state);
    let before = all.activated().select(&young);
    let nursery = Nursery::new(gate, &all, &young, views, None);
    let raised = nursery.train(solver, Phase::Youth, small, Some(&young), |_| Asked::NOTHING)?;
    solver.engine.state_mut()?.parameters.put(&young, &raised.parameters);
    gate.redraw_rows(solver.engine.state()?, views, &young, &before);
    Ok(())
}

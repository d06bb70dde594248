//! A look into a training: the scene between two iterations, on request.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::Solver;
use crate::TrainError;
use crate::gate::Shares;
use crate::parameters::Parameters;

/// The scene of a training between two iterations.
#[derive(Clone, Debug)]
pub struct Glimpsed {
    /// Counted from the run's first.
    pub timestep: usize,
    /// Iterations of the timestep that are computed.
    pub iterations: usize,
    /// The whole scene, in stored form.
    pub parameters: Parameters,
    /// Time that the copy took from the training, in seconds.
    pub seconds: f64,
}

/// Lets other threads ask a training for its scene ([`Trainer::show_to`](crate::Trainer::show_to)). The scene is copied
/// on request only, and a request does not change a bit of the training.
#[derive(Debug, Default)]
pub struct Glimpse {
    /// Locked by the thread that asks: one after another.
    asking: Mutex<()>,
    is_wanted: AtomicBool,
    taken: Mutex<Option<Glimpsed>>,
    arrived: Condvar,
}

impl Glimpse {
    /// The scene after the next iteration; none if no iteration ends within `patience`, as between two timesteps.
    pub fn ask(&self, patience: Duration) -> Option<Glimpsed> {
        let _turn = self.asking.lock().unwrap_or_else(PoisonError::into_inner);
        let mut taken = self.taken();
        *taken = None;
        self.is_wanted.store(true, Ordering::Release);
        let waited = self.arrived.wait_timeout_while(taken, patience, |taken| taken.is_none());
        let (mut taken, _) = waited.unwrap_or_else(PoisonError::into_inner);
        self.is_wanted.store(false, Ordering::Release);
        taken.take()
    }

    fn is_wanted(&self) -> bool {
        self.is_wanted.load(Ordering::Acquire)
    }

    fn give(&self, glimpsed: Glimpsed) {
        *self.taken() = Some(glimpsed);
        self.is_wanted.store(false, Ordering::Release);
        self.arrived.notify_all();
    }

    fn taken(&self) -> MutexGuard<'_, Option<Glimpsed>> {
        // A panic elsewhere leaves a scene or none.
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The part of the scene in the engine's state.
pub(crate) struct Part<'a> {
    /// Its shares of the scene.
    pub shares: Shares,
    /// The scene before the timestep, and the indices in it of the first rows of the engine's state. None if the
    /// state's Gaussians have not joined the scene yet.
    pub of: Option<(&'a Parameters, &'a [usize])>,
}

impl Solver {
    /// Gives the scene to the thread that asked for it.
    ///
    /// - `iterations`: submitted so far in this timestep
    pub(super) fn give_glimpse(&mut self, part: Option<&Part<'_>>, iterations: usize) -> Result<(), TrainError> {
        let Some(glimpse) = self.glimpse.clone().filter(|glimpse| glimpse.is_wanted()) else { return Ok(()) };
        // Iterations that are under way would have taken this time anyway.
        self.engine.wait()?;
        let begin = Instant::now();
        let trained = &self.engine.state()?.parameters;
        let parameters = match part.map(|part| part.of) {
            None => trained.clone(),
            Some(Some((whole, rows))) => {
                let mut parameters = whole.clone();
                parameters.put(rows, trained);
                parameters
            }
            Some(None) => return Ok(()),
        };
        let seconds = begin.elapsed().as_secs_f64();
        glimpse.give(Glimpsed { timestep: self.timestep, iterations, parameters, seconds });
        Ok(())
    }
}

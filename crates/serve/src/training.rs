//! The interface between the server and a training that it shows.

use std::fmt::Debug;
use std::sync::Arc;

/// A training, as the page sees it.
pub trait Training: Debug + Send + Sync {
    /// The content of one of [`TRAINING_FILES`].
    ///
    /// - `known`: tag of the content that the page has
    /// - returns: none if there is nothing newer
    ///
    /// # Errors
    /// A line for people that says why there is none.
    fn answer(&self, path: &str, known: Option<&str>) -> Result<Option<TrainingFile>, String>;
}

/// Content that a page asked of a training.
#[derive(Clone, Debug)]
pub struct TrainingFile {
    /// Another one for other content.
    pub tag: String,
    /// The content.
    pub bytes: Arc<[u8]>,
}

/// Paths of a training: its state, the running timestep, and the last finished timesteps (`docs/PLAYER.md`, "A
/// training").
pub const TRAINING_FILES: [&str; 3] = ["/train.json", "/running.tcgs", "/finished.tcgs"];

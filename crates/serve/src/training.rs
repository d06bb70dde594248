//! The interface between the server and a training that it shows.

use std::fmt::Debug;
use std::sync::Arc;

/// A training, as the page sees it.
pub trait Training: Debug + Send + Sync {
    /// The content of one of [`TRAINING_FILES`].
    ///
    /// - `known`: tag of the content that the page has
    /// - returns: `None` if there is no newer content
    ///
    /// # Errors
    /// A line for people that gives the reason.
    fn answer(&self, path: &str, known: Option<&str>) -> Result<Option<TrainingFile>, String>;
}

/// Content for a page, made by a training.
#[derive(Clone, Debug)]
pub struct TrainingFile {
    /// Identifies the content: other content has another tag.
    pub tag: String,
    /// The content.
    pub bytes: Arc<[u8]>,
}

/// Paths of a training: its state, the running timestep, and the last finished timesteps (`docs/PLAYER.md`, "A
/// training").
pub const TRAINING_FILES: [&str; 3] = ["/train.json", "/running.tcgs", "/finished.tcgs"];

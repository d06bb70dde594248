//! The subject of a scene, from its timesteps and the cameras of its capture, and paths around it.

use tcgs_capture::Split;
use tcgs_core::{Camera, Subject, Tour, add_motion};

use crate::spread::spread;
use crate::{OpenScene, PipelineError};

/// Number of timesteps that are read to find motion.
const NUM_TIMESTEPS: usize = 4;

impl OpenScene {
    /// Cameras of the capture: those in a `.tcgs` file, or the training cameras of a run's capture if that still
    /// exists. Empty for anything else.
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the file cannot be read.
    pub fn rig(&self) -> Result<Vec<Camera>, PipelineError> {
        let carried = self.cameras()?;
        if !carried.is_empty() {
            return Ok(carried.into_iter().map(|named| named.camera).collect());
        }
        let cameras = || {
            let capture = self.open_capture(self.capture()?).ok()?;
            capture.cameras(Split::Train, self.first_frame, self.downscale).ok()
        };
        Ok(cameras().unwrap_or_default().into_iter().map(|(_, camera)| camera).collect())
    }

    /// The subject of the scene at a timestep. To find what moves, at most four other readable timesteps are read.
    ///
    /// - `cameras`: of the capture; may be empty
    ///
    /// # Errors
    /// As [`OpenScene::at`].
    pub fn subject(&self, timestep: usize, cameras: &[Camera]) -> Result<Subject, PipelineError> {
        let (now, living) = (self.at(timestep)?, self.living(timestep)?);
        let mut moved = vec![0.0; now.num_gaussians()];
        for other in spread(self.num_timesteps(), NUM_TIMESTEPS).filter(|&other| other != timestep) {
            // An unreadable timestep does not concern this one; drawing it reports the error.
            let (Ok(then), Ok(living_then)) = (self.at(other), self.living(other)) else { continue };
            let pairs: Vec<(usize, usize)> = match (&living, living_then) {
                (Some(now), Some(then)) => {
                    now.iter().enumerate().filter_map(|(i, id)| Some((i, then.binary_search(id).ok()?))).collect()
                }
                _ if then.num_gaussians() == now.num_gaussians() => (0..moved.len()).map(|i| (i, i)).collect(),
                _ => Vec::new(),
            };
            add_motion(&mut moved, pairs.into_iter().map(|(i, j)| (i, now.means()[i], then.means()[j])));
        }
        Ok(Subject::of(&now, &moved, cameras))
    }

    /// Cameras at equal steps on a path around the subject, among the cameras of its capture ([`Tour::among`]).
    ///
    /// - `timestep`: the first one on the path
    /// - `count`: number of cameras
    /// - `size`: width and height of their images, pixels
    ///
    /// # Errors
    /// As [`OpenScene::at`].
    pub fn tour(
        &self,
        tour: Tour,
        timestep: usize,
        count: usize,
        size: [usize; 2],
    ) -> Result<Vec<Camera>, PipelineError> {
        let cameras = self.rig()?;
        let subject = self.subject(timestep, &cameras)?;
        Ok(tour.among(&subject, &cameras, self.up().direction(), count, size))
    }
}

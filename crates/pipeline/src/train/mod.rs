//! From a capture to a run folder.

mod background;
mod chapter;
mod fit;
mod folder;
mod ready;
mod settings;

use std::borrow::Cow;
use std::path::Path;

use tcgs_capture::{Capture, Split};
use tcgs_prepare::close_holes;
use tcgs_train::{TrainConfig, Trainer};

use self::background::border_color;
use self::fit::FEW_POINTS;
use crate::{Backend, PipelineError, capture_for};

pub use chapter::{continued_trainer, start_state};
pub use fit::fit;
pub use folder::RunFolder;
pub use ready::ReadyRun;
pub use settings::settings_for;

/// A trainer before the first timestep of the frames that the settings name.
///
/// # Errors
/// [`PipelineError`] if the capture lacks the first frame or training cameras, or there are no points to start from.
pub fn new_trainer(config: &TrainConfig, capture: &Capture, backend: &Backend) -> Result<Trainer, PipelineError> {
    let capture = capture_for(config, capture)?;
    let cameras = capture.cameras(Split::Train, config.data.first_frame, config.data.downscale)?;
    let cameras: Vec<_> = cameras.into_iter().map(|(_, camera)| camera).collect();
    let capture = match config.data.points.as_str() {
        "" => capture,
        points => Cow::Owned(capture.into_owned().with_points(Path::new(points))?),
    };
    let cloud = capture.point_cloud()?;
    // Points of `tcgs prepare` leave nothing open, few points would give a shell of a few points, and a removal without
    // a measured error would remove what no view shows.
    let is_given = capture.measured_share()?.is_none() && cloud.points.len() >= FEW_POINTS;
    let cloud = if is_given && config.densify.prune_error > 0.0 { close_holes(&cloud, &cameras) } else { cloud };
    let mut trainer = Trainer::with_engine(config, &cloud, &cameras, |state| backend.engine(state))?;
    if config.render.background {
        let views = capture.views(Split::Train, config.data.first_frame, config.data.downscale)?;
        trainer.set_background(border_color(&views))?;
    }
    Ok(trainer)
}

//! Chapters: a run that continues the state of another scene.

use tcgs_capture::{Capture, Split};
use tcgs_core::Camera;
use tcgs_train::{Checkpoint, Lifetimes, Parameters, Pose, Run, TrainConfig, TrainError, Trainer};

use crate::{Backend, OpenScene, PipelineError, capture_for};

/// The state of a scene at a timestep, from which a run can start ([`continued_trainer`]).
///
/// From a run, masks, quantizers and the gains of cameras carry over. The optimizer's state carries over if the
/// timestep is one of the run's last two; otherwise the optimizer starts without a state. For any other scene, masks
/// begin as the settings say, nothing is quantised, and cameras have no gains. All Gaussians are then foreground unless
/// the scene says otherwise.
///
/// # Errors
/// [`PipelineError::Input`] if the scene has no such timestep, no Gaussian or spherical harmonics, or was trained with
/// another number of cameras, or the settings ask for spherical harmonics; [`PipelineError`] if a file of the scene or
/// the capture's cameras cannot be read.
pub fn start_state(
    scene: &OpenScene,
    timestep: usize,
    config: &TrainConfig,
    capture: &Capture,
) -> Result<Checkpoint, PipelineError> {
    if config.color.degree > 0 {
        let expected = "0 in a run that continues the state of another scene";
        return Err(PipelineError::input("color.degree", config.color.degree.to_string(), expected));
    }
    let gaussians = scene.lit(timestep)?;
    if gaussians.num_gaussians() == 0 {
        return Err(PipelineError::input(scene.path.display(), "has no Gaussians", "at least one"));
    }
    if gaussians.layout().sh_degree() > 0 {
        let expected = "colours that do not depend on the direction of view, which alone are continued";
        return Err(PipelineError::input(scene.path.display(), "has spherical harmonics", expected));
    }
    let cameras = training_cameras(config, capture)?;
    let Some(run) = scene.run() else {
        let n = gaussians.num_gaussians();
        let foreground = scene.foreground(timestep)?;
        let parameters = Parameters {
            mask_logits: vec![config.mask.initial_logit; n],
            foreground: foreground.unwrap_or_else(|| vec![true; n]),
            camera_gains: vec![[0.0; 3]; cameras.len()],
            camera_offsets: vec![[0.0; 3]; cameras.len()],
            gaussians,
        };
        return Ok(Checkpoint::of_parameters(parameters, &cameras));
    };
    let mut start = checkpoint_of(run, timestep)?;
    let found = start.parameters.camera_gains.len();
    if found != cameras.len() {
        let (found, expected) = (format!("was trained with {found} cameras"), format!("{} as in", cameras.len()));
        let expected = format!("{expected} {}", capture.name());
        return Err(PipelineError::input(scene.path.display(), found, expected));
    }
    if !config.quantize.enabled {
        start.quantizers = None;
    }
    // All Gaussians that live at the start exist from the chapter's first timestep to its last.
    start.lifetimes = Lifetimes::new(start.parameters.num_gaussians());
    start.born = Pose::default();
    start.unseen.clear();
    Ok(start)
}

/// A checkpoint with the optimizer's state, if the run still has it.
fn checkpoint_of(run: &Run, timestep: usize) -> Result<Checkpoint, TrainError> {
    let first = if timestep == 0 { None } else { Some(run.checkpoint(0, None)?) };
    match run.resumable(timestep, first.as_ref()) {
        Err(_) if timestep + 2 < run.timesteps() => run.checkpoint(timestep, first.as_ref()),
        found => found,
    }
}

/// A trainer that continues the state of another scene.
///
/// - `start`: of [`start_state`] or [`Run::start`]
pub fn continued_trainer(config: &TrainConfig, start: &Checkpoint, backend: &Backend) -> Trainer {
    Trainer::continued(config, start, |state| backend.engine(state))
}

fn training_cameras(config: &TrainConfig, capture: &Capture) -> Result<Vec<Camera>, PipelineError> {
    let cameras =
        capture_for(config, capture)?.cameras(Split::Train, config.data.first_frame, config.data.downscale)?;
    if cameras.is_empty() {
        return Err(PipelineError::input(capture.name(), "no training cameras", "at least one"));
    }
    Ok(cameras.into_iter().map(|(_, camera)| camera).collect())
}

//! From footage to a compressed scene and its quality: what the command line does, for programs.
//!
//! What lives here: opening a scene of any kind ([`OpenScene`]), and the steps that need several crates at once:
//!
//! - making a capture of videos ([`prepare`])
//! - training a run with prefetched images ([`fit`])
//! - looking at a run during its training ([`LiveRun`])
//! - showing a capture before training ([`points_scene`])
//! - pruning and compressing ([`PrunedScene`], [`compress_scene`])
//! - searching a size or a quality ([`search`] with a [`Judge`])
//! - comparing with a capture ([`evaluate`]), or a file with its source ([`compare`])
//! - rendering ([`render`])
//! - writing for other programs ([`Export`])
//!
//! What does not: arguments, progress bars and words for people (the command line), and the maths of each step (the
//! crates below).
//!
//! Every wrong input is a [`PipelineError`]; [`HasFault::fault`] tells whether the input or the machine failed. A long
//! call reports its progress to an [`Observer`], which may stop it.
//!
//! ```
//! use std::ops::ControlFlow;
//! use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
//! use tcgs_pipeline::{
//!     Backend, CompressOptions, EvaluateSettings, Event, OpenScene, OpenSettings, Unobserved, compress_scene,
//!     evaluate, fit, new_trainer, settings_for,
//! };
//! use tcgs_train::{Preset, Run};
//!
//! let folder = tempfile::tempdir()?;
//! let small = SyntheticSettings { width: 48, height: 36, num_timesteps: 2, num_points: 300, ..Default::default() };
//! write_synthetic(&folder.path().join("capture"), &small)?;
//! let capture = Capture::open(&folder.path().join("capture"))?;
//!
//! // Train, and hear of every timestep.
//! let mut config = settings_for(Preset::Fast, &capture);
//! (config.schedule.first_iterations, config.schedule.rest_iterations) = (20, 5);
//! let run = Run::create(&folder.path().join("run"), &config)?;
//! let trainer = new_trainer(&config, &capture, &Backend::Cpu)?;
//! let mut timesteps = 0;
//! fit(&capture, &run, trainer, &mut |event: &Event| {
//!     timesteps += usize::from(matches!(event, Event::Timestep { .. }));
//!     ControlFlow::Continue(())
//! })?;
//! assert_eq!(timesteps, 2);
//!
//! // Compress, open the file, and compare it with the held-out cameras.
//! let trained = OpenScene::open(run.folder(), OpenSettings::default())?;
//! let options = CompressOptions { capture: Some(folder.path().join("capture")), ..CompressOptions::default() };
//! let compressed = compress_scene(&trained, &options)?;
//! let file = folder.path().join("scene.tcgs");
//! std::fs::write(&file, &compressed.file)?;
//! let scene = OpenScene::open(&file, OpenSettings::default())?;
//! let settings = EvaluateSettings::of(&scene, Split::Test);
//! let quality = evaluate(&scene, &capture, &settings, &*Backend::Cpu.renderer(), &mut Unobserved)?;
//! assert!(quality.mean(|image| Some(image.psnr)).is_some_and(|psnr| psnr > 5.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backend;
mod compress;
mod error;
mod evaluate;
mod export;
mod held_out;
mod live;
mod new_folder;
mod observe;
mod path_file;
mod prepare;
mod preview;
mod render;
mod scene;
mod spread;
mod train;
mod verify;

pub use backend::Backend;
pub use compress::{
    Allowance, CompressOptions, CompressPreset, Compressed, ErrorSearch, Judge, JudgeImages, Marks, PrunedScene,
    QUALITY_RANGE, RefineBudget, RefineOptions, Refined, RefinedWithin, SearchResult, SizeStep, Target, Tuning,
    capture_kind_of, compress_scene, kept_gaussians, position_step_remark, refine, refine_within, search,
    search_errors, settings_of, tune,
};
pub use error::{Fault, HasFault, PipelineError};
pub use evaluate::{
    COLUMNS, EvaluateSettings, Evaluation, ImageScore, MetricColumn, evaluate, evaluation_json, protocol_mean,
};
pub use export::{Export, ExportedParams, TimestepKind};
pub use held_out::capture_for;
pub use live::{LiveFile, LiveRun};
pub use new_folder::NewFolder;
pub use observe::{ErrorTrial, Event, Observer, PrepareStep, TimestepSummary, Trial, TuningTrial, Unobserved, Work};
pub use path_file::read_camera_path;
pub use prepare::{
    CHECK_PAGE, FootageOptions, PrepareOptions, PreparedCapture, WantMasks, examine, make_points, open_source, prepare,
};
pub use preview::points_scene;
pub use render::{CameraAt, render};
pub use scene::{CutFiles, OpenScene, OpenSettings};
pub use train::{ReadyRun, RunFolder, continued_trainer, fit, new_trainer, settings_for, start_state};
pub use verify::{Compared, Comparison, compare, whole_file_limits};

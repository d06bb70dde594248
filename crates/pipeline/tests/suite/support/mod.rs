//! A small capture, and a run and files made from it.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
use tcgs_interchange::{ParamsExtras, write_params_npz};
use tcgs_pipeline::{
    Backend, CompressOptions, Export, OpenScene, OpenSettings, TimestepKind, Unobserved, compress_scene, fit,
    new_trainer, settings_for,
};
use tcgs_train::{Preset, Run};

/// The capture of the tests.
pub const SMALL: SyntheticSettings = SyntheticSettings {
    width: 48,
    height: 36,
    num_train_cameras: 4,
    num_test_cameras: 1,
    num_timesteps: 3,
    num_points: 300,
    seed: 0,
};

/// A folder with `capture`, `run` of three timesteps, `params.npz`, `scene.tcgs` and `plys`; tests do not write to it.
pub fn files() -> &'static Path {
    static FILES: OnceLock<tempfile::TempDir> = OnceLock::new();
    FILES
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let path = |name: &str| folder.path().join(name);
            write_synthetic(&path("capture"), &SMALL).unwrap();
            let capture = Capture::open(&path("capture")).unwrap();
            let mut config = settings_for(Preset::Fast, &capture);
            (config.schedule.first_iterations, config.schedule.rest_iterations) = (12, 6);
            config.births.enabled = false;
            // Masks that can be pruned; version 1 of the format has no antialiasing.
            config.mask.enabled = true;
            config.render.antialiased = false;
            config.data.capture = path("capture").display().to_string();
            let run = Run::create(&path("run"), &config).unwrap();
            let trainer = new_trainer(&config, &capture, &Backend::Cpu).unwrap();
            fit(&capture, &run, trainer, &mut Unobserved).unwrap();

            let scene = open(&path("run"));
            let compressed = compress_scene(&scene, &CompressOptions::default()).unwrap();
            fs::write(path("scene.tcgs"), compressed.file).unwrap();
            write_params_npz(&path("params.npz"), &scene.floats().unwrap(), &ParamsExtras::default()).unwrap();
            fs::create_dir(path("plys")).unwrap();
            Export::new(&scene).unwrap().write_folder(TimestepKind::Ply, 0..3, &path("plys"), &mut Unobserved).unwrap();
            folder
        })
        .path()
}

/// Opens an existing scene.
pub fn open(path: &Path) -> OpenScene {
    OpenScene::open(path, OpenSettings::default()).unwrap()
}

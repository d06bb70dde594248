//! Every call returns a result, whatever its input: no input panics, and every error names its culprit in one line.

use std::fs;
use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::support::{files, open};
use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_codec::{CompressSettings, DecodeLimits, inspect};
use tcgs_core::{Attribute, Column, DynamicGaussians, Gaussians, Layout, Tour};
use tcgs_interchange::{SpzVersion, write_ply_to};
use tcgs_pipeline::{
    Backend, CameraAt, CompressOptions, EvaluateSettings, Event, Export, Fault, HasFault, Judge, JudgeImages,
    OpenScene, OpenSettings, PipelineError, PrunedScene, Target, TimestepKind, Unobserved, compress_scene, evaluate,
    fit, new_trainer, read_camera_path, render, search, settings_for,
};
use tcgs_train::{Checkpoint, Optimizer, Preset, Run, TrainConfig};

/// Asserts that an error is the input's fault and one line with these words.
#[track_caller]
fn refused<T>(result: Result<T, PipelineError>, words: &[&str]) {
    let error = result.err().expect("an error");
    let message = error.to_string();
    assert_eq!(error.fault(), Fault::Input, "{message}");
    assert!(!message.contains('\n'), "{message}");
    for word in words {
        assert!(message.contains(word), "{word:?} is not in {message:?}");
    }
}

#[test]
fn what_is_no_scene_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| OpenScene::open(path, OpenSettings::default());
    let write = |name: &str, bytes: &[u8]| -> PathBuf {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    };
    refused(open(&folder.path().join("none.tcgs")), &[&format!("none.tcgs: {}", io::Error::from_raw_os_error(2))]);
    refused(open(&write("empty/notes.txt", b"x").with_file_name("")), &["without config.toml"]);
    refused(open(&write("a.txt", b"hello")), &["a.txt", "another kind"]);
    refused(open(&write("b.npz", b"PK\x03\x04")), &["b.npz"]);
    refused(open(&write("c.ply", b"ply\nformat")), &["c.ply"]);
    refused(open(&write("run/config.toml", b"").with_file_name("")), &["checkpoints", "no checkpoint"]);
    refused(open(&write("broken/config.toml", b"seed = 'no'").with_file_name("")), &["config.toml"]);
    let whole = fs::read(files().join("scene.tcgs")).unwrap();
    for length in [0, 3, 7, 40, whole.len() / 2, whole.len() - 1] {
        refused(open(&write("cut.tcgs", &whole[..length])), &["cut.tcgs", "expected a whole .tcgs file"]);
    }
    let mut damaged = whole.clone();
    let segment = inspect(&whole, &DecodeLimits::default()).unwrap().cohorts[0].segments[0].1.clone();
    damaged[(segment.start + segment.end) as usize / 2] ^= 1;
    let path = write("damaged.tcgs", &damaged);
    // The damage lies in a segment and shows when the segment is read.
    let read = open(&path).and_then(|scene| (0..3).try_for_each(|t| scene.at(t).map(drop)));
    refused(read, &["damaged.tcgs"]);
}

#[test]
fn a_timestep_that_is_missing_or_damaged_is_named() {
    for name in ["run", "scene.tcgs", "params.npz", "plys"] {
        let scene = open(&files().join(name));
        assert_eq!(scene.num_timesteps(), 3, "{name}");
        refused(scene.at(3), &[name, "no timestep 3"]);
        refused(scene.drawn(usize::MAX), &[name]);
        refused(scene.choose_frames(Some(&(2..4))), &[name, "0..3", "2..4"]);
        #[allow(clippy::reversed_empty_ranges)] // as a program may give it
        let backwards = 2..1;
        refused(scene.choose_frames(Some(&backwards)), &[name]);
    }
    let folder = tempfile::tempdir().unwrap();
    for frame in 0..3 {
        let (from, to) = (format!("plys/{frame:06}.ply"), folder.path().join(format!("{frame:06}.ply")));
        fs::copy(files().join(from), to).unwrap();
    }
    let other = folder.path().join("000002.ply");
    write_ply_to(fs::File::create(&other).unwrap(), &Gaussians::zeros(7)).unwrap();
    let scene = open(folder.path());
    // A timestep may have another number; a scene of tracks may not.
    assert_eq!((scene.at(2).unwrap().num_gaussians(), scene.num_gaussians_at(2)), (7, 7));
    refused(scene.floats(), &["000002.ply", "has 7 Gaussians"]);
    let options = CompressOptions { bits: Some((6, 6)), ..CompressOptions::default() };
    assert_eq!(compress_scene(&scene, &options).unwrap().compact.at(2).num_gaussians(), 7);
    write_ply_to(fs::File::create(&other).unwrap(), &Gaussians::zeros(8)).unwrap();
    refused(scene.at(2), &["000002.ply", "has 8 Gaussians", "expected 7"]);
    fs::remove_file(&other).unwrap();
    refused(scene.at(2), &["000002.ply"]);
}

#[test]
fn a_scene_that_cannot_be_compressed_is_refused() {
    let compressed = open(&files().join("scene.tcgs"));
    refused(compress_scene(&compressed, &CompressOptions::default()), &["scene.tcgs", "compressed already"]);
    refused(compressed.floats(), &["compressed already"]);

    let scene = open(&files().join("run"));
    let with = |options: CompressOptions| compress_scene(&scene, &options);
    let options = CompressOptions::default;
    refused(with(CompressOptions { prune: Some(1.0), ..options() }), &["run", "largest mean mask"]);
    refused(with(CompressOptions { capture: Some("/no/capture".into()), ..options() }), &["/no/capture"]);
    refused(with(CompressOptions { bits: Some((9, 4)), ..options() }), &[]);
    refused(with(CompressOptions { bits: Some((0, 40)), ..options() }), &[]);
    refused(with(CompressOptions { bits: Some((40, 40)), ..options() }), &[]);
    refused(with(CompressOptions { position_bits: Some(77), ..options() }), &[]);
    refused(with(CompressOptions { prune: Some(f32::NAN), ..options() }), &["threshold of masks"]);
    let keypoints = CompressSettings { max_mse: [f32::NAN; 5], ..CompressSettings::default() };
    refused(with(CompressOptions { keypoints, ..options() }), &[]);
    // Fewer than two keypoints count as two.
    let keypoints = CompressSettings { max_keypoints: 0, ..CompressSettings::default() };
    with(CompressOptions { keypoints, ..options() }).unwrap();

    let mut gaussians = Gaussians::zeros(3);
    gaussians.means_mut()[1] = [0.0, f32::NAN, 0.0];
    let mut floats = DynamicGaussians::default();
    floats.push(gaussians);
    let broken = scene.with_floats(floats, "floats");
    refused(compress_scene(&broken, &options()), &["Gaussian 1 at timestep 0 is NaN"]);
    let empty = scene.with_floats(DynamicGaussians::default(), "floats");
    refused(compress_scene(&empty, &options()), &[]);
    refused(Export::new(&empty).unwrap().params(0..1), &["has no Gaussians"]);
    refused(Export::new(&empty).unwrap().timestep(TimestepKind::Ply, 0), &["has no Gaussians"]);
    refused(Export::new(&empty).unwrap().fourdgs(0..1), &["has no Gaussians"]);
}

#[test]
fn a_target_out_of_reach_is_refused() {
    let scene = open(&files().join("params.npz"));
    let options = CompressOptions { bits: Some((6, 6)), ..CompressOptions::default() };
    let pruned = PrunedScene::new(&scene, &options).unwrap();
    let images = |frames| JudgeImages { capture: None, split: Split::Test, frames };
    let judge = |frames| Judge::new(&scene, &images(frames), Backend::Cpu.renderer());
    refused(judge(Some(2..9)), &["2..9"]);
    let judge = judge(Some(0..1)).unwrap();
    let found = search(&pruned, &options.keypoints, Target::Bytes(10), &judge, &mut Unobserved);
    assert!(matches!(found, Err(PipelineError::TargetBytes { target: 10, .. })));
    refused(found, &["a target of 10 bytes"]);
    let mut stop = |_: &Event| ControlFlow::Break(());
    let stopped = search(&pruned, &options.keypoints, Target::Bytes(9000), &judge, &mut stop);
    assert!(matches!(stopped, Err(PipelineError::Stopped)));
}

#[test]
fn what_cannot_be_evaluated_or_rendered_is_refused() {
    let scene = open(&files().join("scene.tcgs"));
    let capture = Capture::open(&files().join("capture")).unwrap();
    let renderer = Backend::Cpu.renderer();
    let with = |settings: EvaluateSettings| evaluate(&scene, &capture, &settings, &*renderer, &mut Unobserved);
    let settings = || EvaluateSettings::of(&scene, Split::Test);
    refused(with(EvaluateSettings { frames: 1..7, ..settings() }), &["1..7"]);
    refused(with(EvaluateSettings { frames: 1..1, ..settings() }), &["1..1"]);
    refused(with(EvaluateSettings { downscale: 0, ..settings() }), &["downscale"]);
    refused(with(EvaluateSettings { downscale: 999, ..settings() }), &["downscale"]);
    let mut stop = |event: &Event| match event {
        Event::Frame(_) => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let stopped = evaluate(&scene, &capture, &settings(), &*renderer, &mut stop);
    assert!(matches!(stopped, Err(PipelineError::Stopped)));

    refused(CameraAt::of_tour(&scene, 0..9, Tour::Orbit, [64, 36]), &["0..9"]);
    refused(CameraAt::of_capture(&scene, 3..4, &capture, None), &["3..4"]);
    refused(CameraAt::of_path(&scene, 0..3, &tcgs_core::CameraPath::default(), None), &["no keyframe"]);
    let mut cameras = CameraAt::of_tour(&scene, 0..3, Tour::Orbit, [64, 36]).unwrap();
    let mut taken = 0;
    let mut take = |_: &CameraAt, _| {
        taken += 1;
        Ok(())
    };
    render::<PipelineError>(&scene, &cameras, &*renderer, &mut Unobserved, &mut take).unwrap();
    assert!(matches!(
        render::<PipelineError>(&scene, &cameras, &*renderer, &mut stop, &mut take),
        Err(PipelineError::Stopped)
    ));
    cameras[0].frame = 77;
    refused(render(&scene, &cameras, &*renderer, &mut Unobserved, &mut take), &["77..78"]);
    assert_eq!(taken, 3 + 1);
}

#[test]
fn a_camera_path_that_is_none_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("path.json");
    refused(read_camera_path(&path), &["path.json"]);
    for text in ["", "[]", "{}", r#"{"format":"tcgs-camera-path","version":1,"cameras":[]}"#] {
        fs::write(&path, text).unwrap();
        refused(read_camera_path(&path), &["path.json", "expected a camera path"]);
    }
}

#[test]
fn scales_that_vary_have_no_place_in_a_params_npz() {
    let scene = open(&files().join("params.npz"));
    let mut floats = scene.floats().unwrap().into_owned();
    let mut other = floats.at(0);
    other.log_scales_mut()[0][0] += 1.0;
    floats.push(other);
    let varying = scene.with_floats(floats, "floats");
    let export = Export::new(&varying).unwrap();
    export.params(0..3).unwrap();
    refused(export.params(0..4), &["log_scales vary with time"]);
    refused(export.params(0..9), &["0..9"]);
}

#[test]
fn a_training_that_is_stopped_resumes_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let calm = Run::open(&files().join("run")).unwrap();
    let capture = Capture::open(&files().join("capture")).unwrap();
    let run = Run::create(folder.path(), calm.config()).unwrap();
    // In the middle of the first timestep, of the second, and right after it.
    let mut stops = 0;
    for stop_after in [5, 15, 6] {
        let trainer = match run.resume().unwrap() {
            Some(trainer) => trainer,
            None => new_trainer(run.config(), &capture, &Backend::Cpu).unwrap(),
        };
        let mut told = 0;
        let mut stop = |event: &Event| {
            told += usize::from(matches!(event, Event::Iteration { .. }));
            if told == stop_after { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        stops += usize::from(matches!(fit(&capture, &run, trainer, &mut stop), Err(PipelineError::Stopped)));
    }
    assert_eq!(stops, 3);
    let trainer = run.resume().unwrap().expect("a finished timestep");
    fit(&capture, &run, trainer, &mut Unobserved).unwrap();
    for timestep in 0..3 {
        let bytes = |run: &Run| fs::read(run.folder().join(format!("checkpoints/{timestep:06}.npz"))).unwrap();
        assert!(bytes(&run) == bytes(&calm), "timestep {timestep}");
    }
}

#[test]
fn a_start_from_few_points_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let few = SyntheticSettings {
        width: 48,
        height: 36,
        num_train_cameras: 4,
        num_test_cameras: 1,
        num_timesteps: 1,
        num_points: 66,
        seed: 0,
    };
    write_synthetic(&folder.path().join("capture"), &few).unwrap();
    let capture = Capture::open(&folder.path().join("capture")).unwrap();
    let mut config = settings_for(Preset::Fast, &capture);
    config.schedule.first_iterations = 2;
    let run = Run::create(&folder.path().join("run"), &config).unwrap();
    let trainer = new_trainer(&config, &capture, &Backend::Cpu).unwrap();
    let mut told = Vec::new();
    fit(&capture, &run, trainer, &mut |event: &Event| {
        if let Event::FewPoints { found, expected } = *event {
            told.push((found, expected));
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(matches!(told[..], [(66, 67..)]), "{told:?}");
}

#[test]
fn a_run_with_a_column_that_no_format_holds_is_refused_by_name() {
    let old = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../testdata/run/checkpoints/000000.npz"));
    let mut checkpoint = Checkpoint::load(old, None, true).unwrap();
    let mut layout = Layout::default();
    layout.push("wetness", 2, Column::like(Attribute::Color));
    let gaussians = std::mem::take(&mut checkpoint.parameters.gaussians).extended(&Arc::new(layout.clone()));
    checkpoint.parameters.gaussians = gaussians;
    checkpoint.quantizers = None;
    checkpoint.optimizer = Optimizer::new(&checkpoint.parameters, 0);
    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(&folder.path().join("run"), &TrainConfig::default()).unwrap();
    run.save(0, &checkpoint).unwrap();

    let scene = open(run.folder());
    assert_eq!(scene.bytes, layout.raw_bytes(checkpoint.parameters.num_gaussians(), 1));
    assert_eq!(*scene.at(0).unwrap().layout(), Arc::new(layout));
    let export = Export::new(&scene).unwrap();
    refused(export.params(0..1), &["wetness", "params.npz"]);
    for (kind, name) in [
        (TimestepKind::Ply, "a PLY file"),
        (TimestepKind::CompressedPly, "a compressed PLY file"),
        (TimestepKind::Spz(SpzVersion::V3), "an SPZ file"),
        (TimestepKind::Glb, "a glTF file"),
        (TimestepKind::Sog, "a SOG file"),
    ] {
        refused(export.timestep(kind, 0), &["wetness", name]);
    }
    refused(export.fourdgs(0..1), &["wetness", "a .4dgs file"]);
    assert_eq!(export.floats(0..1).unwrap().next().unwrap().unwrap().len(), checkpoint.parameters.num_gaussians() * 64);
    let options = CompressOptions { bits: Some((6, 6)), version: 1, ..CompressOptions::default() };
    let error = compress_scene(&scene, &options).err().unwrap().to_string();
    assert!(error.contains("wetness") && error.contains("version 1 of the format"), "{error}");
    let file = compress_scene(&scene, &CompressOptions { version: 2, ..options }).unwrap();
    assert_eq!(file.compact.oldest_version(), 2);
}

//! A run in which Gaussians are born and die, from its checkpoints to a file.

use std::path::Path;

use crate::support::{files, open};
use serde_json::json;
use tcgs_capture::Capture;
use tcgs_codec::{CompressSettings, UpAxis};
use tcgs_core::{Attribute, Life, Lives, PointCloud, SceneReader};
use tcgs_interchange::{ReadLimits, read_params_foreground, read_params_npz};
use tcgs_pipeline::{
    Backend, CompressOptions, Export, LiveRun, Marks, OpenScene, OpenSettings, PrunedScene, compress_scene,
    kept_gaussians, new_trainer, start_state,
};
use tcgs_train::{Checkpoint, Lifetimes, Parameters, Run, TrainConfig};

const NUM_TIMESTEPS: usize = 12;
const NUM_GAUSSIANS: usize = 235;

/// Some are born at timesteps 4 and 9; ten of those of the start and five of those born at 4 die at 7.
fn lives() -> Lives {
    let birth = |i: usize| if i < 200 { 0 } else { 4 + 5 * u32::from(i >= 230) };
    let death = |i: usize| if (10..20).contains(&i) || (205..210).contains(&i) { 7 } else { Life::NEVER };
    (0..NUM_GAUSSIANS).map(|i| Life { birth: birth(i), death: death(i) }).collect()
}

/// How many Gaussians there are at a timestep.
fn count(timestep: usize) -> usize {
    match timestep {
        0..4 => 200,
        4..7 => 230,
        7..9 => 215,
        _ => 220,
    }
}

/// Mark of a Gaussian by its identity.
fn is_foreground(id: usize) -> bool {
    id * 7919 % 10 < 6
}

/// A run with [`lives`].
///
/// - `hidden`: by their masks
fn run(folder: &Path, first_frame: usize, hidden: &[usize]) -> Run {
    run_of(&lives(), folder, first_frame, hidden)
}

/// A run whose Gaussians all move, of four training cameras.
fn run_of(lives: &Lives, folder: &Path, first_frame: usize, hidden: &[usize]) -> Run {
    let mut config = TrainConfig::default();
    config.mask.enabled = true;
    config.data.first_frame = first_frame;
    let run = Run::create(folder, &config).unwrap();
    let n = NUM_GAUSSIANS;
    let points: Vec<[f32; 3]> = (0..n).map(|i| [i as f32 % 17.0, i as f32 % 5.0, i as f32 / 40.0]).collect();
    let foreground = (0..n).map(is_foreground).collect();
    let cloud = PointCloud { colors: vec![[0.5, 0.25, 0.75]; n], foreground, points };
    let whole = Parameters::from_cloud(&cloud, 4, 1.0);
    let camera = tcgs_core::Camera::look_at([0.0, 0.0, -9.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
    for timestep in 0..NUM_TIMESTEPS {
        let living = lives.living(timestep);
        let mut parameters = whole.select(&living);
        for (&i, mean) in living.iter().zip(parameters.gaussians.means_mut()) {
            mean[0] += 0.3 * (timestep as f32 + i as f32).sin();
        }
        for (&i, opacity) in living.iter().zip(parameters.gaussians.values_mut(Attribute::LogitOpacity)) {
            // The young settle at timestep 6.
            *opacity = i as f32 / 50.0 + if i >= 200 && timestep < 6 { 0.5 } else { 0.0 };
        }
        for (i, logit) in living.iter().zip(&mut parameters.mask_logits) {
            *logit = if hidden.contains(i) { -20.0 } else { 20.0 };
        }
        let mut checkpoint = Checkpoint::of_parameters(parameters, std::slice::from_ref(&camera));
        // A timestep knows its births and deaths so far.
        let born = lives.iter().filter(|life| life.birth as usize <= timestep);
        let known = born.map(|&life| if life.death as usize > timestep { Life::since(life.birth) } else { life });
        let known = known.collect();
        checkpoint.lifetimes = Lifetimes { ids: living.iter().map(|&i| i as u32).collect(), lives: known };
        run.save(timestep, &checkpoint).unwrap();
    }
    run
}

#[test]
fn a_file_shows_each_gaussian_from_its_birth_to_its_death() {
    let folder = tempfile::tempdir().unwrap();
    let run = run(folder.path(), 0, &[]);
    let mut scene = OpenScene::open(run.folder(), OpenSettings::default()).unwrap();
    assert_eq!((scene.num_identities(), scene.num_gaussians_at(3)), (Some(235), 200));
    let (whole, first) = (run.trained().unwrap(), run.checkpoint(0, None).unwrap());
    assert_eq!(whole.lives, Some(lives()));
    let pruned = scene.pruned(&kept_gaussians(&scene, None).unwrap()).unwrap();
    for timestep in 0..NUM_TIMESTEPS {
        let now = SceneReader::at(&mut scene, timestep).unwrap();
        assert_eq!(now.num_gaussians(), count(timestep));
        assert_eq!(OpenScene::num_gaussians_at(&scene, timestep), count(timestep));
        let kept = OpenScene::at(&pruned, timestep).unwrap();
        // In a scene the young have the values with which they settled.
        assert!(kept.means() == now.means() && (timestep < 6 || kept == now), "timestep {timestep}");
        // Before its birth each stands as it is born, after its death as it died.
        let all = whole.scene.at(timestep);
        for i in 0..NUM_GAUSSIANS {
            let life = lives()[i].within(0..NUM_TIMESTEPS as u32);
            let shown = timestep.clamp(life.birth as usize, life.death as usize - 1);
            let row = lives().living(shown).binary_search(&i).unwrap();
            let own = run.parameters(shown, Some(&first).filter(|_| shown > 0)).unwrap().gaussians;
            assert_eq!(all.means()[i], own.means()[row], "Gaussian {i} at timestep {timestep}");
            assert_eq!(all.logit_opacities()[i], i as f32 / 50.0, "Gaussian {i} at timestep {timestep}");
        }
    }

    let options =
        CompressOptions { bits: Some((8, 8)), views: 0, up: Some(UpAxis::Unknown), ..CompressOptions::default() };
    let compressed = compress_scene(&scene, &options).unwrap();
    // Reading from disk gives the same bytes.
    let from_disk = CompressOptions { max_float_bytes: 0, ..options };
    assert!(compress_scene(&scene, &from_disk).unwrap().file == compressed.file);

    // The run has no capture, whose cameras would measure sensitivity.
    let measured = PrunedScene::new(&scene, &CompressOptions::default()).unwrap();
    assert!(measured.bits_from.contains("cameras around the scene"), "{}", measured.bits_from);

    let path = folder.path().join("scene.tcgs");
    std::fs::write(&path, &compressed.file).unwrap();
    let file = OpenScene::open(&path, OpenSettings::default()).unwrap();
    let largest = file.declared_errors().iter().find(|(name, _)| name == "means").unwrap().1;
    assert!(largest < 0.7, "{largest}");
    for timestep in 0..NUM_TIMESTEPS {
        let (truth, found) = (OpenScene::at(&scene, timestep).unwrap(), OpenScene::at(&file, timestep).unwrap());
        assert_eq!(found.num_gaussians(), count(timestep), "timestep {timestep}");
        // Each is within the declared error of a true one.
        let near = |a: &[f32; 3]| truth.means().iter().any(|b| (0..3).all(|d| (a[d] - b[d]).abs() <= largest));
        assert!(found.means().iter().all(near), "timestep {timestep}");
    }
}

#[test]
fn a_file_of_version_1_is_refused_where_somebody_dies_although_nobody_is_born() {
    let folder = tempfile::tempdir().unwrap();
    let lives = lives().iter().map(|&life| Life { birth: 0, ..life }).collect();
    let scene = open(run_of(&lives, folder.path(), 0, &[]).folder());
    let capture = Some(files().join("capture"));
    for min_share in [0.0, 1e-9] {
        let options = CompressOptions { version: 1, min_share, capture: capture.clone(), ..CompressOptions::default() };
        let error = compress_scene(&scene, &options).unwrap_err().to_string();
        assert!(error.ends_with("found Gaussians that come and go"), "{min_share}: {error}");
        assert!(compress_scene(&scene, &CompressOptions { version: 2, ..options }).is_ok());
    }
}

#[test]
fn other_programs_files_have_who_lives_and_is_not_masked() {
    let folder = tempfile::tempdir().unwrap();
    // They surround those that die at 7.
    let hidden = [3, 15, 100, 232];
    let scene = open(run(folder.path(), 0, &hidden).folder());
    let export = Export::new(&scene).unwrap();
    for timestep in 0..NUM_TIMESTEPS {
        let living = lives().living(timestep);
        let rows: Vec<usize> = (0..living.len()).filter(|&row| !hidden.contains(&living[row])).collect();
        let expected = scene.at(timestep).unwrap().select(&rows);
        assert!(export.gaussians(timestep).unwrap() == expected, "timestep {timestep}");
    }
    let params = export.params(9..12).unwrap();
    let path = folder.path().join("params.npz");
    params.write(&mut std::fs::File::create(&path).unwrap()).unwrap();
    assert_eq!(open(&path).num_gaussians_at(0), count(9) - 3);
    let error = export.params(5..8).err().unwrap().to_string();
    assert!(error.contains("227 Gaussians at frame 5 and 213 at frame 7"), "{error}");
    assert!(error.ends_with("or the frames 5..7 alone"), "{error}");

    // The young have the opacities with which they settle.
    let params = export.params(4..7).unwrap();
    params.write(&mut std::fs::File::create(&path).unwrap()).unwrap();
    let written = read_params_npz(&path).unwrap();
    let shown: Vec<usize> = lives().living(4).into_iter().filter(|id| !hidden.contains(id)).collect();
    let opacities: Vec<f32> = shown.iter().map(|&id| id as f32 / 50.0).collect();
    assert_eq!(written.at(0).logit_opacities(), opacities);
    for timestep in 4..7 {
        assert_eq!(written.means(timestep - 4), export.gaussians(timestep).unwrap().means());
    }
    let marks: Vec<bool> = shown.into_iter().map(is_foreground).collect();
    assert_eq!(read_params_foreground(&path, ReadLimits::default()).unwrap().unwrap(), marks);
}

#[test]
fn a_file_says_which_gaussians_are_foreground() {
    let folder = tempfile::tempdir().unwrap();
    let scene = open(run(folder.path(), 0, &[3, 15, 100, 232]).folder());
    let truth = Export::new(&scene).unwrap();
    let options = CompressOptions {
        keypoints: CompressSettings { keypoints: false, ..CompressSettings::default() },
        bits: Some((8, 8)),
        position_bits: Some(16),
        views: 0,
        ..CompressOptions::default()
    };
    let files = [folder.path().join("scene.tcgs"), folder.path().join("params.npz")];
    let [file, params] = &files;
    let from_disk = CompressOptions { max_float_bytes: 0, ..options.clone() };
    for options in [
        CompressOptions { marks: Marks::Keep, ..from_disk },
        CompressOptions { marks: Marks::Keep, ..options.clone() },
        options,
    ] {
        std::fs::write(file, compress_scene(&scene, &options).unwrap().file).unwrap();
        let compressed = open(file);
        let export = Export::new(&compressed).unwrap();
        for frames in [0..4, 4..7, 7..9, 9..12] {
            let exported = export.params(frames.clone()).unwrap();
            assert_eq!(exported.has_background(), options.marks == Marks::Keep);
            exported.write(&mut std::fs::File::create(params).unwrap()).unwrap();
            let marks = read_params_foreground(params, ReadLimits::default()).unwrap().unwrap();
            let (written, expected) = (read_params_npz(params).unwrap(), truth.gaussians(frames.start).unwrap());
            let living = lives().living(frames.start);
            let ids: Vec<usize> = living.into_iter().filter(|id| ![3, 15, 100, 232].contains(id)).collect();
            for (mean, mark) in written.means(0).iter().zip(marks) {
                let distance = |other: &[f32; 3]| (0..3).map(|c| (mean[c] - other[c]).powi(2)).sum::<f32>();
                let distances: Vec<f32> = expected.means().iter().map(distance).collect();
                let nearest = (0..distances.len()).min_by(|&a, &b| distances[a].total_cmp(&distances[b])).unwrap();
                // They are at least 0.4 apart.
                assert!(distances[nearest] < 0.02, "{}", distances[nearest]);
                assert_eq!(mark, options.marks == Marks::Drop || is_foreground(ids[nearest]));
            }
        }
    }
}

#[test]
fn who_is_born_when_another_dies_is_not_taken_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let birth = |i: usize| if i < 225 { 0 } else { 4 };
    let death = |i: usize| if (10..20).contains(&i) { 4 } else { Life::NEVER };
    let lives = (0..NUM_GAUSSIANS).map(|i| Life { birth: birth(i), death: death(i) }).collect();
    let scene = open(run_of(&lives, folder.path(), 0, &[]).folder());
    let options = CompressOptions { bits: Some((8, 8)), views: 0, ..CompressOptions::default() };
    let file = folder.path().join("scene.tcgs");
    std::fs::write(&file, compress_scene(&scene, &options).unwrap().file).unwrap();
    for scene in [scene, open(&file)] {
        let export = Export::new(&scene).unwrap();
        let error = export.params(0..6).err().unwrap().to_string();
        assert!(error.contains("has 225 Gaussians at frame 0 and as many others at frame 4"), "{error}");
        assert!(export.params(0..4).is_ok() && export.params(6..12).is_ok());
    }
}

#[test]
fn who_watches_a_training_sees_those_that_live_since_the_last_death() {
    let folder = tempfile::tempdir().unwrap();
    let run = run(folder.path(), 0, &[3, 100]);
    let capture = Capture::open(&files().join("capture")).unwrap();
    let mut trainer = new_trainer(run.config(), &capture, &Backend::Cpu).unwrap();
    let metrics =
        json!({ "psnr": 30.0, "loss": 0.1, "num_gaussians": 200, "active_gaussians": 1.0, "active_tiles": 1.0 });
    for end in 1..=NUM_TIMESTEPS {
        run.append_metrics(&metrics).unwrap();
        let live = LiveRun::new(&run, &capture, &mut trainer).unwrap();
        let file = live.finished(None).unwrap().unwrap();
        let file = OpenScene::decode(Path::new("live"), &file.bytes).unwrap();
        let begin = if end > 7 { 7 } else { 0 };
        assert_eq!(file.frames(), begin..end);
        let first = run.checkpoint(0, None).unwrap();
        for timestep in begin..end {
            let now = run.parameters(timestep, Some(&first).filter(|_| timestep > 0)).unwrap().gaussians;
            let shown = OpenScene::at(&file, timestep - begin).unwrap();
            assert_eq!(shown.num_gaussians(), count(timestep) - 2, "timestep {timestep} until {end}");
            // They are stored to a small part of their size, which is about 1.
            let near = |a: &[f32; 3]| now.means().iter().any(|b| (0..3).all(|d| (a[d] - b[d]).abs() < 0.1));
            assert!(shown.means().iter().all(near), "timestep {timestep} until {end}");
        }
    }
}

#[test]
fn a_chapter_has_those_that_live_when_it_starts_at_all_timesteps_and_runs_with_lives_are_not_joined() {
    let folder = tempfile::tempdir().unwrap();
    let [before, after] = [0, NUM_TIMESTEPS].map(|first| run(&folder.path().join(first.to_string()), first, &[]));
    let [before, after] = [before, after].map(|run| open(run.folder()));
    let (capture, config) = (Capture::open(&files().join("capture")).unwrap(), TrainConfig::default());
    let start = start_state(&before, 8, &config, &capture).unwrap();
    assert_eq!(start.lifetimes, Lifetimes::new(count(8)));
    let path = folder.path().join("start.npz");
    start.save(&path, true).unwrap();
    assert!(Checkpoint::load(&path, None, false).unwrap().lifetimes.are_whole());

    let error = OpenScene::join(vec![before, after], None).unwrap_err().to_string();
    assert!(error.contains("has Gaussians that are born or die, expected"), "{error}");
}

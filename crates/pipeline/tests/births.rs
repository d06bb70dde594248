//! A run in which Gaussians are born, from its checkpoints to a file.

#![allow(clippy::unwrap_used)] // helpers of tests are not counted as tests

use std::path::Path;

use tcgs_codec::UpAxis;
use tcgs_core::{PointCloud, SceneReader};
use tcgs_pipeline::{CompressOptions, OpenScene, OpenSettings, compress_scene, kept_gaussians};
use tcgs_train::{Checkpoint, Parameters, Run, TrainConfig};

const NUM_TIMESTEPS: usize = 12;
/// How many Gaussians there are at a timestep.
fn count(timestep: usize) -> usize {
    200 + if timestep >= 4 { 30 } else { 0 } + if timestep >= 9 { 5 } else { 0 }
}

/// A run whose Gaussians all move, and of which some are born at timesteps 4 and 9.
fn run(folder: &Path) -> Run {
    let config = TrainConfig::default();
    let run = Run::create(folder, &config).unwrap();
    let last = count(NUM_TIMESTEPS);
    let points: Vec<[f32; 3]> = (0..last).map(|i| [i as f32 % 17.0, i as f32 % 5.0, i as f32 / 40.0]).collect();
    let cloud = PointCloud { colors: vec![[0.5, 0.25, 0.75]; last], foreground: vec![true; last], points };
    let whole = Parameters::from_cloud(&cloud, 2, 1.0);
    let camera = tcgs_core::Camera::look_at([0.0, 0.0, -9.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
    for timestep in 0..NUM_TIMESTEPS {
        let rows: Vec<usize> = (0..count(timestep)).collect();
        let mut parameters = whole.select(&rows);
        for (i, mean) in parameters.gaussians.means_mut().iter_mut().enumerate() {
            mean[0] += 0.3 * (timestep as f32 + i as f32).sin();
        }
        let mut checkpoint = Checkpoint::of_parameters(parameters, std::slice::from_ref(&camera));
        let births = rows.iter().map(|&i| {
            if i < 200 {
                0
            } else if i < 230 {
                4
            } else {
                9
            }
        });
        let (births, deaths) = (births.collect(), vec![u32::MAX; rows.len()]);
        checkpoint.lifetimes = tcgs_train::Lifetimes::from_columns((0..rows.len() as u32).collect(), births, deaths);
        run.save(timestep, &checkpoint).unwrap();
    }
    run
}

#[test]
fn a_file_shows_each_gaussian_from_its_birth_on() {
    let folder = tempfile::tempdir().unwrap();
    let run = run(folder.path());
    let mut scene = OpenScene::open(run.folder(), OpenSettings::default()).unwrap();
    assert_eq!((scene.num_gaussians(), scene.num_gaussians_at(3)), (235, 200));
    let pruned = scene.pruned(&kept_gaussians(&scene, None).unwrap()).unwrap();
    for timestep in 0..NUM_TIMESTEPS {
        let now = SceneReader::at(&mut scene, timestep).unwrap();
        assert_eq!(now.num_gaussians(), count(timestep));
        assert_eq!(OpenScene::num_gaussians_at(&scene, timestep), count(timestep));
        assert!(OpenScene::at(&pruned, timestep).unwrap() == now, "timestep {timestep}");
    }

    let options =
        CompressOptions { bits: Some((8, 8)), views: 0, up: Some(UpAxis::Unknown), ..CompressOptions::default() };
    let compressed = compress_scene(&scene, &options).unwrap();
    // From the disk the same bytes.
    let from_disk = CompressOptions { max_float_bytes: 0, ..options };
    assert!(compress_scene(&scene, &from_disk).unwrap().file == compressed.file);

    let path = folder.path().join("scene.tcgs");
    std::fs::write(&path, &compressed.file).unwrap();
    let file = OpenScene::open(&path, OpenSettings::default()).unwrap();
    let largest = file.declared_errors().iter().find(|(name, _)| name == "means").unwrap().1;
    assert!(largest < 0.7, "{largest}");
    for timestep in 0..NUM_TIMESTEPS {
        let (truth, found) = (OpenScene::at(&scene, timestep).unwrap(), OpenScene::at(&file, timestep).unwrap());
        assert_eq!(found.num_gaussians(), count(timestep), "timestep {timestep}");
        // Each is where one of the truth is, as near as the file says.
        let near = |a: &[f32; 3]| truth.means().iter().any(|b| (0..3).all(|d| (a[d] - b[d]).abs() <= largest));
        assert!(found.means().iter().all(near), "timestep {timestep}");
    }
}

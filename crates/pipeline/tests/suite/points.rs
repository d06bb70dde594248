//! The points that a training starts from.

use std::fs;

use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_core::{Pinhole, rotmat_from_quat};
use tcgs_pipeline::{Backend, new_trainer, settings_for};
use tcgs_train::Preset;

use crate::support::SMALL;

#[test]
fn given_points_get_a_shell_that_stays_out_of_the_images() {
    let folder = tempfile::tempdir().unwrap();
    let means_of = |name: &str, num_points: usize, preset: Preset| {
        let path = folder.path().join(name);
        fs::create_dir_all(&path).unwrap();
        write_synthetic(&path.join("capture"), &SyntheticSettings { num_points, num_timesteps: 1, ..SMALL }).unwrap();
        let capture = Capture::open(&path.join("capture")).unwrap();
        let mut trainer = new_trainer(&settings_for(preset, &capture), &capture, &Backend::Cpu).unwrap();
        let gaussians = trainer.state().unwrap().parameters.gaussians.clone();
        let cameras = capture.cameras(Split::Train, 0, 1).unwrap();
        (gaussians, cameras)
    };
    let (closed, cameras) = means_of("default", 4000, Preset::Default);
    let num_added = closed.num_gaussians() - 4000;
    assert!((10..=200).contains(&num_added), "{num_added} points added to 4000");
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(|(_, camera)| Pinhole::new(camera)).collect();
    for (i, &mean) in closed.means().iter().enumerate().skip(4000) {
        let (rotation, scales) = (rotmat_from_quat(closed.quats()[i]), closed.log_scales()[i].map(f32::exp));
        for turn in 0..16 {
            // Two standard deviations from the middle of the disc.
            let (sin, cos) = (turn as f32 / 16.0 * std::f32::consts::TAU).sin_cos();
            let [a, b] = [1.99 * scales[0] * cos, 1.99 * scales[1] * sin];
            let border = std::array::from_fn(|c| mean[c] + a * rotation[c][0] + b * rotation[c][1]);
            assert!(pinholes.iter().all(|pinhole| pinhole.pixel(mean).is_none()), "{mean:?} is in an image");
            assert!(pinholes.iter().all(|pinhole| pinhole.pixel(border).is_none()), "{mean:?} reaches into an image");
        }
    }
    for (name, num_points, preset) in [("paper", 4000, Preset::D3dgs), ("few", 900, Preset::Default)] {
        assert_eq!(means_of(name, num_points, preset).0.num_gaussians(), num_points, "{name}");
    }
}

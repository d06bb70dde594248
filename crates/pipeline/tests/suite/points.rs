//! The points that a training starts from.

use std::fs;

use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_core::{Pinhole, distance};
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
    for (&mean, log_scales) in closed.means().iter().zip(closed.log_scales()).skip(4000) {
        for pinhole in &pinholes {
            assert!(pinhole.pixel(mean).is_none(), "{mean:?} is in an image");
            // Not even two standard deviations towards the camera's axis reach into an image.
            let axis_point = pinhole
                .unproject([pinhole.width as f32 / 2.0, pinhole.height as f32 / 2.0], distance(mean, pinhole.center));
            let apart = distance(mean, axis_point);
            let reach = (1.99 * log_scales[0].exp() / apart).min(1.0);
            let nearer = std::array::from_fn(|c| mean[c] + reach * (axis_point[c] - mean[c]));
            assert!(pinhole.pixel(nearer).is_none(), "{mean:?} reaches into an image");
        }
    }
    for (name, num_points, preset) in [("paper", 4000, Preset::D3dgs), ("few", 900, Preset::Default)] {
        assert_eq!(means_of(name, num_points, preset).0.num_gaussians(), num_points, "{name}");
    }
}

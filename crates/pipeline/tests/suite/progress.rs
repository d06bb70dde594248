//! Reported progress of a training.

use std::fs;
use std::ops::ControlFlow;

use tcgs_capture::{Capture, write_synthetic};
use tcgs_pipeline::{Backend, Event, Work, fit, new_trainer, settings_for};
use tcgs_train::{Preset, Run};

use crate::support::SMALL;

#[test]
fn iterations_that_a_timestep_does_not_take_count_as_done() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    write_synthetic(&path, &SMALL).unwrap();
    // In the second timestep nothing moves.
    for camera in fs::read_dir(path.join("ims")).unwrap() {
        let camera = camera.unwrap().path();
        fs::copy(camera.join("000000.png"), camera.join("000001.png")).unwrap();
    }
    let capture = Capture::open(&path).unwrap();
    let mut config = settings_for(Preset::Fast, &capture);
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (12, 6);
    let run = Run::create(&folder.path().join("run"), &config).unwrap();
    let trainer = new_trainer(&config, &capture, &Backend::Cpu).unwrap();
    let (mut begun, mut iterations, mut done) = (None, [0; 3], vec![0]);
    let mut after_timesteps = Vec::new();
    fit(&capture, &run, trainer, &mut |event: &Event| {
        match event {
            Event::Begun { work, num_steps } => begun = Some((*work, *num_steps)),
            Event::Iteration { progress, num_done } => {
                iterations[progress.timestep] += 1;
                done.push(*num_done);
            }
            Event::Timestep { num_done, .. } => {
                after_timesteps.push(*num_done);
                done.push(*num_done);
            }
            _ => {}
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(begun, Some((Work::Training, 24)));
    assert_eq!((iterations[0], iterations[1]), (12, 0), "{iterations:?}");
    assert!(iterations[2] > 0, "{iterations:?}");
    assert_eq!(after_timesteps, [12, 18, 24]);
    assert!(done.is_sorted(), "{done:?}");
}

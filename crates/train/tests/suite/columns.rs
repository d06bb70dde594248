//! A layout with columns that only the table knows goes through all stages of a run.

use std::ops::ControlFlow;
use std::sync::Arc;

use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_codec::{CompressSettings, SceneInfo};
use tcgs_core::{Attribute, Camera, Column, Gaussians, Layout, View};
use tcgs_train::engine::Engine;
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::{BirthConfig, Parameters, Run, State, TrainConfig, Trainer};

/// One column of two components that varies and is quantised, one of one component that is learned once and is not.
fn layout() -> (Arc<Layout>, Attribute, Attribute) {
    let mut layout = Layout::default();
    let wetness = layout.push("wetness", 2, Column::like(Attribute::Color));
    let age = layout.push("age", 1, Column { quantized: false, ..Column::like(Attribute::LogScale) });
    (Arc::new(layout), wetness, age)
}

fn capture(folder: &std::path::Path) -> Capture {
    let settings = SyntheticSettings {
        width: 48,
        height: 36,
        num_train_cameras: 3,
        num_test_cameras: 1,
        num_timesteps: 3,
        num_points: 400,
        ..SyntheticSettings::default()
    };
    write_synthetic(folder, &settings).unwrap();
    Capture::open(folder).unwrap()
}

/// Whether each row of the made-up columns is one of the start: nothing draws them, so nothing changes them.
fn is_carried(gaussians: &Gaussians, wetness: Attribute, age: Attribute) -> bool {
    let (pairs, ages) = (gaussians.values(wetness).as_chunks::<2>().0, gaussians.values(age));
    pairs.len() == gaussians.num_gaussians()
        && pairs.iter().zip(ages).all(|(&[a, b], &age)| b == a + 0.5 && age == -a && a.fract() == 0.0)
        && ages.iter().any(|&age| age != ages[0])
}

#[test]
fn a_made_up_column_is_trained_saved_resumed_and_selected() {
    let folder = tempfile::tempdir().unwrap();
    let capture = capture(&folder.path().join("capture"));
    let views = |frame| -> Vec<View> { capture.views(Split::Train, frame, 1).unwrap() };
    let cameras: Vec<Camera> = views(0).into_iter().map(|v| v.camera).collect();
    let (layout, wetness, age) = layout();

    let mut config = TrainConfig::default();
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (100, 12);
    config.densify.interval = 20;
    config.births = BirthConfig::OFF;
    let cloud = capture.point_cloud().unwrap();
    let mut parameters = Parameters::from_cloud(&cloud, cameras.len(), config.mask.initial_logit);
    let mut gaussians = std::mem::take(&mut parameters.gaussians).extended(&layout);
    let start: Vec<f32> = (0..gaussians.num_gaussians()).map(|i| (i % 7) as f32).collect();
    gaussians.values_mut(wetness).as_chunks_mut().0.iter_mut().zip(&start).for_each(|(w, &a)| *w = [a, a + 0.5]);
    gaussians.values_mut(age).iter_mut().zip(&start).for_each(|(age, &a)| *age = -a);
    parameters.gaussians = gaussians;

    let on_cpu = |state: State| -> Box<dyn Engine> { Box::new(CpuEngine::new(state)) };
    let run = Run::create(&folder.path().join("run"), &config).unwrap();
    let mut trainer = Trainer::from_parameters(&config, parameters, &cameras, on_cpu).unwrap();
    let mut last = None;
    for frame in 0..3 {
        trainer.fit(&views(frame), &mut |_| ControlFlow::Continue(())).unwrap();
        let checkpoint = trainer.checkpoint().unwrap();
        assert!(is_carried(&checkpoint.parameters.gaussians, wetness, age), "timestep {frame}");
        let o = &checkpoint.optimizer;
        assert!(o.steps[wetness.index()] > 0 && o.first.values(wetness).iter().all(|&m| m == 0.0));
        if frame < 2 {
            run.save(frame, &checkpoint).unwrap();
        }
        last = Some(checkpoint);
    }
    let last = last.unwrap();
    assert_ne!(last.parameters.num_gaussians(), 400, "density did not adapt");
    let quantizers = last.quantizers.as_ref().unwrap();
    let groups: Vec<Attribute> = quantizers.groups.iter().map(|&(attribute, _)| attribute).collect();
    assert!(groups.contains(&wetness) && !groups.contains(&age), "{groups:?}");

    // A run resumed from its files ends with the same bits.
    let mut resumed = run.resume().unwrap().unwrap();
    resumed.recall(&views(1)).unwrap();
    resumed.fit(&views(2), &mut |_| ControlFlow::Continue(())).unwrap();
    assert!(resumed.checkpoint().unwrap() == last, "resuming changed something");
    run.save(2, &last).unwrap();

    // All timesteps together, and some of the Gaussians.
    let trained = run.trained().unwrap();
    assert_eq!(*trained.scene.layout(), layout);
    assert!(trained.scene.varies(wetness) && !trained.scene.varies(age));
    let some: Vec<usize> = (0..trained.scene.num_gaussians()).step_by(3).collect();
    let selected = trained.scene.select(&some);
    assert!((0..3).all(|t| is_carried(&selected.at(t), wetness, age)));
    assert_eq!(selected.values(age, 2), some.iter().map(|&i| trained.scene.values(age, 0)[i]).collect::<Vec<_>>());

    // Symbols carry the columns; version 1 of the format has no place for them and refuses.
    let (bit_map, quantizers) = trained.quantization.unwrap();
    let (bit_map, info) = (bit_map.select(&some), SceneInfo::of(&selected));
    let settings = CompressSettings::default();
    let compact = tcgs_codec::compress(&selected, &bit_map, Some(&quantizers), info, &settings).unwrap();
    let found = compact.reconstruct();
    assert_eq!(*found.layout(), layout);
    // There Gaussians are reordered and quantised.
    let sorted = |scene: &tcgs_core::DynamicGaussians| {
        let mut ages = scene.values(age, 0).to_vec();
        ages.sort_by(f32::total_cmp);
        ages
    };
    assert!(sorted(&found).iter().zip(sorted(&selected)).all(|(a, b)| (a - b).abs() < 0.01));
    let error = tcgs_codec::encode(&compact).unwrap_err().to_string();
    assert!(error.contains("wetness"), "{error}");
}

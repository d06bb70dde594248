//! The GPU engine on a part of the scene: against itself on all of it, and against the CPU engine.

use crate::support::engines::{assert_same, bits, config, quantized, state, target, with_harmonics, with_past};
use crate::support::{Random, gpu, relative_l2};
use tcgs_core::{Activated, Attribute, Image};
use tcgs_render::gpu::Gpu;
use tcgs_render::{TileMask, tiles_reached};
use tcgs_train::engine::cpu::{CpuEngine, drawn};
use tcgs_train::engine::gpu::GpuEngine;
use tcgs_train::engine::{Engine, Scenery, Step, Target, ViewScenery};
use tcgs_train::{Dropout, LossTerms, Phase, Rates, Row, Schedule, State, TrainConfig, WeightConfig};

const SIZES: [[usize; 2]; 3] = [[75, 52], [120, 40], [33, 90]];

fn rates(config: &TrainConfig) -> Rates {
    // As in the trainer: locked Gaussians share the quantizers.
    Rates { step: 0.0, ..Schedule::new(config, 2.0).rates(Phase::Rest, 0) }
}

fn step<'a>(camera: usize, config: &'a TrainConfig) -> Step<'a> {
    let (weights, mask) = (&config.weights, &config.mask);
    Step {
        camera,
        rates: rates(config),
        weights,
        mask,
        counts_gradients: false,
        dropout: Dropout::default(),
        moves_gaussians: true,
    }
}

fn run(
    engine: &mut dyn Engine,
    targets: &[Target],
    scenery: Option<Scenery>,
    cameras: &[usize],
    config: &TrainConfig,
) -> Vec<LossTerms> {
    engine.begin(targets.into(), scenery).unwrap();
    cameras.iter().for_each(|&camera| engine.step(&step(camera, config)).unwrap());
    engine.wait().unwrap();
    engine.losses().unwrap()
}

/// Every third Gaussian is active.
fn is_active(i: usize) -> bool {
    i % 3 == 1
}

/// A set of tiles and all tiles beside them.
fn with_margin(tiles: &TileMask, image: &Image) -> TileMask {
    let mut wide = TileMask::none(image.width, image.height);
    for tile in tiles.iter() {
        let [columns, rows] = tiles.pixels(tile, image.width, image.height);
        wide.insert_pixels(
            columns.start.saturating_sub(1)..columns.end + 1,
            rows.start.saturating_sub(1)..rows.end + 1,
        );
    }
    wide
}

#[test]
fn a_part_has_the_gradients_of_the_whole_to_the_bit() {
    let Some(gpu) = gpu() else { return };
    const N: usize = 240;
    let mut config = config();
    // Losses on pixels alone, because means over Gaussians would be over other numbers of them.
    config.weights = WeightConfig { image: 1.0, segmentation: 3.0, ..WeightConfig::NONE };
    for channels in [3, 5] {
        let targets: Vec<Target> = (0..3).map(|i| target(SIZES[i], channels, i as u64)).collect();
        let mut whole = state(N, 3, |i| i % 2 == 0);
        for i in 0..N {
            let g = &mut whole.parameters.gaussians;
            g.log_scales_mut()[i] = g.log_scales()[i].map(|s| s - 2.5);
            // The active ones are together, so that some tiles have none.
            if is_active(i) {
                g.means_mut()[i] = g.means()[i].map(|x| 0.1 * x + 0.4);
            }
        }
        // All others are held, so that the GPU activates them too; Gaussians of equal depth are drawn in the scene's
        // order.
        let rows: Vec<usize> = (0..N).filter(|&i| is_active(i)).chain((0..N).filter(|&i| !is_active(i))).collect();
        let num_active = N / 3;
        let mut part = whole.clone();
        part.gather(&rows.iter().map(|&i| Row::Kept(i)).collect::<Vec<_>>());

        let all = drawn(&whole, &config.mask, channels == 5);
        let active = all.select(&rows[..num_active]);
        let mut num_tiles = [0, 0];
        let views = targets.iter().map(|target| {
            // Windows of SSIM then see no part of the picture with active Gaussians.
            let tiles = with_margin(&tiles_reached(&active, &target.camera), &target.image);
            num_tiles = [num_tiles[0] + tiles.len(), num_tiles[1] + tiles.grid()[0] * tiles.grid()[1]];
            let picture = Image::filled(target.image.width, target.image.height, channels, 0.0);
            ViewScenery { tiles, gaussians: (0..N as u32).collect(), colors: None, picture }
        });
        let views = views.collect();
        assert!(4 * num_tiles[0] < 3 * num_tiles[1], "{num_tiles:?} are not a part");
        let places = rows.iter().map(|&i| i as u32).collect();
        let scenery = Scenery { num_active, drawn: all, places, views };
        // Every column has a rate, as in a first timestep.
        let rates = Schedule::new(&config, 2.0).rates(Phase::First, 0);
        for camera in 0..3 {
            let (mut a, mut b) = (GpuEngine::new(&gpu, whole.clone()), GpuEngine::new(&gpu, part.clone()));
            for (engine, scenery) in [(&mut a, None), (&mut b, Some(scenery.clone()))] {
                engine.begin(targets.clone().into(), scenery).unwrap();
                engine.step(&Step { rates, ..step(camera, &config) }).unwrap();
            }
            let (expected, found) = (a.state().unwrap(), b.state().unwrap());
            for attribute in Attribute::BASE {
                let k = attribute.components();
                // The first moments of a first update are a tenth of the gradients.
                let [expected, found] = [expected, found].map(|s| s.optimizer.first.values(attribute));
                let mut moved = 0;
                for (row, &i) in rows.iter().enumerate() {
                    let (e, f) = (&expected[i * k..][..k], &found[row * k..][..k]);
                    if row < num_active {
                        assert_eq!(f, e, "{} of Gaussian {i}, view {camera}", attribute.name());
                        moved += usize::from(e.iter().any(|&v| v != 0.0));
                    } else {
                        assert!(f.iter().all(|&v| v == 0.0), "{} of locked {i}", attribute.name());
                    }
                }
                assert!(moved > num_active / 2, "{moved} of {num_active} have a gradient to {}", attribute.name());
            }
            for (row, &i) in rows.iter().enumerate().skip(num_active) {
                let [before, after] = [&whole, found].map(|s| &s.parameters.gaussians);
                assert_eq!(after.means()[row], before.means()[i], "locked Gaussian {i}");
                assert_eq!(after.quats()[row], before.quats()[i], "locked Gaussian {i}");
            }
        }
    }
}

/// The tiles that a view draws.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tiles {
    Scattered,
    Rectangle,
}

/// A state of some rows, and a scenery that draws them among others.
///
/// Pictures are the targets, so that pixels around the tiles have no loss: the two engines count different ones.
fn part_of_a_scene(
    start: &State,
    targets: &[Target],
    config: &TrainConfig,
    num_active: usize,
    which: Tiles,
) -> Scenery {
    let mut random = Random::new(5);
    let n = start.parameters.num_gaussians();
    let channels = targets[0].image.num_channels;
    let locked = drawn(&state(3 * n, 1, |i| i % 2 == 0), &config.mask, channels == 5);
    let rows = drawn(start, &config.mask, channels == 5);
    // Rows from the last to the first, each after three locked ones.
    let joined = joined(&locked, &rows);
    let order: Vec<usize> = (0..n).flat_map(|i| [3 * i, 3 * i + 1, 3 * i + 2, 3 * n + (n - 1 - i)]).collect();
    let place_of = |row: usize| (4 * (n - 1 - row) + 3) as u32;
    let mut view = |target: &Target| {
        let [width, height] = [target.image.width, target.image.height];
        let mut tiles = TileMask::none(width, height);
        let [columns, rows] = tiles.grid();
        match which {
            Tiles::Scattered => {
                (0..(columns * rows).div_ceil(4)).for_each(|_| tiles.insert(random.below(columns * rows)));
            }
            Tiles::Rectangle => tiles.insert_pixels(17..width * 2 / 3, 20..height),
        }
        // Some of the locked ones are in no list.
        let gaussians: Vec<u32> = (0..4 * n as u32).filter(|i| i % 4 == 3 || i % 11 != 0).collect();
        // Each camera sees the locked ones in other colours.
        let has_harmonics = start.parameters.gaussians.layout().sh_degree() > 0;
        let colors = has_harmonics.then(|| (0..channels * gaussians.len()).map(|_| 0.5 + random.within(0.5)).collect());
        ViewScenery { tiles, gaussians, colors, picture: target.image.clone() }
    };
    let views = targets.iter().map(&mut view).collect();
    Scenery { num_active, drawn: joined.select(&order), places: (0..n).map(place_of).collect(), views }
}

fn joined(a: &Activated, b: &Activated) -> Activated {
    Activated {
        means: [&a.means[..], &b.means].concat(),
        quats: [&a.quats[..], &b.quats].concat(),
        scales: [&a.scales[..], &b.scales].concat(),
        opacities: [&a.opacities[..], &b.opacities].concat(),
        colors: [&a.colors[..], &b.colors].concat(),
        num_channels: a.num_channels,
        is_antialiased: a.is_antialiased,
        background: b.background.clone(),
    }
}

const CAMERAS: [usize; 5] = [1, 0, 2, 1, 0];

fn compare(name: &str, gpu: &Gpu, start: &State, channels: usize, num_active: usize, which: Tiles, cameras: &[usize]) {
    let config = config();
    let targets: Vec<Target> = (0..3).map(|i| target(SIZES[i], channels, i as u64)).collect();
    let scenery = part_of_a_scene(start, &targets, &config, num_active, which);
    let (mut a, mut b) = (CpuEngine::new(start.clone()), GpuEngine::new(gpu, start.clone()));
    let expected = run(&mut a, &targets, Some(scenery.clone()), cameras, &config);
    let mut found = run(&mut b, &targets, Some(scenery), cameras, &config);
    if which == Tiles::Scattered {
        // The CPU engine counts a pixel once for each rectangle of tiles near it.
        for (found, expected) in found.iter_mut().zip(&expected) {
            assert!(found.image > 0.2 * expected.image && found.image <= expected.image * (1.0 + 1e-5), "{name}");
            (found.image, found.segmentation) = (expected.image, expected.segmentation);
        }
    }
    assert_same(name, &config, (&expected, a.state().unwrap()), (&found, b.state().unwrap()));
    let (before, after) = (&start.parameters, &b.state().unwrap().parameters);
    for attribute in Attribute::BASE {
        let first = num_active * attribute.components();
        let [before, after] = [before, after].map(|p| p.gaussians.values(attribute));
        assert_eq!(before[first..], after[first..], "{name}: held {}", attribute.name());
    }
    assert_eq!(before.camera_gains, after.camera_gains, "{name}");
    assert!(relative_l2(after.gaussians.values(Attribute::Mean), before.gaussians.values(Attribute::Mean)) > 1e-6);
}

#[test]
fn both_engines_train_a_part_alike() {
    let Some(gpu) = gpu() else { return };
    for channels in [3, 5] {
        for (n, num_active) in [(1, 1), (90, 40), (600, 300)] {
            let mut start = with_past(state(n, 3, |i| i % 3 != 0));
            let gaussians = &mut start.parameters.gaussians;
            *gaussians = std::mem::take(gaussians).with_background([90, 140, 200]);
            for which in [Tiles::Scattered, Tiles::Rectangle] {
                let name = format!("{n} rows, {channels} channels, {which:?}");
                compare(&name, &gpu, &start, channels, num_active, which, &CAMERAS);
            }
        }
    }
}

#[test]
fn both_engines_train_a_part_among_the_colours_that_each_camera_sees() {
    let Some(gpu) = gpu() else { return };
    for (degree, channels) in [(1, 5), (3, 3)] {
        let start = with_past(with_harmonics(state(120, 3, |i| i % 3 != 0), degree));
        let name = format!("degree {degree}, {channels} channels");
        // One iteration each: Adam's step is as long for a gradient of pure rounding.
        for camera in 0..3 {
            compare(&format!("{name}, view {camera}"), &gpu, &start, channels, 50, Tiles::Rectangle, &[camera]);
        }
    }
}

#[test]
fn iterations_beyond_the_room_and_runs_again_have_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let start = quantized(with_past(state(90, 3, |i| i % 2 == 0)), true);
    let targets: Vec<Target> = (0..3).map(|i| target(SIZES[i], 5, i as u64)).collect();
    let scenery = part_of_a_scene(&start, &targets, &config, 50, Tiles::Scattered);
    let cameras: Vec<usize> = (0..70).map(|i| i % 3).collect();
    let runs = [100_000, 100_000, 1].map(|room| {
        let mut engine = GpuEngine::new(&gpu, start.clone()).with_room_for(room);
        let losses = run(&mut engine, &targets, Some(scenery.clone()), &cameras, &config);
        (losses, bits(engine.state().unwrap()))
    });
    assert_eq!(runs[0].0.len(), 70);
    assert!(runs[0] == runs[1], "another run differs");
    assert!(runs[0] == runs[2], "a run with too little room differs");
}

#[test]
fn the_steady_loop_reads_nothing_back_and_compiles_nothing_anew() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let start = with_past(state(60, 3, |i| i % 2 == 0));
    let targets: Vec<Target> = (0..3).map(|i| target(SIZES[i], 5, i as u64)).collect();
    let scenery = part_of_a_scene(&start, &targets, &config, 30, Tiles::Scattered);
    let mut engine = GpuEngine::new(&gpu, start.clone()).with_room_for(100_000);
    run(&mut engine, &targets, Some(scenery.clone()), &[0], &config);
    let compiled = gpu.num_compiled();
    // Another timestep, with other lists.
    let fewer = Scenery { num_active: 20, ..scenery };
    run(&mut engine, &targets, Some(fewer), &[1], &config);
    let before = [gpu.num_submissions(), gpu.num_reads()];
    for i in 0..60 {
        engine.step(&step(i % 3, &config)).unwrap();
    }
    assert_eq!((gpu.num_submissions() - before[0], gpu.num_reads() - before[1]), (60, 0));
    engine.wait().unwrap();
    assert_eq!((engine.losses().unwrap().len(), gpu.num_compiled()), (60, compiled));
}

#[test]
fn a_part_and_the_whole_follow_each_other() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let start = with_past(state(90, 3, |i| i % 2 == 0));
    let targets: Vec<Target> = (0..3).map(|i| target(SIZES[i], 5, i as u64)).collect();
    let scenery = part_of_a_scene(&start, &targets, &config, 50, Tiles::Scattered);
    let alone = |scenery: Option<Scenery>| {
        let mut engine = GpuEngine::new(&gpu, start.clone());
        let losses = run(&mut engine, &targets, scenery, &[0, 1], &config);
        (losses, bits(engine.state().unwrap()))
    };
    let mut engine = GpuEngine::new(&gpu, start.clone());
    for scenery in [None, Some(scenery.clone()), None, Some(scenery)] {
        *engine.state_mut().unwrap() = start.clone();
        let losses = run(&mut engine, &targets, scenery.clone(), &[0, 1], &config);
        assert!((losses, bits(engine.state().unwrap())) == alone(scenery));
    }
}

#[test]
fn an_image_around_the_tiles_is_part_of_the_loss() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let start = with_past(state(30, 3, |i| i % 2 == 0));
    let targets: Vec<Target> = (0..3).map(|i| target(SIZES[i], 3, i as u64)).collect();
    let scenery = part_of_a_scene(&start, &targets, &config, 20, Tiles::Scattered);
    let mut dark = scenery.clone();
    for view in &mut dark.views {
        view.picture = Image::filled(view.picture.width, view.picture.height, 3, 0.0);
    }
    let [with, without] = [scenery, dark].map(|scenery| {
        let mut engine = GpuEngine::new(&gpu, start.clone());
        (run(&mut engine, &targets, Some(scenery), &[0], &config)[0].image, bits(engine.state().unwrap()))
    });
    assert!(without.0 > with.0 && without.1 != with.1, "{} and {}", with.0, without.0);
}

//! Rendering some tiles of an image against rendering all of it.

use crate::support::{random_scene, test_camera};
use tcgs_core::{Activated, ActivatedGrads, Image, normalize};
use tcgs_render::settings::{MAX_ALPHA, MIN_ALPHA};
use tcgs_render::{
    CpuLocked, CpuRasterizer, CpuTiles, Laps, Rasterizer, RenderGrads, RenderSettings, Scope, SplatCamera, TileMask,
    count_pairs, gaussians_reaching, project, tiles_reached,
};

const SIZE: [usize; 2] = [75, 52];

fn some_tiles() -> TileMask {
    let mut mask = TileMask::none(SIZE[0], SIZE[1]);
    [0, 7, 8, 12, 19].into_iter().for_each(|tile| mask.insert(tile));
    mask
}

fn outside(mask: &TileMask) -> impl Fn(usize) -> bool + use<> {
    let mut inside = vec![false; SIZE[0] * SIZE[1]];
    for tile in mask.iter() {
        let [columns, rows] = mask.pixels(tile, SIZE[0], SIZE[1]);
        rows.for_each(|y| inside[y * SIZE[0]..][columns.clone()].fill(true));
    }
    move |pixel| !inside[pixel % inside.len()]
}

#[test]
fn tiles_drawn_alone_have_the_bits_of_the_whole_image_and_its_gradients() {
    let (camera, settings, mask) = (test_camera(SIZE[0], SIZE[1]), RenderSettings::default(), some_tiles());
    let gaussians = random_scene(300, 5, 3);
    let is_outside = outside(&mask);
    let Ok((whole, saved)) = CpuRasterizer.forward(&gaussians, &camera, &settings);
    assert_eq!(count_pairs(&gaussians, &camera), saved.counts());
    let mut image = Image::filled(SIZE[0], SIZE[1], 5, -7.0);
    let tiles =
        CpuRasterizer.forward_in(&gaussians, &camera, &settings, Scope::Tiles(&mask), &mut image, &mut Laps::begin());
    for (pixel, (&drawn, &expected)) in image.data.iter().zip(&whole.image.data).enumerate() {
        assert_eq!(drawn, if is_outside(pixel) { -7.0 } else { expected }, "value {pixel}");
    }

    let mut v_image = Image::filled(SIZE[0], SIZE[1], 5, 0.0);
    for (pixel, v) in v_image.data.iter_mut().enumerate().filter(|(pixel, _)| !is_outside(*pixel)) {
        *v = (0.37 * pixel as f32).sin() + 0.3;
    }
    let Ok(expected) = CpuRasterizer.backward(&gaussians, &camera, &settings, &saved, &v_image);
    // Pixels outside of the tiles are not read.
    v_image.data.iter_mut().enumerate().filter(|(pixel, _)| is_outside(*pixel)).for_each(|(_, v)| *v = f32::NAN);
    let laps = &mut Laps::begin();
    let found = CpuRasterizer.backward_in(&gaussians, &camera, &settings, &tiles, &image, &v_image, None, laps);
    assert_eq!(found.activated, expected.activated);
    assert_eq!(found.v_means2d_ndc, expected.v_means2d_ndc);
    let reaching = gaussians_reaching(&gaussians, &camera, &mask);
    let visible: Vec<u32> = (0..300).filter(|&i| found.visible[i as usize]).collect();
    assert_eq!(visible, reaching);
    assert!(reaching.len() > 50 && reaching.len() < 290, "{} of 300", reaching.len());
}

#[test]
fn gaussians_may_move_among_locked_ones() {
    let (camera, settings) = (test_camera(SIZE[0], SIZE[1]), RenderSettings::default());
    let mut gaussians = random_scene(300, 5, 3);
    // Equal depths are drawn in the order of the Gaussians, whichever of them move.
    (0..300).for_each(|i| gaussians.means[i] = gaussians.means[i - i % 3]);
    let moving: Vec<u32> = (0..300).filter(|i| i % 3 == 1).rev().collect();
    let locked = CpuLocked::new(&gaussians, &camera, some_tiles(), moving.clone());
    for step in 0..3 {
        let of = |scope: Scope<'_>| {
            let (mut image, laps) = (Image::filled(SIZE[0], SIZE[1], 5, -7.0), &mut Laps::begin());
            let tiles = CpuRasterizer.forward_in(&gaussians, &camera, &settings, scope, &mut image, laps);
            let v_image = Image { data: image.data.iter().map(|v| (9.0 * v).sin() + 0.3).collect(), ..image.clone() };
            let grads = CpuRasterizer.backward_in(&gaussians, &camera, &settings, &tiles, &image, &v_image, None, laps);
            (image, grads)
        };
        assert_eq!(of(Scope::Locked(&locked)), of(Scope::Tiles(&some_tiles())), "step {step}");
        for &i in &moving {
            gaussians.means[i as usize][0] += 0.1 * (i as f32).sin();
            gaussians.means[i as usize][2] += 0.05 * (i as f32).cos();
            gaussians.opacities[i as usize] *= if i % 7 == 0 { 1e-4 } else { 0.9 };
        }
    }
}

#[test]
fn gradients_of_some_gaussians_have_the_bits_of_those_of_all() {
    let camera = test_camera(SIZE[0], SIZE[1]);
    let gaussians = random_scene(300, 5, 3);
    let wanted: Vec<bool> = (0..300).map(|i| i % 3 == 1).collect();
    let (chosen, others): (Vec<usize>, Vec<usize>) = (0..300).partition(|&i| wanted[i]);
    for (statistic_channels, learned_channels) in [(0, 3), (0, 5), (3, 3), (3, 5), (5, 3), (5, 5)] {
        let settings = RenderSettings { statistic_channels, learned_channels, ..RenderSettings::default() };
        let (mask, laps) = (TileMask::all(SIZE[0], SIZE[1]), &mut Laps::begin());
        let mut image = Image::filled(SIZE[0], SIZE[1], 5, 0.0);
        let tiles = CpuRasterizer.forward_in(&gaussians, &camera, &settings, Scope::Tiles(&mask), &mut image, laps);
        let mut v_image = image.clone();
        v_image.data.iter_mut().enumerate().for_each(|(i, v)| *v = (0.37 * i as f32).sin() + 0.3);
        let mut grads =
            |wanted| CpuRasterizer.backward_in(&gaussians, &camera, &settings, &tiles, &image, &v_image, wanted, laps);
        let (all, some) = (grads(None), grads(Some(&wanted[..])));
        assert_eq!(some.activated.select(&chosen, 5), all.activated.select(&chosen, 5));
        assert!(chosen.iter().all(|&i| some.v_means2d_ndc[i] == all.v_means2d_ndc[i]));
        assert!(chosen.iter().all(|&i| some.visible[i] == all.visible[i]));
        let rest = some.activated.select(&others, 5);
        assert!(rest.v_means.iter().all(|v| *v == [0.0; 3]) && rest.v_colors.iter().all(|v| *v == 0.0));
    }
}

#[test]
fn colours_that_are_not_learned_have_no_gradient_and_change_no_other() {
    let camera = test_camera(SIZE[0], SIZE[1]);
    let gaussians = random_scene(300, 5, 3);
    let settings = RenderSettings::default();
    let Ok((output, saved)) = CpuRasterizer.forward(&gaussians, &camera, &settings);
    let mut v_image = output.image.clone();
    v_image.data.iter_mut().enumerate().for_each(|(i, v)| *v = (0.37 * i as f32).sin() + 0.3);
    let backward = |learned_channels| {
        let settings = RenderSettings { learned_channels, ..settings.clone() };
        let Ok(grads) = CpuRasterizer.backward(&gaussians, &camera, &settings, &saved, &v_image);
        grads
    };
    let (all, three) = (backward(5), backward(3));
    for (found, expected) in three.activated.v_colors.chunks(5).zip(all.activated.v_colors.chunks(5)) {
        assert_eq!([&found[..3], &found[3..]], [&expected[..3], &[0.0; 2]]);
    }
    assert!(all.activated.v_colors.chunks(5).any(|colors| colors[3] != 0.0));
    let without_colors = |grads: &RenderGrads| RenderGrads {
        activated: ActivatedGrads { v_colors: Vec::new(), ..grads.activated.clone() },
        ..grads.clone()
    };
    assert_eq!(without_colors(&three), without_colors(&all));
}

#[test]
fn blending_weights_are_the_gradients_to_colours_and_tiles_draw_in_any_colours() {
    let (camera, settings) = (test_camera(SIZE[0], SIZE[1]), RenderSettings::default());
    for channels in [1, 2, 5] {
        let gaussians = random_scene(300, channels, 3);
        let tiles = CpuTiles::new(&gaussians, &camera);
        let Ok((whole, saved)) = CpuRasterizer.forward(&gaussians, &camera, &settings);
        assert_eq!(tiles.draw(&gaussians.colors, channels), whole.image);

        let mut shares = Image::filled(SIZE[0], SIZE[1], channels, 0.0);
        shares.data.iter_mut().enumerate().for_each(|(i, share)| *share = (0.37 * i as f32).sin() + 0.3);
        let Ok(expected) = CpuRasterizer.backward(&gaussians, &camera, &settings, &saved, &shares);
        let weights = tiles.weights(&shares);
        assert_eq!(weights, expected.activated.v_colors, "{channels} channels");
        assert!(weights.iter().filter(|&&weight| weight != 0.0).count() > 100 * channels);
    }
}

#[test]
fn no_gaussian_changes_a_tile_that_it_does_not_reach() {
    let (camera, settings) = (test_camera(SIZE[0], SIZE[1]), RenderSettings::default());
    let scene = random_scene(40, 1, 9);
    for i in 0..scene.num_gaussians() {
        let alone = Activated {
            means: vec![scene.means[i]],
            quats: vec![scene.quats[i]],
            scales: vec![scene.scales[i]],
            opacities: vec![scene.opacities[i]],
            colors: vec![1.0],
            num_channels: 1,
            is_antialiased: false,
            background: Vec::new(),
        };
        let is_outside = outside(&tiles_reached(&alone, &camera));
        let Ok((output, _)) = CpuRasterizer.forward(&alone, &camera, &settings);
        let drawn = output.image.data.iter().enumerate().filter(|(_, value)| **value != 0.0);
        assert_eq!(drawn.filter(|(pixel, _)| is_outside(*pixel)).count(), 0, "Gaussian {i}");
    }
}

/// Bounds of a splat's columns and rows leave out no pixel: each Gaussian alone has its alpha in every pixel.
#[test]
fn every_pixel_shows_the_alpha_of_its_splat() {
    let (width, height) = (250, 170);
    let (camera, settings) = (test_camera(width, height), RenderSettings::default());
    let splat_camera = SplatCamera::<f32>::new(&camera);
    let (mut num_shown, mut num_hidden, mut num_beside) = (0, 0, 0);
    for i in 0..600 {
        // Thin and long in every direction, up to four times the width of the image, many with their centres beside it.
        let at = |step: f32, from: f32, to: f32| from + (to - from) * (step * i as f32).fract();
        let mean = [at(0.618, -2.5, 2.5), at(0.755, -2.0, 2.0), at(0.570, -2.4, 2.0)];
        let quat = normalize([1.0, at(0.414, -1.0, 1.0), at(0.303, -1.0, 1.0), at(0.732, -3.0, 3.0)]);
        let scale = [at(0.179, -7.0, 0.7), at(0.267, -7.0, -3.0), at(0.911, -7.0, -3.0)].map(f32::exp);
        let alone = Activated {
            means: vec![mean],
            quats: vec![quat],
            scales: vec![scale],
            opacities: vec![at(0.845, 0.004, 1.9)],
            colors: vec![1.0],
            num_channels: 1,
            is_antialiased: i % 2 == 0,
            background: Vec::new(),
        };
        let Ok((output, _)) = CpuRasterizer.forward(&alone, &camera, &settings);
        let Some(p) = project(mean, quat, scale, &splat_camera) else { continue };
        let kept = if alone.is_antialiased { p.kept_opacity() } else { 1.0 };
        let [a, b, c] = p.conic.map(f64::from);
        num_beside += usize::from(!(0.0..width as f32).contains(&p.mean2d[0]));
        for (pixel, &drawn) in output.image.data.iter().enumerate() {
            let dx = (pixel % width) as f64 + 0.5 - f64::from(p.mean2d[0]);
            let dy = (pixel / width) as f64 + 0.5 - f64::from(p.mean2d[1]);
            let exponent = 0.5 * (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy);
            let alpha = f64::from(alone.opacities[0] * kept) * (-exponent).exp();
            // Blending rounds the terms of the exponent.
            let rounding = 2e-3 + 1e-6 * (a * dx * dx + c * dy * dy);
            if alpha > MIN_ALPHA * (1.0 + rounding) {
                let error = (f64::from(drawn) / alpha.min(MAX_ALPHA) - 1.0).abs();
                assert!(error < rounding, "Gaussian {i}, pixel {pixel}: {drawn}, expected {alpha}");
                num_shown += 1;
            } else if alpha < MIN_ALPHA * (1.0 - rounding) {
                assert_eq!(drawn, 0.0, "Gaussian {i}, pixel {pixel}");
                num_hidden += 1;
            }
        }
    }
    assert!(num_shown > 100_000 && num_hidden > 1_000_000 && num_beside > 50, "{num_shown} {num_hidden} {num_beside}");
}

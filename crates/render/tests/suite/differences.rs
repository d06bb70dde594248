//! The CPU renderer against the f64 oracle: images, and gradients against its central differences.

use crate::support::oracle::{self, Scene};
use crate::support::{random_scene, relative_l2, test_camera};
use tcgs_core::{Activated, Image};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

const BEHIND: [f32; 8] = [0.3, 0.1, 0.7, 0.2, 0.9, 0.0, 0.5, 0.4];

fn background() -> RenderSettings {
    RenderSettings { background: Some(BEHIND), ..RenderSettings::default() }
}

/// A smooth, signed gradient image.
fn v_image(width: usize, height: usize, channels: usize) -> Image {
    let mut v = Image::filled(width, height, channels, 0.0);
    for (i, x) in v.data.iter_mut().enumerate() {
        *x = (0.37 * i as f32).sin() + 0.3;
    }
    v
}

#[test]
fn forward_equals_the_oracle_for_every_number_of_channels() {
    let camera = test_camera(37, 29);
    for channels in 1..=8 {
        let is_antialiased = channels % 2 == 0;
        let gaussians = Activated { is_antialiased, ..random_scene(60, channels, channels as u64) };
        let (output, _) = CpuRasterizer.forward(&gaussians, &camera, &background()).unwrap();
        let expected = oracle::render(&Scene::new(&gaussians), &camera, &BEHIND);
        let off = output.image.data.iter().zip(&expected.image).filter(|(a, b)| (f64::from(**a) - **b).abs() > 2e-5);
        // A cut-off may fall on either side of a rounding in a few pixels.
        assert!(off.count() <= 3, "{channels} channels");
    }
}

#[test]
fn backward_equals_central_differences_of_the_oracle() {
    compare_with_differences(&random_scene(30, 5, 77), 50);
}

#[test]
fn backward_of_antialiased_splats_equals_central_differences_of_the_oracle() {
    let mut gaussians = Activated { is_antialiased: true, ..random_scene(30, 5, 78) };
    // About a pixel's extent, and far below in one direction.
    gaussians.scales.iter_mut().for_each(|scale| *scale = scale.map(|s| 0.2 * s));
    gaussians.scales[3][0] = 0.002;
    compare_with_differences(&gaussians, 20);
}

/// - `most_skipped`: 1 in this many samples may cross a cut-off
fn compare_with_differences(gaussians: &Activated, most_skipped: usize) {
    let camera = test_camera(37, 29);
    let channels = gaussians.num_channels;
    let settings = background();
    let (_, saved) = CpuRasterizer.forward(gaussians, &camera, &settings).unwrap();
    let v = v_image(37, 29, channels);
    let grads = CpuRasterizer.backward(gaussians, &camera, &settings, &saved, &v).unwrap();
    let scene = Scene::new(gaussians);

    let g = &grads.activated;
    let found = |i: usize, component: usize| match component {
        oracle::MEAN..oracle::QUAT => g.v_means[i][component],
        oracle::QUAT..oracle::SCALE => g.v_quats[i][component - oracle::QUAT],
        oracle::SCALE..oracle::OPACITY => g.v_scales[i][component - oracle::SCALE],
        oracle::OPACITY => g.v_opacities[i],
        _ => g.v_colors[i * channels + component - oracle::COLOR],
    };
    let (mut skipped, mut total) = (0, 0);
    let mut groups = vec![(0.0, 0.0); oracle::COLOR + channels];
    for i in 0..scene.values.len() {
        for (component, group) in groups.iter_mut().enumerate() {
            let at = |h: f64| {
                let mut moved = scene.clone();
                moved.values[i][component] += h;
                oracle::render(&moved, &camera, &BEHIND)
            };
            let h = 1e-6;
            let (high, low) = (at(h), at(-h));
            total += 1;
            // If a sample appears or vanishes between the two, the difference is no derivative.
            if high.contributors != low.contributors {
                skipped += 1;
                continue;
            }
            let difference: f64 = (high.image.iter().zip(&low.image).zip(&v.data))
                .map(|((a, b), v)| (a - b) / (2.0 * h) * f64::from(*v))
                .sum();
            group.0 += (f64::from(found(i, component)) - difference).powi(2);
            group.1 += difference.powi(2);
        }
    }
    assert!(skipped * most_skipped <= total, "{skipped} of {total} samples crossed a cut-off");
    for (component, (error, norm)) in groups.iter().enumerate() {
        let relative = (error / norm).sqrt();
        assert!(relative < 2e-4, "component {component}: relative L2 {relative:.1e}");
    }
}

#[test]
fn the_statistic_counts_the_colours_alone() {
    let camera = test_camera(64, 48);
    let five = random_scene(400, 5, 5);
    let mut three = five.clone();
    three.num_channels = 3;
    three.colors = five.colors.chunks_exact(5).flat_map(|c| c[..3].to_vec()).collect();
    let settings = RenderSettings::default();
    let run = |gaussians| {
        let (_, saved) = CpuRasterizer.forward(gaussians, &camera, &settings).unwrap();
        CpuRasterizer.backward(gaussians, &camera, &settings, &saved, &v_image(64, 48, gaussians.num_channels)).unwrap()
    };
    let (five, three) = (run(&five), run(&three));
    let norm = |v: &[[f32; 2]]| v.as_flattened().iter().map(|x| x * x).sum::<f32>().sqrt();
    assert!(norm(&three.v_means2d_ndc) > 1.0);
    let error = relative_l2(five.v_means2d_ndc.as_flattened(), three.v_means2d_ndc.as_flattened());
    assert!(error < 1e-6, "relative L2 {error:.1e}");
    // With three channels the statistic is the whole gradient, in NDC units; two more channels must change the
    // gradient.
    assert_ne!(five.activated.v_means, three.activated.v_means);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let camera = test_camera(100, 75);
    let gaussians = random_scene(3000, 5, 9);
    let run = |threads| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let settings = RenderSettings::default();
            let (output, saved) = CpuRasterizer.forward(&gaussians, &camera, &settings).unwrap();
            (CpuRasterizer.backward(&gaussians, &camera, &settings, &saved, &v_image(100, 75, 5)).unwrap(), output)
        })
    };
    let one = run(1);
    assert!(one.0.visible.iter().filter(|&&v| v).count() > 2000);
    for threads in [2, 3, 8] {
        assert!(run(threads) == one, "{threads} threads differ from one");
    }
}

#[test]
fn nothing_to_draw_leaves_the_background() {
    let camera = test_camera(20, 20);
    let mut empty = random_scene(0, 3, 0);
    let (output, saved) = CpuRasterizer.forward(&empty, &camera, &background()).unwrap();
    assert!(output.transmittance.iter().all(|&t| t == 1.0));
    assert!((0..3).all(|c| output.image.plane(c).iter().all(|&x| x == BEHIND[c])));
    let grads = CpuRasterizer.backward(&empty, &camera, &background(), &saved, &v_image(20, 20, 3)).unwrap();
    assert!(grads.visible.is_empty());
    // Without one in the settings it is the Gaussians' own, of which the last channels may be left out.
    empty.background = vec![0.5, 0.25];
    let (output, _) = CpuRasterizer.forward(&empty, &camera, &RenderSettings::default()).unwrap();
    assert_eq!([0, 1, 2].map(|channel| output.image.plane(channel)[7]), [0.5, 0.25, 0.0]);

    // Gaussians that are not finite are culled, not smeared over the image.
    empty = random_scene(2, 3, 1);
    empty.means[0] = [f32::NAN; 3];
    empty.scales[1] = [f32::INFINITY; 3];
    let (output, _) = CpuRasterizer.forward(&empty, &camera, &background()).unwrap();
    assert!(output.transmittance.iter().all(|&t| t == 1.0));
}

#[test]
fn order_of_gaussians_does_not_matter() {
    let camera = test_camera(64, 48);
    let gaussians = random_scene(300, 3, 21);
    let mut reversed = gaussians.clone();
    reversed.means.reverse();
    reversed.quats.reverse();
    reversed.scales.reverse();
    reversed.opacities.reverse();
    reversed.colors = gaussians.colors.chunks_exact(3).rev().flatten().copied().collect();
    let render = |g| CpuRasterizer.forward(g, &camera, &background()).unwrap().0;
    assert!(render(&gaussians) == render(&reversed));
}

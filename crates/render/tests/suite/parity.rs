//! The GPU against the CPU. Both blend the same contributors, so numbers agree up to rounding. At a cut-off (alpha
//! 1/255, transmittance 1e-4) a pixel may fall to either side.

use crate::support::{Random, gpu, random_scene, relative_l2, test_camera};
use tcgs_core::{Activated, Camera, Image};
use tcgs_render::gpu::GpuRasterizer;
use tcgs_render::{CpuRasterizer, Rasterizer, RenderGrads, RenderOutput, RenderSettings};

const BEHIND: [f32; 8] = [0.1, 0.3, 0.2, 0.9, 0.5, 0.4, 0.7, 0.6];

fn settings() -> RenderSettings {
    RenderSettings { background: Some(BEHIND), ..RenderSettings::default() }
}

fn v_image(output: &RenderOutput) -> Image {
    let mut random = Random(7);
    Image { data: output.image.data.iter().map(|_| random.range(-1.0, 1.0)).collect(), ..output.image.clone() }
}

fn render<R: Rasterizer>(rasterizer: &R, scene: &Activated, camera: &Camera) -> (RenderOutput, RenderGrads) {
    let (output, saved) = rasterizer.forward(scene, camera, &settings()).unwrap();
    let grads = rasterizer.backward(scene, camera, &settings(), &saved, &v_image(&output)).unwrap();
    (output, grads)
}

/// Share of values that differ by more than `tolerance`, and the largest difference.
fn differing(found: &[f32], expected: &[f32], tolerance: f32) -> (f64, f32) {
    assert_eq!(found.len(), expected.len());
    let differences: Vec<f32> = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).collect();
    let many = differences.iter().filter(|d| d.is_nan() || **d > tolerance).count();
    (many as f64 / found.len().max(1) as f64, differences.iter().copied().fold(0.0, f32::max))
}

fn compare(name: &str, rasterizer: &GpuRasterizer, scene: &Activated, camera: &Camera) {
    let (expected, expected_grads) = render(&CpuRasterizer, scene, camera);
    let (found, grads) = render(rasterizer, scene, camera);
    let image = differing(&found.image.data, &expected.image.data, 1e-5);
    let transmittance = differing(&found.transmittance, &expected.transmittance, 1e-5);
    eprintln!("{name}: image {image:?}, transmittance {transmittance:?}");
    assert!(image.0 < 1e-4 && image.1 < 5e-3, "{name}: image {image:?}");
    assert!(transmittance.0 < 1e-4 && transmittance.1 < 5e-3, "{name}: transmittance {transmittance:?}");
    assert_eq!(grads.visible, expected_grads.visible, "{name}: visible");
    let (a, b) = (&grads.activated, &expected_grads.activated);
    let pairs: [(&str, &[f32], &[f32]); 6] = [
        ("means", a.v_means.as_flattened(), b.v_means.as_flattened()),
        ("quats", a.v_quats.as_flattened(), b.v_quats.as_flattened()),
        ("scales", a.v_scales.as_flattened(), b.v_scales.as_flattened()),
        ("opacities", &a.v_opacities, &b.v_opacities),
        ("colors", &a.v_colors, &b.v_colors),
        ("statistic", grads.v_means2d_ndc.as_flattened(), expected_grads.v_means2d_ndc.as_flattened()),
    ];
    for (what, found, expected) in pairs {
        let error = relative_l2(found, expected);
        eprintln!("{name} {what}: {error:.1e}");
        assert!(error < 5e-4, "{name} {what}: relative L2 {error}");
    }
}

#[test]
fn random_scenes() {
    let Some(gpu) = gpu() else { return };
    let rasterizer = GpuRasterizer::new(&gpu);
    // One tile and many, sizes that end within a tile, few and all channels, one bucket and several.
    for (n, channels, width, height) in [(1, 1, 16, 16), (40, 3, 50, 37), (700, 5, 97, 61), (3000, 8, 64, 48)] {
        let scene = random_scene(n, channels, n as u64);
        compare(&format!("{n} x {channels}"), &rasterizer, &scene, &test_camera(width, height));
        // Another scene, because in this one a pixel of the last size ends at a cut-off.
        let antialiased = Activated { is_antialiased: true, ..random_scene(n, channels, n as u64 + 1) };
        compare(&format!("{n} x {channels}, antialiased"), &rasterizer, &antialiased, &test_camera(width, height));
    }
}

#[test]
fn small_splats_near_and_beside_the_camera() {
    let Some(gpu) = gpu() else { return };
    let mut scene = random_scene(2000, 3, 3);
    let mut random = Random(11);
    for i in 0..2000 {
        scene.means[i] = [random.range(-4.0, 4.0), random.range(-3.0, 3.0), random.range(-4.0, 2.0)];
        scene.scales[i] = [random.range(1e-4, 0.02), random.range(1e-3, 0.5), random.range(1e-4, 0.05)];
        scene.opacities[i] = if i % 7 == 0 { 0.003 } else { random.range(0.004, 1.0) };
    }
    compare("needles", &GpuRasterizer::new(&gpu), &scene, &test_camera(160, 90));
    scene.is_antialiased = true;
    compare("antialiased needles", &GpuRasterizer::new(&gpu), &scene, &test_camera(160, 90));
}

#[test]
fn nothing_to_draw_is_the_background() {
    let Some(gpu) = gpu() else { return };
    let rasterizer = GpuRasterizer::new(&gpu);
    let camera = test_camera(33, 20);
    let mut behind = random_scene(5, 3, 1);
    behind.means.iter_mut().for_each(|mean| *mean = [0.0, 0.0, -9.0]);
    let mut broken = random_scene(3, 3, 1);
    broken.means[0][0] = f32::NAN;
    broken.scales[1] = [f32::INFINITY; 3];
    broken.opacities[2] = f32::NAN;
    for scene in [random_scene(0, 3, 1), behind, broken] {
        let (output, grads) = render(&rasterizer, &scene, &camera);
        assert!(output.transmittance.iter().all(|&t| t == 1.0));
        for channel in 0..3 {
            assert!(output.image.plane(channel).iter().all(|&v| v == BEHIND[channel]));
        }
        assert!(grads.activated.v_means.as_flattened().iter().all(|&v| v == 0.0));
    }
    // Without one in the settings it is the Gaussians' own, of which the last channels may be left out.
    let scene = Activated { background: vec![0.5, 0.25], ..random_scene(0, 3, 1) };
    let (output, _) = rasterizer.forward(&scene, &camera, &RenderSettings::default()).unwrap();
    assert_eq!([0, 1, 2].map(|channel| output.image.plane(channel)[7]), [0.5, 0.25, 0.0]);
}

#[test]
fn one_image_after_another_and_more_pairs_than_there_is_room_for() {
    let Some(gpu) = gpu() else { return };
    let camera = test_camera(320, 240);
    // Each splat covers all 300 tiles, far more than the first guess.
    let mut huge = random_scene(200, 3, 5);
    huge.scales.fill([3.0; 3]);
    huge.opacities.fill(0.02);
    let small = random_scene(200, 3, 6);
    let rasterizer = GpuRasterizer::new(&gpu);
    for scene in [&small, &huge, &small] {
        let again = render(&rasterizer, scene, &camera);
        assert_eq!(again, render(&GpuRasterizer::new(&gpu), scene, &camera), "results depend on what was drawn before");
        assert_eq!(again, render(&rasterizer, scene, &camera), "two runs differ");
    }
    compare("huge", &rasterizer, &huge, &camera);
    let compiled = gpu.num_compiled();
    render(&GpuRasterizer::new(&gpu), &small, &camera);
    assert_eq!(gpu.num_compiled(), compiled, "a shader was compiled twice");
}

#[test]
fn an_absent_adapter_is_named() {
    let error = tcgs_render::gpu::Gpu::open(tcgs_render::gpu::GpuChoice::Named("no such thing")).unwrap_err();
    assert!(error.to_string().starts_with("no GPU named no such thing, found "), "{error}");
}

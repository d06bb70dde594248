//! Extreme images and numbers on the GPU.

use crate::support::{Random, gpu, random_scene, relative_l2, test_camera};
use tcgs_core::{Activated, Camera, Image};
use tcgs_render::gpu::{GpuError, GpuRasterizer};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

/// An image two tiles high.
fn wide(columns: usize) -> Camera {
    Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 3000.0, 16 * columns, 17)
}

#[test]
fn more_tiles_than_a_dispatch_has_workgroups_along_one_side() {
    let Some(gpu) = gpu() else { return };
    let camera = wide(32_768);
    let mut scene = random_scene(30, 1, 1);
    for mean in &mut scene.means {
        *mean = [mean[0] * 60.0, mean[1] * 0.01, 0.0];
    }
    let settings = RenderSettings::default();
    let expected = CpuRasterizer.forward(&scene, &camera, &settings).unwrap().0;
    let found = GpuRasterizer::new(&gpu).forward(&scene, &camera, &settings).unwrap().0;
    let lit = |data: &[f32]| data.iter().filter(|v| **v > 0.0).count();
    assert!(lit(&expected.image.data) > 10_000);
    let worst = found.image.data.iter().zip(&expected.image.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 5e-3, "{worst}");
}

#[test]
fn more_pairs_than_32_bits_count_are_too_many() {
    let Some(gpu) = gpu() else { return };
    // Every splat reaches all 65534 tiles.
    let scene = Activated {
        means: vec![[0.0; 3]; 65_540],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 65_540],
        scales: vec![[1e6; 3]; 65_540],
        opacities: vec![0.5; 65_540],
        colors: vec![0.5; 65_540],
        num_channels: 1,
        is_antialiased: false,
        background: Vec::new(),
    };
    let error = GpuRasterizer::new(&gpu).forward(&scene, &wide(32_767), &RenderSettings::default()).unwrap_err();
    assert!(matches!(error, GpuError::Memory { .. } | GpuError::Unfit { .. }), "{error:?}");
}

#[test]
fn extreme_numbers_are_as_on_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let (settings, mut random) = (RenderSettings::default(), Random(3));
    let extremes = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, 1e-38, 1e30, -1e30, 3e38, 1e12, -5.0];
    for (round, size) in [[1, 1], [40, 23], [16, 1], [1, 33]].into_iter().enumerate() {
        let camera = test_camera(size[0], size[1]);
        let mut scene = random_scene(400, 3, round as u64);
        for i in (0..400).step_by(2) {
            let extreme = extremes[i / 2 % extremes.len()];
            match i / 2 / extremes.len() % 5 {
                0 => scene.means[i][i % 3] = extreme,
                1 => scene.scales[i][i % 3] = extreme,
                2 => scene.scales[i] = [extreme; 3],
                3 => scene.quats[i] = [0.0; 4],
                _ => scene.opacities[i] = if extreme == 0.0 { 1.0 } else { extreme.min(1.0) },
            }
        }
        let v_image = Image {
            data: (0..3 * size[0] * size[1]).map(|_| random.range(-1.0, 1.0)).collect(),
            ..Image::filled(size[0], size[1], 3, 0.0)
        };
        let on_gpu = GpuRasterizer::new(&gpu);
        let (expected, saved) = CpuRasterizer.forward(&scene, &camera, &settings).unwrap();
        let expected_grads = CpuRasterizer.backward(&scene, &camera, &settings, &saved, &v_image).unwrap();
        let (found, saved) = on_gpu.forward(&scene, &camera, &settings).unwrap();
        let grads = on_gpu.backward(&scene, &camera, &settings, &saved, &v_image).unwrap();
        assert_eq!(grads.visible, expected_grads.visible, "{size:?}");
        let worst = found.image.data.iter().zip(&expected.image.data).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 5e-3, "{size:?}: {worst}");
        let (f, e) = (&grads.activated, &expected_grads.activated);
        let pairs = [
            ("means", f.v_means.as_flattened(), e.v_means.as_flattened()),
            ("quats", f.v_quats.as_flattened(), e.v_quats.as_flattened()),
            ("scales", f.v_scales.as_flattened(), e.v_scales.as_flattened()),
            ("opacities", &f.v_opacities, &e.v_opacities),
        ];
        for (name, found, expected) in pairs {
            let error = relative_l2(found, expected);
            assert!(error < 1e-3, "{size:?} {name}: {error}");
        }
    }
}

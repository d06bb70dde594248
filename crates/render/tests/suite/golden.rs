//! Renders and gradients of other programs (gsplat 1.5.3; the rasterizer of Dynamic 3D Gaussians).

use crate::support::{Arrays, golden, gpu, relative_l2, rows};
use tcgs_core::{Activated, ActivatedGrads, Image, normalize_vjp};
use tcgs_render::gpu::GpuRasterizer;
use tcgs_render::{CpuRasterizer, Rasterizer, RenderGrads, RenderSettings};

fn share_within(found: &[f32], expected: &[f32], tolerance: f32, channels: usize) -> f64 {
    let n = found.len() / channels;
    let good =
        (0..n).filter(|&p| (0..channels).all(|c| (found[c * n + p] - expected[c * n + p]).abs() <= tolerance)).count();
    good as f64 / n as f64
}

fn planes_from_interleaved(hwc: &[f32]) -> Vec<f32> {
    (0..3).flat_map(|c| hwc.iter().skip(c).step_by(3).copied()).collect()
}

fn render<R: Rasterizer>(rasterizer: &R, arrays: &mut Arrays) -> (Activated, Image, RenderGrads) {
    let (gaussians, camera) = arrays.scene();
    let settings = RenderSettings::default();
    let (output, saved) = rasterizer.forward(&gaussians, &camera, &settings).unwrap();
    let v_image = Image { data: arrays.f32("v_image_chw"), ..output.image.clone() };
    let grads = rasterizer.backward(&gaussians, &camera, &settings, &saved, &v_image).unwrap();
    (gaussians, output.image, grads)
}

/// Compares both renderers.
fn compare(name: &str, gradient_tolerance: f64, second_opinion: bool) {
    compare_one(name, &CpuRasterizer, gradient_tolerance, second_opinion);
    if let Some(gpu) = gpu() {
        compare_one(name, &GpuRasterizer::new(&gpu), gradient_tolerance, second_opinion);
    }
}

fn compare_one<R: Rasterizer>(name: &str, rasterizer: &R, gradient_tolerance: f64, second_opinion: bool) {
    let Some(path) = golden(&format!("raster_{name}.npz")) else { return };
    let mut arrays = Arrays::open(&path);
    let (gaussians, image, grads) = render(rasterizer, &mut arrays);

    let expected = planes_from_interleaved(&arrays.f32("gsplat_image_hwc"));
    let close = share_within(&image.data, &expected, 1e-4, 3);
    let worst = image.data.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    eprintln!("{name}: {:.3} % of pixels within 1e-4, worst {worst:.1e}", 100.0 * close);
    assert!(close >= 0.999 && worst <= 0.01, "{name}: {close} within 1e-4, worst {worst}");

    let ActivatedGrads { v_means, v_quats, v_scales, v_opacities, v_colors } = &grads.activated;
    // gsplat differentiates through normalize(q).
    let through_normalize: Vec<[f32; 4]> =
        gaussians.quats.iter().zip(v_quats).map(|(&q, &v)| normalize_vjp(q, v)).collect();
    let pairs: [(&str, &[f32]); 5] = [
        ("gsplat_v_means", v_means.as_flattened()),
        ("gsplat_v_quats", through_normalize.as_flattened()),
        ("gsplat_v_scales", v_scales.as_flattened()),
        ("gsplat_v_opacities", v_opacities),
        ("gsplat_v_colors", v_colors),
    ];
    for (key, found) in pairs {
        let error = relative_l2(found, &arrays.f32(key));
        eprintln!("{name} {key}: {error:.1e}");
        assert!(error <= gradient_tolerance, "{name} {key}: relative L2 {error}");
    }

    if second_opinion {
        let close = share_within(&image.data, &arrays.f32("image_chw"), 1e-4, 3);
        assert!(close >= 0.98, "{name}: {close} within 1e-4 of the second program");
        // Its statistic has a third, unused component. It drops splats beyond three standard
        // deviations, so its gradients agree less closely than gsplat's.
        let ndc: Vec<f32> = rows::<3>(&arrays.f32("v_means2d_ndc")).iter().flat_map(|v| [v[0], v[1]]).collect();
        let error = relative_l2(grads.v_means2d_ndc.as_flattened(), &ndc);
        eprintln!("{name} v_means2d_ndc: {error:.1e}");
        assert!(error <= 0.02, "{name} v_means2d_ndc: relative L2 {error}");
    }
}

#[test]
fn tiny() {
    compare("tiny", 0.01, true);
}

#[test]
fn small() {
    compare("small", 0.01, true);
}

#[test]
fn medium() {
    compare("medium", 0.01, true);
}

#[test]
fn hard() {
    compare("hard", 0.03, false);
}

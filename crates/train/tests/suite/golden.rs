//! Losses, quantizer gradients, sensitivities and the very first render against other programs' vectors.

use std::io::Write;
use std::path::{Path, PathBuf};

use tcgs_codec::Quantizer;
use tcgs_core::{Activated, ActivatedGrads, Camera, Image, normalize};
use tcgs_interchange::{NpyValue, NpzReader};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tcgs_train::engine::cpu::{MotionPrior, PriorGrads, image_loss};
use tcgs_train::{Neighbors, Parameters, WeightConfig, fake_quant_vjp, predict, scene_radius, step_gradient_scale};

/// A file or folder that may not be passed on with the project. `None` skips the test, unless `REQUIRE_GOLDEN` is set.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("REQUIRE_GOLDEN").is_none(), "{} is required and absent", path.display());
    // Bypasses the capture of passing tests, so that a skip is visible.
    let _ = writeln!(std::io::stderr(), "skipped: {} is absent", path.display());
    None
}

struct Arrays(NpzReader);

impl Arrays {
    fn open(path: &Path) -> Self {
        Self(NpzReader::open(path).unwrap())
    }

    fn get<T: NpyValue>(&mut self, name: &str) -> Vec<T> {
        self.0.array_of(name).unwrap().values
    }

    fn rows<const D: usize>(&mut self, name: &str) -> Vec<[f32; D]> {
        self.get::<f32>(name).as_chunks::<D>().0.to_vec()
    }
}

fn relative_l2(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let square = |x: f32| f64::from(x) * f64::from(x);
    let error: f64 = found.iter().zip(expected).map(|(a, b)| square(a - b)).sum();
    (error / expected.iter().map(|&b| square(b)).sum::<f64>()).sqrt()
}

fn close<const D: usize>(found: &[[f32; D]], expected: &[[f32; D]], tolerance: f32) {
    for (a, b) in found.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((a - b).abs() <= tolerance, "{a} against {b}");
    }
}

#[test]
fn motion_priors_equal_the_reference() {
    let Some(path) = shared("golden/motion_prior.npz") else { return };
    let mut a = Arrays::open(&path);
    let is_foreground: Vec<bool> = a.get("is_fg");
    let (means0, quats0) = (a.rows::<3>("means_t0"), a.rows::<4>("quats_t0"));
    let (means1, quats1) = (a.rows::<3>("means_t1"), a.rows::<4>("quats_t1"));
    let (means2, quats2) = (a.rows::<3>("means_t2"), a.rows::<4>("quats_t2"));
    let colors = a.rows::<3>("colors");

    // Neighbours, found once after the first timestep.
    let neighbors = Neighbors::new(&means0, &is_foreground);
    assert_eq!(neighbors.per_node, 20);
    let expected: Vec<u32> = a.get::<i64>("neighbor_indices").iter().map(|&i| i as u32).collect();
    let sorted = |indices: &[u32]| -> Vec<Vec<u32>> {
        indices
            .chunks(20)
            .map(|row| {
                let mut row = row.to_vec();
                row.sort_unstable();
                row
            })
            .collect()
    };
    assert_eq!(sorted(&neighbors.indices), sorted(&expected));
    for (found, name) in [(&neighbors.weights, "neighbor_weight"), (&neighbors.distances, "neighbor_dist")] {
        assert!(relative_l2(found, &a.get::<f32>(name)) < 1e-3, "{name}");
    }

    // The constant-velocity prediction of the third timestep.
    let (mut predicted_means, mut predicted_quats) = (Vec::new(), Vec::new());
    for i in 0..means0.len() {
        let (mean, quat) = predict(means1[i], means0[i], quats1[i], quats0[i]);
        predicted_means.push(mean);
        predicted_quats.push(quat);
    }
    close(&predicted_means, &a.rows::<3>("predicted_means_t2"), 1e-5);
    close(&predicted_quats, &a.rows::<4>("predicted_quats_t2"), 1e-5);

    // Each loss alone.
    let prior = MotionPrior::new(neighbors.into(), &is_foreground, &means0, &quats0, &means1, &quats1, &colors);
    for name in ["rigid", "rot", "iso", "floor", "bg"] {
        let on = |this: &str| f32::from(u8::from(name == this));
        let weights = WeightConfig {
            rigid: on("rigid"),
            rot: on("rot"),
            iso: on("iso"),
            floor: on("floor"),
            background: on("bg"),
            soft_color: 0.0,
            ..WeightConfig::NONE
        };
        let n = means2.len();
        let (mut v_means, mut v_quats, mut v_colors) = (vec![[0.0; 3]; n], vec![[0.0; 4]; n], vec![[0.0; 3]; n]);
        let grads = PriorGrads { v_means: &mut v_means, v_quats: &mut v_quats, v_colors: &mut v_colors };
        let losses = prior.losses(&means2, &quats2, &colors, &weights, grads);
        let found = match name {
            "rigid" => losses.rigid,
            "rot" => losses.rot,
            "iso" => losses.iso,
            "floor" => losses.floor,
            _ => losses.background,
        };
        let expected = a.get::<f64>(&format!("loss_{name}"))[0];
        assert!((found / expected - 1.0).abs() < 1e-4, "{name}: {found} against {expected}");
        for (found, key) in
            [(v_means.as_flattened(), format!("v_means_{name}")), (v_quats.as_flattened(), format!("v_quats_{name}"))]
        {
            let expected = a.get::<f32>(&key);
            let norm = |v: &[f32]| v.iter().map(|x| x * x).sum::<f32>().sqrt();
            if norm(&expected) == 0.0 {
                assert_eq!(norm(found), 0.0, "{key}");
            } else {
                let error = relative_l2(found, &expected);
                eprintln!("{key}: {error:.1e}");
                assert!(error < 2e-3, "{key}: relative L2 {error}");
            }
        }
    }
}

#[test]
fn the_image_loss_equals_the_reference() {
    let Some(path) = shared("golden/image_loss.npz") else { return };
    let mut a = Arrays::open(&path);
    let image = |data| Image { width: 61, height: 45, num_channels: 3, data };
    let (rendered, target) = (image(a.get("rendered_chw")), image(a.get("target_chw")));
    let mut v_image = Image::default();
    let loss = image_loss(&rendered, &target, [0.0; 3], [0.0; 3], 1.0, 0.0, &mut v_image);
    assert!((loss.image - a.get::<f64>("loss")[0]).abs() < 1e-6);
    assert!(relative_l2(&v_image.data, &a.get::<f32>("v_rendered_chw")) < 1e-4);
}

#[test]
fn learned_steps_equal_the_authors_quantizer() {
    for bits in [3_u8, 4, 8] {
        let Some(path) = shared(&format!("golden/lsq_{bits}bit.npz")) else { return };
        let mut a = Arrays::open(&path);
        let (x, y, v_y, v_x) = (a.rows::<3>("x"), a.rows::<3>("y"), a.rows::<3>("v_y"), a.rows::<3>("v_x"));
        let (step_init, v_step) = (a.get::<f32>("step_init"), a.get::<f32>("v_step"));
        for channel in 0..3 {
            let column: Vec<f32> = x.iter().map(|row| row[channel]).collect();
            let step = tcgs_codec::lsq_step(&column, bits).unwrap();
            assert!(
                (step / step_init[channel] - 1.0).abs() < 1e-5,
                "{bits} bits: {step} against {}",
                step_init[channel]
            );
            let quantizer = Quantizer::new(step_init[channel], 0.0, bits).unwrap();
            let mut sum = 0.0;
            let mut off = 0;
            for (i, &value) in column.iter().enumerate() {
                let found = quantizer.dequantize(quantizer.quantize(value));
                // A value on the edge between two codes may go to either.
                off += usize::from((found - y[i][channel]).abs() > 1e-5);
                let (v, v_step, _) = fake_quant_vjp(value, &quantizer, v_y[i][channel]);
                assert!((v - v_x[i][channel]).abs() <= 1e-6, "{bits} bits, {value}");
                sum += f64::from(v_step);
            }
            assert!(off <= 1, "{bits} bits: {off} codes differ");
            // The gradient's scale counts all values of the tensor.
            let found = sum as f32 * step_gradient_scale(bits, 3 * column.len());
            assert!((found - v_step[channel]).abs() < 1e-3 * v_step[channel].abs().max(0.01), "{bits} bits: {found}");
        }
    }
}

#[test]
fn sensitivities_equal_the_reference() {
    let (Some(scene), Some(path)) = (shared("golden/raster_small.npz"), shared("golden/sensitivity.npz")) else {
        return;
    };
    let (mut scene, mut a) = (Arrays::open(&scene), Arrays::open(&path));
    let k = scene.get::<f64>("k");
    let size = scene.get::<i64>("size_wh");
    let gaussians = Activated {
        means: scene.rows("means"),
        quats: scene.rows::<4>("quats_wxyz").into_iter().map(normalize).collect(),
        scales: scene.rows("scales"),
        opacities: scene.get("opacities"),
        colors: scene.get("colors"),
        num_channels: 3,
        is_antialiased: false,
        background: Vec::new(),
    };
    // The vectors are with respect to activated values, so this repeats the stored-form function step by step.
    let mut sum = ActivatedGrads::default();
    let mut num_pixels = 0;
    for matrix in a.get::<f64>("camera_from_world").chunks(16) {
        let camera = Camera::new(
            size[0] as usize,
            size[1] as usize,
            std::array::from_fn(|i| std::array::from_fn(|j| k[3 * i + j])),
            std::array::from_fn(|i| std::array::from_fn(|j| matrix[4 * i + j])),
        )
        .unwrap();
        let settings = RenderSettings::default();
        let (output, saved) = CpuRasterizer.forward(&gaussians, &camera, &settings).unwrap();
        let ones = Image::filled(output.image.width, output.image.height, 3, 1.0);
        let v = CpuRasterizer.backward(&gaussians, &camera, &settings, &saved, &ones).unwrap().activated;
        let add = |sum: &mut Vec<f32>, v: &[f32]| {
            sum.resize(v.len(), 0.0);
            sum.iter_mut().zip(v).for_each(|(s, v)| *s += v.abs());
        };
        let n = v.v_means.len();
        sum.v_means.resize(n, [0.0; 3]);
        sum.v_quats.resize(n, [0.0; 4]);
        sum.v_scales.resize(n, [0.0; 3]);
        for i in 0..n {
            (0..3).for_each(|d| sum.v_means[i][d] += v.v_means[i][d].abs());
            (0..4).for_each(|d| sum.v_quats[i][d] += v.v_quats[i][d].abs());
            (0..3).for_each(|d| sum.v_scales[i][d] += v.v_scales[i][d].abs());
        }
        add(&mut sum.v_opacities, &v.v_opacities);
        add(&mut sum.v_colors, &v.v_colors);
        num_pixels += camera.width * camera.height;
    }
    for (name, found) in [
        ("s_means", sum.v_means.as_flattened()),
        ("s_quats", sum.v_quats.as_flattened()),
        ("s_scales", sum.v_scales.as_flattened()),
        ("s_opacities", &sum.v_opacities),
        ("s_colors", &sum.v_colors),
    ] {
        let found: Vec<f32> = found.iter().map(|s| s / num_pixels as f32).collect();
        let error = relative_l2(&found, &a.get::<f32>(name));
        eprintln!("{name}: {error:.1e}");
        // The other program cuts splats off at three standard deviations.
        assert!(error < 0.02, "{name}: relative L2 {error}");
    }
}

#[test]
fn the_first_render_of_basketball_equals_the_reference() {
    let (Some(golden), Some(capture)) =
        (shared("golden/basketball_initial_render.json"), shared("data/panoptic_basketball"))
    else {
        return;
    };
    let golden: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(golden).unwrap()).unwrap();
    let capture = tcgs_capture::Capture::open(&capture).unwrap();
    let views = capture.views(tcgs_capture::Split::Train, 0, 1).unwrap();
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera.clone()).collect();
    let radius = f64::from(scene_radius(&cameras));
    assert!((radius / golden["scene_radius"].as_f64().unwrap() - 1.0).abs() < 1e-5);
    let parameters = Parameters::from_cloud(&capture.point_cloud().unwrap(), views.len(), 1.0);
    let scales = &parameters.gaussians.log_scales();
    let mean_scale = scales.iter().map(|s| f64::from(s[0].exp())).sum::<f64>() / scales.len() as f64;
    assert!((mean_scale / golden["mean_scale"].as_f64().unwrap() - 1.0).abs() < 1e-3);

    let drawn = tcgs_core::activate(&parameters.gaussians);
    for (view, expected) in views.iter().zip(golden["per_camera"].as_array().unwrap()) {
        let (output, _) = CpuRasterizer.forward(&drawn, &view.camera, &RenderSettings::default()).unwrap();
        let l1 = output.image.data.iter().zip(&view.image.data).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>()
            / output.image.data.len() as f64;
        // PSNR is compared relatively: another JPEG decoder moves the targets by 0.05 of 255 on average, and PSNR by
        // 0.007 dB.
        let found =
            [l1, tcgs_metrics::ssim(&output.image, &view.image), tcgs_metrics::psnr(&output.image, &view.image)];
        for (found, (key, relative)) in found.iter().zip([("l1", false), ("ssim", false), ("psnr_joint_clamped", true)])
        {
            let expected = expected[key].as_f64().unwrap();
            let scale = if relative { expected } else { 1.0 };
            assert!(
                (found - expected).abs() < 1e-3 * scale,
                "camera {} {key}: {found} against {expected}",
                view.camera_id
            );
        }
        // The rendered colours themselves do not depend on a decoder.
        for channel in 0..3 {
            let mean = output.image.plane(channel).iter().map(|&x| f64::from(x)).sum::<f64>()
                / output.image.num_pixels() as f64;
            let expected = expected["mean_rgb"][channel].as_f64().unwrap();
            assert!((mean - expected).abs() < 2e-5, "camera {} channel {channel}: {mean}", view.camera_id);
        }
    }
}

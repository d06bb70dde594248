//! Compared with the image loss of Dynamic 3D Gaussians, from vectors that other programs made.

use crate::skip;
use tcgs_core::Image;
use tcgs_interchange::NpzReader;
use tcgs_metrics::{psnr, psnr_per_channel, ssim, ssim_grad};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/golden/image_loss.npz");

struct Golden(NpzReader);

impl Golden {
    /// The vectors; `None` where this checkout has none and `REQUIRE_GOLDEN` does not ask for them.
    fn open() -> Option<Self> {
        if !std::path::Path::new(GOLDEN).exists() {
            skip(&format!("no {GOLDEN}"));
            return None;
        }
        Some(Self(NpzReader::open(GOLDEN.as_ref()).unwrap()))
    }

    fn scalar(&mut self, name: &str) -> f64 {
        self.0.array_of::<f64>(name).unwrap().values[0]
    }

    fn image(&mut self, name: &str) -> Image {
        let array = self.0.array_of::<f32>(name).unwrap();
        let [num_channels, height, width] = array.shape[..] else { panic!("{name} is {:?}", array.shape) };
        Image { width, height, num_channels, data: array.values }
    }
}

#[test]
fn values_match() {
    let Some(mut golden) = Golden::open() else { return };
    let (rendered, target) = (golden.image("rendered_chw"), golden.image("target_chw"));
    let ssim = ssim(&rendered, &target);
    assert!((ssim - golden.scalar("ssim")).abs() < 1e-6, "{ssim}");
    let joint = psnr(&rendered, &target);
    assert!((joint - golden.scalar("psnr_joint")).abs() < 1e-5, "{joint}");
    let per_channel = psnr_per_channel(&rendered, &target);
    assert!((per_channel - golden.scalar("psnr_per_channel_mean")).abs() < 1e-5, "{per_channel}");
}

#[test]
fn the_gradient_of_the_image_loss_matches() {
    let Some(mut golden) = Golden::open() else { return };
    let (rendered, target) = (golden.image("rendered_chw"), golden.image("target_chw"));
    let mut v_rendered = target.clone();
    let means = ssim_grad(&rendered, &target, &[-0.2 / 3.0; 3], &mut v_rendered);

    let num_values = rendered.data.len() as f32;
    let differences = rendered.data.iter().zip(&target.data).map(|(a, b)| a - b);
    let l1 = differences.clone().map(|d| f64::from(d.abs())).sum::<f64>() / f64::from(num_values);
    let loss = 0.8 * l1 + 0.2 * (1.0 - means.iter().sum::<f64>() / 3.0);
    assert!((loss - golden.scalar("loss")).abs() < 1e-6, "{loss}");

    v_rendered.data.iter_mut().zip(differences).for_each(|(v, d)| *v += 0.8 * d.signum() / num_values);
    let expected = golden.image("v_rendered_chw");
    let (mut error, mut norm) = (0.0, 0.0);
    for (found, expected) in v_rendered.data.iter().zip(&expected.data) {
        error += f64::from(found - expected).powi(2);
        norm += f64::from(*expected).powi(2);
    }
    let relative = (error / norm).sqrt();
    assert!(relative < 1e-5, "relative error {relative}");
}

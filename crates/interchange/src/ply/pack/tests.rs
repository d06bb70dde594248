use tcgs_core::Layout;

use super::*;
use crate::testing::{Bounds, assert_near, awkward, random};
use crate::{ReadSettings, read_ply};

fn written(gaussians: &Gaussians) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_compressed_ply_to(&mut bytes, gaussians).unwrap();
    bytes
}

fn again(gaussians: &Gaussians) -> Gaussians {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), written(gaussians)).unwrap();
    read_ply(file.path(), ReadSettings::default()).unwrap()
}

/// Half a step of a range of 2, as [`random`] gives them, with the bits of each axis.
const HALF_STEP: [f64; 3] = [1.0 / 2047.0, 1.0 / 1023.0, 1.0 / 2047.0];

const BOUNDS: Bounds = Bounds {
    mean: HALF_STEP,
    quat: SQRT_2 / 1023.0 / 2.0,
    log_scale: HALF_STEP,
    opacity: 0.5 / 255.0,
    color: 0.5 / 255.0,
    harmonic: 1.0 / 64.0,
};

#[test]
fn numbers_come_back_within_half_a_step() {
    for (num_gaussians, degree) in [(1, 0), (1, 3), (255, 1), (256, 2), (257, 3), (700, 0)] {
        let gaussians = random(num_gaussians, degree);
        assert_near(&again(&gaussians), &gaussians, &BOUNDS);
    }
}

#[test]
fn a_file_has_the_length_that_its_header_says() {
    for (degree, of_harmonics) in [0, 9, 24, 45].into_iter().enumerate() {
        let bytes = written(&random(257, degree));
        let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        assert_eq!(bytes.len(), end + 2 * 18 * 4 + 257 * (16 + of_harmonics));
    }
}

#[test]
fn a_range_of_one_value_is_exact() {
    let mut gaussians = Gaussians::zeros(300);
    gaussians.means_mut().fill([1e9, -7.25, 1e-9]);
    gaussians.log_scales_mut().fill([-3.3, 0.1, 2.0]);
    gaussians.colors_mut().fill([0.3, -2.0, 5.0]);
    let found = again(&gaussians);
    assert_eq!((found.means(), found.log_scales()), (gaussians.means(), gaussians.log_scales()));
    // Without harmonics a negative colour is black.
    assert!(found.colors().iter().all(|color| *color == [0.3, 0.0, 5.0]));
    assert!(found.quats().iter().all(|&[w, ..]| w > 0.99), "{:?}", found.quats()[0]);
}

#[test]
fn extreme_numbers_stay_finite() {
    let gaussians = awkward();
    let found = again(&gaussians);
    assert_eq!(found.num_gaussians(), gaussians.num_gaussians());
    let (low, high) = found
        .log_scales()
        .as_flattened()
        .iter()
        .fold((0.0, 0.0), |(low, high): (f32, f32), &s| (low.min(s), high.max(s)));
    assert_eq!((low, high), (-20.0, 20.0));
}

#[test]
fn each_byte_of_harmonics_is_nearest() {
    let value = |byte: u8| match byte {
        0 => -4.0,
        255 => 4.0,
        byte => 8.0 * ((f64::from(byte) + 0.5) / 256.0 - 0.5),
    };
    for i in -4200..=4200 {
        let x = f64::from(i) / 1000.0;
        let found = (value(coefficient(x as f32)) - x).abs();
        let nearest = (0..=255).map(|byte| (value(byte) - x).abs()).fold(f64::MAX, f64::min);
        assert!(found <= nearest + 1e-6, "{x}: {found}, expected {nearest}");
        assert!(x.abs() > 4.0 || found <= 3.0 / 128.0 + 1e-6, "{x}: {found}");
    }
}

#[test]
fn antialiased_gaussians_have_a_comment_and_equal_ones_equal_bytes() {
    let mut gaussians = random(10, 1);
    let plain = written(&gaussians);
    assert_eq!(plain, written(&gaussians));
    assert!(!again(&gaussians).layout().is_antialiased());
    gaussians = gaussians.extended(&Layout::with_harmonics(1).antialiased(true));
    assert!(again(&gaussians).layout().is_antialiased());
    assert_eq!(written(&gaussians).len(), plain.len() + "comment SplatRenderMode: mip\n".len());
    gaussians = gaussians.with_background([1, 20, 255]);
    assert_eq!(again(&gaussians).layout().background(), [1, 20, 255]);
}

use std::io::Read;

use flate2::read::GzDecoder;
use tcgs_core::Layout;

use super::*;
use crate::testing::{Bounds, assert_near, awkward, random};
use crate::{ReadSettings, TimestepFiles, read_gaussians};

fn written(gaussians: &Gaussians, axes: Axes, version: SpzVersion) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_spz_to(&mut bytes, gaussians, axes, version).unwrap();
    bytes
}

/// Writes and reads both versions, which hold the same numbers.
fn again(gaussians: &Gaussians, axes: Axes) -> Gaussians {
    let [read, other] = [SpzVersion::V3, SpzVersion::V4].map(|version| {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), written(gaussians, axes, version)).unwrap();
        let files = TimestepFiles::open(file.path(), ReadSettings::default()).unwrap();
        assert_eq!((files.axes(), files.notes()), (axes, vec![]));
        read_gaussians(file.path(), ReadSettings::default()).unwrap()
    });
    assert_eq!(read, other);
    read
}

/// Positions of [`random`] are below 1, so 16 bits are behind the point.
const BOUNDS: Bounds = Bounds {
    mean: [0.5 / 65536.0; 3],
    quat: 0.5 / 511.0 / SQRT_2,
    log_scale: [0.5 / 16.0; 3],
    opacity: 0.5 / 255.0,
    color: 0.5 / 255.0 / 0.15 * tcgs_core::HARMONIC_0,
    harmonic: 0.5 / 128.0,
};

#[test]
fn numbers_come_back_within_half_a_step_from_any_axes() {
    for (i, axes) in Axes::all().enumerate() {
        let gaussians = random([1, 257, 2, 1000, 3, 256, 255, 4][i], i % 4);
        assert_near(&again(&gaussians, axes), &gaussians, &BOUNDS);
    }
    // More than a window of gzip and a block of Zstandard in each array.
    let many = random(150_000, 0);
    assert_near(&again(&many, Axes::RUB), &many, &BOUNDS);
}

#[test]
fn arrays_without_noise_come_back() {
    // Zeros, runs and repeated rows, which an encoder treats in other ways than noise.
    for n in [1, 7, 3000, 100_000] {
        let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(1), n);
        gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
        assert_near(&again(&gaussians, Axes::RDF), &gaussians, &BOUNDS);
        let few = random(5, 1);
        let repeated = few.select(&(0..n).map(|i| i % 5).collect::<Vec<_>>());
        assert_near(&again(&repeated, Axes::RDF), &repeated, &BOUNDS);
    }
}

#[test]
fn fractional_bits_follow_the_largest_coordinate() {
    for (largest, bits) in [
        (0.0, Some(16)),
        (1e-9, Some(24)),
        (0.49, Some(17)),
        (1.0, Some(16)),
        (15.9, Some(12)),
        (100.0, Some(12)),
        (2047.9, Some(12)),
        (2048.0, Some(11)),
        (8_388_607.0, Some(0)),
        (8_388_608.0, None),
        (f32::MAX, None),
    ] {
        assert_eq!(fractional_bits(&[[0.0, -largest, 0.0]]), bits, "{largest}");
        let mut gaussians = random(3, 0);
        gaussians.means_mut()[1][2] = largest;
        if let Some(bits) = fractional_bits(gaussians.means()) {
            let bounds = Bounds { mean: [0.5 / f64::from(1_u32 << bits); 3], ..BOUNDS };
            assert_near(&again(&gaussians, Axes::RUB), &gaussians, &bounds);
        } else {
            let error = write_spz_to(Vec::new(), &gaussians, Axes::RUB, SpzVersion::V3).unwrap_err();
            assert_eq!(error.to_string(), "an SPZ file holds coordinates up to 8388607 units");
        }
    }
}

#[test]
fn extreme_numbers_become_the_ends_of_their_ranges() {
    let mut gaussians = awkward();
    gaussians.means_mut().fill([1.0, 2.0, 3.0]);
    let found = again(&gaussians, Axes::RDF);
    assert_eq!(found.log_scales()[0], [-10.0, 255.0 / 16.0 - 10.0, 0.0]);
    let [bright, dark, _] = found.colors()[0];
    assert!((bright - 1.4403).abs() < 1e-3 && (dark + 0.4403).abs() < 1e-3, "{bright} {dark}");
    assert_eq!(found.quats()[0], [1.0, 0.0, 0.0, 0.0]);
    for band in found.layout().harmonics() {
        assert_eq!(found.values(band)[..3], [127.0 / 128.0, -1.0, 0.0]);
    }
}

#[test]
fn flags_and_bytes_are_those_of_the_gaussians() {
    for is_antialiased in [false, true] {
        let layout = Layout::with_harmonics(2).antialiased(is_antialiased);
        let gaussians = random(20, 2).extended(&layout);
        assert_eq!(*again(&gaussians, Axes::RDF).layout(), layout);
        let [v3, v4] = [SpzVersion::V3, SpzVersion::V4].map(|version| {
            let bytes = written(&gaussians, Axes::RDF, version);
            assert_eq!(bytes, written(&gaussians, Axes::RDF, version));
            bytes
        });
        let mut plain = Vec::new();
        GzDecoder::new(&v3[..]).read_to_end(&mut plain).unwrap();
        let flags = 2 + u8::from(is_antialiased);
        for (plain, version, num_streams) in [(plain, 3, 0), (v4, 4, 6)] {
            assert_eq!(plain[..8], [b'N', b'G', b'S', b'P', version, 0, 0, 0]);
            assert_eq!(plain[12..16], [2, 16, flags, num_streams]);
        }
    }
    assert_eq!(written(&random(20, 0), Axes::RUB, SpzVersion::V4)[15], 5);
}

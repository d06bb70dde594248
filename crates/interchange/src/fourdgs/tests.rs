use std::path::{Path, PathBuf};

use ::fourdgs::{SceneExtras, WriteOptions};
use tcgs_core::{Gaussians, Layout, SceneReader, normalize, sigmoid};

use super::*;
use crate::{HigherHarmonics, ReadSettings};

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange").join(name)
}

fn open(path: &Path) -> Result<FourdgsFile, String> {
    FourdgsFile::open(path, ReadSettings::default()).map_err(|error| {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        message.strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned()
    })
}

/// The timesteps that `make_4dgs.py` writes.
fn expected(timestep: usize) -> Gaussians {
    let original = crate::read_ply(&file("original.ply"), ReadSettings::default()).unwrap();
    let rows: Vec<usize> = [0..40, 0..50, 10..45][timestep].clone().collect();
    let mut gaussians = original.select(&rows);
    gaussians.means_mut().iter_mut().for_each(|mean| mean[0] += 0.1 * timestep as f32);
    gaussians
}

/// Fails if values differ by more than the finest profile promises. That is 2 % of the median scale in positions and
/// 0.5 % in scales, half of 1/255 in colours and opacities, 0.0005 in a component of a rotation, half of their 8 bits
/// in harmonics.
fn compare(found: &Gaussians, expected: &Gaussians) {
    assert_eq!(found.num_gaussians(), expected.num_gaussians());
    let mut scales: Vec<f32> = expected.log_scales().as_flattened().iter().map(|s| s.exp()).collect();
    scales.sort_by(f32::total_cmp);
    // The median of this timestep need not be that of the scene.
    let position = 0.02 * 1.5 * scales[scales.len() / 2];
    // The writer sorts by place.
    for (i, mean) in found.means().iter().enumerate() {
        let distance = |j: &usize| -> f32 { (0..3).map(|c| (mean[c] - expected.means()[*j][c]).powi(2)).sum() };
        let j = (0..expected.num_gaussians()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        for c in 0..3 {
            assert!((mean[c] - expected.means()[j][c]).abs() <= position, "{mean:?} {:?}", expected.means()[j]);
            assert!((found.log_scales()[i][c] - expected.log_scales()[j][c]).abs() <= 1.005_f32.ln() + 1e-6);
            let color = expected.colors()[j][c];
            // The converter clamps colours, this writer does not.
            let error = (found.colors()[i][c] - color).abs().min((found.colors()[i][c] - color.clamp(0.0, 1.0)).abs());
            assert!(error <= 0.5 / 255.0 + 1e-6, "{color}: {error}");
        }
        let opacity = |gaussians: &Gaussians, i: usize| sigmoid(gaussians.logit_opacities()[i]);
        assert!((opacity(found, i) - opacity(expected, j)).abs() <= 0.5 / 255.0 + 1e-6);
        let (a, b) = (normalize(found.quats()[i]), normalize(expected.quats()[j]));
        let sign = (0..4).map(|c| a[c] * b[c]).sum::<f32>().signum();
        assert!((0..4).all(|c| (a[c] - sign * b[c]).abs() <= 2.0 * 3.0_f32.sqrt() * 0.0005), "{a:?} {b:?}");
        for band in found.layout().harmonics() {
            let row = |gaussians: &Gaussians, i: usize| {
                gaussians.values(band)[i * band.components()..][..band.components()].to_vec()
            };
            let (a, b) = (row(found, i), row(expected, j));
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 4.0 / 255.0 + 1e-6), "{a:?} {b:?}");
        }
    }
}

#[test]
fn both_models_of_the_package_are_read() {
    for (name, degree) in [("fourdgs_births.4dgs", 3), ("fourdgs_states.4dgs", 0)] {
        let read = open(&file(name)).unwrap();
        assert_eq!(
            (read.num_timesteps(), read.num_identities(), read.layout().sh_degree()),
            (3, None, degree),
            "{name}"
        );
        assert!((read.frame_rate() - 10.0).abs() < 1e-6);
        assert_eq!([0, 1, 2].map(|t| read.num_gaussians_at(t)), [40, 50, 35]);
        for timestep in 0..3 {
            compare(&read.at(timestep).unwrap(), &expected(timestep));
        }
        let dropped = FourdgsFile::open(&file(name), HigherHarmonics::Drop.into()).unwrap();
        assert!(dropped.layout().is_base() && dropped.at(1).unwrap().means() == read.at(1).unwrap().means());
    }
}

#[test]
fn harmonics_that_the_header_declares_may_be_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.4dgs");
    let whole = ::fourdgs::read_bytes(&std::fs::read(file("fourdgs_births.4dgs")).unwrap()).unwrap();
    // Colours that were rounded once may err by more than the writer allows.
    let options = WriteOptions { sh_bands: 2, verify: false, ..WriteOptions::default() };
    let written =
        ::fourdgs::write_to_vec(&whole.gaussians, whole.duration_sec, &options, &SceneExtras::default()).unwrap();
    assert_eq!(::fourdgs::read_bytes(&written).unwrap().header.sh_degree, 3);
    std::fs::write(&path, &written).unwrap();
    let (read, all) = (open(&path).unwrap(), open(&file("fourdgs_births.4dgs")).unwrap());
    assert_eq!(read.layout().sh_degree(), 2);
    let (a, b) = (read.at(1).unwrap(), all.at(1).unwrap());
    assert_eq!(a.num_gaussians(), 50);
    for band in read.layout().harmonics() {
        let sum = |gaussians: &Gaussians| gaussians.values(band).iter().map(|x| x.abs()).sum::<f32>();
        assert!(sum(&a) > 0.0 && (sum(&a) / sum(&b) - 1.0).abs() < 0.05, "{band:?}: {} {}", sum(&a), sum(&b));
    }
}

#[test]
fn what_is_written_is_read_again() {
    let bytes = |timesteps: &[Gaussians], rate: f64| {
        fourdgs_bytes(timesteps.iter().cloned().map(Ok::<_, String>), rate).unwrap().unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.4dgs");
    // Numbers change; the last two timesteps are the same, and so is one Gaussian of the first two.
    let mut first = expected(1);
    first.means_mut()[..49].iter_mut().for_each(|mean| mean[1] += 0.05);
    let scene = [first, expected(1), expected(2), expected(2)];
    let written = bytes(&scene, 24.0);
    assert_eq!(written, bytes(&scene, 24.0));
    std::fs::write(&path, &written).unwrap();
    let read = open(&path).unwrap();
    assert_eq!((read.num_timesteps(), read.layout().sh_degree()), (4, 3));
    assert!((read.frame_rate() - 24.0).abs() < 1e-3);
    for (timestep, gaussians) in scene.iter().enumerate() {
        compare(&read.at(timestep).unwrap(), gaussians);
    }
    assert_eq!(::fourdgs::read_bytes(&written).unwrap().header.attributes["coordinate_system"], "y-up-right-handed");
    // 49 of one timestep, one of two, 49 more of one, 35 of two.
    let whole = ::fourdgs::read_bytes(&written).unwrap();
    assert_eq!(whole.gaussians.count(), 49 + 1 + 49 + 35);

    let plain: Vec<Gaussians> = scene
        .iter()
        .map(|g| {
            let mut plain = Gaussians::zeros_of(&Layout::base(), g.num_gaussians());
            for attribute in Layout::base().attributes() {
                plain.values_mut(attribute).copy_from_slice(g.values(attribute));
            }
            plain
        })
        .collect();
    std::fs::write(&path, bytes(&plain, 30.0)).unwrap();
    assert!(open(&path).unwrap().layout().is_base());

    // Values in the middle between two steps are written too, at any distance from the origin.
    let mut middle = Gaussians::zeros(1000);
    for i in 0..1000 {
        middle.means_mut()[i] = [i as f32 * 0.02, 1000.0 + i as f32 * 1e-4, 0.0];
        middle.quats_mut()[i] = [1.0, 0.0, 0.0, 0.0];
        middle.log_scales_mut()[i] = [-4.0; 3];
        middle.colors_mut()[i] = [0.5, 0.1, i as f32 / 1000.0];
    }
    std::fs::write(&path, bytes(&[middle], 30.0)).unwrap();
    assert_eq!(open(&path).unwrap().num_gaussians_at(0), 1000);

    let mut infinite = expected(0);
    infinite.means_mut()[3][0] = f32::INFINITY;
    assert!(fourdgs_bytes([Ok::<_, String>(infinite)], 30.0).unwrap().is_err());
    assert_eq!(fourdgs_bytes([Err::<Gaussians, _>("unreadable")], 30.0), Err("unreadable"));
}

#[test]
fn at_its_time_a_reader_sees_the_timestep() {
    for rate in [10.0, 24.0, 25.0, 29.97, 30.0, 60.0] {
        let timesteps = (0..400).map(|timestep| {
            let mut gaussians = Gaussians::zeros(1);
            gaussians.means_mut()[0] = [timestep as f32, 1.0, 0.0];
            gaussians.quats_mut()[0] = [1.0, 0.0, 0.0, 0.0];
            Ok::<_, String>(gaussians)
        });
        let bytes = fourdgs_bytes(timesteps, rate).unwrap().unwrap();
        let scene = ::fourdgs::read_bytes(&bytes).unwrap();
        for timestep in 0..400 {
            let state = scene.state_at(f64::from(timestep) / rate).unwrap();
            // The axes of glTF: x to the left, y up.
            let [x, y, _] = state.centers[..] else { panic!("{} of one", state.centers.len()) };
            assert!((x + timestep as f32).abs() < 0.1 && (y + 1.0).abs() < 0.1, "{timestep} at {rate}: {x} {y}");
        }
    }
}

/// Bytes with a number at a place.
fn with_number(mut bytes: Vec<u8>, at: usize, number: u32) -> Vec<u8> {
    bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
    bytes
}

#[test]
fn constants_of_few_bytes_that_stand_for_many_are_refused() {
    let mut gaussians = Gaussians::zeros(2);
    gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
    let mut bytes = fourdgs_bytes([Ok::<_, String>(gaussians)], 30.0).unwrap().unwrap();
    let chunk = ::fourdgs::serialization::Records::new(&bytes, 8).map(Result::unwrap).find(|r| r.opcode == 5).unwrap();
    // The chunk's own count, then that of each stream.
    let content = chunk.offset + 9;
    let mut counts = vec![content + 20];
    let end = content + chunk.content.len();
    let mut at = content + 44;
    while at < end {
        assert_eq!(bytes[at + 2], 2, "a stream of equal values is a constant");
        counts.push(at + 5);
        at += 17 + u64::from_le_bytes(bytes[at + 9..at + 17].try_into().unwrap()) as usize;
    }
    for at in counts {
        bytes = with_number(bytes, at, 3_000_000);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.4dgs");
    std::fs::write(&path, &bytes).unwrap();
    let message = open(&path).unwrap_err();
    assert!(message.starts_with("needs ") && message.contains(" bytes of memory, limit is "), "{message}");
}

#[test]
fn numbers_of_gaussians_are_those_of_the_timesteps_for_any_window() {
    let bytes = std::fs::read(file("fourdgs_births.4dgs")).unwrap();
    let windows = ::fourdgs::serialization::Records::new(&bytes, 8).map(Result::unwrap).find(|r| r.opcode == 4);
    // A header of 9 bytes and the number of windows stand before the first window.
    let first = windows.unwrap().offset + 13;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.4dgs");
    let mut changed = 0;
    for border in [first, first + 8] {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 0.15] {
            let mut bytes = bytes.clone();
            bytes[border..border + 8].copy_from_slice(&value.to_le_bytes());
            std::fs::write(&path, bytes).unwrap();
            let Ok(read) = open(&path) else { continue };
            for timestep in 0..read.num_timesteps() {
                let Ok(gaussians) = read.at(timestep) else { continue };
                let number = gaussians.num_gaussians();
                assert_eq!(number, read.num_gaussians_at(timestep), "{value} at {border}, timestep {timestep}");
                changed += usize::from(number != expected(timestep.min(2)).num_gaussians());
            }
        }
    }
    assert!(changed > 5, "{changed}");
}

#[test]
fn what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.4dgs");
    for name in ["fourdgs_births.4dgs", "fourdgs_states.4dgs"] {
        let bytes = std::fs::read(file(name)).unwrap();
        for length in [0, 7, 8, 9, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let message = open(&path).unwrap_err();
            assert!(message.ends_with("expected a whole .4dgs file"), "{name}, {length}: {message}");
        }
    }
    std::fs::write(&path, "ply\n").unwrap();
    assert!(open(&path).unwrap_err().ends_with("expected a whole .4dgs file"));
    assert!(open(&folder.path().join("none.4dgs")).unwrap_err().starts_with("reading failed"));
}

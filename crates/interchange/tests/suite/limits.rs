//! Limits of readers: every kind of file is refused under tight limits, and read under the usual limits and without
//! any.

use std::fs;
use std::path::Path;

use tcgs_core::{DynamicGaussians, Gaussians, SceneReader};
use tcgs_interchange::{
    FourdgsFile, InterchangeError, NpzReader, NpzWriter, ParamsExtras, ParamsNpz, ReadLimits, ReadSettings,
    TimestepFiles, fourdgs_bytes, read_gaussians, read_ply_points, write_params_npz,
};

use super::{ONE_TIMESTEP, SCENES, file};

/// Less than any reader holds.
const TIGHT: ReadLimits = ReadLimits { base_bytes: 100, expansion: 0, max_timesteps: 2 };

fn with(limits: ReadLimits) -> ReadSettings {
    ReadSettings { limits, ..ReadSettings::default() }
}

/// Asserts that a reader refuses a file under [`TIGHT`], and reads it under the default and without limits.
fn is_bounded<T>(path: &Path, read: impl Fn(&Path, ReadLimits) -> Result<T, InterchangeError>) {
    let refused = read(path, TIGHT).err().unwrap();
    assert!(matches!(refused, InterchangeError::Limit { .. }), "{refused}");
    let message = refused.to_string();
    assert!(message.contains(": needs ") && message.contains("limit is "), "{message}");
    for limits in [ReadLimits::default(), ReadLimits::NONE] {
        assert!(read(path, limits).is_ok(), "{}", path.display());
    }
}

#[test]
fn every_reader_keeps_to_its_limits() {
    for name in ONE_TIMESTEP {
        is_bounded(&file(name), |path, limits| read_gaussians(path, with(limits)));
        // A folder's files are refused when it is opened, before any is read.
        is_bounded(&file(name), |path, limits| TimestepFiles::open(path, with(limits)));
    }
    for name in SCENES {
        is_bounded(&file(name), |path, limits| FourdgsFile::open(path, with(limits)));
        // Three timesteps.
        let few = ReadLimits { max_timesteps: 2, ..ReadLimits::default() };
        let message = FourdgsFile::open(&file(name), with(few)).unwrap_err().to_string();
        assert!(message.ends_with(": needs 3 timesteps, limit is 2"), "{message}");
    }
    is_bounded(&file("original.ply"), read_ply_points);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    let mut scene = DynamicGaussians::default();
    (0..3).for_each(|_| scene.push(Gaussians::zeros(50)));
    write_params_npz(&path, &scene, &ParamsExtras::default()).unwrap();
    is_bounded(&path, ParamsNpz::open);
    is_bounded(&path, NpzReader::open_with);
    let few = ReadLimits { max_timesteps: 2, ..ReadLimits::default() };
    let message = ParamsNpz::open(&path, few).unwrap_err().to_string();
    assert!(message.ends_with(": needs 3 timesteps, limit is 2"), "{message}");
}

#[test]
fn copies_of_an_array_count() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let mut npz = NpzWriter::new(fs::File::create(&path).unwrap());
    npz.array("a", &[100], [&[0.0_f32; 100][..]]).unwrap();
    npz.finish().unwrap();
    // 400 bytes of values, and 128 of the header in the archive.
    let limits = ReadLimits { base_bytes: 1000, expansion: 0, ..ReadLimits::default() };
    let mut npz = NpzReader::open_with(&path, limits).unwrap();
    npz.check_copies("a", 2).unwrap();
    let message = npz.check_copies("a", 3).unwrap_err().to_string();
    assert!(message.ends_with(": needs 1200 bytes of memory, limit is 1000"), "{message}");
}

/// Numbers are counted without the states; they must agree with the states.
#[test]
fn gaussians_of_each_time_are_counted_as_they_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.4dgs");
    for rate in [10.0, 24.0, 30.0, 29.97] {
        let timesteps = (0..40_usize).map(|t| {
            let mut gaussians = Gaussians::zeros(3 + t % 7);
            gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
            // Some stay as they are for a while.
            gaussians.means_mut().iter_mut().enumerate().for_each(|(i, mean)| mean[0] = (i + t / (1 + i)) as f32);
            Ok::<_, String>(gaussians)
        });
        fs::write(&path, fourdgs_bytes(timesteps, rate).unwrap().unwrap()).unwrap();
        let mut read = FourdgsFile::open(&path, ReadSettings::default()).unwrap();
        for t in 0..read.num_timesteps() {
            assert_eq!(read.num_gaussians_at(t), 3 + t % 7);
            assert_eq!(SceneReader::at(&mut read, t).unwrap().num_gaussians(), 3 + t % 7);
        }
    }
    // Windows and fading of the package.
    let mut read = FourdgsFile::open(&file("fourdgs_births.4dgs"), ReadSettings::default()).unwrap();
    for t in 0..read.num_timesteps() {
        let expected = read.num_gaussians_at(t);
        assert_eq!(SceneReader::at(&mut read, t).unwrap().num_gaussians(), expected);
    }
}

#[cfg(unix)]
#[test]
fn devices_and_pipes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.ply", "a.spz", "a.glb", "a.sog", "a.ksplat", "meta.json", "a.4dgs", "a.npz", "a.npy"] {
        let path = folder.path().join(name);
        std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
        let refusals = [
            read_gaussians(&path, ReadSettings::default()).err(),
            FourdgsFile::open(&path, ReadSettings::default()).err(),
            NpzReader::open(&path).err(),
            read_ply_points(&path, ReadLimits::default()).err(),
            tcgs_interchange::read_npy(&path).err(),
        ];
        for refusal in refusals {
            let message = refusal.unwrap().to_string();
            assert!(message.ends_with("is a device or a pipe, expected a file"), "{message}");
        }
    }
}

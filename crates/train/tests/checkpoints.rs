//! Checkpoints as files: those of earlier versions stay readable, damaged ones are refused.

#![allow(clippy::unwrap_used)] // helpers of tests are not counted as tests

use std::fs;
use std::path::{Path, PathBuf};

use tcgs_interchange::NpzReader;
use tcgs_train::{Checkpoint, Run, TrainError};

/// A run that the first version of checkpoints wrote; see its README.md.
const OLD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../testdata/run");

fn old(timestep: usize) -> PathBuf {
    Path::new(OLD).join(format!("checkpoints/{timestep:06}.npz"))
}

fn load(path: &Path, first: Option<&Checkpoint>) -> Result<Checkpoint, TrainError> {
    Checkpoint::load(path, first, true)
}

#[test]
fn a_run_of_the_first_version_is_read() {
    let run = Run::open(OLD.as_ref()).unwrap();
    let trained = run.trained().unwrap();
    assert_eq!((trained.scene.num_timesteps(), trained.scene.num_gaussians()), (2, 18));
    assert!(run.resume().unwrap().is_some());
    let (bit_map, _) = trained.quantization.unwrap();
    assert!(bit_map.widths.iter().all(|widths| widths.len() == 18));
    // As Python's struct module reads them from the file.
    let mut first = NpzReader::open(&old(0)).unwrap();
    assert_eq!(first.array_of::<f32>("means").unwrap().values[..2], [-2.673_492_7, -1.256_459_5]);
    assert_eq!(first.array_of::<u64>("steps").unwrap().shape, [6]);
}

#[test]
fn a_checkpoint_of_the_first_version_is_written_anew_with_the_same_values() {
    let folder = tempfile::tempdir().unwrap();
    let first = load(&old(0), None).unwrap();
    for timestep in [0, 1] {
        let of = if timestep == 0 { None } else { Some(&first) };
        let checkpoint = load(&old(timestep), of).unwrap();
        let (path, again) = (folder.path().join("a.npz"), folder.path().join("b.npz"));
        checkpoint.save(&path, timestep == 0).unwrap();
        checkpoint.save(&again, timestep == 0).unwrap();
        assert_eq!(fs::read(&path).unwrap(), fs::read(&again).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "something unfinished was left behind");
        assert!(load(&path, of).unwrap() == checkpoint);
        let (mut before, mut after) = (NpzReader::open(&old(timestep)).unwrap(), NpzReader::open(&path).unwrap());
        let names: Vec<String> = before.array_names().collect();
        assert!(after.array_names().eq(names.iter().cloned()), "other arrays, or in another order");
        for name in &names {
            match name.as_str() {
                "steps" => assert_eq!(before.array_of::<u64>(name).unwrap(), after.array_of::<u64>(name).unwrap()),
                "foreground" | "quantizer_groups" | "bit_widths" => {
                    assert_eq!(before.array_of::<u8>(name).unwrap(), after.array_of::<u8>(name).unwrap());
                }
                _ => {
                    let [before, after] = [&mut before, &mut after].map(|npz| npz.array_of::<f32>(name).unwrap());
                    assert_eq!(before.shape, after.shape, "{name}");
                    assert!(before.values.iter().map(|x| x.to_bits()).eq(after.values.iter().map(|x| x.to_bits())));
                }
            }
        }
    }
}

#[test]
fn damaged_checkpoints_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("000000.npz");
    let whole = fs::read(old(0)).unwrap();
    let expected = load(&old(0), None).unwrap();
    for length in (0..whole.len()).step_by(53) {
        fs::write(&path, &whole[..length]).unwrap();
        let error = load(&path, None).unwrap_err();
        assert!(matches!(error, TrainError::File { .. }), "{length} bytes: {error}");
        let error = error.to_string();
        assert!(error.contains("000000.npz: not a checkpoint") && error.lines().count() == 1, "{error}");
    }
    for at in (0..whole.len()).step_by(7) {
        let mut damaged = whole.clone();
        damaged[at] ^= 1 << (at % 8);
        fs::write(&path, &damaged).unwrap();
        match load(&path, None) {
            // A bit that says nothing about the arrays, such as one of a date.
            Ok(found) => assert!(found == expected, "a flip at {at} changes values unnoticed"),
            Err(error) => assert!(matches!(error, TrainError::File { .. }), "{at}: {error}"),
        }
    }
}

//! Scenes are read one timestep at a time, and no timestep is read without need.

use std::fs;
use std::path::Path;

use crate::support::{files, open};
use tcgs_codec::{CompressSettings, DecodeLimits, inspect};
use tcgs_core::SceneReader;
use tcgs_interchange::{ParamsExtras, write_params_npz};
use tcgs_pipeline::{CompressOptions, OpenScene, Unobserved, compare, compress_scene};

/// A copy of the run, to be spoilt.
fn copy_of_run(to: &Path) {
    fs::create_dir(to.join("checkpoints")).unwrap();
    for name in ["config.toml", "checkpoints/000000.npz", "checkpoints/000001.npz", "checkpoints/000002.npz"] {
        fs::copy(files().join("run").join(name), to.join(name)).unwrap();
    }
}

#[test]
fn a_timestep_of_a_run_is_read_without_those_after_it() {
    let folder = tempfile::tempdir().unwrap();
    copy_of_run(folder.path());
    fs::write(folder.path().join("checkpoints/000002.npz"), b"spoilt").unwrap();
    let (whole, spoilt) = (open(&files().join("run")), open(folder.path()));
    for timestep in [0, 1] {
        assert_eq!(spoilt.at(timestep).unwrap(), whole.at(timestep).unwrap());
        spoilt.drawn(timestep).unwrap();
    }
    assert!(spoilt.at(2).unwrap_err().to_string().contains("000002.npz"));
    assert!(spoilt.floats().is_err());
    // One timestep after another is the same as all together.
    let floats = whole.floats().unwrap();
    assert_eq!(whole.bytes, floats.raw_bytes());
    assert!((0..3).all(|t| whole.at(t).unwrap() == floats.at(t)));
}

#[test]
fn a_segment_of_a_file_is_decoded_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.tcgs");
    let keypoints = CompressSettings { segment_length: Some(1), ..CompressSettings::default() };
    let options = CompressOptions { keypoints, ..CompressOptions::default() };
    let compressed = compress_scene(&open(&files().join("run")), &options).unwrap();
    let mut file = compressed.file;
    let segments = inspect(&file, &DecodeLimits::default()).unwrap().cohorts[0].segments.clone();
    assert_eq!(segments.len(), 3);
    file[(segments[1].1.start + segments[1].1.end) as usize / 2] ^= 1;
    fs::write(&path, &file).unwrap();
    let mut scene: OpenScene = open(&path);
    for timestep in [0, 2] {
        assert_eq!(scene.at(timestep).unwrap(), compressed.compact.at(timestep));
        assert_eq!(scene.span(timestep), timestep..timestep + 1);
    }
    assert!(SceneReader::at(&mut scene, 1).unwrap_err().to_string().contains("scene.tcgs"));
}

#[test]
fn floats_compress_to_the_same_bytes_from_memory_and_from_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    let run = open(&files().join("run"));
    let params = folder.path().join("params.npz");
    write_params_npz(&params, &run.floats().unwrap(), &ParamsExtras::default()).unwrap();
    let params = open(&params);
    assert_eq!((params.bytes, params.layout()), (run.bytes, run.layout()));
    assert!((0..3).all(|t| params.at(t).unwrap() == run.at(t).unwrap()));
    let bits = Some((4, 8));
    for (scene, bits, version) in [(&run, None, 1), (&run, bits, 2), (&params, None, 2), (&params, bits, 1)] {
        let options =
            |max_float_bytes| CompressOptions { max_float_bytes, bits, version, ..CompressOptions::default() };
        let (memory, disk) = (options(u64::MAX), options(0));
        let (memory, disk) = (compress_scene(scene, &memory).unwrap(), compress_scene(scene, &disk).unwrap());
        assert!(memory.file == disk.file, "{}, bits {bits:?}", scene.kind());
        assert_eq!((&memory.compact, memory.stages), (&disk.compact, disk.stages));
        // Version 2 declares errors, and those of the disk are the same.
        assert_eq!(disk.compact.declared_errors.len(), if version == 1 { 0 } else { 5 });
        let file = scene.with_symbols(disk.compact);
        assert_eq!(compare(&file, scene, &mut Unobserved).unwrap().holds(), version == 2);
    }
}

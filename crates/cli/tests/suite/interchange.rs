//! Files of other programs (`testdata/interchange`): compressed, drawn, measured and written as glTF.

use std::fs;
use std::path::PathBuf;

use crate::support::*;
use tcgs_core::SceneReader;
use tcgs_interchange::{FourdgsFile, ReadSettings, TimestepFiles, read_gaussians};
use tempfile::tempdir;

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange").join(name)
}

#[test]
fn a_folder_of_several_kinds_becomes_a_file_and_glb_files() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("source")).unwrap();
    let kinds = ["original.ply", "splat_transform_v3.spz", "splat_transform.compressed.ply", "splat_transform_v4.spz"];
    for (i, name) in kinds.into_iter().enumerate() {
        // Endings do not say what a file is.
        fs::copy(file(name), path("source").join(format!("00000{i}.ply"))).unwrap();
    }
    let said = succeed(&["compress", text(&path("source")), "--bits", "8,8", "--out", text(&path("scene.tcgs"))]);
    assert!(said.contains("(Gaussian files): 260 Gaussians with harmonics of degree 3, 4 timesteps"), "{said}");
    succeed(&["render", text(&path("source")), "--out", text(&path("frames")), "--size", "64x48"]);
    assert_eq!(fs::read_dir(path("frames")).unwrap().count(), 4);
    succeed(&["eval", text(&path("source")), "--capture", text(capture())]);

    // Out as glTF, in again.
    for scene in ["source", "scene.tcgs"] {
        let glbs = path(&format!("{scene}.glbs"));
        // A name with an ending is that of a file, unless it is a folder's.
        fs::create_dir(&glbs).unwrap();
        succeed(&["export", text(&path(scene)), "--to", text(&glbs), "--files", "glb", "--frames", "1..4"]);
        let files = TimestepFiles::open(&glbs, ReadSettings::default()).unwrap();
        assert_eq!((files.kind(), files.num_timesteps(), files.first_frame()), ("glTF files", 3, Some(1)));
        assert_eq!((files.num_gaussians(), files.layout().sh_degree()), (260, 3));
    }
    let (one, source) = (path("one.glb"), path("source"));
    let arguments = ["export", text(&source), "--frames", "1..2", "--to", text(&one)];
    succeed(&arguments);
    let (found, expected) = (
        read_gaussians(&one, ReadSettings::default()).unwrap(),
        read_gaussians(&file("splat_transform_v3.spz"), ReadSettings::default()).unwrap(),
    );
    assert_eq!(found.means(), expected.means());
    let again = fs::read(&one).unwrap();
    succeed(&[&arguments[..], &["--force"]].concat());
    assert_eq!(fs::read(&one).unwrap(), again);
    let message = fail(2, &["export", text(&path("source")), "--to", text(&path("many.glb"))]);
    assert!(message.contains("many.glb: a file for 4 timesteps, expected --frames 0..1"), "{message}");
}

#[test]
fn one_file_is_a_scene_of_one_timestep() {
    let folder = tempdir().unwrap();
    for (name, kind) in [
        ("splat_transform.glb", "glTF files"),
        ("splat_transform_v4.spz", "SPZ files"),
        ("splat_transform.compressed.ply", "PLY files"),
    ] {
        let out = folder.path().join(name).with_extension("tcgs");
        let said = succeed(&["compress", text(&file(name)), "--bits", "6,6", "--out", text(&out)]);
        assert!(said.contains(kind) && said.contains("1 timesteps"), "{said}");
        succeed(&["info", text(&out)]);
    }
}

#[test]
fn what_cannot_be_read_is_one_line() {
    let folder = tempdir().unwrap();
    let bytes = fs::read(file("splat_transform_v4.spz")).unwrap();
    let cut = folder.path().join("cut.spz");
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let out = folder.path().join("cut.tcgs");
    let message = fail(2, &["compress", text(&cut), "--out", text(&out)]);
    assert!(message.contains("cut.spz: ends early, expected a whole SPZ file"), "{message}");
    let other = folder.path().join("other.glb");
    fs::write(&other, "not glTF").unwrap();
    let message = fail(2, &["export", text(&other), "--to", text(&out.with_extension("ply"))]);
    assert!(message.contains("other.glb: is none of PLY, SPZ and glTF, expected one of these"), "{message}");
    let message = fail(2, &["compress", text(&file("spz_degree_4.spz")), "--out", text(&out)]);
    assert!(message.contains("has spherical harmonics of degree 4, expected 0 to 3"), "{message}");
    assert!(!out.exists());
}

#[test]
fn scenes_over_time_go_to_4dgs_and_back() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (name, number) in [
        ("fourdgs_births.4dgs", "35 to 50 Gaussians with harmonics of degree 3"),
        ("fourdgs_states.4dgs", "35 to 50 Gaussians"),
    ] {
        let (scene, back, result) = (path(name).with_extension("tcgs"), path(name), path("result.json"));
        let said = succeed(&["compress", text(&file(name)), "--bits", "8,8", "--out", text(&scene)]);
        assert!(said.contains(&format!("(.4dgs file): {number}, 3 timesteps")), "{said}");
        succeed(&["info", text(&scene), "--json", text(&result), "--force"]);
        assert!((json(&result)["frame_rate"].as_f64().unwrap() - 10.0).abs() < 1e-3);
        succeed(&["render", text(&file(name)), "--out", text(&path(&format!("{name}.frames"))), "--size", "64x48"]);

        succeed(&["export", text(&scene), "--to", text(&back)]);
        let read = FourdgsFile::open(&back, ReadSettings::default()).unwrap();
        assert_eq!([0, 1, 2].map(|t| read.num_gaussians_at(t)), [40, 50, 35], "{name}");
        assert!((read.frame_rate() - 10.0).abs() < 1e-3);
        let message = fail(2, &["export", text(&scene), "--to", text(&back)]);
        assert!(message.contains("exists already"), "{message}");
    }
    let cut = path("cut.4dgs");
    let bytes = fs::read(file("fourdgs_births.4dgs")).unwrap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let message = fail(2, &["compress", text(&cut)]);
    assert!(message.contains("cut.4dgs: ends early, expected a whole .4dgs file"), "{message}");
    assert!(!path("cut.tcgs").exists());
}

//! Files of other programs (`testdata/interchange`): compressed, drawn, measured and written as glTF.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::*;
use tcgs_core::{Gaussians, SceneReader};
use tcgs_interchange::{FourdgsFile, ReadSettings, TimestepFiles, read_gaussians, write_ply_to};
use tempfile::tempdir;

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange").join(name)
}

#[test]
fn a_folder_of_several_kinds_becomes_a_file_and_glb_files() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("source")).unwrap();
    let kinds = ["original.ply", "gsply_v3.spz", "splat_transform.compressed.ply", "splat_transform_37_v4.spz"];
    for (i, name) in kinds.into_iter().enumerate() {
        // A file's format does not depend on its ending.
        fs::copy(file(name), path("source").join(format!("00000{i}.ply"))).unwrap();
    }
    let said = succeed(&["compress", text(&path("source")), "--bits", "8,8", "--out", text(&path("scene.tcgs"))]);
    assert!(said.contains("(Gaussian files): 260 Gaussians with harmonics of degree 3, 4 timesteps"), "{said}");
    succeed(&["render", text(&path("source")), "--out", text(&path("frames")), "--size", "64x48"]);
    assert_eq!(fs::read_dir(path("frames")).unwrap().count(), 4);
    succeed(&["eval", text(&path("source")), "--capture", text(capture())]);

    // Exported as glTF and read again.
    for scene in ["source", "scene.tcgs"] {
        let glbs = path(&format!("{scene}.glbs"));
        // A name with an ending is that of a file, unless a folder has the name.
        fs::create_dir(&glbs).unwrap();
        succeed(&["export", text(&path(scene)), "--to", text(&glbs), "--files", "glb", "--frames", "1..4"]);
        let files = TimestepFiles::open(&glbs, ReadSettings::default()).unwrap();
        assert_eq!((files.kind(), files.num_timesteps(), files.first_frame()), ("glTF files", 3, Some(1)));
        assert_eq!((files.num_identities(), files.layout().sh_degree()), (Some(260), 3));
    }
    let (one, source) = (path("one.glb"), path("source"));
    let arguments = ["export", text(&source), "--frames", "1..2", "--to", text(&one)];
    succeed(&arguments);
    let (found, expected) = (
        read_gaussians(&one, ReadSettings::default()).unwrap(),
        read_gaussians(&file("gsply_v3.spz"), ReadSettings::default()).unwrap(),
    );
    assert_eq!(found.means(), expected.means());
    let again = fs::read(&one).unwrap();
    succeed(&[&arguments[..], &["--force"]].concat());
    assert_eq!(fs::read(&one).unwrap(), again);
    let message = fail(2, &["export", text(&path("source")), "--to", text(&path("many.glb"))]);
    assert!(message.contains("many.glb: a file for 4 timesteps, expected --frames 0..1"), "{message}");
}

#[test]
fn a_scene_becomes_files_of_every_kind_and_is_read_again() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("source")).unwrap();
    for i in 0..3 {
        let name = ["original.ply", "splat_transform_37_v4.spz", "gsply_v3.spz"][i];
        fs::copy(file(name), path("source").join(format!("{i}.ply"))).unwrap();
    }
    for (files, ending, kind) in [
        ("ply", ".ply", "PLY files"),
        ("compressed-ply", ".compressed.ply", "PLY files"),
        ("spz", ".spz", "SPZ files"),
        ("glb", ".glb", "glTF files"),
        ("sog", ".sog", "SOG files"),
    ] {
        let (out, one, source) = (path(files), path(&format!("one{ending}")), path("source"));
        succeed(&["export", text(&source), "--to", text(&out), "--files", files]);
        let read = TimestepFiles::open(&out, ReadSettings::default()).unwrap();
        assert_eq!((read.kind(), read.num_timesteps(), read.first_frame()), (kind, 3, Some(0)), "{files}");
        // The same Gaussians in the same order, which the reader checks by their positions.
        let scene = read.read(0..3).unwrap();
        assert_eq!((scene.num_gaussians(), scene.layout().sh_degree()), (260, 3));
        succeed(&["export", text(&source), "--to", text(&one), "--frames", "0..1"]);
        assert_eq!(fs::read(&one).unwrap(), fs::read(out.join(format!("000000{ending}"))).unwrap());
        succeed(&["export", text(&source), "--to", text(&out), "--files", files, "--force"]);
    }
    let [v3, v4] = [path("spz"), path("spz4")];
    succeed(&["export", text(&path("source")), "--to", text(&v4), "--files", "spz", "--spz-version", "4"]);
    let [v3, v4] = [v3, v4].map(|spz| {
        (fs::read(spz.join("000000.spz")).unwrap(), TimestepFiles::open(&spz, ReadSettings::default()).unwrap())
    });
    assert!(v3.0.starts_with(&[0x1F, 0x8B]) && v4.0.starts_with(b"NGSP\x04"));
    assert_eq!(v3.1.read(0..3).unwrap(), v4.1.read(0..3).unwrap());
    let one = path("one4.spz");
    succeed(&["export", text(&path("source")), "--to", text(&one), "--frames", "0..1", "--spz-version", "4"]);
    assert_eq!(fs::read(&one).unwrap(), v4.0);
    for other in ["plys", "a.glb", "page.html"] {
        let message = fail(2, &["export", text(&path("source")), "--to", text(&path(other)), "--spz-version", "4"]);
        let expected = "--spz-version of a file that is no SPZ, expected --to NAME.spz, or --files spz and a folder";
        assert!(message.contains(expected), "{message}");
    }
    let message = fail(2, &["export", text(&path("source")), "--to", text(&path("a.splat"))]);
    assert!(message.contains("NAME.compressed.ply, NAME.spz, NAME.glb, NAME.sog, NAME/meta.json"), "{message}");
}

#[test]
fn an_unpacked_sog_is_written_and_read() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (table, packed, original) = (path("unpacked/meta.json"), path("a.sog"), file("original.ply"));
    let arguments = ["export", text(&original), "--to", text(&table)];
    succeed(&arguments);
    succeed(&["export", text(&original), "--to", text(&packed)]);
    let read = |path: &Path| read_gaussians(path, ReadSettings::default()).unwrap();
    assert_eq!(read(&table), read(&packed));
    for scene in [path("unpacked"), table.clone()] {
        let (out, result) = (path("out.tcgs"), path("out.json"));
        let said = succeed(&["compress", text(&scene), "--bits", "6,6", "--out", text(&out), "--force"]);
        assert!(said.contains("(SOG files): 260 Gaussians"), "{said}");
        succeed(&["info", text(&scene), "--json", text(&result), "--force"]);
        let files = fs::read_dir(path("unpacked")).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len());
        assert_eq!(json(&result)["bytes"], files.sum::<u64>());
    }
    // Only files of an unpacked SOG are replaced, and none that is read.
    assert!(fail(2, &arguments).contains("exists already"));
    succeed(&[&arguments[..], &["--force"]].concat());
    let message = fail(2, &["export", text(&table), "--to", text(&table), "--force"]);
    assert!(message.contains("which this command reads"), "{message}");
    fs::write(path("unpacked/notes.txt"), "precious").unwrap();
    let message = fail(2, &[&arguments[..], &["--force"]].concat());
    assert!(message.contains("notes.txt: not written by this command"), "{message}");
    // It holds one frame.
    let births = file("fourdgs_births.4dgs");
    let message = fail(2, &["export", text(&births), "--to", text(&path("many/meta.json"))]);
    assert!(message.contains("meta.json: a file for 3 timesteps, expected --frames 0..1") && !path("many").exists());
}

#[test]
fn one_file_is_a_scene_of_one_timestep() {
    let folder = tempdir().unwrap();
    for (name, kind) in [
        ("splat_transform.glb", "glTF files"),
        ("splat_transform_v4.spz", "SPZ files"),
        ("splat_transform.compressed.ply", "PLY files"),
        ("splat_transform_37.sog", "SOG files"),
        ("gaussian_splats_3d_1.ksplat", ".ksplat files"),
    ] {
        let out = folder.path().join(name).with_extension("tcgs");
        let said = succeed(&["compress", text(&file(name)), "--bits", "6,6", "--out", text(&out)]);
        assert!(said.contains(kind) && said.contains("1 timesteps"), "{said}");
        succeed(&["info", text(&out)]);
    }
}

/// The lines that a command prints on standard error; it succeeds.
fn remarks(arguments: &[&str]) -> Vec<String> {
    let output = run(arguments);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8(output.stderr).unwrap();
    said.lines().filter(|line| line.starts_with("note: ")).map(Into::into).collect()
}

#[test]
fn assumed_axes_are_told_and_an_option_sets_others() {
    let folder = tempdir().unwrap();
    let back = |name: &str| folder.path().join(name);
    let export = |source: &str, axes: &[&str], out: &str| {
        let (source, out) = (file(source), back(out));
        let said = remarks(&[&["export", text(&source), "--to", text(&out)][..], axes].concat());
        (said, read_gaussians(&out, ReadSettings::default()).unwrap())
    };
    let original = read_gaussians(&file("original.ply"), ReadSettings::default()).unwrap();
    let is_near = |found: &Gaussians| {
        let pairs = found.means().as_flattened().iter().zip(original.means().as_flattened());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1e-3
    };
    let (said, found) = export("gsply_v3.spz", &[], "a.ply");
    let path = file("gsply_v3.spz");
    let expected =
        format!("note: {}: axes assumed rdf, as PLY files have; --axes rub if it is upside down", path.display());
    assert_eq!(said, [expected]);
    assert!(is_near(&found));
    // Axes declared by the file, or given as an option.
    let (said, found) = export("niantic_rub.spz", &[], "b.ply");
    assert!(said.is_empty() && is_near(&found));
    let (said, found) = export("splat_transform_v3.spz", &["--axes", "RUB"], "c.ply");
    assert!(said.is_empty() && is_near(&found));
    for (name, axes) in [("original.ply", "luf"), ("splat_transform.glb", "rdf")] {
        let (_, turned) = export(name, &["--axes", axes], &format!("{axes}.ply"));
        assert!(turned.means().iter().zip(original.means()).all(|(a, b)| *a == [-b[0], -b[1], b[2]]), "{name}");
    }
    let (births, out) = (file("fourdgs_births.4dgs"), back("births"));
    for axes in ["rdf", "rub"] {
        succeed(&["export", text(&births), "--axes", axes, "--to", text(&out), "--force"]);
        let first = read_gaussians(&out.join("000000.ply"), ReadSettings::default()).unwrap();
        let sign = if axes == "rdf" { 1.0 } else { -1.0 };
        let y = first.means()[0][1] * sign;
        assert!(original.means()[..40].iter().any(|mean| (mean[1] - y).abs() < 1e-2), "{axes}: {y}");
    }
    let message = fail(2, &["export", text(&path), "--axes", "up", "--to", text(&back("d.ply"))]);
    assert!(message.contains("\"up\" is no set of axes, expected three letters such as rdf, rub or luf"), "{message}");
}

#[test]
fn replaced_numbers_are_told_in_one_line() {
    let folder = tempdir().unwrap();
    let (source, out) = (folder.path().join("source"), folder.path().join("scene.tcgs"));
    fs::create_dir(&source).unwrap();
    for timestep in 0..3 {
        let mut gaussians = read_gaussians(&file("original.ply"), ReadSettings::default()).unwrap();
        gaussians.logit_opacities_mut()[..2].copy_from_slice(&[f32::INFINITY, f32::NEG_INFINITY]);
        gaussians.log_scales_mut()[9][2] = f32::NEG_INFINITY;
        write_ply_to(fs::File::create(source.join(format!("{timestep}.ply"))).unwrap(), &gaussians).unwrap();
    }
    let counts = "infinite numbers were replaced by finite ones: opacities 6, scales 3, in 3 timesteps";
    let expected = [format!("note: {}: {counts}", source.display())];
    assert_eq!(remarks(&["compress", text(&source), "--bits", "8,8", "--out", text(&out)]), expected);
    assert_eq!(remarks(&["verify", text(&out), text(&source)]), expected);
    let (frames, glbs) = (folder.path().join("frames"), folder.path().join("glbs"));
    assert_eq!(remarks(&["render", text(&source), "--out", text(&frames), "--size", "64x48"]), expected);
    assert_eq!(remarks(&["eval", text(&source), "--capture", text(capture())]), expected);
    let one = ["export", text(&source), "--files", "glb", "--to", text(&glbs), "--frames", "1..2"];
    assert_eq!(remarks(&one)[0].split(": ").last(), Some("opacities 2, scales 1"));
}

#[test]
fn antialiasing_goes_to_ply_files_and_back() {
    let folder = tempdir().unwrap();
    let [marked, out, back] = ["marked.ply", "scene.tcgs", "back.ply"].map(|name| folder.path().join(name));
    let bytes = fs::read(file("original.ply")).unwrap();
    fs::write(&marked, [&bytes[..4], b"comment antialiased 1\n", &bytes[4..]].concat()).unwrap();
    let said = succeed(&["compress", text(&marked), "--bits", "8,8", "--out", text(&out)]);
    assert!(said.contains("of degree 3, antialiased, 1 timesteps"), "{said}");
    succeed(&["export", text(&out), "--to", text(&back)]);
    assert!(
        fs::read(&back).unwrap().starts_with(b"ply\nformat binary_little_endian 1.0\ncomment SplatRenderMode: mip\n")
    );
    assert!(read_gaussians(&back, ReadSettings::default()).unwrap().layout().is_antialiased());
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
    assert!(message.contains("other.glb: is none of PLY, SPZ, glTF and SOG, expected one of these"), "{message}");
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

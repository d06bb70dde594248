//! Sequences of other programs: PLY files with spherical harmonics, and with a different number of Gaussians in every
//! file.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::*;
use tcgs_core::{Gaussians, Layout};
use tcgs_interchange::{ReadSettings, read_ply, write_ply_to};
use tempfile::tempdir;

/// Some Gaussians on a turning sphere around the origin, in view of the test capture.
fn sphere(timestep: usize, num_gaussians: usize) -> Gaussians {
    let mut gaussians = Gaussians::zeros(num_gaussians);
    for i in 0..num_gaussians {
        let height = (i as f32 + 0.5) * 2.0 / num_gaussians as f32 - 1.0;
        let (sin, cos) = (2.4 * i as f32 + 0.05 * timestep as f32).sin_cos();
        let ring = (1.0 - height * height).sqrt();
        gaussians.means_mut()[i] = [ring * cos, height, ring * sin];
        gaussians.quats_mut()[i] = [1.0, 0.3 * cos, 0.0, 0.2];
        gaussians.colors_mut()[i] = [0.5 + 0.4 * cos, 0.5 + 0.4 * height, 0.3];
        gaussians.log_scales_mut()[i] = [-2.1, -2.3, -2.5];
        gaussians.logit_opacities_mut()[i] = 2.0;
    }
    gaussians
}

/// The same Gaussians with harmonics of degree 3, all coefficients different.
fn with_harmonics(gaussians: Gaussians) -> Gaussians {
    let mut gaussians = gaussians.extended(&Layout::with_harmonics(3));
    for (l, band) in gaussians.layout().harmonics().into_iter().enumerate() {
        for (i, value) in gaussians.values_mut(band).iter_mut().enumerate() {
            *value = 0.2 * (0.7 * i as f32 + l as f32).sin();
        }
    }
    gaussians
}

fn write(folder: &Path, scene: &[Gaussians]) -> PathBuf {
    fs::create_dir(folder).unwrap();
    for (timestep, gaussians) in scene.iter().enumerate() {
        write_ply_to(fs::File::create(folder.join(format!("{timestep:06}.ply"))).unwrap(), gaussians).unwrap();
    }
    folder.into()
}

/// Names and contents of a folder's files.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let mut files: Vec<_> =
        entries.map(|e| (e.file_name().into_string().unwrap(), fs::read(e.path()).unwrap())).collect();
    files.sort();
    files
}

/// Renders a scene and returns its pictures.
fn pictures(scene: &Path, out: &Path, more: &[&str]) -> Vec<(String, Vec<u8>)> {
    let arguments = ["render", text(scene), "--out", text(out), "--size", "64x48", "--backend", "cpu"];
    succeed(&[&arguments[..], more].concat());
    contents(out)
}

#[test]
fn harmonics_are_drawn_measured_and_written() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let plain: Vec<Gaussians> = (0..3).map(|t| sphere(t, 200)).collect();
    let scene: Vec<Gaussians> = plain.iter().cloned().map(with_harmonics).collect();
    let (plain, plys) = (write(&path("plain"), &plain), write(&path("plys"), &scene));

    // The pictures differ only by the harmonics.
    let drawn = pictures(&plys, &path("drawn"), &[]);
    let dropped = pictures(&plys, &path("dropped"), &["--drop-sh"]);
    assert_eq!((drawn.len(), &dropped), (3, &pictures(&plain, &path("without"), &[])));
    assert!(drawn.iter().zip(&dropped).all(|(a, b)| a.0 == b.0 && a.1 != b.1));

    let eval = |scene: &Path, more: &[&str]| {
        let result = path("eval.json");
        let arguments = ["eval", text(scene), "--capture", text(capture()), "--json", text(&result), "--force"];
        succeed(&[&arguments[..], more].concat());
        json(&result)
    };
    let result = eval(&plys, &[]);
    assert_eq!((&result["num_gaussians"], &result["num_timesteps"]), (&200.into(), &3.into()));
    assert_eq!(result["bytes"], 200 * (40 * 3 + 16 + 180));
    assert_ne!(result["psnr"], eval(&plys, &["--drop-sh"])["psnr"]);

    // Every bit of a coefficient survives export and import.
    let said = succeed(&["export", text(&plys), "--to", text(&path("back"))]);
    assert!(said.contains("200 Gaussians with harmonics of degree 3, 3 timesteps"), "{said}");
    for (t, gaussians) in scene.iter().enumerate() {
        let back = read_ply(&path("back").join(format!("{t:06}.ply")), ReadSettings::default()).unwrap();
        for band in gaussians.layout().harmonics() {
            assert_eq!(back.values(band), gaussians.values(band));
        }
        assert_eq!(back.means(), gaussians.means());
    }
    assert_eq!(pictures(&path("back"), &path("again"), &[]), drawn);
    succeed(&["export", text(&plys), "--to", text(&path("scene.f32"))]);
    let floats: Vec<u8> = scene
        .iter()
        .flat_map(|g| g.layout().attributes().flat_map(|a| g.values(a).to_vec()).collect::<Vec<_>>())
        .flat_map(f32::to_le_bytes)
        .collect();
    let written = fs::read(path("scene.f32")).unwrap();
    // A colour may differ in its last bits.
    let value = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    assert_eq!(written.len(), floats.len());
    assert!(written.chunks(4).zip(floats.chunks(4)).all(|(a, b)| (value(a) - value(b)).abs() < 1e-7));

    // A format without harmonics refuses them in a message.
    let message = fail(2, &["export", text(&plys), "--to", text(&path("params.npz"))]);
    assert!(message.contains("the column sh1, which a params.npz cannot hold"), "{message}");
    succeed(&["export", text(&plys), "--drop-sh", "--to", text(&path("params.npz"))]);
    let message = fail(2, &["compress", text(&plys), "--bits", "6,6", "--format", "1"]);
    assert!(message.contains("found sh1; --format 2 holds it, and --drop-sh leaves"), "{message}");
    let (file, result) = (path("shining.tcgs"), path("compress.json"));
    let arguments = ["compress", text(&plys), "--target-psnr", "45", "--out", text(&file), "--json", text(&result)];
    succeed(&arguments);
    let raw = 200 * 3 * (14 + 45) * 4;
    let bytes = fs::metadata(&file).unwrap().len();
    assert!(4 * bytes < raw, "{bytes} of {raw}");
    assert!(json(&result)["target"]["psnr"].as_f64().unwrap() >= 45.0);
    assert_eq!(pictures(&file, &path("shining"), &[]).len(), drawn.len());
    let said = succeed(&["compress", text(&plys), "--bits", "6,6", "--drop-sh"]);
    assert!(said.contains("200 Gaussians, 3 timesteps"), "{said}");
    let start = format!("{}@0", plys.display());
    let message = fail(
        2,
        &["train", text(capture()), "--out", text(&path("run")), "--start-from", &start, "--iterations", "2,2"],
    );
    assert!(message.contains("has spherical harmonics"), "{message}");
}

#[test]
fn the_number_of_gaussians_may_change_in_every_file() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let numbers = [150, 201, 90, 200];
    let scene: Vec<Gaussians> = numbers.iter().enumerate().map(|(t, &n)| with_harmonics(sphere(t, n))).collect();
    let plys = write(&path("plys"), &scene);

    // Each frame is drawn as if it were the only one.
    let drawn = pictures(&plys, &path("drawn"), &[]);
    assert_eq!(drawn.len(), 4);
    let of_capture = |scene: &Path, out: &Path, frames: &str| {
        succeed(&["render", text(scene), "--out", text(out), "--cameras", text(capture()), "--frames", frames]);
        let camera = fs::read_dir(out).unwrap().next().unwrap().unwrap().path();
        contents(&camera)
    };
    let all = of_capture(&plys, &path("all"), "0..4");
    for (t, name) in ["000000.ply", "000001.ply", "000002.ply", "000003.ply"].into_iter().enumerate() {
        let frames = format!("{t}..{}", t + 1);
        assert_eq!(of_capture(&plys.join(name), &path(name), &frames)[0], all[t], "{name}");
    }

    let result = path("eval.json");
    let said = succeed(&["eval", text(&plys), "--capture", text(capture()), "--json", text(&result)]);
    assert!(said.contains("90 to 201 Gaussians with harmonics of degree 3, 4 timesteps"), "{said}");
    let result = json(&result);
    assert_eq!((&result["num_gaussians"], result["images"].as_array().unwrap().len()), (&201.into(), 4));
    assert_eq!(result["bytes"], (150 + 201 + 90 + 200) * (14 + 45) * 4);

    succeed(&["export", text(&plys), "--to", text(&path("back")), "--frames", "1..4"]);
    assert_eq!(contents(&path("back")).len(), 3);
    for t in 1..4 {
        let back = read_ply(&path("back").join(format!("{t:06}.ply")), ReadSettings::default()).unwrap();
        assert_eq!((back.means(), back.quats()), (scene[t].means(), scene[t].quats()));
        for band in back.layout().harmonics() {
            assert_eq!(back.values(band), scene[t].values(band));
        }
    }
    succeed(&["export", text(&plys), "--to", text(&path("scene.f32"))]);
    assert_eq!(fs::metadata(path("scene.f32")).unwrap().len(), (150 + 201 + 90 + 200) * (14 + 45) * 4);

    let (file, result) = (path("scene.tcgs"), path("compress.json"));
    let arguments = ["compress", text(&plys), "--target-psnr", "45", "--out", text(&file), "--json", text(&result)];
    succeed(&arguments);
    let (bytes, raw) = (fs::metadata(&file).unwrap().len(), (150 + 201 + 90 + 200) * (14 + 45) * 4);
    assert!(4 * bytes < raw, "{bytes} of {raw}");
    assert!(json(&result)["target"]["psnr"].as_f64().unwrap() >= 45.0);
    let said = succeed(&["info", text(&file)]);
    assert!(said.contains("frames 0 to"), "{said}");
    succeed(&["export", text(&file), "--to", text(&path("decoded"))]);
    let decoded = path("decoded").join("000002.ply");
    assert_eq!(read_ply(&decoded, ReadSettings::default()).unwrap().num_gaussians(), 90);
    let message = fail(2, &["export", text(&plys), "--drop-sh", "--to", text(&path("params.npz"))]);
    let expected = "has 150 Gaussians at frame 0 and 201 at frame 1, which a params.npz cannot hold";
    assert!(message.contains(expected), "{message}");
    succeed(&["export", text(&plys), "--drop-sh", "--frames", "2..3", "--to", text(&path("params.npz"))]);
}

#[test]
fn what_is_not_of_one_scene_is_named() {
    let folder = tempdir().unwrap();
    let plys = write(&folder.path().join("plys"), &[with_harmonics(sphere(0, 20)), sphere(1, 20)]);
    let out = folder.path().join("frames");
    let render = ["render", text(&plys), "--out", text(&out)];
    let message = fail(2, &render);
    let expected = "000001.ply: has spherical harmonics of degree 0, expected spherical harmonics of degree 3 as in ";
    assert!(message.contains(expected), "{message}");
    // A tenth coefficient belongs to no degree.
    let first = plys.join("000000.ply");
    let bytes = fs::read(&first).unwrap();
    let at = bytes.windows(30).position(|w| w.starts_with(b"property float f_rest_44\n")).unwrap();
    fs::write(&first, [&bytes[..at], b"property float other_44\n", &bytes[at + 25..]].concat()).unwrap();
    let message = fail(2, &render);
    assert!(message.contains("000000.ply: has 44 properties f_rest, expected 0, 9, 24 or 45"), "{message}");
    assert!(!out.exists());
}

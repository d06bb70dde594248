//! Declared errors of files: written, shown, bounded, and verified against the compressed scene.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::*;
use serde_json::Value;
use tcgs_codec::{CompactFile, DecodeLimits};
use tcgs_core::{Gaussians, Layout};
use tcgs_interchange::write_ply_to;
use tempfile::{TempDir, tempdir};

/// A pseudo-random number in [0, 1).
fn random(i: usize) -> f32 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((z ^ z >> 27) >> 40) as f32 / (1 << 24) as f32
}

/// Some Gaussians of a synthetic scene, which stand or move, and have harmonics or not.
fn made(ids: impl IntoIterator<Item = usize>, timestep: usize, degree: usize) -> Gaussians {
    let layout = Layout::with_harmonics(degree);
    let one = |id: usize| {
        let mut one = Gaussians::zeros_of(&layout, 1);
        let r = |i: usize| random(id * 64 + i) - 0.5;
        let wave = if id.is_multiple_of(3) { 0.05 * (0.5 * timestep as f32 + id as f32).sin() } else { 0.0 };
        one.means_mut()[0] = [2.0 * r(0) + wave, 2.0 * r(1), 2.0 * r(2) - wave];
        one.quats_mut()[0] = [1.0, r(3) + wave, r(4), r(5)];
        one.log_scales_mut()[0] = [-3.0 + r(6), -3.0 + r(7), -3.0 + r(8)];
        one.logit_opacities_mut()[0] = 4.0 * r(9);
        one.colors_mut()[0] = [0.5 + 0.8 * r(10), 0.5 + 0.8 * r(11), 0.5 + 0.8 * r(12) + wave];
        for band in layout.harmonics() {
            let shine = if id.is_multiple_of(4) { 0.3 } else { 1e-3 };
            for (i, x) in one.values_mut(band).iter_mut().enumerate() {
                *x = shine * (random(id * 1000 + band.index() * 64 + i) - 0.5);
            }
        }
        one
    };
    Gaussians::concat(&layout, &ids.into_iter().map(one).collect::<Vec<_>>())
}

fn write(folder: &Path, scene: &[Gaussians]) -> PathBuf {
    fs::create_dir(folder).unwrap();
    for (timestep, gaussians) in scene.iter().enumerate() {
        write_ply_to(fs::File::create(folder.join(format!("{timestep:06}.ply"))).unwrap(), gaussians).unwrap();
    }
    folder.into()
}

/// PLY files of a scene with a constant number of Gaussians.
fn constant(folder: &TempDir, num_timesteps: usize, degree: usize) -> PathBuf {
    let scene: Vec<Gaussians> = (0..num_timesteps).map(|t| made(0..200, t, degree)).collect();
    write(&folder.path().join("constant"), &scene)
}

/// Compresses; returns the output and the result.
fn compress(source: &Path, out: &Path, more: &[&str]) -> (String, Value) {
    let result = out.with_extension("json");
    let arguments = ["compress", text(source), "--out", text(out), "--json", text(&result), "--force"];
    let said = succeed(&[&arguments[..], more].concat());
    (said, json(&result))
}

/// Verifies a file that must pass; returns the output and the result.
fn verify(file: &Path, sources: &[&Path]) -> (String, Value) {
    let result = file.with_extension("verify.json");
    let mut arguments = vec!["verify", text(file)];
    arguments.extend(sources.iter().map(|source| text(source)));
    arguments.extend(["--json", text(&result), "--force"]);
    (succeed(&arguments), json(&result))
}

/// The same file with changed content.
fn forge(file: &Path, name: &str, change: impl FnOnce(&mut CompactFile)) -> PathBuf {
    let mut compact = CompactFile::decode(&fs::read(file).unwrap(), &DecodeLimits::default()).unwrap();
    change(&mut compact);
    let forged = file.with_file_name(name);
    fs::write(&forged, compact.encode(2, &[]).unwrap()).unwrap();
    forged
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}, expected a number"))
}

/// Asserts that each measured error equals the declared one up to rounding.
fn assert_tight(result: &Value) {
    for (name, error) in result["errors"].as_object().unwrap() {
        let (declared, found) = (number(&error["declared"]), number(&error["found"]));
        assert!(found <= declared && declared <= found * 1.000_01 + 2e-12, "{name}: {found} of {declared}");
    }
}

#[test]
fn a_scene_with_harmonics_is_as_its_file_declares() {
    let folder = tempdir().unwrap();
    let (plys, file) = (constant(&folder, 6, 2), folder.path().join("scene.tcgs"));
    let (said, result) = compress(&plys, &file, &[]);
    let names = ["means", "quats", "log_scales", "logit_opacities", "colors", "sh1", "sh2"];
    assert_keys(&result["declared_errors"], &names);
    assert!(!said.contains("largest error"), "it frightens where it was not asked for: {said}");
    let said = succeed(&["info", text(&file), "--json", text(&folder.path().join("info.json"))]);
    assert!(said.contains("\nattribute        largest error\nmean  ") && said.contains("radians"), "{said}");
    assert_eq!(json(&folder.path().join("info.json"))["declared_errors"], result["declared_errors"]);

    let (said, alone) = verify(&file, &[]);
    assert!(said.starts_with(&format!("{}: whole, 200 Gaussians, 6 timesteps, ", text(&file))), "{said}");
    assert_eq!(alone["declared_errors"], result["declared_errors"]);
    assert!(alone.get("errors").is_none());
    let (said, compared) = verify(&file, &[&plys]);
    assert!(said.ends_with("all Gaussians of the source are in the file\nwithin the declared errors\n"), "{said}");
    assert_tight(&compared);
    assert_eq!(
        (&compared["holds"], &compared["num_compared"], &compared["num_beyond"]),
        (&true.into(), &1200.into(), &0.into())
    );

    // A file can be the source, too, and has no error against itself.
    let (_, compared) = verify(&file, &[&file]);
    assert!(compared["errors"].as_object().unwrap().values().all(|error| number(&error["found"]) == 0.0));
}

#[test]
fn gaussians_that_come_go_and_change_their_order_are_found() {
    let folder = tempdir().unwrap();
    let ids = |t: usize| (0..150 + 10 * t).rev().filter(move |id| id % 11 != t).collect::<Vec<_>>();
    let scene: Vec<Gaussians> = (0..5).map(|t| made(ids(t), t, 1)).collect();
    let (plys, file) = (write(&folder.path().join("plys"), &scene), folder.path().join("scene.tcgs"));
    compress(&plys, &file, &[]);
    let (_, compared) = verify(&file, &[&plys]);
    assert_tight(&compared);
    let count: usize = scene.iter().map(Gaussians::num_gaussians).sum();
    assert_eq!((&compared["num_compared"], &compared["num_pruned"]), (&count.into(), &serde_json::json!([0, 0])));

    // The file has more Gaussians than a source. A Gaussian without a partner in the source is an error; one missing
    // from the file is not.
    let fewer: Vec<Gaussians> = (0..5).map(|t| made(ids(t).into_iter().skip(2), t, 1)).collect();
    let fewer = write(&folder.path().join("fewer"), &fewer);
    let message = fail(1, &["verify", text(&file), text(&fewer)]);
    assert!(message.contains(&format!("10 of {count} Gaussians of all timesteps are none of the source")), "{message}");
    let more: Vec<Gaussians> = (0..5).map(|t| made(ids(t).into_iter().chain(500..507 + t), t, 1)).collect();
    let more = write(&folder.path().join("more"), &more);
    let (said, _) = verify(&file, &[&more]);
    assert!(said.contains("\n7 to 11 Gaussians of the source were pruned at a timestep\n"), "{said}");
}

#[test]
fn a_run_is_verified_with_what_its_masks_prune() {
    let folder = tempdir().unwrap();
    // Version 1 has no antialiasing.
    let masked = ["--set", "mask.enabled=true", "--set", "weights.mask=0.05", "--set", "render.antialiased=false"];
    let (run, file) = (train(&folder, "run", &masked), folder.path().join("scene.tcgs"));
    let (_, result) = compress(&run, &file, &["--prune", "0.02"]);
    let (before, after) = (number(&result["num_gaussians_before"]), number(&result["num_gaussians"]));
    let (_, compared) = verify(&file, &[&run]);
    assert_tight(&compared);
    assert_eq!(
        compared["num_pruned"],
        serde_json::json!([before as usize - after as usize, before as usize - after as usize])
    );

    // A file of version 1 declares no errors, and is reported as such.
    compress(&run, &file, &["--format", "1"]);
    let (said, alone) = verify(&file, &[]);
    assert!(said.ends_with("declares no errors\n") && alone["declared_errors"] == serde_json::json!({}), "{said}");
    let message = fail(1, &["verify", text(&file), text(&run)]);
    assert!(
        message.contains("declares no error of mean, rotation, scale, opacity, color, expected a file"),
        "{message}"
    );
}

#[test]
fn what_is_forged_or_damaged_is_caught() {
    let folder = tempdir().unwrap();
    let (plys, file) = (constant(&folder, 4, 1), folder.path().join("scene.tcgs"));
    compress(&plys, &file, &[]);

    for place in 0..6 {
        let forged = forge(&file, "forged.tcgs", |compact| compact.declared_errors[place].1 *= 0.9);
        let result = forged.with_extension("json");
        let message = fail(1, &["verify", text(&forged), text(&plys), "--json", text(&result), "--force"]);
        let word = ["mean", "rotation", "scale", "opacity", "color", "sh1"][place];
        assert!(
            message.contains("are none of the source within the declared errors (") && message.contains(word),
            "{message}"
        );
        let result = json(&result);
        let name = ["means", "quats", "log_scales", "logit_opacities", "colors", "sh1"][place];
        let error = &result["errors"][name];
        assert!(number(&error["found"]) > number(&error["declared"]) && result["holds"] == false, "{result}");
        verify(&forged, &[]);
    }
    let forged = forge(&file, "silent.tcgs", |compact| drop(compact.declared_errors.remove(1)));
    let message = fail(1, &["verify", text(&forged), text(&plys)]);
    assert!(message.contains("declares no error of rotation, expected"), "{message}");
    // A Gaussian has moved, and the declared errors do not cover it.
    let forged = forge(&file, "moved.tcgs", |compact| {
        let cohort = &mut compact.cohorts[0];
        cohort.quantizers.attributes[0].values_mut().for_each(|channels| channels[1].offset += 0.2);
    });
    let message = fail(1, &["verify", text(&forged), text(&plys)]);
    assert!(message.contains("within the declared errors (mean"), "{message}");

    let mut bytes = fs::read(&file).unwrap();
    let damaged = folder.path().join("damaged.tcgs");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(&damaged, &bytes).unwrap();
    for more in [&[][..], &[text(&plys)]] {
        let message = fail(2, &[&["verify", text(&damaged)], more].concat());
        assert!(
            message.contains("damaged.tcgs: invalid ") && message.ends_with("expected a whole .tcgs file"),
            "{message}"
        );
    }
    bytes.truncate(middle);
    fs::write(&damaged, &bytes).unwrap();
    fail(2, &["verify", text(&damaged)]);
}

#[test]
fn another_scene_is_refused() {
    let folder = tempdir().unwrap();
    let (plys, file) = (constant(&folder, 4, 1), folder.path().join("scene.tcgs"));
    compress(&plys, &file, &[]);
    let short = write(&folder.path().join("short"), &[made(0..200, 0, 1)]);
    let message = fail(2, &["verify", text(&file), text(&short)]);
    assert!(message.contains("short: has 1 timesteps, expected 4 as "), "{message}");
    let message = fail(2, &["verify", text(&file), text(&plys), "--drop-sh"]);
    assert!(message.contains("constant: has the columns means[3] quats[4] "), "{message}");
    fail(2, &["verify", text(&plys)]);
    fail(2, &["verify", text(&folder.path().join("nowhere.tcgs"))]);
}

#[test]
fn errors_are_kept_within_bounds() {
    let folder = tempdir().unwrap();
    let (plys, file) = (constant(&folder, 6, 1), folder.path().join("scene.tcgs"));
    let bounds = "mean=0.0005,rotation=0.002,scale=0.002,opacity=0.001,color=0.002,sh1=0.004";
    let (said, result) = compress(&plys, &file, &["--max-error", bounds]);
    let wanted = result["max_error"]["wanted"].as_object().unwrap();
    assert_eq!(wanted.len(), 6);
    for (name, wanted) in wanted {
        assert!(number(&result["declared_errors"][name]) <= number(wanted), "{name}: {result}");
    }
    let steps = result["max_error"]["steps"].as_array().unwrap().len();
    assert!(said.contains("\nattribute        largest error\nmean  "), "{said}");
    assert!((2..=6).contains(&steps) && said.contains(&format!("within the bounds; {steps} settings tried")), "{said}");
    assert_tight(&verify(&file, &[&plys]).1);

    // Bounds that are already met change nothing.
    let plain = folder.path().join("plain.tcgs");
    let (_, result) = compress(&plys, &plain, &[]);
    let (_, loose) = compress(&plys, &file, &["--max-error", "mean=0.5"]);
    assert_eq!(loose["declared_errors"], result["declared_errors"]);
    assert!(fs::read(&plain).unwrap() == fs::read(&file).unwrap());
    // A scene that fits into version 1 is written in version 2.
    let base = write(&folder.path().join("base"), &[made(0..50, 0, 0), made(0..50, 1, 0)]);
    compress(&base, &file, &["--max-error", "color=0.003"]);
    assert!(number(&verify(&file, &[&base]).1["declared_errors"]["colors"]) <= 0.003);
}

#[test]
fn bounds_out_of_reach_are_named_with_what_was_reached() {
    let folder = tempdir().unwrap();
    let (plys, file) = (constant(&folder, 3, 0), folder.path().join("scene.tcgs"));
    let refuse = |code, more: &[&str]| {
        let message = fail(code, &[&["compress", text(&plys), "--out", text(&file)], more].concat());
        assert!(!file.exists());
        message
    };
    let message = refuse(2, &["--max-error", "color=0.01,mean=1e-9"]);
    assert!(message.contains("--max-error mean=0.000000001: the smallest error that is found is "), "{message}");
    let smallest: f64 = message.split_whitespace().find_map(|word| word.trim_end_matches(',').parse().ok()).unwrap();
    assert!(smallest > 1e-6 && smallest < 1e-3, "{message}");
    let message = refuse(2, &["--max-error", "sh1=0.1"]);
    assert!(message.contains("sh1: no attribute of the scene, expected one of means, "), "{message}");
    let message = refuse(2, &["--max-error", "mean=0.1", "--format", "1"]);
    assert!(message.contains("--format 1: declares no errors, expected --format 2"), "{message}");
    for wrong in [&["mean=0.1", "--bits", "4,8"], &["mean=0.1", "--target-bytes", "9k"]] {
        assert!(refuse(2, &[&["--max-error"], &wrong[..]].concat()).contains("cannot be used with"));
    }
    assert!(refuse(2, &["--max-error", "means"]).contains("expected ATTRIBUTE=ERROR"));
    // The named error can be reached.
    compress(&plys, &file, &["--max-error", &format!("mean={smallest}")]);
}

//! `params.npz` of Dynamic 3D Gaussians: foreground marks, and refusals of scenes that it cannot hold.

use std::fs;
use std::path::Path;

use crate::support::*;
use tcgs_interchange::{ParamsExtras, ReadLimits, read_params_foreground, read_params_npz, write_params_npz};
use tempfile::tempdir;

/// Exports a scene and counts its foreground and background Gaussians.
///
/// - returns: the counts, and standard error
fn exported(scene: &Path, params: &Path) -> ([usize; 2], String) {
    let output = run(&["export", text(scene), "--to", text(params), "--force"]);
    let remarks = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{remarks}");
    let foreground = read_params_foreground(params, ReadLimits::default()).unwrap().unwrap();
    ([true, false].map(|wanted| foreground.iter().filter(|&&found| found == wanted).count()), remarks)
}

#[test]
fn the_foreground_survives_compression() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let trained = train(&folder, "run", &[]);
    let of_run = exported(&trained, &path("of_run.npz")).0;
    // A scene with its own foreground marks.
    let (params, scene) = (path("params.npz"), read_params_npz(&path("of_run.npz")).unwrap());
    let foreground: Vec<bool> = (0..scene.num_gaussians()).map(|i| i % 3 == 0).collect();
    let extras = ParamsExtras { foreground: Some(&foreground), ..ParamsExtras::default() };
    write_params_npz(&params, &scene, &extras).unwrap();
    let (of_params, remarks) = exported(&params, &path("again.npz"));
    assert!(of_params.iter().all(|&count| count > 5) && !remarks.contains("marked"), "{of_params:?} {remarks}");
    assert_eq!(read_params_foreground(&path("again.npz"), ReadLimits::default()).unwrap(), Some(foreground));

    let (plain, kept) = (path("plain.tcgs"), path("kept.tcgs"));
    for (source, expected) in [(&trained, of_run), (&params, of_params)] {
        let compress = ["compress", text(source), "--bits", "6,6", "--refine", "off", "--force", "--out"];
        succeed(&[&compress[..], &[text(&plain)]].concat());
        succeed(&[&compress[..], &[text(&kept), "--keep-foreground"]].concat());
        assert_eq!(exported(&kept, &path("back.npz")).0, expected);
        let labels: serde_json::Value =
            serde_json::from_str(&succeed(&["info", text(&kept), "--data", "tcgs.labels"])).unwrap();
        assert_eq!(labels["objects"], serde_json::json!(["foreground"]));
        assert!(fs::metadata(&plain).unwrap().len() < fs::metadata(&kept).unwrap().len());

        let (counts, remarks) = exported(&plain, &path("back.npz"));
        assert_eq!(counts, [expected[0] + expected[1], 0]);
        assert!(remarks.contains("no Gaussian is marked as background"), "{remarks}");
    }

    // A scene without marks gets a line that says so.
    succeed(&["export", text(&trained), "--to", text(&path("plys"))]);
    let output = run(&["compress", text(&path("plys")), "--bits", "6,6", "--keep-foreground"]);
    let remarks = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && remarks.contains("so the file gets no marks"), "{remarks}");
    let labels = path("labels.json");
    fs::write(&labels, r#"{ "objects": [], "runs": [] }"#).unwrap();
    let attach = format!("labels={}", labels.display());
    let arguments = ["compress", text(&trained), "--keep-foreground", "--attach", &attach];
    let message = fail(2, &arguments);
    assert!(message.contains("tcgs.labels: attached, and marks that are kept, expected one of the two"), "{message}");
}

#[test]
fn a_run_with_births_is_refused_with_what_holds_it() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // With removal, so short a training has no births.
    let trained = train(&folder, "run", &["--set", "births.enabled=true", "--set", "densify.prune_error=0"]);
    let message = fail(2, &["export", text(&trained), "--to", text(&path("params.npz"))]);
    assert!(
        message.contains("which a params.npz cannot hold, expected a folder of PLY or .glb files or a .4dgs file"),
        "{message}"
    );
    let frames = message.split("or the frames ").nth(1).and_then(|rest| rest.strip_suffix(" alone")).unwrap();
    succeed(&["export", text(&trained), "--to", text(&path("params.npz")), "--frames", frames]);
    succeed(&["export", text(&trained), "--to", text(&path("scene.4dgs"))]);
    succeed(&["export", text(&trained), "--to", text(&path("glbs")), "--files", "glb"]);
}

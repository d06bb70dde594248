//! Gaussians that no training camera sees are left out of a file, and die when they are no longer seen.

use crate::support::{files, open};
use tcgs_core::{BaseColumns, DynamicGaussians, Gaussians};
use tcgs_interchange::{ParamsExtras, write_params_npz};
use tcgs_pipeline::{CompressOptions, compress_scene};

const IN_THE_ROOM: [f32; 3] = [0.0, -0.8, 0.2];
const BEHIND_ALL_CAMERAS: [f32; 3] = [0.0, -0.8, -30.0];

/// Three timesteps: one Gaussian stays in the room, one there is transparent, one leaves after the second timestep, and
/// one is in no image.
fn scene() -> DynamicGaussians {
    let mut scene = DynamicGaussians::default();
    for timestep in 0..3 {
        let third = if timestep < 2 { [0.5, -0.8, 0.2] } else { BEHIND_ALL_CAMERAS };
        scene.push(Gaussians::from(BaseColumns {
            means: vec![IN_THE_ROOM, IN_THE_ROOM, third, BEHIND_ALL_CAMERAS],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            log_scales: vec![[-2.0; 3]; 4],
            logit_opacities: vec![2.0, -20.0, 2.0, 2.0],
            colors: vec![[0.5; 3]; 4],
        }));
    }
    scene
}

#[test]
fn what_no_camera_sees_is_left_out_and_what_leaves_dies() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
    let scene = open(&path);
    let options = |min_share, version, max_float_bytes| CompressOptions {
        min_share,
        version,
        max_float_bytes,
        bits: Some((8, 8)),
        capture: Some(files().join("capture")),
        ..CompressOptions::default()
    };
    let alive = |options: &CompressOptions| {
        let compact = compress_scene(&scene, options).unwrap().compact;
        [0, 1, 2].map(|timestep| compact.at(timestep).num_gaussians())
    };
    assert_eq!(alive(&options(0.0, 2, u64::MAX)), [4, 4, 4]);
    assert_eq!(alive(&options(1e-6, 2, u64::MAX)), [3, 3, 2]);
    assert_eq!(alive(&options(1e-6, 2, 0)), [3, 3, 2]);
    // Version 1 has no lives.
    assert_eq!(alive(&options(1e-6, 1, u64::MAX)), [3, 3, 3]);
}

#[test]
fn a_share_that_none_reaches_is_refused() {
    let run = open(&files().join("run"));
    for (min_share, said) in [(0.9, "its largest Gaussian makes up"), (1.5, "expected a number from 0"), (-1.0, "-1")] {
        let error = compress_scene(&run, &CompressOptions { min_share, ..CompressOptions::default() }).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
    let error = compress_scene(&open(&path), &CompressOptions { min_share: 1e-6, ..CompressOptions::default() });
    assert!(error.unwrap_err().to_string().contains("no training cameras, expected a capture"));
}

//! The first camera of a file, and the paths around a scene.

use std::path::Path;

use crate::support::{files, open};
use tcgs_capture::{Capture, Split};
use tcgs_core::{BaseColumns, Camera, DynamicGaussians, Gaussians, Subject, Tour};
use tcgs_pipeline::{CameraAt, CompressOptions, OpenScene, compress_scene};

const PERSON: [f32; 3] = [0.3, -0.8, 0.2];

/// Three timesteps in which a person walks a little before a shell of radius 40; a wall stands at each place given.
fn scene(walls: &[[f32; 3]]) -> OpenScene {
    let mut scene = DynamicGaussians::default();
    for timestep in 0..3_u8 {
        let step = 0.05 * f32::from(timestep);
        let person = (0..60_u8)
            .map(f32::from)
            .map(|i| [PERSON[0] + step + 0.1 * i.sin(), PERSON[1] + 0.01 * (i - 30.0), PERSON[2] + 0.1 * i.cos()]);
        let shell = (0..600_u16).map(f32::from).map(|i| [40.0 * i.sin(), 0.05 * (i - 300.0), 40.0 * i.cos()]);
        let means: Vec<[f32; 3]> = person.chain(shell).chain(walls.iter().copied()).collect();
        let n = means.len();
        let size = |i: usize| {
            if i < 60 {
                -2.0
            } else if i < 660 {
                0.5
            } else {
                -1.2
            }
        };
        scene.push(Gaussians::from(BaseColumns {
            means,
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            log_scales: (0..n).map(|i| [size(i); 3]).collect(),
            logit_opacities: vec![4.0; n],
            colors: vec![[0.5; 3]; n],
        }));
    }
    OpenScene::of_floats(Path::new("made here"), scene, 30.0)
}

fn cameras() -> Vec<Camera> {
    let capture = Capture::open(&files().join("capture")).unwrap();
    capture.cameras(Split::Train, 0, 1).unwrap().into_iter().map(|(_, camera)| camera).collect()
}

/// The cameras of the scene's file, in its order.
fn views(scene: &OpenScene) -> Vec<Camera> {
    let options =
        CompressOptions { capture: Some(files().join("capture")), bits: Some((8, 8)), ..CompressOptions::default() };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tcgs");
    std::fs::write(&path, compress_scene(scene, &options).unwrap().file).unwrap();
    open(&path).rig().unwrap()
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn a_file_names_a_camera_first_that_sees_the_person() {
    let number =
        |view: &Camera| cameras().iter().position(|camera| apart(camera.center(), view.center()) < 1e-3).unwrap();
    let clear: Vec<usize> = views(&scene(&[])).iter().map(number).collect();
    assert_eq!(clear[0], Subject::inner_first(&cameras())[0], "the one in the middle");
    // A wall between that camera and the person, and then before the second choice, too.
    let wall = |i: usize| {
        let center = cameras()[i].center();
        std::array::from_fn(|axis| 0.5 * (center[axis] as f32 + PERSON[axis]))
    };
    let order = Subject::inner_first(&cameras());
    for hidden in [1, 2] {
        let walls: Vec<[f32; 3]> = order[..hidden].iter().map(|&i| wall(i)).collect();
        let found: Vec<usize> = views(&scene(&walls)).iter().map(number).collect();
        assert!(!order[..hidden].contains(&found[0]), "{found:?} begins behind a wall; walls before {order:?}");
        assert!(found.is_sorted_by_key(|&i| (i != found[0], i)), "the others as they were: {found:?}");
    }
}

#[test]
fn paths_lead_around_what_moves_and_stay_among_the_cameras() {
    let person = PERSON.map(f64::from);
    let scene = scene(&[]);
    let aims = |camera: &Camera| {
        let ([x, y], _) = camera.project(person).expect("before the camera");
        x > 0.0 && y > 0.0 && x < camera.width as f64 && y < camera.height as f64
    };
    for tour in [Tour::Orbit, Tour::Spiral] {
        let path = CameraAt::of_tour(&scene, 0..3, tour, [64, 36]).unwrap();
        for at in &path {
            assert!(aims(&at.camera) && apart(at.camera.center(), person) < 4.0, "not out at the shell: {at:?}");
        }
    }
    // A run has the cameras of its capture, and its file some of them.
    for name in ["run", "scene.tcgs"] {
        let scene = open(&files().join(name));
        assert_eq!(scene.rig().unwrap().len(), 4, "{name}");
        let path = scene.tour(Tour::Orbit, 0, 40, [48, 36]).unwrap();
        for camera in cameras() {
            let nearest = path.iter().map(|other| apart(other.center(), camera.center())).fold(f64::MAX, f64::min);
            assert!(nearest < 0.5, "{name}: it misses a camera by {nearest}");
        }
    }
    assert_eq!(open(&files().join("params.npz")).rig().unwrap(), []);
}

#[test]
fn gaussians_that_are_born_do_not_look_as_if_others_moved() {
    let subject = |path: &Path| {
        let scene = open(path);
        scene.subject(0, &scene.rig().unwrap()).unwrap()
    };
    let vectors = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v2");
    for name in ["lives", "cohorts"] {
        let found = subject(&vectors.join(name).with_extension("tcgs"));
        assert!(found.center.iter().all(|x| x.is_finite()) && found.distance > 0.0, "{name}: {found:?}");
    }
}

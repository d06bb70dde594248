//! The view of a file at the start.

use crate::support::{cohorts_file, settings, wait};
use tcgs_codec::{BitMap, CompressSettings, SceneInfo, UpAxis, compress, encode};
use tcgs_core::{Camera, DynamicGaussians, Gaussians, Layout};
use tcgs_play::{BytesSource, Moment, Player, start_view};

const UP: [f64; 3] = [0.0, -1.0, 0.0];

fn moment(file: &[u8], timestep: usize) -> Moment {
    let mut player = Player::new(BytesSource::new(file), settings(1 << 30), timestep);
    wait(&mut player, &mut 0.0);
    player.current().unwrap()
}

fn file(scene: &DynamicGaussians) -> Vec<u8> {
    let bits = BitMap::uniform(scene.num_gaussians(), 16, 8);
    encode(&compress(scene, &bits, None, SceneInfo::of(scene), &CompressSettings::default()).unwrap()).unwrap()
}

/// Opaque Gaussians at the given means, of a tenth of a unit.
fn opaque(means: &[[f32; 3]]) -> Gaussians {
    let mut gaussians = Gaussians::zeros(means.len());
    gaussians.means_mut().copy_from_slice(means);
    gaussians.log_scales_mut().fill([-2.3; 3]);
    gaussians.logit_opacities_mut().fill(5.0);
    gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
    gaussians
}

fn still(means: &[[f32; 3]]) -> Moment {
    let mut scene = DynamicGaussians::default();
    scene.push(opaque(means));
    moment(&file(&scene), 0)
}

/// A cylinder of radius 12, and a person at x = 2, z = -3, who walks along x from timestep to timestep.
fn person_in_a_hall() -> Vec<u8> {
    let mut scene = DynamicGaussians::default();
    for timestep in 0..5_u8 {
        let means: Vec<[f32; 3]> = (0..1100_u16)
            .map(|i| (i, f32::from(i)))
            .map(|(i, at)| match i {
                0..1000 => [12.0 * at.sin(), 0.01 * at - 5.0, 12.0 * at.cos()],
                _ => [2.0 + 0.1 * f32::from(timestep) + 0.1 * at.sin(), 0.01 * (at - 1050.0), -3.0 + 0.1 * at.cos()],
            })
            .collect();
        scene.push(opaque(&means));
    }
    file(&scene)
}

fn in_camera(camera: &Camera, p: [f64; 3]) -> [f64; 3] {
    let m = &camera.camera_from_world;
    [0, 1, 2].map(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3])
}

#[test]
fn the_middle_is_in_the_middle_and_up_is_up() {
    let means: Vec<[f32; 3]> =
        (0..1001_u16).map(|i| [5.0 + (f32::from(i)).sin(), 1.0, 2.0 * f32::from(i).cos()]).collect();
    let moment = still(&means);
    for up in [UpAxis::Unknown, UpAxis::PlusX, UpAxis::PlusY, UpAxis::PlusZ, UpAxis::MinusX, UpAxis::MinusZ] {
        let direction = up.direction();
        let (camera, pivot) = start_view(&moment, &[], direction);
        let [x, y, depth] = in_camera(&camera, pivot);
        assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && depth > 1.0, "{up:?}");
        let above = in_camera(&camera, std::array::from_fn(|i| pivot[i] + 0.1 * direction[i]));
        assert!(above[1] < -0.05 && above[0].abs() < 1e-9, "{up:?}: {above:?}");
    }
}

#[test]
fn a_few_far_away_and_a_single_point_do_not_matter() {
    let mut means = vec![[0.0, 0.0, 0.0]; 100];
    means[7] = [1e6, 0.0, 0.0];
    let (camera, _) = start_view(&still(&means), &[], UP);
    assert!(camera.center().iter().all(|x| x.abs() < 1.0));
    start_view(&still(&[[1.0; 3]]), &[], UP);
}

#[test]
fn without_cameras_what_moves_is_looked_at() {
    let file = person_in_a_hall();
    for timestep in [0, 3] {
        let (camera, pivot) = start_view(&moment(&file, timestep), &[], UP);
        assert!((pivot[0] - 2.0 - 0.1 * timestep as f64).abs() < 0.2 && (pivot[2] + 3.0).abs() < 0.1, "{pivot:?}");
        let [x, y, depth] = in_camera(&camera, pivot);
        assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && (0.5..9.0).contains(&depth), "{depth} away");
    }
}

#[test]
fn a_file_begins_at_its_first_camera_that_shows_the_subject() {
    let moment = moment(&person_in_a_hall(), 0);
    let at = |x: f64, z: f64, target: [f64; 3]| Camera::look_at([x, -0.5, z], target, UP, 60.0, 96, 54);
    let person = [2.2, 0.0, -3.0];
    let away = at(2.0, -6.0, [2.0, 0.0, -12.0]);
    let outside = at(2.0, -16.0, person);
    let good = [at(4.0, -6.0, person), at(1.0, -6.0, person)];
    let first = |cameras: &[Camera]| start_view(&moment, cameras, UP);
    let (camera, pivot) = first(&good);
    assert_eq!(camera, good[0]);
    assert!((pivot[0] - 2.2).abs() < 0.3 && (pivot[2] + 3.0).abs() < 0.3, "{pivot:?}");
    let [a, b] = good;
    assert_eq!(first(&[away.clone(), a.clone(), b.clone()]).0, a);
    assert_eq!(first(&[outside.clone(), away, b.clone(), a.clone()]).0, b, "a wall is before the person");
}

/// Short-lived cohorts, Gaussians that come and go, and unknown layouts.
#[test]
fn any_file_has_a_start_view() {
    for layout in [Layout::base(), Layout::with_harmonics(1)] {
        let file = cohorts_file(160, &layout);
        for timestep in 0..12 {
            let (camera, pivot) = start_view(&moment(&file, timestep), &[], UP);
            assert!(camera.camera_from_world.as_flattened().iter().chain(&pivot).all(|x| x.is_finite()));
        }
    }
}

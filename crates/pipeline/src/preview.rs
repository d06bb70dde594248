//! A capture before training, as a scene for players: its points as small Gaussians, and its cameras as views.

use tcgs_capture::{Capture, Split};
use tcgs_codec::{BitMap, CompressSettings, FileCamera, SceneInfo, VIEWS, compress, encode_with, write_views};
use tcgs_core::{Camera, DynamicGaussians, PointCloud};
use tcgs_train::Parameters;

use crate::PipelineError;
use crate::compress::up_axis;

/// Size of a point relative to the distance to its neighbours. The gaps let viewers look through, since some cameras
/// stand behind points.
const POINT_SIZE: f32 = 0.3;
/// Limit on the size of points far from all others, as a multiple of the usual size.
const MAX_SIZE: f32 = 4.0;
/// Stored opacity: 0.98 after activation.
const OPAQUE: f32 = 4.0;
/// Bit width of a number.
const BITS: u8 = 10;

/// A `.tcgs` file of one timestep with the initial points of a capture, and a view for each of its cameras. If a
/// capture has no points yet, a point marks each camera.
///
/// - `names`: of all cameras, in the order of [`Split::All`]
///
/// # Errors
/// [`PipelineError`] if the points cannot be read.
///
/// # Panics
/// If there is not a name for each camera.
pub fn points_scene(capture: &Capture, names: &[String]) -> Result<Vec<u8>, PipelineError> {
    let cameras = capture.cameras(Split::All, 0, 1)?;
    assert_eq!(names.len(), cameras.len(), "a name for each camera");
    let cloud = if capture.has_points() { capture.point_cloud()? } else { at_cameras(&cameras) };
    let mut gaussians = Parameters::from_cloud(&cloud, 0, 0.0).gaussians;
    let n = gaussians.num_gaussians();
    let mut sizes: Vec<f32> = gaussians.log_scales().iter().map(|scales| scales[0]).collect();
    sizes.sort_by(f32::total_cmp);
    let most = sizes[n / 2] + MAX_SIZE.ln();
    for scales in gaussians.log_scales_mut() {
        *scales = scales.map(|scale| scale.min(most) + POINT_SIZE.ln());
    }
    gaussians.logit_opacities_mut().fill(OPAQUE);

    let mut scene = DynamicGaussians::default();
    scene.push(gaussians);
    let mut info = SceneInfo::of(&scene);
    info.name = capture.name();
    info.up = up_axis(&cameras);
    let compact = compress(&scene, &BitMap::uniform(n, 16, BITS), None, info, &CompressSettings::default())?;
    let view =
        |((_, camera), name): (&(usize, Camera), &String)| FileCamera { name: name.clone(), camera: camera.clone() };
    let views = write_views(&cameras.iter().zip(names).map(view).collect::<Vec<_>>());
    Ok(encode_with(&compact, &[(VIEWS, &views)])?)
}

fn at_cameras(cameras: &[(usize, Camera)]) -> PointCloud {
    let points: Vec<[f32; 3]> = cameras.iter().map(|(_, camera)| camera.center().map(|x| x as f32)).collect();
    let n = points.len();
    PointCloud { points, colors: vec![[0.6; 3]; n], foreground: vec![true; n] }
}

#[cfg(test)]
mod tests {
    use tcgs_capture::{SyntheticSettings, write_synthetic};
    use tcgs_codec::{DecodeLimits, application_data, decode, read_views};

    use super::*;

    #[test]
    fn points_are_where_they_were_and_cameras_are_views() {
        let folder = tempfile::tempdir().unwrap();
        let small =
            SyntheticSettings { width: 32, height: 24, num_timesteps: 1, num_points: 400, ..Default::default() };
        write_synthetic(folder.path(), &small).unwrap();
        let capture = Capture::open(folder.path()).unwrap();
        let cameras = capture.cameras(Split::All, 0, 1).unwrap();
        let names: Vec<String> = (0..cameras.len()).map(|i| format!("camera {i}")).collect();
        let file = points_scene(&capture, &names).unwrap();

        let scene = decode(&file, &DecodeLimits::default()).unwrap().reconstruct();
        let cloud = capture.point_cloud().unwrap();
        assert_eq!((scene.num_timesteps(), scene.num_gaussians()), (1, cloud.points.len()));
        let apart = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f32::max);
        for point in &cloud.points {
            let nearest = scene.means(0).iter().map(|mean| apart(mean, point)).fold(f32::INFINITY, f32::min);
            assert!(nearest < 0.01, "{point:?} is off by {nearest}");
        }
        let data: Vec<(String, Vec<u8>)> = application_data(&file, &DecodeLimits::default())
            .unwrap()
            .into_iter()
            .map(|(name, bytes)| (name, bytes.to_vec()))
            .collect();
        let views = read_views(&data);
        assert_eq!(views.iter().map(|view| view.name.clone()).collect::<Vec<_>>(), names);
        assert!(apart(&views[3].camera.center().map(|x| x as f32), &cameras[3].1.center().map(|x| x as f32)) < 1e-3);
    }

    #[test]
    fn a_capture_without_points_shows_where_its_cameras_are() {
        let folder = tempfile::tempdir().unwrap();
        let small =
            SyntheticSettings { width: 32, height: 24, num_timesteps: 1, num_points: 400, ..Default::default() };
        write_synthetic(folder.path(), &small).unwrap();
        std::fs::remove_file(folder.path().join("init_pt_cld.npz")).unwrap();
        let capture = Capture::open(folder.path()).unwrap();
        let cameras = capture.cameras(Split::All, 0, 1).unwrap();
        let file = points_scene(&capture, &vec!["x".into(); cameras.len()]).unwrap();
        let scene = decode(&file, &DecodeLimits::default()).unwrap().reconstruct();
        assert_eq!(scene.num_gaussians(), cameras.len());
    }
}

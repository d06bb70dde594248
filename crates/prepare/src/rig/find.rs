//! Finds unknown cameras from their images by COLMAP.

use std::ops::ControlFlow;
use std::path::Path;

use tcgs_capture::CaptureDescription;
use tcgs_core::{add_scaled, cross, distance, dot, normalize, upper_median};

use super::bundle::{self, Freedom, Track};
use super::camera::RigCamera;
use super::frames::{Frames, moments};
use super::model::{Found, to_text};
use super::program::{Colmap, image_name};
use super::similarity::Similarity;
use crate::PrepareError;

/// Number of moments if the first one does not place all cameras: moving objects are then at more places.
const NUM_MOMENTS: usize = 4;
/// Priors after the program has put the images of one camera nearly at one place.
const FREEDOM: Freedom = Freedom { turn: 0.05, shift: 0.1, log_focal: 0.05, k1: 0.05 };

/// The cameras found, and the tracks behind them.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct FoundCameras {
    /// Median reprojection error, pixels.
    pub error_px: f64,
    tracks: Vec<Track>,
}

impl FoundCameras {
    /// Number of points by which the cameras were placed.
    pub fn num_points(&self) -> usize {
        self.tracks.len()
    }

    /// Multiplies all lengths, as [`scale_cameras`] did for the description.
    pub fn scale(&mut self, factor: f64) {
        for x in self.tracks.iter_mut().flat_map(|track| &mut track.point) {
            *x *= factor;
        }
    }

    /// A text model of COLMAP with the cameras of a description and the points: names and contents of its files.
    pub fn model(&self, description: &CaptureDescription) -> Vec<(&'static str, String)> {
        let cameras: Vec<RigCamera> = description.cameras.iter().map(RigCamera::new).collect();
        let names: Vec<&str> = description.cameras.iter().map(|camera| camera.name.as_str()).collect();
        to_text(&cameras, &self.tracks, &names)
    }
}

/// Finds poses, focal lengths and distortion of all cameras of a description from their images, by the program
/// `colmap`.
///
/// COLMAP gets the middle frame of the capture. If that places some cameras and not all, other frames are added. Images
/// of one camera have the same intrinsics, and in the end the same pose. The world's y axis then points down in the
/// cameras' images, its origin is the middle of what they see, and its unit is unknown.
///
/// - `folder`: the folder that the description's files are relative to
/// - `work`: an empty folder for COLMAP's files, which the caller removes
/// - `tell`: called with a description of each step; a break ends the work
///
/// # Errors
/// [`PrepareError`] if the program is not installed or fails, if cameras remain whose place was not found, or if `tell`
/// ended the work; the description is then as it was.
pub fn find_cameras(
    folder: &Path,
    description: &mut CaptureDescription,
    work: &Path,
    tell: &mut dyn FnMut(&str) -> ControlFlow<()>,
) -> Result<FoundCameras, PrepareError> {
    let mut colmap = Colmap::find(work, tell)?;
    let frames = Frames::open(folder, description)?;
    let num_cameras = description.cameras.len();
    let mut chosen = moments(description.num_frames, 1);
    let first = chosen[0];
    chosen.extend(moments(description.num_frames, NUM_MOMENTS).into_iter().filter(|frame| *frame != first));
    let mut models = attempt(&mut colmap, &frames, &chosen[..1], num_cameras)?;
    let num_placed = |models: &[Found]| models.first().map_or(0, Found::num_placed);
    // If no two cameras fit at one moment, more moments take long and have not helped.
    if (2..num_cameras).contains(&num_placed(&models)) && chosen.len() > 1 {
        let more = attempt(&mut colmap, &frames, &chosen, num_cameras)?;
        models = if num_placed(&more) > num_placed(&models) { more } else { models };
    }
    // The images of one camera alone are no rig.
    models.retain(|found| found.num_placed() >= 2);
    let names: Vec<String> = description.cameras.iter().map(|camera| camera.name.clone()).collect();
    if let Some(problem) = two_scenes(&models, &names) {
        return Err(PrepareError::invalid(folder, problem));
    }
    let best = models.into_iter().next();
    let Found { cameras, mut tracks } = best.ok_or_else(|| not_placed(folder, &names, &[]))?;
    let is_placed: Vec<bool> = cameras.iter().map(Option::is_some).collect();
    let mut cameras: Vec<RigCamera> = cameras.into_iter().flatten().collect();
    if cameras.len() < num_cameras {
        return Err(not_placed(folder, &names, &is_placed));
    }
    colmap.tell("adjusting the cameras")?;
    bundle::bundle(&mut cameras, &mut tracks, &vec![true; num_cameras], FREEDOM, bundle::MIN_SCALE_PX);
    upright(&cameras, &tracks).apply(&mut cameras, &mut tracks);
    let mut of_camera = vec![Vec::new(); num_cameras];
    for track in &tracks {
        for (&(camera, _), error) in track.seen.iter().zip(bundle::errors(&cameras, track)) {
            of_camera[camera].push(error);
        }
    }
    for ((camera, rig), errors) in description.cameras.iter_mut().zip(&cameras).zip(&of_camera) {
        rig.put_into(camera);
        camera.error_px = Some((1e3 * upper_median(errors.iter().copied()).unwrap_or_default()).round() / 1e3);
    }
    let error_px = upper_median(of_camera.concat()).unwrap_or_default();
    Ok(FoundCameras { error_px, tracks })
}

/// Runs the program on the images of some moments.
///
/// - returns: the models that were found, the one that places most cameras first
fn attempt(
    colmap: &mut Colmap<'_>,
    frames: &Frames,
    chosen: &[usize],
    num_cameras: usize,
) -> Result<Vec<Found>, PrepareError> {
    colmap.tell("reading images")?;
    for (moment, &frame) in chosen.iter().enumerate() {
        colmap.store(&frames.at(frame)?, moment)?;
    }
    let num_images = num_cameras * chosen.len();
    colmap.find_features(num_images)?;
    let mut pairs = Vec::new();
    for moment in 0..chosen.len() {
        for a in 0..num_cameras {
            pairs.extend((a + 1..num_cameras).map(|b| (image_name(a, moment), image_name(b, moment))));
            // Images of one camera connect the moments.
            pairs.extend((0..moment).map(|earlier| (image_name(a, earlier), image_name(a, moment))));
        }
    }
    colmap.match_images(&pairs)?;
    let models = colmap.place(num_images)?;
    let mut models =
        models.iter().map(|model| Found::read(model, num_cameras)).collect::<Result<Vec<_>, PrepareError>>()?;
    // The sort is stable: of two models with as many cameras the first is kept.
    models.sort_by_key(|found| std::cmp::Reverse(found.num_placed()));
    Ok(models)
}

/// The error of two models that place several cameras each, and none in common.
fn two_scenes(models: &[Found], names: &[String]) -> Option<String> {
    /// A smaller model is hardly a scene.
    const MIN_CAMERAS: usize = 3;
    let placed = |model: &Found| (0..names.len()).filter(|&i| model.cameras[i].is_some()).collect::<Vec<_>>();
    let first = placed(models.first()?);
    let others = models[1..].iter().map(placed);
    let second = others.into_iter().find(|other| other.iter().all(|camera| !first.contains(camera)))?;
    let named = |cameras: &[usize]| cameras.iter().map(|&i| names[i].as_str()).collect::<Vec<_>>().join(", ");
    (first.len() >= MIN_CAMERAS && second.len() >= MIN_CAMERAS).then(|| {
        format!(
            "COLMAP finds two groups of cameras that see nothing in common: {} and {}; expected the videos of one scene \
             in a folder",
            named(&first),
            named(&second)
        )
    })
}

fn not_placed(folder: &Path, names: &[String], is_placed: &[bool]) -> PrepareError {
    let helps = "what helps: neighbouring cameras within about 30 degrees of each other that see the same things, images \
                 of 1000 pixels or more with texture in focus, or a calibration made with a board (--calibration)";
    let missing: Vec<&str> =
        names.iter().zip(is_placed).filter(|(_, placed)| !**placed).map(|(name, _)| name.as_str()).collect();
    let problem = if is_placed.iter().any(|&placed| placed) {
        let (placed, all) = (names.len() - missing.len(), names.len());
        format!(
            "COLMAP places {placed} of {all} cameras, but not {}; {helps}, or to leave these out",
            missing.join(", ")
        )
    } else {
        format!("COLMAP finds no two cameras of which it is sure that they see the same things; {helps}")
    };
    PrepareError::invalid(folder, problem)
}

/// Turns a rig so that down in its images is down in the world, and moves the median of its points to the origin.
fn upright(cameras: &[RigCamera], tracks: &[Track]) -> Similarity {
    let sum = |row: usize| -> [f64; 3] {
        std::array::from_fn(|i| cameras.iter().map(|camera| camera.camera_from_world[row][i]).sum())
    };
    let down = normalize(sum(1));
    let ahead = [sum(2), cameras[0].forward(), [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
    let level = |v: [f64; 3]| add_scaled(v, -dot(v, down), down);
    // The mean direction of cameras all around is nearly zero.
    let forward = ahead.map(level).into_iter().find(|v| dot(*v, *v) > 0.01).unwrap_or([0.0, 0.0, 1.0]);
    let forward = normalize(forward);
    let rotation = [cross(down, forward), down, forward];
    let middle = [0, 1, 2].map(|i| upper_median(tracks.iter().map(|track| track.point[i])).unwrap_or_default());
    let shift = rotation.map(|row| -dot(row, middle));
    Similarity { scale: 1.0, rotation, shift }
}

/// Scales a description to a measured distance between two cameras.
///
/// - `cameras`: names of the two cameras
/// - `metres`: distance between their optical centres, above 0
///
/// - returns: the factor by which lengths were multiplied
///
/// # Errors
/// A camera that does not exist, or two at one place, in words.
pub fn scale_cameras(description: &mut CaptureDescription, cameras: [&str; 2], metres: f64) -> Result<f64, String> {
    let center = |name: &str| {
        let camera = description.cameras.iter().find(|camera| camera.name == name);
        camera.map(|camera| RigCamera::new(camera).center()).ok_or_else(|| {
            let names: Vec<&str> = description.cameras.iter().map(|camera| camera.name.as_str()).collect();
            format!("has no camera {name}, expected one of {}", names.join(", "))
        })
    };
    let apart = distance(center(cameras[0])?, center(cameras[1])?);
    if apart < 1e-9 {
        return Err(format!("has {} and {} at one place, expected two that are apart", cameras[0], cameras[1]));
    }
    let factor = metres / apart;
    for camera in &mut description.cameras {
        for row in &mut camera.camera_from_world {
            row[3] *= factor;
        }
    }
    description.in_metres = true;
    Ok(factor)
}

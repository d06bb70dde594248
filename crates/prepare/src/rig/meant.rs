//! Detects poses that are written down in another convention than their format has, from the images.
//!
//! Two cameras agree on a place by chance, three do not. Under wrong poses three cameras agree on hardly any place. A
//! convention under which they agree on many places is therefore the one that was meant.

use super::bundle::{self, Track};
use super::camera::RigCamera;
use super::matches::{self, Shot};

/// On average fewer shared places per camera than this suggest another convention.
const FEW: usize = 5;
/// Minimum ratio of the number of places under the meant convention to that under the format's own.
const CLEARLY: usize = 4;

/// A convention of poses, in words, and the conversion of a camera from it.
type Reading = (&'static str, fn(&RigCamera) -> RigCamera);

/// Common mistakes. Left-handed axes are refused where a calibration is read.
const READINGS: [Reading; 3] = [
    ("the wrong way round (world from camera), and are inverted", inverted),
    ("for camera axes y up and z backward, and are turned", turned),
    (
        "the wrong way round (world from camera), for camera axes y up and z backward, and are inverted and turned",
        |c| turned(&inverted(c)),
    ),
];

/// Finds the convention that was meant.
///
/// - `tracks`: found with the cameras as they are
/// - `shots`: of one moment
/// - returns: the cameras as meant and, in words, what is done to them; `None` if the poses are right, or if it is not
///   certain what was meant
pub(super) fn find(
    cameras: &[RigCamera],
    tracks: &[Track],
    shots: &[Shot],
    band: f64,
) -> Option<(Vec<RigCamera>, String)> {
    let given = confirmed(cameras, tracks, band);
    if given >= FEW * cameras.len() {
        return None;
    }
    let with = |(words, read): &Reading| {
        let cameras: Vec<RigCamera> = cameras.iter().map(read).collect();
        let count = confirmed(&cameras, &matches::find(&cameras, shots, band), band);
        (count, cameras, *words)
    };
    let (count, read, words) = READINGS.iter().map(with).max_by_key(|(count, ..)| *count)?;
    (count >= FEW * cameras.len() && count >= CLEARLY * given).then(|| {
        let line = format!(
            "all poses are {words}: {count} places then fit that three cameras see or more, {given} as they were"
        );
        (read, line)
    })
}

/// Number of the places that three cameras or more see within the band.
pub(super) fn confirmed(cameras: &[RigCamera], tracks: &[Track], band: f64) -> usize {
    let side = |camera: usize| cameras[camera].lens.width.max(cameras[camera].lens.height) as f64;
    let fits = |track: &&Track| {
        let errors = bundle::errors(cameras, track);
        track.seen.len() >= 3 && track.seen.iter().zip(errors).all(|(&(camera, _), error)| error < band * side(camera))
    };
    tracks.iter().filter(fits).count()
}

fn inverted(camera: &RigCamera) -> RigCamera {
    let (m, center) = (&camera.camera_from_world, camera.center());
    let camera_from_world = [0, 1, 2].map(|i| [m[0][i], m[1][i], m[2][i], center[i]]);
    RigCamera { camera_from_world, ..camera.clone() }
}

fn turned(camera: &RigCamera) -> RigCamera {
    let [x, y, z] = camera.camera_from_world;
    RigCamera { camera_from_world: [x, y.map(|v| -v), z.map(|v| -v)], ..camera.clone() }
}

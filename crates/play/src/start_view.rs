//! The view of a scene at the start, if the page does not choose one.
//!
//! The player alone uses this choice; no file depends on it.

use tcgs_core::{Camera, Subject, Tour, activate, add_motion};

use crate::holdings::Moment;

/// Size of the picture for a camera that is created because the file has none, pixels. [`Camera::fitted`] adapts it to
/// the window.
const SIZE: [usize; 2] = [640, 360];
/// Number of directions tried for a scene without cameras, until one is without fog.
const NUM_DIRECTIONS: usize = 8;

/// The view with which a player begins.
#[derive(Clone, Debug, PartialEq)]
pub struct StartView {
    /// The camera.
    pub camera: Camera,
    /// Direction in the world that points up.
    pub up: [f64; 3],
    /// Point in the world around which the camera orbits.
    pub pivot: [f64; 3],
}

/// The camera with which a player begins, and its pivot. The camera is the file's first one that shows the scene's
/// [`Subject`] without fog before it. A file without cameras is seen from [`Subject::distance`] away and a little
/// above.
///
/// - `moment`: a timestep. Motion is measured within the segments that hold it
/// - `cameras`: the file's cameras, the preferred ones first; may be empty
/// - `up`: direction in the world that points up, not zero
/// - returns: the camera, with the size of its images or 640 x 360 pixels, and the pivot in the world: the subject's
///   middle
pub fn start_view(moment: &Moment, cameras: &[Camera], up: [f64; 3]) -> (Camera, [f64; 3]) {
    let gaussians = moment.gaussians();
    let subject = Subject::of(&gaussians, &moved(moment), cameras);
    let around =
        if cameras.is_empty() { Tour::Orbit.among(&subject, &[], up, NUM_DIRECTIONS, SIZE) } else { Vec::new() };
    let candidates = if cameras.is_empty() { &around } else { cameras };
    // A coarser picture may lack the subject, so there the file's order of cameras counts.
    let is_trusted = !moment.is_whole && !cameras.is_empty();
    let first = if is_trusted { None } else { subject.first_shown(candidates, &activate(&gaussians)) };
    (candidates[first.unwrap_or(0)].clone(), subject.center)
}

/// Motion of each Gaussian of [`Moment::gaussians`] between the beginning, middle and end of its segment, scene units.
fn moved(moment: &Moment) -> Vec<f32> {
    let mut moved = Vec::new();
    for segment in &moment.segments {
        let living =
            |timestep: usize| segment.alive(timestep).unwrap_or_else(|| (0..segment.num_gaussians()).collect());
        let (rows, now) = (living(moment.timestep), segment.at(moment.timestep));
        let before = moved.len();
        moved.resize(before + rows.len(), 0.0);
        let span = segment.timesteps();
        for timestep in [span.start, (span.start + span.end) / 2, span.end - 1] {
            if timestep == moment.timestep {
                continue;
            }
            let (then, alive) = (segment.at(timestep), living(timestep));
            let both = rows.iter().enumerate().filter(|(_, row)| alive.binary_search(row).is_ok());
            add_motion(&mut moved[before..], both.map(|(i, &row)| (i, now.means()[row], then.means()[row])));
        }
    }
    moved
}

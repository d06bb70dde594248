//! Application data about the training cameras (`docs/FORMAT.md`): views to start from, and the positions from which
//! pictures can be trusted.

use std::path::Path;

use tcgs_capture::{Capture, Split};
use tcgs_codec::{FileCamera, TRUST, UpAxis, VIEWS, write_trust, write_views};
use tcgs_core::{Camera, Subject, length};

use super::CompressOptions;
use crate::spread::spread;
use crate::{OpenScene, PipelineError};

/// The capture given, or the run's if it is still there, and its training cameras; none without.
#[derive(Default)]
pub struct TrainedFrom {
    capture: Option<Capture>,
    /// Identifier and camera at the capture's full size.
    pub cameras: Vec<(usize, Camera)>,
}

impl TrainedFrom {
    pub fn open(scene: &OpenScene, options: &CompressOptions) -> Result<Self, PipelineError> {
        let of = |path: &Path| -> Result<_, PipelineError> {
            let capture = scene.open_capture(path)?;
            let cameras = capture.cameras(Split::Train, scene.first_frame, 1)?;
            Ok(Self { capture: Some(capture), cameras })
        };
        match (&options.capture, scene.capture()) {
            (Some(path), _) => of(path),
            (None, Some(path)) => Ok(of(path).unwrap_or_default()),
            (None, None) => Ok(Self::default()),
        }
    }

    /// Application data: some of the cameras, spread evenly, and from where pictures can be trusted. Empty without
    /// cameras.
    pub fn data(&self, scene: &OpenScene, options: &CompressOptions) -> Result<Vec<(String, Vec<u8>)>, PipelineError> {
        let Some(capture) = self.capture.as_ref().filter(|_| options.views > 0 && !self.cameras.is_empty()) else {
            return Ok(Vec::new());
        };
        let all: Vec<Camera> = self.cameras.iter().map(|(_, camera)| camera.clone()).collect();
        let subject = scene.subject(0, &all)?;
        let views = views(scene, &self.cameras, &subject, options)?;
        let trust = capture.trust(&all, subject.center)?;
        Ok(vec![(VIEWS.into(), write_views(&views)), (TRUST.into(), write_trust(&trust))])
    }
}

/// Some of the cameras, spread evenly. A player begins at the first: the innermost camera that shows the scene's
/// subject, at the first timestep, without fog.
fn views(
    scene: &OpenScene,
    cameras: &[(usize, Camera)],
    subject: &Subject,
    options: &CompressOptions,
) -> Result<Vec<FileCamera>, PipelineError> {
    let of = |i: usize| FileCamera { name: cameras[i].0.to_string(), camera: cameras[i].1.clone() };
    let mut views: Vec<FileCamera> = spread(cameras.len(), options.views).map(of).collect();
    let drawn = scene.drawn(0)?.seen_by(&cameras[0].1);
    let in_file: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
    let order = Subject::inner_first(&in_file);
    if let Some(start) = subject.first_shown(order.iter().map(|&i| &in_file[i]), &drawn) {
        views[..=order[start]].rotate_right(1);
    }
    Ok(views)
}

/// The axis along which the cameras stand upright; unknown where none is near.
pub fn up_axis(cameras: &[(usize, Camera)]) -> UpAxis {
    // The rows of a rotation from the world are the camera's axes in it; the second points down.
    let sum = |axis: usize| -> f64 { cameras.iter().map(|(_, camera)| -camera.camera_from_world[1][axis]).sum() };
    let mean = [0, 1, 2].map(|axis| sum(axis) / cameras.len().max(1) as f64);
    let length = length(mean);
    let axes = [[UpAxis::PlusX, UpAxis::MinusX], [UpAxis::PlusY, UpAxis::MinusY], [UpAxis::PlusZ, UpAxis::MinusZ]];
    let along = (0..3).find(|&axis| length > MIN_AGREEMENT && mean[axis].abs() > MIN_COSINE * length);
    along.map_or(UpAxis::Unknown, |axis| axes[axis][usize::from(mean[axis] < 0.0)])
}

/// Length of the mean of the cameras' upright directions below which they stand anyhow.
const MIN_AGREEMENT: f64 = 0.4;
/// Of the angle between that mean and an axis: 30 degrees.
const MIN_COSINE: f64 = 0.866;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_is_where_cameras_stand_upright() {
        let ring = |up: [f64; 3], sideways: [f64; 3]| -> Vec<(usize, Camera)> {
            let eyes = [1.0, -1.0].map(|s| [0, 1, 2].map(|i| 3.0 * s * sideways[i] + 1.5 * up[i]));
            eyes.map(|eye| (0, Camera::look_at(eye, [0.0; 3], up, 50.0, 64, 48))).to_vec()
        };
        assert_eq!(up_axis(&ring([0.0, -1.0, 0.0], [0.0, 0.0, 1.0])), UpAxis::MinusY);
        assert_eq!(up_axis(&ring([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])), UpAxis::PlusZ);
        assert_eq!(up_axis(&ring([0.1, 0.0, 1.0], [0.0, 1.0, 0.0])), UpAxis::PlusZ);
        assert_eq!(up_axis(&ring([0.0, 0.7, 0.7], [1.0, 0.0, 0.0])), UpAxis::Unknown);
        assert_eq!(up_axis(&[]), UpAxis::Unknown);
    }
}

//! The share of a subject that a camera shows, and the choice of the first camera.

use super::{Subject, far};
use crate::{Activated, Camera, Pinhole, add_scaled, dot, length, rotmat_from_unit_quat, sub};

/// Rays of a view along each side of the square around the subject; those in its corners are left out.
const RAYS: usize = 5;
/// Radius of the disc of rays, least and most, in shorter sides of the picture.
const DISC: [f64; 2] = [0.1, 0.4];
/// Least share of the subject that a good view shows.
const MIN_SHOWN: f64 = 0.5;
/// Standard deviations within which an opaque Gaussian adds an 8-bit step to a picture: `√(2 ln 255)`.
const REACH: f64 = 3.33;

impl Subject {
    /// The share of the subject that a camera shows: 0 outside of the picture, behind fog and in darkness; 1 for an
    /// opaque subject with nothing before it.
    ///
    /// Blends a few rays as a renderer does. Products of transparencies need no sorting.
    ///
    /// - `drawn`: one timestep; its colours do not matter
    /// - returns: the blending weight of all Gaussians that are not nearer than the subject, mean over a disc around it
    ///
    /// # Departure
    /// A renderer projects Gaussians and widens them by a part of a pixel. Here a Gaussian counts with its greatest
    /// density along the ray.
    pub fn shown_by(&self, camera: &Camera, drawn: &Activated) -> f64 {
        let pinhole = Pinhole::<f64>::new(camera);
        let Some((middle, depth)) = pinhole.project(self.center) else { return 0.0 };
        let side = camera.width.min(camera.height) as f64;
        let disc = (camera.focal[0] * self.radius / depth).clamp(DISC[0] * side, DISC[1] * side);
        let near = depth - self.radius.min(depth / 2.0);
        // Each ray within the picture has two transparencies: of all that is nearer than the subject, and of
        // everything.
        let places: Vec<[f64; 2]> = disc_places().map(|[x, y]| [middle[0] + disc * x, middle[1] + disc * y]).collect();
        let is_inside = |[x, y]: [f64; 2]| x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64;
        let mut rays: Vec<([f64; 3], [f64; 2])> =
            places.iter().filter(|&&place| is_inside(place)).map(|&place| (pinhole.ray(place), [1.0; 2])).collect();
        let axis = pinhole.ray(middle);
        for i in 0..drawn.num_gaussians() {
            let offset = sub(drawn.means[i].map(f64::from), pinhole.center);
            let z = dot(pinhole.forward(), offset);
            let reach = REACH * f64::from(drawn.scales[i].iter().copied().fold(0.0, f32::max));
            let across = add_scaled(offset, -z, axis);
            if z > 0.0 && length(across) <= reach * length(axis) + z * disc / camera.focal[0] {
                let of_near = usize::from(z >= near);
                for (ray, passes) in &mut rays {
                    let passing = 1.0 - alpha_along(*ray, offset, drawn, i);
                    passes[1] *= passing;
                    passes[0] *= if of_near == 0 { passing } else { 1.0 };
                }
            }
        }
        rays.iter().map(|(_, [before, all])| before - all).sum::<f64>() / places.len() as f64
    }

    /// The first camera that shows at least half of the subject ([`Self::shown_by`]); without one, the camera that
    /// shows most.
    ///
    /// - `cameras`: the preferred ones first
    /// - `drawn`: one timestep
    /// - returns: its place among the cameras; `None` without cameras
    pub fn first_shown<'a>(&self, cameras: impl IntoIterator<Item = &'a Camera>, drawn: &Activated) -> Option<usize> {
        let mut most: Option<(usize, f64)> = None;
        for (i, camera) in cameras.into_iter().enumerate() {
            let shown = self.shown_by(camera, drawn);
            if shown >= MIN_SHOWN {
                return Some(i);
            }
            if most.is_none_or(|(_, other)| shown > other) {
                most = Some((i, shown));
            }
        }
        most.map(|(i, _)| i)
    }

    /// Indices of cameras by their distance from the mean of all positions, nearest first. Equal distances keep their
    /// order.
    pub fn inner_first(cameras: &[Camera]) -> Vec<usize> {
        let middle: [f64; 3] = std::array::from_fn(|axis| {
            cameras.iter().map(|camera| camera.center()[axis]).sum::<f64>() / cameras.len().max(1) as f64
        });
        let mut order: Vec<usize> = (0..cameras.len()).collect();
        order.sort_by(|&a, &b| far(&cameras[a], middle).total_cmp(&far(&cameras[b], middle)));
        order
    }
}

/// Places on the disc of radius 1, in rows.
fn disc_places() -> impl Iterator<Item = [f64; 2]> {
    let at = |i: usize| 2.0 * i as f64 / (RAYS - 1) as f64 - 1.0;
    (0..RAYS * RAYS).map(move |i| [at(i % RAYS), at(i / RAYS)]).filter(|&[x, y]| x * x + y * y < 1.5)
}

/// The greatest alpha of a Gaussian along a ray, 0 behind the ray's origin.
///
/// - `ray`: direction in the world, any length
/// - `offset`: of the Gaussian's centre from the ray's origin
fn alpha_along(ray: [f64; 3], offset: [f64; 3], drawn: &Activated, i: usize) -> f64 {
    let world_from_local = rotmat_from_unit_quat(drawn.quats[i].map(f64::from));
    let in_deviations = |v: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|axis| {
            let column = [0, 1, 2].map(|row| world_from_local[row][axis]);
            dot(column, v) / f64::from(drawn.scales[i][axis]).max(1e-9)
        })
    };
    let (along, to) = (in_deviations(ray), in_deviations(offset));
    let (forward, squared) = (dot(along, to), dot(along, along));
    if forward <= 0.0 || squared <= 0.0 {
        return 0.0;
    }
    let exponent = 0.5 * (dot(to, to) - forward * forward / squared).max(0.0);
    f64::from(drawn.opacities[i]) * (-exponent).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Gaussians, activate};

    const UP: [f64; 3] = [0.0, -1.0, 0.0];
    const SUBJECT: Subject = Subject { center: [0.0; 3], radius: 0.5, distance: 4.0 };

    /// Round Gaussians: centre, deviation, opacity as stored.
    fn scene(of: &[([f32; 3], f32, f32)]) -> Activated {
        let mut gaussians = Gaussians::zeros(of.len());
        for (i, &(mean, deviation, logit)) in of.iter().enumerate() {
            gaussians.means_mut()[i] = mean;
            gaussians.log_scales_mut()[i] = [deviation.ln(); 3];
            gaussians.logit_opacities_mut()[i] = logit;
            gaussians.quats_mut()[i] = [1.0, 0.0, 0.0, 0.0];
        }
        activate(&gaussians)
    }

    fn camera(position: [f64; 3], target: [f64; 3]) -> Camera {
        Camera::look_at(position, target, UP, 50.0, 64, 48)
    }

    #[test]
    fn fog_and_darkness_do_not_show_the_subject() {
        let front = camera([0.0, 0.0, -4.0], [0.0; 3]);
        let person = ([0.0; 3], 0.6, 6.0);
        assert!(SUBJECT.shown_by(&front, &scene(&[person])) > 0.7);
        assert_eq!(SUBJECT.shown_by(&front, &scene(&[])), 0.0, "nothing there");
        let wall = ([0.0, 0.0, 6.0], 3.0, 6.0);
        assert!(SUBJECT.shown_by(&front, &scene(&[wall])) > 0.9, "what is behind it counts");
        let fog: Vec<_> = (0..5_u8).map(|i| ([0.0, 0.0, -3.0 + 0.2 * f32::from(i)], 1.5, -0.5)).collect();
        let foggy = scene(&[&fog[..], &[person]].concat());
        assert!(SUBJECT.shown_by(&front, &foggy) < 0.2);
        // Seen from behind, the fog lies behind the subject.
        assert!(SUBJECT.shown_by(&camera([0.0, 0.0, 4.0], [0.0; 3]), &foggy) > 0.7);
        assert_eq!(SUBJECT.shown_by(&camera([0.0, 0.0, -4.0], [0.0, 0.0, -9.0]), &scene(&[person])), 0.0, "looks away");
        assert!(SUBJECT.shown_by(&camera([0.0, 0.0, -4.0], [2.56, 0.0, 0.0]), &scene(&[person])) < 0.5, "at the edge");
    }

    #[test]
    fn a_ray_blends_as_the_formula_says() {
        // An opacity of 0.5, through the middle and a deviation beside it.
        let drawn = scene(&[([0.0, 0.0, 2.0], 0.5, 0.0)]);
        assert!((alpha_along([0.0, 0.0, 3.0], [0.0, 0.0, 2.0], &drawn, 0) - 0.5).abs() < 1e-6);
        let beside = alpha_along([0.0, 0.0, 1.0], [0.5, 0.0, 2.0], &drawn, 0);
        assert!((beside - 0.5 * (-0.5_f64).exp()).abs() < 1e-6, "{beside}");
        assert_eq!(alpha_along([0.0, 0.0, -1.0], [0.0, 0.0, 2.0], &drawn, 0), 0.0);
        // Stretched by four along x and turned by a right angle about z, it reaches along y.
        let mut gaussians = Gaussians::zeros(1);
        gaussians.log_scales_mut()[0] = [2.0_f32.ln(), 0.5_f32.ln(), 0.5_f32.ln()];
        gaussians.quats_mut()[0] = [0.5_f32.sqrt(), 0.0, 0.0, 0.5_f32.sqrt()];
        let turned = activate(&gaussians);
        let at = |offset: [f64; 3]| alpha_along([0.0, 0.0, 1.0], offset, &turned, 0);
        assert!((at([0.0, 2.0, 5.0]) - at([0.5, 0.0, 5.0])).abs() < 1e-6 && at([0.0, 2.0, 5.0]) > 0.3);
    }

    #[test]
    fn the_first_that_shows_the_subject_is_taken() {
        let cameras = [[0.0, 0.0, -4.0], [4.0, 0.0, 0.0], [0.0, 0.0, 4.0]].map(|at| camera(at, [0.0; 3]));
        let person = ([0.0; 3], 0.6, 6.0);
        let before = |[x, z]: [f32; 2]| ([x, 0.0, z], 1.0, 6.0);
        let first = |drawn: &Activated| SUBJECT.first_shown(&cameras, drawn);
        assert_eq!(first(&scene(&[person])), Some(0));
        assert_eq!(first(&scene(&[person, before([0.0, -3.0])])), Some(1));
        assert_eq!(first(&scene(&[person, before([0.0, -3.0]), before([3.0, 0.0])])), Some(2));
        let thin = ([0.0, 0.0, 3.0], 1.0, 1.0);
        let hidden = scene(&[person, before([0.0, -3.0]), before([3.0, 0.0]), thin]);
        assert_eq!(first(&hidden), Some(2), "none shows half; this one the most");
        assert_eq!(SUBJECT.first_shown(&[], &hidden), None);
    }

    #[test]
    fn cameras_in_the_middle_come_first() {
        let row: Vec<Camera> = [0.0, 1.0, 2.0, 3.0, 4.0].map(|x| camera([x, 0.0, -4.0], [x, 0.0, 0.0])).to_vec();
        assert_eq!(Subject::inner_first(&row), [2, 1, 3, 0, 4]);
        assert_eq!(Subject::inner_first(&[]), [0; 0]);
    }
}

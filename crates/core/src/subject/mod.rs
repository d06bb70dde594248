//! The subject of a scene: the point at which views aim. It follows from the moving Gaussians (here) or from the
//! cameras (`axes`). `shown` measures whether a camera shows it. What does not live here: the cameras of a path
//! ([`Tour`](crate::Tour)).

mod axes;
mod shown;

use self::axes::meeting_point;
pub(crate) use self::axes::{PARALLEL, nearest_to_axes};
use crate::{Camera, Extent, Gaussians, distance, sigmoid};

/// A Gaussian moves if its motion exceeds this many times the median of all, which is the jitter of training.
const JITTERS: f64 = 6.0;
/// A Gaussian moves if its motion exceeds this share of that of the faster fourth of the moving ones.
const SHARE_OF_FAST: f64 = 0.25;
/// Least and greatest share of the scene's opacity that a moving subject has. Fewer Gaussians are strays; if more move,
/// the whole scene does.
const MOVING: [f64; 2] = [5e-4, 0.5];
/// Radius of the moving Gaussians, in radii of the scene, above which they are spread over the scene and no subject.
const MAX_SPREAD: f64 = 0.75;
/// The subject's middle lies halfway between these quantiles along each axis. A median would choose one of two people.
const MIDDLE: [f64; 2] = [0.25, 0.75];
/// Share of the moving Gaussians within the subject's radius.
const WITHIN: f64 = 0.6;

/// Distance of a view from the middle, in radii of the scene's [`Extent`], without cameras and motion. A captured scene
/// is mostly its surroundings, and the cameras that captured it stood just within them.
pub(crate) const DISTANCE: f64 = 0.85;
/// Distance of a view from the moving Gaussians, in their radii, if there are no cameras.
const DISTANCE_OF_MOVING: f64 = 3.0;
/// Least share of the Gaussians that lie nearer to the subject than such a view, so that a ball is seen with its
/// surroundings.
const BEFORE: f64 = 0.02;
/// Least radius, scene units, so that a scene of one point can be viewed too.
pub(crate) const MIN_RADIUS: f64 = 1e-3;

/// The point at which views of a scene aim, and the size of the object there.
///
/// ```
/// use tcgs_core::{Camera, Gaussians, Subject};
/// // A shell far away behind what two cameras look at.
/// let mut gaussians = Gaussians::zeros(50);
/// gaussians.means_mut().fill([0.0, 0.0, 40.0]);
/// let camera = |x| Camera::look_at([x, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let subject = Subject::of(&gaussians, &[], &[camera(-3.0), camera(3.0)]);
/// assert!(subject.center[2].abs() < 1.0);
/// assert!(Subject::of(&gaussians, &[], &[]).center[2] == 40.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Subject {
    /// Its middle in the world, scene units.
    pub center: [f64; 3],
    /// Distance from the middle within which most of it lies, scene units.
    pub radius: f64,
    /// Distance from which it is seen, scene units: the median of the cameras'.
    pub distance: f64,
}

impl Subject {
    /// The first of these that the scene has:
    ///
    /// 1. the moving Gaussians, if they are a clear minority and most cameras see them
    /// 2. the point at which the axes of the cameras meet
    /// 3. the median of the centres
    ///
    /// - `gaussians`: one timestep, in stored form, finite
    /// - `moved`: `[N]` motion of each Gaussian over other timesteps ([`add_motion`]), scene units; empty if unknown
    /// - `cameras`: of the capture; may be empty
    ///
    /// # Panics
    /// If `moved` is not empty and does not have a value for each Gaussian.
    pub fn of(gaussians: &Gaussians, moved: &[f32], cameras: &[Camera]) -> Self {
        assert!(moved.is_empty() || moved.len() == gaussians.num_gaussians(), "{} distances moved", moved.len());
        let extent = Extent::of(gaussians.means());
        let moving = moving(gaussians, moved).filter(|moving| {
            let seeing = cameras.iter().filter(|camera| sees(camera, moving.0)).count();
            moving.1 <= MAX_SPREAD * extent.radius && 2 * seeing >= cameras.len()
        });
        match moving {
            Some((center, radius)) if cameras.is_empty() => {
                let of_scene = DISTANCE * extent.radius.max(MIN_RADIUS);
                let distances = gaussians.means().iter().map(|mean| (distance(mean.map(f64::from), center), 1.0));
                let before = quantile(distances, BEFORE);
                Self { center, radius, distance: (DISTANCE_OF_MOVING * radius).max(before).min(of_scene) }
            }
            Some((center, radius)) => Self { center, radius, distance: distance_of(cameras, center) },
            None if cameras.is_empty() => {
                let Extent { center, radius } = extent;
                Self { center, radius, distance: DISTANCE * radius.max(MIN_RADIUS) }
            }
            None => {
                let center = meeting_point(gaussians, cameras);
                let half = |camera: &Camera| 0.5 * camera.width.min(camera.height) as f64 / camera.focal[0];
                let radius = median(cameras.iter().map(|camera| 0.5 * half(camera) * far(camera, center)));
                Self { center, radius, distance: distance_of(cameras, center) }
            }
        }
    }
}

/// Raises the motion of each Gaussian to at least its distance from its centre at another timestep.
///
/// - `moved`: `[N]` motion so far, scene units
/// - `rows`: for each Gaussian its row in `moved`, its centre now, and its centre at the other timestep
///
/// ```
/// let mut moved = [0.0, 0.0];
/// tcgs_core::add_motion(&mut moved, [(1, [0.0; 3], [0.0, 3.0, 4.0])]);
/// assert_eq!(moved, [0.0, 5.0]);
/// ```
pub fn add_motion(moved: &mut [f32], rows: impl IntoIterator<Item = (usize, [f32; 3], [f32; 3])>) {
    for (row, now, then) in rows {
        moved[row] = moved[row].max(distance(then.map(f64::from), now.map(f64::from)) as f32);
    }
}

/// Middle and radius of the Gaussians that move, by opacity and distance; `None` if they are no clear minority.
fn moving(gaussians: &Gaussians, moved: &[f32]) -> Option<([f64; 3], f64)> {
    let opacity: Vec<f64> = gaussians.logit_opacities().iter().map(|&logit| sigmoid(f64::from(logit))).collect();
    let jitter = JITTERS * median(moved.iter().map(|&moved| f64::from(moved)));
    let of =
        |least: f64| moved.iter().map(|&moved| f64::from(moved)).zip(&opacity).filter(move |&(moved, _)| moved > least);
    let fast = quantile(of(jitter).map(|(moved, &opacity)| (moved, opacity)), 0.75);
    let least = jitter.max(SHARE_OF_FAST * fast);
    let share = of(least).map(|(_, opacity)| opacity).sum::<f64>() / opacity.iter().sum::<f64>();
    // NaN, of a scene without opacity, is no share either.
    if !(MOVING[0]..=MOVING[1]).contains(&share) {
        return None;
    }
    let rows = gaussians.means().iter().zip(moved).zip(&opacity).filter(|((_, moved), _)| f64::from(**moved) > least);
    let weighted: Vec<([f64; 3], f64)> =
        rows.map(|((mean, moved), opacity)| (mean.map(f64::from), opacity * f64::from(*moved).min(fast))).collect();
    let along = |axis: usize, share| quantile(weighted.iter().map(|(mean, weight)| (mean[axis], *weight)), share);
    let center = std::array::from_fn(|axis| 0.5 * (along(axis, MIDDLE[0]) + along(axis, MIDDLE[1])));
    Some((center, quantile(weighted.iter().map(|&(mean, weight)| (distance(mean, center), weight)), WITHIN)))
}

/// Whether a point lies in a camera's picture.
fn sees(camera: &Camera, point: [f64; 3]) -> bool {
    let inside = |[x, y]: [f64; 2]| x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64;
    camera.project(point).is_some_and(|(place, _)| inside(place))
}

/// Distance of a camera from a point.
fn far(camera: &Camera, point: [f64; 3]) -> f64 {
    distance(camera.center(), point)
}

fn distance_of(cameras: &[Camera], point: [f64; 3]) -> f64 {
    median(cameras.iter().map(|camera| far(camera, point))).max(MIN_RADIUS)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(values.map(|value| (value, 1.0)), 0.5)
}

/// The value below which a share of the weights lies; 0 of no values.
fn quantile(values: impl Iterator<Item = (f64, f64)>, share: f64) -> f64 {
    let mut values: Vec<(f64, f64)> = values.collect();
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let due = share * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let found = values.iter().find(|(_, weight)| {
        sum += weight;
        sum >= due
    });
    found.or(values.last()).map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 3] = [0.0, -1.0, 0.0];

    /// An opaque shell of radius 20, and two people at x = -1 and x = 1, z = -1, with a tenth as many Gaussians.
    fn shell_and_people() -> Gaussians {
        let mut gaussians = Gaussians::zeros(2200);
        gaussians.logit_opacities_mut().fill(3.0);
        for (i, mean) in gaussians.means_mut().iter_mut().enumerate() {
            let (turn, i) = (i as f32 * 2.4, i as f32);
            *mean = if i < 2000.0 {
                let height = i / 1000.0 - 1.0;
                let out = (1.0 - height * height).sqrt();
                [20.0 * out * turn.cos(), 20.0 * height, 20.0 * out * turn.sin()]
            } else {
                let side = if i % 2.0 == 0.0 { 1.0 } else { -1.0 };
                [side + 0.2 * turn.cos(), 0.8 * (0.7 * i).sin(), -1.0 + 0.2 * turn.sin()]
            };
        }
        gaussians
    }

    /// The people walk by `step`; of the shell a Gaussian in a hundred strays far, the others by a little.
    fn moved(step: f32) -> Vec<f32> {
        let of = |i: usize| {
            if i >= 2000 {
                step * (1.0 + (i % 3) as f32)
            } else if i.is_multiple_of(100) {
                9.0 * step
            } else {
                1e-3
            }
        };
        (0..2200).map(of).collect()
    }

    fn ring(count: u8, target: [f64; 3]) -> Vec<Camera> {
        let angle = |i: u8| std::f64::consts::TAU * f64::from(i) / f64::from(count);
        let at = |a: f64| [target[0] + 4.0 * a.sin(), target[1] - 1.0, target[2] - 4.0 * a.cos()];
        (0..count).map(|i| Camera::look_at(at(angle(i)), target, UP, 50.0, 64, 48)).collect()
    }

    fn assert_near(subject: Subject, center: [f64; 3], within: f64) {
        let far = distance(subject.center, center);
        assert!(far < within, "{subject:?} is {far} from {center:?}");
    }

    #[test]
    fn what_moves_is_the_subject_whatever_surrounds_it() {
        let gaussians = shell_and_people();
        for cameras in [vec![], ring(4, [0.0, 0.0, -1.0])] {
            let subject = Subject::of(&gaussians, &moved(0.1), &cameras);
            assert_near(subject, [0.0, 0.0, -1.0], 0.35);
            assert!((0.8..2.0).contains(&subject.radius), "both people: {subject:?}");
            assert!((2.0..6.0).contains(&subject.distance), "not from the shell: {subject:?}");
        }
    }

    #[test]
    fn all_that_moves_or_nothing_is_no_subject() {
        let gaussians = shell_and_people();
        let still = Subject::of(&gaussians, &[], &[]);
        let Extent { center, radius } = Extent::of(gaussians.means());
        assert_eq!((still.center, still.radius, still.distance), (center, radius, 0.85 * radius));
        let of =
            |moved: &dyn Fn(usize) -> f32| Subject::of(&gaussians, &(0..2200).map(moved).collect::<Vec<f32>>(), &[]);
        assert_eq!(of(&|_| 0.5), still, "the scene as a whole");
        assert_eq!(of(&|i| 0.01 + 0.001 * (i % 7) as f32), still, "jitter");
        assert_eq!(of(&|i| if i % 20 == 3 && i < 2000 { 0.3 } else { 0.0 }), still, "here and there on the shell");
        assert_eq!(of(&|i| if i == 2100 { 5.0 } else { 0.0 }), still, "a stray one");
    }

    #[test]
    fn what_moves_out_of_the_pictures_is_no_subject() {
        let target = [0.0, 0.0, 6.0];
        let away: Vec<Camera> =
            (0..9_u8).map(|i| Camera::look_at([f64::from(i) - 4.0, 0.0, 2.0], target, UP, 50.0, 64, 48)).collect();
        assert_near(Subject::of(&shell_and_people(), &moved(0.1), &away), target, 0.2);
    }

    #[test]
    fn without_motion_axes_say_where_to_look() {
        let target = [0.5, -0.3, 1.0];
        for count in [4, 24] {
            let subject = Subject::of(&shell_and_people(), &[], &ring(count, target));
            assert_near(subject, target, 0.1);
            assert!((4.0..4.3).contains(&subject.distance) && (0.4..1.1).contains(&subject.radius), "{subject:?}");
        }
    }

    #[test]
    fn distances_are_the_greatest() {
        let mut moved = [0.5, 0.0];
        add_motion(&mut moved, [(0, [1.0; 3], [1.0, 1.0, 1.25]), (1, [0.0; 3], [0.0, 0.0, -2.0])]);
        assert_eq!(moved, [0.5, 2.0]);
    }

    #[test]
    fn the_smallest_scenes_have_a_subject() {
        for gaussians in [Gaussians::zeros(0), Gaussians::zeros(1)] {
            for cameras in [vec![], ring(1, [0.0; 3]), vec![ring(1, [0.0; 3])[0].clone(); 3]] {
                let Subject { center, radius, distance } = Subject::of(&gaussians, &[], &cameras);
                assert!(center.iter().chain([&radius]).all(|x| x.is_finite()) && distance > 0.0);
            }
        }
    }
}

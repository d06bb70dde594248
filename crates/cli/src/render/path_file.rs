//! A camera path that was saved from the player: views at timesteps, and the cameras between them.

use std::fs;
use std::path::Path;

use serde::Deserialize;
use tcgs_core::{Camera, dot, normalize};
use tcgs_play::Lens;

use crate::error::wrong_input;
use crate::options::Size;
use crate::scene::unreadable;

const FORMAT: &str = "tcgs-camera-path";

/// The file.
#[derive(Deserialize)]
struct Document {
    format: String,
    version: u32,
    cameras: Vec<Key>,
}

/// A view at a timestep, as the player gives and takes it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
struct Key {
    timestep: f64,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// `[4][4]` row-major.
    camera_from_world: [f64; 16],
}

/// Views at timesteps that increase, at least one.
#[derive(Debug)]
pub struct PathFile {
    keys: Vec<(f64, Camera)>,
}

impl PathFile {
    /// Reads a file.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let expected = "a camera path that the player saved";
        let bytes = fs::read(path).map_err(|error| unreadable(path, error, expected))?;
        Self::parse(&bytes)
            .map_err(|problem| wrong_input(format!("{}: {problem}, expected {expected}", path.display())))
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let document: Document = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if (document.format.as_str(), document.version) != (FORMAT, 1) {
            return Err(format!("format {:?} version {}", document.format, document.version));
        }
        let mut keys: Vec<(f64, Camera)> = Vec::new();
        for (index, key) in document.cameras.into_iter().enumerate() {
            if keys.last().is_some_and(|(before, _)| *before >= key.timestep) {
                return Err(format!("camera {index} has timestep {}, not later than the one before", key.timestep));
            }
            if !(Size { width: key.width, height: key.height }).is_legal() {
                return Err(format!("camera {index} has {}x{} pixels, more than 16384", key.width, key.height));
            }
            let intrinsics = [[key.fx, 0.0, key.cx], [0.0, key.fy, key.cy], [0.0, 0.0, 1.0]];
            let m = key.camera_from_world;
            let camera_from_world = std::array::from_fn(|row| std::array::from_fn(|column| m[4 * row + column]));
            let camera = Camera::new(key.width, key.height, intrinsics, camera_from_world)
                .map_err(|error| format!("camera {index}: {error}"))?;
            keys.push((key.timestep, camera));
        }
        if keys.is_empty() { Err("no cameras".into()) } else { Ok(Self { keys }) }
    }

    /// The camera at a timestep, in pictures of a size; before the first view and after the last it stands still.
    ///
    /// Position, axes and intrinsics follow cubic Hermite splines whose slope at a view is that of a parabola through it
    /// and its neighbours; the axes are made orthonormal again. The player's page computes the same.
    ///
    /// - `size`: the first view's where none is given; of another shape, all that a view shows is shown
    pub fn camera(&self, timestep: f64, size: Option<Size>) -> Camera {
        let (_, first) = &self.keys[0];
        let size = size.unwrap_or(Size { width: first.width, height: first.height });
        let after = self.keys.partition_point(|(t, _)| *t <= timestep);
        let key = &self.keys[after.saturating_sub(1)];
        if after == 0 || after == self.keys.len() || key.0 == timestep {
            return fitted(&key.1, size);
        }
        let (from, to) = (self.numbers(after - 1, size), self.numbers(after, size));
        let (from_slope, to_slope) = (self.slopes(after - 1, size), self.slopes(after, size));
        let span = self.keys[after].0 - key.0;
        let s = (timestep - key.0) / span;
        let (s2, s3) = (s * s, s * s * s);
        let mixed: [f64; NUMBERS] = std::array::from_fn(|i| {
            (2.0 * s3 - 3.0 * s2 + 1.0) * from[i]
                + (s3 - 2.0 * s2 + s) * span * from_slope[i]
                + (3.0 * s2 - 2.0 * s3) * to[i]
                + (s3 - s2) * span * to_slope[i]
        });
        camera_of(&mixed, size)
    }

    fn numbers(&self, key: usize, size: Size) -> [f64; NUMBERS] {
        numbers_of(&fitted(&self.keys[key].1, size))
    }

    /// Of the parabola through the view and its neighbours, at an end the two nearest; of two views, of the line.
    fn slopes(&self, key: usize, size: Size) -> [f64; NUMBERS] {
        let count = self.keys.len();
        if count == 2 {
            let (from, to, span) = (self.numbers(0, size), self.numbers(1, size), self.keys[1].0 - self.keys[0].0);
            return std::array::from_fn(|i| (to[i] - from[i]) / span);
        }
        let first = key.saturating_sub(1).min(count - 3);
        let [t0, t1, t2] = [0, 1, 2].map(|i| self.keys[first + i].0);
        let at = self.keys[key].0;
        let weights = [
            (2.0 * at - t1 - t2) / ((t0 - t1) * (t0 - t2)),
            (2.0 * at - t0 - t2) / ((t1 - t0) * (t1 - t2)),
            (2.0 * at - t0 - t1) / ((t2 - t0) * (t2 - t1)),
        ];
        let points = [0, 1, 2].map(|i| self.numbers(first + i, size));
        std::array::from_fn(|i| (0..3).map(|k| weights[k] * points[k][i]).sum())
    }
}

/// What is interpolated of a camera: centre, forward and down axis, focal lengths, principal point.
const NUMBERS: usize = 13;

fn numbers_of(camera: &Camera) -> [f64; NUMBERS] {
    let [x, y, z] = camera.center();
    let [_, down, forward, _] = camera.camera_from_world;
    let ([fx, fy], [cx, cy]) = (camera.focal, camera.principal);
    [x, y, z, forward[0], forward[1], forward[2], down[0], down[1], down[2], fx, fy, cx, cy]
}

fn camera_of(numbers: &[f64; NUMBERS], size: Size) -> Camera {
    let vector = |first: usize| [numbers[first], numbers[first + 1], numbers[first + 2]];
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let (center, z) = (vector(0), normalize(vector(3)));
    let x = normalize(cross(vector(6), z));
    let y = cross(z, x);
    let row = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -dot(axis, center)];
    let &[.., fx, fy, cx, cy] = numbers;
    Camera {
        width: size.width,
        height: size.height,
        focal: [fx, fy],
        principal: [cx, cy],
        camera_from_world: [row(x), row(y), row(z), [0.0, 0.0, 0.0, 1.0]],
    }
}

/// The same view in a picture of another size: square pixels, and all that it shows is shown.
fn fitted(camera: &Camera, size: Size) -> Camera {
    let Size { width, height } = size;
    let (focal, principal) = Lens::of(camera).at([width, height]);
    Camera { width, height, focal, principal, camera_from_world: camera.camera_from_world }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 3] = [0.0, -1.0, 0.0];

    fn path() -> PathFile {
        let at =
            |angle: f64| Camera::look_at([3.0 * angle.sin(), -1.0, -3.0 * angle.cos()], [0.0; 3], UP, 80.0, 100, 60);
        PathFile { keys: vec![(2.0, at(0.0)), (4.0, at(0.5)), (7.0, at(1.25)), (8.0, at(1.5))] }
    }

    fn distance(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn views_are_met_exactly_and_held_beyond_the_ends() {
        let path = path();
        for (timestep, camera) in &path.keys {
            assert_eq!(&path.camera(*timestep, None), camera);
        }
        assert_eq!(path.camera(0.0, None), path.keys[0].1);
        assert_eq!(path.camera(9.5, None), path.keys[3].1);
    }

    #[test]
    fn between_views_the_camera_moves_smoothly_and_keeps_looking() {
        let path = path();
        for i in 0..=60 {
            let timestep = 2.0 + 0.1 * f64::from(i);
            let camera = path.camera(timestep, None);
            // The views lie on a circle, a quarter of a radian a timestep apart.
            let angle = 0.25 * (timestep - 2.0);
            let center = [3.0 * angle.sin(), -1.0, -3.0 * angle.cos()];
            assert!(distance(&camera.center(), &center) < 0.05, "{timestep}: {:?}", camera.center());
            let to_middle = normalize(camera.center().map(|x| -x));
            assert!(dot(camera.forward(), to_middle) > 0.999);
            let [fx, fy] = camera.focal;
            assert!((fx - 80.0).abs() < 1e-9 && (fy - 80.0).abs() < 1e-9);
            let k = [[fx, 0.0, 50.0], [0.0, fy, 30.0], [0.0, 0.0, 1.0]];
            assert!(Camera::new(100, 60, k, camera.camera_from_world).is_ok());
            let next = path.camera(timestep + 1e-6, None);
            assert!(distance(&camera.center(), &next.center()) < 1e-5, "no jump");
        }
    }

    #[test]
    fn another_size_shows_all_that_a_view_shows() {
        let wide = path().camera(2.0, Some(Size { width: 400, height: 120 }));
        assert_eq!((wide.focal, wide.principal), ([160.0; 2], [200.0, 60.0]));
        let tall = path().camera(2.0, Some(Size { width: 50, height: 120 }));
        assert_eq!((tall.focal, tall.principal), ([40.0; 2], [25.0, 60.0]));
        assert_eq!(wide.camera_from_world, path().keys[0].1.camera_from_world);
    }

    #[test]
    fn what_is_no_path_is_refused() {
        let camera = |timestep: f64, first: f64| {
            format!(
                r#"{{"timestep":{timestep},"width":4,"height":3,"fx":5,"fy":5,"cx":2,"cy":1.5,"cameraFromWorld":[{first},0,0,0,0,1,0,0,0,0,1,2,0,0,0,1]}}"#
            )
        };
        let document = |cameras: &str| format!(r#"{{"format":"{FORMAT}","version":1,"cameras":[{cameras}]}}"#);
        let good = PathFile::parse(document(&camera(0.5, 1.0)).as_bytes()).unwrap();
        assert_eq!((good.keys[0].0, good.keys[0].1.center()), (0.5, [0.0, 0.0, -2.0]));
        let cases = [
            ("{}".into(), "missing field `format`"),
            ("nonsense".into(), "expected"),
            (document(""), "no cameras"),
            (document(&camera(0.0, 1.0)).replace("\"version\":1", "\"version\":2"), "version 2"),
            (document(&camera(0.0, 2.0)), "camera 0: the upper left 3x3 of w2c is not a rotation"),
            (document(&camera(0.0, 1.0)).replace("\"fx\":5,", ""), "missing field `fx`"),
            (document(&format!("{0},{0}", camera(3.0, 1.0))), "camera 1 has timestep 3, not later"),
        ];
        for (text, expected) in cases {
            let error = PathFile::parse(text.as_bytes()).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}

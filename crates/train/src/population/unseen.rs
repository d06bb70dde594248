//! Points outside of all training images: no loss constrains them, but other cameras see them.
//!
//! Such points keep the places and colours of the capture. Since nothing is learned of them, a few of them are enough.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, PointCloud, squared_distance};

/// Fewest cells for a capture's unseen points, so that small scenes have some.
const MIN_CELLS: usize = 1000;

/// Growth of the cells until they are few enough.
const GROWTH: f32 = 1.25;

/// Whether each point is in the image of a camera, hidden or not.
///
/// - `points`: `[P, 3]`, scene units
/// - returns: `[P]`
pub fn are_in_images(points: &[[f32; 3]], cameras: &[Camera]) -> Vec<bool> {
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    points.par_iter().map(|&point| pinholes.iter().any(|pinhole| pinhole.pixel(point).is_some())).collect()
}

/// Reduces the points that are in no image to a few.
///
/// - `cameras`: cameras of the images
/// - `share`: largest number of these points, as a share of those in images
/// - returns: the points in images, then the reduced ones
pub(crate) fn gather_unseen(cloud: &PointCloud, cameras: &[Camera], share: f32) -> PointCloud {
    let is_seen = are_in_images(&cloud.points, cameras);
    let rows = |wanted: bool| (0..is_seen.len()).filter(|&i| is_seen[i] == wanted).collect::<Vec<_>>();
    let (seen, unseen) = (rows(true), rows(false));
    let most = ((share * seen.len() as f32) as usize).max(MIN_CELLS);
    let mut gathered = PointCloud {
        points: seen.iter().map(|&i| cloud.points[i]).collect(),
        colors: seen.iter().map(|&i| cloud.colors[i]).collect(),
        foreground: seen.iter().map(|&i| cloud.foreground[i]).collect(),
    };
    for cell in cells(&cloud.points, &unseen, most) {
        let mean = |of: &[[f32; 3]]| -> [f32; 3] {
            std::array::from_fn(|axis| cell.iter().map(|&i| of[i][axis]).sum::<f32>() / cell.len() as f32)
        };
        // A point of the surface, because the mean around a corner lies in the air.
        let middle = mean(&cloud.points);
        let distance = |i: usize| squared_distance(cloud.points[i], middle);
        let nearest = cell.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        gathered.points.extend(nearest.map(|i| cloud.points[i]));
        gathered.colors.push(mean(&cloud.colors));
        gathered.foreground.push(2 * cell.iter().filter(|&&i| cloud.foreground[i]).count() > cell.len());
    }
    gathered
}

/// Divides points into at most `most` cubes of equal size, in an order of their own.
///
/// - `rows`: indices of the points
fn cells(points: &[[f32; 3]], rows: &[usize], most: usize) -> Vec<Vec<usize>> {
    if rows.len() <= most {
        return rows.iter().map(|&i| vec![i]).collect();
    }
    let ends = |fold: fn(f32, f32) -> f32, from: f32| -> [f32; 3] {
        std::array::from_fn(|axis| rows.iter().map(|&i| points[i][axis]).fold(from, fold))
    };
    let (low, high) = (ends(f32::min, f32::INFINITY), ends(f32::max, f32::NEG_INFINITY));
    let extent = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f32::max);
    // On a square surface of this extent, cells of the initial edge number 16 times `most`; the edge then grows.
    let mut edge = extent / (most as f32).sqrt() / 4.0;
    loop {
        let mut cells: BTreeMap<[u32; 3], Vec<usize>> = BTreeMap::new();
        for &i in rows {
            let cell = std::array::from_fn(|axis| ((points[i][axis] - low[axis]) / edge) as u32);
            cells.entry(cell).or_default().push(i);
        }
        // Coincident points have no extent.
        if cells.len() <= most || edge == 0.0 {
            return cells.into_values().collect();
        }
        edge *= GROWTH;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall behind what a camera sees, and the same wall behind the camera.
    fn cloud() -> (PointCloud, Camera) {
        let wall = |z: f32| {
            (0..40)
                .flat_map(move |x| (0..40).map(move |y| [x, y].map(|i| 0.05 * i as f32 - 1.0)))
                .map(move |[x, y]| [x, y, z])
        };
        let points: Vec<[f32; 3]> = wall(1.0).chain(wall(-9.0)).collect();
        let colors = points.iter().map(|point| [0.0, 0.5 + 0.4 * point[0], 0.3]).collect();
        let foreground = vec![false; points.len()];
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        (PointCloud { points, colors, foreground }, camera)
    }

    #[test]
    fn what_no_image_has_becomes_few_and_stays_where_it_is() {
        let (cloud, camera) = cloud();
        let gathered = gather_unseen(&cloud, std::slice::from_ref(&camera), 0.1);
        assert_eq!(gathered.points[..1600], cloud.points[..1600]);
        let rest = 1600..gathered.points.len();
        assert!((300..=1000).contains(&rest.len()), "{}", rest.len());
        for (point, color) in gathered.points[rest.clone()].iter().zip(&gathered.colors[rest]) {
            assert_eq!(point[2], -9.0);
            assert!((color[1] - 0.5 - 0.4 * point[0]).abs() < 0.02, "{point:?} {color:?}");
        }
    }

    #[test]
    fn what_is_hidden_is_in_the_image() {
        let (_, camera) = cloud();
        let points = [[0.0, 0.0, 0.0], [0.0, 0.0, 5.0], [0.0, 0.0, -5.0], [9.0, 0.0, 0.0]];
        assert_eq!(are_in_images(&points, &[camera]), [true, true, false, false]);
    }

    #[test]
    fn points_at_one_place_are_one() {
        let (mut cloud, camera) = cloud();
        cloud.points[1600..].fill([0.0, 0.0, -9.0]);
        assert_eq!(gather_unseen(&cloud, &[camera], 0.01).points.len(), 1600 + 1);
    }
}

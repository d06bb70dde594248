//! Whether the transforms of a calibration are inverted: seen by where the cameras look.

use tcgs_core::dot;

use crate::calibration::inverse;

type Transform = [[f64; 4]; 3];

/// Cameras that it takes to tell.
const MIN_CAMERAS: usize = 3;
/// Least cosine of any camera between where it looks and where the place is that all would look at: this much is certain.
const SURE: f64 = 0.9;
/// As given, this little is a mistake. Inverted cameras around a scene all stand near one place and look anywhere.
const WRONG: f64 = 0.5;

/// Whether the cameras look at one place if their transforms are inverted, and do not as they are given. Cameras side by
/// side look at no one place either way, and nothing can be told of them.
///
/// - `poses`: `camera_from_world`, supposedly
pub(super) fn are_inverted(poses: &[Transform]) -> bool {
    let inverted: Vec<Transform> = poses.iter().copied().map(inverse).collect();
    poses.len() >= MIN_CAMERAS && agreement(&inverted) > SURE && agreement(poses) < WRONG
}

/// Least cosine between each camera's direction and the way to the point that is nearest to all lines of sight.
fn agreement(poses: &[Transform]) -> f64 {
    let rays: Vec<([f64; 3], [f64; 3])> = poses.iter().map(|pose| (center(pose), forward(pose))).collect();
    let Some(place) = nearest_to(&rays) else { return 0.0 };
    let cosines = rays.iter().map(|(center, forward)| {
        let way: [f64; 3] = std::array::from_fn(|i| place[i] - center[i]);
        dot(way, *forward) / dot(way, way).sqrt().max(f64::MIN_POSITIVE)
    });
    cosines.fold(1.0, f64::min)
}

/// The point with the least sum of squared distances to lines, by Cramer's rule; `None` if the lines are parallel.
fn nearest_to(rays: &[([f64; 3], [f64; 3])]) -> Option<[f64; 3]> {
    let (mut m, mut v) = ([[0.0; 3]; 3], [0.0; 3]);
    for (center, forward) in rays {
        for i in 0..3 {
            for j in 0..3 {
                let share = f64::from(u8::from(i == j)) - forward[i] * forward[j];
                m[i][j] += share;
                v[i] += share * center[j];
            }
        }
    }
    let det = |m: &[[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = det(&m);
    // The determinant of lines in all directions is about (2/3 of their number)^3.
    let is_sure = whole > 1e-6 * (rays.len() as f64).powi(3);
    is_sure.then(|| {
        std::array::from_fn(|column| {
            let mut with = m;
            for row in 0..3 {
                with[row][column] = v[row];
            }
            det(&with) / whole
        })
    })
}

fn center(pose: &Transform) -> [f64; 3] {
    inverse(*pose).map(|row| row[3])
}

fn forward(pose: &Transform) -> [f64; 3] {
    let [x, y, z, _] = pose[2];
    [x, y, z]
}

//! Cameras with one pose: found from numbers alone, without images.

use tcgs_core::distance;

use super::{Finding, FindingKind, Names};

/// Distance between two cameras below which they are in one place, share of the size of the rig.
const SAME_PLACE: f64 = 1e-3;
/// Largest difference of the entries of two rotations that are the same: about a tenth of a degree.
const SAME_TURN: f64 = 2e-3;

/// First three rows of `camera_from_world`.
type Pose = [[f64; 4]; 3];

/// Groups of cameras with the same place and the same direction, as copied entries have.
///
/// - `poses`: first three rows of each camera's `camera_from_world`
/// - returns: indices into `poses`, ascending, of two cameras or more each
///
/// ```
/// let pose = |x: f64| [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 2.0]];
/// assert_eq!(tcgs_prepare::same_poses(&[pose(0.0), pose(1.0), pose(0.0)]), [vec![0, 2]]);
/// ```
pub fn same_poses(poses: &[Pose]) -> Vec<Vec<usize>> {
    let centers: Vec<[f64; 3]> = poses.iter().map(center).collect();
    let apart = |i: usize, j: usize| distance(centers[i], centers[j]);
    let size = (0..poses.len()).map(|i| apart(0, i)).fold(0.0, f64::max);
    let turned = |i: usize, j: usize| {
        let entries = (0..3).flat_map(|row| (0..3).map(move |column| (row, column)));
        entries.map(|(row, column)| (poses[i][row][column] - poses[j][row][column]).abs()).fold(0.0, f64::max)
    };
    let same = |i: usize, j: usize| apart(i, j) <= SAME_PLACE * size && turned(i, j) <= SAME_TURN;
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for i in 0..poses.len() {
        match groups.iter_mut().find(|group| same(group[0], i)) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups.retain(|group| group.len() > 1);
    groups
}

/// `−Rᵀ t`
fn center(pose: &Pose) -> [f64; 3] {
    std::array::from_fn(|j| -(0..3).map(|i| pose[i][j] * pose[i][3]).sum::<f64>())
}

/// Findings about cameras with one pose.
///
/// - `ids`: of the cameras, in the order of `poses`
pub(super) fn findings(ids: &[usize], poses: &[Pose], names: &Names) -> Vec<Finding> {
    let finding = |group: Vec<usize>| {
        let ids: Vec<usize> = group.into_iter().map(|i| ids[i]).collect();
        let problem = "they have one pose: the same place and the same direction";
        let fix = format!("give each of {} its own pose; one may be a copy of the other", names.list(&ids));
        Finding::new(FindingKind::SamePose, ids, problem, fix)
    };
    same_poses(poses).into_iter().map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera on a circle of radius 4 that looks at its middle.
    fn on_ring(degrees: f64) -> Pose {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [[cos, 0.0, -sin, 0.0], [0.0, 1.0, 0.0, 0.0], [sin, 0.0, cos, 4.0]]
    }

    #[test]
    fn cameras_of_one_pose_are_told_from_near_ones() {
        let ring = |degrees: &[f64]| same_poses(&degrees.iter().map(|&at| on_ring(at)).collect::<Vec<_>>());
        assert_eq!(ring(&[0.0, 51.0, 102.0, 51.0, 153.0, 0.0, 51.0]), [vec![0, 5], vec![1, 3, 6]]);
        assert_eq!(ring(&[0.0, 51.0, 51.01, 102.0]), [vec![1, 2]], "fitted from one pose");
        assert!(ring(&[0.0, 51.0, 51.3, 102.0]).is_empty());
        assert!(ring(&[]).is_empty() && ring(&[7.0]).is_empty());
    }

    #[test]
    fn cameras_in_one_place_that_look_elsewhere_are_right() {
        let at_origin = |degrees: f64| on_ring(degrees).map(|[a, b, c, _]| [a, b, c, 0.0]);
        assert!(same_poses(&[at_origin(0.0), at_origin(40.0)]).is_empty());
        assert_eq!(same_poses(&[at_origin(0.0), at_origin(0.0)]), [vec![0, 1]]);
    }
}

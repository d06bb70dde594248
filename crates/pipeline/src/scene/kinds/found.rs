//! The output folder of programs that train 3D Gaussian splatting, which holds the Gaussians as
//! `point_cloud/iteration_30000/point_cloud.ply`.

use std::fs;
use std::path::{Path, PathBuf};

use tcgs_core::natural_key;
use tcgs_interchange::TimestepFiles;

/// Name of the file in the folder of an iteration.
const FILE: &str = "point_cloud.ply";
/// Points that training starts from, in the output folder itself.
const POINTS: &str = "input.ply";

/// The Gaussians of the highest iteration, if a folder is the output folder of a training, its `point_cloud`, or that
/// of an iteration. A folder with a file of Gaussians for each frame is none of these.
pub(super) fn trained_file(folder: &Path) -> Option<PathBuf> {
    if iteration(folder).is_some() {
        return Some(folder.join(FILE)).filter(|file| file.is_file());
    }
    if has_frames(folder) {
        return None;
    }
    highest_iteration(folder).or_else(|| highest_iteration(&folder.join("point_cloud")))
}

/// The number in the name of an iteration's folder.
fn iteration(folder: &Path) -> Option<&str> {
    let number = folder.file_name()?.to_str()?.strip_prefix("iteration_")?;
    Some(number).filter(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}

fn has_frames(folder: &Path) -> bool {
    TimestepFiles::list(folder).is_ok_and(|files| files.iter().any(|file| !file.ends_with(POINTS)))
}

fn highest_iteration(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let iterations = entries.filter(|path| iteration(path).is_some() && path.join(FILE).is_file());
    let highest = iterations.max_by_key(|path| natural_key(iteration(path).unwrap_or_default()))?;
    Some(highest.join(FILE))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An empty file and the folders above it.
    fn touch(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    }

    #[test]
    fn the_highest_iteration_is_found_from_every_folder_above() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let file = |name: &str| root.join("point_cloud").join(name).join(FILE);
        for name in ["iteration_7000", "iteration_30000", "iteration_final"] {
            touch(&file(name));
        }
        touch(&root.join(POINTS));
        fs::create_dir(root.join("point_cloud/iteration_90000")).unwrap();
        let highest = Some(file("iteration_30000"));
        assert_eq!(trained_file(root), highest);
        assert_eq!(trained_file(&root.join("point_cloud")), highest);
        assert_eq!(trained_file(&root.join("point_cloud/iteration_7000")), Some(file("iteration_7000")));
        assert_eq!(trained_file(&root.join("point_cloud/iteration_90000")), None);
        assert_eq!(trained_file(&root.join("point_cloud/iteration_final")), None);
        // A frame beside them makes the folder a sequence.
        touch(&root.join("000000.ply"));
        assert_eq!(trained_file(root), None);
    }

    #[test]
    fn folders_of_frames_are_no_iterations() {
        let folder = tempfile::tempdir().unwrap();
        for frame in ["frame_0", "frame_1"] {
            touch(&folder.path().join(frame).join("point_cloud/iteration_30000").join(FILE));
        }
        assert_eq!(trained_file(folder.path()), None);
        assert!(trained_file(&folder.path().join("frame_1")).is_some());
    }
}

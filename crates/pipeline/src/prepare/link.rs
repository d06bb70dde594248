//! Links the files of one folder into another, so that they take no space twice.

use std::fs;
use std::path::Path;

use super::unwritable;
use crate::error::PipelineError;

/// Links all visible files of a folder and its subfolders, or copies a file that cannot be linked.
///
/// - `without`: names to leave out at the top level
pub fn link_tree(from: &Path, to: &Path, without: &[&str]) -> Result<(), PipelineError> {
    let unlisted = |error| PipelineError::unreadable(from, error, "a folder that can be listed");
    for entry in fs::read_dir(from).map_err(unlisted)? {
        let entry = entry.map_err(unlisted)?;
        let (source, name) = (entry.path(), entry.file_name());
        let shown = name.to_string_lossy();
        if shown.starts_with('.') || without.contains(&&*shown) {
            continue;
        }
        let target = to.join(&name);
        if source.is_dir() {
            fs::create_dir(&target).map_err(unwritable(&target))?;
            link_tree(&source, &target, &[])?;
        } else {
            // Follows a symbolic link: the capture must not break when its source moves.
            let file = source.canonicalize();
            let file = file.map_err(|error| PipelineError::unreadable(&source, error, "a file that can be read"))?;
            if fs::hard_link(&file, &target).is_err() {
                fs::copy(&file, &target).map_err(unwritable(&target))?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_linked_with_their_folders() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("to"));
        fs::create_dir_all(from.join("ims/3")).unwrap();
        fs::create_dir(&to).unwrap();
        for (name, text) in [("ims/3/0.png", "image"), ("points", "old"), (".hidden", "x"), ("ims/points", "kept")] {
            fs::write(from.join(name), text).unwrap();
        }
        #[cfg(unix)]
        std::os::unix::fs::symlink(from.join("ims/3/0.png"), from.join("same.png")).unwrap();
        link_tree(&from, &to, &["points"]).unwrap();
        assert_eq!(fs::read(to.join("ims/3/0.png")).unwrap(), b"image");
        assert_eq!(fs::read(to.join("ims/points")).unwrap(), b"kept");
        assert!(!to.join("points").exists() && !to.join(".hidden").exists());
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            let inode = |path: &Path| path.symlink_metadata().unwrap().ino();
            assert_eq!(inode(&to.join("ims/3/0.png")), inode(&from.join("ims/3/0.png")));
            assert_eq!(inode(&to.join("same.png")), inode(&from.join("ims/3/0.png")), "not a symbolic link");
        }
    }
}

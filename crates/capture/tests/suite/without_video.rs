//! The error of a capture of videos where this crate is compiled without them.

use std::fs;

use tcgs_capture::Capture;

#[test]
fn a_capture_of_videos_is_refused_with_one_line() {
    let folder = tempfile::tempdir().unwrap();
    // Two rows of poses, as NumPy writes them.
    let mut poses = b"\x93NUMPY\x01\x00".to_vec();
    let header = format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 17), }");
    poses.extend((header.len() as u16).to_le_bytes());
    poses.extend(header.as_bytes());
    poses.extend([0; 2 * 17 * 4]);
    fs::write(folder.path().join("poses_bounds.npy"), poses).unwrap();
    for name in ["cam00.mp4", "cam01.mp4"] {
        fs::write(folder.path().join(name), "a video").unwrap();
    }
    let message = Capture::open(folder.path()).unwrap_err().to_string();
    let begin = "cam00.mp4: is a video, which this program was compiled without (feature `video`), expected a folder";
    assert!(message.contains(begin) && !message.contains('\n'), "{message}");
}

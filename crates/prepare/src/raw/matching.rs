//! Assigns the cameras of a calibration to recordings.

use tcgs_capture::CalibratedCamera;

/// Largest difference of two poses of one camera, scene units and sines: more is a moving camera.
const SAME_POSE: f64 = 1e-3;

/// Finds the camera of each recording: by name without regard to case and separators, else by the last number in it.
///
/// - `names`: names of the recordings
/// - returns: a camera for each recording, and the names of cameras without a recording; or the fault
pub(super) fn matched<'a>(
    names: &[String],
    cameras: &'a [CalibratedCamera],
) -> Result<(Vec<&'a CalibratedCamera>, Vec<String>), String> {
    let by_name = |recording: &String| {
        let is_meant = |camera: &&CalibratedCamera| camera.names.iter().any(|name| plain(name) == plain(recording));
        cameras.iter().filter(is_meant).collect::<Vec<_>>()
    };
    let by_number = |recording: &String| {
        let number = number_in(recording);
        let is_meant = |camera: &&CalibratedCamera| camera.names.iter().any(|name| number_in(name) == number);
        let found: Vec<_> = cameras.iter().filter(is_meant).collect();
        // Another recording with this number would take the same camera.
        let is_alone = names.iter().filter(|other| number_in(other) == number).count() == 1;
        if number.is_some() && is_alone { found } else { Vec::new() }
    };
    let mut found: Vec<Vec<&CalibratedCamera>> = names.iter().map(by_name).collect();
    if found.iter().any(Vec::is_empty) {
        found = names.iter().map(by_number).collect();
    }
    let known = || cameras.iter().map(|camera| camera.names[0].clone()).collect::<Vec<_>>();
    let mut chosen = Vec::new();
    for (name, found) in names.iter().zip(&found) {
        let Some((first, others)) = found.split_first() else {
            return Err(format!("has no camera {name}, expected one for each recording; it has {}", shown(&known())));
        };
        if let Some(other) = others.iter().find(|other| !is_same_pose(first, other)) {
            return Err(format!(
                "has several poses of {name} ({}, {}), expected a camera that stands still",
                first.names[0], other.names[0]
            ));
        }
        chosen.push(*first);
    }
    let is_used = |camera: &CalibratedCamera| found.iter().flatten().any(|used| std::ptr::eq(*used, camera));
    let unused = cameras.iter().filter(|camera| !is_used(camera)).map(|camera| camera.names[0].clone()).collect();
    Ok((chosen, unused))
}

fn is_same_pose(a: &CalibratedCamera, b: &CalibratedCamera) -> bool {
    let pairs = a.camera_from_world.as_flattened().iter().zip(b.camera_from_world.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < SAME_POSE
}

/// A name in lower case without separators.
fn plain(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// The last number in a name.
pub(super) fn number_in(name: &str) -> Option<usize> {
    let digits = |c: char| c.is_ascii_digit();
    let end = name.rfind(digits)? + 1;
    let begin = name[..end].rfind(|c| !digits(c)).map_or(0, |i| i + name[i..].chars().next().map_or(1, char::len_utf8));
    name[begin..end].parse().ok()
}

fn shown(names: &[String]) -> String {
    const MOST: usize = 8;
    match names.get(..MOST) {
        Some(first) if names.len() > MOST => format!("{} and {} more", first.join(", "), names.len() - MOST),
        _ => names.join(", "),
    }
}

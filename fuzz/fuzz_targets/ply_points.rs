//! Any bytes as a PLY file of points.
#![no_main]

mod files;

use libfuzzer_sys::fuzz_target;
use tcgs_interchange::read_ply_points;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(cloud) = files::read("a.ply", bytes, |path| read_ply_points(path, files::LIMITS)) {
        assert!(!cloud.points.is_empty() && cloud.points.len() == cloud.colors.len());
        assert!(cloud.points.as_flattened().iter().all(|x| x.is_finite()));
        assert!(cloud.colors.as_flattened().iter().all(|x| (0.0..=1.0).contains(x)));
    }
});

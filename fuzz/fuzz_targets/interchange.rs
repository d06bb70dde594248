//! Any bytes as a file of another program: no panic, and what is read can be written and read again.
#![no_main]

use std::path::PathBuf;

use libfuzzer_sys::fuzz_target;
use tcgs_core::SceneReader;
use tcgs_interchange::{
    Axes, FourdgsFile, NpzReader, ReadLimits, ReadSettings, SpzVersion, read_gaussians, read_npy, read_ply_points,
    write_compressed_ply_to, write_glb_to, write_ply_to, write_sog_to, write_spz_to,
};

/// Readers take paths. One file of each name a process.
fn path(ending: &str) -> PathBuf {
    std::env::temp_dir().join(format!("tcgs-fuzz-{}.{ending}", std::process::id()))
}

fuzz_target!(|bytes: &[u8]| {
    let given = path("given");
    // Two kinds are known by their endings alone.
    for given in [&given, &path("splat"), &path("ksplat")] {
        std::fs::write(given, bytes).expect("a temporary file");
        let Ok(gaussians) = read_gaussians(given, ReadSettings::default()) else { continue };
        assert!(gaussians.num_gaussians() > 0 && gaussians.means().as_flattened().iter().all(|x| x.is_finite()));
        let (mut ply, mut glb, mut compressed, mut sog) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        write_ply_to(&mut ply, &gaussians).expect("memory");
        write_glb_to(&mut glb, &gaussians).expect("memory");
        write_compressed_ply_to(&mut compressed, &gaussians).expect("memory");
        write_sog_to(&mut sog, &gaussians).expect("memory");
        // Some coordinates are too large for SPZ.
        let spz = [SpzVersion::V3, SpzVersion::V4].into_iter().filter_map(|version| {
            let mut spz = Vec::new();
            write_spz_to(&mut spz, &gaussians, Axes::RUB, version).ok().map(|()| spz)
        });
        for written in [ply, glb, compressed, sog].into_iter().chain(spz) {
            let again = path("again");
            std::fs::write(&again, written).expect("a temporary file");
            let again = read_gaussians(&again, ReadSettings::default()).expect("a file just written");
            assert_eq!(again.num_gaussians(), gaussians.num_gaussians());
        }
    }
    let _ = read_ply_points(&given, ReadLimits::default());
    let _ = read_npy(&given);
    if let Ok(mut archive) = NpzReader::open(&given) {
        let names: Vec<String> = archive.array_names().collect();
        for name in names {
            let _ = archive.type_of(&name);
            let _ = archive.array(&name);
        }
    }
    if let Ok(file) = FourdgsFile::open(&given, ReadSettings::default()) {
        for timestep in 0..file.num_timesteps().min(8) {
            let _ = file.at(timestep);
        }
    }
});

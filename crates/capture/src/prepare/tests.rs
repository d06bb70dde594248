use super::*;
use crate::{SyntheticSettings, synthetic::distance_from_surface, write_synthetic};

/// One frame without points.
fn synthetic(settings: &SyntheticSettings) -> (tempfile::TempDir, Capture) {
    let folder = tempfile::tempdir().unwrap();
    write_synthetic(folder.path(), &SyntheticSettings { num_timesteps: 1, ..settings.clone() }).unwrap();
    std::fs::remove_file(folder.path().join("init_pt_cld.npz")).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    (folder, capture)
}

fn prepared(capture: &Capture, settings: &PrepareSettings) -> Prepared {
    prepare(capture, settings, &mut |_| ()).unwrap()
}

/// Distances from the true surfaces of the points of an origin, ascending.
fn distances(prepared: &Prepared, foreground: bool, origin: Origin) -> Vec<f64> {
    let cloud = &prepared.cloud;
    let chosen = (0..cloud.points.len()).filter(|&i| prepared.origins[i] == origin && cloud.foreground[i] == foreground);
    let mut distances: Vec<f64> = chosen.map(|i| distance_from_surface(cloud.points[i], foreground)).collect();
    distances.sort_by(f64::total_cmp);
    distances
}

#[test]
fn points_lie_on_the_true_surfaces() {
    let (_folder, capture) = synthetic(&SyntheticSettings::default());
    let prepared = prepared(&capture, &PrepareSettings { num_points: 8000, ..PrepareSettings::default() });
    for foreground in [true, false] {
        for origin in [Origin::Triangulated, Origin::Hull, Origin::Filled, Origin::Shell] {
            let d = distances(&prepared, foreground, origin);
            if !d.is_empty() {
                let at = |share: f64| d[(share * (d.len() - 1) as f64) as usize];
                println!("{foreground} {origin:?} {} {:.3} {:.3} {:.3} {:.3}", d.len(), at(0.5), at(0.75), at(0.9), at(0.98));
            }
        }
    }
}

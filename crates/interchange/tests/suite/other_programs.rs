//! Files that other programs made of one PLY file (`testdata/interchange`), against that file. Every tolerance is half
//! a step of what the kind of file holds, and what a float rounds.

use tcgs_core::{Attribute, Gaussians, HARMONIC_0, SceneReader, normalize, rotmat_from_quat, sigmoid};
use tcgs_interchange::{Axes, HigherHarmonics, ReadSettings, TimestepFiles, read_gaussians};

use super::file;

fn read(name: &str) -> Gaussians {
    read_gaussians(&file(name), ReadSettings::default()).unwrap()
}

/// The Gaussians of an SPZ file of splat-transform 2.7.1, which turned them to RUB and declared no axes; or of its
/// library, as `make.mjs` calls it.
fn read_rub(name: &str) -> Gaussians {
    read_gaussians(&file(name), ReadSettings { axes: Some(Axes::RUB), ..ReadSettings::default() }).unwrap()
}

/// Half a step of each attribute: the error that a kind of file may have.
struct HalfSteps {
    mean: [f64; 3],
    /// For the stored components of a unit quaternion.
    quat: f64,
    log_scale: [f64; 3],
    /// Activated.
    opacity: f64,
    color: f64,
    /// For degree 1, and for the other degrees.
    harmonics: [f64; 2],
}

/// Fails where an attribute errs more than it may.
fn compare(found: &Gaussians, expected: &Gaussians, may: &HalfSteps) {
    assert_eq!(found.num_gaussians(), expected.num_gaussians());
    let near = |what: &str, i: usize, found: f32, expected: f32, half_step: f64| {
        let error = f64::from(found - expected).abs();
        let rounding = 4.0 * f64::from(f32::EPSILON) * f64::from(expected.abs()).max(1.0);
        assert!(
            error <= half_step + rounding,
            "{what} of Gaussian {i}: {found}, expected {expected} within {half_step}"
        );
    };
    for i in 0..found.num_gaussians() {
        for c in 0..3 {
            near("mean", i, found.means()[i][c], expected.means()[i][c], may.mean[c]);
            near("log scale", i, found.log_scales()[i][c], expected.log_scales()[i][c], may.log_scale[c]);
            near("color", i, found.colors()[i][c], expected.colors()[i][c], may.color);
        }
        let opacity = |gaussians: &Gaussians| sigmoid(gaussians.logit_opacities()[i]);
        near("opacity", i, opacity(found), opacity(expected), may.opacity);
        let quat = |gaussians: &Gaussians| normalize(gaussians.quats()[i].map(f64::from));
        // A rotation has two quaternions. The component that is not stored follows from the unit length, so its error
        // is compared in the square.
        let (a, b) = (quat(found), quat(expected));
        let errs = |sign: f64| -> f64 {
            (0..4).map(|c| (a[c] * a[c].abs() - sign * b[c] * b[c].abs()).abs()).fold(0.0, f64::max)
        };
        let error = errs(1.0).min(errs(-1.0));
        assert!(
            error <= 2.0 * 3.0_f64.sqrt() * may.quat + 1e-6,
            "quat of Gaussian {i}: {a:?}, expected {b:?}: {error}"
        );
    }
    for (l, band) in (1..).zip(found.layout().harmonics()) {
        let half_step = may.harmonics[usize::from(l > 1)];
        for (k, (found, expected)) in found.values(band).iter().zip(expected.values(band)).enumerate() {
            near(
                &format!("harmonic {l}, {}", k % band.components()),
                k / band.components(),
                *found,
                *expected,
                half_step,
            );
        }
    }
}

fn span(gaussians: &Gaussians, attribute: Attribute, c: usize) -> f64 {
    let values = gaussians.values(attribute).iter().skip(c).step_by(3);
    let (low, high) = values.fold((f32::MAX, f32::MIN), |(low, high), &x| (low.min(x), high.max(x)));
    f64::from(high) - f64::from(low)
}

#[test]
fn compressed_ply_of_splat_transform() {
    let original = read("original.ply");
    let found = read("splat_transform.compressed.ply");
    assert_eq!((found.num_gaussians(), found.layout()), (260, original.layout()));
    // The writer sorts. Two Gaussians of the original lie further apart than positions err.
    let nearest = |i: usize| -> usize {
        let distance = |j: &usize| -> f32 {
            found.means()[i].iter().zip(original.means()[*j]).map(|(a, b)| (a - b) * (a - b)).sum()
        };
        (0..260).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
    };
    let order: Vec<usize> = (0..260).map(nearest).collect();
    let mut each_once = order.clone();
    each_once.sort_unstable();
    assert_eq!(each_once, (0..260).collect::<Vec<_>>());
    // A chunk spans no more than the whole.
    let half_step = |attribute, bits: [i32; 3]| {
        std::array::from_fn(|c| span(&original, attribute, c) / (2.0_f64.powi(bits[c]) - 1.0) / 2.0)
    };
    let color = (0..3).map(|c| span(&original, Attribute::Color, c)).fold(0.0, f64::max);
    let may = HalfSteps {
        mean: half_step(Attribute::Mean, [11, 10, 11]),
        quat: 2.0_f64.sqrt() / 1023.0 / 2.0,
        log_scale: half_step(Attribute::LogScale, [11, 10, 11]),
        opacity: 0.5 / 255.0,
        color: color / 255.0 / 2.0,
        harmonics: [8.0 / 256.0 / 2.0; 2],
    };
    compare(&found, &original.select(&order), &may);
}

/// Half steps of SPZ, with `bits` for harmonics of degree 1 and above.
fn spz(bits: [i32; 2]) -> HalfSteps {
    HalfSteps {
        mean: [0.5 / 4096.0; 3],
        quat: 0.5 / 511.0 / 2.0_f64.sqrt(),
        log_scale: [0.5 / 16.0; 3],
        opacity: 0.5 / 255.0,
        color: 0.5 / 255.0 / 0.15 * HARMONIC_0,
        // Rounded to 8 bits, then to fewer.
        harmonics: bits.map(|bits| (0.5 + 2.0_f64.powi(7 - bits)) / 128.0),
    }
}

/// Each Gaussian of `found`, in an order in which it is nearest to that of `expected`: writers sort.
fn in_order_of(found: &Gaussians, expected: &Gaussians) -> Gaussians {
    let distance = |i: usize, j: usize| -> f32 {
        found.means()[j].iter().zip(expected.means()[i]).map(|(a, b)| (a - b) * (a - b)).sum()
    };
    let nearest =
        |i: usize| (0..found.num_gaussians()).min_by(|&a, &b| distance(i, a).total_cmp(&distance(i, b))).unwrap();
    found.select(&(0..expected.num_gaussians()).map(nearest).collect::<Vec<_>>())
}

#[test]
fn sog_of_splat_transform() {
    let (original, found) = (read("original.ply"), read("splat_transform_37.sog"));
    assert_eq!((found.num_gaussians(), found.layout().sh_degree()), (260, 1));
    // The writer cuts off where others round. A position is exp(m) - 1 of a step of m; codebooks are its own choice.
    let step = |c| (1.0 + span(&original, Attribute::Mean, c)) * 2.0 * 4.0_f64.ln() / 65535.0;
    let may = HalfSteps {
        mean: std::array::from_fn(step),
        quat: 2.0_f64.sqrt() / 255.0,
        log_scale: [5.0 / 64.0; 3],
        opacity: 1.0 / 255.0,
        color: 4.0 * HARMONIC_0 / 64.0,
        // 256 rows of a palette for 260 Gaussians.
        harmonics: [1.2, 0.0],
    };
    let sorted = in_order_of(&found, &original);
    compare(&sorted, &original, &may);
    let band = found.layout().harmonics()[0];
    let errors = sorted.values(band).iter().zip(original.values(band)).map(|(a, b): (&f32, &f32)| (a - b).abs());
    assert!(errors.filter(|error| *error > 1.2 / 64.0).count() < 260 * 9 / 20);
    let files = TimestepFiles::open(&file("splat_transform_37.sog"), ReadSettings::default()).unwrap();
    assert_eq!((files.kind(), files.axes(), files.notes()), ("SOG files", Axes::RDF, vec![]));
}

#[test]
fn ksplat_of_gaussian_splats_3d() {
    let mut original = read("original.ply").select(&(0..40).collect::<Vec<_>>());
    // The writer clamps colours.
    original.colors_mut().as_flattened_mut().iter_mut().for_each(|color| *color = color.clamp(0.0, 1.0));
    let (low, high) = (-0.6, 0.6);
    for (name, sh_degree) in
        [("gaussian_splats_3d_0.ksplat", 1), ("gaussian_splats_3d_1.ksplat", 2), ("gaussian_splats_3d_2.ksplat", 2)]
    {
        let found = read(name);
        assert_eq!((found.num_gaussians(), found.layout().sh_degree()), (40, sh_degree), "{name}");
        let is_whole = sh_degree == 1;
        // Half floats are cut off after 10 bits. Scales are below 0.4, coefficients below 0.6, opacities and colours
        // are cut off to bytes.
        let half_float = if is_whole { 0.0 } else { 2.0_f64.powi(-10) };
        let may = HalfSteps {
            // 32767 steps from the middle of a bucket to its side.
            mean: [if is_whole { 0.0 } else { 1.5 / 32767.0 / 2.0 }; 3],
            quat: half_float,
            log_scale: [half_float; 3],
            opacity: 1.0 / 255.0,
            color: 1.0 / 255.0,
            harmonics: [if name.ends_with("_2.ksplat") { (high - low) / 255.0 } else { half_float }; 2],
        };
        compare(&in_order_of(&found, &original), &original, &may);
        let files = TimestepFiles::open(&file(name), ReadSettings::default()).unwrap();
        assert_eq!((files.kind(), files.axes(), files.notes()), (".ksplat files", Axes::RDF, vec![]));
    }
}

#[test]
fn spz_of_splat_transform_and_of_its_library() {
    let original = read("original.ply");
    for name in ["splat_transform_v3.spz", "splat_transform_v4.spz"] {
        let found = read_rub(name);
        assert_eq!(found.layout(), original.layout());
        compare(&found, &original, &spz([5, 4]));
    }
    assert_eq!(read_rub("splat_transform_v3.spz"), read_rub("splat_transform_v4.spz"));
    // Written from what was read of version 4.
    let may = HalfSteps { quat: 0.5 / 127.5, ..spz([8, 8]) };
    compare(&read_rub("spz_v2.spz"), &read_rub("splat_transform_v4.spz"), &may);
    let dropped = read_gaussians(&file("splat_transform_v4.spz"), HigherHarmonics::Drop.into()).unwrap();
    assert!(dropped.layout().is_base() && dropped.means() == read("splat_transform_v4.spz").means());
}

#[test]
fn spz_of_other_programs_has_the_axes_of_ply_files_or_declares_others() {
    let original = read("original.ply");
    let names = [
        "niantic_v2.spz",
        "niantic_v3.spz",
        "niantic_rub.spz",
        "splat_transform_37_v3.spz",
        "splat_transform_37_v4.spz",
        "gsply_v3.spz",
        "gsply_v4.spz",
        "gaussforge_v2.spz",
        "gaussforge_v3.spz",
        "spz_js_v2.spz",
    ];
    for name in names {
        let found = read(name);
        assert_eq!(found.layout(), original.layout(), "{name}");
        let quat = if name.contains("_v2") { 0.5 / 127.5 } else { 0.5 / 511.0 / 2.0_f64.sqrt() };
        compare(&found, &original, &HalfSteps { quat, ..spz([5, 4]) });
        let notes = TimestepFiles::open(&file(name), ReadSettings::default()).unwrap().notes();
        assert_eq!(notes.is_empty(), name == "niantic_rub.spz", "{name}: {notes:?}");
    }
}

#[test]
fn spz_of_degree_4_is_read_without_harmonics() {
    let problem = read_gaussians(&file("spz_degree_4.spz"), ReadSettings::default()).unwrap_err().to_string();
    assert!(problem.ends_with("has spherical harmonics of degree 4, expected 0 to 3"), "{problem}");
    let found = read_gaussians(&file("spz_degree_4.spz"), HigherHarmonics::Drop.into()).unwrap();
    assert_eq!(found.means(), &read("splat_transform_v4.spz").means()[..1]);
}

#[test]
fn glb_of_splat_transform() {
    let (original, found) = (read("original.ply"), read("splat_transform.glb"));
    assert_eq!((found.num_gaussians(), found.layout().sh_degree()), (260, 1));
    assert_eq!(found.means(), original.means());
    // It turns a Gaussian's own axes differently, which its shape does not show.
    let shape = |gaussians: &Gaussians, i: usize| -> [[f64; 3]; 3] {
        let rotation = rotmat_from_quat(gaussians.quats()[i].map(f64::from));
        let variances = gaussians.log_scales()[i].map(|s| f64::from(2.0 * s).exp());
        let entry = |r: usize, c: usize| (0..3).map(|k| rotation[r][k] * variances[k] * rotation[c][k]).sum();
        std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)))
    };
    for i in 0..260 {
        let (a, b) = (shape(&found, i), shape(&original, i));
        let size = b[0][0] + b[1][1] + b[2][2];
        for (a, b) in a.as_flattened().iter().zip(b.as_flattened()) {
            assert!((a - b).abs() < 2e-6 * size, "Gaussian {i}: {a}, expected {b}");
        }
    }
    let same = original.layout();
    let mut rest = found.extended(same);
    // Shapes are compared.
    rest.quats_mut().copy_from_slice(original.quats());
    let lower = rest.layout().harmonics()[1..].to_vec();
    for band in lower {
        rest.values_mut(band).copy_from_slice(original.values(band));
    }
    let exact =
        HalfSteps { mean: [0.0; 3], quat: 0.0, log_scale: [0.0; 3], opacity: 0.0, color: 0.0, harmonics: [0.0; 2] };
    compare(&rest, &original, &exact);
}

#[test]
fn a_folder_of_several_kinds_is_one_sequence() {
    let folder = tempfile::tempdir().unwrap();
    for (i, name) in ["original.ply", "gsply_v3.spz", "spz_js_v2.spz", "niantic_rub.spz"].iter().enumerate() {
        let ending = name.rsplit('.').next().unwrap();
        std::fs::copy(file(name), folder.path().join(format!("{i}.{ending}"))).unwrap();
    }
    let files = TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap();
    assert_eq!((files.num_timesteps(), files.num_identities(), files.kind()), (4, Some(260), "Gaussian files"));
    let scene = files.read(0..4).unwrap();
    assert_eq!(scene.at(3), read("niantic_rub.spz"));
}

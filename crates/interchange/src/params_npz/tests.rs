use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use tcgs_core::{Attribute, DynamicGaussians, Layout, SceneReader};

use super::*;
use crate::npz::NpzRows;
use crate::{NpzReader, NpzWriter, ReadLimits};

/// Two timesteps of three Gaussians, every value different.
fn scene() -> DynamicGaussians {
    scene_of(Layout::base())
}

fn scene_of(layout: Arc<Layout>) -> DynamicGaussians {
    let mut counter = 0.0;
    let mut next = || {
        counter += 0.25;
        counter
    };
    let mut values = |count| -> Vec<f32> { (0..count).map(|_| next()).collect() };
    let means = vec![values(9), values(9)];
    let colors = vec![values(9), values(9)];
    let log_scales = vec![values(9)];
    let quats = vec![values(12), values(12)];
    let samples = vec![means, quats, log_scales, vec![vec![-1.0, 0.5, 2.0]], colors];
    DynamicGaussians::from_samples(layout, 2, samples)
}

fn bytes(scene: &DynamicGaussians, extras: &ParamsExtras) -> Vec<u8> {
    write_params_npz_to(io::Cursor::new(Vec::new()), scene, extras).unwrap().into_inner()
}

/// An array to write: key, shape, values.
type Array = (&'static str, Vec<usize>, Vec<f32>);

/// The arrays of [`scene`], for tests to spoil.
fn arrays() -> Vec<Array> {
    let scene = scene();
    vec![
        ("means3D", vec![2, 3, 3], scene.samples(Attribute::Mean).concat()),
        ("rgb_colors", vec![2, 3, 3], scene.samples(Attribute::Color).concat()),
        ("unnorm_rotations", vec![2, 3, 4], scene.samples(Attribute::Quat).concat()),
        ("logit_opacities", vec![3, 1], scene.samples(Attribute::LogitOpacity).concat()),
        ("log_scales", vec![3, 3], scene.samples(Attribute::LogScale).concat()),
    ]
}

/// The result of reading; errors without the file's name.
fn read(arrays: &[Array]) -> Result<DynamicGaussians, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    let mut npz = NpzWriter::new(File::create(&path).unwrap());
    for (key, shape, values) in arrays {
        npz.array(key, shape, [values.as_slice()]).unwrap();
    }
    npz.finish().unwrap();
    read_params_npz(&path).map_err(|error| {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        message.strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned()
    })
}

fn read_with(change: impl Fn(&mut Vec<Array>)) -> Result<DynamicGaussians, String> {
    let mut arrays = arrays();
    change(&mut arrays);
    read(&arrays)
}

#[test]
fn a_scene_survives_the_round_trip_and_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
    assert_eq!(read_params_npz(&path).unwrap(), scene());
    assert_eq!(std::fs::read(&path).unwrap(), bytes(&scene(), &ParamsExtras::default()));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
    // Antialiased scenes stay so.
    let antialiased = scene_of(Layout::base().antialiased(true));
    write_params_npz(&path, &antialiased, &ParamsExtras::default()).unwrap();
    let read = read_params_npz(&path).unwrap();
    assert!(read == antialiased && read.layout().is_antialiased());
    // So does the background.
    let before = scene_of(Layout::base().with_background([1, 20, 255]));
    write_params_npz(&path, &before, &ParamsExtras::default()).unwrap();
    assert_eq!(read_params_npz(&path).unwrap(), before);
}

#[test]
fn a_background_that_is_no_colour_is_an_error() {
    for wrong in [&[1.0, 2.0][..], &[1.0, 2.0, 256.0], &[1.0, 2.5, 3.0], &[1.0, 2.0, 3.0, 4.0]] {
        let error =
            read_with(|arrays| arrays.push(("tcgs_background", vec![wrong.len()], wrong.to_vec()))).unwrap_err();
        assert!(error.contains("tcgs_background") && error.contains("expected red, green and blue"), "{error}");
    }
}

/// [`arrays`] as [`Array`]s, compressed or not, in an archive.
fn write_compressed(path: &Path, compressed: &[&str]) {
    let mut zip = zip::ZipWriter::new(File::create(path).unwrap());
    for (key, shape, values) in arrays() {
        let mut own = NpzWriter::new(io::Cursor::new(Vec::new()));
        own.array(key, &shape, [values.as_slice()]).unwrap();
        let mut own = zip::ZipArchive::new(own.finish().unwrap()).unwrap();
        let mut npy = Vec::new();
        io::Read::read_to_end(&mut own.by_index(0).unwrap(), &mut npy).unwrap();
        let is_compressed = compressed.contains(&key);
        let method = if is_compressed { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        zip.start_file(format!("{key}.npy"), options).unwrap();
        zip.write_all(&npy).unwrap();
    }
    zip.finish().unwrap();
}

#[test]
fn a_timestep_is_read_alone_whether_compressed_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    for compressed in [&[][..], &["rgb_colors"], &["means3D", "unnorm_rotations", "rgb_colors", "log_scales"]] {
        write_compressed(&path, compressed);
        let mut params = ParamsNpz::open(&path, ReadLimits::default()).unwrap();
        let on_disk = [&params.means, &params.quats, &params.colors].map(NpzRows::is_on_disk);
        let stored = ["means3D", "unnorm_rotations", "rgb_colors"].map(|key| !compressed.contains(&key));
        assert_eq!(on_disk, stored);
        assert_eq!((params.num_timesteps(), params.num_identities()), (2, Some(3)));
        for timestep in [1, 0, 1] {
            assert_eq!(params.at(timestep).unwrap(), scene().at(timestep));
        }
        assert_eq!(params.read_all().unwrap(), scene());
    }
}

#[test]
fn a_file_that_is_written_to_while_it_is_open_is_no_other_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
    let mut params = ParamsNpz::open(&path, ReadLimits::default()).unwrap();
    // Into the open file, not beside it: the first value of the second timestep.
    let mut bytes = std::fs::read(&path).unwrap();
    let second = scene().means(1)[0][0].to_le_bytes();
    let at = bytes.windows(4).position(|window| window == second).unwrap();
    bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let error = params.at(1).unwrap_err().to_string();
    assert!(error.ends_with("means3D [1, 0, 0] is NaN, expected a finite number"), "{error}");
    std::fs::write(&path, &bytes[..at]).unwrap();
    assert!(params.at(1).unwrap_err().to_string().contains("means3D "));
}

#[test]
fn extras_are_stored_as_the_source_stores_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    let extras = ParamsExtras {
        foreground: Some(&[true, false, true]),
        log_gains: &[[0.1, 0.2, 0.3]],
        offsets: &[[0.0; 3], [0.5; 3]],
        origin: Some(ParamsOrigin { first_frame: 40, downscale: 2, frame_rate: 29.97 }),
    };
    write_params_npz(&path, &scene(), &extras).unwrap();
    let mut npz = NpzReader::open(&path).unwrap();
    assert_eq!(npz.array("seg_colors").unwrap().values, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
    let (gains, offsets) = (npz.array("cam_m").unwrap(), npz.array("cam_c").unwrap());
    assert_eq!((gains.shape, &gains.values[..4]), (vec![50, 3], &[0.1, 0.2, 0.3, 0.0][..]));
    assert_eq!((offsets.shape, &offsets.values[2..7]), (vec![50, 3], &[0.0, 0.5, 0.5, 0.5, 0.0][..]));
    // Windows replaces no file that is open.
    drop(npz);

    assert_eq!(read_params_origin(&path, ReadLimits::default()).unwrap(), extras.origin);
    assert_eq!(read_params_npz(&path).unwrap(), scene());

    let many = ParamsExtras { log_gains: &[[1.0; 3]; 60], ..extras };
    write_params_npz(&path, &scene(), &many).unwrap();
    assert_eq!(NpzReader::open(&path).unwrap().array("cam_c").unwrap().shape, [60, 3]);

    write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
    assert_eq!(read_params_origin(&path, ReadLimits::default()).unwrap(), None);
    let all = NpzReader::open(&path).unwrap().array("seg_colors").unwrap();
    assert_eq!(all.values, [1.0, 0.0, 0.0].repeat(3));
}

#[test]
fn an_origin_out_of_range_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    let problem = |arrays: &[(&str, &[f32])]| {
        let mut npz = NpzWriter::new(File::create(&path).unwrap());
        for (key, values) in arrays {
            npz.array(key, &[values.len()], [*values]).unwrap();
        }
        npz.finish().unwrap();
        let message = read_params_origin(&path, ReadLimits::default()).unwrap_err().to_string();
        message.strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned()
    };
    let origin = |first_frame, downscale, frame_rate| {
        problem(&[(FIRST_FRAME, &[first_frame]), (DOWNSCALE, &[downscale]), (FRAME_RATE, &[frame_rate])])
    };
    assert_eq!(origin(1.5, 1.0, 30.0), "tcgs_first_frame is [1.5], expected a whole number from 0");
    assert_eq!(origin(-1.0, 1.0, 30.0), "tcgs_first_frame is [-1.0], expected a whole number from 0");
    assert_eq!(origin(0.0, 0.0, 30.0), "tcgs_downscale is [0.0], expected a whole number of 1 to 65536");
    assert_eq!(origin(0.0, 1.0, -30.0), "tcgs_frame_rate is [-30.0], expected a number, 0 or more");
    assert_eq!(problem(&[(FIRST_FRAME, &[])]), "tcgs_first_frame is [], expected a whole number from 0");
    assert!(problem(&[(FIRST_FRAME, &[0.0])]).starts_with("tcgs_downscale is missing, found "));
}

#[test]
#[should_panic(expected = "logit_opacities vary over 3 timesteps, params.npz holds one")]
fn opacities_that_vary_are_a_mistake() {
    let mut scene = scene();
    let mut next = scene.at(1);
    next.logit_opacities_mut()[2] += 1.0;
    scene.push(next);
    bytes(&scene, &ParamsExtras::default());
}

#[test]
fn other_shapes_of_the_constant_arrays_are_tolerated() {
    for shape in [vec![3], vec![1, 3], vec![1, 3, 1]] {
        assert_eq!(read_with(|a| a[3].1 = shape.clone()).unwrap(), scene(), "{shape:?}");
    }
    assert_eq!(read_with(|a| a[4].1 = vec![1, 3, 3]).unwrap(), scene());
}

#[test]
fn one_gaussian_at_one_timestep_is_a_scene() {
    let single = |shape: &[usize], values: &[f32]| (shape.to_vec(), values.to_vec());
    let arrays = [
        ("means3D", single(&[1, 1, 3], &[1.0, 2.0, 3.0])),
        ("rgb_colors", single(&[1, 1, 3], &[0.1, 0.2, 0.3])),
        ("unnorm_rotations", single(&[1, 1, 4], &[1.0, 0.0, 0.0, 0.0])),
        ("logit_opacities", single(&[1, 1], &[0.5])),
        ("log_scales", single(&[1, 3], &[-1.0, -2.0, -3.0])),
    ]
    .map(|(key, (shape, values))| (key, shape, values));
    let scene = read(&arrays).unwrap();
    assert_eq!((scene.num_timesteps(), scene.values(Attribute::LogScale, 0)), (1, [-1.0, -2.0, -3.0].as_slice()));
}

#[test]
fn every_inconsistency_names_its_key() {
    for key in 0..5 {
        let name = arrays()[key].0;
        let missing = read_with(|a| drop(a.remove(key))).unwrap_err();
        assert!(missing.starts_with(&format!("{name} is missing, found ")), "{missing}");
        let nan = read_with(|a| a[key].2[1] = f32::NAN).unwrap_err();
        assert!(nan.starts_with(&format!("{name} [")) && nan.contains("is NaN, expected a finite number"), "{nan}");
    }
    let problem = |change: fn(&mut Vec<Array>)| read_with(change).unwrap_err();
    assert_eq!(problem(|a| a[0].1 = vec![6, 3]), "means3D has the shape (6, 3), expected (timesteps, gaussians, 3)");
    assert_eq!(
        problem(|a| a[0] = ("means3D", vec![0, 3, 3], vec![])),
        "means3D has 0 timesteps of 3 gaussians, expected at least one each"
    );
    assert_eq!(
        problem(|a| a[0] = ("means3D", vec![2, 0, 3], vec![])),
        "means3D has 2 timesteps of 0 gaussians, expected at least one each"
    );
    assert_eq!(
        problem(|a| a[1].1 = vec![3, 2, 3]),
        "rgb_colors has the shape (3, 2, 3), expected (2, 3, 3) to agree with means3D"
    );
    assert_eq!(
        problem(|a| a[2] = ("unnorm_rotations", vec![2, 3, 3], vec![0.0; 18])),
        "unnorm_rotations has the shape (2, 3, 3), expected (2, 3, 4) to agree with means3D"
    );
    assert_eq!(
        problem(|a| a[3] = ("logit_opacities", vec![4, 1], vec![0.0; 4])),
        "logit_opacities has the shape (4, 1), expected (3, 1) to agree with means3D"
    );
    assert_eq!(problem(|a| a[4].1 = vec![9]), "log_scales has the shape (9,), expected (3, 3) to agree with means3D");
}

#[test]
fn a_cut_or_flipped_file_never_panics_and_never_passes_for_another() {
    let whole = bytes(&scene(), &ParamsExtras::default());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.npz");
    // Steps keep the test short; the table of contents at the end is cut at every byte.
    let table = whole.len() - 600;
    for length in (0..table).step_by(7).chain(table..whole.len()) {
        std::fs::write(&path, &whole[..length]).unwrap();
        let message = read_params_npz(&path).unwrap_err().to_string();
        assert!(message.starts_with(&path.display().to_string()) && !message.contains('\n'), "{length}: {message}");
    }
    for at in (0..whole.len()).step_by(3) {
        let mut flipped = whole.clone();
        flipped[at] ^= 0x10;
        std::fs::write(&path, &flipped).unwrap();
        if let Ok(found) = read_params_npz(&path) {
            assert_eq!(found, scene(), "byte {at}");
        }
    }
}

#[test]
#[should_panic(expected = "foreground: [2] against [3]")]
fn flags_for_another_number_of_gaussians_are_a_mistake() {
    bytes(&scene(), &ParamsExtras { foreground: Some(&[true, false]), ..Default::default() });
}

#[test]
#[should_panic(expected = "a scene of 0 timesteps")]
fn an_empty_scene_is_a_mistake() {
    bytes(&DynamicGaussians::default(), &ParamsExtras::default());
}

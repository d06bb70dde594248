use std::fs;
use std::io::{Cursor, Read, Write};

use tcgs_core::{Gaussians, HARMONIC_0, Layout};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

use super::*;
use crate::testing::{Bounds, assert_near, awkward, random};
use crate::{Axes, HigherHarmonics, InterchangeError, ReadLimits, ReadSettings, TimestepFiles, read_gaussians};

fn written(gaussians: &Gaussians) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_sog_to(&mut bytes, gaussians).unwrap();
    bytes
}

fn read_with(bytes: &[u8], settings: ReadSettings) -> Result<Gaussians, String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), bytes).unwrap();
    read_gaussians(file.path(), settings).map_err(|error| {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
    })
}

fn read(bytes: &[u8]) -> Result<Gaussians, String> {
    read_with(bytes, ReadSettings::default())
}

/// The bounds for [`random`]: positions between -1 and 1, log scales in a range of 2, colours in one of 1, harmonics in
/// one of 1.8.
const BOUNDS: Bounds = Bounds {
    // (1 + |x|) times half a step of a range of 2 ln 2.
    mean: [2.0 * std::f64::consts::LN_2 / MAX_POSITION; 3],
    quat: std::f64::consts::SQRT_2 / 255.0 / 2.0,
    log_scale: [2.0 / 64.0; 3],
    opacity: 0.5 / 255.0,
    color: 1.0 / 64.0,
    harmonic: 1.8 / 64.0,
};

#[test]
fn numbers_come_back_within_their_bounds() {
    for (num_gaussians, degree) in [(1, 0), (1, 3), (2, 1), (64, 2), (65, 3), (257, 0), (1000, 1), (5000, 3)] {
        let gaussians = random(num_gaussians, degree);
        assert_near(&read(&written(&gaussians)).unwrap(), &gaussians, &BOUNDS);
    }
}

#[test]
fn few_different_values_are_exact() {
    let few = random(80, 2);
    let gaussians = few.select(&(0..3000).map(|i| i % 80).collect::<Vec<_>>());
    let exact = Bounds { log_scale: [0.0; 3], color: 1e-7, ..BOUNDS };
    assert_near(&read(&written(&gaussians)).unwrap(), &gaussians, &exact);
}

#[test]
fn beyond_65536_gaussians_similar_ones_share_harmonics() {
    // Ten thousand different rows.
    let few = random(10_000, 1);
    let gaussians = few.select(&(0..70_000).map(|i| i * 7 % 10_000).collect::<Vec<_>>());
    assert_near(&read(&written(&gaussians)).unwrap(), &gaussians, &BOUNDS);
    let many = random(70_000, 1);
    let found = read(&written(&many)).unwrap();
    let band = many.layout().harmonics()[0];
    let errors = found.values(band).iter().zip(many.values(band)).map(|(a, b)| (a - b).abs());
    assert!(errors.sum::<f32>() / (9.0 * 70_000.0) < 0.02);
}

#[test]
fn extreme_numbers_stay_finite() {
    let gaussians = awkward();
    let found = read(&written(&gaussians)).unwrap();
    assert_eq!(found.num_gaussians(), gaussians.num_gaussians());
    // Few different values have no error.
    assert_eq!(found.log_scales(), gaussians.log_scales());
    let [w, ..] = found.quats()[0];
    assert!(w > 0.99);
}

#[test]
fn marks_and_bytes_are_those_of_the_gaussians() {
    let gaussians = random(30, 1);
    assert_eq!(written(&gaussians), written(&gaussians));
    assert!(!read(&written(&gaussians)).unwrap().layout().is_antialiased());
    let layout = Layout::with_harmonics(1).antialiased(true);
    let bytes = written(&gaussians.extended(&layout));
    assert_eq!(*read(&bytes).unwrap().layout(), layout);
    let dropped = read_with(&bytes, HigherHarmonics::Drop.into()).unwrap();
    assert_eq!(*dropped.layout(), Layout::base().antialiased(true));
    let turned = read_with(&bytes, ReadSettings { axes: Some(Axes::RUB), ..ReadSettings::default() }).unwrap();
    assert!(turned.means().iter().zip(dropped.means()).all(|(a, b)| *a == [b[0], -b[1], -b[2]]));
}

/// The entries of an archive.
fn entries(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).unwrap();
    let all = (0..archive.len()).map(|i| {
        let mut entry = archive.by_index(i).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        (entry.name().unwrap().into_owned(), bytes)
    });
    all.collect()
}

fn zipped(entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        archive.start_file(name, SimpleFileOptions::default()).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// A file with an edited table.
fn edited(bytes: &[u8], edit: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let mut entries = entries(bytes);
    let mut meta = serde_json::from_slice(&entries[0].1).unwrap();
    edit(&mut meta);
    entries[0].1 = serde_json::to_vec(&meta).unwrap();
    zipped(&entries)
}

#[test]
fn a_file_in_a_folder_of_its_archive_is_read() {
    let bytes = written(&random(30, 2));
    let moved: Vec<_> = entries(&bytes).into_iter().map(|(name, bytes)| (format!("scene/{name}"), bytes)).collect();
    assert_eq!(read(&zipped(&moved)).unwrap(), read(&bytes).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zip");
    fs::write(&path, zipped(&moved)).unwrap();
    assert!(is_sog_file(&path));
    fs::write(&path, zipped(&moved[1..])).unwrap();
    assert!(!is_sog_file(&path) && !is_sog_file(folder.path()));
    assert_eq!(read(&zipped(&moved[1..])).unwrap_err(), "has no meta.json, expected a SOG file");
}

#[test]
fn what_is_wrong_with_a_table_is_named() {
    let bytes = written(&random(300, 1));
    let problem = |edit: &dyn Fn(&mut serde_json::Value)| read(&edited(&bytes, edit)).err().unwrap();
    assert_eq!(problem(&|meta| meta["version"] = 3.into()), "is SOG of version 3, expected version 2");
    let first = problem(&|meta| drop(meta.as_object_mut().unwrap().remove("version")));
    assert_eq!(first, "is SOG of version 1, expected version 2");
    assert_eq!(problem(&|meta| meta["count"] = 0.into()), "holds no Gaussian, expected at least one");
    let many = problem(&|meta| meta["count"] = 321.into());
    assert_eq!(many, "means_l.webp has 320 pixels, expected at least 321");
    let many = problem(&|meta| meta["count"] = u64::MAX.into());
    assert_eq!(many, "has 18446744073709551615 Gaussians, expected at most 268402689");
    let many = problem(&|meta| meta["count"] = 200_000_000.into());
    assert!(many.starts_with("needs ") && many.contains("bytes of memory, limit is"), "{many}");
    let degree = problem(&|meta| meta["shN"]["bands"] = 4.into());
    assert_eq!(degree, "has spherical harmonics of degree 4, expected 1 to 3");
    let wide = problem(&|meta| meta["shN"]["bands"] = 2.into());
    assert_eq!(wide, "shN_centroids.webp has 960 pixels, expected at least 2400");
    let palette = problem(&|meta| meta["shN"]["count"] = 65_537.into());
    assert_eq!(palette, "has a palette of 65537 rows, expected at most 65536");
    let palette = problem(&|meta| meta["shN"]["count"] = 299.into());
    assert_eq!(palette, "shN_labels.webp has row 299 at Gaussian 299, expected one of 299");
    let width = problem(&|meta| meta["shN"]["files"][0] = "means_l.webp".into());
    assert!(width.starts_with("means_l.webp has 320 pixels, expected at least 900"), "{width}");
    let name = problem(&|meta| meta["quats"]["files"][0] = "../quats.webp".into());
    assert_eq!(name, "has no ../quats.webp, expected the files that meta.json names");
    let name = problem(&|meta| meta["quats"]["files"] = serde_json::json!([]));
    assert!(name.starts_with("meta.json: ") && name.ends_with("expected the table of a SOG file"), "{name}");
    let quats = problem(&|meta| meta["quats"]["files"][0] = "sh0.webp".into());
    assert!(quats.starts_with("sh0.webp has alpha ") && quats.ends_with(", expected 252 to 255"), "{quats}");
    let short = problem(&|meta| meta["scales"]["codebook"] = serde_json::json!([0.5]));
    assert!(short.contains("scales.webp has place") && short.ends_with("expected one of 1 in its codebook"), "{short}");
    let infinite = problem(&|meta| meta["scales"]["codebook"][255] = 1e300.into());
    assert!(infinite.starts_with("log_scales of Gaussian"), "{infinite}");
    let infinite = problem(&|meta| meta["means"]["maxs"][1] = 1e300.into());
    assert!(infinite.starts_with("means of Gaussian"), "{infinite}");
    for json in ["", "[", "{}", "[[[[", "null", "{\"version\": 2}"] {
        let mut entries = entries(&bytes);
        entries[0].1 = json.into();
        let message = read(&zipped(&entries)).unwrap_err();
        assert!(message.contains("expected"), "{json}: {message}");
    }
    let deep = "[".repeat(100_000);
    let mut entries = entries(&bytes);
    entries[0].1 = deep.into();
    assert!(read(&zipped(&entries)).unwrap_err().starts_with("meta.json: recursion limit exceeded"));
    entries[0].1 = vec![b' '; (1 << 20) + 1];
    assert_eq!(read(&zipped(&entries)).unwrap_err(), "has meta.json of 1048577 bytes, expected at most 1048576");
}

#[test]
fn what_is_wrong_with_an_image_is_named() {
    let gaussians = random(300, 0);
    let all = entries(&written(&gaussians));
    let with = |name: &str, image: Vec<u8>| {
        let replaced =
            |(own, bytes): &(String, Vec<u8>)| (own.clone(), if own == name { image.clone() } else { bytes.clone() });
        read(&zipped(&all.iter().map(replaced).collect::<Vec<_>>())).unwrap_err()
    };
    for (name, bytes) in &all[1..] {
        for length in [0, 5, 20, bytes.len() / 2] {
            let message = with(name, bytes[..length].to_vec());
            let expected = "expected a lossless WebP image";
            assert!(message.starts_with(&format!("{name}: ")) && message.ends_with(expected), "{length}: {message}");
        }
    }
    let image = |width: u32, height: u32, color: image_webp::ColorType, bytes: &[u8]| {
        let mut encoded = Vec::new();
        image_webp::WebPEncoder::new(&mut encoded).encode(bytes, width, height, color).unwrap();
        encoded
    };
    // Without alpha every alpha is 255: the largest component is z.
    let plain = image(20, 15, image_webp::ColorType::Rgb8, &[128; 900]);
    let found = with("means_l.webp", image(20, 14, image_webp::ColorType::Rgb8, &[0; 840]));
    assert_eq!(found, "means_l.webp has 280 pixels, expected at least 300");
    let replaced = |(name, bytes): &(String, Vec<u8>)| {
        (name.clone(), if name == "quats.webp" { plain.clone() } else { bytes.clone() })
    };
    let read_plain = read(&zipped(&all.iter().map(replaced).collect::<Vec<_>>())).unwrap();
    assert!(read_plain.quats().iter().all(|[.., z]| *z > 0.99));
    let alpha = with("quats.webp", image(20, 15, image_webp::ColorType::Rgba8, &[251; 1200]));
    assert_eq!(alpha, "quats.webp has alpha 251 at Gaussian 0, expected 252 to 255");
}

#[test]
fn an_image_that_takes_too_much_memory_is_refused() {
    // A large image of one colour is short.
    let mut all = entries(&written(&random(10, 0)));
    let mut encoded = Vec::new();
    let side = 4096;
    image_webp::WebPEncoder::new(&mut encoded)
        .encode(&vec![0; side * side], side as u32, side as u32, image_webp::ColorType::L8)
        .unwrap();
    assert!(encoded.len() < 1 << 17, "{}", encoded.len());
    all[1].1 = encoded;
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), zipped(&all)).unwrap();
    let refused = read_gaussians(file.path(), ReadSettings::default()).unwrap_err();
    assert!(matches!(refused, InterchangeError::Limit { .. }), "{refused}");
    let unlimited = ReadSettings { limits: ReadLimits::NONE, ..ReadSettings::default() };
    assert_eq!(read_gaussians(file.path(), unlimited).unwrap().num_gaussians(), 10);
}

/// Damage behind the checksums of the archive.
#[test]
fn damaged_images_and_tables_do_no_harm() {
    let all = entries(&written(&random(70, 1)));
    let mut state = 1_u64;
    let mut below = |end: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % end
    };
    let mut refused = 0;
    for _ in 0..1000 {
        let mut mutant = all.clone();
        let which = below(mutant.len());
        let bytes = &mut mutant[which].1;
        for _ in 0..=below(3) {
            let end = if below(2) == 0 { bytes.len() } else { bytes.len().min(60) };
            let at = below(end);
            bytes[at] ^= 1 << below(8);
        }
        match read(&zipped(&mutant)) {
            Ok(gaussians) => assert!(gaussians.means().as_flattened().iter().all(|x| x.is_finite())),
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 100, "{refused}");
}

#[test]
fn a_known_file_has_known_numbers() {
    let mut gaussians = Gaussians::zeros(3);
    gaussians.means_mut().copy_from_slice(&[[0.0, 1.0, -3.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 3.0]]);
    gaussians.quats_mut().copy_from_slice(&[[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -2.0, 0.0], [0.1, 0.5, 0.5, 0.7]]);
    gaussians.log_scales_mut().copy_from_slice(&[[-1.0; 3], [-2.0, -1.0, -3.0], [-3.0; 3]]);
    gaussians.colors_mut().fill([0.5, 0.5 + HARMONIC_0 as f32, 0.5]);
    let all = entries(&written(&gaussians));
    let meta: serde_json::Value = serde_json::from_slice(&all[0].1).unwrap();
    assert_eq!((&meta["version"], &meta["count"]), (&2.into(), &3.into()));
    let (ln_2, ln_4) = (std::f64::consts::LN_2, 4.0_f64.ln());
    let near = |found: &serde_json::Value, expected: [f64; 3]| {
        assert!((0..3).all(|c| (found[c].as_f64().unwrap() - expected[c]).abs() < 1e-12), "{found}");
    };
    near(&meta["means"]["mins"], [-ln_2, ln_2, -ln_4]);
    near(&meta["means"]["maxs"], [ln_2, ln_2, ln_4]);
    near(&meta["scales"]["codebook"], [-3.0, -2.0, -1.0]);
    let pixels = |name: &str| {
        let (_, bytes) = all.iter().find(|(own, _)| own == name).unwrap();
        let mut decoder = image_webp::WebPDecoder::new(Cursor::new(bytes)).unwrap();
        let mut pixels = vec![0; decoder.output_buffer_size().unwrap()];
        decoder.read_image(&mut pixels).unwrap();
        pixels.as_chunks::<4>().0[..3].to_vec()
    };
    assert_eq!(pixels("means_u.webp"), [[128, 0, 0, 255], [255, 0, 128, 255], [0, 0, 255, 255]]);
    assert_eq!(pixels("scales.webp"), [[2, 2, 2, 255], [1, 2, 0, 255], [0, 0, 0, 255]]);
    assert_eq!(pixels("sh0.webp"), [[0, 1, 0, 128]; 3]);
    assert_eq!(pixels("quats.webp"), [[128, 128, 128, 252], [128, 128, 128, 254], [146, 218, 218, 255]]);
}

/// The folder of an unpacked SOG of some Gaussians.
fn unpacked(gaussians: &Gaussians) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in sog_files(gaussians).unwrap() {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    folder
}

#[test]
fn an_unpacked_sog_is_the_content_of_a_file() {
    let gaussians = random(300, 2);
    let folder = unpacked(&gaussians);
    let table = folder.path().join("meta.json");
    assert_eq!(sog_files(&gaussians).unwrap(), entries(&written(&gaussians)));
    assert_eq!(read_gaussians(&table, ReadSettings::default()).unwrap(), read(&written(&gaussians)).unwrap());
    assert!(is_sog_file(&table) && !is_sog_file(folder.path()));
    // The folder and its table are the same scene.
    for path in [folder.path(), &table] {
        let files = TimestepFiles::open(path, ReadSettings::default()).unwrap();
        assert_eq!((files.files(), files.kind()), (&[table.clone()][..], "SOG files"));
        let mut names = files.files_and_images();
        names.sort();
        let mut expected: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        expected.sort();
        assert_eq!(names, expected);
    }
    // Other files of Gaussians come first.
    fs::write(folder.path().join("000000.sog"), written(&random(5, 0))).unwrap();
    let files = TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap();
    assert_eq!(files.files(), [folder.path().join("000000.sog")]);
}

#[test]
fn what_is_wrong_with_an_unpacked_sog_is_named() {
    let folder = unpacked(&random(10, 0));
    let table = folder.path().join("meta.json");
    let problem = |settings: ReadSettings| {
        let message = read_gaussians(&table, settings).unwrap_err().to_string();
        message.strip_prefix(&format!("{}: ", table.display())).unwrap().to_owned()
    };
    let text = fs::read_to_string(&table).unwrap();
    // Only files beside the table are read.
    fs::create_dir(folder.path().join("other")).unwrap();
    fs::copy(folder.path().join("quats.webp"), folder.path().join("other/quats.webp")).unwrap();
    let absolute = folder.path().join("quats.webp").display().to_string().replace('\\', "/");
    for name in ["other/quats.webp", "./quats.webp", "other/../quats.webp", "other", "..", "", &absolute, "none.webp"] {
        fs::write(&table, text.replace("quats.webp", name)).unwrap();
        assert_eq!(problem(ReadSettings::default()), format!("has no {name}, expected the files that meta.json names"));
    }
    fs::write(&table, "{}").unwrap();
    assert_eq!(problem(ReadSettings::default()), "is SOG of version 1, expected version 2");
    fs::write(&table, " ".repeat((1 << 20) + 1)).unwrap();
    assert_eq!(problem(ReadSettings::default()), "has meta.json of 1048577 bytes, expected at most 1048576");
    fs::write(&table, &text).unwrap();
    let tight = ReadLimits { base_bytes: 100, expansion: 0, ..ReadLimits::default() };
    assert!(problem(ReadSettings { limits: tight, ..ReadSettings::default() }).starts_with("needs "));
    let image = folder.path().join("means_u.webp");
    let bytes = fs::read(&image).unwrap();
    fs::write(&image, &bytes[..bytes.len() / 2]).unwrap();
    let damaged = problem(ReadSettings::default());
    assert!(damaged.starts_with("means_u.webp: ") && damaged.ends_with("expected a lossless WebP image"), "{damaged}");
}

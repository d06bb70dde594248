use std::path::PathBuf;

use tcgs_core::rotmat_from_quat;

use super::*;

fn file(name: &str) -> Vec<u8> {
    std::fs::read(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange").join(name)).unwrap()
}

/// Reads a file; an error is the problem as one line.
fn read(bytes: &[u8]) -> Result<Gaussians, String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    read_spz(file.path(), ReadSettings::default()).map_err(|error| {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
    })
}

fn gunzip(bytes: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    GzDecoder::new(bytes).read_to_end(&mut plain).unwrap();
    plain
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = Vec::new();
    flate2::read::GzEncoder::new(bytes, flate2::Compression::fast()).read_to_end(&mut packed).unwrap();
    packed
}

/// A file with some bytes replaced.
fn with(bytes: &[u8], at: usize, new: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[at..at + new.len()].copy_from_slice(new);
    bytes
}

#[test]
fn extensions_say_which_axes_a_file_has() {
    let plain = gunzip(&file("splat_transform_v3.spz"));
    let as_is = read(&gzip(&plain)).unwrap();
    let record =
        |kind: u32, content: &[u8]| [&kind.to_le_bytes()[..], &(content.len() as u32).to_le_bytes(), content].concat();
    let system = |system: u32| record(COORDINATE_SYSTEM, &system.to_le_bytes());
    let other = record(0xADBE_0002, &[0; 12]);
    let flagged = with(&plain, 14, &[2]);
    let read_with = |records: &[u8]| read(&gzip(&[&flagged, records].concat()));
    assert_eq!(read_with(&[]).unwrap(), as_is);
    assert_eq!(read_with(&other).unwrap(), as_is);
    // RDF, as PLY files, and unspecified, which is as without the extension.
    assert_eq!(read_with(&[other.clone(), system(6)].concat()).unwrap(), as_is);
    assert_eq!(read_with(&system(0)).unwrap(), as_is);
    let rub = read_with(&system(4)).unwrap();
    assert!(rub.means().iter().zip(as_is.means()).all(|(a, b)| *a == [b[0], -b[1], -b[2]]));
    // RUF is a reflection of RUB along z; shapes are reflected with the positions.
    let ruf = read_with(&system(8)).unwrap();
    let (a, b) = (rotmat_from_quat(ruf.quats()[5]), rotmat_from_quat(rub.quats()[5]));
    assert!(ruf.means()[5][2] == -rub.means()[5][2] && ruf.means()[5][1] == rub.means()[5][1]);
    assert!((a[0][0] - b[0][0]).abs() < 1e-6 && (a[0][2] + b[0][2]).abs() < 1e-6);
    let message = read_with(&system(9)).unwrap_err();
    assert_eq!(message, "is in coordinate system 9, expected one of 1 to 8, whose y is up or down");
    let message = read_with(&system(4)[..11]).unwrap_err();
    assert_eq!(message, "has an extension that ends early, expected a whole one");

    // Version 4 has them between header and table.
    let bytes = file("splat_transform_v4.spz");
    let records = system(4);
    let head = with(&with(&bytes[..32], 14, &[2]), 16, &(32 + records.len() as u32).to_le_bytes());
    let v4 = read(&[&head, &records, &bytes[32..]].concat()).unwrap();
    assert_eq!(v4, rub);
}

#[test]
fn axes_of_the_settings_win_and_assumed_ones_are_noted() {
    let plain = gunzip(&file("splat_transform_v3.spz"));
    let declared = [&COORDINATE_SYSTEM.to_le_bytes()[..], &4_u32.to_le_bytes(), &4_u32.to_le_bytes()].concat();
    let unspecified = [&COORDINATE_SYSTEM.to_le_bytes()[..], &4_u32.to_le_bytes(), &0_u32.to_le_bytes()].concat();
    let unknown = [&COORDINATE_SYSTEM.to_le_bytes()[..], &4_u32.to_le_bytes(), &9_u32.to_le_bytes()].concat();
    let flagged = with(&plain, 14, &[2]);
    let target = tempfile::NamedTempFile::new().unwrap();
    let notes = |bytes: &[u8], axes: Option<Axes>| {
        std::fs::write(target.path(), gzip(bytes)).unwrap();
        let settings = ReadSettings { axes, ..ReadSettings::default() };
        let files = crate::TimestepFiles::open(target.path(), settings).unwrap();
        (files.at(0).unwrap(), files.notes())
    };
    let assumed = vec![crate::ReadNote::AssumedAxes(Axes::RDF)];
    let (rdf, noted) = notes(&plain, None);
    assert_eq!(noted, assumed);
    assert_eq!(noted[0].to_string(), "axes assumed rdf, as PLY files have");
    assert_eq!(notes(&[&flagged[..], &unspecified].concat(), None), (rdf.clone(), assumed));
    let (rub, noted) = notes(&[&flagged[..], &declared].concat(), None);
    assert!(noted.is_empty() && rub != rdf);
    assert_eq!(notes(&plain, Some(Axes::RUB)), (rub, vec![]));
    // Also over what a file declares, even if that is not read.
    for declared in [declared, unknown] {
        assert_eq!(notes(&[&flagged[..], &declared].concat(), Some(Axes::RDF)), (rdf.clone(), vec![]));
    }
}

#[test]
fn the_flag_of_antialiasing_is_of_the_layout() {
    let plain = gunzip(&file("splat_transform_v3.spz"));
    let as_is = read(&gzip(&plain)).unwrap();
    assert!(!as_is.layout().is_antialiased());
    for gaussians in
        [read(&gzip(&with(&plain, 14, &[1]))).unwrap(), read(&with(&file("splat_transform_v4.spz"), 14, &[1])).unwrap()]
    {
        assert!(gaussians.layout().is_antialiased());
        assert_eq!((gaussians.means(), gaussians.layout().sh_degree()), (as_is.means(), 3));
    }
    let folder = tempfile::tempdir().unwrap();
    let named = folder.path().join("1.spz");
    std::fs::write(&named, gzip(&with(&plain, 14, &[1]))).unwrap();
    let layout = read_head(&named, HigherHarmonics::Drop.into()).unwrap().layout;
    assert!(layout.is_antialiased() && layout.is_base());
    // A sequence is of one kind.
    std::fs::write(folder.path().join("0.spz"), gzip(&plain)).unwrap();
    let problem = crate::TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap_err().to_string();
    let expected =
        "1.spz: has spherical harmonics of degree 3, antialiased, expected spherical harmonics of degree 3 as in ";
    assert!(problem.contains(expected), "{problem}");
}

#[test]
fn what_is_wrong_is_named() {
    let ends_early = "ends early, expected a whole SPZ file";
    for name in ["splat_transform_v3.spz", "splat_transform_v4.spz", "spz_v2.spz"] {
        let bytes = file(name);
        for length in [0, 1, 3, 15, 16, 20, 31, 40, 100, bytes.len() / 2, bytes.len() - 9] {
            let message = read(&bytes[..length]).unwrap_err();
            assert!(message.contains("expected"), "{name}, {length}: {message}");
        }
        assert_eq!(read(&bytes[..bytes.len() / 2]).unwrap_err(), ends_early, "{name}");
    }
    let plain = gunzip(&file("splat_transform_v3.spz"));
    let v3 = |at: usize, new: &[u8]| read(&gzip(&with(&plain, at, new))).unwrap_err();
    assert_eq!(v3(0, b"XGSP"), "does not begin with NGSP, expected an SPZ file");
    for version in [0_u8, 1, 4, 5] {
        let expected = "packed by gzip, expected version 2 or 3 of gzip, or 4";
        assert_eq!(v3(4, &[version]), format!("is SPZ of version {version}, {expected}"));
    }
    assert_eq!(v3(8, &0_u32.to_le_bytes()), "holds no Gaussian, expected at least one");
    assert_eq!(v3(8, &261_u32.to_le_bytes()), ends_early);
    assert_eq!(v3(8, &u32::MAX.to_le_bytes()), ends_early);
    assert_eq!(v3(12, &[5]), "has spherical harmonics of degree 5, expected 0 to 3");
    assert_eq!(v3(13, &[25]), "has 25 fractional bits of positions, expected at most 24");
    let long = [plain.clone(), vec![0; MAX_EXTENSIONS as usize + 2]].concat();
    assert!(read(&gzip(&long)).unwrap_err().starts_with("holds more than 1048576 bytes behind its Gaussians"));
    let packed = gzip(&plain);
    let message = read(&with(&packed, packed.len() - 8, &[1, 2, 3, 4])).unwrap_err();
    assert!(message.ends_with("expected a whole SPZ file"), "{message}");

    let bytes = file("splat_transform_v4.spz");
    let v4 = |at: usize, new: &[u8]| read(&with(&bytes, at, new)).unwrap_err();
    assert_eq!(v4(4, &[3]), "is SPZ of version 3, not packed by gzip, expected version 2 or 3 of gzip, or 4");
    assert_eq!(v4(15, &[5]), "has 5 streams, expected 6");
    assert_eq!(v4(12, &[0]), "has 6 streams, expected 5");
    assert_eq!(v4(8, &261_u32.to_le_bytes()), "has 2340 bytes in stream 0, expected 2349");
    assert_eq!(v4(8, &u32::MAX.to_le_bytes()), ends_early);
    assert!(v4(16, &[31]).starts_with("has its table at byte 31, expected it from 32 on"));
    assert!(v4(16, &u32::MAX.to_le_bytes()).starts_with("has its table at byte 4294967295"));
    assert_eq!(v4(32, &u64::MAX.to_le_bytes()), ends_early);
    assert!(v4(32 + 96, b"none").ends_with("expected a Zstandard frame"), "{}", v4(32 + 96, b"none"));
}

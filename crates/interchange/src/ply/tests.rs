use tcgs_core::Attribute;

use super::*;

/// The value of every property in the files of [`original`]: different for each.
fn value(gaussian: usize, property: usize) -> f32 {
    0.37 + 0.1 * gaussian as f32 - 0.03 * property as f32
}

/// Names of the properties as the original writes them.
fn names(num_rest: usize) -> Vec<String> {
    let numbered = |name: &str, count: usize| (0..count).map(|i| format!("{name}_{i}")).collect::<Vec<_>>();
    [
        ["x", "y", "z", "nx", "ny", "nz"].map(String::from).to_vec(),
        numbered("f_dc", 3),
        numbered("f_rest", num_rest),
        vec!["opacity".into()],
        numbered("scale", 3),
        numbered("rot", 4),
    ]
    .concat()
}

/// A file of three Gaussians as the original program writes it.
fn original(format: &str, names: &[String], write: impl Fn(f32) -> Vec<u8>) -> Vec<u8> {
    let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
    let header = format!("ply\nformat {format} 1.0\nelement vertex 3\n{properties}end_header\n");
    let row = |gaussian: usize| -> Vec<u8> {
        let mut row: Vec<u8> = (0..names.len()).flat_map(|property| write(value(gaussian, property))).collect();
        if format == "ascii" {
            row.push(b'\n');
        }
        row
    };
    [header.into_bytes(), (0..3).flat_map(row).collect()].concat()
}

fn little_endian(names: &[String]) -> Vec<u8> {
    original("binary_little_endian", names, |x| x.to_le_bytes().to_vec())
}

fn read(bytes: &[u8], settings: ReadSettings) -> Result<Gaussians, String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    read_ply(file.path(), settings).map_err(|error| {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
    })
}

/// Checks the contents of the files of [`original`].
fn check(gaussians: &Gaussians, num_rest: usize) {
    assert_eq!(gaussians.num_gaussians(), 3);
    for i in 0..3 {
        let of = |property: usize| value(i, property);
        let color = |dc: f32| 0.5 + 0.282_094_8 * dc;
        let after = 9 + num_rest;
        assert_eq!(gaussians.means()[i], [of(0), of(1), of(2)]);
        for c in 0..3 {
            assert!((gaussians.colors()[i][c] - color(of(6 + c))).abs() < 1e-7);
        }
        assert_eq!(gaussians.logit_opacities()[i], of(after));
        assert_eq!(gaussians.log_scales()[i], [1, 2, 3].map(|c| of(after + c)));
        assert_eq!(gaussians.quats()[i], [4, 5, 6, 7].map(|c| of(after + c)));
    }
}

#[test]
fn files_of_the_original_are_read_in_every_encoding() {
    for (degree, num_rest) in [0, 9, 24, 45].into_iter().enumerate() {
        let names = names(num_rest);
        let files = [
            little_endian(&names),
            original("binary_big_endian", &names, |x| x.to_be_bytes().to_vec()),
            original("ascii", &names, |x| format!("{x} ").into_bytes()),
        ];
        for file in files {
            check(&read(&file, HigherHarmonics::Drop.into()).unwrap(), num_rest);
            let kept = read(&file, ReadSettings::default()).unwrap();
            check(&kept, num_rest);
            assert_eq!(*kept.layout(), Layout::with_harmonics(degree));
            // Property 9 is f_rest_0; all of red come first, then all of green.
            for i in 0..3 {
                let rest: Vec<f32> = (0..num_rest).map(|k| value(i, 9 + k)).collect();
                let mut k = 0;
                for band in kept.layout().harmonics() {
                    let of_gaussian = &kept.values(band)[i * band.components()..][..band.components()];
                    for rgb in of_gaussian.chunks(3) {
                        assert_eq!(rgb, [0, 1, 2].map(|channel| rest[channel * num_rest / 3 + k]));
                        k += 1;
                    }
                }
                assert_eq!(3 * k, num_rest);
            }
        }
    }
}

#[test]
fn harmonics_come_back_with_their_bits_in_the_order_of_the_original() {
    for num_rest in [9, 24, 45] {
        let names = names(num_rest);
        let file = little_endian(&names);
        let gaussians = read(&file, ReadSettings::default()).unwrap();
        let mut written = Vec::new();
        write_ply_to(&mut written, &gaussians).unwrap();
        assert_eq!(written.len(), file.len());
        let header = file.len() - 3 * 4 * names.len();
        assert_eq!(written[..header], file[..header]);
        for (i, name) in (0..3 * names.len()).map(|i| (i, &names[i % names.len()])) {
            let at = |bytes: &[u8]| f32::from_le_bytes(bytes[header + 4 * i..][..4].try_into().unwrap());
            let (found, expected) = (at(&written), at(&file));
            match &**name {
                "nx" | "ny" | "nz" => assert_eq!(found, 0.0),
                dc if dc.starts_with("f_dc") => assert!((found - expected).abs() < 2e-7),
                _ => assert_eq!(found.to_bits(), expected.to_bits(), "{name}"),
            }
        }
    }
}

#[test]
fn other_numbers_of_harmonics_are_refused() {
    for num_rest in [1, 8, 10, 27, 48] {
        let file = little_endian(&names(num_rest));
        let message = read(&file, ReadSettings::default()).unwrap_err();
        let expected = "expected 0, 9, 24 or 45: spherical harmonics of degree 0 to 3";
        assert_eq!(message, format!("has {num_rest} properties f_rest, {expected}"));
        check(&read(&file, HigherHarmonics::Drop.into()).unwrap(), num_rest);
    }
    let mut odd = names(9);
    odd[9 + 4] = "f_rest_9".into();
    let message = read(&little_endian(&odd), ReadSettings::default()).unwrap_err();
    assert_eq!(message, "has no property f_rest_4, expected f_rest_0 to f_rest_8");
}

#[test]
fn order_and_company_of_properties_do_not_matter() {
    let file = little_endian(&names(0));
    let text = String::from_utf8_lossy(&file[..file.windows(10).position(|w| w == b"end_header").unwrap()]);
    let header = text.replace("property float nx", "property uchar red\nproperty double half");
    let header = header.replace("property float ny\nproperty float nz\n", "").replace("vertex 3", "vertex 1");
    let mut bytes = (header + "element face 0\nproperty list uchar int vertex_indices\nend_header\n").into_bytes();
    for property in 0..17 {
        match property {
            3 => bytes.extend([[200].as_slice(), &0.5_f64.to_le_bytes()].concat()),
            4 | 5 => {}
            _ => bytes.extend(value(0, property).to_le_bytes()),
        }
    }
    let one = read(&bytes, ReadSettings::default()).unwrap();
    assert_eq!(one, read(&file, ReadSettings::default()).unwrap().select(&[0]));
}

#[test]
fn gaussians_come_back_with_their_bits() {
    let mut gaussians = read(&little_endian(&names(0)), ReadSettings::default()).unwrap();
    gaussians.means_mut()[1] = [-0.0, f32::MIN_POSITIVE / 8.0, 1e30];
    gaussians.quats_mut()[2] = [-0.0, 3.0, -7e-20, 0.0];
    gaussians.colors_mut().copy_from_slice(&[[0.0, 1.0, 0.5], [1e-3, 0.1, 0.249_99], [2.0, 0.999_999, 1.0 / 3.0]]);
    let mut first = Vec::new();
    write_ply_to(&mut first, &gaussians).unwrap();
    let found = read(&first, ReadSettings::default()).unwrap();
    for attribute in Attribute::BASE {
        for (a, b) in gaussians.values(attribute).iter().zip(found.values(attribute)) {
            if attribute == Attribute::Color {
                assert!((a - b).abs() <= 3e-8, "{a} {b}");
            } else {
                assert_eq!(a.to_bits(), b.to_bits(), "{attribute:?}");
            }
        }
    }
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n";
    let properties: String = names(0).iter().map(|name| format!("property float {name}\n")).collect();
    let header = format!("{header}{properties}end_header\n");
    assert_eq!(first[..header.len()], *header.as_bytes(), "{}", String::from_utf8_lossy(&first[..300]));
    assert_eq!(first.len(), header.len() + 3 * 17 * 4);
}

#[test]
fn colours_below_zero_are_black() {
    let mut gaussians = Gaussians::zeros(1);
    gaussians.colors_mut()[0] = [-0.3, 0.0, 1.7];
    let mut bytes = Vec::new();
    write_ply_to(&mut bytes, &gaussians).unwrap();
    let found = read(&bytes, ReadSettings::default()).unwrap().colors()[0];
    assert_eq!((found[0], found[1]), (0.0, 0.0));
    assert!((found[2] - 1.7).abs() < 1e-6);

    // With harmonics the sum is what may not be negative; without those that were dropped it is the colour again.
    let mut bytes = Vec::new();
    write_ply_to(&mut bytes, &gaussians.extended(&Layout::with_harmonics(1))).unwrap();
    assert!((read(&bytes, ReadSettings::default()).unwrap().colors()[0][0] + 0.3).abs() < 3e-8);
    assert_eq!(read(&bytes, HigherHarmonics::Drop.into()).unwrap().colors()[0], found);
}

#[test]
fn what_is_wrong_is_named() {
    let whole = little_endian(&names(0));
    let problem = |bytes: &[u8]| read(bytes, ReadSettings::default()).unwrap_err();
    let edited = |from: &str, to: &str| {
        let end = whole.windows(10).position(|w| w == b"end_header").unwrap();
        let header = String::from_utf8(whole[..end].to_vec()).unwrap();
        assert!(header.contains(from));
        problem(&[header.replacen(from, to, 1).as_bytes(), &whole[end..]].concat())
    };
    for name in &PROPERTIES[..REQUIRED] {
        let message = edited(&format!("property float {name}\n"), "property float other\n");
        assert!(message.starts_with(&format!("has no property {name}, expected x, y, z")), "{message}");
    }
    assert_eq!(edited("vertex 3", "vertex 4"), "ends early, expected a whole PLY file");
    assert_eq!(edited("vertex 3", "vertex 18446744073709551615"), "ends early, expected a whole PLY file");
    assert_eq!(edited("vertex 3", "vertex 0"), "holds no Gaussian, expected at least one");
    assert_eq!(edited("element vertex", "element face"), "holds face first, expected the element vertex");
    assert_eq!(edited("element vertex", "element chunk"), "holds the element chunk alone, expected chunk and vertex");
    let message = edited("property float x", "property list uchar float x");
    assert!(message.ends_with("expected a PLY file of 3D Gaussians"), "{message}");
    let message = problem(b"glTF\n");
    assert!(message.ends_with("expected a PLY file of 3D Gaussians"), "{message}");
    assert_eq!(problem(b"ply\n"), "ends early, expected a whole PLY file");
    let mut spoilt = whole.clone();
    let at = spoilt.len() - 4 * (17 + 8);
    spoilt[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(problem(&spoilt), "logit_opacities of Gaussian 1: NaN, expected a finite number");
    // More Gaussians than the file has bytes for are seen before any is read.
    let path = tempfile::NamedTempFile::new().unwrap();
    let end = whole.windows(10).position(|w| w == b"end_header").unwrap();
    let many = String::from_utf8(whole[..end].to_vec()).unwrap().replace("vertex 3", "vertex 1000");
    std::fs::write(path.path(), [many.as_bytes(), &whole[end..]].concat()).unwrap();
    assert!(read_head(path.path(), ReadSettings::default()).unwrap_err().to_string().contains("ends early"));
    assert!(matches!(
        read_ply(Path::new("/nowhere.ply"), HigherHarmonics::Drop.into()),
        Err(InterchangeError::Read { .. })
    ));
}

#[test]
fn what_is_wrong_with_a_compressed_file_is_named() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange");
    let whole = std::fs::read(folder.join("splat_transform.compressed.ply")).unwrap();
    let end = whole.windows(10).position(|w| w == b"end_header").unwrap();
    let edited = |from: &str, to: &str| {
        let header = String::from_utf8(whole[..end].to_vec()).unwrap();
        assert!(header.contains(from));
        read(&[header.replacen(from, to, 1).as_bytes(), &whole[end..]].concat(), ReadSettings::default()).unwrap_err()
    };
    assert_eq!(edited("vertex 260", "vertex 600"), "has 2 chunks for 600 Gaussians, expected 3");
    assert_eq!(edited("vertex 260", "vertex 300"), "has harmonics of 260 Gaussians, expected 300");
    assert_eq!(edited("chunk 2", "chunk 9"), "has 9 chunks for 260 Gaussians, expected 2");
    assert_eq!(edited("element vertex", "element point"), "holds point after chunk, expected the element vertex");
    assert!(edited("packed_scale", "packed").starts_with("has no property packed_scale, expected packed_position"));
    assert!(edited("min_scale_y", "least").starts_with("has no property min_scale_y, expected min_x"));
    assert!(edited("f_rest_44", "other").starts_with("has 44 properties f_rest, expected 0, 9, 24 or 45"));
    for length in [whole.len() - 1, whole.len() / 2, end + 11] {
        let message = read(&whole[..length], ReadSettings::default()).unwrap_err();
        assert_eq!(message, "ends early, expected a whole PLY file", "{length}");
    }
    let mut spoilt = whole.clone();
    spoilt[end + 11..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let message = read(&spoilt, ReadSettings::default()).unwrap_err();
    assert_eq!(message, "means of Gaussian 0: NaN, expected a finite number");
    let dropped = read(&whole, HigherHarmonics::Drop.into()).unwrap();
    assert!(dropped.layout().is_base() && dropped.num_gaussians() == 260);
    // Before there were ranges of colours they lay between 0 and 1.
    let header = String::from_utf8(whole[..end].to_vec()).unwrap();
    let older = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"]
        .iter()
        .fold(header, |header, name| header.replace(&format!("property float {name}\n"), ""));
    let chunks = whole[end + 11..][..2 * 72].chunks(72).flat_map(|row| row[..48].to_vec()).collect::<Vec<_>>();
    let older = [older.as_bytes(), b"end_header\n", &chunks, &whole[end + 11 + 144..]].concat();
    let found = read(&older, ReadSettings::default()).unwrap();
    assert_eq!(found.means(), read(&whole, ReadSettings::default()).unwrap().means());
    assert!(found.colors().as_flattened().iter().all(|c| (0.0..=1.0).contains(c)));
}

/// A file with a comment behind its first line.
fn commented(bytes: &[u8], comments: &str) -> Vec<u8> {
    let end = bytes.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    [&bytes[..end], comments.as_bytes(), &bytes[end..]].concat()
}

#[test]
fn comments_say_whether_gaussians_are_antialiased() {
    let plain = little_endian(&names(9));
    for (comments, expected) in [
        ("", false),
        ("comment SplatRenderMode: mip\n", true),
        ("comment splatrendermode:  MIP\n", true),
        ("comment SplatRenderMode: default\n", false),
        ("comment antialiased 1\n", true),
        ("comment antialiased true\n", true),
        ("comment antialiased 0\n", false),
        ("comment antialiased: perhaps\ncomment mip\n", false),
        // The last one counts.
        ("comment SplatRenderMode: mip\ncomment Vertical axis: y\ncomment antialiased 0\n", false),
    ] {
        let bytes = commented(&plain, comments);
        let found = read(&bytes, ReadSettings::default()).unwrap();
        assert_eq!((found.layout().is_antialiased(), found.layout().sh_degree()), (expected, 1), "{comments}");
        check(&found, 9);
        let target = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(target.path(), &bytes).unwrap();
        assert_eq!(read_head(target.path(), ReadSettings::default()).unwrap().layout, *found.layout());
    }
    let path = std::path::PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../testdata/interchange/splat_transform.compressed.ply");
    let compressed = commented(&std::fs::read(path).unwrap(), "comment SplatRenderMode: mip\n");
    assert!(read(&compressed, ReadSettings::default()).unwrap().layout().is_antialiased());
}

#[test]
fn the_last_comment_that_names_a_background_counts() {
    let plain = little_endian(&names(9));
    for (comments, expected) in [
        ("", [0; 3]),
        ("comment tcgs background 118 120 103\n", [118, 120, 103]),
        ("comment tcgs background 1 2 3\ncomment tcgs background 4 5 6\ncomment red\n", [4, 5, 6]),
        ("comment tcgs background 1 2 256\n", [0; 3]),
        ("comment tcgs background 1 2\n", [0; 3]),
        ("comment tcgs background 1 2 3 4\n", [0; 3]),
    ] {
        let found = read(&commented(&plain, comments), ReadSettings::default()).unwrap();
        assert_eq!(found.layout().background(), expected, "{comments}");
    }
    let (layout, mut bytes) = (Layout::with_harmonics(1).antialiased(true).with_background([0, 9, 255]), Vec::new());
    write_ply_to(&mut bytes, &Gaussians::zeros_of(&layout, 2)).unwrap();
    assert_eq!(*read(&bytes, ReadSettings::default()).unwrap().layout(), layout);
}

#[test]
fn antialiased_gaussians_are_written_with_a_comment() {
    let written = |layout: &std::sync::Arc<Layout>| {
        let mut bytes = Vec::new();
        write_ply_to(&mut bytes, &Gaussians::zeros_of(layout, 2)).unwrap();
        bytes
    };
    let (plain, layout) = (written(&Layout::with_harmonics(1)), Layout::with_harmonics(1).antialiased(true));
    let bytes = written(&layout);
    let comment = b"comment SplatRenderMode: mip\n";
    let at = bytes.windows(comment.len()).position(|window| window == comment).unwrap();
    assert_eq!([&bytes[..at], &bytes[at + comment.len()..]].concat(), plain);
    assert_eq!(*read(&bytes, ReadSettings::default()).unwrap().layout(), layout);
}

#[test]
fn a_file_is_turned_from_the_axes_of_the_settings() {
    let bytes = little_endian(&names(9));
    let as_is = read(&bytes, ReadSettings::default()).unwrap();
    let turned = read(&bytes, ReadSettings { axes: Some(Axes::RUB), ..ReadSettings::default() }).unwrap();
    assert!(turned.means().iter().zip(as_is.means()).all(|(a, b)| *a == [b[0], -b[1], -b[2]]));
    let [w, x, y, z] = as_is.quats()[0];
    assert_eq!(turned.quats()[0], [w, x, -y, -z]);
}

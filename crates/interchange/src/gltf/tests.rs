use std::path::PathBuf;

use serde_json::{Value, json};
use tcgs_core::{Attribute, Gaussians, Layout, sigmoid};

use super::*;
use crate::axes::Axes;
use crate::{HigherHarmonics, ReadSettings};

/// Some Gaussians, all values different.
fn some(num_gaussians: usize, sh_degree: usize) -> Gaussians {
    let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(sh_degree), num_gaussians);
    for (a, attribute) in Layout::with_harmonics(sh_degree).attributes().enumerate() {
        for (i, value) in gaussians.values_mut(attribute).iter_mut().enumerate() {
            *value = (0.7 * i as f32 + a as f32).sin();
        }
    }
    gaussians.colors_mut().as_flattened_mut().iter_mut().for_each(|c| *c = c.abs());
    gaussians
}

fn glb(gaussians: &Gaussians) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_glb_to(&mut bytes, gaussians).unwrap();
    bytes
}

fn read_as(bytes: &[u8], settings: ReadSettings) -> Result<Gaussians, String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    crate::read_gaussians(file.path(), settings).map_err(|error| {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
    })
}

/// Reads a file; an error is the problem as one line.
fn read(bytes: &[u8]) -> Result<Gaussians, String> {
    read_as(bytes, ReadSettings::default())
}

/// The JSON and the buffer of a `.glb` file.
fn parts(bytes: &[u8]) -> (Value, Vec<u8>) {
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..20 + length]).unwrap(), bytes[28 + length..].to_vec())
}

/// A `.glb` file of changed JSON.
fn joined(document: &Value, buffer: &[u8]) -> Vec<u8> {
    let json = serde_json::to_vec(document).unwrap();
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, content) in [(JSON, &json[..]), (BIN, buffer)] {
        bytes.extend([content.len() as u32, kind].map(u32::to_le_bytes).as_flattened());
        bytes.extend(content);
    }
    bytes
}

#[test]
fn gaussians_come_back_up_to_activation() {
    for degree in 0..=3 {
        let mut gaussians = some(7, degree);
        gaussians.logit_opacities_mut()[..4].copy_from_slice(&[40.0, -60.0, 8.0, 0.0]);
        let bytes = glb(&gaussians);
        assert_eq!(bytes, glb(&gaussians));
        assert_eq!(u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize, bytes.len());
        let found = read(&bytes).unwrap();
        assert_eq!((found.layout(), found.means()), (gaussians.layout(), gaussians.means()));
        for band in gaussians.layout().harmonics() {
            assert_eq!(found.values(band), gaussians.values(band));
        }
        for (i, quat) in gaussians.quats().iter().enumerate() {
            let unit = tcgs_core::normalize(*quat);
            assert!((0..4).all(|c| (found.quats()[i][c] - unit[c]).abs() < 2e-7));
            let opacity = |gaussians: &Gaussians| sigmoid(f64::from(gaussians.logit_opacities()[i]));
            assert!((opacity(&found) - opacity(&gaussians)).abs() <= 6e-8);
        }
        let (a, b) = (found.values(Attribute::LogScale), gaussians.values(Attribute::LogScale));
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-7));
        let (a, b) = (found.values(Attribute::Color), gaussians.values(Attribute::Color));
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-7));
        let dropped = read_as(&bytes, HigherHarmonics::Drop.into()).unwrap();
        assert!(dropped.layout().is_base() && dropped.means() == gaussians.means());
    }
}

#[test]
fn attributes_are_those_of_splat_transform() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange");
    let original = crate::read_ply(&folder.join("original.ply"), ReadSettings::default()).unwrap();
    // Degree 1, as the other program was told.
    let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(1), original.num_gaussians());
    for attribute in Layout::with_harmonics(1).attributes() {
        gaussians.values_mut(attribute).copy_from_slice(original.values(attribute));
    }
    let (ours, our_bytes) = parts(&glb(&gaussians));
    let (theirs, their_bytes) = parts(&std::fs::read(folder.join("splat_transform.glb")).unwrap());
    let of = |document: &Value| document["meshes"][0]["primitives"][0].clone();
    assert_eq!(of(&ours)["extensions"], of(&theirs)["extensions"]);
    let names: Vec<String> = of(&ours)["attributes"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(names, of(&theirs)["attributes"].as_object().unwrap().keys().cloned().collect::<Vec<_>>());
    let bytes_of = |document: &Value, bytes: &[u8], name: &str| -> Vec<u8> {
        let accessor = &document["accessors"][of(document)["attributes"][name].as_u64().unwrap() as usize];
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let at = |key: &str| view[key].as_u64().unwrap() as usize;
        bytes[at("byteOffset")..][..at("byteLength")].to_vec()
    };
    for name in names {
        let (a, b) = (bytes_of(&ours, &our_bytes, &name), bytes_of(&theirs, &their_bytes, &name));
        assert_eq!(a.len(), b.len(), "{name}");
        // The two turn a Gaussian's own axes differently; that shapes are the same the reader's test shows.
        if name.ends_with("ROTATION") {
            continue;
        }
        let floats =
            |bytes: &[u8]| -> Vec<f32> { bytes.as_chunks().0.iter().map(|&x| f32::from_le_bytes(x)).collect() };
        let same = match &*name {
            "COLOR_0" => a.iter().zip(&b).all(|(a, b)| a.abs_diff(*b) <= 1),
            // The rounding of an sRGB colour, divided by the harmonic of degree 0.
            _ => floats(&a).iter().zip(floats(&b)).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs().max(0.4)),
        };
        assert!(same, "{name}");
    }
    let bounds = |document: &Value, key: &str| document["accessors"][0][key].clone();
    assert_eq!((bounds(&ours, "min"), bounds(&ours, "max")), (bounds(&theirs, "min"), bounds(&theirs, "max")));
}

#[test]
fn other_forms_of_a_file_are_read() {
    let gaussians = some(5, 1);
    let (mut document, buffer) = parts(&glb(&gaussians));
    let as_is = read(&glb(&gaussians)).unwrap();
    assert_eq!(read(&joined(&document, &buffer)).unwrap(), as_is);

    // JSON with the buffer inside, or in a file beside it.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    use base64::Engine;
    let inside = format!("data:application/octet-stream;base64,{}", base64::prelude::BASE64_STANDARD.encode(&buffer));
    std::fs::write(folder.path().join("a.bin"), &buffer).unwrap();
    for uri in [&*inside, "a.bin"] {
        document["buffers"][0]["uri"] = uri.into();
        std::fs::write(&path, document.to_string()).unwrap();
        assert_eq!(read_gltf(&path, ReadSettings::default()).unwrap(), as_is);
    }
    // One file of many names is read once; a document is no buffer.
    let again: Vec<Value> = (0..50).map(|_| json!({ "byteLength": 1, "uri": "a.bin" })).collect();
    let mut many = document.clone();
    many["buffers"].as_array_mut().unwrap().extend(again);
    std::fs::write(&path, many.to_string()).unwrap();
    assert_eq!(read_gltf(&path, ReadSettings::default()).unwrap(), as_is);
    many["buffers"][1]["uri"] = "a.gltf".into();
    std::fs::write(&path, many.to_string()).unwrap();
    let message = read_gltf(&path, ReadSettings::default()).unwrap_err().to_string();
    assert!(message.ends_with("names itself as buffer 1, expected another file"), "{message}");
    for uri in ["../a.bin", "/etc/passwd", "http://a/b", "b.bin"] {
        document["buffers"][0]["uri"] = uri.into();
        std::fs::write(&path, document.to_string()).unwrap();
        assert!(read_gltf(&path, ReadSettings::default()).is_err(), "{uri}");
    }
    document["buffers"][0].as_object_mut().unwrap().remove("uri");

    // Two nodes show the mesh, one inside the other; y of glTF points up.
    document["nodes"] = json!([{ "mesh": 0, "children": [1] }, { "mesh": 0, "translation": [0.0, 2.0, 0.0] }]);
    let twice = read(&joined(&document, &buffer)).unwrap();
    assert_eq!(twice.num_gaussians(), 10);
    assert!((twice.means()[7][1] - (as_is.means()[2][1] - 2.0)).abs() < 1e-6);

    // Rows apart, integers for numbers.
    let mut gaussians = as_is.clone();
    Axes::LUF.turn(&mut gaussians);
    let mut bytes = Vec::new();
    for i in 0..5 {
        bytes.extend(gaussians.means()[i].map(f32::to_le_bytes).as_flattened());
        let [w, x, y, z] = gaussians.quats()[i];
        bytes.extend([x, y, z, w].map(|x| ((x * 127.0).round() as i8).to_le_bytes()).as_flattened());
        bytes.extend(
            gaussians.log_scales()[i].map(|s| ((s.exp() * 10000.0).round() as u16).to_le_bytes()).as_flattened(),
        );
        bytes.extend([(sigmoid(gaussians.logit_opacities()[i]) * 255.0).round() as u8, 0]);
        bytes.extend(gaussians.colors()[i].map(|c| crate::stored::sh0_from_color(c).to_le_bytes()).as_flattened());
    }
    document["nodes"] = json!([{ "mesh": 0 }]);
    document["buffers"][0]["byteLength"] = bytes.len().into();
    document["bufferViews"] = json!([{ "buffer": 0, "byteLength": bytes.len(), "byteStride": 36 }]);
    let accessor = |at: usize, kind: u32, shape: &str, normalized: bool| json!({ "bufferView": 0, "byteOffset": at, "componentType": kind, "count": 5, "type": shape, "normalized": normalized });
    document["accessors"] = json!([
        accessor(0, 5126, "VEC3", false),
        accessor(12, 5120, "VEC4", true),
        accessor(16, 5123, "VEC3", false),
        accessor(22, 5121, "SCALAR", true),
        accessor(24, 5126, "VEC3", false),
    ]);
    document["meshes"][0]["primitives"][0]["attributes"] = json!({
        "POSITION": 0, "KHR_gaussian_splatting:ROTATION": 1, "KHR_gaussian_splatting:SCALE": 2,
        "KHR_gaussian_splatting:OPACITY": 3, "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0": 4,
    });
    let quantised = read(&joined(&document, &bytes)).unwrap();
    assert_eq!(quantised.means(), as_is.means());
    for i in 0..5 {
        assert!((0..4).all(|c| (quantised.quats()[i][c] - as_is.quats()[i][c]).abs() <= 0.5 / 127.0 + 1e-6));
        let (a, b) = (quantised.log_scales()[i], as_is.log_scales()[i]);
        assert!((0..3).all(|c| (a[c].exp() - 10000.0 * b[c].exp()).abs() < 0.51), "{a:?} {b:?}");
        let opacity = |gaussians: &Gaussians| sigmoid(gaussians.logit_opacities()[i]);
        assert!((opacity(&quantised) - opacity(&as_is)).abs() <= 0.5 / 255.0 + 1e-6);
    }
}

#[test]
fn what_is_wrong_is_named() {
    let whole = glb(&some(3, 1));
    for length in [0, 3, 11, 12, 19, 25, 400, whole.len() - 1] {
        let message = read(&whole[..length]).unwrap_err();
        assert!(message.contains("expected"), "{length}: {message}");
    }
    let (document, buffer) = parts(&whole);
    let problem = |change: &dyn Fn(&mut Value)| {
        let mut document = document.clone();
        change(&mut document);
        read(&joined(&document, &buffer)).unwrap_err()
    };
    let index = |name: &str| {
        let primitive = &document["meshes"][0]["primitives"][0];
        primitive["attributes"][name].as_u64().unwrap() as usize
    };
    let mut old = whole.clone();
    old[4] = 1;
    assert_eq!(read(&old).unwrap_err(), "is glTF of version 1, expected 2");
    assert!(read(b"{}").unwrap_err().starts_with("has no scene"));
    assert!(read(b"{ \"scenes\": 3 }").unwrap_err().ends_with("expected a glTF file"));
    assert_eq!(
        problem(&|d| d["extensionsRequired"] = json!(["KHR_gaussian_splatting_compression_spz_2"])),
        "requires the extension KHR_gaussian_splatting_compression_spz_2, expected KHR_gaussian_splatting alone"
    );
    let of = |d: &mut Value, key: &str, new: Value| d["meshes"][0]["primitives"][0][key] = new;
    assert_eq!(problem(&|d| of(d, "mode", 4.into())), "has Gaussians of mode 4, expected 0");
    let extension = |key: &'static str, new: &'static str| {
        problem(&|d| d["meshes"][0]["primitives"][0]["extensions"][EXTENSION][key] = new.into())
    };
    assert!(extension("kernel", "disk").starts_with("has Gaussians of kernel \"disk\""));
    assert!(extension("colorSpace", "lin_rec709_display").starts_with("has colours in \"lin_rec709_display\""));
    assert_eq!(
        problem(&|d| of(d, "extensions", json!({}))),
        "shows no primitive with KHR_gaussian_splatting, expected one"
    );
    let message = problem(&|d| {
        d["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove(&attribute("SCALE"));
    });
    assert!(message.starts_with("has no attribute KHR_gaussian_splatting:SCALE, expected"), "{message}");
    let accessor = |name: &str, key: &'static str, new: Value| {
        let at = index(name);
        problem(&|d| d["accessors"][at][key] = new.clone())
    };
    assert_eq!(accessor("POSITION", "count", 0.into()), "holds no Gaussian, expected at least one");
    let message = "POSITION of 4 rows ends early, expected a whole one";
    assert_eq!(accessor("POSITION", "count", 4.into()), message);
    let most = accessor("POSITION", "count", u64::MAX.into());
    assert!(most.starts_with("needs 18446744073709551615 bytes of memory, limit is "), "{most}");
    let opacity = attribute("OPACITY");
    assert_eq!(accessor(&opacity, "count", 2.into()), format!("{opacity} is of 2 Gaussians, expected 3"));
    assert_eq!(accessor(&opacity, "type", "VEC2".into()), format!("{opacity} is VEC2, expected SCALAR"));
    assert_eq!(accessor(&opacity, "sparse", json!({})), format!("{opacity} is sparse SCALAR, expected SCALAR"));
    assert!(accessor(&opacity, "componentType", 5125.into()).contains("has components of type 5125, expected"));
    assert!(accessor(&opacity, "bufferView", 99.into()).contains("has no buffer view"));
    assert!(problem(&|d| d["bufferViews"][0]["byteOffset"] = u64::MAX.into()).contains("ends early"));
    assert!(problem(&|d| d["buffers"][0]["byteLength"] = u64::MAX.into()).contains("in buffer 0, expected"));
    let twice = problem(&|d| d["nodes"] = json!([{ "mesh": 0, "children": [0] }]));
    assert_eq!(twice, "comes to node 0 twice, expected a tree of nodes");
    assert!(problem(&|d| d["nodes"][0]["children"] = json!([7])).starts_with("has no node 7"));
    let message = problem(&|d| d["nodes"][0]["scale"] = json!([1.0, 1.0, 2.0]));
    assert!(message.starts_with("node 0 is placed by another transform, expected a rotation"), "{message}");
    let many = problem(&|d| {
        d["nodes"] =
            (0..40).map(|_| json!({ "mesh": 0 })).chain([json!({ "children": (0..40).collect::<Vec<_>>() })]).collect();
        d["scenes"][0]["nodes"] = json!([40]);
        d["accessors"].as_array_mut().unwrap().iter_mut().for_each(|a| a["count"] = 3.into());
        d["bufferViews"].as_array_mut().unwrap().iter_mut().for_each(|view| view["byteOffset"] = 0.into());
        d["buffers"][0]["byteLength"] = 36.into();
    });
    assert!(many.contains("expected"), "{many}");

    // Numbers out of range.
    let mut gaussians = some(3, 0);
    gaussians.means_mut()[1][2] = f32::NAN;
    let message = read(&glb(&gaussians)).unwrap_err();
    assert_eq!(message, "means of Gaussian 1: NaN, expected a finite number");
    let at = |name: &str| document["bufferViews"][index(name)]["byteOffset"].as_u64().unwrap() as usize;
    let with = |name: &str, value: f32| {
        let mut buffer = buffer.clone();
        buffer[at(name)..][..4].copy_from_slice(&value.to_le_bytes());
        read(&joined(&document, &buffer))
    };
    let scale = attribute("SCALE");
    assert_eq!(with(&scale, -1.5).unwrap_err(), "SCALE of Gaussian 0: -1.5, expected a number that is not negative");
    assert!(with(&scale, f32::NAN).unwrap_err().starts_with("log_scales of Gaussian 0: NaN"));
    assert_eq!(with(&scale, 0.0).unwrap().log_scales()[0][0], -20.0);
    assert_eq!(with(&opacity, 1.5).unwrap_err(), "OPACITY of Gaussian 0: 1.5, expected a number from 0 to 1");
    assert!(with(&opacity, f32::NAN).is_err());
    assert!(with(&opacity, 1.0).unwrap().logit_opacities()[0] > 16.0);
}

//! Files of version 1 and the values they mean, kept for ever: `testdata/bitstream/v1`; and files that must be refused:
//! `testdata/bitstream/refused`.
//!
//! `UPDATE_GOLDENS=1 cargo test -p tcgs-codec --test vectors` makes those that are missing; a file that exists keeps its
//! bytes. `testdata/bitstream/forge.py` makes what no encoder writes.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tcgs_codec::{
    CompactScene, CompressSettings, DecodeError, DecodeLimits, SceneInfo, application_data, compress, decode, encode,
    encode_with,
};
use tcgs_core::Attribute;

#[allow(dead_code)]
mod any_scene;
mod corner_scenes;
mod scenes;
use any_scene::any_scene;

/// Vectors with bytes that a decoder takes and no encoder writes.
const FORGED: [&str; 3] = ["dropped_bits", "optional_sections", "symbols_beyond"];

/// Every vector but those of `forge.py`: its name and the scene that it holds.
fn vectors() -> Vec<(&'static str, CompactScene)> {
    let mut layered = any_scene(6, 12, 3);
    layered.layers = vec![1, 2, 3];
    layered.segment_length = 5;
    let room = scenes::room(40, 9);
    let bit_map = scenes::mixed_widths(40);
    let compressed = |settings: CompressSettings| compress(&room, &bit_map, None, info(&room), &settings).unwrap();
    vec![
        ("empty", any_scene(0, 3, 1)),
        ("one_timestep", any_scene(4, 1, 2)),
        ("layers_and_segments", layered),
        ("one_timestep_segments", CompactScene { segment_length: 1, ..any_scene(3, 6, 4) }),
        ("long", CompactScene { segment_length: 120, ..any_scene(2, 300, 5) }),
        ("room_default", compressed(CompressSettings { segment_length: Some(4), ..Default::default() })),
        ("room_paper", compressed(CompressSettings { segment_length: Some(4), ..CompressSettings::paper() })),
        ("one_gaussian", corner_scenes::one_gaussian()),
        ("many_keypoints", corner_scenes::many_keypoints()),
        ("crowd", corner_scenes::crowd()),
        ("clamps", corner_scenes::clamps()),
        ("beyond_floats", corner_scenes::beyond_floats()),
        ("still", corner_scenes::still()),
    ]
}

fn info(room: &tcgs_core::DynamicGaussians) -> SceneInfo {
    // Not the version of the program: the bytes are to stay.
    SceneInfo { name: "room".into(), generator: "vectors".into(), ..SceneInfo::of(room) }
}

/// What a file says, and the floats of its first, middle and last timestep.
fn describe(scene: &CompactScene) -> Value {
    let info = &scene.info;
    let attribute = |a: Attribute| {
        let tracks = &scene.tracks[a.index()];
        let tracks: Vec<Value> = (0..tracks.len()).map(|i| json!([tracks.track(i).0, tracks.track(i).1])).collect();
        json!({
            "varies": scene.varies[a.index()],
            "widths": scene.bit_map.widths[a.index()],
            "tracks_of_times_and_codes": tracks,
        })
    };
    let last = scene.num_timesteps() - 1;
    let values = |timestep: usize| {
        let now = scene.at(timestep);
        // JSON has no infinity.
        let number = |x: &f32| if x.is_finite() { json!(x) } else { json!(x.to_string()) };
        let of = |a: Attribute| (a.name().to_owned(), now.values(a).iter().map(number).collect());
        json!({ "timestep": timestep, "values": Attribute::BASE.map(of).into_iter().collect::<serde_json::Map<_, _>>() })
    };
    let attributes = Attribute::BASE.map(|a| (a.name().to_owned(), attribute(a)));
    json!({
        "num_gaussians": info.num_gaussians,
        "num_timesteps": info.num_timesteps,
        "first_frame": info.first_frame,
        "downscale": info.downscale,
        "frame_rate": info.frame_rate,
        "color_space": info.color_space as u8,
        "up": info.up as u8,
        "name": info.name,
        "generator": info.generator,
        "segment_length": scene.segment_length,
        "layers": scene.layers,
        "attributes": attributes.into_iter().collect::<serde_json::Map<_, _>>(),
        "reconstructed": ([0, last / 2, last].map(values)),
    })
}

/// A line for each innermost list.
fn text(value: &Value) -> String {
    fn write(value: &Value, indent: usize, out: &mut String) {
        let nested = |v: &Value| v.is_array() || v.is_object();
        let (open, close, items): (_, _, Vec<(String, &Value)>) = match value {
            Value::Array(items) if items.iter().any(nested) && !items.iter().any(Value::is_number) => {
                ('[', ']', items.iter().map(|v| (String::new(), v)).collect())
            }
            Value::Object(items) => ('{', '}', items.iter().map(|(k, v)| (format!("{k:?}: "), v)).collect()),
            other => return out.push_str(&other.to_string()),
        };
        if items.iter().all(|(_, v)| v.is_array() && v.as_array().unwrap().iter().all(|x| !nested(x))) && open == '[' {
            return out.push_str(&value.to_string());
        }
        out.push(open);
        for (i, (key, item)) in items.iter().enumerate() {
            out.push_str(if i > 0 { ",\n" } else { "\n" });
            out.push_str(&" ".repeat(indent + 1));
            out.push_str(key);
            write(item, indent + 1, out);
        }
        out.push('\n');
        out.push_str(&" ".repeat(indent));
        out.push(close);
    }
    let mut out = String::new();
    write(value, 0, &mut out);
    out.push('\n');
    out
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream")
}

/// All `.tcgs` files of a folder, by their names without the ending.
fn files(folder: &Path) -> Vec<(String, PathBuf)> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "tcgs"));
    files.sort();
    files.into_iter().map(|path| (path.file_stem().unwrap().to_str().unwrap().to_owned(), path)).collect()
}

#[test]
fn every_vector_means_what_it_meant() {
    let folder = folder().join("v1");
    let made = vectors();
    if std::env::var_os("UPDATE_GOLDENS").is_some() {
        let write_missing = |path: PathBuf, bytes: &[u8]| path.exists() || fs::write(path, bytes).is_ok();
        for (name, scene) in &made {
            assert!(write_missing(folder.join(name).with_extension("tcgs"), &encode(scene).unwrap()));
        }
        for (_, path) in files(&folder) {
            let scene = decode(&fs::read(&path).unwrap(), &DecodeLimits::default()).unwrap();
            assert!(write_missing(path.with_extension("json"), text(&describe(&scene)).as_bytes()));
        }
    }
    let found = files(&folder);
    let expected = made.iter().map(|(name, _)| *name).chain(FORGED);
    assert!(expected.clone().all(|name| found.iter().any(|(found, _)| found == name)), "a vector is missing");
    assert_eq!(found.len(), expected.count());
    for (name, path) in found {
        let file = fs::read(&path).unwrap();
        let scene = decode(&file, &DecodeLimits::default()).unwrap();
        let expected = fs::read_to_string(path.with_extension("json")).unwrap();
        assert_eq!(text(&describe(&scene)), expected, "{name}");
        let data = application_data(&file, &DecodeLimits::default()).unwrap();
        let data: Vec<(&str, &[u8])> = data.iter().map(|(name, bytes)| (name.as_str(), *bytes)).collect();
        let again = encode_with(&scene, &data).unwrap();
        assert_eq!(
            again == file,
            !FORGED.contains(&name.as_str()),
            "{name}: other bytes for the same values, or forged"
        );
        assert_eq!(decode(&again, &DecodeLimits::default()).unwrap(), scene, "{name}");
    }
}

/// The bytes in the annotated dump of `docs/FORMAT.md`: an offset, bytes or `00 x N`, and what they mean, each two blanks
/// apart.
#[test]
fn the_annotated_file_is_the_vector() {
    let text = fs::read_to_string(folder().join("../../docs/FORMAT.md")).unwrap();
    let (_, dump) = text.split_once("\n## A file, byte by byte\n").unwrap();
    let dump = dump.split("```\n").nth(1).unwrap();
    let mut bytes = Vec::new();
    for line in dump.lines().filter(|line| !line.starts_with(' ')) {
        let mut fields = line.splitn(3, "  ");
        let offset = usize::from_str_radix(fields.next().unwrap(), 16).unwrap();
        assert_eq!(offset, bytes.len(), "{line}");
        let dumped = fields.next().unwrap();
        match dumped.strip_prefix("00 x ") {
            Some(count) => bytes.resize(offset + count.trim().parse::<usize>().unwrap(), 0),
            None => bytes.extend(dumped.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap())),
        }
    }
    assert_eq!(bytes, fs::read(folder().join("v1/one_gaussian.tcgs")).unwrap());
}

/// Kind, section and field of an error, as the table of refused files names them.
fn kind(error: &DecodeError) -> (&'static str, &'static str, &'static str) {
    match error {
        DecodeError::Format { section, field, .. } => ("format", section, field),
        DecodeError::Version { .. } => ("version", "version", "version"),
        DecodeError::Limit { .. } => ("limit", "limit", "limit"),
        other => panic!("{other}: of the machine"),
    }
}

#[test]
fn every_refused_file_is_refused_for_its_reason() {
    let folder = folder().join("refused");
    let table: Value = serde_json::from_slice(&fs::read(folder.join("refused.json")).unwrap()).unwrap();
    let table = table["files"].as_array().unwrap();
    let listed: Vec<&str> = table.iter().map(|row| row["file"].as_str().unwrap()).collect();
    let mut found: Vec<String> = files(&folder).into_iter().map(|(name, _)| format!("{name}.tcgs")).collect();
    found.sort_by_key(|name| listed.iter().position(|listed| listed == name));
    assert_eq!(found, listed);
    assert!(listed.len() >= 20);
    for row in table {
        let name = row["file"].as_str().unwrap();
        let file = fs::read(folder.join(name)).unwrap();
        let error = decode(&file, &DecodeLimits::default()).expect_err(name);
        let expected = ["kind", "section", "field"].map(|key| row[key].as_str().unwrap());
        assert_eq!(<[&str; 3]>::from(kind(&error)), expected, "{name}: {error}");
        // However the bytes arrive; where segments meet is seen by who joins them.
        if row["field"] != "keypoints" {
            let mut decoder = tcgs_codec::Decoder::new(DecodeLimits::default());
            let refused = file.chunks(13).any(|bytes| decoder.push(bytes).is_err());
            assert!(refused || !decoder.is_finished(), "{name}");
        }
    }
}

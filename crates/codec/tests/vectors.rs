//! Files of version 1 and the values they mean, kept for ever: `testdata/bitstream/v1`.
//!
//! `UPDATE_GOLDENS=1 cargo test -p tcgs-codec --test vectors` makes them anew.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tcgs_codec::{CompactScene, CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode};
use tcgs_core::Attribute;

#[allow(dead_code)]
mod any_scene;
mod scenes;
use any_scene::any_scene;

/// Every vector: its name and the scene that it holds.
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
        let of = |a: Attribute| (a.name().to_owned(), json!(now.values(a)));
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
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v1")
}

#[test]
fn every_vector_means_what_it_meant() {
    if std::env::var_os("UPDATE_GOLDENS").is_some() {
        fs::create_dir_all(folder()).unwrap();
        for (name, scene) in vectors() {
            fs::write(folder().join(name).with_extension("tcgs"), encode(&scene).unwrap()).unwrap();
            fs::write(folder().join(name).with_extension("json"), text(&describe(&scene))).unwrap();
        }
    }
    let mut found: Vec<PathBuf> = fs::read_dir(folder()).unwrap().map(|e| e.unwrap().path()).collect();
    found.retain(|path| path.extension().is_some_and(|e| e == "tcgs"));
    assert!(found.len() >= vectors().len());
    for path in found {
        let file = fs::read(&path).unwrap();
        let scene = decode(&file, &DecodeLimits::default()).unwrap();
        let expected = fs::read_to_string(path.with_extension("json")).unwrap();
        assert_eq!(text(&describe(&scene)), expected, "{}", path.display());
        assert_eq!(encode(&scene).unwrap(), file, "{}: other bytes for the same values", path.display());
    }
}

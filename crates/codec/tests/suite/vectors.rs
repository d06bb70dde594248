//! Golden files of both versions and their decoded values: `testdata/bitstream/v1`, kept for ever, and
//! `testdata/bitstream/v2`. Also files that must be refused: `testdata/bitstream/refused` and
//! `testdata/bitstream/refused_v2`.
//!
//! `UPDATE_GOLDENS=1 cargo test -p tcgs-codec --test suite vectors` makes missing files; an existing file keeps its
//! bytes. `forge.py` and `forge_v2.py` beside them make files that no encoder writes.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::any_scene::any_scene;
use crate::support::{cohort_scenes, corner_scenes, scenes};
use serde_json::{Value, json};
use tcgs_codec::{
    CompactScene, CompressSettings, DecodeError, DecodeLimits, SceneFile, SceneInfo, application_data, compress,
    decode, decode_cohorts, encode, encode_cohorts, encode_with,
};
use tcgs_core::{Activation, Attribute, Gaussians, Life};

/// Vectors of version 1 with bytes that a decoder accepts and no encoder writes.
const FORGED: [&str; 3] = ["dropped_bits", "optional_sections", "symbols_beyond"];
/// The same for version 2.
const FORGED_V2: [&str; 6] =
    ["born_and_gone", "declared_errors", "optional_sections", "skipped", "skipped_motion", "symbols_beyond"];

/// Every vector of version 1 except those of `forge.py`: its name and its scene.
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

/// Every vector of version 2 except those of `forge_v2.py`: its name and its content.
fn vectors_v2() -> [(&'static str, cohort_scenes::File); 11] {
    [
        ("one_gaussian", cohort_scenes::one_gaussian()),
        ("no_cohorts", cohort_scenes::no_cohorts()),
        ("cohorts", cohort_scenes::cohorts()),
        ("lives", cohort_scenes::lives()),
        ("sparse", cohort_scenes::sparse()),
        ("harmonics", cohort_scenes::harmonics()),
        ("shared_plan", cohort_scenes::shared_plan()),
        ("layers", cohort_scenes::layers()),
        ("flip_book", cohort_scenes::flip_book()),
        ("still", cohort_scenes::still()),
        ("antialiased", cohort_scenes::antialiased()),
    ]
}

fn info(room: &tcgs_core::DynamicGaussians) -> SceneInfo {
    // A fixed name instead of the program's version, so that the bytes stay.
    SceneInfo { name: "room".into(), generator: "vectors".into(), ..SceneInfo::of(room) }
}

/// The fields of `INFO` that both versions have.
fn describe_info(info: &SceneInfo) -> Value {
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
    })
}

/// Division, widths and tracks of a cohort; a file of version 1 has only one.
fn describe_cohort(scene: &CompactScene) -> Value {
    let attribute = |a: Attribute| {
        let tracks = &scene.tracks[a.index()];
        let tracks: Vec<Value> = (0..tracks.len()).map(|i| json!([tracks.track(i).0, tracks.track(i).1])).collect();
        let described = json!({
            "varies": scene.varies[a.index()],
            "widths": scene.bit_map.widths[a.index()],
            "tracks_of_times_and_codes": tracks,
        });
        (scene.layout.name(a).to_owned(), described)
    };
    json!({
        "segment_length": scene.segment_length,
        "layers": scene.layers,
        "attributes": scene.layout.attributes().map(attribute).collect::<serde_json::Map<_, _>>(),
    })
}

/// Floats at a timestep.
fn describe_values(timestep: usize, now: &Gaussians) -> Value {
    // JSON has no infinity.
    let number = |x: &f32| if x.is_finite() { json!(x) } else { json!(x.to_string()) };
    let of = |a: Attribute| (now.layout().name(a).to_owned(), now.values(a).iter().map(number).collect());
    json!({
        "timestep": timestep,
        "values": now.layout().attributes().map(of).collect::<serde_json::Map<_, _>>(),
    })
}

/// Adds the fields of `more`.
fn joined(mut value: Value, more: Value) -> Value {
    if let (Value::Object(fields), Value::Object(more)) = (&mut value, more) {
        fields.extend(more);
    }
    value
}

/// Content of a file of version 1, and the floats of its first, middle and last timestep.
fn describe(scene: &CompactScene) -> Value {
    let last = scene.num_timesteps() - 1;
    let values = [0, last / 2, last].map(|t| describe_values(t, &scene.at(t)));
    joined(joined(describe_info(&scene.info), describe_cohort(scene)), json!({ "reconstructed": values }))
}

/// Content of a file of version 2, and the floats of its first, middle and last timestep.
fn describe_v2(file: &[u8]) -> Value {
    let limits = DecodeLimits::default();
    let mut reader = SceneFile::open(std::io::Cursor::new(file), &limits, 0).unwrap();
    let info = reader.info().clone();
    let first_and_last = |life: &Life| [life.birth, life.death - 1];
    let cohort = |cohort: &CompactScene| {
        let mut described = joined(
            describe_cohort(cohort),
            json!({
                "start": cohort.start,
                "num_timesteps": cohort.info.num_timesteps,
                "num_gaussians": cohort.info.num_gaussians,
                "lives": cohort.lives.as_ref().map(|lives| lives.iter().map(first_and_last).collect::<Vec<_>>()),
                "names": cohort.layout.columns().iter().map(|column| &column.name).collect::<Vec<_>>(),
            }),
        );
        // Only present where it is true, so that older vectors keep their text.
        if cohort.layout.is_antialiased() {
            described["antialiased"] = json!(true);
        }
        for column in cohort.layout.columns() {
            let activation = Activation::ALL.iter().position(|&known| known == column.activation);
            let more = json!({ "unit": column.unit, "components": column.components(), "activation": activation });
            let attribute = &mut described["attributes"][&column.name];
            *attribute = joined(attribute.take(), more);
        }
        described
    };
    let cohorts: Vec<Value> = decode_cohorts(file, &limits).unwrap().1.iter().map(cohort).collect();
    let last = info.num_timesteps as usize - 1;
    let values = [0, last / 2, last].map(|t| describe_values(t, &reader.at(t).unwrap()));
    let errors = reader.archive().declared_errors();
    joined(describe_info(&info), json!({ "errors": errors, "cohorts": cohorts, "reconstructed": values }))
}

/// Formats JSON with one line for each innermost list.
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

/// Makes missing vectors on request, and checks the content of a folder.
///
/// - `made`: names and bytes
/// - `forged`: names of files that no encoder writes
/// - `describe`: decodes a file to JSON
/// - returns: names and bytes
fn vectors_of(
    folder: &Path,
    made: &[(&str, Vec<u8>)],
    forged: &[&str],
    describe: impl Fn(&[u8]) -> Value,
) -> Vec<(String, Vec<u8>)> {
    if std::env::var_os("UPDATE_GOLDENS").is_some() {
        let write_missing = |path: PathBuf, bytes: &[u8]| path.exists() || fs::write(path, bytes).is_ok();
        for (name, file) in made {
            assert!(write_missing(folder.join(name).with_extension("tcgs"), file));
        }
        for (_, path) in files(folder) {
            let file = fs::read(&path).unwrap();
            assert!(write_missing(path.with_extension("json"), text(&describe(&file)).as_bytes()));
        }
    }
    let found = files(folder);
    let expected = made.iter().map(|(name, _)| name).chain(forged);
    assert!(expected.clone().all(|name| found.iter().any(|(found, _)| found == name)), "a vector is missing");
    assert_eq!(found.len(), expected.count());
    let read = |(name, path): (String, PathBuf)| {
        let file = fs::read(&path).unwrap();
        let expected = fs::read_to_string(path.with_extension("json")).unwrap();
        assert_eq!(text(&describe(&file)), expected, "{name}");
        (name, file)
    };
    found.into_iter().map(read).collect()
}

/// Application data of a file.
fn data_of(file: &[u8]) -> Vec<(String, Vec<u8>)> {
    let data = application_data(file, &DecodeLimits::default()).unwrap();
    data.into_iter().map(|(name, bytes)| (name, bytes.to_vec())).collect()
}

fn borrowed(data: &[(String, Vec<u8>)]) -> Vec<(&str, &[u8])> {
    data.iter().map(|(name, bytes)| (name.as_str(), &bytes[..])).collect()
}

#[test]
fn every_vector_means_what_it_meant() {
    let made: Vec<_> = vectors().into_iter().map(|(name, scene)| (name, encode(&scene).unwrap())).collect();
    let decoded = |file: &[u8]| decode(file, &DecodeLimits::default()).unwrap();
    for (name, file) in vectors_of(&folder().join("v1"), &made, &FORGED, |file| describe(&decoded(file))) {
        let scene = decoded(&file);
        let again = encode_with(&scene, &borrowed(&data_of(&file))).unwrap();
        assert_eq!(
            again == file,
            !FORGED.contains(&name.as_str()),
            "{name}: other bytes for the same values, or forged"
        );
        assert_eq!(decoded(&again), scene, "{name}");
    }
}

#[test]
fn every_vector_of_version_2_means_what_it_meant() {
    let encoded = |(info, cohorts): cohort_scenes::File| encode_cohorts(&info, &cohorts, &[]).unwrap();
    let made: Vec<_> = vectors_v2().into_iter().map(|(name, file)| (name, encoded(file))).collect();
    for (name, file) in vectors_of(&folder().join("v2"), &made, &FORGED_V2, describe_v2) {
        let (info, cohorts) = decode_cohorts(&file, &DecodeLimits::default()).unwrap();
        let again = encode_cohorts(&info, &cohorts, &borrowed(&data_of(&file))).unwrap();
        assert_eq!(
            again == file,
            !FORGED_V2.contains(&name.as_str()),
            "{name}: other bytes for the same values, or forged"
        );
        assert_eq!(decode_cohorts(&again, &DecodeLimits::default()).unwrap(), (info, cohorts), "{name}");
    }
}

/// The bytes of an annotated dump in `docs/FORMAT.md`. A line has an offset, bytes or `00 x N`, and their meaning,
/// separated by two blanks.
fn dumped(text: &str, heading: &str) -> Vec<u8> {
    let (_, dump) = text.split_once(&format!("\n## {heading}\n")).unwrap();
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
    bytes
}

#[test]
fn the_annotated_files_are_the_vectors() {
    let text = fs::read_to_string(folder().join("../../docs/FORMAT.md")).unwrap();
    for (heading, file) in [
        ("A file, byte by byte", "v1/one_gaussian.tcgs"),
        ("A file of version 2, byte by byte", "v2/one_gaussian.tcgs"),
    ] {
        assert_eq!(dumped(&text, heading), fs::read(folder().join(file)).unwrap(), "{file}");
    }
}

/// Kind, section and field of an error, as in the table of refused files.
fn kind(error: &DecodeError) -> (&'static str, &'static str, &'static str) {
    match error {
        DecodeError::Format { section, field, .. } => ("format", section, field),
        DecodeError::Version { .. } => ("version", "version", "version"),
        DecodeError::Limit { .. } => ("limit", "limit", "limit"),
        other => panic!("{other}: of the machine"),
    }
}

/// All files of a folder that must be refused, and the reasons.
fn refused_files(folder: &Path) -> Vec<(Vec<u8>, Value)> {
    let table: Value = serde_json::from_slice(&fs::read(folder.join("refused.json")).unwrap()).unwrap();
    let table = table["files"].as_array().unwrap();
    let listed: Vec<&str> = table.iter().map(|row| row["file"].as_str().unwrap()).collect();
    let mut found: Vec<String> = files(folder).into_iter().map(|(name, _)| format!("{name}.tcgs")).collect();
    found.sort_by_key(|name| listed.iter().position(|listed| listed == name));
    assert_eq!(found, listed);
    assert!(listed.len() >= 20);
    let read = |row: &Value| (fs::read(folder.join(row["file"].as_str().unwrap())).unwrap(), row.clone());
    table.iter().map(read).collect()
}

#[test]
fn every_refused_file_is_refused_for_its_reason() {
    let of_folders = ["refused", "refused_v2"].map(|name| refused_files(&folder().join(name)));
    for (file, row) in of_folders.into_iter().flatten() {
        let name = row["file"].as_str().unwrap();
        let error = decode_cohorts(&file, &DecodeLimits::default()).expect_err(name);
        let expected = ["kind", "section", "field"].map(|key| row[key].as_str().unwrap());
        assert_eq!(<[&str; 3]>::from(kind(&error)), expected, "{name}: {error}");
        // A push decoder refuses the file, too, except for errors that only a reader of the whole file sees: borders of
        // segments, gaps, order, and common properties of cohorts.
        let is_of_whole = row["field"] == "keypoints" || row["field"] == "attributes" || row["section"] == "file";
        let mut decoder = tcgs_codec::Decoder::new(DecodeLimits::default());
        let refused = file.chunks(13).any(|bytes| decoder.push(bytes).is_err());
        assert!(refused || !decoder.is_finished() || is_of_whole, "{name}");
    }
}

/// Where a later version may extend version 2, and only there, the decoder says that a newer one may read the file.
#[test]
fn what_a_newer_decoder_may_read_is_told_from_what_is_wrong() {
    let refused = refused_files(&folder().join("refused_v2"));
    let newer =
        refused.iter().filter(|(file, _)| decode_cohorts(file, &DecodeLimits::default()).unwrap_err().is_newer());
    let newer: Vec<&str> = newer.map(|(_, row)| row["file"].as_str().unwrap()).collect();
    assert_eq!(newer, ["unknown_tag.tcgs", "flags.tcgs", "activation.tcgs", "coding.tcgs", "coding_of_means.tcgs"]);
}

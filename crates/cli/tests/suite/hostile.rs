//! Files made to exhaust memory or time are refused in one line, within little of both. Their texts do not control the
//! terminal.

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::*;
use flate2::{Compression, Crc};
use serde_json::{Value, json};
use tcgs_core::Gaussians;
use tcgs_interchange::{fourdgs_bytes, write_glb_to};
use tempfile::{TempDir, tempdir};

/// Largest memory for refusing a file of less than 1 MB, kilobytes.
const MOST_KILOBYTES: u64 = 200_000;
/// Limit on the time of a refusal. A refusal takes a tenth of a second; other tests run on the same processors.
const MOST_TIME: Duration = Duration::from_secs(10);

/// Output and exit code of a command, its peak memory (kB), and its time.
fn measured(arguments: &[&str]) -> (Output, u64, Duration) {
    let start = Instant::now();
    let mut child = tcgs().args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut most = 0;
    while child.try_wait().unwrap().is_none() {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        most = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(most);
        if most > 4 * MOST_KILOBYTES || start.elapsed() > 3 * MOST_TIME {
            child.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    (child.wait_with_output().unwrap(), most, start.elapsed())
}

/// Asserts that a command refuses its input in one line, and within little memory and time.
///
/// - `expected`: part of the line
fn is_refused(arguments: &[&str], expected: &str) {
    let (output, kilobytes, time) = measured(arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    println!("{kilobytes} kB, {} ms: {message}", time.as_millis());
    assert!(kilobytes < MOST_KILOBYTES, "{arguments:?}: {kilobytes} kB");
    assert!(time < MOST_TIME, "{arguments:?}: {time:?}");
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    let lines = message.lines().filter(|line| !line.starts_with("computing on ")).count();
    assert!(lines == 1 && message.contains(expected), "{arguments:?}: {message}");
}

/// Asserts that all commands that read a scene refuse a file.
fn no_command_reads(path: &Path, expected: &str) {
    let out = path.with_extension("out");
    let (plys, file) = (out.join("plys"), out.join("a.tcgs"));
    fs::create_dir_all(&out).unwrap();
    is_refused(&["export", text(path), "--to", text(&plys)], expected);
    is_refused(&["compress", text(path), "--out", text(&file)], expected);
    assert_eq!(fs::read_dir(&out).unwrap().count(), 0, "{}: something was written", path.display());
}

/// A folder for hostile files.
struct Place(TempDir);

impl Place {
    fn new() -> Self {
        Self(tempdir().unwrap())
    }

    /// Writes a file of less than 1 MB.
    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        assert!(bytes.as_ref().len() < 1_000_000, "{name}: {} bytes", bytes.as_ref().len());
        fs::write(&path, bytes).unwrap();
        path
    }
}

const LIMIT: &str = "bytes of memory, limit is";

/// The header of an SPZ file without harmonics.
fn spz_header(version: u32, num_gaussians: u32, num_streams: u8) -> Vec<u8> {
    let numbers = [version, num_gaussians].map(u32::to_le_bytes);
    [&b"NGSP"[..], numbers.as_flattened(), &[0, 12, 0, num_streams]].concat()
}

#[test]
fn spz_files_that_unpack_to_gigabytes() {
    let place = Place::new();
    let n = 5_000_000;
    let plain = std::io::Cursor::new(spz_header(3, n, 0)).chain(std::io::repeat(0).take(20 * u64::from(n)));
    let mut packed = Vec::new();
    flate2::read::GzEncoder::new(plain, Compression::default()).read_to_end(&mut packed).unwrap();
    no_command_reads(&place.write("gzip.spz", &packed), "needs 380000000 bytes of memory, limit is");

    // A Zstandard frame of blocks that repeat one byte.
    let n = 40_000_000_u64;
    let (mut table, mut frames) = (Vec::new(), Vec::new());
    for length in [9, 1, 3, 3, 4].map(|bytes| bytes * n) {
        let mut frame = b"\x28\xB5\x2F\xFD\x00\x38".to_vec();
        let blocks = length.div_ceil(1 << 17);
        for block in 0..blocks {
            let size = (length - (block << 17)).min(1 << 17);
            let head = u64::from(block + 1 == blocks) | 1 << 1 | size << 3;
            frame.extend(&head.to_le_bytes()[..3]);
            frame.push(0);
        }
        table.extend([frame.len() as u64, length].map(u64::to_le_bytes).concat());
        frames.extend(frame);
    }
    let head = [spz_header(4, n as u32, 5), 32_u32.to_le_bytes().to_vec(), vec![0; 12]].concat();
    no_command_reads(&place.write("zstandard.spz", [head, table, frames].concat()), LIMIT);
}

/// The JSON and the buffer of a `.glb` file with a number of Gaussians.
fn gltf(num_gaussians: usize) -> (Value, Vec<u8>) {
    let mut gaussians = Gaussians::zeros(num_gaussians);
    gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
    let mut bytes = Vec::new();
    write_glb_to(&mut bytes, &gaussians).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..20 + length]).unwrap(), bytes[28 + length..].to_vec())
}

/// A `.glb` file.
fn glb(document: &Value, buffer: &[u8]) -> Vec<u8> {
    let json = document.to_string();
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, content) in [(b"JSON", json.as_bytes()), (b"BIN\0", buffer)] {
        bytes.extend((content.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(content);
    }
    bytes
}

#[test]
fn gltf_files_that_show_much_of_little() {
    let place = Place::new();
    let (document, buffer) = gltf(3000);
    let mut itself = document.clone();
    itself["buffers"] = (0..18_000).map(|_| json!({ "uri": "itself.gltf", "byteLength": 1 })).collect();
    no_command_reads(&place.write("itself.gltf", itself.to_string()), "names itself as buffer 0");

    // Every node shows the mesh.
    let mut nodes = document.clone();
    nodes["nodes"] = (0..30_000).map(|_| json!({ "mesh": 0 })).collect();
    nodes["scenes"][0]["nodes"] = (0..30_000).collect();
    no_command_reads(&place.write("nodes.glb", glb(&nodes, &buffer)), LIMIT);

    // Every node shows all primitives.
    let primitive = document["meshes"][0]["primitives"][0].clone();
    nodes["meshes"][0]["primitives"] = (0..700).map(|_| primitive.clone()).collect();
    no_command_reads(&place.write("primitives.gltf", nodes.to_string()), "primitives, expected fewer");

    // Parsed JSON takes a hundred times its length.
    let empty = "{},".repeat(300_000);
    let many = format!(r#"{{"scenes":[{{"nodes":[]}}],"nodes":[{empty}{{}}]}}"#);
    no_command_reads(&place.write("empty.gltf", many), "shows no primitive");
    let mut rows = document;
    rows["accessors"].as_array_mut().unwrap().iter_mut().for_each(|a| a["count"] = 4_000_000_000_u64.into());
    no_command_reads(&place.write("rows.glb", glb(&rows, &buffer)), LIMIT);
}

/// A `.4dgs` file of two equal Gaussians whose streams are all constants.
fn fourdgs(rate: f64) -> Vec<u8> {
    let mut gaussians = Gaussians::zeros(2);
    gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
    fourdgs_bytes([Ok::<_, String>(gaussians)], rate).unwrap().unwrap()
}

#[test]
fn dot_4dgs_files_of_many_timesteps_or_gaussians() {
    let place = Place::new();
    let long = place.write("long.4dgs", fourdgs(1.0 / 33_000.0));
    no_command_reads(&long, "needs 990000 timesteps, limit is 65536; --no-limits lifts it");

    // Counts of the chunk and of its streams.
    let mut bytes = fourdgs(30.0);
    let number = |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let mut at = 8;
    while bytes[at] != 5 {
        at += 9 + number(&bytes, at + 1);
    }
    let (content, end) = (at + 9, at + 9 + number(&bytes, at + 1));
    let mut counts = vec![content + 20];
    let mut stream = content + 44;
    while stream < end {
        counts.push(stream + 5);
        stream += 17 + number(&bytes, stream + 9);
    }
    assert_eq!((counts.len(), stream), (12, end));
    for at in counts {
        bytes[at..at + 4].copy_from_slice(&5_000_000_u32.to_le_bytes());
    }
    no_command_reads(&place.write("constants.4dgs", bytes), LIMIT);
}

/// A zip archive of one compressed array of zeros for each name and shape.
fn npz_of_zeros(arrays: &[(&str, &[usize])]) -> Vec<u8> {
    let (mut files, mut table) = (Vec::new(), Vec::new());
    for (name, shape) in arrays {
        let shape_text = shape.iter().map(|n| format!("{n}, ")).collect::<String>();
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape_text}), }}\n");
        let start = [&b"\x93NUMPY\x01\0"[..], &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
        let num_values = 4 * shape.iter().product::<usize>();
        let (mut crc, mut packed) =
            (Crc::new(), flate2::write::DeflateEncoder::new(Vec::new(), Compression::default()));
        let zeros = vec![0; 1 << 20];
        let rest = (0..num_values).step_by(1 << 20).map(|at| &zeros[..(num_values - at).min(1 << 20)]);
        for bytes in std::iter::once(&start[..]).chain(rest) {
            crc.update(bytes);
            packed.write_all(bytes).unwrap();
        }
        let (packed, file) = (packed.finish().unwrap(), format!("{name}.npy"));
        let sizes = [crc.sum(), packed.len() as u32, (start.len() + num_values) as u32].map(u32::to_le_bytes);
        // Version 2.0, no flags, deflated, no time; then the sizes, the length of the name, nothing else.
        let common = [&b"\x14\0\0\0\x08\0\0\0\0\0"[..], sizes.as_flattened(), &[file.len() as u8, 0, 0, 0]].concat();
        let at = (files.len() as u32).to_le_bytes();
        table.extend([&b"PK\x01\x02\x14\0"[..], &common[..], &[0; 10], &at, file.as_bytes()].concat());
        files.extend([&b"PK\x03\x04"[..], &common[..], file.as_bytes(), &packed].concat());
    }
    let (count, place) =
        ((arrays.len() as u16).to_le_bytes(), [table.len() as u32, files.len() as u32].map(u32::to_le_bytes));
    let end = [&b"PK\x05\x06\0\0\0\0"[..], &count[..], &count, place.as_flattened(), &[0, 0]].concat();
    [files, table, end].concat()
}

#[test]
fn archives_of_zeros() {
    let place = Place::new();
    let n = 3_000_000;
    let scene: [(&str, &[usize]); 5] = [
        ("means3D", &[1, n, 3]),
        ("rgb_colors", &[1, n, 3]),
        ("unnorm_rotations", &[1, n, 4]),
        ("logit_opacities", &[n, 1]),
        ("log_scales", &[n, 3]),
    ];
    no_command_reads(&place.write("params.npz", npz_of_zeros(&scene)), LIMIT);
    let steps: [(&str, &[usize]); 5] = [
        ("means3D", &[500_000, 1, 3]),
        ("rgb_colors", &[500_000, 1, 3]),
        ("unnorm_rotations", &[500_000, 1, 4]),
        ("logit_opacities", &[1, 1]),
        ("log_scales", &[1, 3]),
    ];
    no_command_reads(&place.write("steps.npz", npz_of_zeros(&steps)), "needs 500000 timesteps, limit is 65536");

    let points = place.write("points.npz", npz_of_zeros(&[("data", &[4_000_000, 7])]));
    let run = place.0.path().join("run");
    is_refused(&["train", text(capture()), "--out", text(&run), "--points", text(&points)], LIMIT);
    // The array alone is within the limit; the points made from it are not.
    let twice = place.write("twice.npz", npz_of_zeros(&[("data", &[2_300_000, 7])]));
    is_refused(&["train", text(capture()), "--out", text(&run), "--points", text(&twice)], LIMIT);
}

/// A `.ply` file of points with an arbitrary header.
fn ply(format: &str, header: &str, rest: &[u8]) -> Vec<u8> {
    [format!("ply\nformat {format} 1.0\n{header}end_header\n").as_bytes(), rest].concat()
}

#[test]
fn ply_files_of_counts_lists_and_comments() {
    let place = Place::new();
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let names = names.into_iter().chain(["rot_0", "rot_1", "rot_2", "rot_3"]);
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    let element = |count: u64, more: &str| format!("element vertex {count}\n{properties}{more}");
    let run = place.0.path().join("run");
    let of_points = |path: &Path, expected: &str| {
        is_refused(&["train", text(capture()), "--out", text(&run), "--points", text(path)], expected);
    };
    for format in ["ascii", "binary_little_endian"] {
        for (name, header, expected) in [
            ("count", element(4_000_000_000, ""), "ends early"),
            ("lists", element(3, "property list uint float extra\n"), "expected"),
            ("comments", format!("{}{}", "comment flood\n".repeat(60_000), element(1000, "")), "ends early"),
            ("elements", format!("{}{}", element(10, ""), "element a 1\n".repeat(60_000)), "ends early"),
        ] {
            let rest = if format == "ascii" { "0 ".repeat(14) + "4000000000 1 " } else { "\u{7f}".repeat(60) };
            let path = place.write(&format!("{name}_{format}.ply"), ply(format, &header, rest.as_bytes()));
            no_command_reads(&path, expected);
            of_points(&path, "expected");
        }
    }
    let line = place.write("line.ply", "ply\n".to_owned() + &" ".repeat(900_000));
    no_command_reads(&line, "ends early");
    of_points(&line, "ends early");
}

#[test]
fn devices_in_the_place_of_files() {
    let place = Place::new();
    for name in ["a.ply", "a.spz", "a.glb", "a.gltf", "a.4dgs", "a.npz"] {
        let path = place.0.path().join(name);
        std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
        no_command_reads(&path, "a device or a pipe");
    }
    let run = place.0.path().join("run");
    for name in ["a.ply", "a.npz"] {
        let points = place.0.path().join(name);
        // The link is resolved first, and its target has no ending.
        is_refused(&["train", text(capture()), "--out", text(&run), "--points", text(&points)], "expected points as");
    }
}

#[test]
fn files_that_broke_a_reader_before() {
    for (name, expected) in [("v4_bomb.spz", LIMIT), ("selfref.gltf", "names itself as buffer")] {
        let Some(path) = shared(&format!("hostile/{name}")) else { continue };
        let place = Place::new();
        no_command_reads(&place.write(name, fs::read(&path).unwrap()), expected);
    }
}

#[test]
fn who_knows_a_file_lifts_its_limits() {
    let place = Place::new();
    // 69,000 timesteps at thirty frames per second.
    let path = place.write("hour.4dgs", fourdgs(1.0 / 2300.0));
    let one = place.0.path().join("one.ply");
    let arguments = ["export", text(&path), "--frames", "0..1", "--to", text(&one)];
    assert!(fail(2, &arguments).ends_with("needs 69000 timesteps, limit is 65536; --no-limits lifts it"));
    succeed(&[&arguments[..], &["--no-limits"]].concat());
    assert!(one.is_file());
}

#[test]
fn texts_of_files_do_not_control_the_terminal() {
    let place = Place::new();
    let (escape, bell) = ("\u{1b}]0;title\u{7}", "\u{9b}31m");
    let is_printable = |arguments: &[&str], expected: &str| {
        let output = run(arguments);
        for printed in [&output.stdout, &output.stderr] {
            let printed = String::from_utf8_lossy(printed);
            assert!(!printed.contains(|c: char| c.is_control() && c != '\n'), "{arguments:?}: {printed:?}");
        }
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(message.contains(expected), "{arguments:?}: {message}");
    };
    let out = place.0.path().join("out");
    let export = |path: &Path| is_printable(&["export", text(path), "--to", text(&out)], "\\u{1b}]0;title\\u{7}");
    export(&place.write("a.ply", ply("ascii", &format!("element {escape}{bell} 1\nproperty float x\n"), b"0\n")));
    let (mut document, buffer) = gltf(3);
    document["extensionsRequired"] = json!([format!("{escape}{bell}")]);
    export(&place.write("a.glb", glb(&document, &buffer)));
    // A file name, in an error message and in the description of a scene.
    let named = place.write(&format!("{escape}.ply"), "ply\n");
    export(&named);
    let (document, buffer) = gltf(3);
    let named = place.write(&format!("{escape}.glb"), glb(&document, &buffer));
    let said = run(&["export", text(&named), "--to", text(&out)]);
    let said = String::from_utf8(said.stdout).unwrap();
    assert!(said.contains("\\u{1b}]0;title\\u{7}.glb (glTF files): 3 Gaussians"), "{said}");

    // A capture of Panoptic Sports.
    let folder = place.0.path().join("capture");
    fs::create_dir_all(folder.join("ims")).unwrap();
    let meta = json!({
        "w": 8, "h": 8, "cam_id": [[0]], "fn": [[format!("{escape}{bell}.jpg")]],
        "k": [[[[8, 0, 4], [0, 8, 4], [0, 0, 1]]]],
        "w2c": [[[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]]],
    });
    fs::write(folder.join("train_meta.json"), meta.to_string()).unwrap();
    fs::write(folder.join("test_meta.json"), meta.to_string()).unwrap();
    is_printable(&["train", text(&folder), "--out", text(&place.0.path().join("run"))], "\\u{1b}]0;title\\u{7}");
}

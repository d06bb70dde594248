//! PLY files: exported from a scene, and imported from other programs.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::*;
use tcgs_core::{Attribute, Gaussians};
use tcgs_interchange::{ReadSettings, TimestepFiles, read_params_npz, read_ply, write_ply_to};
use tempfile::{TempDir, tempdir};

/// A sequence of 300 Gaussians on a turning globe; every third fades, some grow.
fn globe(timestep: usize) -> Gaussians {
    let mut gaussians = Gaussians::zeros(300);
    for i in 0..300 {
        let height = (i as f32 + 0.5) / 150.0 - 1.0;
        let (sin, cos) = (2.4 * i as f32 + 0.05 * timestep as f32).sin_cos();
        let ring = (1.0 - height * height).sqrt();
        gaussians.means_mut()[i] = [40.0 * ring * cos, 40.0 * height, 40.0 * ring * sin];
        gaussians.quats_mut()[i] = [1.0, 0.3 * cos, 0.0, 0.2];
        gaussians.colors_mut()[i] = [0.5 + 0.4 * cos, 0.5 + 0.4 * height, 0.3];
        let (fades, grows) = (if i % 3 == 0 { 1.5 } else { 0.0 }, if i % 7 == 0 { 0.2 } else { 0.0 });
        gaussians.log_scales_mut()[i] = [1.6 + grows * timestep as f32, 1.3, 1.0];
        gaussians.logit_opacities_mut()[i] = 3.0 - fades * timestep as f32;
    }
    gaussians
}

fn write_globe(folder: &TempDir, num_timesteps: usize) -> PathBuf {
    let plys = folder.path().join("globe");
    fs::create_dir(&plys).unwrap();
    for timestep in 0..num_timesteps {
        let file = fs::File::create(plys.join(format!("globe_{timestep}.ply"))).unwrap();
        write_ply_to(file, &globe(timestep)).unwrap();
    }
    plys
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_run_goes_to_ply_files_and_from_there_to_a_file_that_renders() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let run = train(&folder, "run", &["--preset", "d3dgs", "--frames", "1..4"]);
    let (plys, params) = (path("plys"), path("params.npz"));
    succeed(&["export", text(&run), "--to", text(&plys), "--json", text(&path("export.json"))]);
    assert_eq!(names(&plys), ["000001.ply", "000002.ply", "000003.ply"]);
    let written: u64 = names(&plys).iter().map(|name| fs::metadata(plys.join(name)).unwrap().len()).sum();
    assert_eq!(json(&path("export.json"))["bytes"], written);

    // The same floats as in a params.npz; colours differ only by their offset.
    succeed(&["export", text(&run), "--to", text(&params)]);
    let (floats, files) =
        (read_params_npz(&params).unwrap(), TimestepFiles::open(&plys, ReadSettings::default()).unwrap());
    assert_eq!(files.first_frame(), Some(1));
    let scene = files.read(0..3).unwrap();
    for attribute in Attribute::BASE {
        assert_eq!(floats.num_samples(attribute), scene.num_samples(attribute), "{attribute:?}");
        for timestep in 0..3 {
            let pairs = floats.values(attribute, timestep).iter().zip(scene.values(attribute, timestep));
            for (a, b) in pairs {
                let same = match attribute {
                    Attribute::Color => (a.max(0.0) - b).abs() <= 3e-8 * a.abs().max(1.0),
                    _ => a.to_bits() == b.to_bits(),
                };
                assert!(same, "{attribute:?}: {a} {b}");
            }
        }
    }

    // Frames are known from the names, and from arrays that a params.npz need not have.
    let psnr = |scene: &Path| {
        let result = path("eval.json");
        succeed(&["eval", text(scene), "--capture", text(capture()), "--json", text(&result), "--force"]);
        let result = json(&result);
        assert_eq!(result["images"].as_array().unwrap().len(), 3);
        result["psnr"].as_f64().unwrap()
    };
    let of_run = psnr(&run);
    assert!((psnr(&params) - of_run).abs() < 1e-3 && (psnr(&plys) - of_run).abs() < 0.1);

    let unrefined = ["compress", text(&plys), "--capture", text(capture()), "--frame-rate", "24", "--refine", "off"];
    let said = succeed(&unrefined);
    assert!(said.contains("(PLY files): ") && said.contains("measured with 4 training cameras"), "{said}");
    let file = path("plys.tcgs");
    assert!((psnr(&file) - of_run).abs() < 0.5, "compression must not change the pictures");
    succeed(&["info", text(&file), "--json", text(&path("info.json"))]);
    let info = json(&path("info.json"));
    assert_eq!((&info["first_frame"], &info["frame_rate"]), (&1.into(), &24.0.into()));

    let one = path("one.ply");
    succeed(&["export", text(&file), "--frames", "2..3", "--to", text(&one)]);
    assert_eq!(read_ply(&one, ReadSettings::default()).unwrap().num_gaussians(), floats.num_gaussians());
    succeed(&["render", text(&one), "--out", text(&path("frames")), "--size", "40x20"]);
    succeed(&["export", text(&file), "--frames", "2..4", "--to", text(&plys), "--force"]);
    assert_eq!(names(&plys), ["000002.ply", "000003.ply"]);
}

#[test]
fn opacities_and_scales_that_vary_survive() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let plys = write_globe(&folder, 12);
    let said = succeed(&["compress", text(&plys), "--json", text(&path("compress.json"))]);
    assert!(said.contains("16 cameras around the scene"), "{said}");
    assert_eq!(json(&path("compress.json"))["stages"][0]["bytes"], 300 * 12 * 56);

    let (file, back) = (path("globe.tcgs"), path("back"));
    succeed(&["export", text(&file), "--to", text(&back)]);
    assert_eq!(names(&back).len(), 12);
    let last = read_ply(&back.join("000011.ply"), ReadSettings::default()).unwrap();
    let sorted = |values: &[f32]| {
        let mut values = values.to_vec();
        values.sort_by(f32::total_cmp);
        values
    };
    let expected = globe(11);
    for (attribute, tolerance) in [(Attribute::LogitOpacity, 0.5), (Attribute::LogScale, 0.2), (Attribute::Mean, 0.4)] {
        let (a, b) = (sorted(expected.values(attribute)), sorted(last.values(attribute)));
        let far = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0_f32, f32::max);
        assert!(far < tolerance, "{attribute:?}: {far}");
    }

    let params = path("params.npz");
    for scene in [&plys, &file] {
        let message = fail(2, &["export", text(scene), "--to", text(&params)]);
        let expected = "log_scales vary with time, which a params.npz cannot hold, expected a folder";
        assert!(message.contains(expected), "{message}");
        assert!(!params.exists());
    }
    // A single timestep does not vary.
    succeed(&["export", text(&file), "--frames", "5..6", "--to", text(&params)]);
    succeed(&["info", text(&file), "--json", text(&path("info.json"))]);
    assert!(json(&path("info.json"))["keypoints_mean"]["logit_opacities"].as_f64().unwrap() > 1.2);
}

#[test]
fn what_does_not_fit_is_one_line() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let refuse = |arguments: &[&str], expected: &[&str]| {
        let message = fail(2, arguments);
        for part in expected {
            assert!(message.contains(part), "{arguments:?}: {message}\nexpected: {part}");
        }
    };
    let plys = write_globe(&folder, 4);
    let out = text(&plys).to_owned() + ".tcgs";

    let whole = fs::read(plys.join("globe_2.ply")).unwrap();
    fs::write(plys.join("globe_2.ply"), &whole[..whole.len() - 1]).unwrap();
    refuse(&["compress", text(&plys)], &["globe_2.ply: ends early"]);
    let shuffled: Vec<usize> = (0..300).map(|i| 7 * i % 300).collect();
    let write = |gaussians: &Gaussians| {
        write_ply_to(fs::File::create(plys.join("globe_2.ply")).unwrap(), gaussians).unwrap();
    };
    // A different order or number of Gaussians is not refused: matching Gaussians are followed.
    for (name, rows) in [("shuffled.tcgs", &shuffled[..]), ("fewer.tcgs", &shuffled[..299])] {
        write(&globe(2).select(rows));
        succeed(&["compress", text(&plys), "--bits", "6,6", "--out", text(&path(name))]);
        let mut file = tcgs_codec::SceneFile::open(
            fs::File::open(path(name)).unwrap(),
            &tcgs_codec::DecodeLimits::default(),
            tcgs_codec::SegmentCache::DEFAULT_BYTES,
        )
        .unwrap();
        assert_eq!(file.archive().version(), 2, "{name}");
        assert_eq!(file.at(2).unwrap().num_gaussians(), rows.len(), "{name}");
    }
    write(&globe(2));
    refuse(&["compress", text(&plys), "--prune", "0.1"], &["globe", "no masks"]);
    refuse(&["compress", text(&plys), "--frame-rate", "-1"], &["'-1'", "0 or more"]);
    refuse(&["export", text(&plys), "--to", text(&path("a.ply"))], &["a.ply", "4 timesteps", "--frames 0..1"]);
    let precious = path("precious");
    fs::create_dir(&precious).unwrap();
    fs::write(precious.join("diary.txt"), "x").unwrap();
    let export = ["export", text(&plys), "--to", text(&precious)];
    refuse(&export, &["precious", "exists already"]);
    refuse(&[&export[..], &["--force"]].concat(), &["diary.txt", "not written by this command"]);
    assert!(!Path::new(&out).exists() && !path("back").exists() && !path("a.ply").exists());
}

/// Attached data are returned byte for byte; data that do not match their declared kind are refused.
#[test]
fn data_of_applications_go_in_and_come_out() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let plys = write_globe(&folder, 2);
    let file = path("scene.tcgs");
    let (credits, notes) = (br#"{ "licence": "CC-BY-4.0" }"#, b"any\0bytes");
    fs::write(path("credits.json"), credits).unwrap();
    fs::write(path("notes.bin"), notes).unwrap();
    let attach = |name: &str, of: &str| format!("{name}={}", text(&path(of)));
    let compress = ["compress", text(&plys), "--bits", "6,6", "--out", text(&file), "--force"];
    for version in ["1", "2"] {
        let words = ["--attach", &attach("credits", "credits.json"), "--attach", &attach("myapp.notes", "notes.bin")];
        succeed(&[&compress[..], &words, &["--format", version]].concat());
        for (name, expected) in [("tcgs.credits", &credits[..]), ("myapp.notes", notes)] {
            let output = run(&["info", text(&file), "--data", name]);
            assert!(output.status.success());
            assert_eq!(output.stdout, expected, "{name}");
        }
    }
    let message = fail(2, &["info", text(&file), "--data", "tcgs.sound"]);
    assert!(message.contains("has tcgs.credits, myapp.notes, expected tcgs.sound"), "{message}");
    fs::remove_file(&file).unwrap();
    for (name, of, expected) in [
        ("credits", "notes.bin", "notes.bin: "),
        ("sound", "credits.json", "credits.json: no Ogg stream, expected Opus in Ogg"),
        ("credits", "absent.json", "absent.json: "),
        ("tcgs.views", "credits.json", "names that begin with tcgs."),
        ("creditz", "credits.json", "expected credits, units, light, paths"),
    ] {
        let message = fail(2, &[&compress[..], &["--attach", &attach(name, of)]].concat());
        assert!(message.contains(expected), "{name}: {message}");
        assert!(!file.exists());
    }
}

/// Plain floats equal the decoder's bit for bit, including infinite ones and empty scenes.
#[test]
fn plain_floats_are_those_of_the_file() {
    let folder = tempdir().unwrap();
    for name in ["layers_and_segments", "beyond_floats", "empty"] {
        let vectors = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v1");
        let (file, out) = (vectors.join(format!("{name}.tcgs")), folder.path().join(format!("{name}.f32")));
        succeed(&["export", text(&file), "--to", text(&out)]);
        let scene = tcgs_codec::decode(&fs::read(&file).unwrap(), &tcgs_codec::DecodeLimits::default()).unwrap();
        let of_timestep = |t: usize| Attribute::BASE.map(|a| scene.at(t).values(a).to_vec()).concat();
        let expected: Vec<u8> = (0..scene.num_timesteps()).flat_map(of_timestep).flat_map(f32::to_le_bytes).collect();
        assert_eq!(fs::read(&out).unwrap(), expected, "{name}");
        let first = scene.info.first_frame;
        let one = format!("{first}..{}", first as u64 + 1);
        succeed(&["export", text(&file), "--to", text(&out), "--frames", &one, "--force"]);
        assert_eq!(fs::read(&out).unwrap(), expected[..expected.len() / scene.num_timesteps()], "{name}");
    }
    let empty = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v1/empty.tcgs");
    let message = fail(2, &["export", text(&empty), "--to", text(&folder.path().join("plys"))]);
    assert!(message.ends_with("has no Gaussians, expected at least one"), "{message}");
    assert!(!folder.path().join("plys").exists());
}

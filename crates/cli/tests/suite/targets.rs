//! Files of a requested size or quality, and optional data in them.

use std::fs;

use crate::support::*;
use serde_json::Value;
use tempfile::tempdir;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}, expected a number"))
}

/// The smallest length that a command names when it is asked for 300 bytes.
fn least_bytes(message: &str) -> u64 {
    assert!(message.contains("--target-bytes 300: the smallest file is"), "{message}");
    message.split_whitespace().find_map(|word| word.parse().ok().filter(|&n| n > 300)).unwrap()
}

#[test]
fn a_target_is_kept_and_its_setting_gives_the_same_file() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let capture = text(capture());
    let run = train(&folder, "run", &[]);
    let (file, result) = (path("a.tcgs"), path("a.json"));
    let compress = |more: &[&str]| {
        let given = ["compress", text(&run), "--out", text(&file), "--json", text(&result), "--force"];
        let said = succeed(&[&given[..], more].concat());
        (said, json(&result), fs::metadata(&file).unwrap().len())
    };
    let (_, plain, default) = compress(&["--refine", "off"]);
    assert!(plain.get("target").is_none());

    // Between the smallest possible file and that of the default quality.
    let least =
        least_bytes(&fail(2, &["compress", text(&run), "--out", text(&file), "--force", "--target-bytes", "300"]));
    let wanted = (least + default) / 2;
    let (said, found, bytes) = compress(&["--target-bytes", &wanted.to_string(), "--capture", capture]);
    assert!(bytes <= wanted && bytes as f64 > 0.97 * wanted as f64, "{bytes} of {wanted}: {said}");
    let target = &found["target"];
    assert_eq!((&target["target_bytes"], &target["bytes"]), (&wanted.into(), &bytes.into()));
    assert_eq!((&target["measured_against"], &target["images"]), (&"capture".into(), &4.into()));
    assert!(said.contains(&format!("against 4 images of {capture}, 4 frames")), "{said}");
    let steps = target["steps"].as_array().unwrap();
    assert!(steps.len() >= 2 && said.lines().filter(|line| line.contains("kB") && line.contains("  -")).count() > 0);
    // The reported PSNR equals that of eval.
    let measured = path("eval.json");
    succeed(&["eval", text(&file), "--capture", capture, "--json", text(&measured)]);
    assert!((number(&json(&measured)["psnr"]) - number(&target["psnr"])).abs() < 1e-6);
    // The reported quality alone gives the same bytes.
    let before = fs::read(&file).unwrap();
    compress(&["--quality", &target["quality"].to_string(), "--capture", capture, "--refine", "off"]);
    assert!(fs::read(&file).unwrap() == before, "other bytes for quality {}", target["quality"]);

    let (said, coarse, small) = compress(&["--target-psnr", "24"]);
    assert_eq!(coarse["target"]["measured_against"], "source");
    assert!(said.contains("renders of"), "{said}");
    assert!(number(&coarse["target"]["psnr"]) >= 24.0);
    let (_, fine, large) = compress(&["--target-psnr", "31", "--frames", "1..3"]);
    assert!(number(&fine["target"]["psnr"]) >= 31.0 && large > small, "{small} and {large}");
}

#[test]
fn tuning_saves_bytes_at_the_same_psnr() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &[]);
    let (file, result) = (folder.path().join("a.tcgs"), folder.path().join("a.json"));
    let given = ["compress", text(&run), "--out", text(&file), "--json", text(&result), "--force"];
    succeed(&[&given[..], &["--refine", "off"]].concat());
    let plain = fs::metadata(&file).unwrap().len();
    let tune = |more: &[&str]| {
        let said = succeed(&[&given[..], &["--tune"], more].concat());
        let tuning = json(&result)["tuning"].clone();
        assert_eq!(tuning["bytes"], fs::metadata(&file).unwrap().len());
        (said, tuning)
    };
    let (said, tuning) = tune(&["--capture", text(capture())]);
    assert_eq!(tuning["bytes_before"], plain);
    assert!(number(&tuning["psnr"]) >= number(&tuning["psnr_before"]), "{said}");
    assert!(number(&tuning["bytes"]) < 0.99 * number(&tuning["bytes_before"]), "{said}");
    assert!(said.contains("tolerance of positions ") && said.contains("\ntuned: "), "{said}");
    assert!(tuning["steps"].as_array().unwrap().iter().any(|step| !step["saved"].is_null()), "{said}");
    // Measured on the training cameras, like eval.
    let measured = folder.path().join("eval.json");
    succeed(&["eval", text(&file), "--capture", text(capture()), "--cameras", "train", "--json", text(&measured)]);
    assert!((number(&json(&measured)["psnr"]) - number(&tuning["psnr"])).abs() < 1e-6);

    // Tuning keeps a target, measured against renders of the source if there is no capture.
    let (said, tuning) = tune(&["--target-psnr", "30", "--frames", "1..2"]);
    assert!(number(&tuning["psnr"]) >= 30.0 && tuning["target_psnr"] == 30.0, "{said}");
    assert!(tuning["measured_against"] == "source" && said.contains(" renders of "), "{said}");
    for (more, message) in [
        (&["--bits", "4,8"][..], "cannot be used with"),
        (&["--max-error", "mean=0.1"], "cannot be used with"),
        (&["--preset", "paper"], "expected --preset default with"),
    ] {
        assert!(fail(2, &[&given[..], &["--tune"], more].concat()).contains(message), "{more:?}");
    }
}

#[test]
fn what_is_out_of_reach_leaves_nothing() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &[]);
    let out = folder.path().join("a.tcgs");
    let compress = |more: &[&str]| fail(2, &[&["compress", text(&run), "--out", text(&out)], more].concat());
    let message = compress(&["--target-bytes", "300"]);
    let least = least_bytes(&message);
    let message = compress(&["--target-psnr", "99", "--capture", text(capture())]);
    assert!(message.contains("--target-psnr 99: the best against 4 images of"), "{message}");
    assert!(!out.exists() && fs::read_dir(folder.path()).unwrap().count() == 1);
    // The named length can be reached.
    succeed(&["compress", text(&run), "--out", text(&out), "--target-bytes", &least.to_string()]);
    assert!(fs::metadata(&out).unwrap().len() <= least);
}

#[test]
fn a_file_says_which_way_is_up_where_cameras_stood_and_what_they_saw() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &[]);
    let out = folder.path().join("a.tcgs");
    let data = |more: &[&str]| {
        // Refining would add application data: the light over time.
        succeed(&[&["compress", text(&run), "--out", text(&out), "--force", "--refine", "off"], more].concat());
        let bytes = fs::read(&out).unwrap();
        let data = tcgs_codec::application_data(&bytes, &tcgs_codec::DecodeLimits::default()).unwrap();
        data.iter()
            .map(|(name, data)| (name.clone(), serde_json::from_slice::<Value>(data).unwrap()))
            .collect::<Vec<_>>()
    };
    let found = data(&["--up", "z", "--views", "3"]);
    let said = succeed(&["info", text(&out)]);
    assert!(said.contains("\nup            z\n") && said.contains("application data: tcgs.views, "), "{said}");
    let [(name, views), (name_of_trust, trust)] = &found[..] else { panic!("{found:?}") };
    let views = views["views"].as_array().unwrap();
    assert_eq!((&name[..], views.len(), &name_of_trust[..]), ("tcgs.views", 3, "tcgs.trust"));
    assert!(said.contains("\ntrust: pictures from "), "{said}");
    assert_keys(trust, &["center", "distances", "between", "directions"]);
    let capture = tcgs_capture::Capture::open(capture()).unwrap();
    let cameras = capture.cameras(tcgs_capture::Split::Train, 0, 1).unwrap();
    // Every training camera is trusted, also those that are no view.
    let trust = tcgs_codec::read_trust(&[(name_of_trust.clone(), trust.to_string().into_bytes())]).unwrap();
    assert_eq!(trust.directions().len(), cameras.len());
    assert!(cameras.iter().all(|(_, camera)| trust.doubt(camera.center()) == 0.0));
    // A player starts with the first camera; the others follow in the capture's order.
    let place =
        |view: &Value| cameras.iter().position(|(id, _)| view["name"].as_str() == Some(&id.to_string())).unwrap();
    let places: Vec<usize> = views.iter().map(place).collect();
    assert!(places.is_sorted_by_key(|&i| (i != places[0], i)), "{places:?}");
    for i in [0, 1, 3] {
        let (id, camera) = &cameras[i];
        let view = &views[places.iter().position(|&place| place == i).unwrap()];
        assert_keys(view, &["name", "width", "height", "focal", "principal", "position", "rotation"]);
        assert_eq!((&view["name"], &view["width"]), (&id.to_string().into(), &48.into()));
        let numbers = |field: &str| view[field].as_array().unwrap().iter().map(number).collect::<Vec<f64>>();
        let (position, rotation) = (numbers("position"), numbers("rotation"));
        assert!(position.iter().zip(camera.center()).all(|(a, b)| (a - b).abs() < 1e-4), "{view}");
        let matrix = tcgs_core::rotmat_from_quat([rotation[0], rotation[1], rotation[2], rotation[3]]);
        let forward = [0, 1, 2].map(|axis| matrix[axis][2]);
        assert!(tcgs_core::dot(forward, camera.forward()) > 1.0 - 1e-6, "{view}");
    }
    assert_eq!(data(&["--views", "0"]), []);
    let said = succeed(&["info", text(&out)]);
    assert!(said.contains("\nup            -y\n"), "found by the cameras: {said}");
}

#[test]
fn refining_comes_closer_to_the_images_and_repeats() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let run = train(&folder, "run", &[]);
    let compress = |name: &str, more: &[&str]| {
        let (file, result) = (path(&format!("{name}.tcgs")), path(&format!("{name}.json")));
        let given = ["compress", text(&run), "--out", text(&file), "--json", text(&result)];
        let said = succeed(&[&given[..], more].concat());
        (said, json(&result), file)
    };
    let psnr = |file: &std::path::Path| {
        let measured = path("eval.json");
        let given = [
            "eval",
            text(file),
            "--capture",
            text(capture()),
            "--cameras",
            "train",
            "--json",
            text(&measured),
            "--force",
        ];
        succeed(&given);
        number(&json(&measured)["psnr"])
    };
    let (said, result, plain) = compress("plain", &["--refine", "off"]);
    assert!(!said.contains("refined") && result.get("refined").is_none(), "{said}");
    // Refines by default, in proportion to the training: 30 iterations of the first timestep, and 2/15 of 10 of each of
    // four.
    let (said, result, usual) = compress("usual", &["--backend", "cpu"]);
    assert_eq!(result["refined"]["iterations"], 30 + 6, "{said}");
    assert!(psnr(&usual) > psnr(&plain), "{} from {}", psnr(&usual), psnr(&plain));
    let (said, result, refined) = compress("refined", &["--refine", "480", "--backend", "cpu"]);
    assert!(said.contains("refined in 480 iterations, which --refine 480 repeats"), "{said}");
    assert_eq!(result["refined"]["iterations"], 480);
    assert!(number(&result["refined"]["loss_after"]) < number(&result["refined"]["loss_before"]));
    assert!(psnr(&refined) > psnr(&plain) + 0.5, "{} from {}", psnr(&refined), psnr(&plain));
    // Declared errors are those against the floats, from which refinement moves away.
    let report = path("verify.json");
    succeed(&["verify", text(&refined), text(&run), "--json", text(&report)]);

    let (_, result, timed) = compress("timed", &["--refine", "1s", "--backend", "cpu"]);
    let iterations = result["refined"]["iterations"].to_string();
    let (_, _, again) = compress("again", &["--refine", &iterations, "--backend", "cpu"]);
    assert!(fs::read(timed).unwrap() == fs::read(again).unwrap(), "other bytes in {iterations} iterations");

    // A refined file still keeps a target.
    let most = fs::metadata(&refined).unwrap().len() * 19 / 20;
    let (said, result, small) =
        compress("small", &["--refine", "100", "--target-bytes", &most.to_string(), "--backend", "cpu"]);
    let bytes = fs::metadata(&small).unwrap().len();
    assert!(bytes <= most && bytes as f64 > 0.8 * most as f64, "{bytes} of {most}: {said}");
    assert_eq!((&result["refined"]["iterations"], &result["target"]["target_bytes"]), (&100.into(), &most.into()));

    let of_capture = ["--capture", text(capture()), "--cameras", "train", "--refine", "240", "--backend", "cpu"];
    // The search for the target precedes refinement.
    let wanted = psnr(&plain) - 0.3;
    let target = format!("{wanted:.3}");
    let (said, result, small) = compress("as-good", &[&of_capture[..], &["--target-psnr", &target]].concat());
    let (before, after) = (number(&result["target"]["psnr"]), number(&result["refined"]["psnr"]));
    assert!((psnr(&small) - after).abs() < 1e-3 && after >= wanted - 1e-3 && after > before, "{said}");
    assert!(fs::metadata(&small).unwrap().len() < fs::metadata(&plain).unwrap().len(), "{said}");
    let message = fail(2, &[&["compress", text(&run), "--target-psnr", "90"], &of_capture[..]].concat());
    assert!(message.contains("--target-psnr 90: the best against"), "{message}");

    // A tuned file is refined.
    let out = path("tuned.tcgs");
    let found = path("tuned.json");
    let tuned = ["compress", text(&run), "--tune", "--out", text(&out), "--json", text(&found)];
    succeed(&[&tuned[..], &of_capture].concat());
    let result = json(&found);
    assert!(number(&result["tuning"]["bytes"]) < number(&result["tuning"]["bytes_before"]), "{result}");
    assert!(psnr(&out) > number(&result["tuning"]["psnr"]) + 0.2, "{result}");

    let message = fail(2, &["compress", text(&run), "--refine", "5x"]);
    assert!(message.contains("expected off, a time, such as 90s, 5m or 1h, or a number of iterations"), "{message}");
    let params = path("params.npz");
    succeed(&["export", text(&plain), "--to", text(&params)]);
    let message = fail(2, &["compress", text(&params), "--refine", "5"]);
    assert!(message.contains("params.npz: has no capture of its own, expected --capture with"), "{message}");
}

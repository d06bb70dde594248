//! The server of the player, from the view of a program and of a browser.

use std::fs;
use std::io::{self, Read};
use std::path::Path;

use crate::support::server::*;
use crate::support::*;
use serde_json::Value;
use tcgs_capture::{Capture, Split, write_synthetic};
use tempfile::tempdir;

#[test]
fn what_is_no_tcgs_file_is_refused_by_name() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &["--frames", "0..1"]);
    let params = folder.path().join("params.npz");
    succeed(&["export", text(&run), "--to", text(&params)]);
    let cut = folder.path().join("cut.tcgs");
    fs::write(&cut, b"TCGS").unwrap();
    // In the operating system's words.
    let absent = format!("nowhere.tcgs: {}", io::Error::from_raw_os_error(2));
    let cases = [
        (text(&run), "run: is a folder of no capture"),
        (text(&params), "params.npz: a file of another kind"),
        ("nowhere.tcgs", &absent),
        (text(&cut), "cut.tcgs: ends after 4 bytes"),
    ];
    for (scene, problem) in cases {
        let message = fail(2, &["view", scene, "--no-open"]);
        assert!(
            message.contains(problem) && message.contains("expected a .tcgs file, which `tcgs compress`"),
            "{message}"
        );
    }
    succeed(&["compress", text(&run)]);
    let newer = run.join("scene.tcgs");
    let mut bytes = fs::read(&newer).unwrap();
    bytes[4] = 99;
    fs::write(&newer, bytes).unwrap();
    let message = fail(2, &["view", text(&newer), "--no-open"]);
    assert!(message.contains("scene.tcgs: ") && message.contains("version"), "{message}");
}

#[test]
fn a_scene_becomes_one_page() {
    let folder = tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v1/room_default.tcgs");
    let page = folder.path().join("page.html");
    let message = fail(2, &["export", text(&scene), "--frames", "0..1", "--to", text(&page)]);
    assert!(message.contains("--frames 0..1 of a page, expected none"), "{message}");
    let message = fail(2, &["export", text(&folder.path().join("no.tcgs")), "--to", text(&page)]);
    assert!(message.contains("no.tcgs"), "{message}");
    assert!(!page.exists());
    if !has_page() {
        return;
    }
    let said = succeed(&["export", text(&scene), "--to", text(&page)]);
    let html = fs::read_to_string(&page).unwrap();
    assert!(said.contains("page.html"), "{said}");
    assert!(html.contains("data-scene=\"room_default.tcgs\"") && !html.contains(" src=\""));
    let message = fail(2, &["export", text(&scene), "--to", text(&page)]);
    assert!(message.contains("--force"), "{message}");
}

#[test]
fn what_is_no_capture_is_refused_by_name() {
    let folder = tempdir().unwrap();
    let (videos, capture) = (folder.path().join("videos"), capture());
    fs::create_dir(&videos).unwrap();
    fs::write(videos.join("a.mp4"), "x").unwrap();
    let message = fail(2, &["view", text(&videos), "--no-open"]);
    assert!(message.contains("videos: is a folder of videos, expected a capture, which `tcgs prepare`"), "{message}");
    let message = fail(2, &["view", text(capture), "--no-open", "--capture", text(capture)]);
    assert!(message.contains("is a capture, expected a scene beside --capture"), "{message}");
}

#[test]
fn a_capture_is_served_as_points_and_cameras() {
    if !has_page() {
        return;
    }
    let folder = tempdir().unwrap();
    let capture = folder.path().join("capture");
    write_synthetic(&capture, &SETTINGS).unwrap();
    for has_points in [true, false] {
        if !has_points {
            fs::remove_file(capture.join("init_pt_cld.npz")).unwrap();
        }
        let (running, port) = start(&["view", text(&capture), "--no-open"]);
        let (head, scene) = ask(port, "/scene.tcgs", "");
        assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
        let scene = tcgs_codec::decode(&scene, &tcgs_codec::DecodeLimits::default()).unwrap().reconstruct();
        let opened = Capture::open(&capture).unwrap();
        let cameras = opened.cameras(Split::All, 0, 1).unwrap();
        let expected = if has_points { opened.point_cloud().unwrap().points.len() } else { cameras.len() };
        assert_eq!(scene.num_gaussians(), expected);

        let file: Value = serde_json::from_slice(&ask(port, "/cameras.json", "").1).unwrap();
        let entries = file["cameras"].as_array().unwrap();
        assert_eq!(entries.len(), cameras.len());
        assert!(file["depth"].as_f64().unwrap() > 0.0 && file["start"]["fx"].as_f64().unwrap() > 0.0, "{file}");
        for (entry, (id, camera)) in entries.iter().zip(&cameras) {
            assert_eq!(entry["name"], id.to_string());
            let pose = entry["cameraFromWorld"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap());
            let expected = camera.camera_from_world.as_flattened();
            assert!(pose.len() == 16 && pose.zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{entry}");
            assert!(entry["image"].as_str().unwrap().starts_with("data:image/jpeg;base64,"));
        }
        let page = String::from_utf8(ask(port, "/", "").1).unwrap();
        assert!(page.contains(r#"<meta name="tcgs-cameras" content="/cameras.json">"#), "{page}");
        drop(running);
    }
}

#[test]
fn one_line_names_the_address_and_the_scene_lies_there() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &["--frames", "0..1"]);
    succeed(&["compress", text(&run)]);
    let scene = run.join("scene.tcgs");
    let arguments = ["view", text(&scene), "--no-open", "--port", "0"];
    if !has_page() {
        let message = fail(1, &arguments);
        assert!(message.contains("without the player") && message.contains("web/build.sh"), "{message}");
        return;
    }
    let (mut running, port) = start(&arguments);
    let file = fs::read(&scene).unwrap();
    let (head, body) = ask(port, "/scene.tcgs", "");
    assert!(head.starts_with("HTTP/1.1 200 ") && body == file, "{head}");
    let (head, body) = ask(port, "/scene.tcgs", "Range: bytes=4-9\r\n");
    assert!(head.starts_with("HTTP/1.1 206 ") && body == file[4..10], "{head}");
    let (head, body) = ask(port, "/", "");
    let page = String::from_utf8(body).unwrap();
    assert!(head.contains("text/html") && page.contains(r#"<meta name="tcgs-src" content="/scene.tcgs">"#), "{page}");
    // Every file that the page names is served.
    for part in page.split(['"', '\'']).filter(|part| part.ends_with(".js") || part.ends_with(".css")) {
        let (head, _) = ask(port, &format!("/{}", part.trim_start_matches("./")), "");
        assert!(head.starts_with("HTTP/1.1 200 "), "{part}: {head}");
    }
    let mut more = String::new();
    running.0.kill().unwrap();
    running.1.read_to_string(&mut more).unwrap();
    drop(running);
    assert_eq!(more, "", "exactly one line");

    let taken = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let message = fail(1, &["view", text(&scene), "--no-open", "--port", &port]);
    assert!(message.contains(&format!("serving at port {port} of 127.0.0.1")), "{message}");
}

//! A training with `--view`, from the view of a program and of a browser.

use std::fs;
use std::io::Read;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use crate::support::server::*;
use crate::support::*;
use serde_json::Value;
use tcgs_codec::{DecodeLimits, SceneFile};
use tempfile::tempdir;

/// Long enough to be watched, with all parts of the training: masks, quantisation, the gate and births.
const LONG: [&str; 6] = ["--preset", "fast", "--iterations", "1500,400", "--backend", "cpu"];

/// Number of Gaussians and timesteps of a file.
fn size(file: &[u8]) -> [usize; 2] {
    let scene = SceneFile::open(std::io::Cursor::new(file.to_vec()), &DecodeLimits::default(), usize::MAX).unwrap();
    let info = scene.info();
    [info.num_gaussians as usize, info.num_timesteps as usize]
}

fn state(port: u16) -> Option<Value> {
    let (head, body) = ask(port, "/train.json", "");
    head.starts_with("HTTP/1.1 200 ").then(|| serde_json::from_slice(&body).unwrap())
}

#[test]
fn a_training_is_watched_and_its_bits_stay_the_same() {
    if !has_page() {
        return;
    }
    let folder = tempdir().unwrap();
    let (alone, watched) = (folder.path().join("alone"), folder.path().join("watched"));
    let arguments = |run| [&["train", text(capture()), "--out", run][..], &LONG].concat();
    succeed(&arguments(text(&alone)));

    let result = folder.path().join("result.json");
    let (mut running, port) = start(&[&arguments(text(&watched))[..], &["--view", "--json", text(&result)]].concat());
    let page = String::from_utf8(ask(port, "/", "").1).unwrap();
    assert!(page.contains(r#"<meta name="tcgs-train" content="/train.json">"#), "{page}");
    let begun = Instant::now();
    let (mut files, mut most_loss, mut most_psnr, mut tag) = (Vec::new(), 0, 0, String::new());
    let last = loop {
        assert!(begun.elapsed() < Duration::from_secs(120), "the training goes on");
        thread::sleep(Duration::from_millis(100));
        let Some(state) = state(port) else { continue };
        if state["has_ended"] == true {
            break state;
        }
        let (head, body) = ask(port, "/running.tcgs", &format!("If-None-Match: \"{tag}\"\r\n"));
        if head.starts_with("HTTP/1.1 200 ") {
            tag = head.lines().find_map(|line| line.strip_prefix("ETag: ")).unwrap().trim_matches('"').into();
            files.push((tag.clone(), size(&body)));
        } else {
            assert!(head.starts_with("HTTP/1.1 204 "), "{head}");
        }
        let points = |key: &str| state["running"][key].as_array().map_or(0, Vec::len);
        (most_loss, most_psnr) = (most_loss.max(points("loss")), most_psnr.max(points("psnr")));
        let (head, body) = ask(port, "/finished.tcgs", "");
        if head.starts_with("HTTP/1.1 200 ") {
            // The state is read after the file was requested, so it may include timesteps trained in between, even the
            // last.
            let Some(state) = self::state(port) else { continue };
            let (in_file, told) = (size(&body)[1], state["timesteps"]["psnr"].as_array().unwrap().len());
            assert!((1..=told).contains(&in_file), "{in_file} of {told} finished timesteps");
        }
    };
    assert!(files.iter().all(|(_, [n, t])| *n > 100 && *t == 1), "{files:?}");
    let mut tags: Vec<&String> = files.iter().map(|(tag, _)| tag).collect();
    tags.dedup();
    assert!(!files.is_empty() && tags.len() == files.len(), "each is another: {files:?}");
    assert!(most_loss > 50 && most_psnr > 0, "{most_loss} points of loss, {most_psnr} of PSNR");

    // After the training the server shows the whole run until no page asks, or until Ctrl-C.
    let whole = ask(port, "/finished.tcgs", "").1;
    assert_eq!(size(&whole)[1], 4);
    let psnr: Vec<f64> = serde_json::from_value(last["timesteps"]["psnr"].clone()).unwrap();
    let told: Vec<f64> =
        json(&result)["timesteps"].as_array().unwrap().iter().map(|t| t["psnr"].as_f64().unwrap()).collect();
    assert_eq!(psnr, told);
    if cfg!(unix) {
        let pid = running.0.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        assert!(running.0.wait().unwrap().success());
        let mut said = String::new();
        running.1.read_to_string(&mut said).unwrap();
        assert!(!said.contains("http://"), "the address is told once: {said}");
    }

    assert_eq!(checkpoints(&watched), checkpoints(&alone));
    let config = |run: &std::path::Path| fs::read_to_string(run.join("config.toml")).unwrap();
    assert_eq!(config(&watched), config(&alone));
    succeed(&["compress", text(&alone), "--refine", "off"]);
    assert!(whole == fs::read(alone.join("scene.tcgs")).unwrap(), "the whole run is what compress makes of it");
}

#[test]
fn nobody_who_looks_is_no_reason_to_stay() {
    if !has_page() {
        return;
    }
    let folder = tempdir().unwrap();
    let run = folder.path().join("run");
    let said = succeed(&["train", text(capture()), "--out", text(&run), "--iterations", "30,10", "--view=127.0.0.1:0"]);
    assert!(said.starts_with("watch at http://127.0.0.1:"), "{said}");
}

#[test]
fn other_machines_and_ports_that_are_taken_are_refused() {
    let folder = tempdir().unwrap();
    let run = folder.path().join("run");
    let arguments = ["train", text(capture()), "--out", text(&run)];
    for address in ["0.0.0.0:8000", "192.168.0.1:80", "example.org"] {
        let message = fail(2, &[&arguments[..], &[&format!("--view={address}")]].concat());
        assert!(message.contains(address) && message.contains("this machine alone"), "{message}");
    }
    if !has_page() {
        let message = fail(1, &[&arguments[..], &["--view"]].concat());
        assert!(message.contains("without the player") && message.contains("web/build.sh"), "{message}");
        return;
    }
    let taken = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = taken.local_addr().unwrap().port();
    let message = fail(1, &[&arguments[..], &[&format!("--view={port}")]].concat());
    assert!(message.contains(&format!("serving at port {port} of 127.0.0.1")), "{message}");
    assert!(!run.exists(), "nothing was begun");
}

//! The server of the player, as a program and a browser see it.

#![allow(clippy::unwrap_used)] // what helps a test may unwrap as a test may

mod support;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

use support::*;
use tempfile::tempdir;

/// Whether this program was built with the page.
fn has_page() -> bool {
    let built = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../web/dist/index.html").is_file();
    assert!(built || std::env::var_os("REQUIRE_PLAYER").is_none(), "REQUIRE_PLAYER is set, and web/dist is not built");
    built
}

/// Ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn what_is_no_tcgs_file_is_refused_by_name() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &["--frames", "0..1"]);
    let params = folder.path().join("params.npz");
    succeed(&["export", text(&run), "--to", text(&params)]);
    let cut = folder.path().join("cut.tcgs");
    fs::write(&cut, b"TCGS").unwrap();
    let cases = [
        (text(&run), "run: is a folder"),
        (text(&params), "params.npz: a file of another kind"),
        ("nowhere.tcgs", "nowhere.tcgs: No such file"),
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
    let mut child = tcgs().args(arguments).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap());
    let running = Running(child);
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    let port = line.strip_prefix("http://127.0.0.1:").and_then(|rest| rest.strip_suffix("/\n"));
    let port: u16 = port.unwrap_or_else(|| panic!("{line}")).parse().unwrap();

    let ask = |path: &str, range: &str| {
        let mut connection = TcpStream::connect(("127.0.0.1", port)).unwrap();
        write!(connection, "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n{range}\r\n")
            .unwrap();
        let mut answer = Vec::new();
        connection.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap();
        (String::from_utf8(answer[..end].to_vec()).unwrap(), answer[end + 4..].to_vec())
    };
    let file = fs::read(&scene).unwrap();
    let (head, body) = ask("/scene.tcgs", "");
    assert!(head.starts_with("HTTP/1.1 200 ") && body == file, "{head}");
    let (head, body) = ask("/scene.tcgs", "Range: bytes=4-9\r\n");
    assert!(head.starts_with("HTTP/1.1 206 ") && body == file[4..10], "{head}");
    let (head, body) = ask("/", "");
    let page = String::from_utf8(body).unwrap();
    assert!(head.contains("text/html") && page.contains(r#"<meta name="tcgs-src" content="/scene.tcgs">"#), "{page}");
    // Whatever the page names lies beside it.
    for part in page.split(['"', '\'']).filter(|part| part.ends_with(".js") || part.ends_with(".css")) {
        let (head, _) = ask(&format!("/{}", part.trim_start_matches("./")), "");
        assert!(head.starts_with("HTTP/1.1 200 "), "{part}: {head}");
    }
    drop(running);
    let mut more = String::new();
    lines.read_to_string(&mut more).unwrap();
    assert_eq!(more, "", "exactly one line");

    let taken = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let message = fail(1, &["view", text(&scene), "--no-open", "--port", &port]);
    assert!(message.contains(&format!("serving at port {port} of 127.0.0.1")), "{message}");
}

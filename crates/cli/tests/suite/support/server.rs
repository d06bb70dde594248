//! A command that serves a page, and requests to it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStdout, Stdio};
use std::time::Duration;

use crate::support::tcgs;

/// Whether this program was built with the page.
pub fn has_page() -> bool {
    let built = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../web/dist/index.html").is_file();
    assert!(built || std::env::var_os("REQUIRE_PLAYER").is_none(), "REQUIRE_PLAYER is set, and web/dist is not built");
    built
}

/// A server that ends with the test, and the rest of its output.
pub struct Running(pub Child, pub BufReader<ChildStdout>);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a server and reads its port from the line with its address.
pub fn start(arguments: &[&str]) -> (Running, u16) {
    let mut child = tcgs().args(arguments).stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap());
    let mut running = Running(child, lines);
    let mut line = String::new();
    running.1.read_line(&mut line).unwrap();
    let address = line.trim_end().trim_start_matches("watch at ");
    let port = address.strip_prefix("http://127.0.0.1:").and_then(|rest| rest.strip_suffix("/"));
    let port = port.unwrap_or_else(|| panic!("{line}")).parse().unwrap();
    (running, port)
}

/// Head and body of a response.
///
/// - `headers`: additional headers, each with its end of line
pub fn ask(port: u16, path: &str, headers: &str) -> (String, Vec<u8>) {
    let mut connection = TcpStream::connect(("127.0.0.1", port)).unwrap();
    connection.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    write!(connection, "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n{headers}\r\n").unwrap();
    let mut answer = Vec::new();
    connection.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap();
    (String::from_utf8(answer[..end].to_vec()).unwrap(), answer[end + 4..].to_vec())
}

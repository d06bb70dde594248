//! A web server for the player's page and one scene. It accepts connections from this machine alone.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, UNIX_EPOCH};

use crate::http::{HttpRequest, RequestedRange};
use crate::training::{TRAINING_FILES, Training};

/// Path at which the scene is served.
const SCENE: &str = "/scene.tcgs";
/// Path at which the cameras of the scene's capture are served, if there are any.
const CAMERAS: &str = "/cameras.json";
/// The elements of `index.html` that name the scene and the cameras to open, as built: none.
const NO_SCENE: &str = r#"<meta name="tcgs-src" content="">"#;
const NO_CAMERAS: &str = r#"<meta name="tcgs-cameras" content="">"#;
/// Likewise the element that names the state of a training.
const NO_TRAINING: &str = r#"<meta name="tcgs-train" content="">"#;
/// Idle timeout: a connection without data for so long is closed.
const PATIENCE: Duration = Duration::from_secs(30);

/// A file of the built page.
#[derive(Debug)]
pub struct PageFile {
    /// Path below the page's folder, with slashes.
    pub name: &'static str,
    /// Content of the file.
    pub bytes: &'static [u8],
}

/// The scene that a server shows.
#[derive(Debug)]
#[non_exhaustive]
pub enum SceneSource {
    /// A `.tcgs` file; every request reopens it.
    File(PathBuf),
    /// The bytes of a `.tcgs` file.
    Bytes(Vec<u8>),
    /// A running training, which makes files on request.
    Training(Arc<dyn Training>),
}

impl From<&Path> for SceneSource {
    fn from(path: &Path) -> Self {
        Self::File(path.into())
    }
}

/// Servers whose pages may show the player in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameAncestors {
    /// This server alone.
    #[default]
    Own,
    /// Any server on this machine, such as a notebook server.
    ThisMachine,
}

impl FrameAncestors {
    /// The value of the header `Content-Security-Policy`.
    fn policy(self) -> &'static str {
        match self {
            Self::Own => "frame-ancestors 'self'",
            Self::ThisMachine => {
                "frame-ancestors 'self' http://127.0.0.1:* http://localhost:* https://127.0.0.1:* https://localhost:* \
                 vscode-webview:"
            }
        }
    }
}

/// A server that listens on a port of 127.0.0.1.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    site: Site,
}

/// The files that are served.
#[derive(Debug)]
struct Site {
    scene: SceneSource,
    /// JSON of `docs/PLAYER.md`, "Cameras".
    cameras: Option<Vec<u8>>,
    page: &'static [PageFile],
    ancestors: FrameAncestors,
}

impl Server {
    /// Listens on a port of 127.0.0.1.
    ///
    /// - `port`: 0 for any free port
    /// - `scene`: the path of a `.tcgs` file, or the bytes of one
    /// - `page`: the built page of the player
    ///
    /// # Errors
    /// If the port is taken or not allowed.
    pub fn bind(port: u16, scene: impl Into<SceneSource>, page: &'static [PageFile]) -> io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        let site = Site { scene: scene.into(), cameras: None, page, ancestors: FrameAncestors::Own };
        Ok(Self { listener, site })
    }

    /// The same server, with pages of other servers allowed to show its page in a frame.
    pub fn framed_by(mut self, ancestors: FrameAncestors) -> Self {
        self.site.ancestors = ancestors;
        self
    }

    /// The same server; its page also shows the cameras of the scene's capture.
    ///
    /// - `cameras`: JSON of `docs/PLAYER.md`, "Cameras"
    pub fn with_cameras(mut self, cameras: Vec<u8>) -> Self {
        self.site.cameras = Some(cameras);
        self
    }

    /// The address of the page, for a browser.
    ///
    /// # Errors
    /// If the system does not report the port.
    pub fn address(&self) -> io::Result<String> {
        Ok(format!("http://{}/", self.listener.local_addr()?))
    }

    /// Serves for ever, with a thread per connection. A browser that breaks off, or sends a malformed request, loses
    /// its own connection and disturbs no other.
    ///
    /// - `failed`: called with the error of a connection that could not be accepted or given a thread
    pub fn run(self, failed: impl Fn(&io::Error)) -> ! {
        let shared = Arc::new(self.site);
        loop {
            let begun = self.listener.accept().and_then(|(connection, _)| {
                let site = Arc::clone(&shared);
                thread::Builder::new().spawn(move || site.serve_connection(&connection))
            });
            if let Err(error) = begun {
                failed(&error);
                thread::sleep(Duration::from_millis(100));
            }
        }
    }
}

impl Site {
    /// Answers the requests of a connection, one after the other.
    fn serve_connection(&self, connection: &TcpStream) -> io::Result<()> {
        connection.set_read_timeout(Some(PATIENCE))?;
        connection.set_write_timeout(Some(PATIENCE))?;
        connection.set_nodelay(true)?;
        let mut incoming = BufReader::new(connection);
        while let Some(request) = HttpRequest::read(&mut incoming)? {
            let with_body = request.method != "HEAD";
            let answer = self.answer(&request)?.with("Content-Security-Policy", self.ancestors.policy());
            answer.send(&mut &*connection, with_body)?;
            if request.header("connection").is_some_and(|value| value.eq_ignore_ascii_case("close")) {
                break;
            }
        }
        Ok(())
    }

    fn answer(&self, request: &HttpRequest) -> io::Result<HttpAnswer> {
        // Refuses any other `Host`: DNS rebinding would let a foreign page point its own name at 127.0.0.1 and read
        // local files.
        let host = request.header("host").unwrap_or_default();
        let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
        if !["127.0.0.1", "localhost"].contains(&name) {
            return Ok(HttpAnswer::plain("403 Forbidden", "this server answers to 127.0.0.1 alone"));
        }
        if !["GET", "HEAD"].contains(&request.method.as_str()) {
            return Ok(HttpAnswer::plain("405 Method Not Allowed", "expected GET or HEAD").with("Allow", "GET, HEAD"));
        }
        if let SceneSource::Training(training) = &self.scene
            && TRAINING_FILES.contains(&request.path.as_str())
        {
            return Ok(answer_training(&**training, request));
        }
        if request.path == SCENE {
            return match &self.scene {
                SceneSource::File(path) => answer_file(path, request),
                // A scene in memory is small, so ranges are not worth supporting: HTTP allows the whole file as an
                // answer.
                SceneSource::Bytes(bytes) => {
                    Ok(HttpAnswer::new("200 OK", "application/octet-stream", AnswerBody::Bytes(bytes.clone())))
                }
                SceneSource::Training(_) => Ok(HttpAnswer::plain("404 Not Found", "no such file")),
            };
        }
        if let Some(cameras) = self.cameras.as_ref().filter(|_| request.path == CAMERAS) {
            return Ok(HttpAnswer::new("200 OK", "application/json", AnswerBody::Bytes(cameras.clone())));
        }
        let name = match request.path.trim_start_matches('/') {
            "" => "index.html",
            name => name,
        };
        let Some(file) = self.page.iter().find(|file| file.name == name) else {
            return Ok(HttpAnswer::plain("404 Not Found", "no such file"));
        };
        let bytes = if name == "index.html" { self.filled_in(file.bytes) } else { file.bytes.into() };
        Ok(HttpAnswer::new("200 OK", mime(name), AnswerBody::Bytes(bytes)))
    }

    /// `index.html` with the paths of its scene and cameras filled in.
    fn filled_in(&self, page: &[u8]) -> Vec<u8> {
        let told = |element: &str, path: &str| element.replace(r#"content="""#, &format!("content=\"{path}\""));
        let (element, path) = match self.scene {
            SceneSource::Training(_) => (NO_TRAINING, TRAINING_FILES[0]),
            _ => (NO_SCENE, SCENE),
        };
        let mut text = String::from_utf8_lossy(page).replace(element, &told(element, path));
        if self.cameras.is_some() {
            text = text.replace(NO_CAMERAS, &told(NO_CAMERAS, CAMERAS));
        }
        text.into_bytes()
    }
}

/// Reopens the scene for every request, so that a scene that was compressed again shows after a reload.
fn answer_file(path: &Path, request: &HttpRequest) -> io::Result<HttpAnswer> {
    let Ok(mut file) = File::open(path) else {
        return Ok(HttpAnswer::plain("404 Not Found", "the scene is no longer there"));
    };
    let metadata = file.metadata()?;
    let length = metadata.len();
    let changed = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    let tag = format!("\"{length:x}-{:x}\"", changed.unwrap_or_default().as_nanos());
    // A part of a changed file would not fit the parts that the page has.
    let unchanged = request.header("if-range").is_none_or(|known| known == tag);
    let wanted = request.header("range").filter(|_| unchanged);
    let kind = "application/octet-stream";
    let answer = match RequestedRange::of(wanted, length) {
        RequestedRange::Whole => HttpAnswer::new("200 OK", kind, AnswerBody::File(file, length)),
        RequestedRange::Bytes(range) => {
            file.seek(SeekFrom::Start(range.start))?;
            let place = format!("bytes {}-{}/{length}", range.start, range.end - 1);
            HttpAnswer::new("206 Partial Content", kind, AnswerBody::File(file, range.end - range.start))
                .with("Content-Range", &place)
        }
        RequestedRange::Beyond => HttpAnswer::plain("416 Range Not Satisfiable", "no such bytes")
            .with("Content-Range", &format!("bytes */{length}")),
    };
    Ok(answer.with("Accept-Ranges", "bytes").with("ETag", &tag))
}

/// Answers with content newer than the page's. The tag in `If-None-Match` names the content that the page has.
fn answer_training(training: &dyn Training, request: &HttpRequest) -> HttpAnswer {
    let known = request.header("if-none-match").map(|tag| tag.trim_matches('"'));
    match training.answer(&request.path, known) {
        Ok(Some(file)) => {
            let kind = if request.path.ends_with(".json") { "application/json" } else { "application/octet-stream" };
            HttpAnswer::new("200 OK", kind, AnswerBody::Bytes(file.bytes.to_vec()))
                .with("ETag", &format!("\"{}\"", file.tag))
        }
        Ok(None) => HttpAnswer::new("204 No Content", "text/plain", AnswerBody::Bytes(Vec::new())),
        Err(problem) => HttpAnswer::plain("500 Internal Server Error", &problem),
    }
}

fn mime(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "wasm" => "application/wasm",
        _ => "application/octet-stream",
    }
}

enum AnswerBody {
    Bytes(Vec<u8>),
    /// The file's next bytes, and their number.
    File(File, u64),
}

struct HttpAnswer {
    head: String,
    body: AnswerBody,
}

impl HttpAnswer {
    fn new(status: &str, kind: &str, body: AnswerBody) -> Self {
        let length = match &body {
            AnswerBody::Bytes(bytes) => bytes.len() as u64,
            AnswerBody::File(_, length) => *length,
        };
        let head = format!("HTTP/1.1 {status}\r\n");
        Self { head, body }
            .with("Content-Type", kind)
            .with("Content-Length", &length.to_string())
            .with("Cache-Control", "no-cache")
            .with("X-Content-Type-Options", "nosniff")
    }

    fn plain(status: &str, text: &str) -> Self {
        Self::new(status, "text/plain; charset=utf-8", AnswerBody::Bytes(format!("{text}\n").into_bytes()))
    }

    fn with(mut self, name: &str, value: &str) -> Self {
        self.head.push_str(&format!("{name}: {value}\r\n"));
        self
    }

    fn send(self, connection: &mut impl Write, with_body: bool) -> io::Result<()> {
        connection.write_all(self.head.as_bytes())?;
        connection.write_all(b"\r\n")?;
        match self.body {
            _ if !with_body => {}
            AnswerBody::Bytes(bytes) => connection.write_all(&bytes)?,
            AnswerBody::File(file, length) => {
                let sent = io::copy(&mut file.take(length), connection)?;
                if sent < length {
                    // The file was truncated meanwhile. The head is already sent, so only closing the connection
                    // reports it.
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
        }
        connection.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::TrainingFile;

    const PAGE: &[PageFile] = &[
        PageFile {
            name: "index.html",
            bytes: br#"<head><meta name="tcgs-src" content=""><meta name="tcgs-cameras" content=""><meta name="tcgs-train" content=""></head>"#,
        },
        PageFile { name: "engine/a.wasm", bytes: b"\0asm" },
    ];

    /// A server of ten bytes, and the folder that holds them.
    fn serve() -> (u16, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("scene.tcgs");
        std::fs::write(&scene, b"0123456789").unwrap();
        let server = Server::bind(0, scene.as_path(), PAGE).unwrap();
        let port = server.listener.local_addr().unwrap().port();
        thread::spawn(move || server.run(|_| {}));
        (port, folder)
    }

    /// Head and body of an answer.
    fn ask(port: u16, method: &str, path: &str, headers: &[&str]) -> (String, String) {
        let mut connection = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        let host = format!("Host: 127.0.0.1:{port}");
        let host = if headers.iter().any(|h| h.starts_with("Host")) { None } else { Some(host.as_str()) };
        let lines: Vec<&str> = host.into_iter().chain(headers.iter().copied()).collect();
        write!(connection, "{method} {path} HTTP/1.1\r\nConnection: close\r\n{}\r\n\r\n", lines.join("\r\n")).unwrap();
        let mut answer = String::new();
        connection.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head.into(), body.into())
    }

    #[test]
    fn scenes_are_served_whole_and_in_parts() {
        let (port, folder) = serve();
        let (head, body) = ask(port, "GET", SCENE, &[]);
        assert!(head.starts_with("HTTP/1.1 200 ") && head.contains("\r\nAccept-Ranges: bytes"), "{head}");
        assert_eq!(body, "0123456789");
        let tag = head.lines().find_map(|line| line.strip_prefix("ETag: ")).unwrap().to_owned();

        let (head, body) = ask(port, "HEAD", SCENE, &[]);
        assert!(head.starts_with("HTTP/1.1 200 ") && head.contains("\r\nContent-Length: 10"), "{head}");
        assert_eq!(body, "");

        let (head, body) = ask(port, "GET", SCENE, &["Range: bytes=2-4", &format!("If-Range: {tag}")]);
        assert!(head.starts_with("HTTP/1.1 206 ") && head.contains("\r\nContent-Range: bytes 2-4/10\r\n"), "{head}");
        assert_eq!(body, "234");

        let (head, _) = ask(port, "GET", SCENE, &["Range: bytes=10-"]);
        assert!(head.starts_with("HTTP/1.1 416 ") && head.contains("\r\nContent-Range: bytes */10\r\n"), "{head}");

        std::fs::write(folder.path().join("scene.tcgs"), b"another").unwrap();
        let (head, body) = ask(port, "GET", SCENE, &["Range: bytes=2-4", &format!("If-Range: {tag}")]);
        assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
        assert_eq!(body, "another");
        std::fs::remove_file(folder.path().join("scene.tcgs")).unwrap();
        assert!(ask(port, "GET", SCENE, &[]).0.starts_with("HTTP/1.1 404 "));
    }

    #[test]
    fn the_page_is_told_its_scene() {
        let (port, _folder) = serve();
        let (head, body) = ask(port, "GET", "/", &[]);
        assert!(head.starts_with("HTTP/1.1 200 ") && head.contains("text/html"), "{head}");
        assert!(body.contains(r#"<meta name="tcgs-src" content="/scene.tcgs">"#), "{body}");
        assert_eq!(ask(port, "GET", "/index.html?theme=dark", &[]).1, body);
        assert!(ask(port, "GET", "/engine/a.wasm", &[]).0.contains("Content-Type: application/wasm"));
        for path in ["/missing", "/../Cargo.toml", "//etc/passwd", "/engine"] {
            assert!(ask(port, "GET", path, &[]).0.starts_with("HTTP/1.1 404 "), "{path}");
        }
    }

    #[test]
    fn scenes_in_memory_have_cameras_beside_them() {
        let server = Server::bind(0, SceneSource::Bytes(b"scene".to_vec()), PAGE).unwrap();
        let server = server.with_cameras(b"{}".to_vec());
        let port = server.listener.local_addr().unwrap().port();
        thread::spawn(move || server.run(|_| {}));
        let (head, body) = ask(port, "GET", SCENE, &["Range: bytes=1-2"]);
        assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
        assert_eq!(body, "scene");
        let (head, body) = ask(port, "GET", CAMERAS, &[]);
        assert!(head.contains("application/json"), "{head}");
        assert_eq!(body, "{}");
        let page = ask(port, "GET", "/", &[]).1;
        assert!(page.contains(r#"<meta name="tcgs-cameras" content="/cameras.json">"#), "{page}");

        let (port, _folder) = serve();
        assert!(ask(port, "GET", CAMERAS, &[]).0.starts_with("HTTP/1.1 404 "));
        assert!(ask(port, "GET", "/", &[]).1.contains(r#"<meta name="tcgs-cameras" content="">"#));
    }

    #[derive(Debug)]
    struct Count;

    impl Training for Count {
        fn answer(&self, path: &str, known: Option<&str>) -> Result<Option<TrainingFile>, String> {
            let file = |bytes: &[u8]| TrainingFile { tag: "second".into(), bytes: bytes.into() };
            match path {
                "/train.json" => Ok(Some(file(b"{}"))),
                "/running.tcgs" => Ok(Some(file(b"TCGS")).filter(|file| known != Some(&file.tag))),
                _ => Err("a damaged checkpoint".into()),
            }
        }
    }

    #[test]
    fn a_training_is_asked_for_what_is_newer() {
        let server = Server::bind(0, SceneSource::Training(Arc::new(Count)), PAGE).unwrap();
        let port = server.listener.local_addr().unwrap().port();
        thread::spawn(move || server.run(|_| {}));
        let page = ask(port, "GET", "/", &[]).1;
        assert!(page.contains(r#"<meta name="tcgs-train" content="/train.json">"#), "{page}");
        assert!(page.contains(r#"<meta name="tcgs-src" content="">"#), "{page}");
        let (head, body) = ask(port, "GET", "/train.json", &[]);
        assert!(head.contains("application/json") && body == "{}", "{head}");
        let (head, body) = ask(port, "GET", "/running.tcgs", &["If-None-Match: \"first\""]);
        assert!(head.starts_with("HTTP/1.1 200 ") && head.contains("ETag: \"second\"") && body == "TCGS", "{head}");
        let (head, body) = ask(port, "GET", "/running.tcgs", &["If-None-Match: \"second\""]);
        assert!(head.starts_with("HTTP/1.1 204 ") && body.is_empty(), "{head}");
        let (head, body) = ask(port, "GET", "/finished.tcgs", &[]);
        assert!(head.starts_with("HTTP/1.1 500 ") && body == "a damaged checkpoint\n", "{head}");
        assert!(ask(port, "GET", SCENE, &[]).0.starts_with("HTTP/1.1 404 "));
        let (port, _folder) = serve();
        assert!(ask(port, "GET", "/train.json", &[]).0.starts_with("HTTP/1.1 404 "));
    }

    #[test]
    fn a_page_is_framed_by_whom_it_allows() {
        let policy = |ancestors| {
            let server = Server::bind(0, Path::new("scene.tcgs"), PAGE).unwrap().framed_by(ancestors);
            let port = server.listener.local_addr().unwrap().port();
            thread::spawn(move || server.run(|_| {}));
            let head = ask(port, "GET", "/", &[]).0;
            head.lines().find_map(|line| line.strip_prefix("Content-Security-Policy: ")).unwrap().to_owned()
        };
        assert_eq!(policy(FrameAncestors::Own), "frame-ancestors 'self'");
        let framed = policy(FrameAncestors::ThisMachine);
        assert!(framed.contains(" http://localhost:* ") && !framed.contains(" * "), "{framed}");
    }

    #[test]
    fn a_connection_is_used_again() {
        let (port, _folder) = serve();
        let mut connection = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        for last in [false, true] {
            let close = if last { "Connection: close\r\n" } else { "" };
            write!(connection, "GET {SCENE} HTTP/1.1\r\nHost: localhost:{port}\r\nRange: bytes=0-0\r\n{close}\r\n")
                .unwrap();
        }
        let mut answers = String::new();
        connection.read_to_string(&mut answers).unwrap();
        assert_eq!(answers.matches("HTTP/1.1 206 ").count(), 2, "{answers}");
    }

    #[test]
    fn others_are_turned_away() {
        let (port, _folder) = serve();
        assert!(ask(port, "GET", SCENE, &["Host: evil.example"]).0.starts_with("HTTP/1.1 403 "));
        assert!(ask(port, "GET", SCENE, &["Host: evil.example:80"]).0.starts_with("HTTP/1.1 403 "));
        assert!(ask(port, "DELETE", SCENE, &[]).0.starts_with("HTTP/1.1 405 "));
    }
}

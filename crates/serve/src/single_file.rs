//! The player with one scene as one file, which a browser opens from a disk.

use std::io::{self, Write};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;

use crate::PageFile;

/// The engine that every browser runs.
const ENGINE: &str = "engine-webgl2/";

/// Modules of the built page that only other pages load.
const FOR_OTHERS: [&str; 4] = ["decoder.js", "element.js", "single.js", "tcgs-player.js"];

/// The page with one scene as HTML, about 0.4 MB longer than 4/3 of the scene. It needs no server, loads nothing, and
/// draws with WebGL2.
///
/// - `page`: [`PAGE`](crate::PAGE)
/// - `name`: of the scene's file
/// - `scene`: bytes of a `.tcgs` file
///
/// # Errors
/// [`io::ErrorKind::NotFound`] if `page` lacks a file, as an empty one does.
pub fn single_file(page: &[PageFile], name: &str, scene: &[u8]) -> io::Result<String> {
    let text = |name: &str| {
        let file = page.iter().find(|file| file.name == name).ok_or_else(|| missing(name))?;
        String::from_utf8(file.bytes.into()).map_err(|_| missing(name))
    };
    let mut parts = String::new();
    for file in page {
        let is_module = file.name.ends_with(".js") && !file.name.contains('/') && !FOR_OTHERS.contains(&file.name);
        if is_module || file.name.starts_with(ENGINE) {
            parts += &part("file", file.name, file.bytes)?;
        }
    }
    parts += &part("scene", name, scene)?;
    let mut html = text("index.html")?;
    let icon = BASE64_STANDARD.encode(text("icon.svg")?);
    let changes = [
        // The page may load nothing but its own texts.
        ("script-src 'self'", "script-src 'unsafe-inline' blob: data:".to_owned()),
        ("style-src 'self'", "style-src 'unsafe-inline'".to_owned()),
        ("href=\"icon.svg\"", format!("href=\"data:image/svg+xml;base64,{icon}\"")),
        ("<link rel=\"stylesheet\" href=\"style.css\">", format!("<style>\n{}</style>", text("style.css")?)),
        (
            "<script type=\"module\" src=\"main.js\"></script>",
            format!("{parts}<script type=\"module\">\n{}</script>", text("single.js")?),
        ),
        ("<meta name=\"tcgs-renderer\" content=\"\">", "<meta name=\"tcgs-renderer\" content=\"webgl2\">".to_owned()),
    ];
    for (before, after) in changes {
        if !html.contains(before) {
            return Err(missing(before));
        }
        html = html.replacen(before, &after, 1);
    }
    Ok(html)
}

/// Bytes as a text of the page.
fn part(kind: &str, name: &str, bytes: &[u8]) -> io::Result<String> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::best());
    packed.write_all(bytes)?;
    let text = BASE64_STANDARD.encode(packed.finish()?);
    let name = name.replace('&', "&amp;").replace('"', "&quot;");
    Ok(format!("<script type=\"text/plain\" data-{kind}=\"{name}\">{text}</script>\n"))
}

fn missing(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::NotFound, format!("the player's page has no {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: [PageFile; 6] = [
        PageFile {
            name: "index.html",
            bytes: b"<meta name=\"tcgs-renderer\" content=\"\"> script-src 'self'; style-src 'self'\
                     <link href=\"icon.svg\"><link rel=\"stylesheet\" href=\"style.css\">\
                     <script type=\"module\" src=\"main.js\"></script>",
        },
        PageFile { name: "icon.svg", bytes: b"<svg/>" },
        PageFile { name: "style.css", bytes: b"a{}" },
        PageFile { name: "single.js", bytes: b"start()" },
        PageFile { name: "main.js", bytes: b"main()" },
        PageFile { name: "engine/tcgs_play.js", bytes: b"other" },
    ];

    #[test]
    fn everything_is_in_one_file() {
        let html = single_file(&PAGE, "a \"b\".tcgs", b"scene").unwrap();
        for expected in
            ["<style>\na{}</style>", "start()", "data-file=\"main.js\"", "data-scene=\"a &quot;b&quot;.tcgs\""]
        {
            assert!(html.contains(expected), "{expected} in {html}");
        }
        assert!(!html.contains("src=") && !html.contains("'self'") && !html.contains("engine/"), "{html}");
    }

    #[test]
    fn a_program_without_the_player_says_so() {
        assert_eq!(single_file(&[], "a.tcgs", b"").unwrap_err().kind(), io::ErrorKind::NotFound);
    }
}

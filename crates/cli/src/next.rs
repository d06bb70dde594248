//! Suggests the next command as a line that a shell can run. Paths are quoted, and suggested outputs do not exist yet.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use tcgs_capture::{Capture, Split};
use tcgs_train::{Run, TrainConfig};

use crate::terminal::say;

/// Whether nothing is suggested: `tcgs make` runs the next command itself.
static IS_SILENT: AtomicBool = AtomicBool::new(false);

/// Suggests nothing from now on.
pub fn be_silent() {
    IS_SILENT.store(true, Ordering::Relaxed);
}

fn suggest(command: &str) -> anyhow::Result<()> {
    if IS_SILENT.load(Ordering::Relaxed) { Ok(()) } else { say(&format!("next: {command}")) }
}

/// The command that turns a folder of videos into a capture.
pub fn prepare(videos: &Path) -> String {
    format!("tcgs prepare {} --out {}", quoted(videos), quoted(&beside(videos, "capture")))
}

/// Prints the command that trains a capture.
///
/// - `points`: a file of points, instead of the capture's own
/// - `hold_out`: the cameras that these points leave out
pub fn train(capture: &Path, points: Option<&Path>, hold_out: &[String]) -> anyhow::Result<()> {
    let run = beside(capture, "run");
    let points = points.map_or(String::new(), |points| format!(" --points {}", quoted(points)));
    let held = if hold_out.is_empty() { String::new() } else { format!(" --hold-out {}", word(&hold_out.join(","))) };
    suggest(&format!("tcgs train {}{points}{held} --out {}", quoted(capture), quoted(&run)))
}

/// Prints the commands that compress a run and measure the file.
///
/// - `place`: path of the capture
/// - `capture`: as it was trained on
pub fn compress(run: &Run, place: &Path, capture: &Capture) -> anyhow::Result<()> {
    let default = run.folder().join("scene.tcgs");
    let file = free(&default);
    let out = if file == default { String::new() } else { format!(" --out {}", quoted(&file)) };
    let cameras = judges(run.config(), capture)?.map_or(String::new(), |judges| format!(" --cameras {judges}"));
    suggest(&format!(
        "tcgs compress {}{out} && tcgs eval {} --capture {}{cameras}",
        quoted(run.folder()),
        quoted(&file),
        quoted(place)
    ))
}

/// The value of `--cameras` that selects a run's held-out cameras: `None` if the default does, `train` if none are held
/// out.
fn judges(config: &TrainConfig, capture: &Capture) -> anyhow::Result<Option<String>> {
    let held_out = capture.camera_names(Split::Test, config.data.first_frame)?;
    Ok(match (held_out.is_empty(), config.data.hold_out.is_empty()) {
        (true, _) => Some("train".into()),
        (false, true) => None,
        (false, false) => Some(word(&held_out.join(","))),
    })
}

/// A path that does not exist, named after a folder and its planned content.
fn beside(folder: &Path, what: &str) -> PathBuf {
    let name = folder.file_name().map_or(what.into(), |name| format!("{}_{what}", name.to_string_lossy()));
    free(&folder.with_file_name(name))
}

/// A path that does not exist: the given one, or the same with a number appended to its stem.
fn free(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    let numbered = (2..).map(|number| path.with_file_name(format!("{stem}{number}{ending}")));
    let mut names = std::iter::once(path.to_path_buf()).chain(numbered);
    names.find(|name| name.symlink_metadata().is_err()).unwrap_or_else(|| path.into())
}

/// Quotes a path as one word of a POSIX shell that is not read as an option.
pub fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    word(&if text.starts_with('-') { format!("./{text}") } else { text })
}

/// Quotes a text as one word of a POSIX shell.
pub fn word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+,:=@%".contains(c) || cfg!(windows) && c == '\\';
    if !text.is_empty() && text.chars().all(is_plain) {
        text.into()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_each_path_as_one_word() {
        let quoted = |text: &str| quoted(Path::new(text));
        assert_eq!(quoted("/data/my_capture-2/cam.01"), "/data/my_capture-2/cam.01");
        assert_eq!(quoted("my capture"), "'my capture'");
        assert_eq!(quoted("it's $HOME;"), r"'it'\''s $HOME;'");
        assert_eq!(quoted("-o"), "./-o");
        assert_eq!((quoted("~/x").as_str(), word("")), ("'~/x'", "''".into()));
    }

    #[cfg(unix)]
    #[test]
    fn a_shell_gives_back_what_was_quoted() {
        for text in ["a b", "it's", "$HOME `id`", "\"x\" \\ !?*[1]{2}", "näh", "#1 & 2 | 3 > 4", "~"] {
            let said = std::process::Command::new("sh").args(["-c", &format!("printf %s {}", word(text))]).output();
            assert_eq!(String::from_utf8(said.unwrap().stdout).unwrap(), text);
        }
    }

    #[test]
    fn a_name_that_is_taken_gets_a_number() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        assert_eq!(free(&place("scene.tcgs")), place("scene.tcgs"));
        std::fs::write(place("scene.tcgs"), "x").unwrap();
        std::fs::write(place("scene2.tcgs"), "x").unwrap();
        assert_eq!(free(&place("scene.tcgs")), place("scene3.tcgs"));
        std::fs::create_dir(place("run")).unwrap();
        assert_eq!(free(&place("run")), place("run2"));
    }
}

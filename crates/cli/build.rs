//! Embeds the commit of the build in the program; `tcgs --version` prints it.

use std::fs;
use std::path::Path;
use std::process::Command;

fn main() {
    let version = env!("CARGO_PKG_VERSION");
    // A package of crates.io has no commit.
    let commit = git(&["describe", "--always", "--dirty", "--abbrev=10"]);
    println!(
        "cargo::rustc-env=TCGS_VERSION={version}{}",
        commit.map_or_else(String::new, |commit| format!(" ({commit})"))
    );
    // Runs again when sources or the commit change, so that the `--dirty` mark stays current.
    for entry in fs::read_dir("..").into_iter().flatten().flatten() {
        let sources = entry.path().join("src");
        if sources.is_dir() {
            println!("cargo::rerun-if-changed={}", sources.display());
        }
    }
    let folder = git(&["rev-parse", "--absolute-git-dir"]);
    for name in ["HEAD", "index"] {
        let path = folder.as_deref().map(|folder| Path::new(folder).join(name));
        if let Some(path) = path.filter(|path| path.exists()) {
            println!("cargo::rerun-if-changed={}", path.display());
        }
    }
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (!text.is_empty()).then_some(text)
}

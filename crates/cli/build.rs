//! Puts into the program the built page of the player, `web/dist`, where there is one (where there is none the program
//! builds all the same, and `tcgs view` says how to make it), and the commit that it is built from, for results that
//! name what made them.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    embed_page()?;
    name_commit();
    Ok(())
}

fn embed_page() -> io::Result<()> {
    let web = Path::new(&env::var("CARGO_MANIFEST_DIR").expect("set by cargo")).join("../../web");
    let page = web.join("dist");
    // A path that does not exist would count as changed at every build.
    println!("cargo::rerun-if-changed={}", if page.is_dir() { &page } else { &web }.display());

    let mut paths = Vec::new();
    if page.join("index.html").is_file() {
        collect(&page.canonicalize()?, &mut paths)?;
        paths.sort();
    }
    let mut list = String::from("&[\n");
    for path in &paths {
        let name: Vec<&str> = path
            .strip_prefix(page.canonicalize()?)
            .expect("below it")
            .iter()
            .filter_map(|part| part.to_str())
            .collect();
        writeln!(list, "    PageFile {{ name: {:?}, bytes: include_bytes!({path:?}) }},", name.join("/"))
            .expect("a text takes everything");
    }
    list.push(']');
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("set by cargo"));
    fs::write(out.join("page.rs"), list)
}

fn collect(folder: &Path, paths: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, paths)?;
        } else {
            paths.push(path);
        }
    }
    Ok(())
}

fn name_commit() {
    let commit = git(&["describe", "--always", "--dirty", "--abbrev=10"]).unwrap_or_else(|| "unknown".into());
    println!("cargo::rustc-env=TCGS_COMMIT={commit}");
    // Whether anything changed since the commit is asked again where sources did, or the commit.
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

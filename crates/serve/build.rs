//! Embeds the built page of the player: `page` in a package, `web/dist` in a checkout. A release build without a page
//! makes it, if Rust can compile to WebAssembly. Otherwise the program is built without a page, and says how to make
//! one when it is asked for it.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    embed_page()
}

fn embed_page() -> io::Result<()> {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo"));
    let web = here.join("../../web");
    let find = || [here.join("page"), web.join("dist")].into_iter().find(|page| page.join("index.html").is_file());
    let page = find().or_else(|| {
        if let Err(problem) = build_page(&web) {
            println!("cargo::warning=tcgs is built without the player: {problem}; see web/build.sh");
        }
        find()
    });
    println!("cargo::rerun-if-changed=build.rs");
    // A path that does not exist would count as changed at every build.
    if let Some(watched) = page.as_ref().or(web.exists().then_some(&web)) {
        println!("cargo::rerun-if-changed={}", watched.display());
    }

    let page = page.map(|page| page.canonicalize()).transpose()?.unwrap_or_default();
    let mut paths = Vec::new();
    if page.is_dir() {
        collect(&page, &mut paths)?;
        paths.sort();
    }
    let mut list = String::from("&[\n");
    for path in &paths {
        let name: Vec<&str> =
            path.strip_prefix(&page).expect("below it").iter().filter_map(|part| part.to_str()).collect();
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

/// Runs `web/build.sh` in a checkout, for a release build, where the target for WebAssembly is installed.
fn build_page(web: &Path) -> io::Result<()> {
    let script = web.join("build.sh");
    let sysroot =
        Command::new(env::var_os("RUSTC").expect("set by cargo")).args(["--print", "sysroot"]).output()?.stdout;
    let sysroot = String::from_utf8_lossy(&sysroot);
    let can_compile = Path::new(sysroot.trim_end()).join("lib/rustlib/wasm32-unknown-unknown").is_dir();
    if env::var("PROFILE").as_deref() != Ok("release") || !can_compile || !script.is_file() {
        return Ok(());
    }
    // A separate target folder, since cargo holds the lock of this build's folder.
    let target = PathBuf::from(env::var_os("OUT_DIR").expect("set by cargo")).join("page");
    let mut build = Command::new("bash");
    build.arg(&script).stdin(Stdio::null());
    // Cargo's variables for this build script must not reach another build.
    let told = ["RUSTC", "RUSTDOC", "TARGET", "HOST", "PROFILE", "OPT_LEVEL", "DEBUG", "NUM_JOBS", "OUT_DIR"];
    for (name, _) in env::vars_os() {
        let of_cargo = name.to_str().is_some_and(|name| name.starts_with("CARGO_") && name != "CARGO_HOME");
        if of_cargo || told.iter().any(|told| name == *told) {
            build.env_remove(&name);
        }
    }
    let made = build.env("CARGO_TARGET_DIR", &target).output()?;
    let _ = fs::remove_dir_all(&target);
    if made.status.success() {
        return Ok(());
    }
    let words = String::from_utf8_lossy(&made.stderr);
    let last = words.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default();
    Err(io::Error::other(format!("web/build.sh ended with {}: {last}", made.status)))
}

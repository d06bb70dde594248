//! Puts into the program the built page of the player, `web/dist`, where there is one. Where there is none the program builds
//! all the same, and says how to make it when the page is asked for.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    embed_page()
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

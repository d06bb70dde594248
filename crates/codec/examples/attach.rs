//! Puts application data into a `.tcgs` file that exists, in place of data of the same name; the scene's bytes stay as they are.
//!
//! ```sh
//! cargo run --release --example attach -p tcgs-codec -- scene.tcgs tcgs.credits credits.json out.tcgs
//! ```
//!
//! Arguments: file, name of the data (`docs/FORMAT.md`, "Application data"), file with the data, new file.

use std::error::Error;
use std::fs;

use tcgs_codec::{CompactFile, DecodeLimits, application_data, inspect};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, name, data, out] = &arguments[..] else { return Err("expected: file, name, data, new file".into()) };
    let read = |path: &String| fs::read(path).map_err(|error| format!("{path}: {error}"));
    let (bytes, data) = (read(file)?, read(data)?);
    let limits = DecodeLimits::default();
    let compact = CompactFile::decode(&bytes, &limits).map_err(|error| format!("{file}: {error}"))?;
    let held = application_data(&bytes, &limits)?;
    let others = held.iter().filter(|(of, _)| of != name).map(|(of, bytes)| (&of[..], *bytes));
    let all: Vec<(&str, &[u8])> = others.chain([(&name[..], &data[..])]).collect();
    let version = inspect(&bytes, &limits)?.version;
    let made = compact.encode(version, &all)?;
    // The new file may replace the old one, so it is written beside it first.
    let unfinished = format!("{out}.unfinished");
    fs::write(&unfinished, &made).and_then(|()| fs::rename(&unfinished, out)).map_err(|error| {
        let _ = fs::remove_file(&unfinished);
        format!("{out}: {error}")
    })?;
    println!("{out}: {} bytes, before {}", made.len(), bytes.len());
    Ok(())
}

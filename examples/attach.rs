//! Puts application data into a `.tcgs` file that exists, in place of data of the same name; the scene's bytes stay as
//! they are.
//!
//! ```sh
//! cargo run --release --example attach -- scene.tcgs tcgs.credits credits.json out.tcgs
//! ```
//!
//! Arguments: file, name of the data (`docs/FORMAT.md`, "Application data"), file with the data, new file.

use std::error::Error;
use std::fs;
use std::io::Write;

use tcgs::codec::{CompactFile, DecodeLimits, application_data, inspect};
use tcgs::interchange::{Existing, write_whole};

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
    // It may be the old file.
    write_whole(out.as_ref(), Existing::Replace, |file| file.write_all(&made))
        .map_err(|error| format!("{out}: {error}"))?;
    println!("{out}: {} bytes, before {}", made.len(), bytes.len());
    Ok(())
}

//! The experiment `captures`: settings compared on many captures, judged by training cameras that were left out.
//!
//! `captures.toml` lists the captures, and `few.toml` those of few cameras. A *variant* is a set of options of `tcgs
//! train` and `tcgs compress`. Each pair of a capture and a variant is trained, compressed and measured once: a stopped
//! command goes on where it was.

mod measure;
mod plan;
mod steps;
mod table;

use std::path::PathBuf;

use anyhow::Context;
use serde_json::Value;

use self::plan::{CaptureEntry, List, Variant};
use self::steps::Place;
use crate::error::{Stopped, wrong_input};
use crate::program::Program;

/// Compare settings on many captures
///
/// Trains, compresses and measures the rows that OUT lacks, and writes OUT/captures.txt after each row. The judges are
/// training cameras that were left out from the first iteration on. With --test they are the captures' own test
/// cameras: for final tables alone.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  cargo run --release -p tcgs-lab -- captures --data captures --out out --short \\
    --variant 'default' --variant 'paper masks: --set weights.mask=0.01 --set weights.mask_consistency=0.01'
  cargo run --release -p tcgs-lab -- captures --data captures --out out --list few --test
  cargo run --release -p tcgs-lab -- captures --data captures --out out --only toss \\
    --variant 'refined: / --quality -1 --refine 1500'")]
pub struct Arguments {
    /// Folder of the captures
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder for runs, files and the table
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    /// NAME: OPTIONS OF TRAIN / OPTIONS OF COMPRESS; may be repeated [default: default]
    #[arg(long, value_name = "VARIANT", default_value = "default")]
    variant: Vec<Variant>,
    /// The captures to measure
    #[arg(long, value_name = "LIST", default_value = "captures")]
    list: List,
    /// Only the captures of the short form
    #[arg(long)]
    short: bool,
    /// Only captures whose names begin with NAME; may be repeated
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Train on all training cameras, and judge by the captures' test cameras: for final tables alone
    #[arg(long)]
    test: bool,
    /// The program [default: tcgs beside this one]
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let program = Program::find(arguments.program.clone())?;
    let place =
        Place { data: arguments.data.clone(), out: arguments.out.clone(), program, judged_by_test: arguments.test };
    let chosen = |entry: &CaptureEntry| {
        let is_named = arguments.only.iter().any(|name| entry.name.starts_with(name.as_str()));
        (arguments.only.is_empty() || is_named) && (entry.short || !arguments.short)
    };
    let entries: Vec<CaptureEntry> = arguments.list.entries()?.into_iter().filter(chosen).collect();
    if entries.is_empty() {
        return Err(wrong_input("no capture has such a name, expected one of the list"));
    }
    let mut rows = Vec::new();
    for entry in &entries {
        for variant in &arguments.variant {
            let found = place.measured(entry, variant);
            match found.with_context(|| format!("{}, {}", entry.name, variant.name)) {
                Ok(found) => rows.push(Row { capture: entry.name.clone(), variant: variant.name.clone(), found }),
                Err(error) if error.is::<Stopped>() => return Err(error),
                // One capture that fails leaves the others their rows.
                Err(error) => eprintln!("lab: {error:#}"),
            }
            let text = table::text(&rows);
            std::fs::write(arguments.out.join("captures.txt"), &text).context("captures.txt")?;
        }
    }
    print!("{}", table::text(&rows));
    anyhow::ensure!(rows.len() == entries.len() * arguments.variant.len(), "some rows are missing");
    Ok(())
}

/// The measurements of one capture with one variant.
struct Row {
    capture: String,
    variant: String,
    found: Value,
}

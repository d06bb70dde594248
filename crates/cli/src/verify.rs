//! `tcgs verify`: checks that a `.tcgs` file is whole, and that its errors stay within those it declares.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};
use tcgs_codec::CompactFile;
use tcgs_core::read_file;
use tcgs_pipeline::{Compared, Comparison, OpenScene, PipelineError, compare, whole_file_limits};

use crate::attribute_errors::{self, show, unit, word};
use crate::options::JobOptions;
use crate::output::show_bytes;
use crate::scene::{SourceOptions, describe, note_replaced, unreadable};
use crate::teller::Teller;
use crate::terminal::say;

/// Check that a .tcgs file is whole, and with SOURCE that it errs by no more than it declares
///
/// Verifies every checksum and decodes everything, within the limits of a decoder. With SOURCE it looks for every
/// Gaussian of the file in the scene that was compressed, at every timestep. In a version 2 file by compress, each
/// Gaussian has a source Gaussian of its own within the declared errors of all attributes. Source Gaussians that are
/// not in the file were pruned.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs verify scene.tcgs
  tcgs verify scene.tcgs my_plys

Exit codes: 0 the file is whole, and with SOURCE within the errors that it declares; 1 an error is larger than declared,
or none is declared; 2 wrong usage, a damaged file, or another scene than SOURCE by its timesteps or attributes.")]
pub struct Arguments {
    /// .tcgs file
    file: PathBuf,
    /// The compressed scene: run folder, params.npz, .4dgs file, PLY, SPZ, glTF or SOG files, or .tcgs file; several
    /// run folders if chapters were joined
    sources: Vec<PathBuf>,
    #[command(flatten)]
    reading: SourceOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let path = &arguments.file;
    let sources: Vec<&Path> = std::iter::once(path).chain(&arguments.sources).map(PathBuf::as_path).collect();
    arguments.job.begin(&[], &sources)?;
    let bytes = read_file(path, u64::MAX).map_err(|error| unreadable(path, error, "a .tcgs file"))?;
    let whole = CompactFile::decode(&bytes, &whole_file_limits(bytes.len() as u64))
        .map_err(|error| PipelineError::Decode { path: path.clone(), error })?;
    let (info, declared) = (&whole.info, &whole.declared_errors);
    say(&format!(
        "{}: whole, {} Gaussians, {} timesteps, {}",
        path.display(),
        info.num_gaussians,
        info.num_timesteps,
        show_bytes(bytes.len() as u64)
    ))?;
    let mut result = json!({
        "file": path.display().to_string(),
        "bytes": bytes.len(),
        "num_gaussians": info.num_gaussians,
        "num_timesteps": info.num_timesteps,
        "declared_errors": attribute_errors::machine_readable(declared),
    });
    if arguments.sources.is_empty() {
        if declared.is_empty() {
            say("declares no errors")?;
        }
        attribute_errors::print(declared)?;
        return arguments.job.write_json(&result);
    }
    // Chapters are joined at borders of segments.
    let segment_length = whole.cohorts.first().map(|cohort| cohort.segment_length);
    drop((whole, bytes));
    let sources = arguments.sources.iter().map(|source| arguments.reading.open(source));
    let source = OpenScene::join(sources.collect::<Result<_, _>>()?, segment_length)?;
    say(&describe(&source))?;
    let file = arguments.reading.open(path)?;
    let comparison = Teller::default().watch(|teller| compare(&file, &source, teller))?;
    print(&comparison)?;
    note_replaced(&source);
    result["source"] = json!(arguments.sources.iter().map(|source| source.display().to_string()).collect::<Vec<_>>());
    add(&mut result, &comparison);
    arguments.job.write_json(&result)?;
    judge(&comparison, arguments)
}

fn print(comparison: &Comparison) -> anyhow::Result<()> {
    say("attribute         declared      found")?;
    for compared in &comparison.attributes {
        let Compared { name, declared, found } = compared;
        let verdict = if declared.is_some() && !compared.holds() { ", more than declared" } else { "" };
        let declared = declared.map_or("-".into(), |declared| show(f64::from(declared)));
        say(&format!("{:<15}  {declared:>9}  {:>9}  {}{verdict}", word(name), show(*found), unit(name)))?;
    }
    let [least, most] = comparison.num_pruned;
    let pruned = match (least, most) {
        (0, 0) => "all Gaussians of the source are in the file".into(),
        (least, most) if least == most => format!("{most} Gaussians of the source were pruned"),
        (least, most) => format!("{least} to {most} Gaussians of the source were pruned at a timestep"),
    };
    say(&pruned)
}

fn add(result: &mut Value, comparison: &Comparison) {
    let of = |compared: &Compared| json!({ "declared": compared.declared.map(f64::from), "found": compared.found });
    let errors = comparison.attributes.iter().map(|compared| (compared.name.clone(), of(compared)));
    result["errors"] = errors.collect::<Map<_, _>>().into();
    result["num_compared"] = json!(comparison.num_compared);
    result["num_beyond"] = json!(comparison.num_beyond);
    result["num_pruned"] = json!(comparison.num_pruned);
    result["holds"] = json!(comparison.holds());
}

/// Returns an error, exit code 1, unless all errors are within those declared.
fn judge(comparison: &Comparison, arguments: &Arguments) -> anyhow::Result<()> {
    let file = arguments.file.display();
    let attributes = |holds: fn(&&Compared) -> bool| -> String {
        let names: Vec<&str> = comparison.attributes.iter().filter(holds).map(|of| word(&of.name)).collect();
        names.join(", ")
    };
    let silent = attributes(|of| of.declared.is_none());
    let larger = attributes(|of| of.declared.is_some() && !of.holds());
    if comparison.holds() {
        say("within the declared errors")
    } else if !silent.is_empty() {
        anyhow::bail!("{file}: declares no error of {silent}, expected a file of format 2, as `tcgs compress` makes it")
    } else if larger.is_empty() {
        let (beyond, all) = (comparison.num_beyond, comparison.num_compared);
        anyhow::bail!("{file}: {beyond} of {all} Gaussians of all timesteps are none of the source, expected all")
    } else {
        let (beyond, all) = (comparison.num_beyond, comparison.num_compared);
        anyhow::bail!(
            "{file}: {beyond} of {all} Gaussians of all timesteps are none of the source within the declared errors \
             ({larger}), expected all"
        )
    }
}

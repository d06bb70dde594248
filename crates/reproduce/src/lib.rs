//! The paper's tables and figures, from captures to LaTeX: a laboratory around the pipeline.
//!
//! A file in `tables/` defines a table: its trainings, measurements, columns, and the paper's numbers. [`plan`] reads
//! such a file. [`execute`] runs steps without a result, each as a process of the command line's program, so that a
//! person can type every step. [`write()`] makes text, CSV, LaTeX, JSON, a page and SVG plots from the results alone.
//! [`html`] makes the page of one run in the same style. What does not live here: arguments of a command line, training
//! and compression.
//!
//! ```
//! use tcgs_reproduce::{Size, plan, tables};
//!
//! let (name, table) = tables()?.swap_remove(0);
//! println!("{name}: {} ({})", table.title, table.paper);
//! let plan = plan("ablation", Some(&["basketball".to_owned()]), Size::Small, &[])?;
//! assert!(plan.jobs.iter().all(|job| job.scene == "basketball"));
//! # Ok::<(), tcgs_reproduce::ReproduceError>(())
//! ```

mod analysis;
mod error;
mod execute;
mod figure;
mod pictures;
mod plan;
mod report;
mod table;

use std::path::PathBuf;

use serde_json::Value;
use tcgs_render::DrawAny;

use crate::error::wrong_input;
use crate::execute::{argument, command_line, quoted, write_file};
use crate::report::plot::standalone;

pub use error::ReproduceError;
pub use execute::{Workplace, execute};
pub use plan::{Column, Job, Measure, Plot, PlotKind, Row, Size, Table, TableLayout, TablePlan, plan, tables};
pub use report::{CompressionStep, Picture, Report, Series, html, png};

/// Checks that every scene has its folder.
///
/// # Errors
/// [`ReproduceError::NoCaptures`] that names the scenes without one.
pub fn check_captures(plan: &TablePlan, place: &Workplace) -> Result<(), ReproduceError> {
    let (present, missing): (Vec<String>, Vec<String>) =
        plan.scenes.iter().cloned().partition(|scene| place.capture(scene).is_dir());
    if missing.is_empty() {
        return Ok(());
    }
    Err(ReproduceError::NoCaptures { data: place.data.clone(), missing, present })
}

/// Commands for all runs that lack something, for GNU parallel or a batch system.
///
/// # Errors
/// [`ReproduceError::OtherArguments`] if a result was made by other arguments.
pub fn missing_commands(plan: &TablePlan, place: &Workplace) -> Result<Vec<String>, ReproduceError> {
    let program = quoted(&argument(&place.program)?);
    let mut commands = Vec::new();
    for job in &plan.jobs {
        if !place.is_done(job)? {
            let mut arguments = place.command.clone();
            arguments.extend_from_slice(&place.backend);
            if let Some(threads) = place.threads {
                arguments.extend(["--threads".into(), threads.to_string()]);
            }
            if place.force {
                arguments.push("--force".into());
            }
            arguments.extend(["--only".into(), job.name()]);
            let line = command_line(&arguments);
            commands.push(format!("{program}{}", line.strip_prefix("tcgs").unwrap_or(&line)));
        }
    }
    Ok(commands)
}

/// A table that has been written.
#[derive(Clone, Debug)]
pub struct Written {
    /// The table as text.
    pub text: String,
    /// The table for machines.
    pub json: Value,
    /// Path of its page.
    pub page: PathBuf,
}

/// Writes a table and its figures into the output folder, from the existing results.
///
/// - `renderer`: draws the table's pictures ([`TablePlan::has_pictures`]); without it they are left out
///
/// # Errors
/// [`ReproduceError`] if a result was made by other arguments, a scene cannot be drawn, or a file cannot be written.
pub fn write(plan: &TablePlan, place: &Workplace, renderer: Option<&DrawAny>) -> Result<Written, ReproduceError> {
    if !place.out.is_dir() {
        return Err(wrong_input(format!("{}: no such folder, expected one to write into", place.out.display())));
    }
    let mut results = table::Results::new();
    for job in &plan.jobs {
        for measure in job.measures.keys() {
            if let Some(result) = place.result(job, measure)? {
                results.insert(format!("{}/{measure}", job.name()), result);
            }
        }
    }
    let mut shown = figure::show(plan, &results)?;
    let file = |name: &str, bytes: &[u8]| write_file(&place.out.join(name), bytes);
    if let Some(renderer) = renderer.filter(|_| plan.has_pictures()) {
        for (name, picture) in pictures::grids(plan, place, renderer)? {
            write_file(&place.out.join(name), &picture.png)?;
            shown.pictures.push(picture);
        }
    }
    let name = &plan.name;
    let title = format!("{} ({})", plan.table.title, plan.table.paper);
    let text = table::text(&title, &plan.table.notes, &shown.sheets);
    let json = table::json(plan, &shown.sheets, &results, place.commit);
    file(&format!("{name}.txt"), text.as_bytes())?;
    file(&format!("{name}.csv"), table::csv(&shown.sheets, &results).as_bytes())?;
    file(&format!("{name}.tex"), table::tex(&title, &shown.sheets).as_bytes())?;
    file(&format!("{name}.json"), format!("{json:#}\n").as_bytes())?;
    let page = place.out.join(format!("{name}.html"));
    write_file(&page, figure::page(plan, &shown, &results).as_bytes())?;
    for figure in &shown.figures {
        let svg = figure.svg();
        if !svg.is_empty() {
            file(&format!("{name}-{}.svg", slug(figure.title())), standalone(&svg).as_bytes())?;
        }
    }
    Ok(Written { text, json, page })
}

/// Turns a title into a part of a file name.
fn slug(title: &str) -> String {
    let title = title.split(';').next().unwrap_or(title);
    let plain = title.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' });
    plain.collect::<String>().split_whitespace().collect::<Vec<_>>().join("-")
}

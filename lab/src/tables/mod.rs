//! The paper's tables and figures, from captures to LaTeX.
//!
//! A file of `lab/tables` defines a table: its trainings, measurements, columns, and the paper's numbers. `plan` reads
//! such a file. `execute` runs steps without a result, each a command of `tcgs` that a person can type. `write` makes
//! text, CSV, LaTeX, JSON, a page and SVG plots from the results alone. This file has the arguments.

mod analysis;
mod execute;
mod figure;
mod pictures;
mod plan;
mod table;
mod write;

use std::path::PathBuf;

use anyhow::Context;

use self::execute::{Workplace, argument, command_line, execute, quoted};
use self::plan::{Job, Size, TablePlan, plan, tables};
use crate::error::wrong_input;
use crate::program::Program;

// `main` has the help of the command: a doc comment would replace it.
#[derive(clap::Args)]
pub struct TableArguments {
    /// Name of the table
    #[arg(required_unless_present = "list")]
    table: Option<String>,
    /// List the tables
    #[arg(long)]
    list: bool,
    /// Folder of the captures
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    data: Option<PathBuf>,
    /// Folder for runs and tables
    #[arg(long, value_name = "OUT", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Scenes, separated by commas; any that DIR has a folder for [default: the paper's]
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    scenes: Option<Vec<String>>,
    /// Length and data of the training
    #[arg(long, default_value = "full")]
    size: Size,
    /// Options of train that replace the table's, such as "--frames 0..20 --iterations 1500,300"
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true)]
    train_args: Option<String>,
    /// Do only this run, and write no table
    #[arg(long, value_name = "SCENE/RUN")]
    only: Option<String>,
    /// Run nothing: write the table from finished runs
    #[arg(long, conflicts_with = "only")]
    no_run: bool,
    /// Print a command for each missing run, and do nothing
    #[arg(long, conflicts_with_all = ["only", "no_run"])]
    print_commands: bool,
    /// Repeat runs that were made by other arguments
    #[arg(long)]
    force: bool,
    /// Option of train and eval: cpu, gpu or auto
    #[arg(long, value_name = "NAME")]
    backend: Option<String>,
    /// Option of train and eval: a GPU, by a part of its name
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
    /// Threads to compute with; results do not depend on it [default: as many as cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// The program [default: tcgs beside this one]
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
}

/// Runs the command.
pub fn run(arguments: &TableArguments) -> anyhow::Result<()> {
    if arguments.list {
        for (name, table) in tables()? {
            println!("{name:<12}  {} ({})", table.title, table.paper);
        }
        return Ok(());
    }
    let (Some(table), Some(data), Some(out)) = (&arguments.table, &arguments.data, &arguments.out) else {
        return Err(wrong_input("no table, expected one of those that --list shows"));
    };
    let threads = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads.unwrap_or(0).into());
    threads.build_global().context("starting threads")?;
    let over: Vec<String> =
        arguments.train_args.iter().flat_map(|text| text.split_whitespace()).map(str::to_owned).collect();
    let plan = plan(table, arguments.scenes.as_deref(), arguments.size, &over)?;
    let backend = [("--backend", &arguments.backend), ("--device", &arguments.device)];
    let backend = backend.into_iter().filter_map(|(name, value)| Some([name.to_owned(), value.clone()?])).flatten();
    let place = Workplace {
        data: data.clone(),
        out: out.clone(),
        backend: backend.collect(),
        threads: arguments.threads.iter().flat_map(|threads| ["--threads".into(), threads.to_string()]).collect(),
        force: arguments.force,
        command: command(arguments, table)?,
        program: Program::find(arguments.program.clone())?,
    };
    check_captures(&plan, &place)?;
    if arguments.print_commands {
        for command in missing_commands(&plan, &place, arguments)? {
            println!("{command}");
        }
        return Ok(());
    }
    if let Some(only) = &arguments.only {
        let chosen: Vec<Job> = plan.jobs.iter().filter(|job| job.name() == *only).cloned().collect();
        if chosen.is_empty() {
            let names: Vec<String> = plan.jobs.iter().map(Job::name).collect();
            let problem = format!("no run of the table {table}, expected one of {}", names.join(", "));
            return Err(wrong_input(format!("--only {only}: {problem}")));
        }
        return execute(&place, &chosen);
    }
    if !arguments.no_run {
        execute(&place, &plan.jobs)?;
    }
    println!("{}", write::write(&plan, &place)?);
    eprintln!("written to {}", place.out.join(format!("{table}.html")).display());
    Ok(())
}

/// The arguments again, without the options that apply to one call only.
fn command(arguments: &TableArguments, table: &str) -> anyhow::Result<Vec<String>> {
    let mut command = vec![table.to_owned()];
    for (name, path) in [("--data", &arguments.data), ("--out", &arguments.out)] {
        if let Some(path) = path {
            command.extend([name.to_owned(), argument(path)?]);
        }
    }
    if let Some(scenes) = &arguments.scenes {
        command.extend(["--scenes".into(), scenes.join(",")]);
    }
    if arguments.size == Size::Small {
        command.extend(["--size".into(), "small".into()]);
    }
    if let Some(more) = &arguments.train_args {
        command.push(format!("--train-args={more}"));
    }
    Ok(command)
}

/// Checks that every scene has its folder.
fn check_captures(plan: &TablePlan, place: &Workplace) -> anyhow::Result<()> {
    let (present, missing): (Vec<&str>, Vec<&str>) =
        plan.scenes.iter().map(String::as_str).partition(|scene| place.capture(scene).is_dir());
    if missing.is_empty() {
        return Ok(());
    }
    let present = if present.is_empty() { "with those that are there".into() } else { present.join(",") };
    let (data, missing) = (place.data.display(), missing.join(", "));
    let problem = format!("has no captures named {missing}, expected a folder for each, or --scenes {present}");
    Err(wrong_input(format!("{data}: {problem}")))
}

/// Commands for all runs that lack something, for GNU parallel or a batch system.
fn missing_commands(plan: &TablePlan, place: &Workplace, arguments: &TableArguments) -> anyhow::Result<Vec<String>> {
    let this = quoted(&argument(&std::env::current_exe().context("finding this program")?)?);
    let mut common = [&*place.command, &place.backend, &place.threads].concat();
    if let Some(program) = &arguments.program {
        common.extend(["--program".into(), argument(program)?]);
    }
    if place.force {
        common.push("--force".into());
    }
    let mut commands = Vec::new();
    for job in &plan.jobs {
        if !place.is_done(job)? {
            let only = ["--only".into(), job.name()];
            commands.push(command_line(&this, &[common.as_slice(), &only].concat()));
        }
    }
    Ok(commands)
}

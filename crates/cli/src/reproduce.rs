//! `tcgs reproduce`: a table of the paper by one command. `tcgs-reproduce` does the work; this file has the arguments
//! and messages.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;
use tcgs_reproduce::{Job, Size, Workplace, check_captures, execute, missing_commands, plan, tables, write};

use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::interrupt;
use crate::options::JobOptions;
use crate::terminal::{note, say};

/// Reproduce a table or figure of the paper
///
/// Trains, compresses and evaluates the runs that are missing in OUT. Writes OUT/TABLE.txt, .csv, .tex, .json, .html
/// and its plots, our numbers beside the paper's. Finished runs are not repeated, so a stopped command continues where
/// it was. DIR holds a folder with a capture for each scene, named after it: basketball, cook_spinach, ...
///
/// --print-commands prints a command for each missing run, for GNU parallel or a batch system; then the same command
/// without it writes the table.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs reproduce --list
  tcgs reproduce ablation --data captures --out results --scenes basketball --size small
  tcgs reproduce ablation --data captures --out results --print-commands | parallel -j 2")]
pub struct Arguments {
    /// Name of the table
    #[arg(required_unless_present = "list")]
    table: Option<String>,
    /// List the tables
    #[arg(long, conflicts_with = "json")]
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
    size: SizeName,
    /// Options of train that replace the table's, such as "--frames 0..20 --iterations 1500,300"
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true)]
    train_args: Option<String>,
    /// Do only this run, and write no table
    #[arg(long, value_name = "SCENE/RUN", conflicts_with = "json")]
    only: Option<String>,
    /// Run nothing: write the table from finished runs
    #[arg(long, conflicts_with = "only")]
    no_run: bool,
    /// Print a command for each missing run, and do nothing
    #[arg(long, conflicts_with_all = ["only", "no_run", "json"])]
    print_commands: bool,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Length and data of the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SizeName {
    /// The paper's frames and schedule
    Full,
    /// About a quarter of an hour of training on two cores
    Small,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin(&[], arguments.data.as_deref().as_slice())?;
    if arguments.list {
        return list();
    }
    let (Some(table), Some(data), Some(out)) = (&arguments.table, &arguments.data, &arguments.out) else {
        return Err(wrong_input("no table, expected one of those that --list shows"));
    };
    let mut over = arguments.train_args.as_deref().map(words).unwrap_or_default();
    if let Some(seed) = arguments.job.seed {
        over.extend(["--seed".into(), seed.to_string()]);
    }
    let size = match arguments.size {
        SizeName::Full => Size::Full,
        SizeName::Small => Size::Small,
    };
    let plan = plan(table, arguments.scenes.as_deref(), size, &over)?;
    let place = Workplace {
        data: data.clone(),
        out: out.clone(),
        backend: arguments.backend.arguments(),
        threads: arguments.job.threads,
        force: arguments.job.force,
        command: command(arguments, table)?,
        program: std::env::current_exe().context("finding this program")?,
        run: interrupt::run,
        commit: env!("TCGS_COMMIT"),
        tell: note,
    };
    check_captures(&plan, &place)?;
    if arguments.print_commands {
        return missing_commands(&plan, &place)?.iter().try_for_each(|command| say(command));
    }
    if let Some(only) = &arguments.only {
        let chosen: Vec<Job> = plan.jobs.iter().filter(|job| job.name() == *only).cloned().collect();
        if chosen.is_empty() {
            let names: Vec<String> = plan.jobs.iter().map(Job::name).collect();
            let problem = format!("no run of the table {table}, expected one of {}", names.join(", "));
            return Err(wrong_input(format!("--only {only}: {problem}")));
        }
        return Ok(interrupt::politely(|| execute(&place, &chosen))?);
    }
    if !arguments.no_run {
        interrupt::politely(|| execute(&place, &plan.jobs))?;
    }
    let renderer = plan.has_pictures().then(|| arguments.backend.open(BackendName::Auto)).transpose()?;
    let renderer = renderer.as_ref().map(|backend| backend.renderer());
    let written = write(&plan, &place, renderer.as_deref())?;
    say(&written.text)?;
    note(&format!("written to {}", written.page.display()));
    arguments.job.write_json(&written.json)
}

fn list() -> anyhow::Result<()> {
    for (name, table) in tables()? {
        say(&format!("{name:<12}  {} ({})", table.title, table.paper))?;
    }
    Ok(())
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// The command line again, without the options that apply to one call only.
fn command(arguments: &Arguments, table: &str) -> anyhow::Result<Vec<String>> {
    let (data, out) = (arguments.data.as_deref(), arguments.out.as_deref());
    let mut command = vec!["reproduce".to_owned(), table.to_owned()];
    for (name, path) in [("--data", data), ("--out", out)] {
        command.extend([name.to_owned(), text(path.unwrap_or("".as_ref()))?]);
    }
    if let Some(scenes) = &arguments.scenes {
        command.extend(["--scenes".into(), scenes.join(",")]);
    }
    if arguments.size == SizeName::Small {
        command.extend(["--size".into(), "small".into()]);
    }
    if let Some(more) = &arguments.train_args {
        command.push(format!("--train-args={more}"));
    }
    if let Some(seed) = arguments.job.seed {
        command.extend(["--seed".into(), seed.to_string()]);
    }
    Ok(command)
}

/// A path as a UTF-8 argument.
fn text(path: &Path) -> anyhow::Result<String> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| wrong_input(format!("{}: not a name in UTF-8, expected one", path.display())))
}

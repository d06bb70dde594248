//! `tcgs reproduce`: a table of the paper by one command.
//!
//! What a table is made of is in `tables/`, one file each; `plan` reads them, `execute` runs what is missing, `table` and
//! `figure` write what was found.

mod analysis;
mod execute;
mod figure;
mod pictures;
mod plan;
mod table;

use std::path::PathBuf;

use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::options::JobOptions;
use crate::output::{note, say, write_file};
use crate::report::plot::standalone;
use execute::{Place, command_line, execute, text};
use plan::{Job, Plan, PlotKind, Size, plan};

/// Reproduce a table or figure of the paper
///
/// Trains, compresses and evaluates what is missing in OUT, and writes OUT/TABLE.txt, .csv, .tex, .json, .html and its
/// plots, our numbers beside the paper's. What is done is not done again, so that a stopped command goes on where it
/// was. DIR holds a capture a scene, in a folder of the scene's name: basketball, cook_spinach, ...
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
    /// Show the tables that there are
    #[arg(long, conflicts_with = "json")]
    list: bool,
    /// Folder of the captures
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    data: Option<PathBuf>,
    /// Folder for runs and tables
    #[arg(long, value_name = "OUT", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Scenes, with commas between [default: the paper's]
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    scenes: Option<Vec<String>>,
    /// How long is trained, and on what
    #[arg(long, default_value = "full")]
    size: Size,
    /// Options of train that replace the table's, such as "--frames 0..20 --iterations 1500,300"
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true)]
    train_args: Option<String>,
    /// Do this run alone, and write no table
    #[arg(long, value_name = "SCENE/RUN", conflicts_with = "json")]
    only: Option<String>,
    /// Run nothing: write the table from what is done
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

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
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
    let plan = plan(table, arguments.scenes.as_deref(), arguments.size, &over)?;
    let place = Place {
        data: data.clone(),
        out: out.clone(),
        backend: arguments.backend.arguments(),
        threads: arguments.job.threads,
        force: arguments.job.force,
        command: command(arguments, table)?,
    };
    check_captures(&plan, &place)?;
    if arguments.print_commands {
        return print_commands(&plan, &place);
    }
    if let Some(only) = &arguments.only {
        let chosen: Vec<Job> = plan.jobs.iter().filter(|job| name_of(job) == *only).cloned().collect();
        if chosen.is_empty() {
            let names: Vec<String> = plan.jobs.iter().map(name_of).collect();
            let problem = format!("no run of the table {table}, expected one of {}", names.join(", "));
            return Err(wrong_input(format!("--only {only}: {problem}")));
        }
        return execute(&place, &chosen);
    }
    if !arguments.no_run {
        execute(&place, &plan.jobs)?;
    }
    write(arguments, &plan, &place)
}

fn name_of(job: &Job) -> String {
    format!("{}/{}", job.scene, job.run)
}

fn list() -> anyhow::Result<()> {
    for (name, table) in plan::list()? {
        say(&format!("{name:<12}  {} ({})", table.title, table.paper))?;
    }
    Ok(())
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// The command line again, but for what belongs to one call alone.
fn command(arguments: &Arguments, table: &str) -> anyhow::Result<Vec<String>> {
    let (data, out) = (arguments.data.as_deref(), arguments.out.as_deref());
    let mut command = vec!["reproduce".to_owned(), table.to_owned()];
    for (name, path) in [("--data", data), ("--out", out)] {
        command.extend([name.to_owned(), text(path.unwrap_or("".as_ref()))?]);
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
    if let Some(seed) = arguments.job.seed {
        command.extend(["--seed".into(), seed.to_string()]);
    }
    Ok(command)
}

/// Every scene has its folder.
fn check_captures(plan: &Plan, place: &Place) -> anyhow::Result<()> {
    let missing: Vec<&str> =
        plan.scenes.iter().filter(|scene| !place.capture(scene).is_dir()).map(String::as_str).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let there: Vec<&str> = plan.scenes.iter().map(String::as_str).filter(|scene| !missing.contains(scene)).collect();
    let instead = match there[..] {
        [] => "a folder for each, or --scenes with those that are there".to_owned(),
        _ => format!("a folder for each, or --scenes {}", there.join(",")),
    };
    let data = place.data.display();
    Err(wrong_input(format!("{data}: has no captures named {}, expected {instead}", missing.join(", "))))
}

/// A line for each run that lacks something.
fn print_commands(plan: &Plan, place: &Place) -> anyhow::Result<()> {
    let program = std::env::current_exe()?;
    let program = text(&program)?;
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
            arguments.extend(["--only".into(), name_of(job)]);
            let line = command_line(&arguments);
            let quoted = execute::quoted(&program);
            say(&format!("{quoted}{}", line.strip_prefix("tcgs").unwrap_or(&line)))?;
        }
    }
    Ok(())
}

/// Writes everything from the results.
fn write(arguments: &Arguments, plan: &Plan, place: &Place) -> anyhow::Result<()> {
    let mut results = table::Results::new();
    for job in &plan.jobs {
        for measure in job.measures.keys() {
            if let Some(result) = place.result(job, measure)? {
                results.insert(format!("{}/{measure}", name_of(job)), result);
            }
        }
    }
    let mut shown = figure::show(plan, &results)?;
    let file = |name: &str, bytes: &[u8]| write_file(&place.out.join(name), bytes, true);
    if plan.table.plots.iter().any(|plot| plot.kind == PlotKind::Pictures) {
        let renderer = arguments.backend.open(BackendName::Auto)?.renderer();
        for (name, picture) in pictures::grids(plan, place, &*renderer)? {
            write_file(&place.out.join(name), &picture.png, true)?;
            shown.pictures.push(picture);
        }
    }
    let name = &plan.name;
    let title = format!("{} ({})", plan.table.title, plan.table.paper);
    let text = table::text(&title, &plan.table.notes, &shown.sheets);
    let json = table::json(plan, &shown.sheets, &results);
    file(&format!("{name}.txt"), text.as_bytes())?;
    file(&format!("{name}.csv"), table::csv(&shown.sheets, &results).as_bytes())?;
    file(&format!("{name}.tex"), table::tex(&title, &shown.sheets).as_bytes())?;
    file(&format!("{name}.json"), format!("{json:#}\n").as_bytes())?;
    file(&format!("{name}.html"), figure::page(plan, &shown, &results).as_bytes())?;
    for figure in &shown.figures {
        let svg = figure.svg();
        if !svg.is_empty() {
            file(&format!("{name}-{}.svg", slug(figure.title())), standalone(&svg).as_bytes())?;
        }
    }
    say(&text)?;
    note(&format!("written to {}", place.out.join(format!("{name}.html")).display()));
    arguments.job.write_json(&json)
}

/// For the name of a file.
fn slug(title: &str) -> String {
    let title = title.split(';').next().unwrap_or(title);
    let plain = title.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' });
    plain.collect::<String>().split_whitespace().collect::<Vec<_>>().join("-")
}

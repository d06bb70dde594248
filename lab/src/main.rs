//! The laboratory: experiments around the program that users do not need. The paper's tables are made here, and the
//! settings of tcgs are chosen by what is measured here.
//!
//! ```sh
//! cargo build --release                                          # the program, which runs every step
//! cargo run --release -p tcgs-lab -- ablation --data CAPTURES --out OUT
//! cargo run --release -p tcgs-lab -- captures --data CAPTURES --out OUT --short
//! cargo run --release -p tcgs-lab -- sizes --out OUT
//! ```

mod captures;
mod error;
mod program;
mod sizes;
mod tables;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// A command that runs this program, in the checkout.
const COMMAND: &str = "cargo run --release -p tcgs-lab --";

/// Make a table or figure of the paper, or another experiment
///
/// Trains, compresses and evaluates the runs that are missing in OUT, with the program tcgs, which `cargo build
/// --release` makes. Writes OUT/TABLE.txt, .csv, .tex, .json, .html and its plots, our numbers beside the paper's.
/// Finished runs are not repeated, so a stopped command continues where it was. DIR holds a folder with a capture for
/// each scene, named after it: basketball, cook_spinach, ...
///
/// --print-commands prints a command for each missing run, for GNU parallel or a batch system; then the same command
/// without it writes the table.
#[derive(Parser)]
#[command(
    name = "lab",
    bin_name = COMMAND,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    disable_help_subcommand = true,
    max_term_width = 120,
    after_help = "\
Example:
  cargo run --release -p tcgs-lab -- --list
  cargo run --release -p tcgs-lab -- ablation --data captures --out results --scenes basketball --size small
  cargo run --release -p tcgs-lab -- ablation --data captures --out results --print-commands | parallel -j 2

Exit codes: 0 all that was asked for was done, 2 wrong usage or input, 130 stopped by a signal, 1 anything else."
)]
struct Arguments {
    #[command(subcommand)]
    experiment: Option<Experiment>,
    #[command(flatten)]
    table: tables::TableArguments,
}

#[derive(Subcommand)]
enum Experiment {
    Captures(captures::Arguments),
    Sizes(sizes::Arguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let run = || match &arguments.experiment {
        Some(Experiment::Captures(arguments)) => captures::run(arguments),
        Some(Experiment::Sizes(arguments)) => sizes::run(arguments),
        None => tables::run(&arguments.table),
    };
    match program::catch_signals().and_then(|()| run()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lab: {error:#}");
            ExitCode::from(error::exit_code(&error))
        }
    }
}

/// A part of a file's name, from a title.
fn slug(title: &str) -> String {
    let plain = title.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' });
    plain.collect::<String>().split_whitespace().collect::<Vec<_>>().join("-")
}

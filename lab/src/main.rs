//! The laboratory: experiments around the program that users do not need, by which its settings are chosen.
//!
//! ```sh
//! cargo run --release -p tcgs-lab -- captures --data CAPTURES --out OUT --short
//! ```

mod captures;

use clap::Parser;

/// Experiments by which the settings of tcgs are chosen
#[derive(Parser)]
#[command(name = "lab")]
enum Arguments {
    Captures(captures::Arguments),
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse() {
        Arguments::Captures(arguments) => captures::run(&arguments),
    }
}

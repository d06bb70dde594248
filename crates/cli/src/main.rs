//! The `tcgs` command: one file or folder per subcommand, each of which parses, calls and prints.
//!
//! What lives here: arguments, progress, messages, files that appear whole. What does not: the method. `main` prints an
//! error once, as one line.

mod attribute_errors;
mod backend;
mod bench;
mod compress;
mod demo;
mod error;
mod eval;
mod export;
mod info;
mod interrupt;
mod make;
mod next;
mod options;
mod output;
mod pictures;
mod prepare;
mod progress;
mod render;
mod scene;
mod teller;
mod terminal;
mod train;
mod verify;
mod view;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use tcgs_pipeline::NewFolder;

/// Temporally compressed 3D Gaussian splatting: from synchronized videos to dynamic scenes that are small
/// enough to stream.
#[derive(Parser)]
#[command(name = "tcgs", bin_name = "tcgs", version = env!("TCGS_VERSION"), after_help = EXAMPLE, max_term_width = 120)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLE: &str = "\
Example:
  tcgs make my_videos
or step by step:
  tcgs prepare my_videos --out my_capture
  tcgs train my_capture --out my_run --preset fast
  tcgs compress my_run
  tcgs eval my_run/scene.tcgs --capture my_capture

Exit codes: 0 all that was asked for was done, 2 wrong usage or input, 130 stopped by Ctrl-C or a\n\
signal that asks for the same (SIGTERM, SIGHUP), 1 anything else.";

#[derive(Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Make(make::Arguments),
    Prepare(prepare::Arguments),
    Train(train::Arguments),
    Compress(compress::Arguments),
    Info(info::Arguments),
    Verify(verify::Arguments),
    Render(render::Arguments),
    Eval(eval::Arguments),
    Export(export::Arguments),
    View(view::Arguments),
    Bench(bench::Arguments),
}

fn main() -> ExitCode {
    quiet_device_layer();
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return explain(&error),
    };
    match interrupt::catch().and_then(|()| run(arguments.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A child process may have ended by the same signal, and its end is reported as an error here.
            let was_stopped = interrupt::asked().is_break() && error::exit_code(&error) != interrupt::EXIT_CODE;
            let error = if was_stopped { error::stopped(error::message(&error)) } else { error };
            terminal::note(&format!("tcgs: {}", one_line(&NewFolder::by_final_names(error::message(&error)))));
            ExitCode::from(error::exit_code(&error))
        }
    }
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Make(arguments) => make::run(&arguments),
        Command::Prepare(arguments) => prepare::run(&arguments),
        Command::Train(arguments) => train::run(&arguments),
        Command::Compress(arguments) => compress::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Render(arguments) => render::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::View(arguments) => view::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
    }
}

/// Parses a command of this program.
///
/// - `words`: without the program's name
fn command(words: Vec<OsString>) -> anyhow::Result<Command> {
    Ok(Arguments::try_parse_from(std::iter::once("tcgs".into()).chain(words))?.command)
}

/// Disables Mesa's Vulkan layer for device selection. Without a desktop session the layer complains on standard error
/// and has no criterion to sort by; this program sorts the devices itself.
fn quiet_device_layer() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: no other thread runs yet.
        #[allow(unsafe_code)]
        unsafe {
            std::env::set_var("NODEVICE_SELECT", "1");
        }
    }
}

/// Prints help and version unchanged, and a complaint about the command line as one line.
fn explain(error: &clap::Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            // A failed write means that the reader has gone; there is no other place to report it.
            let _ = error.print();
        }
        _ => {
            let text = error.render().to_string();
            let paragraphs: Vec<String> = text.split("\n\n").map(one_line).filter(|p| !p.is_empty()).collect();
            terminal::note(&format!("tcgs: {}", paragraphs.join("; ").trim_start_matches("error: ")));
        }
    }
    ExitCode::from(error.exit_code() as u8)
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

//! Words for the person or the program that called. All go through here, so that texts of files do not control a
//! terminal.

use std::io::{self, ErrorKind, Write};

use anyhow::Context;
use tcgs_core::printable;

/// Prints a line on standard output. A reader that has gone away has read enough.
pub fn say(text: &str) -> anyhow::Result<()> {
    match writeln!(io::stdout().lock(), "{}", printable(text)) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("writing to standard output"),
        _ => Ok(()),
    }
}

/// Prints a remark on standard error; nothing depends on its being read.
pub fn note(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(text));
}

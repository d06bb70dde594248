//! All output to the terminal. Texts of files are escaped here, so that they do not control the terminal.

use std::io::{self, ErrorKind, Write};

use anyhow::Context;
use tcgs_core::printable;

/// Prints a line on standard output. A reader that has gone away has read enough.
pub fn say(text: &str) -> anyhow::Result<()> {
    write(format!("{}\n", printable(text)).as_bytes())
}

/// Writes to standard output until the end, or until the reader closes the pipe.
pub fn write(bytes: &[u8]) -> anyhow::Result<()> {
    let mut output = io::stdout().lock();
    match output.write_all(bytes).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("writing to standard output"),
        _ => Ok(()),
    }
}

/// Prints a remark on standard error; nothing depends on its being read.
pub fn note(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(text));
}

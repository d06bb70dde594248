//! All output to the terminal. Texts from files are escaped here, so that they cannot control the terminal.

use std::io::{self, ErrorKind, Write};

use anyhow::Context;
use tcgs_core::printable;

/// Prints a line on standard output. A closed pipe is no error: the reader has read enough.
pub fn say(text: &str) -> anyhow::Result<()> {
    write(format!("{}\n", printable(text)).as_bytes())
}

/// Writes to standard output, until the end or until the reader closes the pipe.
pub fn write(bytes: &[u8]) -> anyhow::Result<()> {
    let mut output = io::stdout().lock();
    match output.write_all(bytes).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("writing to standard output"),
        _ => Ok(()),
    }
}

/// Prints a remark on standard error; errors are ignored.
pub fn note(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(text));
}

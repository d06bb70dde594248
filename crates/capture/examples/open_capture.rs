//! Opens a capture and prints its contents, the time to open it, and the memory used.
//!
//! `cargo run --release -p tcgs-capture --example open_capture -- FOLDER`

use std::time::Instant;

use tcgs_capture::{Capture, Split};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("expected the folder of a capture")?;
    let begin = Instant::now();
    let capture = Capture::open(folder.as_ref())?;
    let seconds = begin.elapsed().as_secs_f64();
    let (train, test) = (capture.cameras(Split::Train, 0, 1)?.len(), capture.cameras(Split::Test, 0, 1)?.len());
    println!("{}: {} frames, {train} training and {test} test cameras", capture.name(), capture.num_frames());
    println!("opened in {seconds:.3} s");
    // Resident memory now and at its peak, where the system says.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().filter(|line| line.starts_with("VmRSS") || line.starts_with("VmHWM")).for_each(|l| println!("{l}"));
    Ok(())
}

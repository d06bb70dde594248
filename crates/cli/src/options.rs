//! Options that several commands share, and how their values are read.

use std::convert::Infallible;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use tcgs_capture::{Capture, CaptureError, Split};
use tcgs_core::MAX_PIXELS;
use tcgs_pipeline::RefineBudget;

use crate::output;

/// Options of every long command.
#[derive(Args, Debug)]
#[command(next_help_heading = "Every command")]
pub struct JobOptions {
    /// Also write the result to this file, as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Replace outputs that exist
    #[arg(long)]
    pub force: bool,
    /// Seed of random choices; equal commands with equal seeds give equal results [default: 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Threads to compute with; results do not depend on it [default: as many as cores]
    #[arg(long, value_name = "N", value_parser = up_to::<MAX_THREADS>)]
    pub threads: Option<usize>,
}

impl JobOptions {
    /// Sets the number of threads and checks the outputs ([`output::check_files`]).
    ///
    /// - `files`: files to write besides that of `--json`
    /// - `sources`: files and folders that the command reads
    pub fn begin(&self, files: &[&Path], sources: &[&Path]) -> anyhow::Result<()> {
        // A command that runs others has started them already.
        static STARTED: AtomicBool = AtomicBool::new(false);
        if !STARTED.swap(true, Ordering::Relaxed) {
            let threads = rayon::ThreadPoolBuilder::new().num_threads(self.threads.unwrap_or(0));
            threads.build_global().context("starting threads")?;
        }
        let files: Vec<&Path> = files.iter().copied().chain(self.json.as_deref()).collect();
        output::check_files(&files, sources, self.force)
    }

    /// Writes the result as JSON if `--json` asks for it.
    pub fn write_json(&self, value: &serde_json::Value) -> anyhow::Result<()> {
        self.json.as_ref().map_or(Ok(()), |path| output::write_json(path, value, self.force))
    }
}

/// Largest number of threads: more than any machine has processors.
const MAX_THREADS: usize = 1024;

/// A whole number from 1 to `MOST`.
pub fn up_to<const MOST: usize>(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|n| (1..=MOST).contains(n));
    number.ok_or_else(|| format!("expected a whole number from 1 to {MOST}"))
}

/// A whole number, 1 or more.
pub fn positive(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&n| n > 0).ok_or_else(|| "expected a whole number of 1 or more".into())
}

/// Seconds, 0 or more.
pub fn seconds(text: &str) -> Result<f64, String> {
    let secs = text.parse().ok().filter(|secs: &f64| secs.is_finite() && *secs >= 0.0);
    secs.ok_or_else(|| "expected seconds, 0 or more".into())
}

/// A rate per second, above 0.
pub fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate: &f64| rate.is_finite() && *rate > 0.0);
    rate.ok_or_else(|| "expected a number above 0".into())
}

/// Bytes: a number, or one with a unit.
pub fn size(text: &str) -> Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = text[digits.len()..].to_ascii_lowercase();
    let factor: Option<f64> = match &*unit {
        "" | "b" => Some(1.0),
        "k" | "kb" => Some(1e3),
        "m" | "mb" => Some(1e6),
        "g" | "gb" => Some(1e9),
        "kib" => Some(1024.0),
        "mib" => Some(f64::from(1 << 20)),
        "gib" => Some(f64::from(1 << 30)),
        _ => None,
    };
    let bytes = digits.parse().ok().zip(factor).map(|(number, factor): (f64, f64)| (number * factor).floor());
    bytes
        .filter(|bytes| (1.0..1e18).contains(bytes))
        .map(|bytes| bytes as u64)
        .ok_or_else(|| "expected bytes, such as 500000, 500k, 2MB (units of 1000) or 2MiB (units of 1024)".into())
}

/// Whether and how long to refine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refining {
    Off,
    For(RefineBudget),
}

/// Parses `off`, a time with a unit, or a number of iterations.
pub fn refining(text: &str) -> Result<Refining, String> {
    if text == "off" { Ok(Refining::Off) } else { refine_budget(text).map(Refining::For) }
}

fn refine_budget(text: &str) -> Result<RefineBudget, String> {
    let count = text.parse().ok().filter(|&count: &usize| count > 0).map(RefineBudget::Iterations);
    count.or_else(|| time_of(text).map(RefineBudget::Time)).ok_or_else(|| EXPECTED_BUDGET.into())
}

/// A time with its unit.
pub fn time(text: &str) -> Result<Duration, String> {
    time_of(text).ok_or_else(|| "expected a time with its unit, such as 90s, 20m or 2h".into())
}

fn time_of(text: &str) -> Option<Duration> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[digits.len()..] {
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    };
    let number = digits.parse().ok().filter(|number: &f64| *number > 0.0 && *number * unit < 1e7)?;
    Some(Duration::from_secs_f64(number * unit))
}

const EXPECTED_BUDGET: &str = "expected off, a time, such as 90s, 5m or 1h, or a number of iterations";

/// Frames `A..B`, half-open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames(pub Range<usize>);

impl FromStr for Frames {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let range = text.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
        let range = range.filter(|range: &Range<usize>| range.start < range.end);
        range.map(Self).ok_or_else(|| "expected A..B with A below B, such as 0..20; B is the first left out".into())
    }
}

/// Two values, separated by a comma.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair<T>(pub T, pub T);

/// Iterations of the first and of every later timestep.
pub fn iterations(text: &str) -> Result<Pair<usize>, String> {
    let pair = text.split_once(',').and_then(|(a, b)| Some(Pair(positive(a).ok()?, positive(b).ok()?)));
    pair.ok_or_else(|| "expected FIRST,REST, such as 2000,300".into())
}

/// Least and largest bit width.
pub fn bits(text: &str) -> Result<Pair<u8>, String> {
    let pair = text.split_once(',').and_then(|(a, b)| Some(Pair(a.parse().ok()?, b.parse().ok()?)));
    pair.filter(|&Pair(min, max)| 1 <= min && min <= max && max <= tcgs_codec::MAX_BITS)
        .ok_or_else(|| "expected MIN,MAX with 1 <= MIN <= MAX <= 16, such as 4,8".into())
}

/// Size of an image, `WxH` pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Size {
    /// Whether an image may have this size. A larger one is taken for a typing error.
    pub fn is_legal(self) -> bool {
        let is_side = |side: &usize| (1..=16384).contains(side);
        [self.width, self.height].iter().all(is_side) && self.width * self.height <= MAX_PIXELS
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse().ok();
        let size = text.split_once('x').and_then(|(w, h)| Some(Self { width: side(w)?, height: side(h)? }));
        size.filter(|size| size.is_legal()).ok_or_else(|| {
            format!("expected WIDTHxHEIGHT of 1 to 16384 pixels each, {MAX_PIXELS} at most, such as 640x360")
        })
    }
}

/// Cameras of a capture.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Cameras {
    /// Cameras held out from training
    Test,
    /// Cameras trained on
    Train,
    /// Both
    All,
}

impl Cameras {
    /// The corresponding split of a capture.
    pub fn split(self) -> Split {
        match self {
            Self::Test => Split::Test,
            Self::Train => Split::Train,
            Self::All => Split::All,
        }
    }
}

/// Cameras of a capture: one of its splits, or some by their names or ids.
#[derive(Clone, PartialEq, Eq)]
pub enum CameraChoice {
    /// One of the capture's splits.
    Split(Split),
    /// Names or ids.
    Named(Vec<String>),
}

impl FromStr for CameraChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match Cameras::from_str(text, false) {
            Ok(cameras) => Self::Split(cameras.split()),
            Err(_) => Self::Named(text.split(',').map(|name| name.trim().to_owned()).collect()),
        })
    }
}

impl CameraChoice {
    /// The split that holds these cameras, and the capture with that split.
    ///
    /// # Errors
    /// [`CaptureError::Invalid`] if no camera has one of the names.
    pub fn choose(&self, capture: Capture) -> Result<(Capture, Split), CaptureError> {
        match self {
            Self::Split(split) => Ok((capture, *split)),
            Self::Named(names) => Ok((capture.with_test_cameras(names)?, Split::Test)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_or_refused() {
        assert_eq!("3..10".parse(), Ok(Frames(3..10)));
        for text in ["", "3", "3..", "..3", "5..5", "9..3", "-1..3", "a..b", "0..1..2"] {
            assert!(text.parse::<Frames>().is_err(), "{text}");
        }
        assert_eq!(bits("4,8"), Ok(Pair(4, 8)));
        assert_eq!(bits("6,6"), Ok(Pair(6, 6)));
        for text in ["4", "8,4", "0,4", "4,17", "4,8,9"] {
            assert!(bits(text).is_err(), "{text}");
        }
        assert_eq!(iterations("30,10"), Ok(Pair(30, 10)));
        assert!(["0,10", "10", "10,x"].iter().all(|text| iterations(text).is_err()));
        let sizes = [("500000", 500_000), ("500k", 500_000), ("2MB", 2_000_000), ("1.5kib", 1536), ("0.5 G", 0)];
        for (text, bytes) in sizes {
            assert_eq!(size(text).ok(), (bytes > 0).then_some(bytes), "{text}");
        }
        assert!(["", "0", "-3", "MB", "2TB", "nan", "inf", "1e300", "2 MB"].iter().all(|text| size(text).is_err()));
        assert_eq!("8192x8192".parse(), Ok(Size { width: 8192, height: 8192 }));
        assert_eq!("640x360".parse(), Ok(Size { width: 640, height: 360 }));
        assert!(["640", "0x4", "4x-4", "99999x4", "16384x16384"].iter().all(|text| text.parse::<Size>().is_err()));
    }
}

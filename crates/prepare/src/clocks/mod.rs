//! The moment of one event on the clock of each camera: from sound, from motion, from a file, or assumed.
//!
//! What lives here: the result, and the file that states it by hand. `sound` and `motion` measure it. What does not:
//! its use for a capture (`raw`).

mod motion;
mod sound;

use std::path::Path;

use tcgs_capture::{Recording, files};

use crate::PrepareError;

/// The clocks of the cameras of one scene against each other.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Clocks {
    /// How they were found.
    pub from: ClocksFrom,
    /// The moment of one and the same event in each recording, seconds by its presentation times.
    pub event_secs: Vec<f64>,
    /// Certainty of motion, where motion was tried. With [`ClocksFrom::Assumed`] it is too low to be used.
    pub evidence: Option<ClockEvidence>,
}

/// Certainty of clocks by motion: the numbers of the least certain camera.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ClockEvidence {
    /// Share of the pairs with another camera whose own offset agrees with the joint one, `[0, 1]`.
    pub agreeing: f64,
    /// Correlation with all others together, over that of the next best offset.
    pub prominence: f64,
}

impl ClockEvidence {
    /// Least [`Self::agreeing`] at which clocks are taken.
    pub const MIN_AGREEING: f64 = 0.5;
    /// [`Self::prominence`] above which clocks are taken. Scenes whose pairs give wrong offsets reach 1.2; scenes whose
    /// pairs give the right ones start at 1.8.
    pub const MIN_PROMINENCE: f64 = 1.4;

    /// Whether the clocks are certain enough to be taken.
    pub fn is_sure(self) -> bool {
        self.agreeing >= Self::MIN_AGREEING && self.prominence > Self::MIN_PROMINENCE
    }
}

/// How clocks were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClocksFrom {
    /// By cross-correlation of the sound.
    Sound,
    /// By cross-correlation of motion and brightness over time.
    Motion,
    /// From a file.
    File,
    /// Nothing was found: all recordings are taken to begin at the same moment.
    Assumed,
}

impl ClocksFrom {
    /// The word in `capture.toml`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sound => "sound",
            Self::Motion => "motion",
            Self::File => "file",
            Self::Assumed => "assumed",
        }
    }
}

impl Clocks {
    /// All recordings begin at the same moment.
    pub fn assumed(num_cameras: usize) -> Self {
        Self { from: ClocksFrom::Assumed, event_secs: vec![0.0; num_cameras], evidence: None }
    }

    /// Reads the moment of one event in each recording: a line for each, `NAME SECONDS`; `#` begins a comment.
    ///
    /// - `names`: of the cameras
    ///
    /// # Errors
    /// [`PrepareError`] that names the line, or the camera without a line.
    pub fn read(path: &Path, names: &[String]) -> Result<Self, PrepareError> {
        let text = files::text(path)?;
        let event_secs = parse(&text, names).map_err(|problem| PrepareError::invalid(path, problem))?;
        Ok(Self { from: ClocksFrom::File, event_secs, evidence: None })
    }
}

/// Finds the clocks of recordings against each other: by sound, else by motion, else assumed.
///
/// - `report`: called with the share of the work that is done, in `[0, 1]`, by any thread
pub(crate) fn measure(recordings: &[Recording], report: &(dyn Fn(f64) + Sync)) -> Result<Clocks, PrepareError> {
    // Image files have no clock, and folders of them are by custom exported together.
    if recordings.iter().all(Recording::is_images) {
        return Ok(Clocks::assumed(recordings.len()));
    }
    let paths: Vec<&Path> = recordings.iter().map(|recording| recording.path.as_path()).collect();
    if let Some(event_secs) = sound::event_secs(&paths) {
        report(1.0);
        return Ok(Clocks { from: ClocksFrom::Sound, event_secs, evidence: None });
    }
    Ok(match motion::event_secs(recordings, report)? {
        Some((event_secs, evidence)) if evidence.is_sure() => {
            Clocks { from: ClocksFrom::Motion, event_secs, evidence: Some(evidence) }
        }
        unsure => Clocks { evidence: unsure.map(|(_, evidence)| evidence), ..Clocks::assumed(recordings.len()) },
    })
}

fn parse(text: &str, names: &[String]) -> Result<Vec<f64>, String> {
    let mut found: Vec<Option<f64>> = vec![None; names.len()];
    for (i, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let problem = |problem: String| format!("line {}: {problem}", i + 1);
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[name, secs] = words.as_slice() else {
            return Err(problem(format!("is {line:?}, expected the name of a camera and seconds")));
        };
        let camera = names.iter().position(|known| known == name);
        let camera = camera.ok_or_else(|| problem(format!("found {name}, expected one of {}", names.join(", "))))?;
        let secs: Option<f64> = secs.parse().ok().filter(|secs: &f64| secs.is_finite());
        let secs = secs.ok_or_else(|| problem(format!("found {:?}, expected seconds", words[1])))?;
        if found[camera].replace(secs).is_some() {
            return Err(problem(format!("names {name} again, expected one line for each camera")));
        }
    }
    let lacks = |i: usize| format!("has no line for {}, expected one for each camera", names[i]);
    found.into_iter().enumerate().map(|(i, secs)| secs.ok_or_else(|| lacks(i))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_events_has_a_line_for_each_camera() {
        let names = ["a", "b"].map(String::from);
        assert_eq!(parse("# clap\nb 1.5\n\na -0.25 # early\n", &names), Ok(vec![-0.25, 1.5]));
        let problem = |text: &str| parse(text, &names).unwrap_err();
        assert_eq!(problem("a 1"), "has no line for b, expected one for each camera");
        assert_eq!(problem("a 1\nc 2"), "line 2: found c, expected one of a, b");
        assert_eq!(problem("a 1\na 2"), "line 2: names a again, expected one line for each camera");
        assert_eq!(problem("a one"), "line 1: found \"one\", expected seconds");
        assert!(problem("a 1 2").starts_with("line 1: is \"a 1 2\""));
    }
}

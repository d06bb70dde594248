//! `capture.toml`: a capture as a text that a person can read and mend. `docs/CAPTURE.md` defines it.
//!
//! What lives here: the text, both ways, and the checks of its values that need no other file. What does not: opening
//! the files that it names (`kinds/described.rs`), and finding its values (`raw`).

use std::fmt::Write as _;
use std::path::Path;

use serde::Deserialize;

use crate::{CaptureError, files};

/// File name of a capture's description.
pub const DESCRIPTION_FILE: &str = "capture.toml";

/// The version that this program writes, and the only one that it reads.
const VERSION: u32 = 1;

/// Most frames of a capture: 19 hours at 30 a second.
const MAX_FRAMES: usize = 1 << 21;

/// The content of `capture.toml`.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CaptureDescription {
    /// 1
    pub version: u32,
    /// Frames per second of the capture's clock, greater than 0.
    pub frame_rate: f64,
    /// Number of frames, at least 1.
    pub num_frames: usize,
    /// Whether lengths are in metres.
    #[serde(default)]
    pub in_metres: bool,
    /// Source of the cameras' intrinsics and poses.
    #[serde(default)]
    pub calibration: Option<CalibrationSource>,
    /// How the clocks of the cameras were found.
    #[serde(default)]
    pub clock: Option<ClockSource>,
    /// Whether gains and offsets are used, and how they were found.
    #[serde(default)]
    pub colors: Option<ColorSource>,
    /// The cameras, in the capture's order.
    #[serde(rename = "camera")]
    pub cameras: Vec<DescribedCamera>,
}

/// Source of a capture's calibration. For people: nothing is computed from it.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct CalibrationSource {
    /// Name of the file, which lies beside the description.
    pub file: String,
    /// Name of its format.
    pub format: String,
    /// Changes made while reading the calibration, a sentence each.
    #[serde(default)]
    pub changes: Vec<String>,
}

/// How the clocks of a capture were found. For people: nothing is computed from it.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct ClockSource {
    /// `sound`, `motion`, `file`, or `assumed`.
    pub from: String,
}

/// Differences in colour between the cameras: how they were found, and whether they are corrected.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ColorSource {
    /// Whether the cameras' gains and offsets are used; without this table they are.
    #[serde(default = "yes")]
    pub used: bool,
    /// How they were found, a sentence each. For people: nothing is computed from it.
    #[serde(default)]
    pub found: Vec<String>,
}

impl Default for ColorSource {
    fn default() -> Self {
        Self { used: true, found: Vec::new() }
    }
}

/// The camera's split: training or test.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// For training.
    #[default]
    Train,
    /// Held out for evaluation.
    Test,
}

/// One camera of a description.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct DescribedCamera {
    /// Number by which messages and results name the camera.
    pub id: usize,
    /// Name for people.
    pub name: String,
    /// Path of the video or of the folder of images, relative to the description.
    pub file: String,
    /// Whether the camera is held out.
    #[serde(default)]
    pub role: Role,
    /// The time in the file at which the capture begins, seconds by the file's presentation times.
    #[serde(default)]
    pub start_secs: f64,
    /// Frames per second of a folder of images; a video has its own.
    #[serde(default)]
    pub images_per_sec: Option<f64>,
    /// Clockwise turn of the stored image, degrees: 0, 90, 180 or 270.
    #[serde(default)]
    pub turn_degrees: u16,
    /// `left, top, width, height` in pixels of the used part of the turned image; by default all of it.
    #[serde(default)]
    pub crop: Option<[usize; 4]>,
    /// Factors of red, green and blue.
    #[serde(default = "no_gains")]
    pub gains: [f32; 3],
    /// Added to red, green and blue after the gains, of values in `[0, 1]`.
    #[serde(default)]
    pub offsets: [f32; 3],
    /// Width and height in pixels of the image, turned and cropped.
    pub size: [usize; 2],
    /// Focal lengths `fx, fy`, pixels.
    pub focal: [f64; 2],
    /// Principal point `cx, cy`, pixels of the turned and cropped image; pixel centres at +0.5.
    pub principal: [f64; 2],
    /// `k1, k2, p1, p2, k3, k4, k5, k6` of OpenCV's model; a shorter list stands for zeros.
    #[serde(default)]
    pub distortion: Vec<f64>,
    /// `[3][4]` row-major, camera axes x right, y down, z forward.
    pub camera_from_world: [[f64; 4]; 3],
    /// Median reprojection error of the places that the camera sees, pixels. For people: nothing is computed from it.
    #[serde(default)]
    pub error_px: Option<f64>,
}

fn no_gains() -> [f32; 3] {
    [1.0; 3]
}

fn yes() -> bool {
    true
}

impl CaptureDescription {
    /// An empty description: no cameras yet.
    ///
    /// - `frame_rate`: frames per second of the capture's clock
    /// - `num_frames`: number of frames
    pub fn new(frame_rate: f64, num_frames: usize) -> Self {
        let (calibration, clock, colors, cameras) = (None, None, None, Vec::new());
        Self { version: VERSION, frame_rate, num_frames, in_metres: false, calibration, clock, colors, cameras }
    }

    /// Reads a description.
    ///
    /// - `path`: the file, by custom [`DESCRIPTION_FILE`]
    ///
    /// # Errors
    /// [`CaptureError`] that names the line or the camera.
    pub fn read(path: &Path) -> Result<Self, CaptureError> {
        let text = files::text(path)?;
        Self::parse(&text).map_err(|problem| CaptureError::invalid(path, problem))
    }

    fn parse(text: &str) -> Result<Self, String> {
        let parsed: Self = toml::from_str(text).map_err(|error| {
            let begin = error.span().map_or(0, |span| span.start).min(text.len());
            let line = 1 + text.as_bytes()[..begin].iter().filter(|&&byte| byte == b'\n').count();
            let message = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
            format!("line {line}: {message}")
        })?;
        parsed.check()?;
        Ok(parsed)
    }

    fn check(&self) -> Result<(), String> {
        if self.version != VERSION {
            return Err(format!("has the version {}, expected {VERSION}", self.version));
        }
        if self.num_frames == 0 {
            return Err("num_frames is 0, expected at least 1".into());
        }
        if self.num_frames > MAX_FRAMES {
            return Err(format!("num_frames is {}, expected at most {MAX_FRAMES}", self.num_frames));
        }
        if self.cameras.is_empty() {
            return Err("has no [[camera]], expected at least one".into());
        }
        for (i, camera) in self.cameras.iter().enumerate() {
            let name = &camera.name;
            if self.cameras[..i].iter().any(|other| other.id == camera.id) {
                return Err(format!("camera {name}: has the id {} of another camera, expected its own", camera.id));
            }
            camera.check().map_err(|problem| format!("camera {name}: {problem}"))?;
        }
        if self.cameras.iter().all(|camera| camera.role == Role::Test) {
            return Err("has cameras of the role test alone, expected some for training".into());
        }
        Ok(())
    }

    /// The text of the file. Reading it gives an equal description.
    pub fn to_toml(&self) -> String {
        let mut text = String::from(
            "# A capture, as `tcgs prepare` found it. Any line may be changed by hand; docs/CAPTURE.md explains them.\n",
        );
        // Writing to a string does not fail.
        let _ = writeln!(text, "version = {}\nframe_rate = {:?}", self.version, self.frame_rate);
        let _ = writeln!(text, "num_frames = {}\nin_metres = {}", self.num_frames, self.in_metres);
        if let Some(source) = &self.calibration {
            let _ = writeln!(text, "\n[calibration]  # where the cameras come from; nothing is computed from this");
            let _ = writeln!(text, "file = {}\nformat = {}", quoted(&source.file), quoted(&source.format));
            let _ = writeln!(text, "changes = {}", listed(&source.changes));
        }
        if let Some(source) = &self.clock {
            let _ = writeln!(text, "\n[clock]  # how start_secs was found; nothing is computed from this");
            let _ = writeln!(text, "from = {}", quoted(&source.from));
        }
        if let Some(colors) = &self.colors {
            let _ = writeln!(text, "\n[colors]  # differences in exposure and white balance between the cameras");
            let _ = writeln!(text, "used = {}  # whether gains and offsets below are used", colors.used);
            let _ = writeln!(text, "found = {}", listed(&colors.found));
        }
        for camera in &self.cameras {
            camera.append_to(&mut text);
        }
        text
    }
}

impl DescribedCamera {
    fn check(&self) -> Result<(), String> {
        if ![0, 90, 180, 270].contains(&self.turn_degrees) {
            return Err(format!("turn_degrees is {}, expected 0, 90, 180 or 270", self.turn_degrees));
        }
        if !self.start_secs.is_finite() {
            return Err(format!("start_secs is {}, expected a finite number", self.start_secs));
        }
        if let Some(rate) = self.images_per_sec.filter(|rate| !(rate.is_finite() && *rate > 0.0)) {
            return Err(format!("images_per_sec is {rate}, expected more than 0"));
        }
        if let Some(gain) = self.gains.iter().find(|gain| !(gain.is_finite() && **gain > 0.0)) {
            return Err(format!("gains has {gain}, expected numbers above 0"));
        }
        if let Some(offset) = self.offsets.iter().find(|offset| !(-1.0..=1.0).contains(*offset)) {
            return Err(format!("offsets has {offset}, expected numbers from -1 to 1"));
        }
        if self.focal.iter().any(|f| !(f.is_finite() && *f > 0.0)) {
            return Err(format!("focal is {:?}, expected numbers above 0", self.focal));
        }
        let numbers = self.principal.iter().chain(&self.distortion);
        if let Some(number) = numbers.into_iter().find(|x| !x.is_finite()) {
            return Err(format!("has the number {number}, expected finite ones"));
        }
        if self.distortion.len() > 8 {
            return Err(format!("distortion has {} numbers, expected at most 8", self.distortion.len()));
        }
        Ok(())
    }

    fn append_to(&self, text: &mut String) {
        let role = if self.role == Role::Test { "test" } else { "train" };
        let _ = writeln!(text, "\n[[camera]]\nid = {}\nname = {}", self.id, quoted(&self.name));
        let _ = writeln!(text, "file = {}\nrole = \"{role}\"", quoted(&self.file));
        let _ =
            writeln!(text, "start_secs = {:?}  # the time in the file at which the capture begins", self.start_secs);
        if let Some(rate) = self.images_per_sec {
            let _ = writeln!(text, "images_per_sec = {rate:?}");
        }
        let _ = writeln!(text, "turn_degrees = {}  # clockwise", self.turn_degrees);
        if let Some(crop) = self.crop {
            let _ = writeln!(text, "crop = {crop:?}  # left, top, width, height");
        }
        let _ = writeln!(text, "gains = {:?}  # of red, green and blue", self.gains);
        if self.offsets != [0.0; 3] {
            let _ = writeln!(text, "offsets = {:?}  # added to red, green and blue", self.offsets);
        }
        let _ = writeln!(text, "size = {:?}", self.size);
        let _ = writeln!(text, "focal = {:?}\nprincipal = {:?}", self.focal, self.principal);
        let _ = writeln!(text, "distortion = {:?}  # k1 k2 p1 p2 k3 k4 k5 k6", self.distortion);
        let rows: String = self.camera_from_world.iter().map(|row| format!("    {row:?},\n")).collect();
        let _ = writeln!(text, "camera_from_world = [\n{rows}]");
        if let Some(error) = self.error_px {
            let _ = writeln!(text, "error_px = {error:?}  # median; nothing is computed from this");
        }
    }
}

/// Sentences as TOML has them, one a line.
fn listed(sentences: &[String]) -> String {
    let lines: String = sentences.iter().map(|sentence| format!("\n    {},", quoted(sentence))).collect();
    if lines.is_empty() { "[]".into() } else { format!("[{lines}\n]") }
}

/// A text as TOML has it.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> CaptureDescription {
        let camera = DescribedCamera {
            id: 3,
            name: "left \"eye\"".into(),
            file: "cam\\03.mp4".into(),
            role: Role::Test,
            start_secs: 1.0 / 3.0,
            images_per_sec: Some(25.0),
            turn_degrees: 270,
            crop: Some([0, 7, 1080, 1906]),
            gains: [1.0, 0.9, 1.1],
            offsets: [0.0, -0.02, 0.015],
            size: [1080, 1906],
            focal: [1e3, 1e-7 + 1000.0],
            principal: [540.0, 953.25],
            distortion: vec![0.1, -0.2, 1e-9, 0.0, 0.3],
            camera_from_world: [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, -1e-12], [0.0, 0.0, 1.0, 3e20]],
            error_px: Some(0.25),
        };
        let mut other = camera.clone();
        (other.id, other.role, other.crop, other.images_per_sec) = (4, Role::Train, None, None);
        (other.error_px, other.offsets) = (None, [0.0; 3]);
        let mut description = CaptureDescription::new(59.94, 100);
        let changes = vec!["scaled".into(), "turned\tround".into()];
        description.calibration =
            Some(CalibrationSource { file: "a.qca.txt".into(), format: "qualisys".into(), changes });
        description.clock = Some(ClockSource { from: "sound".into() });
        description.colors = Some(ColorSource { used: false, found: vec!["a \"warm\" camera".into()] });
        description.cameras = vec![camera, other];
        description
    }

    #[test]
    fn a_description_comes_back_from_its_text() {
        let description = example();
        assert_eq!(CaptureDescription::parse(&description.to_toml()), Ok(description));
    }

    #[test]
    fn wrong_lines_are_named() {
        let text = example().to_toml();
        let problem = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            CaptureDescription::parse(&text.replacen(from, to, 1)).unwrap_err()
        };
        assert!(problem("num_frames = 100", "num_frames = many").starts_with("line 4: "));
        assert!(problem("version = 1", "version = 1\nspeed = 3").contains("unknown field `speed`"));
        assert_eq!(problem("version = 1", "version = 2"), "has the version 2, expected 1");
        assert_eq!(problem("num_frames = 100", "num_frames = 0"), "num_frames is 0, expected at least 1");
        let degrees = problem("turn_degrees = 270", "turn_degrees = 45");
        assert_eq!(degrees, "camera left \"eye\": turn_degrees is 45, expected 0, 90, 180 or 270");
        assert!(problem("id = 4", "id = 3").contains("has the id 3 of another camera"));
        assert!(problem("start_secs = 0.", "start_secs = nan # ").contains("start_secs is NaN"));
        assert!(problem("role = \"train\"", "role = \"test\"").contains("of the role test alone"));
        assert!(problem("gains = [1.0", "gains = [-1.0").contains("gains has -1"));
        assert!(problem("offsets = [0.0", "offsets = [7.0").contains("offsets has 7, expected numbers from -1 to 1"));
    }
}

//! The steps of `tcgs prepare` in words.

use tcgs_capture::{CaptureDescription, Origin, Prepared, Role};
use tcgs_pipeline::{PrepareStep, Work};
use tcgs_prepare::{ClockEvidence, Clocks, ClocksFrom, PlacedCameras, RawCamera};

use super::Arguments;

/// The words of one run of the command.
pub struct Words {
    /// Whether the source is a folder of videos.
    pub is_footage: bool,
    has_offsets: bool,
    refines: bool,
    has_calibration: bool,
}

impl Words {
    pub fn new(arguments: &Arguments, is_footage: bool) -> Self {
        let (has_offsets, refines) = (arguments.offsets.is_some(), arguments.refine_calibration);
        Self { is_footage, has_offsets, refines, has_calibration: false }
    }

    /// The lines about each result of a step.
    pub fn of(&mut self, step: &PrepareStep) -> Vec<String> {
        match step {
            PrepareStep::Planned(work) => self.planned(*work).into_iter().map(Into::into).collect(),
            PrepareStep::Reused(file) => vec![format!("cameras and clocks: as {} says", file.display())],
            PrepareStep::PointsIgnored => vec!["the points that the source has are not used".into()],
            PrepareStep::Recordings(cameras) => recordings_in_words(cameras),
            PrepareStep::Placed(Some(placed)) => {
                self.has_calibration = true;
                calibration_in_words(placed)
            }
            PrepareStep::Placed(None) => vec!["calibration: none, so colmap is to find the cameras".into()],
            PrepareStep::Clocks { clocks, description } => clocks_in_words(clocks, description),
            PrepareStep::SamePose(names) => {
                let names = names.join(", ");
                vec![format!("  {names} have one pose: the same place and the same direction; is one a copy?")]
            }
            PrepareStep::CamerasFound(how) => vec![format!("cameras: {how}")],
            PrepareStep::Refined(lines) => lines.iter().map(|line| format!("  {line}")).collect(),
            PrepareStep::Scaled(line) => vec![format!("  {line}")],
            PrepareStep::ColorsCompared(lines) => lines.to_vec(),
            PrepareStep::MasksKept => vec!["masks: taken as the capture has them".into()],
            PrepareStep::NoMasks { name, problem } => vec![format!("masks: none are made; {name}: {problem}")],
            PrepareStep::Masks { num_masks, share, secs } => {
                vec![format!("masks: {num_masks}, {:.1} % of the pixels move; {secs:.1} s", 100.0 * share)]
            }
            PrepareStep::PointsKept => vec!["points: the capture has some already".into()],
            PrepareStep::Points { prepared, secs } => vec![points_in_words(prepared, *secs)],
            PrepareStep::PointsStrewn { prepared, why } => vec![format!(
                "{} points, strewn where the cameras agree in colour: {why}; views between the cameras will be poor, and \
                 `tcgs prepare --check` looks for a wrong calibration",
                prepared.cloud.points.len()
            )],
            _ => Vec::new(),
        }
    }

    /// The lines about work that a dry run leaves out.
    fn planned(&self, work: Work) -> Vec<&'static str> {
        match work {
            Work::MeasuringClocks => {
                let mut lines = vec![match self.has_offsets {
                    true => "clocks: would be read from --offsets",
                    false => "clocks: would be measured by sound, else by motion",
                }];
                if self.has_calibration && !self.refines {
                    lines.push("calibration: would be taken as it is");
                }
                lines
            }
            Work::FindingCameras => vec!["cameras: would be found by colmap"],
            Work::RefiningCameras => vec!["calibration: would be refined, where that makes it better"],
            Work::ComparingColors => {
                vec!["colours: would be compared, and evened out where that makes them more alike"]
            }
            Work::Masking => vec!["masks: would be made"],
            Work::MakingPoints if self.is_footage => vec!["points: would be made"],
            Work::MakingPoints => vec!["points: would be made; cameras and clocks are taken as the capture has them"],
            Work::Checking => vec!["check: would be made, with a page"],
            _ => Vec::new(),
        }
    }
}

fn recordings_in_words(cameras: &[RawCamera]) -> Vec<String> {
    let mut lines = vec![format!("recordings: {} cameras", cameras.len())];
    for camera in cameras {
        let (width, height) = camera.size;
        let rate = match camera.frame_rate {
            Some(rate) if camera.is_variable => format!("about {rate:.2} frames a second, unevenly"),
            Some(rate) => format!("{rate:.2} frames a second"),
            None => "one frame".into(),
        };
        let turned = match camera.turn_degrees {
            0 => String::new(),
            degrees => format!(", turned by {degrees} degrees"),
        };
        lines.push(format!(
            "  {}: {}, {width}x{height}{turned}, {} frames, {rate}",
            camera.name, camera.codec, camera.num_frames
        ));
    }
    lines
}

fn calibration_in_words(placed: &PlacedCameras) -> Vec<String> {
    let source = &placed.source;
    let mut lines = vec![format!("calibration: {} ({}), {} cameras", source.file, source.format, placed.num_cameras())];
    lines.extend(source.changes.iter().map(|change| format!("  {change}")));
    lines
}

fn clocks_in_words(clocks: &Clocks, description: &CaptureDescription) -> Vec<String> {
    let how = match clocks.from {
        ClocksFrom::Sound => "clocks: by sound".into(),
        ClocksFrom::Motion => {
            format!("clocks: by motion, which is sure{}", clocks.evidence.map_or(String::new(), sureness))
        }
        ClocksFrom::File => "clocks: as --offsets says".into(),
        ClocksFrom::Assumed => {
            let tells = match clocks.evidence {
                Some(evidence) => format!("motion is too unsure to change anything{}", sureness(evidence)),
                None => "neither sound nor motion tells".into(),
            };
            format!("clocks: {tells}; all recordings are taken to begin at once (--offsets FILE says otherwise)")
        }
    };
    let cameras = &description.cameras;
    let skips: Vec<String> =
        cameras.iter().map(|camera| format!("{} {:.3} s", camera.name, camera.start_secs)).collect();
    let num_test = cameras.iter().filter(|camera| camera.role == Role::Test).count();
    vec![
        format!("{how}, each camera skips {}", skips.join(", ")),
        format!(
            "capture: {} frames at {:.2} a second, {} cameras for training, {num_test} held out",
            description.num_frames,
            description.frame_rate,
            cameras.len() - num_test
        ),
    ]
}

/// The evidence for clocks from motion, in brackets.
fn sureness(evidence: ClockEvidence) -> String {
    let ClockEvidence { agreeing, prominence, .. } = evidence;
    format!(
        " (of each camera {:.0} % of the pairs or more tell the same alone, expected {:.0} %; all together by {:.1} times \
         or more as loud as anything else, expected {:.1})",
        100.0 * agreeing,
        100.0 * ClockEvidence::MIN_AGREEING,
        prominence.min(99.0),
        ClockEvidence::MIN_PROMINENCE
    )
}

fn points_in_words(prepared: &Prepared, seconds: f64) -> String {
    let parts = [
        (Origin::Triangulated, "triangulated"),
        (Origin::Hull, "on the visual hull"),
        (Origin::Filled, "between them"),
        (Origin::Shell, "on a shell around"),
    ];
    let parts: Vec<String> = parts
        .into_iter()
        .map(|(origin, name)| (prepared.count(origin), name))
        .filter(|&(count, _)| count > 0)
        .map(|(count, name)| format!("{count} {name}"))
        .collect();
    let foreground = prepared.cloud.foreground.iter().filter(|&&foreground| foreground).count();
    let points = prepared.cloud.points.len();
    format!("{points} points, {foreground} of them foreground: {}; {seconds:.1} s", parts.join(", "))
}

//! `tcgs prepare` on a folder of videos: finds cameras and clocks, then makes masks and points.
//!
//! What lives here: the order of the steps, their messages, and the test whether the output already holds their result.
//! What does not: the steps themselves (`tcgs_prepare`).

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use anyhow::Context;
use serde_json::{Value, json};
use tcgs_capture::{Calibration, Capture, CaptureDescription, DESCRIPTION_FILE, POINTS_FILE, Role};
use tcgs_prepare::{
    ClockEvidence, Clocks, ClocksFrom, ColorBalance, DescribeSettings, PlacedCameras, RawCamera, RawFootage,
    Refinement, has_colmap,
};

use super::{Arguments, MODEL, RECORD, begin_capture, cameras, check, colors, link, masks, no_videos, points};
use crate::error::wrong_input;
use crate::next;
use crate::output::{write_file, write_json};
use crate::progress::Progress;
use crate::terminal::say;

/// Least number of cameras for a depth that another camera confirms.
const MIN_CAMERAS: usize = 3;

/// Results of the steps before masks and points.
struct Described {
    description: CaptureDescription,
    /// Outcome of the refinement, if requested.
    refinement: Option<Refinement>,
    /// Outcome of the colour balance, if requested.
    balance: Option<ColorBalance>,
}

/// Runs the steps.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let Some(out) = arguments.out.as_deref() else {
        let problem = "is a folder of videos, expected --out CAPTURE: its points need cameras and clocks";
        return Err(wrong_input(format!("{}: {problem}", arguments.source.display())));
    };
    let Described { description, refinement, balance } = match found_description(out, arguments)? {
        Some(description) => {
            say(&format!("cameras and clocks: as {} says", out.join(DESCRIPTION_FILE).display()))?;
            Described { description, refinement: None, balance: None }
        }
        None => match describe(arguments, out)? {
            Some(described) => described,
            None => return Ok(()), // a dry run
        },
    };
    let mut result = json!({
        "source": arguments.source.display().to_string(),
        "out": out.display().to_string(),
        "cameras": description.cameras.iter().map(camera_json).collect::<Vec<_>>(),
        "num_frames": description.num_frames,
        "frame_rate": description.frame_rate,
        "calibration": description.calibration.as_ref().map(|source| json!({
            "file": source.file, "format": source.format, "changes": source.changes,
        })),
        "refinement": refinement.map(|refinement| cameras::refinement_json(&refinement, &description)),
        "colors": balance.map(|balance| colors::balance_json(&balance, &description)),
        "clock": description.clock.as_ref().map(|clock| &clock.from),
    });
    let mut capture = Capture::open_unseen(out)?;
    if capture.has_segmentation() {
        say("masks: taken as the capture has them")?;
    } else if arguments.masks.are_wanted(&capture)? {
        if arguments.dry_run {
            say(masks::WOULD)?;
        } else {
            result["masks"] = masks::make_beside(&capture, out)?;
            capture = Capture::open_unseen(out)?;
        }
    }
    if capture.has_points() {
        say("points: the capture has some already")?;
    } else if arguments.dry_run {
        say("points: would be made")?;
    } else {
        let (prepared, of_points) = points::make_or_strew(&capture, arguments)?;
        points::write(&out.join(POINTS_FILE), &prepared, false)?;
        for (key, value) in of_points.as_object().into_iter().flatten() {
            result[key] = value.clone();
        }
    }
    if arguments.dry_run {
        say(check::WOULD)?;
    } else {
        write_json(&out.join(RECORD), &result, true)?;
        result["check"] = check::after_preparing(out)?;
        arguments.job.write_json(&result)?;
        next::train(out, None)?;
    }
    Ok(())
}

/// The description that an interrupted or finished run of the same command wrote.
fn found_description(out: &Path, arguments: &Arguments) -> anyhow::Result<Option<CaptureDescription>> {
    let record = out.join(RECORD);
    if arguments.job.force || !record.is_file() || !out.join(DESCRIPTION_FILE).is_file() {
        return Ok(None);
    }
    let text = std::fs::read(&record).with_context(|| format!("reading {}", record.display()))?;
    let source = serde_json::from_slice::<Value>(&text).unwrap_or_default()["source"].clone();
    if source != json!(arguments.source.display().to_string()) {
        return Ok(None);
    }
    Ok(Some(CaptureDescription::read(&out.join(DESCRIPTION_FILE))?))
}

/// Runs the steps before masks and points.
///
/// - returns: `None` in a dry run
fn describe(arguments: &Arguments, out: &Path) -> anyhow::Result<Option<Described>> {
    let source = &arguments.source;
    // A dry run removes the folder again; an error here would also fail the command itself.
    let folder = Some(begin_capture(out, source, arguments.job.force)?).filter(|_| !arguments.dry_run);
    let raw = RawFootage::find(source, arguments.fps)?;
    let raw = raw.ok_or_else(|| no_videos(source))?;
    let recorded = raw.cameras();
    for line in recordings_in_words(&recorded) {
        say(&line)?;
    }

    let calibration = match &arguments.calibration {
        Some(path) => Some(Calibration::read(path)?),
        None => Calibration::find(source)?,
    };
    let placed = match &calibration {
        Some(calibration) => {
            let placed = raw.place(calibration)?;
            for line in calibration_in_words(&placed, recorded.len()) {
                say(&line)?;
            }
            placed
        }
        None if has_colmap() => {
            say("calibration: none, so colmap is to find the cameras")?;
            raw.unplaced()
        }
        None => {
            let problem = format!(
                "has no calibration, expected {}; or --calibration FILE; or the program colmap, which finds cameras from \
                 their images (apt install colmap)",
                Calibration::marks()
            );
            return Err(wrong_input(format!("{}: {problem}", source.display())));
        }
    };

    if arguments.dry_run {
        announce(arguments, calibration.as_ref())?;
        return Ok(None);
    }
    let names: Vec<String> = recorded.iter().map(|camera| camera.name.clone()).collect();
    let clocks = match &arguments.offsets {
        Some(file) => Clocks::read(file, &names)?,
        None => measure_clocks(&raw)?,
    };
    let settings = DescribeSettings {
        from_secs: arguments.from.unwrap_or(0.0),
        to_secs: arguments.to,
        every: arguments.every.unwrap_or(1),
        frame_rate: None,
        test_cameras: (!arguments.hold_out.is_empty()).then(|| arguments.hold_out.clone()),
    };
    let mut description = raw.describe(&placed, &clocks, &settings)?;
    for line in clocks_in_words(&clocks, &names, &description) {
        say(&line)?;
    }

    let Some(folder) = folder else { return Ok(None) };
    if calibration.is_some() {
        cameras::note_same_poses(&description)?;
    }
    cameras::check_still(source, &description)?;
    let (found, refinement) = match &calibration {
        None => (Some(cameras::find(source, &mut description, folder.temporary())?), None),
        Some(_) if arguments.refine_calibration => (None, cameras::refine(source, &mut description)?),
        Some(_) => (None, None),
    };
    let scale = arguments.scale.as_ref().map(|scale| cameras::scale(source, &mut description, scale)).transpose()?;
    let model = found.map(|mut found| {
        found.scale(scale.unwrap_or(1.0));
        found.model(&description)
    });
    let balance = if arguments.colors { colors::balance(source, &mut description)? } else { None };

    let mut without = vec![POINTS_FILE, RECORD, DESCRIPTION_FILE, check::PAGE];
    without.extend(model.as_ref().map(|_| MODEL));
    link::link_tree(source, folder.path(), &without)?;
    if let Some(model) = model {
        let place = folder.path().join(MODEL);
        std::fs::create_dir(&place).with_context(|| format!("writing {}", place.display()))?;
        for (name, text) in model {
            write_file(&place.join(name), text.as_bytes(), false)?;
        }
    }
    if let Some(calibration) = calibration.filter(|calibration| calibration.path.is_file()) {
        let beside = folder.path().join(&placed.source.file);
        if !beside.exists() {
            std::fs::copy(&calibration.path, &beside).with_context(|| format!("writing {}", beside.display()))?;
        }
    }
    write_file(&folder.path().join(DESCRIPTION_FILE), description.to_toml().as_bytes(), false)?;
    // A capture that does not open, or for which no points can be made, is not kept.
    let capture = Capture::open_unseen(folder.path())?;
    let num_train = description.cameras.iter().filter(|camera| camera.role == Role::Train).count();
    if num_train < MIN_CAMERAS && !capture.has_points() {
        let problem = format!("has {num_train} cameras for training and no points, expected at least {MIN_CAMERAS}");
        return Err(wrong_input(format!("{}: {problem}, which points are made of", source.display())));
    }
    write_json(&folder.path().join(RECORD), &json!({ "source": source.display().to_string() }), false)?;
    folder.finish()?;
    Ok(Some(Described { description, refinement, balance }))
}

/// Says what would be done, in a dry run.
fn announce(arguments: &Arguments, calibration: Option<&Calibration>) -> anyhow::Result<()> {
    say(match arguments.offsets {
        Some(_) => "clocks: would be read from --offsets",
        None => "clocks: would be measured by sound, else by motion",
    })?;
    say(match calibration {
        None => "cameras: would be found by colmap",
        Some(_) if arguments.refine_calibration => "calibration: would be refined, where that makes it better",
        Some(_) => "calibration: would be taken as it is",
    })?;
    if arguments.colors {
        say("colours: would be compared, and evened out where that makes them more alike")?;
    }
    if arguments.masks != masks::Masks::No {
        say(masks::WOULD)?;
    }
    say("points: would be made")?;
    say(check::WOULD)
}

/// Measures clocks by sound or motion, with a progress bar: motion decodes a minute of every video.
fn measure_clocks(raw: &RawFootage) -> anyhow::Result<Clocks> {
    const STEPS: usize = 1000;
    let progress = Mutex::new(Progress::new("clocks", STEPS));
    let report = |share: f64| {
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.advance_to((share * STEPS as f64) as usize, || "comparing motion".into());
    };
    Ok(raw.measure_clocks(&report)?)
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

fn calibration_in_words(placed: &PlacedCameras, num_cameras: usize) -> Vec<String> {
    let source = &placed.source;
    let mut lines = vec![format!("calibration: {} ({}), {num_cameras} cameras", source.file, source.format)];
    lines.extend(source.changes.iter().map(|change| format!("  {change}")));
    lines
}

fn clocks_in_words(clocks: &Clocks, names: &[String], description: &CaptureDescription) -> Vec<String> {
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
    let skips: Vec<String> = names
        .iter()
        .zip(&description.cameras)
        .map(|(name, camera)| format!("{name} {:.3} s", camera.start_secs))
        .collect();
    let num_test = description.cameras.iter().filter(|camera| camera.role == Role::Test).count();
    vec![
        format!("{how}, each camera skips {}", skips.join(", ")),
        format!(
            "capture: {} frames at {:.2} a second, {} cameras for training, {num_test} held out",
            description.num_frames,
            description.frame_rate,
            names.len() - num_test
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

fn camera_json(camera: &tcgs_capture::DescribedCamera) -> Value {
    json!({
        "id": camera.id,
        "name": camera.name,
        "file": camera.file,
        "held_out": camera.role == Role::Test,
        "start_secs": camera.start_secs,
        "turn_degrees": camera.turn_degrees,
        "size": camera.size,
        "error_px": camera.error_px,
    })
}

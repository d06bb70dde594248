//! Cameras and clocks of a folder of videos: the order of the steps, and the test whether the output already holds
//! their result.

use std::path::Path;
use std::sync::mpsc;
use std::thread;

use serde_json::{Value, json};
use tcgs_capture::{Calibration, Capture, CaptureDescription, DESCRIPTION_FILE, DescribedCamera, POINTS_FILE, Role};
use tcgs_interchange::Existing;
use tcgs_prepare::{Clocks, ColorBalance, DescribeSettings, RawFootage, Refinement, has_colmap};

use super::{
    CHECK_PAGE, MODEL, PrepareOptions, RECORD, WantMasks, begin_capture, cameras, colors, fault, finish, link,
    no_videos, planned, say, unwritable, write, write_json,
};
use crate::error::PipelineError;
use crate::observe::{Event, Observer, PrepareStep, Work, tell};

/// Least number of cameras for a depth that another camera confirms.
const MIN_CAMERAS: usize = 3;

/// The record of the steps before masks and points.
pub fn record(
    source: &Path,
    out: &Path,
    description: &CaptureDescription,
    refinement: Option<&Refinement>,
    balance: Option<&ColorBalance>,
) -> Value {
    json!({
        "source": source.display().to_string(),
        "out": out.display().to_string(),
        "cameras": description.cameras.iter().map(camera_json).collect::<Vec<_>>(),
        "num_frames": description.num_frames,
        "frame_rate": description.frame_rate,
        "calibration": description.calibration.as_ref().map(|source| json!({
            "file": source.file, "format": source.format, "changes": source.changes,
        })),
        "refinement": refinement.map(|refinement| cameras::refinement_json(refinement, description)),
        "colors": balance.map(|balance| colors::balance_json(balance, description)),
        "clock": description.clock.as_ref().map(|clock| &clock.from),
    })
}

/// The description that an interrupted or finished call with the same source wrote.
pub fn found_description(
    source: &Path,
    out: &Path,
    options: &PrepareOptions,
) -> Result<Option<CaptureDescription>, PipelineError> {
    let record = out.join(RECORD);
    if options.replace || !record.is_file() || !out.join(DESCRIPTION_FILE).is_file() {
        return Ok(None);
    }
    let text = std::fs::read(&record)
        .map_err(|error| PipelineError::unreadable(&record, error, "the record of an earlier prepare"))?;
    let of = serde_json::from_slice::<Value>(&text).unwrap_or_default()["source"].clone();
    if of != json!(source.display().to_string()) {
        return Ok(None);
    }
    Ok(Some(CaptureDescription::read(&out.join(DESCRIPTION_FILE))?))
}

/// Runs the steps before masks and points.
///
/// - returns: their record; `None` in a dry run
pub fn describe(
    source: &Path,
    out: &Path,
    options: &PrepareOptions,
    observer: &mut dyn Observer,
) -> Result<Option<Value>, PipelineError> {
    let of = &options.footage;
    // A dry run removes the folder again; an error here would also fail the call itself.
    let folder = Some(begin_capture(source, out, options.replace)?).filter(|_| !options.dry_run);
    let raw = RawFootage::find(source, of.images_fps)?;
    let raw = raw.ok_or_else(|| no_videos(source, "one for each camera, since an option is for videos only"))?;
    let recorded = raw.cameras();
    say(observer, PrepareStep::Recordings(&recorded))?;

    let calibration = match &of.calibration {
        Some(path) => Some(Calibration::read(path)?),
        None => Calibration::find(source)?,
    };
    let placed = match &calibration {
        Some(calibration) => {
            let placed = raw.place(calibration)?;
            say(observer, PrepareStep::Placed(Some(&placed)))?;
            placed
        }
        None if has_colmap() => {
            say(observer, PrepareStep::Placed(None))?;
            raw.unplaced()
        }
        None => return Err(PipelineError::NoCalibration { path: source.into() }),
    };

    let Some(folder) = folder else {
        announce(options, calibration.is_some(), observer)?;
        return Ok(None);
    };
    let names: Vec<String> = recorded.iter().map(|camera| camera.name.clone()).collect();
    let clocks = match &of.offsets {
        Some(file) => Clocks::read(file, &names)?,
        None => measure_clocks(&raw, observer)?,
    };
    let settings = DescribeSettings {
        from_secs: of.from_secs.unwrap_or(0.0),
        to_secs: of.to_secs,
        every: of.every.unwrap_or(1),
        frame_rate: None,
        test_cameras: (!of.hold_out.is_empty()).then(|| of.hold_out.clone()),
    };
    let mut description = raw.describe(&placed, &clocks, &settings)?;
    say(observer, PrepareStep::Clocks { clocks: &clocks, description: &description })?;

    if calibration.is_some() {
        cameras::note_same_poses(&description, observer)?;
    }
    cameras::check_still(source, &description)?;
    let (found, refinement) = match &calibration {
        None => (Some(cameras::find(source, &mut description, folder.temporary(), observer)?), None),
        Some(_) if of.refine_calibration => (None, cameras::refine(source, &mut description, observer)?),
        Some(_) => (None, None),
    };
    let scale = match &of.scale {
        Some((cameras, metres)) => cameras::scale(source, &mut description, cameras, *metres, observer)?,
        None => 1.0,
    };
    let model = found.map(|mut found| {
        found.scale(scale);
        found.model(&description)
    });
    let balance = if of.balance_colors { colors::balance(source, &mut description, observer)? } else { None };

    let mut without = vec![POINTS_FILE, RECORD, DESCRIPTION_FILE, CHECK_PAGE];
    without.extend(model.as_ref().map(|_| MODEL));
    link::link_tree(source, folder.path(), &without)?;
    if let Some(model) = model {
        let place = folder.path().join(MODEL);
        std::fs::create_dir(&place).map_err(unwritable(&place))?;
        for (name, text) in model {
            write(&place.join(name), text.as_bytes(), Existing::Keep)?;
        }
    }
    if let Some(calibration) = calibration.filter(|calibration| calibration.path.is_file()) {
        let beside = folder.path().join(&placed.source.file);
        if !beside.exists() {
            std::fs::copy(&calibration.path, &beside).map_err(unwritable(&beside))?;
        }
    }
    write(&folder.path().join(DESCRIPTION_FILE), description.to_toml().as_bytes(), Existing::Keep)?;
    // A capture that does not open, or for which no points can be made, is not kept.
    let capture = Capture::open_unseen(folder.path())?;
    let num_train = description.cameras.iter().filter(|camera| camera.role == Role::Train).count();
    if num_train < MIN_CAMERAS && !capture.has_points() {
        let problem = format!("has {num_train} cameras for training and no points, expected at least {MIN_CAMERAS}");
        return Err(fault(source, format!("{problem}, which points are made of")));
    }
    let begun = json!({ "source": source.display().to_string() });
    write_json(&folder.path().join(RECORD), &begun, Existing::Keep)?;
    finish(folder, observer)?;
    Ok(Some(record(source, out, &description, refinement.as_ref(), balance.as_ref())))
}

/// Reports what would be done, in a dry run.
fn announce(options: &PrepareOptions, has_calibration: bool, observer: &mut dyn Observer) -> Result<(), PipelineError> {
    let of = &options.footage;
    let works = [
        (true, Work::MeasuringClocks),
        (!has_calibration, Work::FindingCameras),
        (has_calibration && of.refine_calibration, Work::RefiningCameras),
        (of.balance_colors, Work::ComparingColors),
        (options.masks != WantMasks::No, Work::Masking),
        (true, Work::MakingPoints),
    ];
    works.into_iter().filter(|(is_planned, _)| *is_planned).try_for_each(|(_, work)| planned(observer, work))
}

/// Measures clocks by sound or motion. Motion decodes a minute of every video.
fn measure_clocks(raw: &RawFootage, observer: &mut dyn Observer) -> Result<Clocks, PipelineError> {
    const NUM_STEPS: usize = 1000;
    tell(observer, Event::Begun { work: Work::MeasuringClocks, num_steps: NUM_STEPS })?;
    // Any thread may report its progress, but an observer hears in the thread of the call.
    let (reporter, reports) = mpsc::channel();
    let (measured, is_stopped) = thread::scope(|scope| {
        let measuring = scope.spawn(move || {
            raw.measure_clocks(&|share| {
                // The other end receives until this thread ends.
                let _ = reporter.send(share);
            })
        });
        let mut is_stopped = false;
        for share in reports {
            let num_done = (share * NUM_STEPS as f64) as usize;
            is_stopped |= observer.hear(&Event::Step { num_done, what: "comparing motion" }).is_break();
        }
        (measuring.join(), is_stopped)
    });
    let measured = measured.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    if is_stopped { Err(PipelineError::Stopped) } else { Ok(measured?) }
}

fn camera_json(camera: &DescribedCamera) -> Value {
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

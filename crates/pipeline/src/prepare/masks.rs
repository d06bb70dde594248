//! Foreground masks of moving things: made, counted, and written where the capture's layout expects them.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Value, json};
use tcgs_capture::{Capture, MASKS_FOLDER, Split};
use tcgs_core::Segmentation;
use tcgs_interchange::{Existing, create_folders};
use tcgs_prepare::{MaskSettings, make_masks, obstacle_to_masks};

use super::{fault, finish, say, unwritable, write};
use crate::error::PipelineError;
use crate::new_folder::NewFolder;
use crate::observe::{Event, Observer, PrepareStep, Work, tell};

/// Whether to make masks of moving things.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WantMasks {
    /// Make them if the cameras stand still, there are enough frames, and the layout has a place for masks.
    Auto,
    /// Make them; fail if that is impossible.
    Yes,
    /// Make none.
    No,
}

impl WantMasks {
    /// Whether to make masks for a capture that has none. `Auto` reports the reason if that is impossible.
    pub(super) fn are_wanted(self, capture: &Capture, observer: &mut dyn Observer) -> Result<bool, PipelineError> {
        if self == Self::No {
            return Ok(false);
        }
        let Some(problem) = obstacle(capture)? else { return Ok(true) };
        let name = capture.name();
        if self == Self::Yes {
            return Err(PipelineError::NoMasks { name, problem });
        }
        say(observer, PrepareStep::NoMasks { name: &name, problem: &problem })?;
        Ok(false)
    }
}

/// The reason why masks of a capture are impossible; `None` if they are possible.
fn obstacle(capture: &Capture) -> Result<Option<String>, PipelineError> {
    if capture.mask_files(Split::All, 0)?.iter().any(|(_, file)| file.is_none()) {
        let kind = capture.kind().name;
        return Ok(Some(format!("is a {kind} capture, which has no place for masks, expected another layout")));
    }
    Ok(obstacle_to_masks(capture)?)
}

/// Makes the masks of a capture with a `capture.toml`, all of them or none.
///
/// - `folder`: the capture's
/// - returns: the record of the step
pub(super) fn make_beside(
    capture: &Capture,
    folder: &Path,
    observer: &mut dyn Observer,
) -> Result<Value, PipelineError> {
    let masks = folder.join(MASKS_FOLDER);
    let new = NewFolder::begin(&masks, false, |_| false)?;
    let told = make(capture, &masks, new.path(), observer)?;
    finish(new, observer)?;
    Ok(told)
}

/// Makes the masks of a capture whose layout has a place for them.
///
/// - `from`, `to`: a mask whose place is in `from` is written to the same place in `to`; an existing mask stays
pub(super) fn make(
    capture: &Capture,
    from: &Path,
    to: &Path,
    observer: &mut dyn Observer,
) -> Result<Value, PipelineError> {
    let begin = Instant::now();
    tell(observer, Event::Begun { work: Work::Masking, num_steps: 100 })?;
    let is_stopped = Cell::new(false);
    let (mut num_masks, mut covered, mut pixels) = (0, 0, 0);
    let mut failed = None;
    // The frame, and the mask file of each camera at that frame.
    let mut places: (usize, BTreeMap<usize, PathBuf>) = (usize::MAX, BTreeMap::new());
    let mut write = |frame: usize, camera_id: usize, mask: &Segmentation| {
        num_masks += 1;
        covered += mask.foreground.iter().filter(|&&marked| marked).count();
        pixels += mask.foreground.len();
        let written = places_at(capture, frame, &mut places).and_then(|()| {
            let place = places.1.get(&camera_id).and_then(|place| place.strip_prefix(from).ok());
            let place = place.ok_or_else(|| fault(from, format!("has no place for a mask of camera {camera_id}")))?;
            write_mask(&to.join(place), mask)
        });
        match written {
            Ok(()) if is_stopped.get() => ControlFlow::Break(()),
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    make_masks(capture, &MaskSettings::default(), &mut write, &mut |step, share| {
        let event = Event::Step { num_done: (100.0 * share) as usize, what: step };
        is_stopped.set(is_stopped.get() | observer.hear(&event).is_break());
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    if is_stopped.get() {
        return Err(PipelineError::Stopped);
    }
    let (seconds, share) = (begin.elapsed().as_secs_f64(), covered as f64 / pixels.max(1) as f64);
    say(observer, PrepareStep::Masks { num_masks, share, secs: seconds })?;
    Ok(json!({ "num_masks": num_masks, "foreground": share, "seconds": seconds }))
}

/// Reads the mask files of a frame unless `places` already holds them.
fn places_at(
    capture: &Capture,
    frame: usize,
    places: &mut (usize, BTreeMap<usize, PathBuf>),
) -> Result<(), PipelineError> {
    if places.0 != frame {
        let files = capture.mask_files(Split::All, frame)?;
        *places = (frame, files.into_iter().filter_map(|(id, file)| Some((id, file?))).collect());
    }
    Ok(())
}

/// Writes a mask unless the file exists.
fn write_mask(file: &Path, mask: &Segmentation) -> Result<(), PipelineError> {
    if file.exists() {
        return Ok(());
    }
    if let Some(folder) = file.parent() {
        create_folders(folder).map_err(unwritable(folder))?;
    }
    let white: Vec<u8> = mask.foreground.iter().map(|&marked| if marked { 255 } else { 0 }).collect();
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&white, mask.width as u32, mask.height as u32, ExtendedColorType::L8)
        .map_err(|error| unwritable(file)(std::io::Error::other(error)))?;
    write(file, &bytes, Existing::Keep)
}

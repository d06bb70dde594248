//! Foreground masks of what moves: made, counted, written where the capture's kind looks for them.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Value, json};
use tcgs_capture::{Capture, MASKS_FOLDER, MaskSettings, Split, make_masks, obstacle_to_masks};
use tcgs_core::Segmentation;

use crate::error::wrong_input;
use crate::output::{NewFolder, write_file};
use crate::progress::Progress;
use crate::terminal::say;

/// What is said of them in a dry run.
pub const WOULD: &str = "masks: would be made";

/// Whether masks are made of what moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Masks {
    /// Where they can be
    Auto,
    /// It is an error if they cannot be
    Yes,
    No,
}

impl Masks {
    /// Whether masks are to be made of a capture that has none. Where they cannot be, `auto` says why.
    pub fn are_wanted(self, capture: &Capture) -> anyhow::Result<bool> {
        if self == Self::No {
            return Ok(false);
        }
        match obstacle(capture)? {
            None => Ok(true),
            Some(problem) if self == Self::Auto => {
                say(&format!("masks: none are made; {}: {problem}", capture.name()))?;
                Ok(false)
            }
            Some(problem) => Err(wrong_input(format!("{}: {problem}; or --masks no", capture.name()))),
        }
    }
}

/// Why masks cannot be made of a capture, if they cannot.
fn obstacle(capture: &Capture) -> anyhow::Result<Option<String>> {
    if capture.mask_files(Split::All, 0)?.iter().any(|(_, file)| file.is_none()) {
        let kind = capture.kind().name;
        return Ok(Some(format!("is a {kind} capture, which has no place for masks, expected another layout")));
    }
    Ok(obstacle_to_masks(capture)?)
}

/// Makes the masks of a capture that `capture.toml` describes, all of them or none.
///
/// - `folder`: the capture's
/// - returns: what is told of them as JSON
pub fn make_beside(capture: &Capture, folder: &Path) -> anyhow::Result<Value> {
    let masks = folder.join(MASKS_FOLDER);
    let new = NewFolder::begin(&masks, false, |_| false)?;
    let told = make(capture, &masks, new.path())?;
    new.finish()?;
    Ok(told)
}

/// Makes the masks of a capture that has a place for them.
///
/// - `from`, `to`: a mask that the capture looks for in `from` is written to the same place in `to`; one that is there
///   stays
pub fn make(capture: &Capture, from: &Path, to: &Path) -> anyhow::Result<Value> {
    let begin = Instant::now();
    let mut progress = Progress::new("masks", 100);
    let (mut num_masks, mut covered, mut pixels) = (0, 0, 0);
    let mut failed = None;
    // Where the masks of a frame belong, by camera.
    let mut places: (usize, BTreeMap<usize, PathBuf>) = (usize::MAX, BTreeMap::new());
    let mut write = |frame: usize, camera_id: usize, mask: &Segmentation| {
        num_masks += 1;
        covered += mask.foreground.iter().filter(|&&marked| marked).count();
        pixels += mask.foreground.len();
        let written = places_at(capture, frame, &mut places).and_then(|()| {
            let place = places.1.get(&camera_id).context("a camera without a mask's place")?;
            write_mask(&to.join(place.strip_prefix(from).context("a mask outside of its folder")?), mask)
        });
        match written {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(error);
                ControlFlow::Break(())
            }
        }
    };
    make_masks(capture, &MaskSettings::default(), &mut write, &mut |step, share| {
        progress.advance_to((100.0 * share) as usize, || step.into());
    })?;
    drop(progress);
    if let Some(error) = failed {
        return Err(error);
    }
    let (seconds, share) = (begin.elapsed().as_secs_f64(), covered as f64 / pixels.max(1) as f64);
    say(&format!("masks: {num_masks}, {:.1} % of the pixels move; {seconds:.1} s", 100.0 * share))?;
    Ok(json!({ "num_masks": num_masks, "foreground": share, "seconds": seconds }))
}

/// Goes on to the places of a frame, if they are those of another.
fn places_at(capture: &Capture, frame: usize, places: &mut (usize, BTreeMap<usize, PathBuf>)) -> anyhow::Result<()> {
    if places.0 != frame {
        let files = capture.mask_files(Split::All, frame)?;
        *places = (frame, files.into_iter().filter_map(|(id, file)| Some((id, file?))).collect());
    }
    Ok(())
}

/// Writes a mask where there is none.
fn write_mask(file: &Path, mask: &Segmentation) -> anyhow::Result<()> {
    if file.exists() {
        return Ok(());
    }
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("writing {}", folder.display()))?;
    }
    let white: Vec<u8> = mask.foreground.iter().map(|&marked| if marked { 255 } else { 0 }).collect();
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&white, mask.width as u32, mask.height as u32, ExtendedColorType::L8)
        .context("encoding a mask")?;
    write_file(file, &bytes, false)
}

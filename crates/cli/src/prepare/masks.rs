//! Foreground masks of moving things: made, counted, and written where the capture's layout expects them.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Value, json};
use tcgs_capture::{Capture, MASKS_FOLDER, Split};
use tcgs_core::Segmentation;
use tcgs_prepare::{MaskSettings, make_masks, obstacle_to_masks};

use crate::error::wrong_input;
use crate::output::{NewFolder, write_file};
use crate::progress::Progress;
use crate::terminal::say;

/// A dry run's line for this step.
pub const WOULD: &str = "masks: would be made";

/// Whether to make masks of moving things.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Masks {
    /// Make them if possible
    Auto,
    /// Make them; fail if that is impossible
    Yes,
    No,
}

impl Masks {
    /// Whether to make masks for a capture that has none. `auto` prints the reason if that is impossible.
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

/// The reason why masks of a capture are impossible; `None` if they are possible.
fn obstacle(capture: &Capture) -> anyhow::Result<Option<String>> {
    if capture.mask_files(Split::All, 0)?.iter().any(|(_, file)| file.is_none()) {
        let kind = capture.kind().name;
        return Ok(Some(format!("is a {kind} capture, which has no place for masks, expected another layout")));
    }
    Ok(obstacle_to_masks(capture)?)
}

/// Makes the masks of a capture with a `capture.toml`, all of them or none.
///
/// - `folder`: the capture's
/// - returns: the report as JSON
pub fn make_beside(capture: &Capture, folder: &Path) -> anyhow::Result<Value> {
    let masks = folder.join(MASKS_FOLDER);
    let new = NewFolder::begin(&masks, false, |_| false)?;
    let told = make(capture, &masks, new.path())?;
    new.finish()?;
    Ok(told)
}

/// Makes the masks of a capture whose layout has a place for them.
///
/// - `from`, `to`: a mask whose place is in `from` is written to the same place in `to`; an existing mask stays
pub fn make(capture: &Capture, from: &Path, to: &Path) -> anyhow::Result<Value> {
    let begin = Instant::now();
    let mut progress = Progress::new("masks", 100);
    let (mut num_masks, mut covered, mut pixels) = (0, 0, 0);
    let mut failed = None;
    // The frame, and the mask file of each camera at that frame.
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

/// Reads the mask files of a frame unless `places` already holds them.
fn places_at(capture: &Capture, frame: usize, places: &mut (usize, BTreeMap<usize, PathBuf>)) -> anyhow::Result<()> {
    if places.0 != frame {
        let files = capture.mask_files(Split::All, frame)?;
        *places = (frame, files.into_iter().filter_map(|(id, file)| Some((id, file?))).collect());
    }
    Ok(())
}

/// Writes a mask unless the file exists.
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

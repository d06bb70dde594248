//! Agreement of the masks of `make_masks` with those of a capture: `measure_masks CAPTURE`.
//!
//! Prints intersection over union: mean and least of the cameras, and of all pixels together.

use std::collections::BTreeMap;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use tcgs_capture::{Capture, Split};
use tcgs_core::{Segmentation, View};
use tcgs_prepare::{MaskSettings, make_masks};

fn main() -> Result<(), Box<dyn Error>> {
    let path: PathBuf = std::env::args().nth(1).ok_or("expected the folder of a capture with masks")?.into();
    let capture = Capture::open(&path)?;
    let begin = Instant::now();
    // Pixels of each camera: marked by both masks, by the made one alone, by the given one alone.
    let mut counts: BTreeMap<usize, [f64; 3]> = BTreeMap::new();
    let mut given: Vec<View> = Vec::new();
    let mut failed = None;
    let mut write = |frame: usize, camera_id: usize, mask: &Segmentation| {
        if given.first().is_none_or(|view| view.frame != frame) {
            match capture.views(Split::All, frame, 1) {
                Ok(views) => given = views,
                Err(error) => {
                    failed = Some(error);
                    return ControlFlow::Break(());
                }
            }
        }
        let view = given.iter().find(|view| view.camera_id == camera_id);
        if let Some(other) = view.and_then(|view| view.segmentation.as_ref()) {
            let counts = counts.entry(camera_id).or_default();
            for pair in mask.foreground.iter().zip(&other.foreground) {
                match pair {
                    (true, true) => counts[0] += 1.0,
                    (true, false) => counts[1] += 1.0,
                    (false, true) => counts[2] += 1.0,
                    (false, false) => {}
                }
            }
        }
        ControlFlow::Continue(())
    };
    make_masks(&capture, &MaskSettings::default(), &mut write, &mut |_, _| ())?;
    if let Some(error) = failed {
        return Err(error.into());
    }
    let of = |[both, made, given]: [f64; 3]| both / (both + made + given).max(1.0);
    let each: Vec<f64> = counts.values().map(|&counts| of(counts)).collect();
    let all = counts.values().fold([0.0; 3], |sum, counts| [0, 1, 2].map(|i| sum[i] + counts[i]));
    println!(
        "{} cameras: mean {:.3}, least {:.3}, all together {:.3}; {:.1} s for {} frames",
        each.len(),
        each.iter().sum::<f64>() / each.len().max(1) as f64,
        each.iter().copied().fold(1.0, f64::min),
        of(all),
        begin.elapsed().as_secs_f64(),
        capture.num_frames()
    );
    Ok(())
}

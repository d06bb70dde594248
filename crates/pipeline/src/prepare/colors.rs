//! Differences in exposure and white balance between the cameras of a folder of videos, and their report.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::{CaptureDescription, ColorSource};
use tcgs_prepare::{ColorBalance, balance_colors};

use super::say;
use super::steps::stoppable;
use crate::error::PipelineError;
use crate::observe::{Observer, PrepareStep, Work};

/// Least deviation of a gain from 1 that gets its own line.
const WORTH_A_LINE: f32 = 0.03;

/// Measures gains and offsets, adopts them if colours then agree better, and reports the outcome.
pub fn balance(
    source: &Path,
    description: &mut CaptureDescription,
    observer: &mut dyn Observer,
) -> Result<Option<ColorBalance>, PipelineError> {
    let balance = stoppable(observer, Work::ComparingColors, 3, |tell| balance_colors(source, description, tell))?;
    let lines = match &balance {
        None => vec!["colours: too few places are seen by several cameras to compare them".into()],
        Some(balance) => in_words(balance, description),
    };
    say(observer, PrepareStep::ColorsCompared(&lines))?;
    let mut colors = ColorSource::default();
    colors.found = lines.iter().map(|line| line.trim().trim_start_matches("colours: ").into()).collect();
    description.colors = Some(colors);
    Ok(balance)
}

/// The outcome of the colour balance as JSON.
pub fn balance_json(balance: &ColorBalance, description: &CaptureDescription) -> Value {
    let ([before, after], [fitted, judging]) = (balance.error_levels, balance.num_places);
    let cameras = description.cameras.iter().zip(&balance.camera_error_levels);
    let of_camera = |(camera, errors): (&tcgs_capture::DescribedCamera, &Option<[f64; 2]>)| {
        json!({
            "name": camera.name,
            "gains": camera.gains,
            "offsets": camera.offsets,
            "before_levels": errors.map(|e| e[0]),
            "after_levels": errors.map(|e| e[1]),
        })
    };
    json!({
        "taken": balance.is_taken,
        "before_levels": before,
        "after_levels": after,
        "num_fitted": fitted,
        "num_judging": judging,
        "cameras": cameras.map(of_camera).collect::<Vec<_>>(),
    })
}

fn in_words(balance: &ColorBalance, description: &CaptureDescription) -> Vec<String> {
    let ([before, after], [fitted, judging]) = (balance.error_levels, balance.num_places);
    let what = match (balance.is_taken, balance.has_offsets) {
        (true, true) => "evened out by gains and offsets",
        (true, false) => "evened out by gains",
        (false, _) => "as recorded, since gains would not make them clearly more alike",
    };
    let mut lines = vec![format!(
        "colours: {what}: {judging} places that were held out differ by {before:.1} levels of 255 between cameras before \
         and {after:.1} after a fit to {fitted} others, medians of the cameras on average"
    )];
    for camera in description.cameras.iter().filter(|_| balance.is_taken) {
        let [red, green, blue] = camera.gains;
        let is_far = camera.gains.iter().any(|gain| (gain - 1.0).abs() > WORTH_A_LINE) || camera.offsets != [0.0; 3];
        if is_far {
            let [r, g, b] = camera.offsets.map(|offset| 255.0 * offset);
            let offsets =
                if balance.has_offsets { format!(", offsets {r:+.1} {g:+.1} {b:+.1}") } else { String::new() };
            lines.push(format!("  {}: gains {red:.3} {green:.3} {blue:.3}{offsets}", camera.name));
        }
    }
    let names = description.cameras.iter().zip(&balance.camera_error_levels).filter(|(_, errors)| errors.is_none());
    let names: Vec<&str> = names.map(|(camera, _)| camera.name.as_str()).collect();
    if !names.is_empty() {
        lines.push(format!("  too few places to judge {}, whose colours stay as recorded", names.join(", ")));
    }
    lines
}

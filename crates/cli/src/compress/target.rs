//! The result of a search for a size or a quality, in words and for machines.

use serde_json::{Map, Value, json};
use tcgs_codec::CompressSettings;
use tcgs_core::Attribute;
use tcgs_pipeline::{Judge, QUALITY_RANGE, SearchResult, Target, Trial, Tuning, TuningTrial};

use crate::output::show_bytes;
use crate::teller::show_psnr;

/// Reads a quality.
pub fn quality(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|q| QUALITY_RANGE.contains(q));
    number.ok_or_else(|| format!("expected a number from {} to {}", QUALITY_RANGE.start(), QUALITY_RANGE.end()))
}

/// In words and for machines.
pub fn describe(found: &SearchResult, target: Target, judge: &Judge) -> (String, Value) {
    let Trial { bytes, psnr, .. } = found.trial;
    let quality = found.trial.quality();
    let text = format!(
        "found --quality {quality}: {}, {} against {}; {} settings tried",
        show_bytes(bytes),
        show_psnr(psnr),
        judge.of,
        found.trials.len()
    );
    let wanted = wanted(target);
    let trial = |t: &Trial| json!({ "quality": t.quality(), "bytes": t.bytes, "psnr": t.psnr });
    let value = json!({
        wanted.0: wanted.1,
        "measured_against": if judge.of_capture { "capture" } else { "source" },
        "images": judge.num_images(),
        "quality": quality,
        "bytes": bytes,
        "psnr": psnr,
        "settings": settings(&found.settings),
        "steps": found.trials.iter().map(trial).collect::<Vec<_>>(),
    });
    (text, value)
}

/// Name and number of a target.
fn wanted(target: Target) -> (&'static str, Value) {
    match target {
        Target::Bytes(bytes) => ("target_bytes", json!(bytes)),
        Target::Psnr(psnr) => ("target_psnr", json!(psnr)),
    }
}

/// The settings that searches choose.
fn settings(settings: &CompressSettings) -> Value {
    let by_attribute = |values: &[f32; 5]| -> Value {
        Attribute::BASE.iter().map(|a| (a.name().to_owned(), json!(values[a.index()]))).collect::<Map<_, _>>().into()
    };
    json!({
        "max_mse": by_attribute(&settings.max_mse),
        "coarser_bits": by_attribute(&settings.coarser),
        "position_fineness": settings.position_fineness,
        "importance": settings.importance,
    })
}

/// The result of tuning, in words and for machines.
pub fn describe_tuning(tuning: &Tuning, target: Option<Target>, judge: &Judge) -> (String, Value) {
    let ((bytes_before, psnr_before), Trial { bytes, psnr, .. }) = (tuning.start, tuning.found.trial);
    let text = format!(
        "tuned: {}, {} against {}; before {}, {}: {:.1} % fewer bytes; {} settings tried",
        show_bytes(bytes),
        psnr.map_or("-".into(), |psnr| format!("{psnr:.3} dB")),
        judge.of,
        show_bytes(bytes_before),
        format_args!("{psnr_before:.3} dB"),
        100.0 * tuning.saved(),
        tuning.trials.len()
    );
    let trial = |t: &TuningTrial| json!({ "setting": t.setting, "bytes": t.bytes, "psnr": t.psnr, "saved": t.saved });
    let mut value = json!({
        "measured_against": if judge.of_capture { "capture" } else { "source" },
        "images": judge.num_images(),
        "bytes_before": bytes_before,
        "psnr_before": psnr_before,
        "bytes": bytes,
        "psnr": psnr,
        "settings": settings(&tuning.found.settings),
        "steps": tuning.trials.iter().map(trial).collect::<Vec<_>>(),
    });
    if let Some((name, number)) = target.map(wanted) {
        value[name] = number;
    }
    (text, value)
}

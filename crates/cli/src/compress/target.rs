//! What a search for a size or a quality found, in words and for machines.

use serde_json::{Map, Value, json};
use tcgs_core::Attribute;
use tcgs_pipeline::{Judge, QUALITY_RANGE, SearchResult, Target, Trial};

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
    let wanted = match target {
        Target::Bytes(bytes) => ("target_bytes", json!(bytes)),
        Target::Psnr(psnr) => ("target_psnr", json!(psnr)),
    };
    let trial = |t: &Trial| json!({ "quality": t.quality(), "bytes": t.bytes, "psnr": t.psnr });
    let by_attribute = |values: &[f32; 5]| -> Value {
        Attribute::BASE.iter().map(|a| (a.name().to_owned(), json!(values[a.index()]))).collect::<Map<_, _>>().into()
    };
    let value = json!({
        wanted.0: wanted.1,
        "measured_against": if judge.of_capture { "capture" } else { "source" },
        "images": judge.num_images(),
        "quality": quality,
        "bytes": bytes,
        "psnr": psnr,
        "settings": {
            "max_mse": by_attribute(&found.settings.max_mse),
            "coarser_bits": by_attribute(&found.settings.coarser),
            "position_fineness": found.settings.position_fineness,
        },
        "steps": found.trials.iter().map(trial).collect::<Vec<_>>(),
    });
    (text, value)
}

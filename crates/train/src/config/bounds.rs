//! Bounds of every setting, in one table. [`check`] compares all settings with it.
//!
//! What lives here: ranges of single settings. Upper ends are far beyond useful values; they refuse typing errors that
//! would take all memory or never end. What does not: how settings fit together ([`TrainConfig::check`]).
//!
//! [`TrainConfig::check`]: super::TrainConfig::check

use super::ConfigError;

/// The values of one setting, both ends included.
#[derive(Clone, Copy, Debug)]
enum Bounds {
    /// Names, texts and switches: their type bounds them.
    Any,
    Whole(i64, i64),
    Number(f64, f64),
}

use Bounds::{Any, Number, Whole};

/// Upper ends of a schedule: more takes years.
const ITERATIONS: i64 = 100_000_000;
const TIMESTEPS: i64 = 10_000_000;
/// Upper end of weights, and of factors that stretch the value they are compared with, or switch it off.
const FACTOR: f64 = 1e6;
const SHARE: Bounds = Number(0.0, 1.0);
/// A rate that is too large takes neither memory nor time: training stops at the first loss that is not finite.
const RATE: Bounds = Number(0.0, 1e38);
const WEIGHT: Bounds = Number(0.0, FACTOR);

/// Every setting by its dotted name, in the order of `config.toml`.
const BOUNDS: [(&str, Bounds); 75] = [
    ("preset", Any),
    ("seed", Any),
    ("data.capture", Any),
    ("data.layout", Any),
    ("data.points", Any),
    ("data.hold_out", Any),
    ("data.start_from", Any),
    ("data.first_frame", Whole(0, TIMESTEPS)),
    ("data.end_frame", Whole(0, TIMESTEPS)),
    ("data.downscale", Whole(1, 16384)),
    ("data.frame_rate", Number(1e-6, 1e6)),
    ("schedule.first_iterations", Whole(1, ITERATIONS)),
    ("schedule.rest_iterations", Whole(1, ITERATIONS)),
    ("rates.mean", RATE),
    ("rates.color", RATE),
    ("rates.color_damping", Number(0.0, FACTOR)),
    ("rates.harmonic", RATE),
    ("rates.color_rest", RATE),
    ("rates.quat", RATE),
    ("rates.logit_opacity", RATE),
    ("rates.log_scale", RATE),
    ("rates.camera", RATE),
    ("rates.camera_centered", Any),
    ("rates.mask", RATE),
    ("rates.step", RATE),
    ("rates.motion_scale", RATE),
    ("rates.reset_steps", Any),
    ("rates.motion_decay", SHARE),
    ("rates.first_decay", SHARE),
    ("rates.first_scale", RATE),
    ("weights.image", WEIGHT),
    ("weights.segmentation", WEIGHT),
    ("weights.rigid", WEIGHT),
    ("weights.rot", WEIGHT),
    ("weights.iso", WEIGHT),
    ("weights.floor", WEIGHT),
    ("weights.background", WEIGHT),
    ("weights.stillness", WEIGHT),
    ("weights.soft_color", WEIGHT),
    ("weights.mask", WEIGHT),
    ("weights.mask_consistency", WEIGHT),
    ("densify.start", Whole(0, ITERATIONS)),
    ("densify.interval", Whole(1, ITERATIONS)),
    ("densify.gradient_threshold", Number(0.0, FACTOR)),
    ("densify.prune_opacity_end", SHARE),
    ("densify.reset", Whole(0, ITERATIONS)),
    ("densify.prune_large", Whole(0, ITERATIONS)),
    ("densify.prune_error", Number(0.0, FACTOR)),
    // Below 1: some are left.
    ("densify.dropout", Number(0.0, 0.9)),
    ("mask.enabled", Any),
    // A mask of 1 is never reached.
    ("mask.threshold", Number(0.0, 0.999)),
    // The sigmoid of larger values is 0 or 1 in f32.
    ("mask.initial_logit", Number(-80.0, 80.0)),
    ("mask.reset", Any),
    ("mask.prune_end", Whole(0, ITERATIONS)),
    ("quantize.enabled", Any),
    ("quantize.start", Whole(0, ITERATIONS)),
    ("quantize.min_bits", Whole(1, 16)),
    ("quantize.max_bits", Whole(1, 16)),
    ("quantize.mean_bits", Number(0.0, 16.0)),
    ("quantize.bit_map", Any),
    ("quantize.learned_offset", Any),
    ("gate.enabled", Any),
    ("gate.share", SHARE),
    ("gate.settle", Number(0.0, FACTOR)),
    ("gate.matches", Any),
    ("births.enabled", Any),
    // Not 0: `births.enabled` switches births off.
    ("births.share", Number(1e-6, 1.0)),
    ("births.iterations", Whole(1, ITERATIONS)),
    ("births.youth", Whole(0, TIMESTEPS)),
    ("births.gradient_threshold", Number(0.0, FACTOR)),
    ("deaths.patience", Whole(0, TIMESTEPS)),
    // Below 1: a Gaussian that covers all pixels alone counts as seen.
    ("deaths.share", Number(0.0, 0.999)),
    ("color.degree", Whole(0, tcgs_core::MAX_SH_DEGREE as i64)),
    ("render.antialiased", Any),
    ("render.background", Any),
];

/// Checks that every setting of a whole configuration has a value within its bounds.
///
/// - `table`: with all settings, of the types that they have
pub(super) fn check(table: &toml::Table) -> Result<(), ConfigError> {
    for (key, bounds) in BOUNDS {
        let Some(value) = find(table, key) else { continue };
        let is_within = match (bounds, value) {
            (Whole(least, most), toml::Value::Integer(found)) => (least..=most).contains(found),
            // A file holds the nearest f32 of an end.
            (Number(least, most), toml::Value::Float(found)) => (least as f32..=most as f32).contains(&(*found as f32)),
            _ => true,
        };
        if !is_within {
            let (found, expected) = match bounds {
                Number(least, most) => (number(value), format!("a number from {least} to {most}")),
                Whole(least, most) => (value.to_string(), format!("a whole number from {least} to {most}")),
                Any => unreachable!("any value is within"),
            };
            return Err(ConfigError::Value { key: key.into(), found, expected });
        }
    }
    Ok(())
}

/// As Rust writes an f32, without the digits of the f64 in a file.
pub(super) fn number(value: &toml::Value) -> String {
    match value.as_float() {
        Some(found) if found.is_finite() && (found as f32).is_infinite() => format!("{found:e}"),
        Some(found) => (found as f32).to_string(),
        None => value.to_string(),
    }
}

fn find<'a>(table: &'a toml::Table, key: &str) -> Option<&'a toml::Value> {
    match key.split_once('.') {
        Some((section, name)) => table.get(section)?.get(name),
        None => table.get(key),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::TrainConfig;

    /// Dotted names of a configuration, in its order.
    fn keys(config: &TrainConfig) -> Vec<String> {
        let mut keys = Vec::new();
        for (name, value) in config.table() {
            match value.as_table() {
                Some(section) => keys.extend(section.keys().map(|key| format!("{name}.{key}"))),
                None => keys.push(name),
            }
        }
        keys
    }

    #[test]
    fn every_setting_has_bounds_and_none_is_beyond() {
        let config = TrainConfig::default();
        let mut known: Vec<&str> = BOUNDS.iter().map(|(key, _)| *key).collect();
        let mut keys = keys(&config);
        known.sort_unstable();
        keys.sort_unstable();
        assert_eq!(known, keys);
        let refused = |key: &str, value: String| {
            let error = config.clone().set(key, &value).unwrap_err().to_string();
            let expected = error.starts_with(&format!("{key} is ")) && error.contains("number from ");
            assert!(expected, "{key}={value}: {error}");
        };
        for (key, bounds) in BOUNDS {
            match bounds {
                Any => {}
                Whole(least, most) => {
                    assert!(least < most, "{key}");
                    for value in [least - 1, most + 1, i64::MIN, i64::MAX] {
                        refused(key, value.to_string());
                    }
                }
                Number(least, most) => {
                    assert!(least < most && most.is_finite(), "{key}");
                    for value in [least - 0.01, most * 1.01, f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1e300] {
                        refused(key, toml::Value::Float(value).to_string());
                    }
                }
            }
        }
    }

    #[test]
    fn the_ends_are_within() {
        for (key, bounds) in BOUNDS {
            let mut config = TrainConfig::default();
            let ends = match bounds {
                Any => continue,
                // One end of either crosses the other setting.
                Whole(..) if key.starts_with("quantize.m") => continue,
                Whole(least, most) => [least.to_string(), most.to_string()],
                Number(least, most) => [least, most].map(|end| toml::Value::Float(end).to_string()),
            };
            for end in ends {
                config.set(key, &end).unwrap_or_else(|error| panic!("{key}={end}: {error}"));
                assert_eq!(TrainConfig::default().merge(&config.to_toml()).unwrap(), config);
            }
        }
    }
}

//! Retired settings, which the `config.toml` of an old run holds. Such a run goes on if each has the one value that
//! this program computes with.
//!
//! What lives here: names and values. What does not: the constants, each beside the code that uses it. A test compares
//! the values with the constants.

use toml::Value;
use toml::Value::{Boolean, Float, Integer};

use super::{ConfigError, bounds};

/// Every retired setting by its dotted name, with the only value that it may have.
static RETIRED: [(&str, Value); 17] = [
    ("densify.end", Integer(5000)),
    ("densify.clone_scale", Float(0.01)),
    ("densify.split_children", Integer(2)),
    ("densify.split_shrink", Float(1.6)),
    ("densify.prune_opacity", Float(0.005)),
    ("densify.prune_scale", Float(0.1)),
    ("densify.reset_opacity", Float(0.01)),
    ("mask.prune_interval", Integer(1000)),
    // The methods that other values switched on are gone.
    ("densify.unseen_share", Float(0.0)),
    ("mask.relative", Boolean(false)),
    ("quantize.position_bits", Integer(16)),
    ("gate.noise", Float(6.0)),
    ("gate.contrast", Float(0.006)),
    ("gate.growth", Float(0.006)),
    ("gate.pace", Float(3.0)),
    ("births.contrast", Float(0.02)),
    ("births.opacity", Float(0.1)),
];

/// Whether a setting is retired, and can therefore be passed over.
///
/// - `key`: dotted name
/// - `found`: its value in a file or on a command line
///
/// # Errors
/// [`ConfigError::Value`] if the setting is retired and has another value than it may have.
pub(super) fn is_retired(key: &str, found: &Value) -> Result<bool, ConfigError> {
    let Some((_, only)) = RETIRED.iter().find(|(name, _)| *name == key) else { return Ok(false) };
    // A file may hold the number 3.0 as 3, and a number as the nearest f32.
    let number = |value: &Value| value.as_float().or(value.as_integer().map(|whole| whole as f64)).map(|x| x as f32);
    if found == only || number(only).is_some_and(|only| number(found) == Some(only)) {
        return Ok(true);
    }
    let expected = format!("{}, since it is no longer a setting", bounds::number(only));
    Err(ConfigError::Value { key: key.into(), found: bounds::number(found), expected })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DensifyConfig, TrainConfig};
    use crate::{gate, population};

    #[test]
    fn an_old_configuration_is_read_if_it_has_the_values_of_the_constants() {
        let config = TrainConfig::default();
        let with = |text: &str, key: &str, value: &Value| {
            let (section, name) = key.split_once('.').unwrap();
            text.replacen(&format!("[{section}]"), &format!("[{section}]\n{name} = {value}"), 1)
        };
        let old = RETIRED.iter().fold(config.to_toml(), |text, (key, only)| with(&text, key, only));
        assert_eq!(config.merge(&old).unwrap(), config);
        for (key, only) in &RETIRED {
            let other = match only {
                Float(number) => Float(number + 0.5),
                Integer(number) => Integer(number + 1),
                _ => Boolean(true),
            };
            let error = config.merge(&with(&config.to_toml(), key, &other)).unwrap_err().to_string();
            let start = format!("{key} is {}, expected {}, since", bounds::number(&other), bounds::number(only));
            assert!(error.starts_with(&start), "{error}");
            assert_eq!(config.clone().set(key, &other.to_string()).unwrap_err().to_string(), error);
        }
    }

    #[test]
    fn values_are_those_of_the_constants() {
        let constants = [
            ("densify.end", population::DENSIFY_END as f32),
            ("densify.clone_scale", population::CLONE_SCALE),
            ("densify.split_children", population::SPLIT_CHILDREN as f32),
            ("densify.split_shrink", population::SPLIT_SHRINK),
            ("densify.prune_opacity", DensifyConfig::PRUNE_OPACITY),
            ("densify.prune_scale", population::PRUNE_SCALE),
            ("densify.reset_opacity", population::RESET_OPACITY),
            ("mask.prune_interval", population::MASK_PRUNE_INTERVAL as f32),
            ("quantize.position_bits", tcgs_codec::BitSettings::default().position_bits.into()),
            ("gate.noise", gate::NOISE_DEVIATIONS),
            ("gate.contrast", gate::CONTRAST),
            ("gate.growth", gate::GROWTH),
            ("gate.pace", gate::SETTLED_PACE as f32),
            ("births.contrast", gate::UNEXPLAINED_CONTRAST),
            ("births.opacity", population::MIN_OPACITY),
        ];
        for (key, constant) in constants {
            assert!(is_retired(key, &Float(constant.into())).unwrap(), "{key}");
        }
        assert_eq!(constants.len() + 2, RETIRED.len());
    }
}

//! Retired settings, which the `config.toml` of an old run holds. Such a run goes on if each has the one value that
//! this program computes with.
//!
//! What lives here: names and values.

use toml::Value;
use toml::Value::Boolean;

use super::{ConfigError, bounds};

/// Every retired setting by its dotted name, with the only value that it may have.
static RETIRED: [(&str, Value); 1] = [
    // The method that `true` switched on is gone.
    ("mask.relative", Boolean(false)),
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
    use crate::config::TrainConfig;

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
            let other = Boolean(true);
            let error = config.merge(&with(&config.to_toml(), key, &other)).unwrap_err().to_string();
            let start = format!("{key} is {}, expected {}, since", bounds::number(&other), bounds::number(only));
            assert!(error.starts_with(&start), "{error}");
            assert_eq!(config.clone().set(key, &other.to_string()).unwrap_err().to_string(), error);
        }
    }
}

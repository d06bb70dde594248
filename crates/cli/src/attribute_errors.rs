//! Largest errors of attributes: parsing the bounds a user asks for, and printing the errors.

use std::str::FromStr;

use serde_json::{Map, Value, json};

use crate::terminal::say;

/// Each of the five base attributes: its name in files, its name in the interface, and the unit of its error.
const WORDS: [(&str, &str, &str); 5] = [
    ("means", "mean", "scene units"),
    ("quats", "rotation", "radians"),
    ("log_scales", "scale", "of the natural logarithm"),
    ("logit_opacities", "opacity", "of 1"),
    ("colors", "color", "of 1"),
];

/// The interface's name of an attribute, from its name in files.
pub fn word(name: &str) -> &str {
    WORDS.iter().find(|(of, ..)| *of == name).map_or(name, |(_, word, _)| word)
}

/// Unit of an attribute's error.
pub fn unit(name: &str) -> &'static str {
    WORDS.iter().find(|(of, ..)| *of == name).map_or("of the stored value", |(.., unit)| unit)
}

/// Formats an error in a fixed width, such as `1.234e-3`.
pub fn show(error: f64) -> String {
    if error == 0.0 { "0".into() } else { format!("{error:.3e}") }
}

/// Bounds on errors, such as `mean=0.001,rotation=0.01`; stored under the names in files.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds(pub Vec<(String, f64)>);

impl FromStr for Bounds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || {
            let words: Vec<&str> = WORDS.iter().map(|(_, word, _)| *word).collect();
            format!("expected ATTRIBUTE=ERROR,... of {}, sh1, ... and a number above 0, each once", words.join(", "))
        };
        let mut bounds: Vec<(String, f64)> = Vec::new();
        for part in text.split(',') {
            let (name, error) = part.split_once('=').ok_or_else(expected)?;
            let known = WORDS.iter().find(|(_, word, _)| *word == name).map_or(name, |(name, ..)| name);
            let error = error.parse().ok().filter(|e: &f64| e.is_finite() && *e > 0.0).ok_or_else(expected)?;
            if known.is_empty() || bounds.iter().any(|(of, _)| of == known) {
                return Err(expected());
            }
            bounds.push((known.to_owned(), error));
        }
        Ok(Self(bounds))
    }
}

/// Prints the errors that a file declares; prints nothing if it declares none.
pub fn print(declared: &[(String, f32)]) -> anyhow::Result<()> {
    if !declared.is_empty() {
        say("attribute        largest error")?;
    }
    declared.iter().try_for_each(|(name, error)| {
        say(&format!("{:<15}  {:>13}  {}", word(name), show(f64::from(*error)), unit(name)))
    })
}

/// The errors as JSON, under the names in files.
pub fn machine_readable<E: Copy + Into<f64>>(errors: &[(String, E)]) -> Value {
    errors.iter().map(|(name, error)| (name.clone(), json!((*error).into()))).collect::<Map<_, _>>().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_read_or_refused() {
        let bounds = |text: &str| text.parse::<Bounds>().map(|bounds| bounds.0);
        let expected = vec![("means".to_owned(), 0.001), ("quats".to_owned(), 0.02), ("sh1".to_owned(), 3.0)];
        assert_eq!(bounds("mean=0.001,quats=2e-2,sh1=3"), Ok(expected));
        for wrong in ["", "mean", "mean=", "mean=0", "mean=-1", "mean=nan", "=1", "mean=1,", "mean=1,means=2"] {
            let message = bounds(wrong).unwrap_err();
            assert!(message.starts_with("expected ATTRIBUTE=ERROR,... of mean, rotation,"), "{wrong}: {message}");
        }
    }

    #[test]
    fn errors_are_said_in_words() {
        assert_eq!((word("quats"), unit("quats"), word("sh2")), ("rotation", "radians", "sh2"));
        assert_eq!([0.0, 0.001_234_5, 12.0].map(show), ["0", "1.234e-3", "1.200e1"]);
    }
}

//! The captures of `captures.toml`, and variants.

use std::convert::Infallible;
use std::str::FromStr;

use serde::Deserialize;

/// A capture, and the part of it that is trained.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureEntry {
    /// As the table calls it.
    pub name: String,
    /// In the folder of captures.
    pub folder: Option<String>,
    /// Seed of `tcgs demo`, where that makes the capture.
    pub demo_seed: Option<u64>,
    /// Keep every n-th frame.
    pub every: Option<usize>,
    /// Whether `tcgs prepare` makes the capture.
    #[serde(default)]
    pub prepare: bool,
    /// Option of `tcgs train`.
    pub frames: Option<String>,
    /// Likewise.
    #[serde(default = "one")]
    pub downscale: usize,
    /// Likewise.
    pub iterations: String,
    /// Stride of the training cameras that are trained with.
    pub r#use: Option<usize>,
    /// Places of these in the sorted names of all cameras, test cameras included; instead of `use`.
    pub views: Option<Vec<usize>>,
    /// Whether `tcgs prepare` makes the initial points of the images of these cameras.
    #[serde(default)]
    pub points_from_images: bool,
    /// Names of the cameras that judge.
    pub hold_out: Vec<String>,
    /// Whether the short form has it.
    #[serde(default)]
    pub short: bool,
}

fn one() -> usize {
    1
}

/// A list of captures.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum List {
    /// captures.toml: on which settings are chosen
    Captures,
    /// few.toml: few cameras
    Few,
}

impl List {
    /// Its captures, in the order of the file.
    pub fn entries(self) -> anyhow::Result<Vec<CaptureEntry>> {
        #[derive(Deserialize)]
        struct File {
            captures: Vec<CaptureEntry>,
        }
        let text = match self {
            Self::Captures => include_str!("../../captures.toml"),
            Self::Few => include_str!("../../few.toml"),
        };
        Ok(toml::from_str::<File>(text)?.captures)
    }
}

/// Options that are compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variant {
    /// As the table calls it.
    pub name: String,
    /// Options of `tcgs train`.
    pub train: Vec<String>,
    /// Options of `tcgs compress`.
    pub compress: Vec<String>,
}

impl FromStr for Variant {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        let (name, options) = text.split_once(':').unwrap_or((text, ""));
        let mut parts = options.split_whitespace().map(str::to_owned);
        let train = parts.by_ref().take_while(|part| part != "/").collect();
        Ok(Self { name: name.trim().into(), train, compress: parts.collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_are_options_of_two_commands() {
        let parsed: Variant = "less: --set weights.mask=0.01 / --quality -1".parse().unwrap();
        assert_eq!(parsed.train, ["--set", "weights.mask=0.01"]);
        assert_eq!(parsed.compress, ["--quality", "-1"]);
        let plain: Variant = "default".parse().unwrap();
        assert!(plain.train.is_empty() && plain.compress.is_empty());
    }

    #[test]
    fn captures_have_names_of_their_own() {
        for list in [List::Captures, List::Few] {
            let captures = list.entries().unwrap();
            let names: std::collections::BTreeSet<&str> = captures.iter().map(|entry| entry.name.as_str()).collect();
            assert_eq!(names.len(), captures.len());
            assert!(captures.iter().all(|entry| entry.folder.is_some() != entry.demo_seed.is_some()));
            assert!(captures.iter().all(|entry| entry.views.is_none() || entry.r#use.is_none()));
        }
    }
}

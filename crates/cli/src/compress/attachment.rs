//! Application data that `tcgs compress --attach` puts into a file (`docs/FORMAT.md`, "Application data").

use std::path::{Path, PathBuf};
use std::str::FromStr;

use tcgs_core::read_file;

use crate::error::wrong_input;

/// Data on which the format agrees, without the prefix of their names; all but sound are JSON.
const AGREED: [&str; 7] = ["credits", "units", "light", "paths", "labels", "sound", "times"];
/// The prefix, which is kept for the format.
const PREFIX: &str = "tcgs.";
/// Most bytes of the data of one name, which every reader of the file holds.
const MAX_BYTES: u64 = 1 << 28;
/// Every stream of Ogg begins so.
const OGG: &[u8] = b"OggS";

/// A name and the file with the data.
#[derive(Clone, Debug)]
pub struct Attachment {
    name: String,
    path: PathBuf,
}

impl FromStr for Attachment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').filter(|(name, path)| !name.is_empty() && !path.is_empty());
        let (name, path) = parts.ok_or("expected NAME=FILE, such as credits=credits.json")?;
        let short = name.strip_prefix(PREFIX).unwrap_or(name);
        let is_agreed = AGREED.contains(&short);
        if !is_agreed && name.starts_with(PREFIX) {
            return Err(format!("names that begin with {PREFIX} are those of the format: {}", AGREED.join(", ")));
        }
        if !is_agreed && !name.contains('.') {
            return Err(format!(
                "expected {}, or a name that begins with that of an application, such as myapp.notes",
                AGREED.join(", ")
            ));
        }
        let name = if is_agreed { format!("{PREFIX}{short}") } else { name.into() };
        Ok(Self { name, path: path.into() })
    }
}

impl Attachment {
    /// The file with the data.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Name and content, as the format wants them.
    pub fn read(&self) -> anyhow::Result<(String, Vec<u8>)> {
        let path = self.path.display();
        let data = read_file(&self.path, MAX_BYTES)
            .map_err(|error| wrong_input(format!("{path}: {error}, expected a file to attach")))?;
        match self.name.strip_prefix(PREFIX) {
            Some("sound") if !data.starts_with(OGG) => {
                Err(wrong_input(format!("{path}: no Ogg stream, expected Opus in Ogg")))
            }
            Some(json) if json != "sound" => match serde_json::from_slice::<serde_json::Value>(&data) {
                Ok(value) if value.is_object() => Ok((self.name.clone(), data)),
                Ok(_) => Err(wrong_input(format!(
                    "{path}: no JSON object, expected one as docs/FORMAT.md says of {}",
                    self.name
                ))),
                Err(error) => {
                    Err(wrong_input(format!("{path}: {error}, expected JSON as docs/FORMAT.md says of {}", self.name)))
                }
            },
            _ => Ok((self.name.clone(), data)),
        }
    }
}

//! The record of a call, `make.json`: options, chosen settings, and finished steps.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tcgs_core::read_text;
use tcgs_interchange::{create_folders, parent_folder};

use super::budget::Plan;
use crate::error::wrong_input;
use crate::output::write_file;
use crate::scene::unreadable;

/// Name of the record.
const FILE: &str = "make.json";
/// Largest record that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// Entries of the folder that a call writes, the record last.
const OURS: [&str; 9] =
    ["capture", "run", "speed", "sound.ogg", "prepare.json", "train.json", "compress.json", "report.html", FILE];

#[derive(Debug, Default, Deserialize, Serialize)]
struct Stored {
    /// Options of the command line.
    choices: Value,
    /// The training that was chosen.
    plan: Option<Plan>,
    /// Remarks by subject.
    notes: BTreeMap<String, String>,
    /// The commands, in order.
    steps: Vec<Step>,
}

/// A command that was run.
#[derive(Debug, Deserialize, Serialize)]
pub struct Step {
    pub name: String,
    /// The command as a shell takes it.
    pub command: String,
    /// Time that it took; none before its end.
    pub seconds: Option<f64>,
}

/// The record of this call and of the interrupted ones before it.
#[derive(Debug)]
pub struct Record {
    path: PathBuf,
    stored: Stored,
    /// Time of the steps that earlier calls finished.
    before: Duration,
}

impl Record {
    /// Reads the record of an earlier call with the same choices, or begins one. Nothing is written before the first
    /// step.
    ///
    /// - `force`: whether the results of an earlier call are removed first
    pub fn begin(folder: &Path, choices: &Value, force: bool) -> anyhow::Result<Self> {
        let path = folder.join(FILE);
        let is_ours = path.is_file();
        let is_empty = fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none());
        if !is_ours && !is_empty {
            let problem = "is not empty and was not made by tcgs make, expected another --out";
            return Err(wrong_input(format!("{}: {problem}", folder.display())));
        }
        if is_ours && !force {
            let text = read_text(&path, MAX_BYTES).map_err(|error| unreadable(&path, error, "the record of a call"))?;
            let stored: Stored = serde_json::from_str(&text)
                .map_err(|error| wrong_input(format!("{}: {error}, expected the record of a call", path.display())))?;
            if let Some(key) = first_difference(&stored.choices, choices) {
                let [was, is] = [&stored.choices, choices].map(|choices| &choices[key]);
                let expected = "expected the same command, another --out, or --force to start over";
                return Err(wrong_input(format!("{}: {key} was {was}, found {is}, {expected}", path.display())));
            }
            let before = Duration::from_secs_f64(stored.steps.iter().filter_map(|step| step.seconds).sum());
            return Ok(Self { path, stored, before });
        }
        for name in OURS {
            let old = folder.join(name);
            let removed = if old.is_dir() { fs::remove_dir_all(&old) } else { fs::remove_file(&old) };
            match removed {
                Err(error) if old.symlink_metadata().is_ok() => {
                    return Err(error).with_context(|| format!("removing {}", old.display()));
                }
                _ => {}
            }
        }
        let stored = Stored { choices: choices.clone(), ..Stored::default() };
        Ok(Self { path, stored, before: Duration::ZERO })
    }

    /// Whether a step was begun, now or by an earlier call.
    pub fn has_begun(&self, name: &str) -> bool {
        self.steps().iter().any(|step| step.name == name)
    }

    /// Whether a step is finished.
    pub fn is_done(&self, name: &str) -> bool {
        self.steps().iter().any(|step| step.name == name && step.seconds.is_some())
    }

    pub fn steps(&self) -> &[Step] {
        &self.stored.steps
    }

    pub fn begin_step(&mut self, name: &str, command: &str) -> anyhow::Result<()> {
        self.stored.steps.retain(|step| step.name != name);
        self.stored.steps.push(Step { name: name.into(), command: command.into(), seconds: None });
        self.write()
    }

    pub fn end_step(&mut self, name: &str, took: Duration) -> anyhow::Result<()> {
        for step in self.stored.steps.iter_mut().filter(|step| step.name == name) {
            step.seconds = Some(took.as_secs_f64());
        }
        self.write()
    }

    pub fn plan(&self) -> Option<Plan> {
        self.stored.plan.clone()
    }

    pub fn set_plan(&mut self, plan: &Plan) -> anyhow::Result<()> {
        self.stored.plan = Some(plan.clone());
        self.write()
    }

    /// Remarks, in the order of their subjects.
    pub fn notes(&self) -> impl Iterator<Item = &str> {
        self.stored.notes.values().map(String::as_str)
    }

    pub fn note(&mut self, subject: &str, text: &str) -> anyhow::Result<()> {
        self.stored.notes.insert(subject.into(), text.into());
        self.write()
    }

    /// Time of the steps that earlier calls finished.
    pub fn before(&self) -> Duration {
        self.before
    }

    /// Time of every finished step, seconds.
    pub fn seconds(&self) -> Value {
        let finished = self.steps().iter().filter_map(|step| Some((step.name.clone(), step.seconds?.into())));
        Value::Object(finished.collect())
    }

    fn write(&self) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(&self.stored).context("writing JSON")?;
        let folder = parent_folder(&self.path);
        create_folders(folder).with_context(|| format!("creating {}", folder.display()))?;
        write_file(&self.path, format!("{text}\n").as_bytes(), true)
    }
}

/// The first key whose values differ.
fn first_difference<'a>(stored: &Value, asked: &'a Value) -> Option<&'a str> {
    asked.as_object()?.iter().find(|(key, value)| stored.get(key) != Some(value)).map(|(key, _)| key.as_str())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_call_goes_on_with_the_same_choices_alone() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("film");
        let choices = json!({ "source": "/videos", "time_seconds": 60.0 });
        let mut record = Record::begin(&place, &choices, false).unwrap();
        record.begin_step("prepare", "tcgs prepare").unwrap();
        record.end_step("prepare", Duration::from_secs(7)).unwrap();
        record.begin_step("train", "tcgs train").unwrap();

        let again = Record::begin(&place, &choices, false).unwrap();
        assert!(again.is_done("prepare") && again.has_begun("train") && !again.is_done("train"));
        assert_eq!((again.before(), again.has_begun("compress")), (Duration::from_secs(7), false));

        let other = json!({ "source": "/videos", "time_seconds": 90.0 });
        let error = Record::begin(&place, &other, false).unwrap_err().to_string();
        assert!(error.contains("time_seconds was 60.0, found 90.0, expected the same command"), "{error}");
        fs::write(place.join("notes.txt"), "mine").unwrap();
        assert!(!Record::begin(&place, &other, true).unwrap().has_begun("prepare"));
        assert!(place.join("notes.txt").exists());
    }

    #[test]
    fn a_folder_of_others_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("run")).unwrap();
        for force in [false, true] {
            let error = Record::begin(folder.path(), &json!({}), force).unwrap_err().to_string();
            assert!(error.contains("was not made by tcgs make"), "{error}");
        }
        assert!(folder.path().join("run").exists());
    }
}

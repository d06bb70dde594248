//! The steps of one row: making a capture, training a run, compressing a file, measuring it. Each is a command of the
//! program.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::Context;
use serde_json::{Value, json};
use tcgs_capture::{Capture, Split};
use tcgs_core::natural_key;
use tcgs_interchange::{Existing, write_whole};
use tcgs_pipeline::{OpenScene, OpenSettings};

use super::measure::measure;
use super::plan::{CaptureEntry, Variant};
use crate::program::{Program, run};
use crate::slug;

/// Where everything lies.
pub struct Place {
    /// Folder of the captures.
    pub data: PathBuf,
    /// Folder for what is made.
    pub out: PathBuf,
    /// The program that runs every step.
    pub program: Program,
    /// Whether test cameras judge instead of training cameras that were left out.
    pub judged_by_test: bool,
}

impl Place {
    /// The measurements of a capture with a variant; made now if they are missing.
    pub fn measured(&self, entry: &CaptureEntry, variant: &Variant) -> anyhow::Result<Value> {
        let judges = if self.judged_by_test { "test" } else { "held-out" };
        let folder = self.out.join(slug(&entry.name)).join(judges).join(slug(&variant.name));
        let arguments = json!([variant.train, variant.compress, entry.iterations, entry.frames, entry.hold_out]);
        let result = folder.join("result.json");
        if let Ok(text) = fs::read_to_string(&result) {
            let found: Value = serde_json::from_str(&text).with_context(|| result.display().to_string())?;
            anyhow::ensure!(found["arguments"] == arguments, "{}: made by other arguments", result.display());
            return Ok(found);
        }
        fs::create_dir_all(&folder)?;
        let capture = self.capture(entry)?;
        let (run, scene) = (folder.join("run"), folder.join("scene.tcgs"));
        let (hold_out, judges) = self.cameras(entry, &capture)?;
        let mut train = words(&["train", text(&capture)?, "--out", text(&run)?, "--resume"]);
        train.extend(words(&["--iterations", &entry.iterations, "--downscale", &entry.downscale.to_string()]));
        if let Some(frames) = &entry.frames {
            train.extend(words(&["--frames", frames]));
        }
        if !hold_out.is_empty() {
            train.extend(words(&["--hold-out", &hold_out.join(",")]));
        }
        if entry.points_from_images {
            let points = folder.join("points.npz");
            let prepare =
                ["prepare", text(&capture)?, "--points-only", text(&points)?, "--hold-out", &hold_out.join(",")];
            self.run(&folder, "prepare", &words(&[&prepare[..], &["--force"]].concat()))?;
            train.extend(words(&["--points", text(&points)?]));
        }
        train.extend_from_slice(&variant.train);
        let train_secs = self.run(&folder, "train", &train)?;
        let mut compress = words(&["compress", text(&run)?, "--out", text(&scene)?, "--force"]);
        compress.extend_from_slice(&variant.compress);
        let compress_secs = self.run(&folder, "compress", &compress)?;
        let cameras = match judges.as_slice() {
            _ if self.judged_by_test => "test".into(),
            [] => "train".into(),
            names => names.join(","),
        };
        let eval = words(&["eval", text(&scene)?, "--capture", text(&capture)?, "--cameras", &cameras]);
        self.run(&folder, "eval", &eval)?;
        let read = |name: &str| -> anyhow::Result<Value> {
            Ok(serde_json::from_str(&fs::read_to_string(folder.join(name).with_extension("json"))?)?)
        };
        let capture = Capture::open(&capture)?;
        // A camera that judges is never a training camera, whatever else the run left out.
        let seen_by = if hold_out.is_empty() { capture.clone() } else { capture.with_test_cameras(&hold_out)? };
        let judge = match judges.as_slice() {
            [] => capture.clone(),
            names => capture.with_test_cameras(names)?,
        };
        let split = if cameras == "train" { Split::Train } else { Split::Test };
        let scene = OpenScene::open(&scene, OpenSettings::default())?;
        let more = measure(&scene, &seen_by, &judge, split)?;
        let found = json!({
            "arguments": arguments,
            "eval": without_images(read("eval")?),
            "num_gaussians": scene.num_identities(),
            "seconds": { "train": train_secs, "compress": compress_secs },
            "more": more,
        });
        write_whole(&result, Existing::Replace, |file| {
            use std::io::Write;
            writeln!(file, "{found:#}")
        })?;
        Ok(found)
    }

    /// The cameras that are not trained with, and those that judge.
    fn cameras(&self, entry: &CaptureEntry, capture: &Path) -> anyhow::Result<(Vec<String>, Vec<String>)> {
        let judges = if self.judged_by_test { vec![] } else { entry.hold_out.clone() };
        let capture = Capture::open_unseen(capture)?;
        let all = capture.camera_names(Split::Train, 0)?;
        let used: Vec<String> = match (&entry.views, entry.r#use) {
            (Some(views), _) => {
                let mut sorted = [all.clone(), capture.camera_names(Split::Test, 0)?].concat();
                sorted.sort_by_cached_key(|name| natural_key(name));
                let named = |&view: &usize| sorted.get(view).cloned();
                views.iter().map(named).collect::<Option<_>>().context("views: the capture has fewer cameras")?
            }
            (None, Some(stride)) => all.iter().step_by(stride).cloned().collect(),
            (None, None) => return Ok((judges.clone(), judges)),
        };
        let is_left_out = |name: &String| !used.contains(name) || judges.contains(name);
        Ok((all.into_iter().filter(is_left_out).collect(), judges))
    }

    /// The capture's folder, made if it has to be.
    fn capture(&self, entry: &CaptureEntry) -> anyhow::Result<PathBuf> {
        let given = match (&entry.folder, entry.demo_seed) {
            (Some(folder), _) => self.data.join(folder),
            (None, seed) => {
                let seed = seed.unwrap_or(0).to_string();
                let demo = self.out.join(format!("demo-{seed}"));
                if !demo.join("report.html").is_file() {
                    self.run(&self.out, "demo", &words(&["demo", "--out", text(&demo)?, "--seed", &seed, "--force"]))?;
                }
                demo.join("capture")
            }
        };
        let made = self.out.join(slug(&entry.name)).join("capture");
        if entry.prepare {
            if !made.join("check.html").is_file() {
                let hold_out = entry.hold_out.iter().flat_map(|name| ["--hold-out", name]);
                let mut prepare = words(&["prepare", text(&given)?, "--out", text(&made)?]);
                if given.join("videos").is_dir() {
                    prepare.extend(words(&hold_out.collect::<Vec<_>>()));
                }
                self.run(&self.out.join(slug(&entry.name)), "prepare", &prepare)?;
            }
            return Ok(made);
        }
        if let Some(every) = entry.every {
            if !made.is_dir() {
                let script = concat!(env!("CARGO_MANIFEST_DIR"), "/scripts/every_nth_frame.py");
                let status = Command::new(script).arg(&given).arg(every.to_string()).arg(&made).status()?;
                anyhow::ensure!(status.success(), "{script}: {status}");
            }
            return Ok(made);
        }
        Ok(given)
    }

    /// Runs the program, with its output in a log; the result is beside it.
    ///
    /// - returns: seconds
    fn run(&self, folder: &Path, step: &str, arguments: &[String]) -> anyhow::Result<f64> {
        eprintln!("tcgs {}", arguments.join(" "));
        let log = folder.join(step).with_extension("log");
        let file = fs::File::create(&log).with_context(|| log.display().to_string())?;
        let json_path = folder.join(step).with_extension("json");
        if json_path.is_file() {
            fs::remove_file(&json_path)?;
        }
        let begin = Instant::now();
        let mut program = Command::new(&self.program.path);
        program.args(arguments).args(["--json", text(&json_path)?]).stdout(file.try_clone()?).stderr(file);
        let status = run(&mut program)?;
        anyhow::ensure!(status.success(), "{step}: {status}, see {}", log.display());
        Ok(begin.elapsed().as_secs_f64())
    }
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|&word| word.to_owned()).collect()
}

fn text(path: &Path) -> anyhow::Result<&str> {
    path.to_str().with_context(|| format!("{}: not a name in UTF-8", path.display()))
}

/// Means alone: a line an image would be most of the result.
fn without_images(mut eval: Value) -> Value {
    if let Some(object) = eval.as_object_mut() {
        object.remove("images");
    }
    eval
}

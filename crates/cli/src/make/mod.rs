//! `tcgs make`: from videos to a scene and a page of results, by the other commands of this program.
//!
//! What lives here: the order of the steps, and the record by which an interrupted call goes on. `budget` fits the
//! training into a time, `sound` takes the sound of the footage, `page` shows the results. What does not: the steps
//! themselves. Each is a command of its own.

mod budget;
mod page;
mod record;
mod sound;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::json;
use tcgs_capture::Capture;
use tcgs_pipeline::{FootageOptions, open_source};

use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::next;
use crate::options::{self, JobOptions};
use crate::output::{check_files, check_folder, show_time, write_file};
use crate::progress::{JobEnd, JobStep};
use crate::terminal::say;

use self::budget::Plan;
use self::record::Record;

/// Make a scene of videos, by one command: capture, training, compressed file, and a page of results
///
/// Runs tcgs prepare, train and compress one after another, and prints each as a command that can be repeated. The
/// scene is OUT. Everything else goes into a folder of the same name without the ending: capture/ with check.html,
/// run/, sound.ogg, make.json with every choice, and report.html.
///
/// The same command goes on after an interruption. Steps that are finished are not repeated.
///
/// Without --time the training takes the iterations of preset fast. With --time it is fitted into the time that
/// preparing leaves, by a short training that measures this machine: three quarters for training, the rest for the
/// refinement of the file. Large images are averaged down, to 960 pixels a row where no GPU computes.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  tcgs make my_videos
  tcgs make my_videos --out juggling.tcgs --time 20m
  tcgs make my_videos --from 12.5 --to 20       a part of long videos, seconds
  tcgs make my_capture                          a capture that tcgs prepare made, or one in a layout that train reads
  tcgs view my_videos_scene.tcgs")]
pub struct Arguments {
    /// Folder of videos, one for each camera, perhaps with a calibration; or a capture
    source: PathBuf,
    /// Scene to write [default: SOURCE_scene.tcgs, beside SOURCE]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Time for everything, such as 20m or 2h
    #[arg(long, value_name = "TIME", value_parser = options::time)]
    time: Option<Duration>,
    /// Videos only: the calibration, if it is not in their folder or there are several
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Videos only: start this many seconds after the moment at which all cameras run
    #[arg(long, value_name = "SECONDS", value_parser = options::seconds)]
    from: Option<f64>,
    /// Videos only: end this many seconds after the moment at which all cameras run
    #[arg(long, value_name = "SECONDS", value_parser = options::seconds)]
    to: Option<f64>,
    /// A camera to hold out from training for measurements; may be given several times [default: every eighth, of fewer
    /// than eight none]
    #[arg(long, value_name = "CAMERA")]
    hold_out: Vec<String>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Number of steps that a user sees.
const NUM_STEPS: usize = 4;

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    // Before anything computes, which would start the threads.
    arguments.job.begin(&[], &[&arguments.source])?;
    let scene = arguments.out.clone().unwrap_or_else(|| beside(&arguments.source));
    if scene.extension().is_none_or(|ending| ending != "tcgs") {
        return Err(wrong_input(format!("{}: expected NAME.tcgs for the scene", scene.display())));
    }
    let folder = scene.with_extension("");
    check_folder(&folder, &[&arguments.source])?;
    let footage = FootageOptions {
        calibration: arguments.calibration.clone(),
        from_secs: arguments.from,
        to_secs: arguments.to,
        ..FootageOptions::default()
    };
    let is_footage = footage.is_footage(&arguments.source)?;
    if !is_footage {
        open_source(&arguments.source)?;
    }
    let record = Record::begin(&folder, &arguments.choices(), arguments.job.force)?;
    // A scene of an earlier call is this command's own; any other is not.
    let force = arguments.job.force || record.has_begun("compress");
    check_files(&[&scene], &[&arguments.source], force)?;
    next::be_silent();
    let mut making = Making { arguments, scene, folder, is_footage, record, begin: Instant::now() };
    making.prepare()?;
    let plan = making.plan()?;
    making.train(&plan)?;
    making.compress()?;
    making.show(&plan)
}

/// The default name of a source's scene.
fn beside(source: &Path) -> PathBuf {
    let name = source.canonicalize().ok().and_then(|source| Some(source.file_name()?.to_string_lossy().into_owned()));
    let name = name.map_or("scene".into(), |name| format!("{name}_scene"));
    source.with_file_name(format!("{name}.tcgs"))
}

impl Arguments {
    /// Options that must be the same for a call to go on after an interruption.
    fn choices(&self) -> serde_json::Value {
        json!({
            "source": self.source.canonicalize().unwrap_or_else(|_| self.source.clone()).display().to_string(),
            "time_seconds": self.time.map(|time| time.as_secs_f64()),
            "calibration": self.calibration.as_ref().map(|path| path.display().to_string()),
            "from_seconds": self.from,
            "to_seconds": self.to,
            "hold_out": self.hold_out,
            "seed": self.job.seed,
        })
    }
}

/// A call in progress.
struct Making<'a> {
    arguments: &'a Arguments,
    scene: PathBuf,
    folder: PathBuf,
    is_footage: bool,
    record: Record,
    begin: Instant,
}

impl Making<'_> {
    /// The capture to train on: the source itself if that has points.
    fn capture(&self) -> anyhow::Result<PathBuf> {
        let source = &self.arguments.source;
        let is_ready = !self.is_footage && Capture::open_unseen(source)?.has_points();
        Ok(if is_ready { source.clone() } else { self.folder.join("capture") })
    }

    /// Begins a step that a user sees: progress shows the time for everything.
    ///
    /// - `rest`: expected time of the steps after it; none if that is unknown
    fn begin_step(&self, number: usize, rest: Option<Duration>) {
        let left = self.arguments.time.map(|time| time.saturating_sub(self.elapsed()));
        let end = match (left, rest) {
            (Some(left), _) => JobEnd::At(Instant::now() + left),
            (None, Some(rest)) => JobEnd::After(rest),
            (None, None) => JobEnd::Unknown,
        };
        JobStep { number, of: NUM_STEPS, end }.begin();
    }

    fn prepare(&mut self) -> anyhow::Result<()> {
        let arguments = self.arguments;
        self.begin_step(1, None);
        let capture = self.capture()?;
        if capture == arguments.source {
            return say(&format!("1/{NUM_STEPS}  {} is a capture with points", capture.display()));
        }
        let mut words = vec!["prepare".into(), arguments.source.as_os_str().into()];
        words.extend(["--out".into(), capture.into_os_string()]);
        let numbers = [("--from", arguments.from), ("--to", arguments.to)];
        words.extend(
            numbers.into_iter().filter_map(|(name, secs)| Some([name.into(), secs?.to_string().into()])).flatten(),
        );
        if let Some(calibration) = &arguments.calibration {
            words.extend(["--calibration".into(), calibration.as_os_str().into()]);
        }
        if self.is_footage {
            words.extend(arguments.hold_out.iter().flat_map(|name| ["--hold-out".into(), name.into()]));
        }
        self.step(1, "prepare", words)
    }

    /// The training that fits the machine and the time. A call that goes on takes it from the record.
    fn plan(&mut self) -> anyhow::Result<Plan> {
        if let Some(plan) = self.record.plan() {
            return Ok(plan);
        }
        let arguments = self.arguments;
        self.begin_step(2, None);
        say(&format!("2/{NUM_STEPS}  measuring the speed of training on this machine"))?;
        let backend = arguments.backend.open(BackendName::Auto)?;
        let left = arguments.time.map(|time| time.saturating_sub(self.elapsed()));
        let plan = Plan::make(&Capture::open(&self.capture()?)?, &backend, &self.folder.join("speed"), left)?;
        for line in plan.lines() {
            say(&line)?;
        }
        self.record.set_plan(&plan)?;
        Ok(plan)
    }

    fn train(&mut self, plan: &Plan) -> anyhow::Result<()> {
        let mut words = vec!["train".into(), self.capture()?.into_os_string()];
        words.extend(["--out".into(), self.folder.join("run").into_os_string()]);
        words.extend(plan.options().into_iter().map(Into::into));
        if !self.is_footage && !self.arguments.hold_out.is_empty() {
            words.extend(["--hold-out".into(), self.arguments.hold_out.join(",").into()]);
        }
        words.push("--resume".into());
        words.extend(self.arguments.backend.words());
        self.begin_step(2, Some(plan.after_training()));
        self.step(2, "train", words)
    }

    fn compress(&mut self) -> anyhow::Result<()> {
        let arguments = self.arguments;
        let mut words = vec!["compress".into(), self.folder.join("run").into_os_string()];
        words.extend(["--out".into(), self.scene.clone().into_os_string()]);
        if let Some(time) = arguments.time {
            // The page takes the last part.
            let left = time.mul_f64(budget::END_OF_REFINEMENT).saturating_sub(self.elapsed());
            let secs = left.as_secs_f64().max(budget::MIN_REFINEMENT_SECS);
            words.extend(["--refine".into(), format!("{secs:.0}s").into()]);
        }
        if let Some(sound) = self.sound()? {
            let mut attached = OsString::from("sound=");
            attached.push(sound);
            words.extend(["--attach".into(), attached]);
        }
        words.extend(arguments.backend.words());
        if self.record.has_begun("compress") || arguments.job.force {
            words.push("--force".into());
        }
        self.begin_step(3, Some(Duration::ZERO));
        self.step(3, "compress", words)
    }

    /// The file of the footage's sound, which is made unless an earlier call has made it.
    fn sound(&mut self) -> anyhow::Result<Option<PathBuf>> {
        let file = self.folder.join("sound.ogg");
        if !self.record.is_done("compress") && !file.exists() {
            let line = sound::take(&self.folder.join("capture"), &file)?;
            say(&line)?;
            self.record.note("sound", &line)?;
        }
        Ok(Some(file).filter(|file| file.exists()))
    }

    fn show(&mut self, plan: &Plan) -> anyhow::Result<()> {
        self.begin_step(4, Some(Duration::ZERO));
        say(&format!("4/{NUM_STEPS}  measuring, and the page of results"))?;
        let file = self.folder.join("report.html");
        let results =
            page::make(&self.folder, &self.capture()?, &self.scene, &self.record, plan, &self.arguments.backend)?;
        write_file(&file, results.html.as_bytes(), true)?;
        say(&results.line)?;
        say(&format!("open {}", file.display()))?;
        say(&format!("next: tcgs view {}", next::quoted(&self.scene)))?;
        let text = |path: &Path| path.display().to_string();
        self.arguments.job.write_json(&json!({
            "scene": text(&self.scene),
            "report": text(&file),
            "bytes": results.bytes,
            "psnr": results.psnr,
            "held_out": results.held_out,
            "seconds": self.record.seconds(),
        }))
    }

    /// Runs a command of this program, unless the record says that it is done.
    fn step(&mut self, number: usize, name: &'static str, mut words: Vec<OsString>) -> anyhow::Result<()> {
        if self.record.is_done(name) {
            return say(&format!("{number}/{NUM_STEPS}  {name}: done before"));
        }
        let job = &self.arguments.job;
        let options =
            [("--seed", job.seed.map(|seed| seed.to_string())), ("--threads", job.threads.map(|n| n.to_string()))];
        words.extend(options.into_iter().filter_map(|(name, value)| Some([name.into(), value?.into()])).flatten());
        let json = self.folder.join(format!("{name}.json"));
        // An interrupted call may have left it.
        let _ = std::fs::remove_file(&json);
        words.extend(["--json".into(), json.into_os_string()]);
        let shown: Vec<String> = words.iter().map(|word| next::word(&word.to_string_lossy())).collect();
        let line = format!("tcgs {}", shown.join(" "));
        say(&format!("{number}/{NUM_STEPS}  {line}"))?;
        self.record.begin_step(name, &line)?;
        let start = Instant::now();
        crate::run(crate::command(words)?)?;
        self.record.end_step(name, start.elapsed())?;
        let left = self.arguments.time.map(|time| time.saturating_sub(self.elapsed()));
        say(&match left {
            Some(left) => format!("{name} took {}, {} left", show_time(start.elapsed()), show_time(left)),
            None => format!("{name} took {}", show_time(start.elapsed())),
        })
    }

    /// Time since the beginning, and of the steps of earlier calls.
    fn elapsed(&self) -> Duration {
        self.begin.elapsed() + self.record.before()
    }
}

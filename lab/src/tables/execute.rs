//! Runs the missing steps of a plan. Each step is a command of `tcgs` that a person can type.
//!
//! `OUT/runs/SCENE/RUN/` holds `train/`, a run folder; `train.json`, its result; `steps.jsonl`, a line for every start
//! of training; and a folder for each measurement. `result.json` in it is written last: if it exists, the measurement
//! is done. Two processes take turns at a run.

use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, bail};
use serde_json::{Map, Value, json};
use tcgs_interchange::{Existing, write_whole};

use super::analysis;
use super::plan::{Job, Measure};
use crate::COMMAND;
use crate::error::wrong_input;
use crate::program::{Program, run as run_step};

/// Name of the result in a measurement's folder.
const RESULT: &str = "result.json";

/// Locations of captures, runs and results, and the execution of steps.
#[derive(Clone, Debug)]
pub struct Workplace {
    /// Folder of the captures, with a folder for each scene.
    pub data: PathBuf,
    /// Folder for all output.
    pub out: PathBuf,
    /// Arguments of `tcgs train` and `tcgs eval` that choose CPU or GPU.
    pub backend: Vec<String>,
    /// Arguments of every step that choose its threads; results do not depend on them.
    pub threads: Vec<String>,
    /// Whether to repeat runs that were made by other arguments.
    pub force: bool,
    /// The arguments that a person types for this table, without `--only`.
    pub command: Vec<String>,
    /// The program that runs every step.
    pub program: Program,
}

impl Workplace {
    fn folder(&self, job: &Job) -> PathBuf {
        self.out.join("runs").join(&job.scene).join(&job.run)
    }

    /// A measurement's output for drawing.
    pub fn drawable(&self, job: &Job, measure: &str) -> PathBuf {
        let folder = self.folder(job);
        let what = &job.measures[measure];
        match (what.export, &what.compress) {
            (true, _) => folder.join(measure).join("params.npz"),
            (_, Some(_)) => folder.join(measure).join("scene.tcgs"),
            _ => folder.join("train"),
        }
    }

    /// The capture of a scene.
    pub fn capture(&self, scene: &str) -> PathBuf {
        self.data.join(scene)
    }

    /// The result of a measurement, if it is done.
    ///
    /// # Errors
    /// If it was made by other arguments.
    pub fn result(&self, job: &Job, measure: &str) -> anyhow::Result<Option<Value>> {
        let path = self.folder(job).join(measure).join(RESULT);
        if !path.is_file() {
            return Ok(None);
        }
        let text = fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        let result: Value = serde_json::from_str(&text)
            .map_err(|error| wrong_input(format!("{}: {error}, expected a result of this command", path.display())))?;
        let wanted = json!({ "train": job.arguments, "measure": arguments_of(&job.measures[measure]) });
        if result["arguments"] == wanted {
            return Ok(Some(result));
        }
        if self.force {
            return Ok(None);
        }
        Err(other_arguments(&path, &result["arguments"], &wanted))
    }

    /// Whether all measurements of a job are done.
    pub fn is_done(&self, job: &Job) -> anyhow::Result<bool> {
        for measure in job.measures.keys() {
            if self.result(job, measure)?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

fn arguments_of(measure: &Measure) -> Value {
    json!({ "export": measure.export, "compress": measure.compress, "analysis": measure.analysis })
}

fn other_arguments(path: &Path, found: &Value, expected: &Value) -> anyhow::Error {
    let problem = format!("was made by the arguments {found}, expected {expected}");
    wrong_input(format!("{}: {problem}; choose another --out, or --force to make it anew", path.display()))
}

/// Runs steps without a result, one training after another. Trainings that another process works on come last, and are
/// waited for.
///
/// # Errors
/// If a step fails, or if there are results by other arguments. Finished steps stay finished.
pub fn execute(place: &Workplace, jobs: &[Job]) -> anyhow::Result<()> {
    let mut missing = Vec::new();
    for job in jobs {
        if !place.is_done(job)? {
            missing.push(job);
        }
    }
    let begin = Instant::now();
    let total = missing.len();
    let mut taken: Vec<&Job> = Vec::new();
    let mut done = 0;
    for wait in [false, true] {
        let round = if wait { std::mem::take(&mut taken) } else { missing.clone() };
        for job in round {
            let Some(_lock) = lock(&place.folder(job), wait)? else {
                taken.push(job);
                continue;
            };
            // Another process may have finished it meanwhile.
            if !place.is_done(job)? {
                let each = begin.elapsed().as_secs_f64() / f64::from(done.max(1));
                let left = (total - done as usize) as f64 * each;
                let left = if done == 0 { String::new() } else { format!(", about {} left", show_seconds(left)) };
                eprintln!("run {} of {total}: {}{left}", done + 1, job.name());
                run(place, job)?;
            }
            done += 1;
        }
    }
    Ok(())
}

/// Formats a duration, such as `2 h 5 min`.
fn show_seconds(seconds: f64) -> String {
    match (seconds / 60.0).ceil() as u64 {
        minutes if minutes >= 60 => format!("{} h {} min", minutes / 60, minutes % 60),
        minutes => format!("{minutes} min"),
    }
}

/// Locks a folder until the file is dropped; none if another process holds the lock and `wait` is false.
fn lock(folder: &Path, wait: bool) -> anyhow::Result<Option<File>> {
    let path = folder.join("lock");
    fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    let lock = File::create(&path).with_context(|| format!("writing {}", path.display()))?;
    match lock.try_lock() {
        Err(TryLockError::WouldBlock) if !wait => return Ok(None),
        Err(TryLockError::WouldBlock) => {
            eprintln!("{}: waiting for the process that is at it", folder.display());
            lock.lock().with_context(|| format!("locking {}", path.display()))?;
        }
        // Some network drives do not support locks.
        _ => {}
    }
    Ok(Some(lock))
}

fn run(place: &Workplace, job: &Job) -> anyhow::Result<()> {
    let folder = place.folder(job);
    let train = train(place, job, &folder)?;
    for (name, measure) in &job.measures {
        if place.result(job, name)?.is_none() {
            measure_run(place, job, name, measure, &train)?;
        }
    }
    Ok(())
}

/// The result of a training, and its log.
struct Trained {
    result: Value,
    /// An entry for every start of the training.
    steps: Vec<Value>,
}

fn train(place: &Workplace, job: &Job, folder: &Path) -> anyhow::Result<Trained> {
    let (run, json_path, log) = (folder.join("train"), folder.join("train.json"), folder.join("steps.jsonl"));
    let mut steps = read_lines(&log)?;
    let other = steps.iter().find(|step| step["arguments"] != json!(job.arguments));
    if let Some(other) = other
        && !place.force
    {
        return Err(other_arguments(&log, &other["arguments"], &json!(job.arguments)));
    }
    if other.is_some() {
        steps.clear();
        // Removes the run before its log: after an interruption the log still tells by which arguments the run was
        // made.
        if run.exists() {
            fs::remove_dir_all(&run).with_context(|| format!("removing {}", run.display()))?;
        }
        for path in [&json_path, &log] {
            remove(path)?;
        }
    }
    if !json_path.is_file() {
        let mut arguments =
            vec!["train".into(), argument(&place.capture(&job.scene))?, "--out".into(), argument(&run)?];
        arguments.extend_from_slice(&job.arguments);
        // The command that begins the training also resumes it.
        let command = command_line("tcgs", &arguments);
        let step = json!({ "command": command, "arguments": job.arguments, "commit": place.program.commit });
        append_line(&log, &step)?;
        steps.push(step);
        arguments.extend(["--resume".into(), "--json".into(), argument(&json_path)?]);
        arguments.extend_from_slice(&place.backend);
        let advice = "its whole checkpoints are kept, and the same command goes on after them";
        let outcome = step_of(place, arguments, &command, advice);
        if outcome.is_err() && !run.join("config.toml").is_file() {
            // A refused training made nothing by these arguments.
            remove(&log)?;
        }
        outcome?;
    }
    Ok(Trained { result: read_json(&json_path)?, steps })
}

fn measure_run(place: &Workplace, job: &Job, name: &str, measure: &Measure, train: &Trained) -> anyhow::Result<()> {
    let folder = place.folder(job);
    let (run, here) = (folder.join("train"), folder.join(name));
    fs::create_dir_all(&here).with_context(|| format!("creating {}", here.display()))?;
    remove(&here.join(RESULT))?;
    let mut result = Map::new();
    let mut commands: Vec<Value> = train.steps.last().map(|step| step["command"].clone()).into_iter().collect();
    let mut seconds = Map::new();
    let mut step = |step: &str, arguments: Vec<String>, backend: bool| -> anyhow::Result<()> {
        let json_path = here.join(format!("{step}.json"));
        let mut arguments: Vec<String> = std::iter::once(step.to_owned()).chain(arguments).collect();
        let command = command_line("tcgs", &arguments);
        arguments.extend(["--json".into(), argument(&json_path)?, "--force".into()]);
        if backend {
            arguments.extend_from_slice(&place.backend);
        }
        let begin = Instant::now();
        step_of(place, arguments, &command, "the same command goes on with this step")?;
        seconds.insert(step.into(), json!(begin.elapsed().as_secs_f64()));
        commands.push(json!(command));
        result.insert(step.into(), read_json(&json_path)?);
        Ok(())
    };
    let drawable = place.drawable(job, name);
    if measure.export {
        step("export", vec![argument(&run)?, "--to".into(), argument(&drawable)?], false)?;
    }
    if let Some(more) = &measure.compress {
        let mut arguments = vec![argument(&run)?, "--out".into(), argument(&drawable)?];
        arguments.extend_from_slice(more);
        // A job decides itself whether its file is refined.
        if !more.iter().any(|option| option == "--refine") {
            arguments.extend(["--refine", "off"].map(String::from));
        }
        step("compress", arguments, false)?;
        step("info", vec![argument(&drawable)?], false)?;
    }
    if measure.analysis.is_none() || measure.export || measure.compress.is_some() {
        let capture = argument(&place.capture(&job.scene))?;
        let protocol = ["--protocol".into(), "tc3dgs".into()];
        let arguments = [vec![argument(&drawable)?, "--capture".into(), capture], protocol.to_vec()].concat();
        step("eval", arguments, true)?;
    }
    if let Some(analysis) = &measure.analysis {
        let begin = Instant::now();
        result.insert("analysis".into(), analysis::analyse(analysis, &run)?);
        seconds.insert("analysis".into(), json!(begin.elapsed().as_secs_f64()));
        let only = ["--only".into(), job.name()];
        commands.push(json!(command_line(COMMAND, &[place.command.as_slice(), &only].concat())));
    }
    result.insert("derived".into(), derived(&result));
    let mut commits: Vec<&str> = train.steps.iter().filter_map(|step| step["commit"].as_str()).collect();
    commits.push(&place.program.commit);
    commits.dedup();
    let about = json!({
        "scene": job.scene,
        "run": job.run,
        "measure": name,
        "arguments": { "train": job.arguments, "measure": arguments_of(measure) },
        "commands": commands,
        "commits": commits,
        "seconds": seconds,
        "train": train.result,
    });
    let about = about.as_object().cloned().unwrap_or_default();
    let result = Value::Object(about.into_iter().chain(result).collect());
    write_file(&here.join(RESULT), format!("{result:#}\n").as_bytes())
}

/// Numbers derived from results.
fn derived(result: &Map<String, Value>) -> Value {
    let histogram = &result.get("info").map_or(Value::Null, |info| info["bits_histogram"].clone());
    let (mut bits, mut values) = (0.0, 0.0);
    for attribute in tcgs_core::Attribute::BASE.into_iter().filter(|&a| a != tcgs_core::Attribute::Mean) {
        for (width, count) in histogram[attribute.name()].as_object().into_iter().flatten() {
            let count = count.as_f64().unwrap_or(0.0) * attribute.components() as f64;
            bits += width.parse().unwrap_or(0.0) * count;
            values += count;
        }
    }
    // Bits of floats over stored bits, without positions.
    if values > 0.0 { json!({ "compression": 32.0 * values / bits }) } else { json!({}) }
}

/// Runs the program; its output goes to standard error.
fn step_of(place: &Workplace, arguments: Vec<String>, command: &str, advice: &str) -> anyhow::Result<()> {
    eprintln!("{command}");
    let mut step = Command::new(&place.program.path);
    step.args(&arguments).args(&place.threads).stdin(Stdio::null()).stdout(Stdio::from(io::stderr()));
    match run_step(&mut step)?.code() {
        Some(0) => Ok(()),
        Some(2) => Err(wrong_input(format!("{command}: wrong input, see the line above, expected it to be right"))),
        Some(code) => bail!("{command}: ended with exit code {code}, see the line above; {advice}"),
        None => bail!("{command}: was killed; {advice}"),
    }
}

/// A command for a shell, and for a person.
///
/// - `program`: its words, as a shell takes them
pub fn command_line(program: &str, arguments: &[String]) -> String {
    let quoted = arguments.iter().map(|argument| quoted(argument));
    std::iter::once(program.to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

/// A word for a shell.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "_-./,:=+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.into();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// A path as an argument.
pub fn argument(path: &Path) -> anyhow::Result<String> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| wrong_input(format!("{}: not a name in UTF-8, expected one", path.display())))
}

fn read_json(path: &Path) -> anyhow::Result<Value> {
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))
}

fn read_lines(path: &Path) -> anyhow::Result<Vec<Value>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    // A line cut short belongs to a step that never began.
    Ok(text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
}

fn append_line(path: &Path, line: &Value) -> anyhow::Result<()> {
    let mut log = fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .with_context(|| format!("opening {}", path.display()))?;
    log.write_all(format!("{line}\n").as_bytes()).with_context(|| format!("writing {}", path.display()))
}

/// Writes a file whole or not at all, and replaces an existing one.
pub fn write_file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_whole(path, Existing::Replace, |into| into.write_all(bytes))
        .with_context(|| format!("writing {}", path.display()))
}

fn remove(path: &Path) -> anyhow::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed.with_context(|| format!("removing {}", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_can_be_typed() {
        let words = ["train", "my data", "--set", "a=1", "it's", "{x}", ""].map(str::to_owned);
        assert_eq!(command_line("tcgs", &words), r"tcgs train 'my data' --set a=1 'it'\''s' '{x}' ''");
    }

    #[test]
    fn a_run_has_one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("runs/a/b");
        let first = lock(&place, false).unwrap();
        assert!(first.is_some() && lock(&place, false).unwrap().is_none());
        let waiting = std::thread::spawn({
            let place = place.clone();
            move || lock(&place, true).unwrap().is_some()
        });
        drop(first);
        assert!(waiting.join().unwrap());
    }

    #[test]
    fn bits_are_weighed_by_components() {
        let info = json!({ "bits_histogram": {
            "means": { "16": 10 }, "quats": { "4": 10 }, "log_scales": { "4": 5, "8": 5 },
            "logit_opacities": { "8": 10 }, "colors": { "4": 10 },
        } });
        // Per Gaussian: 4 rotations of 4, 3 scales of 6 on average, an opacity of 8, 3 colours of 4: 54 bits in 11
        // values.
        let derived = derived(&Map::from_iter([("info".to_owned(), info)]));
        assert!((derived["compression"].as_f64().unwrap() - 32.0 * 11.0 / 54.0).abs() < 1e-12);
    }

    #[test]
    fn times_are_short() {
        assert_eq!([30.0, 61.0, 7500.0].map(show_seconds), ["1 min", "2 min", "2 h 5 min"]);
    }
}

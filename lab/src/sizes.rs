//! The experiment `sizes`: time and memory of a training, as images and Gaussians grow in proportion.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::str::FromStr;

use anyhow::Context;
use serde_json::{Value, json};
use tcgs_capture::{SyntheticSettings, write_synthetic};
use tcgs_report::plot::{self, Axes, Line};

use crate::error::wrong_input;
use crate::program::{Program, run_measured};

/// Measure time and memory of a training by the size of its images
///
/// Renders the scene of `tcgs demo` at each size, trains it, and writes OUT/sizes.txt and OUT/sizes.svg. A size that
/// OUT holds is not trained again; its options must be the same.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  cargo run --release -p tcgs-lab -- sizes --out out
  cargo run --release -p tcgs-lab -- sizes --out long --size 1352x1014 --timesteps 20")]
pub struct Arguments {
    /// Folder for captures, runs and the table
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    /// Size of the images, pixels; may be repeated
    #[arg(long, value_name = "WxH", default_values = ["338x254", "676x508", "1352x1014", "1920x1080"])]
    size: Vec<Size>,
    /// Training cameras, at least 4
    #[arg(long, value_name = "N", default_value = "20")]
    cameras: usize,
    /// Timesteps, at least 2
    #[arg(long, value_name = "T", default_value = "4")]
    timesteps: usize,
    /// Initial points for each pixel of an image: 300,000 points at 1352x1014
    #[arg(long, value_name = "SHARE", default_value = "0.2188")]
    density: f64,
    /// Iterations of the first and of every later timestep
    #[arg(long, value_name = "FIRST,REST", default_value = "300,150")]
    iterations: String,
    /// The program [default: tcgs beside this one]
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
}

/// Width and height of an image, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Size(usize, usize);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<(usize, usize)> =
            text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
        match numbers {
            Some((width, height)) if width > 0 && height > 0 => Ok(Self(width, height)),
            _ => Err("expected WIDTHxHEIGHT in pixels, such as 1352x1014".into()),
        }
    }
}

/// A measured training.
struct Row {
    size: Size,
    num_gaussians: u64,
    /// Seconds of the first timestep, and of a later one on average.
    seconds: [f64; 2],
    /// Milliseconds of an iteration, likewise.
    iteration: [f64; 2],
    /// PSNR of the test cameras at the last timestep, dB.
    psnr: f64,
    /// Largest memory of the program, bytes.
    memory: u64,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let Arguments { cameras, timesteps, .. } = arguments;
    if *cameras < 4 || *timesteps < 2 {
        return Err(wrong_input(format!("{cameras} cameras and {timesteps} timesteps, expected at least 4 and 2")));
    }
    let program = Program::find(arguments.program.clone())?;
    let mut sizes = arguments.size.clone();
    sizes.sort_by_key(|&Size(width, height)| width * height);
    let mut rows = Vec::new();
    for size in sizes {
        rows.push(measured(arguments, &program, size)?);
        fs::write(arguments.out.join("sizes.txt"), text(&rows)).context("sizes.txt")?;
        fs::write(arguments.out.join("sizes.svg"), plot(&rows)).context("sizes.svg")?;
    }
    print!("{}", text(&rows));
    Ok(())
}

/// The row of a size; trained now if it is missing.
fn measured(arguments: &Arguments, program: &Program, size: Size) -> anyhow::Result<Row> {
    let Size(width, height) = size;
    let folder = arguments.out.join(format!("{width}x{height}"));
    let [capture, trained, result] = ["capture", "run", "result.json"].map(|name| folder.join(name));
    let Arguments { cameras, timesteps, density, iterations, .. } = arguments;
    let options = format!("--cameras {cameras} --timesteps {timesteps} --density {density} --iterations {iterations}");
    if !result.is_file() {
        let settings = SyntheticSettings {
            width,
            height,
            num_train_cameras: *cameras,
            num_timesteps: *timesteps,
            num_points: ((width * height) as f64 * density).round().max(1.0) as usize,
            ..SyntheticSettings::default()
        };
        write_synthetic(&capture, &settings)?;
        let mut train = Command::new(&program.path);
        train.arg("train").arg(&capture).arg("--out").arg(&trained);
        train.args(["--preset", "fast", "--backend", "cpu", "--force", "--iterations", iterations]);
        train.stdout(fs::File::create(folder.join("train.log"))?);
        eprintln!("training at {width}x{height}");
        let (status, memory) = run_measured(&mut train)?;
        anyhow::ensure!(status.success(), "{width}x{height}: {status}, see {}", folder.join("train.log").display());
        fs::write(&result, json!({ "options": options, "memory": memory }).to_string())?;
    }
    let found: Value = serde_json::from_str(&fs::read_to_string(&result)?).context("result.json")?;
    if found["options"] != options.as_str() {
        let problem = format!("{}: made with {}", folder.display(), found["options"]);
        return Err(wrong_input(format!("{problem}, expected {options}, or another --out")));
    }
    row(size, &trained.join("metrics.jsonl"), found["memory"].as_u64().context("result.json")?)
}

/// The row of a run with at least two timesteps.
fn row(size: Size, metrics: &Path, memory: u64) -> anyhow::Result<Row> {
    let file = fs::read_to_string(metrics).with_context(|| metrics.display().to_string())?;
    let timesteps: Vec<Value> = file.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    let [first, later @ .., last] = timesteps.as_slice() else { anyhow::bail!("{}: too short", metrics.display()) };
    let later: Vec<&Value> = later.iter().chain([last]).collect();
    let sum = |of: &[&Value], key: &str| of.iter().filter_map(|timestep| timestep[key].as_f64()).sum::<f64>();
    let iteration = |of: &[&Value]| 1e3 * sum(of, "seconds") / sum(of, "iterations");
    Ok(Row {
        size,
        num_gaussians: last["num_gaussians"].as_u64().unwrap_or(0),
        seconds: [sum(&[first], "seconds"), sum(&later, "seconds") / later.len() as f64],
        iteration: [iteration(&[first]), iteration(&later)],
        psnr: last["psnr"].as_f64().unwrap_or(f64::NAN),
        memory,
    })
}

impl Row {
    fn pixels(&self) -> f64 {
        (self.size.0 * self.size.1) as f64
    }
}

/// The table, in Markdown.
fn text(rows: &[Row]) -> String {
    let mut text =
        "| images | Gaussians | first timestep, s | its iteration, ms | later timestep, s | its iteration, ms \
                    | ns a pixel | PSNR, dB | memory, MB |\n|---|---|---|---|---|---|---|---|---|\n"
            .to_owned();
    for row in rows {
        let (Size(width, height), [first, later], [of_first, of_later]) = (row.size, row.seconds, row.iteration);
        let [per_first, per_later] = row.iteration.map(|ms| 1e6 * ms / row.pixels());
        text += &format!(
            "| {width}x{height} | {} | {first:.1} | {of_first:.0} | {later:.1} | {of_later:.0} \
             | {per_first:.0}, {per_later:.0} | {:.2} | {:.0} |\n",
            row.num_gaussians,
            row.psnr,
            row.memory as f64 / 1e6,
        );
    }
    text
}

/// Cost by the number of pixels, relative to the smallest images.
fn plot(rows: &[Row]) -> String {
    let axes =
        Axes { x: "pixels of an image".into(), y: "times that of the first size".into(), log_x: true, log_y: true };
    let line = |name: &str, of: fn(&Row) -> f64| Line {
        name: name.into(),
        points: rows.iter().map(|row| (row.pixels(), of(row) / of(&rows[0]))).collect(),
    };
    let all = [
        line("pixels", Row::pixels),
        line("iteration of the first timestep", |row| row.iteration[0]),
        line("later timestep", |row| row.seconds[1]),
        line("memory", |row| row.memory as f64),
    ];
    plot::standalone(&plot::lines("Time and memory by the size of images", &axes, &all))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_two_numbers() {
        assert_eq!("1352x1014".parse(), Ok(Size(1352, 1014)));
        for wrong in ["", "12", "0x4", "4x", "axb", "3x-1"] {
            assert!(wrong.parse::<Size>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn later_timesteps_are_averaged() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let metrics = [(8.0, 100, 50, 20.0), (2.0, 40, 60, 21.0), (4.0, 60, 70, 22.0)];
        let text: String = metrics
            .iter()
            .map(|(seconds, iterations, num_gaussians, psnr)| {
                let line = json!({
                    "seconds": seconds, "iterations": iterations, "num_gaussians": num_gaussians, "psnr": psnr,
                });
                format!("{line}\n")
            })
            .collect();
        fs::write(file.path(), text).unwrap();
        let row = row(Size(20, 10), file.path(), 7_000_000).unwrap();
        assert_eq!((row.num_gaussians, row.psnr, row.seconds, row.iteration), (70, 22.0, [8.0, 3.0], [80.0, 60.0]));
        assert!(super::text(&[row]).ends_with("| 20x10 | 70 | 8.0 | 80 | 3.0 | 60 | 400000, 300000 | 22.00 | 7 |\n"));
    }
}

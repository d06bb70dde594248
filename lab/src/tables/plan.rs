//! Definitions of the paper's tables: files of `lab/tables`, read once and checked.
//!
//! What lives here: the words of those files, and their meaning for the requested scenes and size. Nothing here runs
//! anything.

use std::collections::BTreeMap;

use anyhow::anyhow;
use serde::Deserialize;

use crate::error::wrong_input;

/// All tables: name and file.
const TABLES: [(&str, &str); 14] = [
    ("main", include_str!("../../tables/main.toml")),
    ("panoptic", include_str!("../../tables/panoptic.toml")),
    ("n3dv", include_str!("../../tables/n3dv.toml")),
    ("technicolor", include_str!("../../tables/technicolor.toml")),
    ("ablation", include_str!("../../tables/ablation.toml")),
    ("mask-grid", include_str!("../../tables/mask-grid.toml")),
    ("mask-values", include_str!("../../tables/mask-values.toml")),
    ("bits", include_str!("../../tables/bits.toml")),
    ("keypoints", include_str!("../../tables/keypoints.toml")),
    ("tolerance", include_str!("../../tables/tolerance.toml")),
    ("selection", include_str!("../../tables/selection.toml")),
    ("polynomials", include_str!("../../tables/polynomials.toml")),
    ("pictures", include_str!("../../tables/pictures.toml")),
    ("departures", include_str!("../../tables/departures.toml")),
];
const SHARED: &str = include_str!("../../tables/shared.toml");

/// Length and data of the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Size {
    /// The paper's frames and schedule
    Full,
    /// About a quarter of an hour of training on two cores
    Small,
}

/// `shared.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Shared {
    datasets: BTreeMap<String, Dataset>,
    runs: BTreeMap<String, Vec<String>>,
    measures: BTreeMap<String, Measure>,
    columns: BTreeMap<String, Column>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Dataset {
    scenes: Vec<String>,
    full: Vec<String>,
    small: Vec<String>,
}

/// Measurements of a trained run. Every measurement ends with `eval`, except one that is only an analysis.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measure {
    /// Whether the run is exported as floats, without the Gaussians that its masks switch off.
    #[serde(default)]
    pub export: bool,
    /// Arguments of `tcgs compress`; `None`: the run is not compressed.
    pub compress: Option<Vec<String>>,
    /// Name of an analysis of the run's tracks or masks: `tracks`, `selection`, `polynomials` or `masks`.
    pub analysis: Option<String>,
}

/// A column of a table: one number of every result.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    /// Text in the head of the column.
    pub label: String,
    /// Paths to the number in a result's JSON, such as `eval.psnr`; the first that exists counts.
    pub from: Vec<String>,
    /// Factor between a stored number and the number that is shown, such as 1e-6 from bytes to MB.
    #[serde(default = "one")]
    pub scale: f64,
    /// Digits after the point; `None`: the number is shown with an exponent.
    pub digits: Option<usize>,
}

fn one() -> f64 {
    1.0
}

/// Arrangement of a table's numbers in blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TableLayout {
    /// One block per scene: rows by columns.
    #[default]
    Rows,
    /// One block per column: rows by scenes, and the mean over scenes.
    Scenes,
    /// One block per dataset: rows by columns, each number a mean over the dataset's scenes.
    Means,
}

/// Content of a file `tables/NAME.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Title of the table.
    pub title: String,
    /// The table or figure of the paper that this one reproduces.
    pub paper: String,
    /// Notes below the table: necessary background, and contradictions in the paper.
    pub notes: Vec<String>,
    /// Arrangement of the numbers in blocks.
    #[serde(default)]
    pub layout: TableLayout,
    /// The scenes of the paper's table.
    pub scenes: Vec<String>,
    /// Names of the shown columns, defined in this file or in `tables/shared.toml`.
    #[serde(default)]
    pub show: Vec<String>,
    #[serde(default)]
    columns: BTreeMap<String, Column>,
    /// Arguments of `train` in addition to the dataset's, which they override.
    #[serde(default)]
    full: Vec<String>,
    #[serde(default)]
    small: Vec<String>,
    #[serde(default)]
    runs: BTreeMap<String, Vec<String>>,
    #[serde(default)]
    measures: BTreeMap<String, Measure>,
    /// The rows, one per method.
    #[serde(default)]
    pub rows: Vec<Row>,
    /// Analyses of runs, whose tables and plots are shown after the table.
    #[serde(default)]
    pub analyses: Vec<Row>,
    /// The figures beside the numbers.
    #[serde(default)]
    pub plots: Vec<Plot>,
}

/// A row of a table, or an analysis beside it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Text before the numbers.
    pub label: String,
    /// Name of the measured training; `None` for a method of which only the paper has numbers.
    pub run: Option<String>,
    /// Name of the measurement.
    pub measure: Option<String>,
    /// Abscissa of the row in a [`PlotKind::Sweep`].
    pub x: Option<f64>,
    /// The paper's numbers: by scene, dataset or `mean`, then by column.
    #[serde(default)]
    pub paper: BTreeMap<String, BTreeMap<String, f64>>,
}

/// A figure beside a table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Plot {
    /// Kind of the figure.
    pub kind: PlotKind,
    /// Text above the figure.
    pub title: String,
    /// Column on the abscissa of [`PlotKind::Points`].
    pub x: Option<String>,
    /// Label of the abscissa of a [`PlotKind::Sweep`].
    #[serde(default)]
    pub x_label: String,
    /// Column on the ordinate of points and sweeps.
    pub y: Option<String>,
    /// Whether the abscissa is logarithmic.
    #[serde(default)]
    pub log_x: bool,
}

/// Kinds of figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlotKind {
    /// A mark per row, and marks for the paper's numbers.
    Points,
    /// PSNR at every timestep, a line per row.
    Time,
    /// A column over the rows' abscissa.
    Sweep,
    /// Renders of the rows beside ground truth.
    Pictures,
}

/// A training at one scene with all its measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Name of the scene, and of its capture's folder below `Workplace::data`.
    pub scene: String,
    /// Name of the training.
    pub run: String,
    /// Arguments of `tcgs train`.
    pub arguments: Vec<String>,
    /// Measurements of the training, by name.
    pub measures: BTreeMap<String, Measure>,
}

/// A table, and the jobs for the requested scenes and size.
#[derive(Clone, Debug)]
pub struct TablePlan {
    /// Name of the table, such as `ablation`.
    pub name: String,
    /// Content of the table's file.
    pub table: Table,
    /// The shown columns and their names, in the table's order.
    pub columns: Vec<(String, Column)>,
    /// The scenes, in the table's order.
    pub scenes: Vec<String>,
    /// The trainings and their measurements, in the order in which they are run.
    pub jobs: Vec<Job>,
    shared: Shared,
}

/// All tables with their names.
///
/// # Errors
/// If a file cannot be parsed, which tests rule out.
pub fn tables() -> anyhow::Result<Vec<(&'static str, Table)>> {
    TABLES.iter().map(|&(name, text)| Ok((name, parse(name, text)?))).collect()
}

fn parse<T: serde::de::DeserializeOwned>(name: &str, text: &str) -> anyhow::Result<T> {
    toml::from_str(text).map_err(|error| anyhow!("lab/tables/{name}.toml: {}", error.message()))
}

fn missing(what: &str) -> anyhow::Error {
    anyhow!("{what}: is not defined")
}

/// The plan of a table.
///
/// - `name`: one of [`tables`]
/// - `scenes`: requested scenes, which need not be the paper's; `None` for all of the paper's table
/// - `over`: arguments of `tcgs train` that replace those of the table's files
///
/// # Errors
/// If there is no such table.
pub fn plan(name: &str, scenes: Option<&[String]>, size: Size, over: &[String]) -> anyhow::Result<TablePlan> {
    let Some((_, text)) = TABLES.iter().find(|table| table.0 == name) else {
        let names: Vec<&str> = TABLES.iter().map(|table| table.0).collect();
        return Err(wrong_input(format!("{name}: no table of this name, expected one of {}", names.join(", "))));
    };
    let table: Table = parse(name, text)?;
    let shared: Shared = parse("shared", SHARED)?;
    let scenes = match scenes {
        None => table.scenes.clone(),
        Some(wanted) => wanted.to_vec(),
    };
    let mut plan = TablePlan { name: name.into(), columns: Vec::new(), scenes, jobs: Vec::new(), table, shared };
    for name in &plan.table.show {
        let column = plan.table.columns.get(name).or(plan.shared.columns.get(name));
        let column = column.ok_or_else(|| missing(&format!("column {name} of the table {}", plan.name)))?;
        plan.columns.push((name.clone(), column.clone()));
    }
    plan.jobs = plan.find_jobs(size, over)?;
    Ok(plan)
}

impl Job {
    /// The name of its training, which includes the scene: `SCENE/RUN`.
    pub fn name(&self) -> String {
        format!("{}/{}", self.scene, self.run)
    }
}

impl TablePlan {
    /// Whether the table shows renders beside ground truth.
    pub fn has_pictures(&self) -> bool {
        self.table.plots.iter().any(|plot| plot.kind == PlotKind::Pictures)
    }

    fn find_jobs(&self, size: Size, over: &[String]) -> anyhow::Result<Vec<Job>> {
        let mut jobs: Vec<Job> = Vec::new();
        for scene in &self.scenes {
            let dataset = self.shared.datasets.get(self.dataset(scene));
            let of_size = |full: &[String], small: &[String]| (if size == Size::Full { full } else { small }).to_vec();
            let of_data = dataset.map_or_else(Vec::new, |dataset| of_size(&dataset.full, &dataset.small));
            let of_table = of_size(&self.table.full, &self.table.small);
            for row in self.table.rows.iter().chain(&self.table.analyses) {
                let (Some(run), Some(measure)) = (&row.run, &row.measure) else { continue };
                let missing =
                    |what: &str| missing(&format!("{what} of the row {} of the table {}", row.label, self.name));
                let own = self.table.runs.get(run).or(self.shared.runs.get(run)).ok_or_else(|| missing(run))?;
                let arguments = [of_data.as_slice(), own, &of_table, over].into_iter().fold(Vec::new(), merged);
                let found = self.table.measures.get(measure).or(self.shared.measures.get(measure));
                let found = found.ok_or_else(|| missing(measure))?.clone();
                let same = jobs.iter().position(|job| job.scene == *scene && job.run == *run);
                let at = same.unwrap_or_else(|| {
                    let measures = BTreeMap::new();
                    jobs.push(Job { scene: scene.clone(), run: run.clone(), arguments, measures });
                    jobs.len() - 1
                });
                jobs[at].measures.insert(measure.clone(), found);
            }
        }
        Ok(jobs)
    }

    /// The dataset of a scene: one of the paper's, or one of its own.
    pub fn dataset<'a>(&'a self, scene: &'a str) -> &'a str {
        let found = self.shared.datasets.iter().find(|(_, dataset)| dataset.scenes.iter().any(|s| s == scene));
        found.map_or(scene, |(name, _)| name)
    }
}

/// Options of a command line, in which those of `over` replace the same options of `base`. `--set` may be repeated; the
/// last value of a key counts.
fn merged(base: Vec<String>, over: &[String]) -> Vec<String> {
    let mut options = grouped(&base);
    for option in grouped(over) {
        let name = name(&option);
        match options.iter_mut().find(|known| name != "--set" && self::name(known) == name) {
            Some(known) => *known = option,
            None => options.push(option),
        }
    }
    options.concat()
}

fn name(option: &[String]) -> String {
    option[0].split('=').next().unwrap_or_default().to_owned()
}

/// Each option with its values.
fn grouped(arguments: &[String]) -> Vec<Vec<String>> {
    let mut options: Vec<Vec<String>> = Vec::new();
    for argument in arguments {
        match options.last_mut() {
            Some(option) if !argument.starts_with("--") => option.push(argument.clone()),
            _ => options.push(vec![argument.clone()]),
        }
    }
    options
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn later_options_replace_earlier_ones() {
        let base = words("--frames 0..150 --set a=1 --preset paper --no-mask");
        let over = words("--set b=2 --frames 0..2 --iterations 3,4 --preset=fast");
        let expected = "--frames 0..2 --set a=1 --preset=fast --no-mask --set b=2 --iterations 3,4";
        assert_eq!(merged(base, &over), words(expected));
    }

    #[test]
    fn every_table_has_a_plan_and_a_name_means_one_thing() {
        for size in [Size::Full, Size::Small] {
            let (mut runs, mut measures) = (BTreeMap::new(), BTreeMap::new());
            for (name, table) in tables().unwrap() {
                let plan = plan(name, None, size, &[]).unwrap();
                assert!(!plan.jobs.is_empty() && !table.notes.is_empty(), "{name}");
                for plot in &plan.table.plots {
                    for column in plot.x.iter().chain(&plot.y) {
                        assert!(plan.columns.iter().any(|(name, _)| name == column), "{name}: {column}");
                    }
                }
                for job in plan.jobs {
                    let place = (job.scene.clone(), job.run.clone());
                    // Tables share results by these names.
                    let known = runs.entry(place.clone()).or_insert_with(|| job.arguments.clone());
                    assert_eq!(*known, job.arguments, "{name}: {place:?}");
                    for (measure, what) in job.measures {
                        let place = (job.scene.clone(), measure);
                        assert_eq!(*measures.entry(place.clone()).or_insert_with(|| what.clone()), what, "{place:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_papers_numbers_are_of_columns_and_scenes_that_exist() {
        for (name, table) in tables().unwrap() {
            let plan = plan(name, None, Size::Full, &[]).unwrap();
            for row in &table.rows {
                for (place, numbers) in &row.paper {
                    let known = plan.shared.datasets.contains_key(place) || plan.scenes.contains(place);
                    assert!(known || place == "mean", "{name}: {place}");
                    for column in numbers.keys() {
                        assert!(table.show.contains(column), "{name}: {column}");
                    }
                }
            }
        }
        // The printed mean of sizes is not the mean over scenes.
        let table = &tables().unwrap()[1].1;
        let ours = &table.rows.iter().find(|row| row.label == "TC3DGS").unwrap().paper;
        let sizes: Vec<f64> = table.scenes.iter().map(|scene| ours[scene]["storage"]).collect();
        assert!((sizes.iter().sum::<f64>() / 6.0 - 40.8e6).abs() < 0.1e6);
        assert_eq!(ours["mean"]["storage"], 49e6);
    }

    #[test]
    fn what_does_not_exist_is_named() {
        let error = plan("abblation", None, Size::Full, &[]).unwrap_err().to_string();
        assert!(error.starts_with("abblation: no table of this name, expected one of main, panoptic"), "{error}");
    }

    #[test]
    fn a_scene_that_the_paper_does_not_have_is_trained_as_it_is() {
        let plan = plan("main", Some(&["garden".to_owned()]), Size::Full, &words("--downscale 4")).unwrap();
        assert_eq!(plan.dataset("garden"), "garden");
        assert!(plan.jobs.iter().all(|job| job.scene == "garden" && !job.arguments.contains(&"--frames".to_owned())));
        assert!(plan.jobs[0].arguments.join(" ").ends_with("--downscale 4"));
    }

    #[test]
    fn a_dataset_and_a_table_have_their_own_frames() {
        let plan = plan("ablation", None, Size::Full, &[]).unwrap();
        let of = |scene: &str| plan.jobs.iter().find(|job| job.scene == scene).unwrap().arguments.join(" ");
        assert_eq!(of("basketball"), "--frames 0..150 --preset d3dgs");
        assert_eq!(of("cook_spinach"), "--frames 0..300 --preset d3dgs");
        let grid = super::plan("mask-grid", None, Size::Full, &words("--iterations 9,8")).unwrap();
        assert_eq!(grid.jobs.len(), 16);
        let arguments = grid.jobs[0].arguments.join(" ");
        assert!(arguments.starts_with("--frames 0..50 --preset paper") && arguments.ends_with("--iterations 9,8"));
    }
}

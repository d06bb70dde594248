//! Plots of a table, and its page.

use std::fmt::Write;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use tcgs_report::plot::{self, Axes, Line, Mark, escape};
use tcgs_report::{Picture, document, pictures, section};

use super::analysis::Findings;
use super::plan::{Plot, PlotKind, Row, TableLayout, TablePlan};
use super::table::{self, Results, Sheet, key, number};
use crate::error::wrong_input;

/// A plot before it is drawn.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Figure {
    /// Curves over a common abscissa.
    Lines { title: String, axes: Axes, lines: Vec<Line> },
    /// Named points.
    Points { title: String, axes: Axes, points: Vec<Mark> },
    /// Bars with their names.
    Columns { title: String, x: String, y: String, bars: Vec<(String, f64)> },
}

impl Figure {
    /// Title above the plot.
    pub fn title(&self) -> &str {
        match self {
            Self::Lines { title, .. } | Self::Points { title, .. } | Self::Columns { title, .. } => title,
        }
    }

    /// The plot as SVG; empty without data.
    pub fn svg(&self) -> String {
        match self {
            Self::Lines { title, axes, lines } => plot::lines(title, axes, lines),
            Self::Points { title, axes, points } => plot::points(title, axes, points),
            Self::Columns { title, x, y, bars } => plot::columns(title, x, y, bars),
        }
    }
}

/// The content of a table's page.
pub struct Shown {
    /// Blocks of numbers.
    pub sheets: Vec<Sheet>,
    /// Plots.
    pub figures: Vec<Figure>,
    /// Renders.
    pub pictures: Vec<Picture>,
}

/// Blocks and plots of a table; renders come from elsewhere.
pub fn show(plan: &TablePlan, results: &Results) -> anyhow::Result<Shown> {
    let mut shown = Shown { sheets: table::sheets(plan, results), figures: Vec::new(), pictures: Vec::new() };
    for plot in &plan.table.plots {
        shown.figures.extend(figures(plan, plot, results)?);
    }
    for scene in &plan.scenes {
        for row in plan.table.rows.iter().chain(&plan.table.analyses) {
            let Some(key) = key(scene, row).filter(|key| results.contains_key(key)) else { continue };
            let Some(findings) = results[&key].get("analysis") else { continue };
            let findings: Findings = serde_json::from_value(findings.clone())
                .map_err(|error| wrong_input(format!("the result {key}: {error}, expected findings of an analysis")))?;
            let name = format!("{scene}, {}", row.label);
            let named = |title: &str| format!("{title} ({name})");
            for mut sheet in findings.sheets {
                sheet.title = named(&sheet.title);
                sheet
                    .lines
                    .iter_mut()
                    .flat_map(|line| &mut line.cells)
                    .for_each(|cell| cell.sources = vec![key.clone()]);
                shown.sheets.push(sheet);
            }
            for mut figure in findings.figures {
                let (Figure::Lines { title, .. } | Figure::Points { title, .. } | Figure::Columns { title, .. }) =
                    &mut figure;
                *title = named(title);
                shown.figures.push(figure);
            }
        }
    }
    Ok(shown)
}

fn figures(plan: &TablePlan, plot: &Plot, results: &Results) -> anyhow::Result<Vec<Figure>> {
    let column = |name: &Option<String>| plan.columns.iter().find(|(known, _)| Some(known) == name.as_ref());
    let mut figures = Vec::new();
    let (x, y) = (column(&plot.x), column(&plot.y));
    let axes = |x_label: &str| Axes {
        x: x_label.into(),
        y: y.map_or_else(|| "PSNR, dB".into(), |(_, column)| column.label.clone()),
        log_x: plot.log_x,
        log_y: false,
    };
    let result = |scene: &str, row: &Row| key(scene, row).and_then(|key| results.get(&key));
    if plot.kind == PlotKind::Points {
        let (Some((x_name, x)), Some((y_name, y))) = (x, y) else { return Ok(figures) };
        for (name, place, scenes) in groups(plan) {
            let mut points = Vec::new();
            for row in &plan.table.rows {
                let mean = |column| {
                    let of = |scene: &&String| result(scene, row).and_then(|result| number(column, result));
                    scenes.iter().map(of).sum::<Option<f64>>().map(|sum| sum / scenes.len() as f64)
                };
                if let (Some(x), Some(y)) = (mean(x), mean(y)) {
                    points.push(Mark { name: row.label.clone(), at: (x, y), color: 0, hollow: false });
                }
                let paper = row.paper.get(&place);
                let of = |name: &str, scale: f64| Some(paper?.get(name)? * scale);
                if let (Some(x), Some(y)) = (of(x_name, x.scale), of(y_name, y.scale)) {
                    points.push(Mark { name: format!("[{}]", row.label), at: (x, y), color: 1, hollow: true });
                }
            }
            let title = format!("{}, {name}; rings: the paper's numbers", plot.title);
            figures.push(Figure::Points { title, axes: axes(&x.label), points });
        }
        return Ok(figures);
    }
    for scene in &plan.scenes {
        let title = format!("{}, {scene}", plot.title);
        match plot.kind {
            PlotKind::Time => {
                let line =
                    |row: &Row| Some(Line { name: row.label.clone(), points: psnr_over_time(result(scene, row)?) });
                let lines = plan.table.rows.iter().filter_map(line).collect();
                figures.push(Figure::Lines { title, axes: axes("timestep"), lines });
            }
            PlotKind::Sweep => {
                let Some((_, y)) = y else { continue };
                let point = |row: &Row| Some((row.x?, number(y, result(scene, row)?)?));
                let mut lines: Vec<Line> = Vec::new();
                for row in &plan.table.rows {
                    let (Some(name), Some(point)) = (&row.run, point(row)) else { continue };
                    match lines.iter_mut().find(|line| line.name == *name) {
                        Some(line) => line.points.push(point),
                        None => lines.push(Line { name: name.clone(), points: vec![point] }),
                    }
                }
                figures.push(Figure::Lines { title, axes: axes(&plot.x_label), lines });
            }
            PlotKind::Points | PlotKind::Pictures => {}
        }
    }
    Ok(figures)
}

/// Scenes whose numbers share one mark: the group's name, the key of the paper's numbers, and the scenes.
type SceneGroup<'a> = (String, String, Vec<&'a String>);

fn groups(plan: &TablePlan) -> Vec<SceneGroup<'_>> {
    match plan.table.layout {
        TableLayout::Rows => plan.scenes.iter().map(|scene| (scene.clone(), scene.clone(), vec![scene])).collect(),
        TableLayout::Scenes => vec![("mean".into(), "mean".into(), plan.scenes.iter().collect())],
        TableLayout::Means => {
            let mut groups: Vec<SceneGroup<'_>> = Vec::new();
            for scene in &plan.scenes {
                let dataset = plan.dataset(scene);
                match groups.iter_mut().find(|group| group.0 == dataset) {
                    Some(group) => group.2.push(scene),
                    None => groups.push((dataset.into(), dataset.into(), vec![scene])),
                }
            }
            groups
        }
    }
}

/// Mean over a timestep's images.
fn psnr_over_time(result: &Value) -> Vec<(f64, f64)> {
    let mut sums: std::collections::BTreeMap<u64, (f64, f64)> = std::collections::BTreeMap::new();
    for image in result["eval"]["images"].as_array().into_iter().flatten() {
        if let (Some(timestep), Some(psnr)) = (image["timestep"].as_u64(), image["psnr"].as_f64()) {
            let sum = sums.entry(timestep).or_default();
            *sum = (sum.0 + psnr, sum.1 + 1.0);
        }
    }
    sums.into_iter().map(|(timestep, (sum, count))| (timestep as f64, sum / count)).collect()
}

/// The page: blocks, plots, renders, and the commands of every number.
pub fn page(plan: &TablePlan, shown: &Shown, results: &Results) -> String {
    let mut page = format!(
        "<p class=\"note\">{} of the paper. Numbers in parentheses are the paper's.</p>\n",
        escape(&plan.table.paper)
    );
    for sheet in &shown.sheets {
        section(&mut page, &sheet.title, "", &table::html(sheet));
    }
    if !shown.pictures.is_empty() {
        section(&mut page, "Pictures", "", &pictures(&shown.pictures));
    }
    for figure in &shown.figures {
        let svg = figure.svg();
        // Bars are drawn small.
        let small = matches!(figure, Figure::Columns { .. });
        let body = if small { format!("<div class=\"grid\"><figure>{svg}</figure></div>\n") } else { svg };
        section(&mut page, figure.title(), "", &body);
    }
    let notes = plan
        .table
        .notes
        .iter()
        .fold(String::new(), |all, note| all + &format!("<p class=\"note\">{}</p>\n", escape(note)));
    section(&mut page, "Notes", "", &notes);
    let commands = results.iter().fold(String::new(), |mut all, (key, result)| {
        let list = |name: &str, between: &str| -> String {
            let parts = result[name].as_array().into_iter().flatten().filter_map(Value::as_str);
            parts.map(escape).collect::<Vec<_>>().join(between)
        };
        let (commits, commands) = (list("commits", ", "), list("commands", "\n"));
        let _ =
            writeln!(all, "<details><summary>{} at {commits}</summary><pre>{commands}</pre></details>", escape(key));
        all
    });
    section(&mut page, "Commands", "The command behind each number, and the commit of the program.", &commands);
    document(&plan.table.title, &page)
}

//! Numbers in rows and columns, ours beside the paper's, as text, CSV, LaTeX and HTML.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tcgs_report::plot::escape;

use super::plan::{Column, Row, TableLayout, TablePlan};

/// A block of a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sheet {
    /// Title above the block.
    pub title: String,
    /// Names above the cells.
    pub head: Vec<String>,
    /// Rows.
    pub lines: Vec<Line>,
}

/// A row of a block.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// Name before the cells.
    pub label: String,
    /// One cell per name of the head.
    pub cells: Vec<Cell>,
}

/// Our number, the paper's, or both.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Ours.
    pub value: Option<f64>,
    /// The paper's.
    pub paper: Option<f64>,
    /// Digits after the point; none for an exponent.
    pub digits: Option<usize>,
    /// Results behind the number: `SCENE/RUN/MEASURE`.
    #[serde(default)]
    pub sources: Vec<String>,
}

impl Cell {
    /// A number of ours alone.
    pub fn new(value: f64, digits: Option<usize>) -> Self {
        Self { value: Some(value), digits, ..Self::default() }
    }

    fn show(&self, value: Option<f64>) -> Option<String> {
        value.filter(|value| value.is_finite()).map(|value| match self.digits {
            Some(digits) => format!("{value:.digits$}"),
            None => format!("{value:.2e}"),
        })
    }

    /// Our number, then the paper's in parentheses.
    fn text(&self) -> String {
        match (self.show(self.value), self.show(self.paper)) {
            (Some(value), Some(paper)) => format!("{value} ({paper})"),
            (Some(value), None) => value,
            (None, Some(paper)) => format!("({paper})"),
            (None, None) => "-".into(),
        }
    }
}

/// Results of measurements: by scene, run and measure.
pub type Results = BTreeMap<String, Value>;

/// Key of a row's result for a scene in [`Results`].
pub fn key(scene: &str, row: &Row) -> Option<String> {
    Some(format!("{scene}/{}/{}", row.run.as_ref()?, row.measure.as_ref()?))
}

/// The number that a column takes from a result.
pub fn number(column: &Column, result: &Value) -> Option<f64> {
    column.from.iter().find_map(|path| at(result, path)).map(|value| value * column.scale)
}

/// - `path`: names with dots; `list[name]` is the element of that name, `list[+]` the sum over all
fn at(value: &Value, path: &str) -> Option<f64> {
    let (step, rest) = path.split_once('.').unwrap_or((path, ""));
    let (name, element) = match step.split_once('[') {
        Some((name, element)) => (name, Some(element.trim_end_matches(']'))),
        None => (step, None),
    };
    let found = value.get(name)?;
    let inside = |value: &Value| if rest.is_empty() { value.as_f64() } else { at(value, rest) };
    match element {
        None => inside(found),
        Some("+") => found.as_array()?.iter().map(inside).sum(),
        Some(element) => inside(found.as_array()?.iter().find(|e| e["name"] == element)?),
    }
}

/// The table's blocks.
pub fn sheets(plan: &TablePlan, results: &Results) -> Vec<Sheet> {
    let cell = |scene: &str, row: &Row, place: &str, (name, column): &(String, Column)| {
        let key = key(scene, row).filter(|key| results.contains_key(key));
        let value = key.as_ref().and_then(|key| number(column, &results[key]));
        let paper = row.paper.get(place).and_then(|numbers| numbers.get(name)).map(|x| x * column.scale);
        let sources = if value.is_some() { key.into_iter().collect() } else { Vec::new() };
        Cell { value, paper, digits: column.digits, sources }
    };
    let mean = |scenes: &[&String], row: &Row, place: &str, column: &(String, Column)| {
        let cells: Vec<Cell> = scenes.iter().map(|scene| cell(scene, row, scene, column)).collect();
        // All scenes or no mean: means over different scenes cannot be compared.
        let sum = cells.iter().map(|cell| cell.value).sum::<Option<f64>>();
        let sources = if sum.is_some() { cells.into_iter().flat_map(|c| c.sources).collect() } else { Vec::new() };
        let paper = cell("", row, place, column).paper;
        Cell { value: sum.map(|sum| sum / scenes.len() as f64), paper, digits: column.1.digits, sources }
    };
    let heads = || plan.columns.iter().map(|(_, column)| column.label.clone()).collect::<Vec<_>>();
    let lines = |cells: &dyn Fn(&Row) -> Vec<Cell>| -> Vec<Line> {
        plan.table.rows.iter().map(|row| Line { label: row.label.clone(), cells: cells(row) }).collect()
    };
    let mut sheets = Vec::new();
    if plan.columns.is_empty() {
        return sheets;
    }
    match plan.table.layout {
        TableLayout::Rows => {
            for scene in &plan.scenes {
                let cells = |row: &Row| plan.columns.iter().map(|column| cell(scene, row, scene, column)).collect();
                sheets.push(Sheet { title: scene.clone(), head: heads(), lines: lines(&cells) });
            }
        }
        TableLayout::Scenes => {
            let all: Vec<&String> = plan.scenes.iter().collect();
            for column in &plan.columns {
                let cells = |row: &Row| {
                    let mean = mean(&all, row, "mean", column);
                    let each = plan.scenes.iter().map(|scene| cell(scene, row, scene, column));
                    std::iter::once(mean).chain(each).collect()
                };
                let head = std::iter::once("mean".to_owned()).chain(plan.scenes.iter().cloned()).collect();
                sheets.push(Sheet { title: column.1.label.clone(), head, lines: lines(&cells) });
            }
        }
        TableLayout::Means => {
            let mut datasets: BTreeMap<&str, Vec<&String>> = BTreeMap::new();
            for scene in &plan.scenes {
                datasets.entry(plan.dataset(scene)).or_default().push(scene);
            }
            for (dataset, scenes) in datasets {
                let cells = |row: &Row| plan.columns.iter().map(|c| mean(&scenes, row, dataset, c)).collect();
                let names: Vec<&str> = scenes.iter().map(|scene| scene.as_str()).collect();
                let title = format!("{dataset}: mean of {}", names.join(", "));
                sheets.push(Sheet { title, head: heads(), lines: lines(&cells) });
            }
        }
    }
    sheets
}

/// The table for people.
pub fn text(title: &str, notes: &[String], sheets: &[Sheet]) -> String {
    let mut text = format!("{title}\n");
    for sheet in sheets {
        let _ = write!(text, "\n{}\n", sheet.title);
        let rows: Vec<Vec<String>> =
            sheet.lines.iter().map(|line| line.cells.iter().map(Cell::text).collect()).collect();
        let label = sheet.lines.iter().map(|line| line.label.chars().count()).max().unwrap_or(0);
        let width = |i: usize| rows.iter().map(|row| row[i].len()).chain([sheet.head[i].chars().count()]).max();
        let mut write = |name: &str, cells: &[String]| {
            let _ = write!(text, "{name:<label$}");
            for (i, cell) in cells.iter().enumerate() {
                let _ = write!(text, "  {cell:>0$}", width(i).unwrap_or(0));
            }
            text.push('\n');
        };
        write("", &sheet.head);
        for (line, row) in sheet.lines.iter().zip(&rows) {
            write(&line.label, row);
        }
    }
    for note in notes {
        let _ = write!(text, "\n{note}\n");
    }
    text
}

/// One line per number, with its sources.
pub fn csv(sheets: &[Sheet], results: &Results) -> String {
    let mut csv = String::from("block,row,column,value,paper,sources,commits,commands\n");
    let joined = |sources: &[String], name: &str| {
        let mut all: Vec<&str> = Vec::new();
        for part in sources.iter().flat_map(|source| results[source][name].as_array().into_iter().flatten()) {
            all.extend(part.as_str().filter(|part| !all.contains(part)));
        }
        all.join("; ")
    };
    for (sheet, line, head, cell) in cells(sheets) {
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let fields = [
            sheet.title.clone(),
            line.label.clone(),
            head.clone(),
            number(cell.value),
            number(cell.paper),
            cell.sources.join("; "),
            joined(&cell.sources, "commits"),
            joined(&cell.sources, "commands"),
        ];
        let _ = writeln!(csv, "{}", fields.map(|field| quoted(&field)).join(","));
    }
    csv
}

fn cells(sheets: &[Sheet]) -> impl Iterator<Item = (&Sheet, &Line, &String, &Cell)> {
    sheets.iter().flat_map(|sheet| {
        sheet
            .lines
            .iter()
            .flat_map(move |line| sheet.head.iter().zip(&line.cells).map(move |(head, cell)| (sheet, line, head, cell)))
    })
}

/// Quotes a field (RFC 4180).
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field.into() }
}

/// One `tabular` per block, for `booktabs`.
pub fn tex(title: &str, sheets: &[Sheet]) -> String {
    let mut tex = format!("% {title}\n% \\usepackage{{booktabs}}; in parentheses: the paper's\n");
    for sheet in sheets {
        let columns = "r".repeat(sheet.head.len());
        let _ = writeln!(tex, "\n% {}\n\\begin{{tabular}}{{l{columns}}}\n\\toprule", tex_text(&sheet.title));
        for head in &sheet.head {
            let _ = write!(tex, " & {}", tex_text(head));
        }
        tex += " \\\\\n\\midrule\n";
        for line in &sheet.lines {
            let cells: Vec<String> = line.cells.iter().map(|cell| tex_number(&cell.text())).collect();
            let _ = writeln!(tex, "{} & {} \\\\", tex_text(&line.label), cells.join(" & "));
        }
        tex += "\\bottomrule\n\\end{tabular}\n";
    }
    tex
}

fn tex_number(text: &str) -> String {
    text.split(' ')
        .map(|part| match part.split_once('e') {
            Some((mantissa, exponent)) => {
                let close = if exponent.ends_with(')') { ")" } else { "" };
                format!("${mantissa} \\cdot 10^{{{}}}${close}", exponent.trim_end_matches(')'))
            }
            None => part.into(),
        })
        .collect::<Vec<_>>()
        .join(" ")
}

fn tex_text(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', c]),
            '\\' => escaped += "\\textbackslash{}",
            '~' => escaped += "\\textasciitilde{}",
            '^' => escaped += "\\textasciicircum{}",
            _ => escaped.push(c),
        }
    }
    escaped
}

/// A block for a page.
pub fn html(sheet: &Sheet) -> String {
    let mut html = String::from("<div class=\"scroll\"><table><thead><tr><th scope=\"col\"></th>");
    for head in &sheet.head {
        let _ = write!(html, "<th scope=\"col\">{}</th>", escape(head));
    }
    html += "</tr></thead><tbody>";
    for line in &sheet.lines {
        let _ = write!(html, "<tr><th scope=\"row\">{}</th>", escape(&line.label));
        for cell in &line.cells {
            let ours = cell.show(cell.value).unwrap_or_default();
            let paper = cell.show(cell.paper).map(|paper| format!(" <small>({paper})</small>")).unwrap_or_default();
            let text = format!("{ours}{paper}");
            let _ = write!(html, "<td>{}</td>", if text.is_empty() { "–" } else { &text });
        }
        html += "</tr>";
    }
    html + "</tbody></table></div>\n"
}

/// The table for machines.
///
/// - `commit`: of the program
pub fn json(plan: &TablePlan, sheets: &[Sheet], results: &Results, commit: &str) -> Value {
    let sources: serde_json::Map<String, Value> = results
        .iter()
        .map(|(key, result)| {
            let names = ["commands", "commits", "seconds"];
            let about: serde_json::Map<_, _> =
                names.map(|name| (name.to_owned(), result[name].clone())).into_iter().collect();
            (key.clone(), about.into())
        })
        .collect();
    json!({
        "table": plan.name,
        "title": plan.table.title,
        "paper": plan.table.paper,
        "notes": plan.table.notes,
        "commit": commit,
        "blocks": sheets,
        "sources": sources,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::plan::{Size, plan};

    fn result() -> Value {
        json!({
            "eval": { "psnr": 28.456, "ssim": null, "num_gaussians": 189_000, "bytes": 5_000_000 },
            "compress": { "stages": [{ "name": "raw", "bytes": 9 }, { "name": "file", "bytes": 44_000_000 }] },
            "train": { "timesteps": [{ "seconds": 1.5 }, { "seconds": 2.5 }] },
            "commands": ["tcgs train a --set b,c"], "commits": ["abc"],
        })
    }

    #[test]
    fn numbers_are_found_in_results() {
        let result = result();
        assert_eq!(at(&result, "eval.psnr"), Some(28.456));
        assert_eq!(at(&result, "compress.stages[file].bytes"), Some(44e6));
        assert_eq!(at(&result, "train.timesteps[+].seconds"), Some(4.0));
        let none = ["eval.ssim", "eval.lpips", "compress.stages[plain].bytes", "train.timesteps[+].psnr", "eval"];
        assert!(none.iter().all(|path| at(&result, path).is_none()));
        let column = Column {
            label: String::new(),
            from: vec!["compress.stages[plain].bytes".into(), "eval.bytes".into()],
            scale: 1e-6,
            digits: None,
        };
        assert_eq!(number(&column, &result), Some(5.0));
    }

    #[test]
    fn ours_stands_beside_the_papers() {
        let scenes = ["basketball".to_owned()];
        let plan = plan("ablation", Some(&scenes), Size::Full, &[]).unwrap();
        let results = Results::from([("basketball/tc3dgs/final".into(), result())]);
        let sheets = sheets(&plan, &results);
        assert_eq!((sheets.len(), sheets[0].lines.len()), (1, plan.table.rows.len()));
        let text = text("T", &plan.table.notes, &sheets);
        // PSNR, the authors' PSNR, SSIM, Gaussians, storage, file, FPS and seconds; a number that was not measured is
        // not 0.
        let expected = ["28.46 (27.90)", "-", "-", "189.0 (189.0)", "5.000 (44.000)", "44.000", "(750)", "4"];
        let row: Vec<String> = sheets[0].lines[3].cells.iter().map(Cell::text).collect();
        assert_eq!(row, expected);
        assert!(text.contains("Dynamic 3DGS") && text.contains("contradicts itself"), "{text}");
        let csv = csv(&sheets, &results);
        let line = "basketball,paper: M Q I,PSNR,28.456,27.9,basketball/tc3dgs/final,abc,\"tcgs train a --set b,c\"";
        assert!(csv.contains(line), "{csv}");
        let tex = tex("T", &sheets);
        assert!(tex.contains("paper: M Q I & 28.46 (27.90) & -") && tex.contains("% basketball"), "{tex}");
        assert!(html(&sheets[0]).contains("<td>28.46 <small>(27.90)</small></td><td>–</td>"));
    }

    #[test]
    fn a_mean_is_of_all_scenes_or_none() {
        let plan = plan("panoptic", None, Size::Full, &[]).unwrap();
        let keys: Vec<String> = plan.scenes.iter().map(|scene| format!("{scene}/tc3dgs/final")).collect();
        let mut results: Results = keys.iter().map(|key| (key.clone(), result())).collect();
        let mean = |results: &Results| {
            let sheets = sheets(&plan, results);
            let line = sheets[0].lines.iter().find(|line| line.label == "TC3DGS").unwrap();
            (line.cells[0].value, line.cells[0].paper, line.cells[0].sources.len(), line.cells[2].value)
        };
        assert_eq!(mean(&results), (Some(28.456), Some(27.81), 6, Some(28.456)));
        results.remove(&keys[0]);
        assert_eq!(mean(&results), (None, Some(27.81), 0, Some(28.456)));
    }

    #[test]
    fn special_characters_are_escaped() {
        assert_eq!(tex_text("a_b & 5 %"), "a\\_b \\& 5 \\%");
        assert_eq!(tex_number("1.50e-5 (2.00e3)"), "$1.50 \\cdot 10^{-5}$ $(2.00 \\cdot 10^{3}$)");
        assert_eq!(quoted("a\"b"), "\"a\"\"b\"");
    }
}

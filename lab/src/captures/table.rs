//! The table as text: the worst capture first.

use std::collections::BTreeMap;

use serde_json::Value;

use super::Row;

/// Heading, place in a result, digits, and factor.
const COLUMNS: [(&str, &str, usize, f64); 13] = [
    ("PSNR", "/eval/psnr", 2, 1.0),
    ("SSIM", "/eval/ssim", 3, 1.0),
    ("seen by 2", "/more/psnr_seen", 2, 1.0),
    ("unseen %", "/more/unseen", 1, 100.0),
    ("fitted", "/more/psnr_fitted", 2, 1.0),
    ("foreground", "/eval/psnr_foreground", 2, 1.0),
    ("LPIPS", "/eval/lpips_vgg", 3, 1.0),
    ("flicker", "/eval/flicker", 4, 1.0),
    ("free %", "/more/free_space", 2, 100.0),
    ("holes %", "/more/holes", 2, 100.0),
    ("Gaussians", "/num_gaussians", 0, 1.0),
    ("kB", "/eval/bytes", 1, 1e-3),
    ("s", "/seconds/train", 0, 1.0),
];

/// Rows of a capture stand together. Captures are sorted by the `psnr_seen` of their first row, lowest first.
pub fn text(rows: &[Row]) -> String {
    let number = |row: &Row, place: &str| row.found.pointer(place).and_then(Value::as_f64);
    let mut first: BTreeMap<&str, f64> = BTreeMap::new();
    for row in rows {
        first.entry(&row.capture).or_insert_with(|| number(row, "/more/psnr_seen").unwrap_or(f64::INFINITY));
    }
    let mut sorted: Vec<&Row> = rows.iter().collect();
    sorted.sort_by(|a, b| {
        first[a.capture.as_str()].total_cmp(&first[b.capture.as_str()]).then(a.capture.cmp(&b.capture))
    });
    let mut lines: Vec<Vec<String>> = vec![["capture", "variant"].map(String::from).to_vec()];
    lines[0].extend(COLUMNS.map(|(heading, ..)| heading.to_owned()));
    for row in sorted {
        let mut line = vec![row.capture.clone(), row.variant.clone()];
        line.extend(COLUMNS.map(|(_, place, digits, factor)| {
            number(row, place).map_or_else(|| "-".into(), |x| format!("{:.digits$}", factor * x))
        }));
        lines.push(line);
    }
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..lines[0].len()).map(width).collect();
    let padded = |(i, cell): (usize, &String)| match i {
        0 | 1 => format!("{cell:<0$}", widths[i]),
        _ => format!("{cell:>0$}", widths[i]),
    };
    let line = |line: &Vec<String>| line.iter().enumerate().map(padded).collect::<Vec<_>>().join("  ") + "\n";
    lines.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_worst_capture_stands_first() {
        let row = |capture: &str, variant: &str, seen: f64| Row {
            capture: capture.into(),
            variant: variant.into(),
            found: json!({ "more": { "psnr_seen": seen }, "eval": { "psnr": 20.0 } }),
        };
        let rows = [row("good", "a", 30.0), row("bad", "a", 20.0), row("bad", "b", 40.0)];
        let text = text(&rows);
        let lines: Vec<Vec<&str>> =
            text.lines().skip(1).map(|line| line.split_whitespace().take(2).collect()).collect();
        assert_eq!(lines, [["bad", "a"], ["bad", "b"], ["good", "a"]]);
    }
}

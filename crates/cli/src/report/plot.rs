//! Plots as inline SVG. Colours come from the page's style (classes `c0` to `c5`), so that they follow
//! its light and dark schemes; every mark carries its numbers as a tooltip.

use std::fmt::Write;

/// Colours there are; a seventh series takes the first again.
const NUM_COLORS: usize = 6;
/// Room beside a plot for the names of its rows or the numbers of its axis, user units.
const LEFT: f64 = 56.0;

/// A line of a plot.
pub(super) struct Line {
    pub name: String,
    /// Those that are not finite, or not positive on a logarithmic axis, are left out.
    pub points: Vec<(f64, f64)>,
}

/// A horizontal bar.
pub(super) struct Row {
    pub name: String,
    pub value: f64,
    /// The value in words, at the bar's end.
    pub text: String,
}

/// Lines over a common abscissa. Empty if there is no point to draw.
pub(super) fn lines(label: &str, x_label: &str, y_label: &str, all: &[Line], log_y: bool) -> String {
    let scale = |y: f64| if log_y { y.log10() } else { y };
    let drawn = |line: &Line| -> Vec<(f64, f64)> {
        let points = line.points.iter().map(|&(x, y)| (x, scale(y)));
        points.filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
    };
    let all: Vec<(&str, Vec<(f64, f64)>)> = all.iter().map(|line| (line.name.as_str(), drawn(line))).collect();
    let points = || all.iter().flat_map(|(_, points)| points.iter().copied());
    let (Some(x_range), Some(y_range)) = (range(points().map(|p| p.0)), range(points().map(|p| p.1))) else {
        return String::new();
    };
    let (width, height) = (720.0, 280.0);
    let (top, bottom) = (if all.len() > 1 { 34.0 } else { 12.0 }, height - 40.0);
    let y_ticks = if log_y { log_ticks(y_range) } else { linear_ticks(y_range, 5) };
    let y_range = y_ticks.iter().fold(y_range, |(low, high), tick| (low.min(tick.0), high.max(tick.0)));
    let x_at = |x: f64| LEFT + (x - x_range.0) / (x_range.1 - x_range.0) * (width - LEFT - 16.0);
    let y_at = |y: f64| bottom - (y - y_range.0) / (y_range.1 - y_range.0) * (bottom - top);

    let mut svg = open(label, width, height);
    for (y, text) in &y_ticks {
        rule(&mut svg, [LEFT, y_at(*y), width - 16.0, y_at(*y)]);
        write_text(&mut svg, [LEFT - 8.0, y_at(*y) + 4.0], "end", text);
    }
    for (x, text) in linear_ticks(x_range, 8).iter().filter(|(x, _)| (x_range.0..=x_range.1).contains(x)) {
        write_text(&mut svg, [x_at(*x), bottom + 18.0], "middle", text);
    }
    write_text(&mut svg, [(LEFT + width) / 2.0, height - 6.0], "middle", x_label);
    let _ = write!(
        svg,
        "<text transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        (top + bottom) / 2.0,
        escape(y_label)
    );
    let mut legend_x = LEFT;
    for (i, (name, points)) in all.iter().enumerate() {
        let _ = write!(svg, "<g class=\"c{}\"><title>{}</title><polyline points=\"", i % NUM_COLORS, escape(name));
        for (x, y) in points {
            let _ = write!(svg, "{:.1},{:.1} ", x_at(*x), y_at(*y));
        }
        svg += "\"/>";
        if let [(x, y)] = points[..] {
            let _ = write!(svg, "<circle class=\"mark\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\"/>", x_at(x), y_at(y));
        }
        if all.len() > 1 {
            let _ =
                write!(svg, "<rect class=\"mark\" x=\"{legend_x:.1}\" y=\"10\" width=\"14\" height=\"4\" rx=\"2\"/>");
            write_text(&mut svg, [legend_x + 20.0, 16.0], "start", name);
            legend_x += 44.0 + 6.8 * name.chars().count() as f64;
        }
        svg += "</g>";
    }
    svg + "</svg>\n"
}

/// Horizontal bars with names and values. Empty if there is none.
///
/// - `log`: bars grow with the logarithm, from a decade below the least
pub(super) fn rows(label: &str, bars: &[Row], log: bool) -> String {
    let bars: Vec<&Row> = bars.iter().filter(|bar| bar.value.is_finite() && (bar.value > 0.0 || !log)).collect();
    let Some((least, most)) = range(bars.iter().map(|bar| bar.value)) else { return String::new() };
    let (low, high) = if log { (least.log10().floor() - 1.0, most.log10()) } else { (0.0, most) };
    let (width, row_height, right) = (720.0, 30.0, 90.0);
    let longest = bars.iter().map(|bar| bar.name.chars().count()).max().unwrap_or(0);
    let left = (7.2 * longest as f64 + 14.0).clamp(LEFT, width / 2.0);
    let height = row_height * bars.len() as f64 + if log { 22.0 } else { 2.0 };
    let x_at = |x: f64| left + ((x - low) / (high - low)).clamp(0.0, 1.0) * (width - left - right);

    let mut svg = open(label, width, height);
    if log {
        for decade in low as i64..=high.floor() as i64 {
            let x = x_at(decade as f64);
            rule(&mut svg, [x, 0.0, x, height - 20.0]);
            write_text(&mut svg, [x, height - 4.0], "middle", short(10f64.powi(decade as i32)).trim());
        }
    }
    for (i, bar) in bars.iter().enumerate() {
        let (y, end) = (row_height * i as f64, x_at(if log { bar.value.log10() } else { bar.value }));
        write_text(&mut svg, [left - 10.0, y + 19.0], "end", &bar.name);
        let _ = write!(
            svg,
            "<rect class=\"mark c0\" x=\"{left:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"18\" rx=\"3\">\
             <title>{}: {}</title></rect><text class=\"value\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            y + 6.0,
            (end - left).max(1.0),
            escape(&bar.name),
            escape(&bar.text),
            end + 8.0,
            y + 19.0,
            escape(&bar.text)
        );
    }
    svg + "</svg>\n"
}

/// A small plot of vertical bars. Empty if there is none.
pub(super) fn columns(label: &str, x_label: &str, y_label: &str, bars: &[(String, f64)]) -> String {
    let most = bars.iter().map(|bar| bar.1).filter(|value| value.is_finite()).fold(0.0, f64::max);
    if most <= 0.0 {
        return String::new();
    }
    let (width, height, top, bottom) = (300.0, 180.0, 20.0, 140.0);
    let ticks = linear_ticks((0.0, most), 4);
    let highest = ticks.last().map_or(most, |tick| tick.0.max(most));
    let y_at = |y: f64| bottom - y / highest * (bottom - top);
    let step = (width - LEFT - 8.0) / bars.len() as f64;
    let shown_every = (bars.len() as f64 * 30.0 / (width - LEFT)).ceil().max(1.0) as usize;

    let mut svg = open(label, width, height);
    write_text(&mut svg, [LEFT, 10.0], "start", y_label);
    for (y, text) in &ticks {
        rule(&mut svg, [LEFT, y_at(*y), width - 8.0, y_at(*y)]);
        write_text(&mut svg, [LEFT - 8.0, y_at(*y) + 4.0], "end", text);
    }
    for (i, (name, value)) in bars.iter().enumerate() {
        let x = LEFT + step * i as f64;
        if *value > 0.0 && value.is_finite() {
            // At least a pixel: a few of many is not none.
            let tall = (bottom - y_at(*value)).max(1.0);
            let _ = write!(
                svg,
                "<rect class=\"mark c0\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{tall:.1}\">\
                 <title>{}: {value}</title></rect>",
                x + 0.1 * step,
                bottom - tall,
                0.8 * step,
                escape(name)
            );
        }
        if i % shown_every == 0 {
            write_text(&mut svg, [x + step / 2.0, bottom + 16.0], "middle", name);
        }
    }
    write_text(&mut svg, [(LEFT + width) / 2.0, height - 6.0], "middle", x_label);
    svg + "</svg>"
}

/// Three digits and a prefix: `1.23 M`; below a thousand there is no prefix and a space ends the text.
pub(super) fn short(value: f64) -> String {
    let prefix = ["", "k", "M", "G", "T"];
    let power = if value.abs() >= 1000.0 { ((value.abs().log10() / 3.0) as usize).min(4) } else { 0 };
    let scaled = value / 1000f64.powi(power as i32);
    let digits = match scaled.abs() {
        x if x >= 99.95 || x == x.trunc() => 0,
        x if x >= 9.995 => 1,
        _ => 2,
    };
    format!("{scaled:.digits$} {}", prefix[power])
}

/// For text and attributes.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Least and largest, apart from each other; `None` without values.
fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    match low.total_cmp(&high) {
        std::cmp::Ordering::Less => Some((low, high)),
        std::cmp::Ordering::Equal => Some((low, high + high.abs().max(1.0) * 1e-3)),
        std::cmp::Ordering::Greater => None,
    }
}

/// Round numbers that cover a range, about `count` of them, with their texts.
fn linear_ticks((low, high): (f64, f64), count: usize) -> Vec<(f64, String)> {
    let rough = (high - low) / count as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|&s| s >= rough).unwrap_or(rough);
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let (first, last) = ((low / step).floor() as i64, (high / step).ceil() as i64);
    let text = |value: f64| if value.abs() >= 10_000.0 { short(value) } else { format!("{value:.digits$}") };
    (first..=last).map(|i| (i as f64 * step, text(i as f64 * step).trim().to_owned())).collect()
}

/// Decades that cover a range of logarithms, and 2 and 5 between them where the range is short.
fn log_ticks((low, high): (f64, f64)) -> Vec<(f64, String)> {
    let steps: &[f64] = if high - low > 2.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let all: Vec<f64> = (low.floor() as i32..=high.ceil() as i32)
        .flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)))
        .collect();
    let first = all.iter().rposition(|v| v.log10() <= low).unwrap_or(0);
    let last = all.iter().position(|v| v.log10() >= high).unwrap_or(all.len() - 1);
    all[first..=last].iter().map(|v| (v.log10(), format!("{v}"))).collect()
}

fn open(label: &str, width: f64, height: f64) -> String {
    let label = escape(label);
    format!("<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{label}\">")
}

fn rule(svg: &mut String, [x1, y1, x2, y2]: [f64; 4]) {
    let _ = write!(svg, "<line class=\"rule\" x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\"/>");
}

fn write_text(svg: &mut String, [x, y]: [f64; 2], anchor: &str, text: &str) {
    let _ = write!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>", escape(text));
}

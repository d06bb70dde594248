//! Plots as inline SVG. Colours come from the page's style (classes `c0` to `c5`), so that they follow
//! its light and dark schemes; every mark carries its numbers as a tooltip.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

/// Number of colours; a seventh series takes the first again.
const NUM_COLORS: usize = 6;
/// Space beside a plot for the names of its rows or the numbers of its axis, user units.
const LEFT: f64 = 64.0;

/// A line of a plot.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Line {
    /// Name in the legend.
    pub name: String,
    /// Points; those that are not finite, or not positive on a logarithmic axis, are left out.
    pub points: Vec<(f64, f64)>,
}

/// A named point of a plot.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Mark {
    /// Name beside the mark.
    pub name: String,
    /// Position; left out if not finite, or not positive on a logarithmic axis.
    pub at: (f64, f64),
    /// Colour that related marks share.
    pub color: usize,
    /// A ring instead of a disc.
    pub hollow: bool,
}

/// Names of a plot's axes, and whether they are logarithmic.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Axes {
    /// Name of the abscissa.
    pub x: String,
    /// Name of the ordinate.
    pub y: String,
    /// Whether the abscissa is logarithmic.
    pub log_x: bool,
    /// Whether the ordinate is logarithmic.
    pub log_y: bool,
}

/// A horizontal bar.
pub(crate) struct Row {
    /// Name before the bar.
    pub name: String,
    /// Length of the bar.
    pub value: f64,
    /// The value in words, at the bar's end.
    pub text: String,
}

/// The frame of a plot: its size, and the positions of values.
struct Frame {
    svg: String,
    log: (bool, bool),
    x_range: (f64, f64),
    y_range: (f64, f64),
    top: f64,
}

/// Layout of [`Frame`], user units.
const WIDTH: f64 = 720.0;
const RIGHT: f64 = 24.0;
const PLOT_HEIGHT: f64 = 228.0;

impl Frame {
    /// Axes and rules around points; none without points.
    ///
    /// - `top`: space above
    fn new(label: &str, axes: &Axes, points: &[(f64, f64)], top: f64) -> Option<Self> {
        let log = (axes.log_x, axes.log_y);
        let points: Vec<(f64, f64)> = points.iter().map(|&p| scaled(p, log)).filter(is_drawn).collect();
        let x_range = range(points.iter().map(|p| p.0))?;
        let y_range = range(points.iter().map(|p| p.1))?;
        let y_ticks = if axes.log_y { log_ticks(y_range) } else { linear_ticks(y_range, 5) };
        let x_ticks = if axes.log_x { log_ticks(x_range) } else { linear_ticks(x_range, 8) };
        let y_range = y_ticks.iter().fold(y_range, |(low, high), tick| (low.min(tick.0), high.max(tick.0)));
        // A logarithmic abscissa begins and ends at a tick, since a short range has few of them.
        let widened = x_ticks.iter().fold(x_range, |(low, high), tick| (low.min(tick.0), high.max(tick.0)));
        let x_range = if axes.log_x { widened } else { x_range };
        let (bottom, height) = (top + PLOT_HEIGHT, top + PLOT_HEIGHT + 40.0);
        let mut frame = Self { svg: open(label, WIDTH, height), log, x_range, y_range, top };
        for (y, text) in &y_ticks {
            let y = frame.at((x_range.0, *y)).1;
            rule(&mut frame.svg, [LEFT, y, WIDTH - RIGHT, y]);
            write_text(&mut frame.svg, [LEFT - 8.0, y + 4.0], "end", text);
        }
        for (x, text) in x_ticks.iter().filter(|(x, _)| (x_range.0..=x_range.1).contains(x)) {
            let x = frame.at((*x, y_range.0)).0;
            write_text(&mut frame.svg, [x, bottom + 18.0], "middle", text);
        }
        write_text(&mut frame.svg, [(LEFT + WIDTH) / 2.0, height - 6.0], "middle", &axes.x);
        let _ = write!(
            frame.svg,
            "<text transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            (top + bottom) / 2.0,
            escape(&axes.y)
        );
        Some(frame)
    }

    /// Position of a scaled point.
    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let share = |value: f64, (low, high): (f64, f64)| (value - low) / (high - low);
        (
            LEFT + share(x, self.x_range) * (WIDTH - LEFT - RIGHT),
            self.top + PLOT_HEIGHT * (1.0 - share(y, self.y_range)),
        )
    }

    /// Positions of the points that can be drawn.
    fn places(&self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        points.iter().map(|&p| scaled(p, self.log)).filter(is_drawn).map(|p| self.at(p)).collect()
    }
}

fn scaled((x, y): (f64, f64), (log_x, log_y): (bool, bool)) -> (f64, f64) {
    (if log_x { x.log10() } else { x }, if log_y { y.log10() } else { y })
}

fn is_drawn((x, y): &(f64, f64)) -> bool {
    x.is_finite() && y.is_finite()
}

/// Positions of a legend's names, row after row, and its height.
fn legend(names: &[&str]) -> (Vec<(f64, f64)>, f64) {
    if names.len() < 2 {
        return (vec![(LEFT, 0.0); names.len()], 12.0);
    }
    let (mut x, mut y) = (LEFT, 10.0);
    let places = names.iter().map(|name| {
        let width = 44.0 + 6.8 * name.chars().count() as f64;
        if x > LEFT && x + width > WIDTH {
            (x, y) = (LEFT, y + 18.0);
        }
        let place = (x, y);
        x += width;
        place
    });
    let places: Vec<(f64, f64)> = places.collect();
    let height = places.last().map_or(0.0, |place| place.1) + 24.0;
    (places, height)
}

/// Lines over a common abscissa. Empty if there is no point to draw.
pub fn lines(label: &str, axes: &Axes, all: &[Line]) -> String {
    let points: Vec<(f64, f64)> = all.iter().flat_map(|line| line.points.iter().copied()).collect();
    let (places, top) = legend(&all.iter().map(|line| line.name.as_str()).collect::<Vec<_>>());
    let Some(mut frame) = Frame::new(label, axes, &points, top) else { return String::new() };
    for (i, line) in all.iter().enumerate() {
        let points = frame.places(&line.points);
        // Dashes distinguish repeated colours.
        let dashes = if i < NUM_COLORS { "" } else { " stroke-dasharray=\"5 4\"" };
        let svg = &mut frame.svg;
        let _ = write!(svg, "<g class=\"c{}\"><title>{}</title>", i % NUM_COLORS, escape(&line.name));
        let _ = write!(svg, "<polyline{dashes} points=\"");
        for (x, y) in &points {
            let _ = write!(svg, "{x:.1},{y:.1} ");
        }
        *svg += "\"/>";
        if let [(x, y)] = points[..] {
            let _ = write!(svg, "<circle class=\"mark\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>");
        }
        if all.len() > 1 {
            let (x, y) = places[i];
            let end = x + 14.0;
            let _ = write!(
                svg,
                "<line class=\"sample\"{dashes} x1=\"{x:.1}\" y1=\"{0:.1}\" x2=\"{end:.1}\" y2=\"{0:.1}\"/>",
                y + 2.0
            );
            write_text(svg, [x + 20.0, y + 6.0], "start", &line.name);
        }
        *svg += "</g>";
    }
    frame.svg + "</svg>\n"
}

/// Named points. Empty if there is none to draw.
pub fn points(label: &str, axes: &Axes, marks: &[Mark]) -> String {
    let all: Vec<(f64, f64)> = marks.iter().map(|mark| mark.at).collect();
    let Some(mut frame) = Frame::new(label, axes, &all, 20.0) else { return String::new() };
    // Boxes that a name must not cover: marks, and other names.
    let mut taken: Vec<[f64; 4]> =
        frame.places(&all).into_iter().map(|(x, y)| [x - 5.0, y - 5.0, x + 5.0, y + 5.0]).collect();
    for mark in marks {
        let places = frame.places(&[mark.at]);
        let [(x, y)] = places[..] else { continue };
        let (name, fill) = (escape(&mark.name), if mark.hollow { "ring" } else { "mark" });
        let _ = write!(
            frame.svg,
            "<g class=\"c{}\"><title>{name}: {:.4e}, {:.4}</title><circle class=\"{fill}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/></g>",
            mark.color % NUM_COLORS,
            mark.at.0,
            mark.at.1
        );
        let [x, y, anchor] = name_place((x, y), &mark.name, &mut taken);
        write_text(&mut frame.svg, [x, y], if anchor > 0.0 { "start" } else { "end" }, &mark.name);
    }
    frame.svg + "</svg>\n"
}

/// A free place for a name beside its point: right or left, above or below if necessary. The third number is positive
/// on the right side.
fn name_place((x, y): (f64, f64), name: &str, taken: &mut Vec<[f64; 4]>) -> [f64; 3] {
    let width = 6.6 * name.chars().count() as f64;
    let candidates = (0..12).flat_map(|step| {
        // 0, 12 down, 12 up, 24 down, ...
        let shift = 12.0 * f64::from((step + 1) / 2) * if step % 2 == 1 { 1.0 } else { -1.0 };
        [(x + 8.0, shift, 1.0), (x - 8.0, shift, -1.0)]
    });
    let mut chosen = [x + 8.0, y + 4.0, 1.0];
    for (at, shift, side) in candidates {
        let (left, middle) = (if side > 0.0 { at } else { at - width }, y + shift);
        let field = [left, middle - 6.0, left + width, middle + 6.0];
        let free = taken.iter().all(|t| field[2] < t[0] || t[2] < field[0] || field[3] <= t[1] || t[3] <= field[1]);
        if free && left > LEFT && field[2] < WIDTH && middle > 4.0 {
            taken.push(field);
            chosen = [at, middle + 4.0, side];
            break;
        }
    }
    chosen
}

/// A plot as a file of its own, with the page's light colours.
pub fn standalone(svg: &str) -> String {
    const STYLE: &str = "<style>\
        svg { background: #ffffff; font-family: system-ui, 'DejaVu Sans', Arial, sans-serif; }\
        text { fill: #5f6570; font-size: 12px; } text.value { fill: #1d1f23; }\
        .rule { stroke: #dfe1e5; stroke-width: 1; }\
        polyline { fill: none; stroke: currentColor; stroke-width: 2; stroke-linejoin: round; stroke-linecap: round; }\
        .sample { stroke: currentColor; stroke-width: 3; } .mark { fill: currentColor; } .ring { fill: #ffffff; stroke: currentColor; stroke-width: 2; }\
        .c0 { color: #2467c9; } .c1 { color: #d9601a; } .c2 { color: #12875f; }\
        .c3 { color: #8d3fb5; } .c4 { color: #a87700; } .c5 { color: #c22e5d; }\
        </style><rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>";
    let (head, body) = svg.trim_end().split_once('>').unwrap_or((svg, ""));
    format!("{} xmlns=\"http://www.w3.org/2000/svg\">{STYLE}{body}\n", head)
}

/// Horizontal bars with names and values. Empty if there is none.
///
/// - `log`: bar lengths are logarithmic, from a decade below the least
pub(crate) fn rows(label: &str, bars: &[Row], log: bool) -> String {
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
pub fn columns(label: &str, x_label: &str, y_label: &str, bars: &[(String, f64)]) -> String {
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
            // At least one pixel, since a few of many are not none.
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
pub(crate) fn short(value: f64) -> String {
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

/// Escapes text for HTML content and attributes.
pub fn escape(text: &str) -> String {
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

/// Ticks over a range of logarithms: decades, thinned out if the range is long, with 2 and 5 between them if it is
/// short.
fn log_ticks((low, high): (f64, f64)) -> Vec<(f64, String)> {
    let steps: &[f64] = if high - low > 2.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let every = ((high - low) / 7.0).ceil().max(1.0) as usize;
    let all: Vec<f64> = (low.floor() as i32..=high.ceil() as i32 + every as i32)
        .step_by(every)
        .flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)))
        .collect();
    let first = all.iter().rposition(|v| v.log10() <= low).unwrap_or(0);
    let last = all.iter().position(|v| v.log10() >= high).unwrap_or(all.len() - 1);
    let text = |v: f64| if (1e-3..1e5).contains(&v) { format!("{v}") } else { format!("{v:.0e}") };
    all[first..=last].iter().map(|&v| (v.log10(), text(v))).collect()
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

//! Writes a table, its page and its plots.

use tcgs_report::plot::standalone;

use super::execute::{Workplace, write_file};
use super::plan::TablePlan;
use super::{figure, pictures, table};
use crate::error::wrong_input;
use crate::slug;

/// Writes a table and its figures into the output folder, from the existing results.
///
/// - returns: the table as text
///
/// # Errors
/// If a result was made by other arguments, a scene cannot be drawn, or a file cannot be written.
pub fn write(plan: &TablePlan, place: &Workplace) -> anyhow::Result<String> {
    if !place.out.is_dir() {
        return Err(wrong_input(format!("{}: no such folder, expected one to write into", place.out.display())));
    }
    let mut results = table::Results::new();
    for job in &plan.jobs {
        for measure in job.measures.keys() {
            if let Some(result) = place.result(job, measure)? {
                results.insert(format!("{}/{measure}", job.name()), result);
            }
        }
    }
    let mut shown = figure::show(plan, &results)?;
    let file = |name: &str, bytes: &[u8]| write_file(&place.out.join(name), bytes);
    if plan.has_pictures() {
        for (name, picture) in pictures::grids(plan, place)? {
            write_file(&place.out.join(name), &picture.png)?;
            shown.pictures.push(picture);
        }
    }
    let name = &plan.name;
    let title = format!("{} ({})", plan.table.title, plan.table.paper);
    let text = table::text(&title, &plan.table.notes, &shown.sheets);
    let json = table::json(plan, &shown.sheets, &results, &place.program.commit);
    file(&format!("{name}.txt"), text.as_bytes())?;
    file(&format!("{name}.csv"), table::csv(&shown.sheets, &results).as_bytes())?;
    file(&format!("{name}.tex"), table::tex(&title, &shown.sheets).as_bytes())?;
    file(&format!("{name}.json"), format!("{json:#}\n").as_bytes())?;
    file(&format!("{name}.html"), figure::page(plan, &shown, &results).as_bytes())?;
    for figure in &shown.figures {
        let svg = figure.svg();
        if !svg.is_empty() {
            file(
                &format!("{name}-{}.svg", slug(figure.title().split(';').next().unwrap_or_default())),
                standalone(&svg).as_bytes(),
            )?;
        }
    }
    Ok(text)
}

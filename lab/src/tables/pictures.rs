//! Renders of a table's rows beside ground truth.

use std::path::PathBuf;

use anyhow::Context;
use image::{Rgb, RgbImage};
use tcgs_capture::{Capture, Split};
use tcgs_core::Image;
use tcgs_pipeline::{Backend, OpenScene, OpenSettings};
use tcgs_render::RenderSettings;
use tcgs_report::{Picture, png};

use super::execute::Workplace;
use super::plan::TablePlan;
use crate::error::wrong_input;

/// Timesteps shown: the first, the middle and the last.
const SHOWN: usize = 3;
/// Gap between pictures, pixels.
const GAP: u32 = 4;
/// Pictures narrower than this are enlarged.
const WIDTH: u32 = 320;

/// One grid per scene, with one row per timestep, ground truth first. Also returns the file for each.
pub fn grids(plan: &TablePlan, place: &Workplace) -> anyhow::Result<Vec<(PathBuf, Picture)>> {
    let renderer = Backend::Cpu.renderer();
    let mut grids = Vec::new();
    for scene in &plan.scenes {
        let capture = Capture::open(&place.capture(scene))?;
        let mut columns: Vec<Vec<Image>> = Vec::new();
        let mut names = vec!["ground truth".to_owned()];
        let mut of = String::new();
        for row in &plan.table.rows {
            let (Some(run), Some(measure)) = (&row.run, &row.measure) else { continue };
            let job = plan
                .jobs
                .iter()
                .find(|job| job.scene == *scene && job.run == *run)
                .with_context(|| format!("{scene}/{run}: is a row's run and none of the plan"))?;
            if place.result(job, measure)?.is_none() {
                continue;
            }
            let model = OpenScene::open(&place.drawable(job, measure), OpenSettings::default())?;
            let frames = model.frames();
            let shown = (0..SHOWN).map(|i| frames.start + i * (frames.len() - 1) / (SHOWN - 1));
            let mut shown: Vec<usize> = shown.collect();
            shown.dedup();
            let mut column = Vec::new();
            for &frame in &shown {
                let views = capture.views(Split::Test, frame, model.downscale)?;
                let view = views.into_iter().next().ok_or_else(|| {
                    wrong_input(format!(
                        "{}: has no test cameras, expected one that has",
                        place.capture(scene).display()
                    ))
                })?;
                let drawn = model.drawn(frame - model.first_frame)?;
                let (output, _) =
                    renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &RenderSettings::default())?;
                if names.len() == 1 {
                    let truths = columns.first_mut();
                    match truths {
                        Some(truths) => truths.push(view.image),
                        None => columns.push(vec![view.image]),
                    }
                }
                column.push(output.image);
                of = format!("camera {}, frames {shown:?}", view.camera_id);
            }
            columns.push(column);
            names.push(row.label.clone());
        }
        if columns.is_empty() {
            continue;
        }
        let caption = format!("{scene}, {of}; from left to right: {}", names.join(", "));
        let name = PathBuf::from(format!("{}-{scene}.png", plan.name));
        let png = png(&grid(&columns)).with_context(|| format!("drawing {}", name.display()))?;
        let picture = Picture { caption, png };
        grids.push((name, picture));
    }
    Ok(grids)
}

/// - `columns`: all as long and of one size
fn grid(columns: &[Vec<Image>]) -> RgbImage {
    let (width, height) = (columns[0][0].width as u32, columns[0][0].height as u32);
    let factor = WIDTH.div_ceil(width).max(1);
    let (width, height) = (width * factor, height * factor);
    let rows = columns.iter().map(Vec::len).min().unwrap_or(0) as u32;
    let (across, down) = (columns.len() as u32 * (width + GAP) - GAP, rows * (height + GAP) - GAP);
    let mut grid = RgbImage::from_pixel(across, down, Rgb([255; 3]));
    for (column, images) in (0_u32..).zip(columns) {
        for (row, image) in (0..rows).zip(images) {
            let bytes = image.to_rgb8();
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let at = 3 * ((y / factor) as usize * image.width + (x / factor) as usize);
                let pixel = Rgb([bytes[at], bytes[at + 1], bytes[at + 2]]);
                grid.put_pixel(column * (width + GAP) + x, row * (height + GAP) + y, pixel);
            }
        }
    }
    grid
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_lie_in_rows_and_columns() {
        let gray = |value: f32| Image::filled(200, 100, 3, value);
        let grid = grid(&[vec![gray(0.0), gray(0.2)], vec![gray(0.4), gray(0.6)], vec![gray(0.8), gray(1.0)]]);
        // Twice as large, to be at least 320 pixels wide.
        assert_eq!((grid.width(), grid.height()), (3 * 400 + 2 * GAP, 2 * 200 + GAP));
        let at = |column: u32, row: u32| grid.get_pixel(column * (400 + GAP) + 399, row * (200 + GAP) + 199)[0];
        assert_eq!([at(0, 0), at(0, 1), at(1, 0), at(1, 1), at(2, 0), at(2, 1)], [0, 51, 102, 153, 204, 255]);
        assert_eq!(grid.get_pixel(401, 5)[0], 255);
    }
}

//! The page of results, `report.html`: pictures, figures, what was uncertain, and how to repeat it.

use std::path::Path;

use serde_json::Value;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Camera, cameras_between, read_file, read_text};
use tcgs_pipeline::{EvaluateSettings, Evaluation, OpenScene, OpenSettings, capture_for, evaluate};
use tcgs_render::{DrawAny, RenderSettings};
use tcgs_report::plot::escape;
use tcgs_report::{Picture, document, list, pictures, png, psnr_over_time, seconds, section, summary};
use tcgs_serve::{PAGE, single_file};

use super::budget::Plan;
use super::record::Record;
use crate::backend::{BackendName, BackendOptions};
use crate::export::MAX_PAGE_SCENE;
use crate::next;
use crate::output::show_bytes;
use crate::pictures::{rgb, series, side_by_side, spread};
use crate::scene::describe_trust;
use crate::teller::Teller;

/// Frames whose pictures are shown, spread over the clip.
const SHOWN: usize = 3;
/// Pictures from between the cameras.
const BETWEEN: usize = 4;
/// Frames that are measured, spread over the clip.
const MEASURED: usize = 20;
/// Largest JSON file of a step, bytes.
const MAX_JSON: u64 = 64 << 20;

/// The page and its figures.
pub struct Results {
    pub html: String,
    /// The figures in words.
    pub line: String,
    pub bytes: u64,
    /// Mean PSNR over the measured images, dB.
    pub psnr: f64,
    /// Whether cameras were held out from training to measure with.
    pub held_out: bool,
}

/// Measures the scene and makes the page.
pub fn make(
    folder: &Path,
    place: &Path,
    file: &Path,
    record: &Record,
    plan: &Plan,
    backend: &BackendOptions,
) -> anyhow::Result<Results> {
    let renderer = backend.open(BackendName::Auto)?.renderer();
    let scene = OpenScene::open(file, OpenSettings::default())?;
    let run = tcgs_train::Run::open(&folder.join("run"))?;
    let capture = Capture::open(place)?;
    let capture = capture_for(run.config(), &capture)?;
    let held_out = !capture.camera_names(Split::Test, scene.first_frame)?.is_empty();
    let split = if held_out { Split::Test } else { Split::Train };
    let evaluation = measure(&scene, &capture, split, plan.downscale, &*renderer)?;
    let mean = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let [psnr, ssim] = [mean(evaluation.mean(|i| Some(i.psnr))), mean(evaluation.mean(|i| Some(i.ssim)))];
    let of = if held_out { "cameras that training never saw" } else { "cameras that were trained on, which flatters" };
    let size = show_bytes(scene.bytes);
    let line = format!(
        "{}: {size}, {} frames, PSNR {psnr:.2} dB and SSIM {ssim:.3} over {of}",
        file.display(),
        scene.num_timesteps()
    );

    let prepared = prepared(folder);
    let mut uncertain = uncertain(&prepared, record, held_out);
    uncertain.extend(scene.trust()?.as_ref().map(describe_trust));
    let figures = [
        ("size", size),
        (
            "a second of the clip",
            show_bytes((scene.bytes as f64 * scene.frame_rate / scene.num_timesteps() as f64) as u64),
        ),
        (if held_out { "PSNR, held-out cameras" } else { "PSNR, trained cameras" }, format!("{psnr:.2} dB")),
        ("SSIM", format!("{ssim:.3}")),
        ("frames", format!("{} at {:.1} a second", scene.num_timesteps(), scene.frame_rate)),
        ("pixels of an image", format!("{}x{}", plan.size[0], plan.size[1])),
    ];
    let mut body = summary(&figures.map(|(name, value)| (name.into(), value)));
    play(&mut body, file);
    let beside = pairs(&scene, &capture, split, plan.downscale, &*renderer)?;
    section(&mut body, "Pictures", &format!("Photograph and render, of {of}."), &pictures(&beside));
    let note = "Renders from half way between the cameras, where there is no photograph to compare with.";
    section(&mut body, "Between the cameras", note, &pictures(&between(&scene, &capture, plan.downscale, &*renderer)?));
    section(&mut body, "What to expect", "", &list(uncertain.iter().map(String::as_str)));
    section(&mut body, "Quality over time", "", &psnr_over_time(&[series("scene", &evaluation, |i| Some(i.psnr))]));
    let took: Vec<(String, f64)> =
        record.steps().iter().filter_map(|step| Some((step.name.clone(), step.seconds?))).collect();
    section(&mut body, "Time", "", &seconds(&took));
    let commands: Vec<&str> = record.steps().iter().map(|step| step.command.as_str()).collect();
    section(&mut body, "Commands", "Each step is a command that can be repeated with other options.", &list(commands));
    let name = file.file_stem().unwrap_or_default().to_string_lossy();
    Ok(Results { html: document(&name, &body), line, bytes: scene.bytes, psnr, held_out })
}

/// The player with the scene. Without a player in this program, or for a scene too large for a page, names the command.
fn play(body: &mut String, file: &Path) {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    if let Ok(player) = read_file(file, MAX_PAGE_SCENE).and_then(|scene| single_file(PAGE, &name, &scene)) {
        let note = "Drag to turn, scroll to zoom, space to pause.";
        // The frame is a page of its own, so that the styles of both do not mix.
        let frame = format!(
            "<iframe title=\"The scene\" allow=\"fullscreen\" loading=\"lazy\" \
             style=\"width: 100%; aspect-ratio: 16 / 9; border: 0\" srcdoc=\"{}\"></iframe>\n",
            escape(&player)
        );
        section(body, "Play it", note, &frame);
        return;
    }
    let look = format!("tcgs view {}", next::quoted(&file.canonicalize().unwrap_or_else(|_| file.into())));
    section(body, "Play it", "This command opens the scene in a browser.", &list([look.as_str()]));
}

/// The quality of some frames.
fn measure(
    scene: &OpenScene,
    capture: &Capture,
    split: Split,
    downscale: usize,
    renderer: &DrawAny,
) -> anyhow::Result<Evaluation> {
    let frames = scene.frames();
    let step = frames.len().div_ceil(MEASURED);
    let mut all: Option<Evaluation> = None;
    for frame in frames.step_by(step.max(1)) {
        let settings = EvaluateSettings { frames: frame..frame + 1, downscale, ..EvaluateSettings::of(scene, split) };
        let of_frame = Teller::default().watch(|teller| evaluate(scene, capture, &settings, renderer, teller))?;
        match &mut all {
            Some(all) => all.images.extend(of_frame.images),
            None => all = Some(of_frame),
        }
    }
    all.ok_or_else(|| anyhow::anyhow!("{}: no frames", scene.path.display()))
}

/// Photographs beside renders, at some frames of one camera after another.
fn pairs(
    scene: &OpenScene,
    capture: &Capture,
    split: Split,
    downscale: usize,
    renderer: &DrawAny,
) -> anyhow::Result<Vec<Picture>> {
    let mut shown = Vec::new();
    for (i, frame) in spread(&scene.frames(), SHOWN).into_iter().enumerate() {
        let views = capture.views(split, frame, downscale)?;
        let names = capture.camera_names(split, frame)?;
        let at = i * views.len() / SHOWN;
        let (Some(view), Some(name)) = (views.get(at), names.get(at)) else { continue };
        let drawn = scene.drawn(frame - scene.first_frame)?;
        let (output, _) = renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &RenderSettings::default())?;
        let caption = format!("Camera {name}, frame {frame}: photograph, and render");
        shown.push(Picture { caption, png: png(&side_by_side(&view.image, &output.image))? });
    }
    Ok(shown)
}

/// Renders from between the training cameras, at the middle of the clip.
fn between(scene: &OpenScene, capture: &Capture, downscale: usize, renderer: &DrawAny) -> anyhow::Result<Vec<Picture>> {
    let frame = spread(&scene.frames(), SHOWN)[SHOWN / 2];
    let cameras: Vec<Camera> =
        capture.cameras(Split::Train, frame, downscale)?.into_iter().map(|(_, camera)| camera).collect();
    let drawn = scene.drawn(frame - scene.first_frame)?;
    let step = cameras.len().div_ceil(BETWEEN).max(1);
    let between = cameras_between(&cameras, 0..cameras.len()).into_iter().step_by(step);
    let picture = |camera: Camera| {
        let (output, _) = renderer.draw(&drawn.seen_by(&camera), &camera, &RenderSettings::default())?;
        Ok(Picture { caption: format!("Between the cameras, frame {frame}"), png: png(&rgb(&output.image))? })
    };
    between.map(picture).collect()
}

/// The record of `tcgs prepare`; null if it was not needed.
fn prepared(folder: &Path) -> Value {
    let text = read_text(&folder.join("prepare.json"), MAX_JSON).ok();
    text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
}

/// Uncertain results of the steps, and the views that can be expected to be good.
fn uncertain(prepared: &Value, record: &Record, held_out: bool) -> Vec<String> {
    let check = &prepared["check"];
    let mut lines = Vec::new();
    lines.extend(check["expectation"].as_str().map(str::to_owned));
    for finding in check["findings"].as_array().into_iter().flatten() {
        let names: Vec<&str> = finding["names"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let text = |key: &str| finding[key].as_str().unwrap_or_default().to_owned();
        lines.push(format!("{}: {}; {}", names.join(", "), text("problem"), text("fix")));
    }
    if let Some(undecided) = check["undecided"].as_array().filter(|undecided| !undecided.is_empty()) {
        let of = check["cameras"].as_array().map_or(0, Vec::len);
        lines.push(format!("of {} of {of} cameras the check cannot tell whether they are right", undecided.len()));
    }
    lines.extend(prepared["clock"].as_str().filter(|&clock| clock == "assumed").map(|_| {
        "neither sound nor motion tells how the cameras' clocks differ: all are taken to begin at once".into()
    }));
    if !held_out {
        lines.push("no camera was held out, so the figures are of images that were trained on".into());
    }
    lines.extend(record.notes().map(Into::into));
    lines
}

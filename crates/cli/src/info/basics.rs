//! The basics of a scene of any kind but `.tcgs`. Anything else gets one line that names its kind.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::Capture;
use tcgs_core::SceneReader;
use tcgs_pipeline::PipelineError;
use tcgs_prepare::RawFootage;

use crate::error::wrong_input;
use crate::output::{show_bytes, show_color};
use crate::scene::{SourceOptions, numbers};
use crate::terminal::say;

/// Prints the basics of a scene.
///
/// - `source`: options for reading it
/// - `data`: name of application data, which no such scene has
/// - returns: the same as JSON
pub fn print(path: &Path, source: SourceOptions, data: Option<&str>) -> anyhow::Result<Value> {
    let scene = source.open(path).map_err(|error| what_it_is(path, error))?;
    if let Some(name) = data {
        let found = format!("{}, which holds no data of applications", scene.kind());
        return Err(wrong_input(format!("{}: {found}, expected a .tcgs file with {name}", path.display())));
    }
    let bounds = Bounds::of(scene.at(0)?.means());
    let [least, most] = numbers(&scene);
    let (first_frame, frame_rate) = (scene.declared_first_frame(), scene.declared_frame_rate());
    let (file_bytes, layout, axes) =
        (scene.file_bytes().ok(), scene.layout(), scene.axes().map(|axes| axes.to_string()));

    let size = file_bytes.map_or("unknown".into(), show_bytes);
    say(&format!("{}: {}, {size}", scene.path.display(), scene.kind()))?;
    let gaussians = if least == most { most.to_string() } else { format!("{least} to {most}") };
    let all = scene.num_identities().unwrap_or(most);
    let of_all = if most < all { format!(" of {all}") } else { String::new() };
    let pruning = if scene.run().is_some() { ", before pruning" } else { "" };
    say(&format!("Gaussians     {gaussians}{of_all}{pruning}"))?;
    let num_timesteps = scene.num_timesteps();
    let frames = first_frame.map(|first| format!(" (frames {first} to {})", first + num_timesteps - 1));
    say(&format!("timesteps     {num_timesteps}{}", frames.unwrap_or_default()))?;
    say(&format!("frame rate    {}", frame_rate.map_or("unknown".into(), |rate| format!("{} a second", rate as f32))))?;
    say(&format!("harmonics     degree {}", layout.sh_degree()))?;
    say(&format!("antialiased   {}", if layout.is_antialiased() { "yes" } else { "no" }))?;
    say(&format!("background    {}", show_color(layout.background())))?;
    say(&format!("axes          {}", axes.as_deref().unwrap_or("unknown")))?;
    if let Some(bounds) = &bounds {
        bounds.print()?;
    }
    let ratio = file_bytes.map(|bytes| format!(" ({:.1} times as much)", scene.bytes as f64 / bytes.max(1) as f64));
    say(&format!("as floats     {}{}", show_bytes(scene.bytes), ratio.unwrap_or_default()))?;
    Ok(json!({
        "kind": scene.kind(),
        "version": null,
        "num_gaussians": all,
        "least_gaussians": least,
        "most_gaussians": most,
        "num_timesteps": num_timesteps,
        "first_frame": first_frame,
        "frame_rate": frame_rate,
        "sh_degree": layout.sh_degree(),
        "antialiased": layout.is_antialiased(),
        "background": layout.background(),
        "axes": axes,
        "bounds": bounds.map(Bounds::into_json),
        "raw_bytes": scene.bytes,
        "bytes": file_bytes,
    }))
}

/// Turns the error of opening into one that names the kind if the path is a capture or holds videos.
fn what_it_is(path: &Path, error: PipelineError) -> anyhow::Error {
    if path.is_dir() && RawFootage::is_in(path).unwrap_or(false) {
        wrong_input(format!(
            "{}: a folder of videos, expected a scene; tcgs prepare makes a capture of it",
            path.display()
        ))
    } else if let Some(capture) =
        Some(path).filter(|path| path.is_dir()).and_then(|path| Capture::open_unseen(path).ok())
    {
        let kind = capture.kind().name;
        wrong_input(format!("{}: a {kind} capture, expected a scene; tcgs train makes one of it", path.display()))
    } else {
        error.into()
    }
}

/// The box around the means of one timestep.
pub struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

impl Bounds {
    /// The bounds of the means; `None` without any Gaussian.
    ///
    /// - `means`: `[N, 3]`
    pub fn of(means: &[[f32; 3]]) -> Option<Self> {
        let (first, rest) = means.split_first()?;
        Some(rest.iter().fold(Self { min: *first, max: *first }, |Self { min, max }, mean| Self {
            min: std::array::from_fn(|c| min[c].min(mean[c])),
            max: std::array::from_fn(|c| max[c].max(mean[c])),
        }))
    }

    /// Prints the bounds as a line of a table.
    pub fn print(&self) -> anyhow::Result<()> {
        let corner = |point: [f32; 3]| point.map(|x| format!("{x:.4}")).join(" ");
        say(&format!("bounds        {} to {}, at the first timestep", corner(self.min), corner(self.max)))
    }

    /// The bounds as JSON.
    pub fn into_json(self) -> Value {
        json!({ "min": self.min, "max": self.max })
    }
}

//! Scenes of the bench as files, so that other renderers can draw and time the same scenes.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use serde_json::json;
use tcgs_core::{Image, activate};
use tcgs_interchange::{NpzWriter, write_ply_to};
use tcgs_pipeline::{Backend, NewFolder};
use tcgs_render::RenderSettings;

use super::scene::BenchScene;
use crate::output::finish;

/// Files of a scene: the Gaussians as 3D Gaussian splatting stores them, the camera, and the camera's image.
const FILES: [&str; 3] = ["gaussians.ply", "camera.json", "image.npz"];

/// Writes every scene, seen by its first camera, into its own folder `NAME-WxH`.
///
/// - `folder`: a new one, or with `force` one that this command wrote
/// - returns: the folder of every scene
pub fn write(folder: &Path, scenes: &[BenchScene], backend: &Backend, force: bool) -> anyhow::Result<Vec<PathBuf>> {
    let new = NewFolder::begin(folder, force, |path| FILES.iter().any(|name| path.ends_with(name)))?;
    let renderer = backend.renderer();
    let mut written = Vec::new();
    for scene in scenes {
        let (gaussians, camera) = (&scene.state.parameters.gaussians, &scene.targets[0].camera);
        let name = format!("{}-{}x{}", scene.name, camera.width, camera.height);
        let path = new.path().join(&name);
        std::fs::create_dir_all(&path).with_context(|| format!("creating {}", path.display()))?;
        let settings = RenderSettings::default();
        let (output, _) = renderer.draw(&Arc::new(activate(gaussians)), camera, &settings)?;
        let about = json!({
            "width": camera.width,
            "height": camera.height,
            "focal": camera.focal,
            "principal": camera.principal,
            "camera_from_world": camera.camera_from_world,
        });
        let [ply, json, npz] = FILES.map(|name| path.join(name));
        let context = |file: &Path| format!("writing {}", file.display());
        write_with(&ply, |file| write_ply_to(file, gaussians)).with_context(|| context(&ply))?;
        write_with(&json, |file| writeln!(file, "{about:#}")).with_context(|| context(&json))?;
        write_with(&npz, |file| write_image(file, &output.image)).with_context(|| context(&npz))?;
        written.push(folder.join(name));
    }
    finish(new, |_| false)?;
    Ok(written)
}

fn write_with(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    write(&mut file)?;
    file.flush()
}

/// Writes the array `image`, `[H, W, 3]`: unclamped floats over black, display-referred like the colours.
fn write_image(file: &mut BufWriter<File>, image: &Image) -> std::io::Result<()> {
    let planes: [&[f32]; 3] = std::array::from_fn(|channel| image.plane(channel));
    let pixels: Vec<f32> = (0..image.width * image.height).flat_map(|i| planes.map(|plane| plane[i])).collect();
    let mut npz = NpzWriter::new(file);
    npz.array("image", &[image.height, image.width, 3], [&pixels[..]])?;
    npz.finish()?;
    Ok(())
}

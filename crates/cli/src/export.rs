//! `tcgs export`: a scene for other programs.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use serde_json::json;
use tcgs_core::{SceneReader, read_file};
use tcgs_interchange::{SpzVersion, parent_folder};
use tcgs_pipeline::{Export, NewFolder, TimestepKind};
use tcgs_serve::{NO_PAGE, PAGE, single_file};

use crate::error::wrong_input;
use crate::options::{Frames, JobOptions};
use crate::output::{check_folder, finish, is_numbered, show_bytes, show_color, write_file_with};
use crate::scene::{SceneOptions, describe, note_replaced};
use crate::teller::Teller;
use crate::terminal::{note, say};
use crate::view::check_scene;

/// Name of the table of an unpacked SOG.
const SOG_TABLE: &str = "meta.json";
/// Largest scene in a page, bytes. Browsers hold no longer texts than half a gigabyte.
pub const MAX_PAGE_SCENE: u64 = 1 << 28;

/// Export a scene for other programs
///
/// A params.npz is the format of Dynamic 3D Gaussians and its viewer. It holds the same Gaussians at all timesteps,
/// scales and opacities once, and no spherical harmonics. Runs of the presets d3dgs and paper have the same Gaussians
/// at all timesteps. In runs of the presets default and fast Gaussians are born and die. Choose frames between two
/// births or deaths with --frames, or write another kind of file: all others hold the whole scene.
///
/// A PLY file has the format of 3D Gaussian splatting, which most viewers read. A .glb file is glTF with
/// KHR_gaussian_splatting. Files of the endings .compressed.ply, .spz and .sog are smaller and round all numbers; a
/// .sog file rounds colours and harmonics most. All of these hold one timestep; in a folder of many a file's name is
/// its frame. NAME/meta.json is a .sog file unpacked into the new folder NAME. An .spz file declares the axes of PLY
/// files. A .4dgs file holds all timesteps, quantised as finely as its format offers. A .usda file is animated USD for
/// Omniverse, Houdini and others (ParticleField3DGaussianSplat of OpenUSD 26.03), as text: usdcat makes it smaller. A
/// .f32 file holds plain floats, bit for bit: for each frame all means, quats, log_scales, logit_opacities and colors,
/// then further columns, little-endian. A run is exported in floats, without the Gaussians that its masks prune: these
/// files cannot hold masks.
///
/// A .html file is the player with a .tcgs file in it. A browser opens it from a disk, without a server and without a
/// network.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs export my_run --to plys
  tcgs export my_d3dgs_run --to params.npz
  tcgs export scene.tcgs --to glbs --files glb
  tcgs export scene.tcgs --to for_supersplat --files sog
  tcgs export scene.tcgs --frames 7..8 --to frame_7/meta.json    unpacked SOG
  tcgs export scene.tcgs --to scene.4dgs
  tcgs export scene.tcgs --to scene.usda
  tcgs export scene.tcgs --to scene.html         a page to send to a friend
  tcgs export scene.tcgs --frames 7..8 --to frame_7.ply")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz, .4dgs file, or PLY, SPZ, glTF or SOG files
    scene: PathBuf,
    #[command(flatten)]
    reading: SceneOptions,
    /// File or folder to write. The ending selects the format: .npz, .4dgs, .usda, .html or .f32 for all timesteps,
    /// .ply, .compressed.ply, .spz, .glb, .sog or /meta.json for one, none for a folder of these
    #[arg(long, value_name = "FILE|DIR")]
    to: PathBuf,
    /// Which files a folder gets
    #[arg(long, value_name = "KIND", default_value = "ply")]
    files: Files,
    /// Version of .spz files. More programs read 3, which is smaller [default: 3]
    #[arg(long, value_name = "N")]
    spz_version: Option<SpzVersions>,
    /// Frames of the capture, from A up to but not including B [default: all of the scene]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    #[command(flatten)]
    job: JobOptions,
}

/// Formats of the files in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Files {
    /// PLY of 3D Gaussian splatting
    Ply,
    /// Compressed PLY of SuperSplat
    CompressedPly,
    /// SPZ
    Spz,
    /// glTF with KHR_gaussian_splatting
    Glb,
    /// SOG, version 2
    Sog,
}

impl From<Files> for TimestepKind {
    fn from(files: Files) -> Self {
        match files {
            Files::Ply => Self::Ply,
            Files::CompressedPly => Self::CompressedPly,
            Files::Spz => Self::Spz(SpzVersion::default()),
            Files::Glb => Self::Glb,
            Files::Sog => Self::Sog,
        }
    }
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum SpzVersions {
    #[value(name = "3")]
    V3,
    #[value(name = "4")]
    V4,
}

impl From<SpzVersions> for SpzVersion {
    fn from(version: SpzVersions) -> Self {
        match version {
            SpzVersions::V3 => Self::V3,
            SpzVersions::V4 => Self::V4,
        }
    }
}

/// Format of the output.
enum Target {
    ParamsNpz,
    Timestep(TimestepKind),
    Fourdgs,
    Usda,
    Floats,
    Folder(TimestepKind, NewFolder),
    UnpackedSog(NewFolder),
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let (to, force) = (&arguments.to, arguments.job.force);
    if !to.is_dir() && to.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html")) {
        return write_page(arguments);
    }
    let target = target(arguments)?;
    let scene = arguments.reading.open(&arguments.scene)?;
    let frames = scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?;
    say(&describe(&scene))?;
    let export = Export::new(&scene)?;
    if let (Some(kept), Some(all)) = (export.num_identities(), scene.num_identities())
        && kept < all
    {
        say(&format!("{kept} of {all} Gaussians are not masked out"))?;
    }
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |written| written.len());
    let is_for_others = !matches!(target, Target::Floats);
    let bytes = match target {
        Target::ParamsNpz => {
            let params = export.params(frames.clone())?;
            if !params.has_background() {
                note("no Gaussian is marked as background: a viewer that hides the background hides nothing");
            }
            write_file_with(to, force, |file| params.write(BufWriter::new(file))?.flush())?;
            if frames.start > 0 {
                let start = frames.start;
                note(&format!("other programs number the timesteps of a params.npz from 0: 0 is frame {start} here"));
            }
            length(to)
        }
        Target::Timestep(_) | Target::UnpackedSog(_) if frames.len() > 1 => {
            let (count, start) = (frames.len(), frames.start);
            let expected = format!("--frames {start}..{} for one, or a folder", start + 1);
            return Err(wrong_input(format!("{}: a file for {count} timesteps, expected {expected}", to.display())));
        }
        Target::Timestep(kind) => {
            write_file_with(to, force, export.timestep(kind, frames.start)?)?;
            length(to)
        }
        Target::Fourdgs => {
            let bytes = export.fourdgs(frames)?;
            write_file_with(to, force, |mut file| file.write_all(&bytes))?;
            length(to)
        }
        Target::Usda => {
            write_file_with(to, force, export.usda(frames)?)?;
            length(to)
        }
        Target::Floats => {
            let mut failed = None;
            let floats = export.floats(frames)?;
            let written = write_file_with(to, force, |mut file| {
                for frame in floats {
                    match frame {
                        Ok(bytes) => file.write_all(&bytes)?,
                        Err(error) => {
                            failed = Some(error);
                            return Err(std::io::Error::other("a frame cannot be read"));
                        }
                    }
                }
                Ok(())
            });
            failed.map_or(Ok(()), Err)?;
            written?;
            length(to)
        }
        Target::Folder(kind, folder) => {
            let bytes = Teller::default().watch(|teller| export.write_folder(kind, frames, folder.path(), teller))?;
            finish(folder, |_| false)?;
            bytes
        }
        Target::UnpackedSog(folder) => {
            let bytes = export.write_unpacked_sog(frames.start, folder.path())?;
            finish(folder, |_| false)?;
            bytes
        }
    };
    say(&format!("{}: {}", to.display(), show_bytes(bytes)))?;
    if scene.layout().is_antialiased() && is_for_others {
        note(
            "the scene is antialiased: switch on antialiasing in the program that draws it, or small splats look too large",
        );
    }
    if scene.layout().background() != [0; 3] && is_for_others {
        let color = show_color(scene.layout().background());
        note(&format!("set the background to {color} in the program that draws the scene, or it looks too dark"));
    }
    note_replaced(&scene);
    arguments.job.write_json(&json!({ "out": to.display().to_string(), "bytes": bytes }))
}

/// Writes the player with the scene as one page.
fn write_page(arguments: &Arguments) -> anyhow::Result<()> {
    let (scene, to, job) = (&arguments.scene, &arguments.to, &arguments.job);
    job.begin(&[to], &[scene])?;
    if let Some(frames) = &arguments.frames {
        let problem = format!("--frames {}..{} of a page", frames.0.start, frames.0.end);
        return Err(wrong_input(format!("{problem}, expected none: a page holds all of a scene")));
    }
    if arguments.spz_version.is_some() {
        return Err(not_spz());
    }
    check_scene(scene)?;
    if PAGE.is_empty() {
        return Err(anyhow!(NO_PAGE));
    }
    let name = scene.file_name().unwrap_or_default().to_string_lossy();
    let html = single_file(PAGE, &name, &read_file(scene, MAX_PAGE_SCENE)?)?;
    write_file_with(to, job.force, |mut file| file.write_all(html.as_bytes()))?;
    say(&format!("{}: {}", to.display(), show_bytes(html.len() as u64)))?;
    job.write_json(&json!({ "out": to.display().to_string(), "bytes": html.len() }))
}

/// Selects the format by the ending and the options. Refuses before the work what could not be written after it.
fn target(arguments: &Arguments) -> anyhow::Result<Target> {
    let mut target = target_by_ending(arguments)?;
    if let Some(version) = arguments.spz_version {
        let (Target::Timestep(kind @ TimestepKind::Spz(_)) | Target::Folder(kind @ TimestepKind::Spz(_), _)) =
            &mut target
        else {
            return Err(not_spz());
        };
        *kind = TimestepKind::Spz(version.into());
    }
    Ok(target)
}

fn not_spz() -> anyhow::Error {
    wrong_input("--spz-version of a file that is no SPZ, expected --to NAME.spz, or --files spz and a folder")
}

fn target_by_ending(arguments: &Arguments) -> anyhow::Result<Target> {
    let (to, job, scene) = (&arguments.to, &arguments.job, arguments.scene.as_path());
    let file = |target| job.begin(&[to], &[scene]).map(|()| target);
    if let Some(kind) = TimestepKind::of(to).filter(|_| !to.is_dir()) {
        return file(Target::Timestep(kind));
    }
    let in_folder = |folder: &Path, is_ours: fn(&Path) -> bool| {
        job.begin(&[], &[scene])?;
        check_folder(folder, &[scene])?;
        Ok::<_, anyhow::Error>(NewFolder::begin(folder, job.force, is_ours)?)
    };
    if to.ends_with(SOG_TABLE) && !to.is_dir() {
        let is_ours =
            |path: &Path| path.ends_with(SOG_TABLE) || path.extension().is_some_and(|ending| ending == "webp");
        return Ok(Target::UnpackedSog(in_folder(parent_folder(to), is_ours)?));
    }
    match to.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
        Some("npz") => file(Target::ParamsNpz),
        Some("4dgs") => file(Target::Fourdgs),
        Some("usda") => file(Target::Usda),
        Some("f32") => file(Target::Floats),
        other if other.is_none() || to.is_dir() => {
            let is_ours = |path: &Path| TimestepKind::ALL.iter().any(|kind| is_numbered(path, kind.ending()));
            Ok(Target::Folder(arguments.files.into(), in_folder(to, is_ours)?))
        }
        _ => {
            let problem = "not a kind of file that this version writes";
            let expected = "NAME.npz, NAME.ply, NAME.compressed.ply, NAME.spz, NAME.glb, NAME.sog, NAME/meta.json, \
                            NAME.4dgs, NAME.usda, NAME.html, NAME.f32, or a folder's name without an ending";
            Err(wrong_input(format!("{}: {problem}, expected {expected}", to.display())))
        }
    }
}

//! A scene for other programs: `params.npz`, PLY files and plain floats.

use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use tcgs_core::{Attribute, Gaussians, Layout, SceneReader};
use tcgs_interchange::{ParamsExtras, ParamsOrigin, write_params_npz_from, write_ply_to};

use crate::observe::tell;
use crate::{Event, Observer, OpenScene, PipelineError, Work, kept_gaussians};

/// `params.npz` holds floats, of which the whole numbers end here.
const MAX_FRAME_OF_PARAMS: usize = 1 << 24;

/// Writes a scene for other programs, in floats. Of a run the Gaussians that its masks leave out over time are left out:
/// such files have no place for masks.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::{ParamsExtras, write_params_npz};
/// use tcgs_pipeline::{Export, OpenScene, OpenSettings, Unobserved};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// let mut floats = DynamicGaussians::default();
/// floats.push(Gaussians::zeros(5));
/// write_params_npz(&path, &floats, &ParamsExtras::default())?;
///
/// let scene = OpenScene::open(&path, OpenSettings::default())?;
/// let export = Export::new(&scene)?;
/// let bytes = export.write_ply_folder(scene.frames(), folder.path(), &mut Unobserved)?;
/// assert_eq!(bytes, std::fs::metadata(folder.path().join("000000.ply"))?.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Export<'a> {
    scene: &'a OpenScene,
    keep: Vec<usize>,
}

impl<'a> Export<'a> {
    /// Decides which Gaussians stay.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the masks of a run leave none, or the scene has a column that no other program's files hold; [`PipelineError`] if a file of the scene is damaged.
    pub fn new(scene: &'a OpenScene) -> Result<Self, PipelineError> {
        let keep = kept_gaussians(scene, None)?;
        if let Some(column) = scene.layout().further() {
            let found = format!("has the column {}, which neither a params.npz nor PLY files hold", column.name);
            return Err(PipelineError::input(
                scene.path.display(),
                found,
                "means, quats, log_scales, logit_opacities and colors",
            ));
        }
        Ok(Self { scene, keep })
    }

    /// How many Gaussians stay.
    pub fn num_gaussians(&self) -> usize {
        self.keep.len()
    }

    /// Refuses a scene without Gaussians, which other programs do not read.
    fn check_some(&self) -> Result<(), PipelineError> {
        if self.keep.is_empty() {
            return Err(PipelineError::input(self.scene.path.display(), "has no Gaussians", "at least one"));
        }
        Ok(())
    }

    /// The Gaussians that stay, at one frame.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene lacks the frame, or it cannot be read.
    pub fn gaussians(&self, frame: usize) -> Result<Gaussians, PipelineError> {
        self.scene.choose_frames(Some(&(frame..frame + 1)))?;
        let gaussians = self.scene.at(frame - self.scene.first_frame)?;
        Ok(if self.keep.len() < gaussians.num_gaussians() { gaussians.select(&self.keep) } else { gaussians })
    }

    /// The arrays of a `params.npz` of some frames.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if there are no Gaussians, scales or opacities vary with time or the first frame's number is too large, neither
    /// of which a `params.npz` can hold; [`PipelineError`] if a frame is missing or cannot be read.
    pub fn params(&self, frames: Range<usize>) -> Result<ExportedParams<'_>, PipelineError> {
        let scene = self.scene;
        self.check_some()?;
        let frames = scene.choose_frames(Some(&frames))?;
        let first = self.gaussians(frames.start)?;
        for frame in frames.start + 1..frames.end {
            let gaussians = self.gaussians(frame)?;
            for attribute in [Attribute::LogScale, Attribute::LogitOpacity] {
                if gaussians.values(attribute) != first.values(attribute) {
                    let found = format!("{} vary with time, which a params.npz cannot hold", attribute.name());
                    return Err(PipelineError::input(
                        scene.path.display(),
                        found,
                        "a folder of PLY files to export to",
                    ));
                }
            }
        }
        // A number of 32 bits, where frames are counted by dates or clocks, would be another one.
        if frames.start >= MAX_FRAME_OF_PARAMS {
            let found = format!("begins at frame {}, which a params.npz cannot hold", frames.start);
            let expected = format!("a frame below {MAX_FRAME_OF_PARAMS}, or a folder of PLY files to export to");
            return Err(PipelineError::input(scene.path.display(), found, expected));
        }
        let foreground = scene.first_checkpoint().map(|first| {
            let foreground = &first.parameters.foreground;
            self.keep.iter().map(|&i| foreground[i]).collect()
        });
        Ok(ExportedParams { export: self, frames, foreground })
    }

    /// Writes one frame as a PLY file.
    ///
    /// # Errors
    /// [`PipelineError`] if the frame is missing or cannot be read.
    pub fn ply(&self, frame: usize) -> Result<impl Fn(&File) -> io::Result<()> + use<>, PipelineError> {
        self.check_some()?;
        let gaussians = self.gaussians(frame)?;
        Ok(move |file: &File| write_ply(file, &gaussians))
    }

    /// Plain floats, bit for bit as they are stored: for each frame all means, quats, log_scales, logit_opacities and
    /// colors, each `[N, components]`, as little-endian binary32 (`docs/FORMAT.md`, "Conformance").
    ///
    /// - returns: `[N * 14 * 4]` bytes a frame, or why the frame cannot be read
    ///
    /// # Errors
    /// [`PipelineError::Frames`] if the scene lacks a frame.
    pub fn floats(
        &self,
        frames: Range<usize>,
    ) -> Result<impl Iterator<Item = Result<Vec<u8>, PipelineError>>, PipelineError> {
        let bytes = |gaussians: Gaussians| {
            let values = Attribute::BASE.into_iter().flat_map(|a| gaussians.values(a).iter());
            values.flat_map(|x| x.to_le_bytes()).collect()
        };
        Ok(self.scene.choose_frames(Some(&frames))?.map(move |frame| self.gaussians(frame).map(bytes)))
    }

    /// Writes a PLY file a frame, named by its number: `000012.ply`.
    ///
    /// - `folder`: exists; what is in it stays
    /// - returns: bytes written
    ///
    /// # Errors
    /// [`PipelineError::Unwritable`] if a file cannot be written; [`PipelineError`] if a frame is missing or cannot be
    /// read; [`PipelineError::Stopped`] if the observer broke off.
    pub fn write_ply_folder(
        &self,
        frames: Range<usize>,
        folder: &Path,
        observer: &mut dyn Observer,
    ) -> Result<u64, PipelineError> {
        self.check_some()?;
        let frames = self.scene.choose_frames(Some(&frames))?;
        tell(observer, Event::Begun { work: Work::Exporting, num_steps: frames.len() })?;
        let mut bytes = 0;
        for frame in frames {
            let path = folder.join(format!("{frame:06}.ply"));
            let gaussians = self.gaussians(frame)?;
            let written = File::create(&path).and_then(|file| {
                write_ply(&file, &gaussians)?;
                Ok(file.metadata()?.len())
            });
            bytes += written.map_err(|error| PipelineError::Unwritable { path, error })?;
            tell(observer, Event::Frame(frame))?;
        }
        Ok(bytes)
    }
}

/// The arrays of a `params.npz`, read while they are written.
#[derive(Debug)]
pub struct ExportedParams<'a> {
    export: &'a Export<'a>,
    frames: Range<usize>,
    /// `[N]`, of a run.
    foreground: Option<Vec<bool>>,
}

/// The frames of an export that are asked for.
struct Frames<'a>(&'a ExportedParams<'a>);

impl SceneReader for Frames<'_> {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        SceneReader::layout(self.0.export.scene)
    }

    fn num_gaussians(&self) -> usize {
        self.0.export.keep.len()
    }

    fn num_timesteps(&self) -> usize {
        self.0.frames.len()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        self.0.export.gaussians(self.0.frames.start + timestep)
    }
}

impl ExportedParams<'_> {
    /// Writes the archive. Reads every timestep three times, and holds one.
    ///
    /// # Errors
    /// What the writer reports, and what reading the scene does.
    pub fn write<W: Write + Seek>(&self, writer: W) -> io::Result<W> {
        let scene = self.export.scene;
        let origin = ParamsOrigin {
            first_frame: self.frames.start as u32,
            downscale: scene.downscale as u32,
            frame_rate: scene.frame_rate as f32,
        };
        let cameras = scene.first_checkpoint().map(|first| &first.parameters);
        let extras = ParamsExtras {
            foreground: self.foreground.as_deref(),
            log_gains: cameras.map_or(&[], |p| &p.camera_gains),
            offsets: cameras.map_or(&[], |p| &p.camera_offsets),
            origin: Some(origin),
        };
        write_params_npz_from(writer, &mut Frames(self), &extras)
    }
}

fn write_ply(file: &File, gaussians: &Gaussians) -> io::Result<()> {
    let mut writer = BufWriter::new(file);
    write_ply_to(&mut writer, gaussians)?;
    writer.flush()
}

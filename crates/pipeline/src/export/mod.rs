//! A scene for other programs: `params.npz`, animated USD, files of one timestep and plain floats.

mod identities;

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use tcgs_core::{Attribute, Column, Gaussians, Layout, SceneReader};
use tcgs_interchange::{
    Axes, ParamsExtras, ParamsOrigin, SpzVersion, fourdgs_bytes, sog_files, space_order, write_compressed_ply_to,
    write_glb_to, write_params_npz_from, write_ply_to, write_sog_to, write_spz_to, write_usda_to,
};
use tcgs_train::StandIns;

use self::identities::Identified;
use crate::observe::tell;
use crate::{Event, Observer, OpenScene, PipelineError, Work, kept_gaussians};

/// Number from which on floats, as in `params.npz`, no longer hold all whole numbers.
const MAX_FRAME_OF_PARAMS: usize = 1 << 24;

/// Kinds of files for one timestep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimestepKind {
    /// PLY of 3D Gaussian splatting.
    #[default]
    Ply,
    /// Compressed PLY of `SuperSplat`.
    CompressedPly,
    /// SPZ.
    Spz(SpzVersion),
    /// glTF with `KHR_gaussian_splatting`, in one file.
    Glb,
    /// SOG, version 2, in one file.
    Sog,
}

impl TimestepKind {
    /// A kind for every ending. An ending that ends in another's comes first.
    pub const ALL: [Self; 5] = [Self::CompressedPly, Self::Ply, Self::Spz(SpzVersion::V3), Self::Glb, Self::Sog];

    /// The ending of such a file's name, with its dot.
    pub fn ending(self) -> &'static str {
        match self {
            Self::Ply => ".ply",
            Self::CompressedPly => ".compressed.ply",
            Self::Spz(_) => ".spz",
            Self::Glb => ".glb",
            Self::Sog => ".sog",
        }
    }

    /// The kind that the ending of a file's name selects, in letters of either case.
    ///
    /// ```
    /// use tcgs_pipeline::TimestepKind;
    /// assert_eq!(TimestepKind::of("a/garden.compressed.ply".as_ref()), Some(TimestepKind::CompressedPly));
    /// assert_eq!(TimestepKind::of("compressed.PLY".as_ref()), Some(TimestepKind::Ply));
    /// assert_eq!(TimestepKind::of("ply".as_ref()), None);
    /// ```
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        Self::ALL.into_iter().find(|kind| name.ends_with(kind.ending()))
    }

    /// The name of such a file in messages.
    fn name(self) -> &'static str {
        match self {
            Self::Ply => "a PLY file",
            Self::CompressedPly => "a compressed PLY file",
            Self::Spz(_) => "an SPZ file",
            Self::Glb => "a glTF file",
            Self::Sog => "a SOG file",
        }
    }

    /// Whether such a file is smaller, or more precise, if neighbours in space are neighbours in it.
    fn is_ordered_by_space(self) -> bool {
        matches!(self, Self::CompressedPly | Self::Sog)
    }

    fn write(self, file: &File, gaussians: &Gaussians) -> io::Result<()> {
        let mut writer = BufWriter::new(file);
        match self {
            Self::Ply => write_ply_to(&mut writer, gaussians)?,
            Self::CompressedPly => write_compressed_ply_to(&mut writer, gaussians)?,
            // Axes that programs assume which ignore the declared ones.
            Self::Spz(version) => write_spz_to(&mut writer, gaussians, Axes::RDF, version)?,
            Self::Glb => write_glb_to(&mut writer, gaussians)?,
            Self::Sog => write_sog_to(&mut writer, gaussians)?,
        }
        writer.flush()
    }
}

/// The order of the Gaussians in the files of a sequence. The same Gaussians keep it, so that a reader can follow them.
#[derive(Default)]
struct FileOrder {
    /// Identities of the ordered Gaussians; none if the scene does not identify them.
    identities: Option<Vec<usize>>,
    order: Vec<usize>,
}

/// Writes a scene for other programs, in floats. A run is written without the Gaussians that its masks leave out over
/// time, since such files have no masks.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::{ParamsExtras, write_params_npz};
/// use tcgs_pipeline::{Export, OpenScene, OpenSettings, TimestepKind, Unobserved};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// let mut floats = DynamicGaussians::default();
/// floats.push(Gaussians::zeros(5));
/// write_params_npz(&path, &floats, &ParamsExtras::default())?;
///
/// let scene = OpenScene::open(&path, OpenSettings::default())?;
/// let export = Export::new(&scene)?;
/// let bytes = export.write_folder(TimestepKind::Ply, scene.frames(), folder.path(), &mut Unobserved)?;
/// assert_eq!(bytes, std::fs::metadata(folder.path().join("000000.ply"))?.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Export<'a> {
    scene: &'a OpenScene,
    /// Gaussians of a run that its masks keep; none for all.
    keep: Option<Vec<usize>>,
}

impl<'a> Export<'a> {
    /// Decides which Gaussians stay.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the masks of a run leave none; [`PipelineError`] if a file of the scene is damaged.
    pub fn new(scene: &'a OpenScene) -> Result<Self, PipelineError> {
        let keep = scene.run().map(|_| kept_gaussians(scene, None)).transpose()?;
        Ok(Self { scene, keep })
    }

    /// Number of Gaussians that stay, counted as by [`OpenScene::num_identities`].
    pub fn num_identities(&self) -> Option<usize> {
        self.keep.as_ref().map_or(self.scene.num_identities(), |keep| Some(keep.len()))
    }

    /// The Gaussians that stay, at one frame.
    ///
    /// # Errors
    /// [`PipelineError`] if the scene lacks the frame, or it cannot be read.
    pub fn gaussians(&self, frame: usize) -> Result<Gaussians, PipelineError> {
        self.scene.choose_frames(Some(&(frame..frame + 1)))?;
        let timestep = frame - self.scene.first_frame;
        let gaussians = self.scene.lit(timestep)?;
        let rows = self.rows(timestep);
        Ok(rows.map_or_else(|| gaussians.clone(), |rows| gaussians.select(&rows)))
    }

    /// Rows of the Gaussians that stay, among those that live at a timestep; none for all.
    fn rows(&self, timestep: usize) -> Option<Vec<usize>> {
        let keep = self.keep.as_ref()?;
        let Some(lives) = self.scene.lives() else { return Some(keep.clone()) };
        let living = lives.living(timestep);
        Some((0..living.len()).filter(|&row| keep.binary_search(&living[row]).is_ok()).collect())
    }

    /// Indices, among all Gaussians, of those that stay at a frame. None if the scene does not identify them across
    /// timesteps.
    fn identities(&self, frame: usize) -> Result<Option<Vec<usize>>, PipelineError> {
        let living = self.scene.living(frame - self.scene.first_frame)?;
        Ok(match (living, &self.keep) {
            (Some(living), Some(keep)) => {
                Some(living.into_iter().filter(|gaussian| keep.binary_search(gaussian).is_ok()).collect())
            }
            (living, keep) => living.or_else(|| keep.clone()),
        })
    }

    /// [`Self::gaussians`], at least one. The newborn of a run have their settled constants, as in its compressed file.
    fn settled(&self, frame: usize, stand_ins: &StandIns) -> Result<Gaussians, PipelineError> {
        let gaussians = self.some_gaussians(frame)?;
        let identities = self.identities(frame)?.filter(|_| stand_ins.lives().is_some());
        let Some(identities) = identities else { return Ok(gaussians) };
        let timestep = frame - self.scene.first_frame;
        Ok(stand_ins.complete(self.scene.lit(timestep)?, timestep).select(&identities))
    }

    /// Refuses a scene without Gaussians, which other programs do not read.
    fn check_some(&self) -> Result<(), PipelineError> {
        if self.num_identities() == Some(0) {
            return Err(PipelineError::input(self.scene.path.display(), "has no Gaussians", "at least one"));
        }
        Ok(())
    }

    /// [`Self::gaussians`], of which there must be some.
    fn some_gaussians(&self, frame: usize) -> Result<Gaussians, PipelineError> {
        let gaussians = self.gaussians(frame)?;
        if gaussians.num_gaussians() == 0 {
            let found = format!("has no Gaussians at frame {frame}");
            return Err(PipelineError::input(self.scene.path.display(), found, "at least one"));
        }
        Ok(gaussians)
    }

    /// [`Self::some_gaussians`], in the order of a kind of file.
    ///
    /// - `last`: the order of the frame before, which stays as long as the Gaussians are the same
    fn ordered_gaussians(
        &self,
        kind: TimestepKind,
        frame: usize,
        last: &mut FileOrder,
    ) -> Result<Gaussians, PipelineError> {
        let gaussians = self.some_gaussians(frame)?;
        if !kind.is_ordered_by_space() {
            return Ok(gaussians);
        }
        let identities = self.identities(frame)?;
        let are_same = last.order.len() == gaussians.num_gaussians() && last.identities == identities;
        if !are_same {
            *last = FileOrder { identities, order: space_order(gaussians.means()) };
        }
        Ok(gaussians.select(&last.order))
    }

    /// The refusal of a column that a kind of file cannot hold.
    fn refuse_column(&self, column: &Column, kind: &str, expected: &str) -> PipelineError {
        let found = format!("has the column {}, which {kind} cannot hold", column.name);
        PipelineError::input(self.scene.path.display(), found, expected)
    }

    /// Refuses scenes that files of other programs cannot hold: no Gaussians, or columns of other kinds.
    fn check_columns(&self, kind: &str) -> Result<(), PipelineError> {
        self.check_some()?;
        let layout = self.scene.layout();
        let harmonics = layout.harmonics();
        let further = &layout.columns()[Attribute::BASE.len()..];
        match further.iter().find(|column| !harmonics.contains(&column.attribute)) {
            Some(column) => {
                let expected = "means, quats, log_scales, logit_opacities, colors and spherical harmonics";
                Err(self.refuse_column(column, kind, expected))
            }
            None => Ok(()),
        }
    }

    /// The arrays of a `params.npz` of some frames.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if there are no Gaussians, or if a `params.npz` cannot hold them. It cannot if a
    /// Gaussian is born or dies, if there are spherical harmonics, if scales or opacities vary with time, or if the
    /// first frame's number is too large. [`PipelineError`] if a frame is missing or cannot be read.
    pub fn params(&self, frames: Range<usize>) -> Result<ExportedParams<'_>, PipelineError> {
        let scene = self.scene;
        self.check_some()?;
        if let Some(column) = scene.layout().further() {
            let expected =
                "means, quats, log_scales, logit_opacities and colors, or a folder of PLY files to export to";
            return Err(self.refuse_column(column, "a params.npz", expected));
        }
        let frames = scene.choose_frames(Some(&frames))?;
        let stand_ins = scene.stand_ins()?;
        let (first, identities) = (self.settled(frames.start, &stand_ins)?, self.identities(frames.start)?);
        for frame in frames.start + 1..frames.end {
            let gaussians = self.settled(frame, &stand_ins)?;
            let [found, expected] = [&gaussians, &first].map(Gaussians::num_gaussians);
            let now = if found != expected {
                Some(found.to_string())
            } else if self.identities(frame)? == identities {
                None
            } else {
                Some("as many others".to_owned())
            };
            if let Some(now) = now {
                let start = frames.start;
                let found = format!(
                    "has {expected} Gaussians at frame {start} and {now} at frame {frame}, which a params.npz cannot \
                     hold"
                );
                let expected = format!(
                    "a folder of PLY or .glb files or a .4dgs file to export to, or the frames {start}..{frame} alone"
                );
                return Err(PipelineError::input(scene.path.display(), found, expected));
            }
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
        // A float of 32 bits would change larger numbers, such as frames counted by dates or clocks.
        if frames.start >= MAX_FRAME_OF_PARAMS {
            let found = format!("begins at frame {}, which a params.npz cannot hold", frames.start);
            let expected = format!("a frame below {MAX_FRAME_OF_PARAMS}, or a folder of PLY files to export to");
            return Err(PipelineError::input(scene.path.display(), found, expected));
        }
        let timestep = frames.start - scene.first_frame;
        let foreground = scene.foreground(timestep)?.map(|foreground| match self.rows(timestep) {
            Some(rows) => rows.iter().map(|&row| foreground[row]).collect(),
            None => foreground,
        });
        Ok(ExportedParams { export: self, frames, num_gaussians: first.num_gaussians(), foreground, stand_ins })
    }

    /// Writes one frame as a file of its own. The Gaussians of a compressed PLY or SOG file are in another order than
    /// those of the scene ([`space_order`]).
    ///
    /// # Errors
    /// [`PipelineError::Input`] if there are no Gaussians, or the scene has a column that such files do not hold;
    /// [`PipelineError`] if the frame is missing or cannot be read.
    pub fn timestep(
        &self,
        kind: TimestepKind,
        frame: usize,
    ) -> Result<impl Fn(&File) -> io::Result<()> + use<>, PipelineError> {
        self.check_columns(kind.name())?;
        let gaussians = self.ordered_gaussians(kind, frame, &mut FileOrder::default())?;
        Ok(move |file: &File| kind.write(file, &gaussians))
    }

    /// Writes one frame as an unpacked SOG: `meta.json` and images. It has the content of the file that
    /// [`Self::timestep`] writes as [`TimestepKind::Sog`].
    ///
    /// - `folder`: exists; its contents stay
    /// - returns: bytes written
    ///
    /// # Errors
    /// As [`Self::timestep`]; [`PipelineError::Unwritable`] if a file cannot be written.
    pub fn write_unpacked_sog(&self, frame: usize, folder: &Path) -> Result<u64, PipelineError> {
        let kind = TimestepKind::Sog;
        self.check_columns(kind.name())?;
        let gaussians = self.ordered_gaussians(kind, frame, &mut FileOrder::default())?;
        let unwritable = |path: &Path, error| PipelineError::Unwritable { path: path.into(), error };
        let mut length = 0;
        for (name, bytes) in sog_files(&gaussians).map_err(|error| unwritable(folder, error))? {
            let path = folder.join(name);
            fs::write(&path, &bytes).map_err(|error| unwritable(&path, error))?;
            length += bytes.len() as u64;
        }
        Ok(length)
    }

    /// The bytes of a `.4dgs` file of some frames ([`fourdgs_bytes`]). Reads one timestep at a time, but builds the
    /// file in memory.
    ///
    /// # Errors
    /// As [`Self::timestep`]; [`PipelineError::Input`] if the format cannot hold the scene.
    pub fn fourdgs(&self, frames: Range<usize>) -> Result<Vec<u8>, PipelineError> {
        self.check_columns("a .4dgs file")?;
        let frames = self.scene.choose_frames(Some(&frames))?;
        fourdgs_bytes(frames.map(|frame| self.gaussians(frame)), self.frame_rate())?
            .map_err(|problem| PipelineError::input(self.scene.path.display(), problem, "what a .4dgs file can hold"))
    }

    /// Some frames as an animated USD file in text ([`write_usda_to`]). Row `i` is the same Gaussian at all timesteps,
    /// if the scene identifies its Gaussians. Outside its life a Gaussian has opacity 0.
    ///
    /// # Errors
    /// As [`Self::timestep`].
    pub fn usda(&self, frames: Range<usize>) -> Result<impl FnOnce(&File) -> io::Result<()>, PipelineError> {
        self.check_columns("a USD file")?;
        let frames = self.scene.choose_frames(Some(&frames))?;
        let (first, frame_rate) = (frames.start, self.frame_rate());
        let mut scene = Identified::new(self, frames)?;
        Ok(move |file: &File| {
            let mut writer = BufWriter::new(file);
            write_usda_to(&mut writer, &mut scene, first, frame_rate)?;
            writer.flush()
        })
    }

    /// Timesteps a second; 30 if the scene does not say.
    fn frame_rate(&self) -> f64 {
        if self.scene.frame_rate > 0.0 { self.scene.frame_rate } else { 30.0 }
    }

    /// Plain floats, bit for bit as they are stored (`docs/FORMAT.md`, "Conformance"). Each frame has all means, quats,
    /// log_scales, logit_opacities and colors, then the further columns in the order of the layout. Each is
    /// `[N, components]`, as little-endian binary32.
    ///
    /// - returns: `[N * 14 * 4]` bytes per frame of a scene without further columns, or the reason that the frame
    ///   cannot be read
    ///
    /// # Errors
    /// [`PipelineError::Frames`] if the scene lacks a frame.
    pub fn floats(
        &self,
        frames: Range<usize>,
    ) -> Result<impl Iterator<Item = Result<Vec<u8>, PipelineError>>, PipelineError> {
        let bytes = |gaussians: Gaussians| {
            let values = gaussians.layout().attributes().flat_map(|a| gaussians.values(a).iter());
            values.flat_map(|x| x.to_le_bytes()).collect()
        };
        Ok(self.scene.choose_frames(Some(&frames))?.map(move |frame| self.gaussians(frame).map(bytes)))
    }

    /// Writes one file per frame, named by its number: `000012.ply`. The Gaussians of compressed PLY and SOG files are
    /// in another order than those of the scene, which is that of the frame before as long as the Gaussians are the
    /// same.
    ///
    /// - `folder`: exists; its contents stay
    /// - returns: bytes written
    ///
    /// # Errors
    /// As [`Self::timestep`]; [`PipelineError::Unwritable`] if a file cannot be written; [`PipelineError::Stopped`] if
    /// the observer broke off.
    pub fn write_folder(
        &self,
        kind: TimestepKind,
        frames: Range<usize>,
        folder: &Path,
        observer: &mut dyn Observer,
    ) -> Result<u64, PipelineError> {
        self.check_columns(kind.name())?;
        let frames = self.scene.choose_frames(Some(&frames))?;
        tell(observer, Event::Begun { work: Work::Exporting, num_steps: frames.len() })?;
        let (mut bytes, mut order) = (0, FileOrder::default());
        for frame in frames {
            let path = folder.join(format!("{frame:06}{}", kind.ending()));
            let gaussians = self.ordered_gaussians(kind, frame, &mut order)?;
            let written = File::create(&path).and_then(|file| {
                kind.write(&file, &gaussians)?;
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
    num_gaussians: usize,
    /// `[N]`; none if the scene does not say.
    foreground: Option<Vec<bool>>,
    stand_ins: StandIns,
}

/// The requested frames of an export.
struct Frames<'a>(&'a ExportedParams<'a>);

impl SceneReader for Frames<'_> {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        SceneReader::layout(self.0.export.scene)
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.0.num_gaussians
    }

    fn num_timesteps(&self) -> usize {
        self.0.frames.len()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        self.0.export.settled(self.0.frames.start + timestep, &self.0.stand_ins)
    }
}

impl ExportedParams<'_> {
    /// Whether any Gaussian is marked as background. If none is, programs that hide the background hide nothing.
    pub fn has_background(&self) -> bool {
        self.foreground.as_ref().is_some_and(|foreground| foreground.contains(&false))
    }

    /// Writes the archive. Reads every timestep three times, and holds one at a time.
    ///
    /// # Errors
    /// The writer's errors, and those of reading the scene.
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

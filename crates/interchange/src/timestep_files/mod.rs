//! A folder with one file a timestep, of any kind that is read.
//!
//! Files may differ in their kind and in their number of Gaussians. All have the same degree of spherical harmonics.
//! All are drawn with antialiasing, or none is; SPZ, PLY and SOG files can say so. A scene whose Gaussians are followed
//! through time ([`TimestepFiles::read`]) needs more, which the files do not state: the same Gaussians in the same
//! order. The reader checks what it can: every file has the same number of Gaussians, and Gaussian `i` of one file is
//! near Gaussian `i` of the next ([`MAX_JUMP`]).

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_core::{DynamicGaussians, Gaussians, Layout, SceneReader, distance, natural_key, sub, upper_median};

use crate::gaussian_file::{FileKind, read_and_count, read_head};
use crate::notes::ReplacedByTimestep;
use crate::{Axes, InterchangeError, ReadNote, ReadSettings, sog, spz};

/// Endings of the files that are timesteps. The content of such a file decides its format.
const ENDINGS: [&str; 7] = ["ply", "spz", "glb", "gltf", "sog", "splat", "ksplat"];

/// Largest motion of the median Gaussian from one file to the next, as a share of the median Gaussian's distance from
/// the scene's middle. Common motion of all Gaussians does not count.
///
/// Gaussians in random order reach 1.4. A rigid body reaches this limit if it turns by 30 degrees within one frame, and
/// no codec profits from tracks with such jumps.
const MAX_JUMP: f32 = 0.5;

/// A sequence of files that is read a timestep at a time: PLY, also compressed, SPZ, glTF, SOG, `.splat`
/// or `.ksplat`. The number of Gaussians may differ between files.
///
/// ```
/// use tcgs_core::{Gaussians, SceneReader};
/// use tcgs_interchange::{ReadSettings, TimestepFiles, write_ply_to};
/// let folder = tempfile::tempdir()?;
/// for (frame, num_gaussians) in [(7, 5), (8, 6)] {
///     let file = std::fs::File::create(folder.path().join(format!("{frame:06}.ply")))?;
///     write_ply_to(std::io::BufWriter::new(file), &Gaussians::zeros(num_gaussians))?;
/// }
/// let files = TimestepFiles::open(folder.path(), ReadSettings::default())?;
/// assert_eq!((files.num_timesteps(), files.first_frame()), (2, Some(7)));
/// assert_eq!((files.num_identities(), files.num_gaussians_at(0)), (None, 5));
/// assert_eq!(files.at(1)?, Gaussians::zeros(6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct TimestepFiles {
    /// In the order of the timesteps, at least one.
    files: Vec<PathBuf>,
    /// Gaussians in each file, at least 1.
    numbers: Vec<usize>,
    /// Kind of all files; none if they differ.
    kind: Option<FileKind>,
    first_frame: Option<u32>,
    settings: ReadSettings,
    layout: Arc<Layout>,
    /// Axes of the first file.
    axes: Axes,
    /// Whether the axes of any file were assumed.
    has_assumed_axes: bool,
    replaced: ReplacedByTimestep,
}

impl TimestepFiles {
    /// Lists the files of a folder in natural order (numbers within names are compared as numbers) whose names end in
    /// `.ply`, `.spz`, `.glb`, `.gltf`, `.sog`, `.splat` or `.ksplat`, and reads their headers. Hidden files are left
    /// out. A folder without such files may be an unpacked SOG.
    ///
    /// - `path`: the folder, or a single file of any name, which becomes a sequence of one timestep
    ///
    /// # Errors
    /// [`InterchangeError::Read`] if the folder or a file cannot be read. [`InterchangeError::File`] if the folder has
    /// no such file. It names the first file whose header is none of Gaussians, or has another degree of harmonics or
    /// another antialiasing than the first file.
    pub fn open(path: &Path, settings: ReadSettings) -> Result<Self, InterchangeError> {
        let files = if path.is_dir() { Self::list(path)? } else { vec![path.into()] };
        let mut numbers = Vec::new();
        let mut kinds = Vec::new();
        let mut first = None;
        let (mut axes, mut has_assumed_axes) = (None, false);
        for file in &files {
            let (kind, head) = read_head(file, settings)?;
            kinds.push(kind);
            let of_file = match (settings.axes, kind) {
                (Some(axes), _) => axes,
                (None, FileKind::Ply | FileKind::Sog | FileKind::Splat | FileKind::Ksplat) => Axes::RDF,
                (None, FileKind::Gltf) => Axes::LUF,
                (None, FileKind::Spz) if has_assumed_axes => spz::ASSUMED_AXES,
                (None, FileKind::Spz) => {
                    let declared = spz::read_axes(file, settings)?;
                    has_assumed_axes = declared.is_none();
                    declared.unwrap_or(spz::ASSUMED_AXES)
                }
            };
            axes.get_or_insert(of_file);
            let expected = first.get_or_insert_with(|| Arc::clone(&head.layout));
            if head.layout.with_background(expected.background()) != *expected {
                let (found, expected, first) = (look(&head.layout), look(expected), files[0].display());
                let problem = format!("has {found}, expected {expected} as in {first}");
                return Err(InterchangeError::File { path: file.clone(), problem });
            }
            numbers.push(head.num_gaussians);
        }
        let first_frame = first_frame(&files);
        let layout = first.unwrap_or_default();
        let kind = kinds.first().copied().filter(|first| kinds.iter().all(|kind| kind == first));
        let replaced = ReplacedByTimestep::default();
        let axes = axes.unwrap_or(Axes::RDF);
        Ok(Self { files, numbers, kind, first_frame, settings, layout, axes, has_assumed_axes, replaced })
    }

    /// Axes that the Gaussians of the first file have in it. Readers turn them into those of PLY files.
    pub fn axes(&self) -> Axes {
        self.axes
    }

    /// Assumptions at the opening of the files, and replacements in the files that were read so far.
    pub fn notes(&self) -> Vec<ReadNote> {
        let axes = self.has_assumed_axes.then_some(ReadNote::AssumedAxes(spz::ASSUMED_AXES));
        axes.into_iter().chain(self.replaced.note()).collect()
    }

    /// Whether a path is a folder with a file for [`Self::open`].
    pub fn is_folder(path: &Path) -> bool {
        Self::list(path).is_ok()
    }

    /// The files of a folder that [`Self::open`] reads, in their natural order. Reads none of them.
    ///
    /// # Errors
    /// [`InterchangeError::Read`] if the folder cannot be read; [`InterchangeError::File`] if it has no such file.
    pub fn list(folder: &Path) -> Result<Vec<PathBuf>, InterchangeError> {
        let failed = |error| InterchangeError::Read { path: folder.into(), error };
        let mut files = Vec::new();
        for entry in fs::read_dir(folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if is_timestep(&path) {
                files.push(path);
            }
        }
        if files.is_empty() {
            files.extend(sog::table_in(folder));
        }
        if files.is_empty() {
            let problem = "holds no PLY, SPZ, glTF, SOG, .splat or .ksplat file, expected one a timestep".into();
            return Err(InterchangeError::File { path: folder.into(), problem });
        }
        files.sort_by_cached_key(|path| natural_key(&name(path)));
        Ok(files)
    }

    /// The files, in the order of the timesteps.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// [`Self::files`], and behind the table of an unpacked SOG its images.
    pub fn files_and_images(&self) -> Vec<PathBuf> {
        let images = |file: &PathBuf| if sog::is_table(file) { sog::images_of(file) } else { Vec::new() };
        self.files.iter().flat_map(|file| std::iter::once(file.clone()).chain(images(file))).collect()
    }

    /// The kind of the files in two words: `PLY files`, `SPZ files`, `glTF files`, `SOG files`, `.splat files`,
    /// `.ksplat files`, or `Gaussian files` of several kinds.
    pub fn kind(&self) -> &'static str {
        match self.kind {
            Some(FileKind::Ply) => "PLY files",
            Some(FileKind::Spz) => "SPZ files",
            Some(FileKind::Gltf) => "glTF files",
            Some(FileKind::Sog) => "SOG files",
            Some(FileKind::Splat) => ".splat files",
            Some(FileKind::Ksplat) => ".ksplat files",
            None => "Gaussian files",
        }
    }

    /// The number in the first file's name, if all names are numbers that count up by one, such as `000012.ply`; the
    /// index of the capture's frame that timestep 0 shows.
    pub fn first_frame(&self) -> Option<u32> {
        self.first_frame
    }

    /// Size as plain 32-bit floats ([`Layout::raw_bytes_of_changing`]).
    pub fn raw_bytes(&self) -> u64 {
        self.layout.raw_bytes_of_changing(&self.numbers)
    }

    /// The Gaussians of one file, in its order.
    ///
    /// # Errors
    /// As [`crate::read_gaussians`]; [`InterchangeError::File`] if the file has another number of Gaussians, or
    /// harmonics of another degree, than when the sequence was opened.
    ///
    /// # Panics
    /// If there is no such timestep.
    pub fn at(&self, timestep: usize) -> Result<Gaussians, InterchangeError> {
        let file = &self.files[timestep];
        let (gaussians, replaced) = read_and_count(file, self.settings)?;
        let gaussians = gaussians.with_background(self.layout.background());
        let (found, expected) = (gaussians.num_gaussians(), self.numbers[timestep]);
        if found != expected || gaussians.layout() != &self.layout {
            let (look_found, look_expected) = (look(gaussians.layout()), look(&self.layout));
            let problem = format!(
                "has {found} Gaussians with {look_found}, expected {expected} with {look_expected} as when it was opened"
            );
            return Err(InterchangeError::File { path: file.clone(), problem });
        }
        self.replaced.record(timestep, replaced);
        Ok(gaussians)
    }

    /// Reads a range of timesteps as one scene of the same Gaussians. Scales, opacities and harmonics vary with time in
    /// the scene if any bit of them differs between the files.
    ///
    /// As [`Self::at`]. [`InterchangeError::File`] names the first file whose number of Gaussians differs from the
    /// first file's, before any is read. It also names a file whose Gaussians are not near those of the file before.
    ///
    /// # Panics
    /// If `timesteps` exceeds the number of files.
    pub fn read(&self, timesteps: Range<usize>) -> Result<DynamicGaussians, InterchangeError> {
        let invalid = |t: usize, problem| Err(InterchangeError::File { path: self.files[t].clone(), problem });
        let expected = self.numbers.get(timesteps.start).copied().unwrap_or(0);
        if let Some(t) = timesteps.clone().find(|&t| self.numbers[t] != expected) {
            let (found, first) = (self.numbers[t], self.files[timesteps.start].display());
            return invalid(t, format!("has {found} Gaussians, expected {expected} as in {first}"));
        }
        let mut scene = DynamicGaussians::new(Arc::clone(&self.layout));
        for t in timesteps {
            let gaussians = self.at(t)?;
            if let Some(last) = scene.num_timesteps().checked_sub(1) {
                let jump = jump(scene.means(last), gaussians.means());
                if jump > MAX_JUMP {
                    return invalid(
                        t,
                        format!(
                            "the median Gaussian moves by {jump:.2} of the scene's size since the file before, expected \
                             at most {MAX_JUMP}: Gaussians in the same order in every file"
                        ),
                    );
                }
            }
            scene.push(gaussians);
        }
        Ok(scene)
    }
}

impl SceneReader for TimestepFiles {
    type Error = InterchangeError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians_at(&self, timestep: usize) -> usize {
        self.numbers[timestep]
    }

    fn num_timesteps(&self) -> usize {
        self.files.len()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, InterchangeError> {
        Self::at(self, timestep)
    }
}

/// How Gaussians of a layout are drawn, in words.
fn look(layout: &Layout) -> String {
    let antialiased = if layout.is_antialiased() { ", antialiased" } else { "" };
    format!("spherical harmonics of degree {}{antialiased}", layout.sh_degree())
}

/// Whether a name is that of a file to read. Hidden ones are other programs' notes.
fn is_timestep(path: &Path) -> bool {
    let is_known = |ending: &std::ffi::OsStr| ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known));
    path.extension().is_some_and(is_known) && !name(path).starts_with('.')
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The number of the first file, if each is named by the number after the one before.
fn first_frame(files: &[PathBuf]) -> Option<u32> {
    let number = |path: &PathBuf| -> Option<u32> {
        let stem = path.file_stem()?.to_str()?;
        let stem = stem.strip_suffix(".compressed").unwrap_or(stem);
        stem.parse().ok().filter(|_| stem.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let first = number(files.first()?)?;
    let counts_up = files.iter().zip(0..).all(|(file, i)| number(file) == first.checked_add(i));
    counts_up.then_some(first)
}

/// How far the median Gaussian moves, less what all have in common, in the median distance from the middle.
///
/// - `before`, `after`: `[N, 3]`, `N >= 1`
fn jump(before: &[[f32; 3]], after: &[[f32; 3]]) -> f32 {
    let axis = |points: &[[f32; 3]], axis: usize| upper_median(points.iter().map(|p| p[axis])).unwrap_or_default();
    let steps: Vec<[f32; 3]> = before.iter().zip(after).map(|(&a, &b)| sub(b, a)).collect();
    let (middle, common) = ([0, 1, 2].map(|c| axis(before, c)), [0, 1, 2].map(|c| axis(&steps, c)));
    let size = upper_median(before.iter().map(|&p| distance(p, middle))).unwrap_or_default();
    let step = upper_median(steps.iter().map(|&step| distance(step, common))).unwrap_or_default();
    // A scene without extent has no order to lose.
    if size > 0.0 { step / size } else { 0.0 }
}

#[cfg(test)]
mod tests;

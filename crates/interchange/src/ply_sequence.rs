//! A folder of PLY files, one file per timestep, whose Gaussians keep their number and their order.
//!
//! The files do not state that they belong together. The reader checks what it can: every file has the same number of
//! Gaussians, and Gaussian `i` of one file is near Gaussian `i` of the next ([`MAX_JUMP`]).

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use tcgs_core::{DynamicGaussians, natural_key};

use crate::{HigherHarmonics, InterchangeError, read_ply};

/// How far the median Gaussian may move from one file to the next, as a share of the median Gaussian's
/// distance from the scene's middle; motion that all have in common is not counted.
///
/// Gaussians in random order come to 1.4. A rigid body comes to this if it turns by 30 degrees within one
/// frame, and no codec gains anything from tracks that jump like that.
const MAX_JUMP: f32 = 0.5;

/// The scene that a sequence of PLY files holds.
#[derive(Clone, Debug, PartialEq)]
pub struct PlySequence {
    /// The scene, with one timestep per file.
    pub scene: DynamicGaussians,
    /// The number in the first file's name, if all names are numbers that count up by one, such as `000012.ply`; the
    /// index of the capture's frame that timestep 0 shows.
    pub first_frame: Option<u32>,
}

/// The paths of a sequence of PLY files. No file is opened until [`Self::read`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyFiles {
    /// The files in the order of the timesteps, at least one.
    pub files: Vec<PathBuf>,
    /// As [`PlySequence::first_frame`].
    pub first_frame: Option<u32>,
}

impl PlyFiles {
    /// Lists the PLY files of a folder in natural order (numbers within names are compared as numbers). Hidden files
    /// are left out.
    ///
    /// - `path`: the folder, or a single PLY file, which becomes a sequence of one timestep
    ///
    /// # Errors
    /// [`InterchangeError::Read`] if the folder cannot be read; [`InterchangeError::Ply`] if the folder has no PLY file.
    pub fn list(path: &Path) -> Result<Self, InterchangeError> {
        let files = if path.is_dir() { ply_files(path)? } else { vec![path.into()] };
        let first_frame = first_frame(&files);
        Ok(Self { files, first_frame })
    }

    /// Reads a range of timesteps as one scene. Scales and opacities vary with time in the scene if any bit of them
    /// differs between the files.
    ///
    /// - `timesteps`: positions in [`files`](Self::files)
    ///
    /// # Errors
    /// As [`read_ply`]; [`InterchangeError::Ply`] names the first file whose number of Gaussians differs from that of
    /// the first, or whose Gaussians are not near those of the file before.
    ///
    /// # Panics
    /// If `timesteps` exceeds the number of files.
    pub fn read(
        &self,
        timesteps: Range<usize>,
        harmonics: HigherHarmonics,
    ) -> Result<DynamicGaussians, InterchangeError> {
        let files = &self.files[timesteps];
        let mut scene = DynamicGaussians::default();
        for file in files {
            let gaussians = read_ply(file, harmonics)?;
            let invalid = |problem| Err(InterchangeError::Ply { path: file.clone(), problem });
            if let Some(last) = scene.num_timesteps().checked_sub(1) {
                let before = scene.means(last);
                if before.len() != gaussians.num_gaussians() {
                    let (found, first) = (gaussians.num_gaussians(), files[0].display());
                    return invalid(format!("has {found} Gaussians, expected {} as in {first}", before.len()));
                }
                let jump = jump(before, gaussians.means());
                if jump > MAX_JUMP {
                    return invalid(format!(
                        "the median Gaussian moves by {jump:.2} of the scene's size since the file before, expected at \
                         most {MAX_JUMP}: Gaussians in the same order in every file"
                    ));
                }
            }
            scene.push(gaussians);
        }
        Ok(scene)
    }
}

/// Reads all PLY files of a folder as one scene: [`PlyFiles::list`], then [`PlyFiles::read`].
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{HigherHarmonics, read_ply_sequence, write_ply_to};
/// let folder = tempfile::tempdir()?;
/// for frame in 7..9 {
///     let file = std::fs::File::create(folder.path().join(format!("{frame:06}.ply")))?;
///     write_ply_to(std::io::BufWriter::new(file), &Gaussians::zeros(5))?;
/// }
/// let sequence = read_ply_sequence(folder.path(), HigherHarmonics::Refuse)?;
/// assert_eq!((sequence.scene.num_timesteps(), sequence.first_frame), (2, Some(7)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`PlyFiles::list`] and [`PlyFiles::read`].
pub fn read_ply_sequence(path: &Path, harmonics: HigherHarmonics) -> Result<PlySequence, InterchangeError> {
    let files = PlyFiles::list(path)?;
    let scene = files.read(0..files.files.len(), harmonics)?;
    Ok(PlySequence { scene, first_frame: files.first_frame })
}

/// Whether a name is that of a file to read. Hidden ones are other programs' notes.
fn is_ply(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ply")) && !name(path).starts_with('.')
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The files of a folder in their natural order.
fn ply_files(folder: &Path) -> Result<Vec<PathBuf>, InterchangeError> {
    let failed = |error| InterchangeError::Read { path: folder.into(), error };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if is_ply(&path) {
            files.push(path);
        }
    }
    if files.is_empty() {
        let problem = "holds no PLY file, expected one a timestep".into();
        return Err(InterchangeError::Ply { path: folder.into(), problem });
    }
    files.sort_by_cached_key(|path| natural_key(&name(path)));
    Ok(files)
}

/// The number of the first file, if each is named by the number after the one before.
fn first_frame(files: &[PathBuf]) -> Option<u32> {
    let number = |path: &PathBuf| -> Option<u32> {
        let stem = path.file_stem()?.to_str()?;
        stem.parse().ok().filter(|_| stem.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let first = number(files.first()?)?;
    let counts_up = files.iter().zip(first..).all(|(file, expected)| number(file) == Some(expected));
    counts_up.then_some(first)
}

/// How far the median Gaussian moves, less what all have in common, in the median distance from the middle.
///
/// - `before`, `after`: `[N, 3]`, `N >= 1`
fn jump(before: &[[f32; 3]], after: &[[f32; 3]]) -> f32 {
    let axis = |points: &[[f32; 3]], axis: usize| median(points.iter().map(|p| p[axis]).collect());
    let distance = |p: &[f32; 3], from: [f32; 3]| (0..3).map(|c| (p[c] - from[c]).powi(2)).sum::<f32>().sqrt();
    let steps: Vec<[f32; 3]> = before.iter().zip(after).map(|(a, b)| std::array::from_fn(|c| b[c] - a[c])).collect();
    let (middle, common) = ([0, 1, 2].map(|c| axis(before, c)), [0, 1, 2].map(|c| axis(&steps, c)));
    let size = median(before.iter().map(|p| distance(p, middle)).collect());
    let step = median(steps.iter().map(|step| distance(step, common)).collect());
    // A scene without extent has no order to lose.
    if size > 0.0 { step / size } else { 0.0 }
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Attribute, Gaussians};
    use tempfile::TempDir;

    use super::*;
    use crate::write_ply_to;

    /// A hundred Gaussians on a crumpled sheet, and where they are at a timestep.
    fn at(timestep: usize) -> Gaussians {
        let mut gaussians = Gaussians::zeros(100);
        for i in 0..100 {
            let (x, y) = ((i % 10) as f32, (i / 10) as f32);
            gaussians.means_mut()[i] = [x + 20.0 * timestep as f32, y, (0.7 * x + y).sin() + 0.1 * timestep as f32];
            gaussians.quats_mut()[i] = [1.0, 0.1 * x, 0.0, 0.0];
            gaussians.colors_mut()[i] = [0.1 * x, 0.1 * y, 0.5];
            gaussians.log_scales_mut()[i] = [-2.0, -3.0, -0.5 * x];
            gaussians.logit_opacities_mut()[i] = y - timestep as f32;
        }
        gaussians
    }

    fn write(folder: &TempDir, name: &str, gaussians: &Gaussians) -> PathBuf {
        let path = folder.path().join(name);
        write_ply_to(fs::File::create(&path).unwrap(), gaussians).unwrap();
        path
    }

    /// What reading gives, and the file and the problem of an error.
    fn read(folder: &TempDir) -> Result<PlySequence, (String, String)> {
        read_ply_sequence(folder.path(), HigherHarmonics::Refuse).map_err(|error| {
            let message = error.to_string();
            let (file, problem) = message.split_once(": ").unwrap();
            (name(Path::new(file)), problem.to_owned())
        })
    }

    #[test]
    fn files_are_timesteps_in_natural_order() {
        let folder = tempfile::tempdir().unwrap();
        for (name, timestep) in [("frame_10.ply", 2), ("frame_9.PLY", 1), ("frame_1.ply", 0)] {
            write(&folder, name, &at(timestep));
        }
        fs::write(folder.path().join("._frame_2.ply"), "a note").unwrap();
        fs::write(folder.path().join("readme.txt"), "").unwrap();
        let PlySequence { scene, first_frame } = read(&folder).unwrap();
        assert_eq!((scene.num_timesteps(), first_frame), (3, None));
        assert!(scene.varies(Attribute::LogitOpacity) && !scene.varies(Attribute::LogScale));
        for timestep in 0..3 {
            let (found, expected) = (scene.at(timestep), at(timestep));
            assert_eq!((&found.means(), &found.quats()), (&expected.means(), &expected.quats()));
            assert_eq!(
                (&found.log_scales(), &found.logit_opacities()),
                (&expected.log_scales(), &expected.logit_opacities())
            );
        }
        let one = read_ply_sequence(&folder.path().join("frame_10.ply"), HigherHarmonics::Refuse).unwrap();
        assert_eq!(one.scene.at(0), scene.at(2));
    }

    #[test]
    fn numbers_that_count_up_are_frames() {
        let frames = |names: &[&str]| first_frame(&names.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(frames(&["a/000007.ply", "a/000008.ply", "a/9.ply"]), Some(7));
        assert_eq!(frames(&["0.ply"]), Some(0));
        for names in [&["1.ply", "3.ply"][..], &["f1.ply", "f2.ply"], &["+1.ply"], &["1.5.ply"], &["4294967295.ply"; 2]]
        {
            assert_eq!(frames(names), None, "{names:?}");
        }
    }

    #[test]
    fn the_first_file_that_does_not_fit_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read(&folder).unwrap_err().1, "holds no PLY file, expected one a timestep");
        for timestep in 0..4 {
            write(&folder, &format!("{timestep}.ply"), &at(timestep));
        }
        assert_eq!(read(&folder).unwrap().first_frame, Some(0));

        let fewer = write(&folder, "2.ply", &at(2).select(&(0..99).collect::<Vec<_>>()));
        write(&folder, "3.ply", &Gaussians::zeros(3));
        let (file, problem) = read(&folder).unwrap_err();
        let first = folder.path().join("0.ply");
        assert_eq!(problem, format!("has 99 Gaussians, expected 100 as in {}", first.display()));
        assert_eq!(file, name(&fewer));

        let mut shuffled: Vec<usize> = (0..100).map(|i| i * 37 % 100).collect();
        write(&folder, "2.ply", &at(2).select(&shuffled));
        let (file, problem) = read(&folder).unwrap_err();
        assert!(file == "2.ply" && problem.starts_with("the median Gaussian moves by 1."), "{problem}");
        // Up to now the rows were mixed; neighbours that changed places are near enough.
        shuffled = (0..100).map(|i| i ^ 1).collect();
        write(&folder, "2.ply", &at(2).select(&shuffled));
        assert_eq!(read(&folder).unwrap_err().0, "3.ply");

        let mut infinite = at(1);
        infinite.log_scales_mut()[4][1] = f32::NEG_INFINITY;
        write(&folder, "1.ply", &infinite);
        let (file, problem) = read(&folder).unwrap_err();
        assert_eq!((&*file, &*problem), ("1.ply", "log_scales of Gaussian 4: -inf, expected a finite number"));
    }

    #[test]
    fn what_all_have_in_common_is_no_jump() {
        let turned = |degrees: f32| -> Vec<[f32; 3]> {
            let (sin, cos) = degrees.to_radians().sin_cos();
            at(0).means().iter().map(|&[x, y, z]| [cos * x - sin * y + 500.0, sin * x + cos * y, z - 70.0]).collect()
        };
        assert_eq!(jump(&turned(0.0), &turned(0.0)), 0.0);
        assert!(jump(at(0).means(), &turned(0.0)) < 1e-3);
        let (little, much) = (jump(&turned(0.0), &turned(20.0)), jump(&turned(0.0), &turned(40.0)));
        assert!(little < MAX_JUMP && MAX_JUMP < much, "{little} {much}");
        assert_eq!(jump(&[[1.0; 3]], &[[9.0; 3]]), 0.0);
        assert_eq!(jump(&[[1.0; 3]; 3], &[[9.0; 3], [1.0; 3], [-4.0; 3]]), 0.0);
    }
}

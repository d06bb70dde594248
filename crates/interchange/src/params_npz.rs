//! `params.npz` of Dynamic 3D Gaussians (Luiten et al. 2024): one archive with one array per attribute.
//!
//! | key | shape | here |
//! |---|---|---|
//! | `means3D` | `(T, N, 3)` | `means` |
//! | `rgb_colors` | `(T, N, 3)` | `colors` |
//! | `unnorm_rotations` | `(T, N, 4)`, `w, x, y, z` | `quats` |
//! | `logit_opacities` | `(N, 1)` | `logit_opacities` |
//! | `log_scales` | `(N, 3)` | `log_scales` |
//! | `seg_colors` | `(N, 3)`: foreground, 0, background | [`ParamsExtras::foreground`], written only |
//! | `cam_m`, `cam_c` | `(50, 3)`: image = exp(cam_m) * render + cam_c | [`ParamsExtras`], written only |
//! | `tcgs_first_frame`, `tcgs_downscale`, `tcgs_frame_rate` | `(1,)` each, ours alone, optional | [`ParamsOrigin`] |
//!
//! The format has no field for the frame of the capture that its first timestep shows. Other programs number the
//! timesteps from 0 and ignore the arrays whose names begin with `tcgs_`: a scene of the frames 7 to 9 has the
//! timesteps 0 to 2 there. The writer does not pad the scene with empty timesteps, since other programs would draw them
//! and train on them. A reader that needs the frame's number reads `tcgs_first_frame`.

use std::{
    fs::File,
    io::{self, BufWriter, Seek, Write},
    path::Path,
    sync::Arc,
};

use tcgs_core::{Attribute, DynamicGaussians, Gaussians, Layout, SceneReader};

use crate::npz::NpzRows;
use crate::{Existing, InterchangeError, NpzReader, NpzWriter, npy::show_shape, write_whole};

/// Keys of [`ParamsOrigin`].
const FIRST_FRAME: &str = "tcgs_first_frame";
const DOWNSCALE: &str = "tcgs_downscale";
const FRAME_RATE: &str = "tcgs_frame_rate";

/// Rows of `cam_m` and `cam_c`: the source always has 50, whatever the number of cameras.
const MIN_CAMERA_ROWS: usize = 50;

/// The arrays of `params.npz` other than the Gaussians' attributes. By default: all foreground, no cameras, no origin.
#[derive(Clone, Copy, Debug, Default)]
pub struct ParamsExtras<'a> {
    /// `[N]`, whether each Gaussian belongs to the foreground; with `None` all do.
    pub foreground: Option<&'a [bool]>,
    /// `[C, 3]`, logarithm of each training camera's colour gain, written as `cam_m`.
    pub log_gains: &'a [[f32; 3]],
    /// `[C, 3]`, colour offset of each training camera, written as `cam_c`.
    pub offsets: &'a [[f32; 3]],
    /// The frames and the resolution that the scene was trained on, for readers that know [`read_params_origin`].
    pub origin: Option<ParamsOrigin>,
}

/// Which frames of a capture a scene shows, and at which resolution it was trained. The format of Dynamic 3D Gaussians
/// has no such fields; other programs ignore these arrays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParamsOrigin {
    /// Index of the capture's frame that timestep 0 shows, below 16,777,216, since the array is float32.
    pub first_frame: u32,
    /// Factor by which width and height of the capture's images were divided for training, 1 to 65536.
    pub downscale: u32,
    /// Frames per second; 0 if unknown.
    pub frame_rate: f32,
}

/// Reads the scene of a `params.npz` that Dynamic 3D Gaussians, or [`write_params_npz`], wrote.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::{ParamsExtras, read_params_npz, write_params_npz};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(5));
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// write_params_npz(&path, &scene, &ParamsExtras::default())?;
/// assert_eq!(read_params_npz(&path)?, scene);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Accepts float64, Fortran order, `logit_opacities` of shape `(N,)`, and a leading axis of length 1 on the arrays that
/// do not vary with time.
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read or is incomplete, an array is missing, shapes disagree, a number is
/// not finite, or the scene has no timestep or no Gaussian.
pub fn read_params_npz(path: &Path) -> Result<DynamicGaussians, InterchangeError> {
    ParamsNpz::open(path)?.read_all()
}

/// A scene in a `params.npz` that is read a timestep at a time.
///
/// [`Self::open`] reads through the file once, and checks what [`read_params_npz`] checks. Arrays that are stored as they
/// are, as the source and [`write_params_npz`] store them, stay on disk; compressed ones (`numpy.savez_compressed`) and
/// those in Fortran order are held in memory, since a timestep of them cannot be reached alone.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians, SceneReader};
/// use tcgs_interchange::{ParamsExtras, ParamsNpz, write_params_npz};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(5));
/// scene.push(Gaussians::zeros(5));
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// write_params_npz(&path, &scene, &ParamsExtras::default())?;
/// let mut params = ParamsNpz::open(&path)?;
/// assert_eq!((params.num_timesteps(), params.at(1)?), (2, scene.at(1)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ParamsNpz {
    npz: NpzReader,
    num_timesteps: usize,
    num_gaussians: usize,
    layout: Arc<Layout>,
    means: NpzRows,
    quats: NpzRows,
    /// `[N, 3]`
    log_scales: Vec<f32>,
    /// `[N]`
    logit_opacities: Vec<f32>,
    colors: NpzRows,
}

impl ParamsNpz {
    /// Opens a `params.npz`, and checks all of it.
    ///
    /// # Errors
    /// As [`read_params_npz`].
    pub fn open(path: &Path) -> Result<Self, InterchangeError> {
        open_params(path)
    }

    /// All timesteps.
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if the file has changed since it was opened, or cannot be read.
    pub fn read_all(mut self) -> Result<DynamicGaussians, InterchangeError> {
        let Self { npz, num_timesteps, means, quats, colors, .. } = &mut self;
        let mut over_time =
            |rows: &NpzRows| (0..*num_timesteps).map(|t| npz.row(rows, t)).collect::<Result<Vec<_>, _>>();
        let (means, quats, colors) = (over_time(means)?, over_time(quats)?, over_time(colors)?);
        let samples = vec![means, quats, vec![self.log_scales], vec![self.logit_opacities], colors];
        Ok(DynamicGaussians::from_samples(self.layout, self.num_timesteps, samples))
    }
}

impl SceneReader for ParamsNpz {
    type Error = InterchangeError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    fn num_timesteps(&self) -> usize {
        self.num_timesteps
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, InterchangeError> {
        let mut row = |rows: &NpzRows| self.npz.row(rows, timestep);
        let (means, quats, colors) = (row(&self.means)?, row(&self.quats)?, row(&self.colors)?);
        let values = vec![means, quats, self.log_scales.clone(), self.logit_opacities.clone(), colors];
        Ok(Gaussians::new(Arc::clone(&self.layout), self.num_gaussians, values))
    }
}

fn open_params(path: &Path) -> Result<ParamsNpz, InterchangeError> {
    let mut npz = NpzReader::open(path)?;
    let invalid = |key: &str, problem| InterchangeError::Array { path: path.into(), key: key.into(), problem };

    let means = npz.rows("means3D")?;
    let &[num_timesteps, num_gaussians, 3] = means.shape.as_slice() else {
        let problem = format!("has the shape {}, expected (timesteps, gaussians, 3)", show_shape(&means.shape));
        return Err(invalid("means3D", problem));
    };
    if num_timesteps == 0 || num_gaussians == 0 {
        let problem = format!("has {num_timesteps} timesteps of {num_gaussians} gaussians, expected at least one each");
        return Err(invalid("means3D", problem));
    }

    let mut varying = |key: &str, components: usize| {
        let array = npz.rows(key)?;
        let expected = [num_timesteps, num_gaussians, components];
        if array.shape != expected {
            let (found, expected) = (show_shape(&array.shape), show_shape(&expected));
            return Err(invalid(key, format!("has the shape {found}, expected {expected} to agree with means3D")));
        }
        Ok(array)
    };
    let colors = varying("rgb_colors", 3)?;
    let quats = varying("unnorm_rotations", 4)?;

    let mut constant = |key: &str, components: usize| {
        let array = npz.array(key)?;
        let shape = match array.shape.as_slice() {
            [1, rest @ ..] if rest.first() == Some(&num_gaussians) => rest,
            whole => whole,
        };
        let expected = [num_gaussians, components];
        if shape != expected && !(components == 1 && shape == [num_gaussians]) {
            let (found, expected) = (show_shape(&array.shape), show_shape(&expected));
            return Err(invalid(key, format!("has the shape {found}, expected {expected} to agree with means3D")));
        }
        Ok(array.values)
    };
    let (log_scales, logit_opacities) = (constant("log_scales", 3)?, constant("logit_opacities", 1)?);
    let layout = Layout::base();
    Ok(ParamsNpz { npz, num_timesteps, num_gaussians, layout, means, quats, log_scales, logit_opacities, colors })
}

/// Reads the origin of the scene in a `params.npz`; `None` if the file has no array `tcgs_first_frame`, as when another
/// program wrote the file.
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read, one of the three arrays is missing, or a number is out of its
/// range.
pub fn read_params_origin(path: &Path) -> Result<Option<ParamsOrigin>, InterchangeError> {
    let mut npz = NpzReader::open(path)?;
    if !npz.contains(FIRST_FRAME) {
        return Ok(None);
    }
    let mut number = |key: &str, expected: &str, legal: fn(f32) -> bool| {
        let array = npz.array(key)?;
        match array.values.as_slice() {
            &[value] if legal(value) => Ok(value),
            values => {
                let problem = format!("is {values:?}, expected {expected}");
                Err(InterchangeError::Array { path: path.into(), key: key.into(), problem })
            }
        }
    };
    Ok(Some(ParamsOrigin {
        first_frame: number(FIRST_FRAME, "a whole number from 0", |x| {
            x.fract() == 0.0 && (0.0..16_777_216.0).contains(&x)
        })? as u32,
        downscale: number(DOWNSCALE, "a whole number of 1 to 65536", |x| {
            x.fract() == 0.0 && (1.0..=65_536.0).contains(&x)
        })? as u32,
        frame_rate: number(FRAME_RATE, "a number, 0 or more", |x| x >= 0.0)?,
    }))
}

/// Reads which Gaussians of a `params.npz` are foreground: those that `seg_colors` paints red; `None` if the file has no
/// such array.
///
/// - returns: `[N]`
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read or the array is damaged.
pub fn read_params_foreground(path: &Path) -> Result<Option<Vec<bool>>, InterchangeError> {
    let mut npz = NpzReader::open(path)?;
    if !npz.contains("seg_colors") {
        return Ok(None);
    }
    let colors = npz.array("seg_colors")?;
    Ok(Some(colors.values.chunks_exact(3).map(|color| color[0] > 0.5).collect()))
}

/// Writes a scene as a `params.npz` that the viewer of Dynamic 3D Gaussians can show. The write is atomic: a temporary
/// file is renamed to `path` and replaces an existing file.
///
/// # Errors
/// [`InterchangeError::Write`] if the file cannot be written; an existing file is then unchanged.
///
/// # Panics
/// As [`write_params_npz_to`].
pub fn write_params_npz(path: &Path, scene: &DynamicGaussians, extras: &ParamsExtras) -> Result<(), InterchangeError> {
    let write = |file: &mut File| write_params_npz_to(BufWriter::new(file), scene, extras)?.flush();
    let written = write_whole(path, Existing::Replace, write);
    written.map_err(|error| InterchangeError::Write { path: path.into(), error })
}

/// Writes the bytes of a `params.npz`. Equal scenes and extras give equal bytes.
///
/// - `writer`: should be buffered
///
/// # Errors
/// The errors of `writer`.
///
/// # Panics
/// If the scene has no timestep or no Gaussian, if scales or opacities vary with time (the format holds them once), or
/// if `extras.foreground` does not have one label per Gaussian.
pub fn write_params_npz_to<W: Write + Seek>(
    writer: W,
    scene: &DynamicGaussians,
    extras: &ParamsExtras,
) -> io::Result<W> {
    let t = scene.num_timesteps();
    for attribute in [Attribute::LogScale, Attribute::LogitOpacity] {
        assert!(!scene.varies(attribute), "{} vary over {t} timesteps, params.npz holds one", attribute.name());
    }
    write_params_npz_from(writer, &mut &*scene, extras)
}

/// Writes the bytes of a `params.npz` of a scene that is read a timestep at a time, three times over. Scales and
/// opacities are those of the first timestep.
///
/// - `writer`: should be buffered
///
/// # Errors
/// The errors of `writer` and, as [`io::ErrorKind::Other`], of `scene`.
///
/// # Panics
/// If the scene has no timestep or no Gaussian, or if `extras.foreground` does not have one label per Gaussian.
pub fn write_params_npz_from<W: Write + Seek, R: SceneReader>(
    writer: W,
    scene: &mut R,
    extras: &ParamsExtras,
) -> io::Result<W> {
    let (t, n) = (scene.num_timesteps(), scene.num_gaussians());
    assert!(t > 0 && n > 0, "a scene of {t} timesteps of {n} gaussians");
    let seg_colors: Vec<[f32; 3]> = match extras.foreground {
        Some(foreground) => {
            assert_eq!(foreground.len(), n, "foreground: [{}] against [{n}]", foreground.len());
            foreground.iter().map(|&f| if f { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] }).collect()
        }
        None => vec![[1.0, 0.0, 0.0]; n],
    };
    let camera_rows = MIN_CAMERA_ROWS.max(extras.log_gains.len()).max(extras.offsets.len());
    let padded = |rows: &[[f32; 3]]| {
        let mut rows = rows.to_vec();
        rows.resize(camera_rows, [0.0; 3]);
        rows
    };

    let mut npz = NpzWriter::new(writer);
    for (key, attribute) in
        [("means3D", Attribute::Mean), ("rgb_colors", Attribute::Color), ("unnorm_rotations", Attribute::Quat)]
    {
        npz.array_with(key, &[t, n, attribute.components()], |put| {
            (0..t).try_for_each(|timestep| put(scene.at(timestep).map_err(io::Error::other)?.values(attribute)))
        })?;
    }
    let first = scene.at(0).map_err(io::Error::other)?;
    npz.array("logit_opacities", &[n, 1], [first.logit_opacities()])?;
    npz.array("log_scales", &[n, 3], [first.log_scales().as_flattened()])?;
    npz.array("seg_colors", &[n, 3], [seg_colors.as_flattened()])?;
    npz.array("cam_m", &[camera_rows, 3], [padded(extras.log_gains).as_flattened()])?;
    npz.array("cam_c", &[camera_rows, 3], [padded(extras.offsets).as_flattened()])?;
    if let Some(origin) = &extras.origin {
        let values = [origin.first_frame as f32, origin.downscale as f32, origin.frame_rate];
        for (key, value) in [FIRST_FRAME, DOWNSCALE, FRAME_RATE].into_iter().zip(values) {
            npz.array(key, &[1], [[value].as_slice()])?;
        }
    }
    npz.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two timesteps of three Gaussians, every value different.
    fn scene() -> DynamicGaussians {
        let mut counter = 0.0;
        let mut next = || {
            counter += 0.25;
            counter
        };
        let mut values = |count| -> Vec<f32> { (0..count).map(|_| next()).collect() };
        let means = vec![values(9), values(9)];
        let colors = vec![values(9), values(9)];
        let log_scales = vec![values(9)];
        let quats = vec![values(12), values(12)];
        let samples = vec![means, quats, log_scales, vec![vec![-1.0, 0.5, 2.0]], colors];
        DynamicGaussians::from_samples(Layout::base(), 2, samples)
    }

    fn bytes(scene: &DynamicGaussians, extras: &ParamsExtras) -> Vec<u8> {
        write_params_npz_to(io::Cursor::new(Vec::new()), scene, extras).unwrap().into_inner()
    }

    /// An array to write: key, shape, values.
    type Array = (&'static str, Vec<usize>, Vec<f32>);

    /// The arrays of [`scene`], for tests to spoil.
    fn arrays() -> Vec<Array> {
        let scene = scene();
        vec![
            ("means3D", vec![2, 3, 3], scene.samples(Attribute::Mean).concat()),
            ("rgb_colors", vec![2, 3, 3], scene.samples(Attribute::Color).concat()),
            ("unnorm_rotations", vec![2, 3, 4], scene.samples(Attribute::Quat).concat()),
            ("logit_opacities", vec![3, 1], scene.samples(Attribute::LogitOpacity).concat()),
            ("log_scales", vec![3, 3], scene.samples(Attribute::LogScale).concat()),
        ]
    }

    /// What reading gives, and the message without the file's name.
    fn read(arrays: &[Array]) -> Result<DynamicGaussians, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        let mut npz = NpzWriter::new(File::create(&path).unwrap());
        for (key, shape, values) in arrays {
            npz.array(key, shape, [values.as_slice()]).unwrap();
        }
        npz.finish().unwrap();
        read_params_npz(&path).map_err(|error| {
            let message = error.to_string();
            assert!(!message.contains('\n'), "{message}");
            message.strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned()
        })
    }

    fn read_with(change: impl Fn(&mut Vec<Array>)) -> Result<DynamicGaussians, String> {
        let mut arrays = arrays();
        change(&mut arrays);
        read(&arrays)
    }

    #[test]
    fn a_scene_survives_the_round_trip_and_gives_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
        assert_eq!(read_params_npz(&path).unwrap(), scene());
        assert_eq!(std::fs::read(&path).unwrap(), bytes(&scene(), &ParamsExtras::default()));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
    }

    /// [`arrays`] as [`Array`]s, compressed or not, in an archive.
    fn write_compressed(path: &Path, compressed: &[&str]) {
        let mut zip = zip::ZipWriter::new(File::create(path).unwrap());
        for (key, shape, values) in arrays() {
            let mut own = NpzWriter::new(io::Cursor::new(Vec::new()));
            own.array(key, &shape, [values.as_slice()]).unwrap();
            let mut own = zip::ZipArchive::new(own.finish().unwrap()).unwrap();
            let mut npy = Vec::new();
            io::Read::read_to_end(&mut own.by_index(0).unwrap(), &mut npy).unwrap();
            let is_compressed = compressed.contains(&key);
            let method = if is_compressed { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
            let options = zip::write::SimpleFileOptions::default().compression_method(method);
            zip.start_file(format!("{key}.npy"), options).unwrap();
            zip.write_all(&npy).unwrap();
        }
        zip.finish().unwrap();
    }

    #[test]
    fn a_timestep_is_read_alone_whether_compressed_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        for compressed in [&[][..], &["rgb_colors"], &["means3D", "unnorm_rotations", "rgb_colors", "log_scales"]] {
            write_compressed(&path, compressed);
            let mut params = ParamsNpz::open(&path).unwrap();
            let on_disk = [&params.means, &params.quats, &params.colors].map(NpzRows::is_on_disk);
            let stored = ["means3D", "unnorm_rotations", "rgb_colors"].map(|key| !compressed.contains(&key));
            assert_eq!(on_disk, stored);
            assert_eq!((params.num_timesteps(), params.num_gaussians()), (2, 3));
            for timestep in [1, 0, 1] {
                assert_eq!(params.at(timestep).unwrap(), scene().at(timestep));
            }
            assert_eq!(params.read_all().unwrap(), scene());
        }
    }

    #[test]
    fn a_file_that_is_written_to_while_it_is_open_is_no_other_scene() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
        let mut params = ParamsNpz::open(&path).unwrap();
        // Into the open file, not beside it: the first value of the second timestep.
        let mut bytes = std::fs::read(&path).unwrap();
        let second = scene().means(1)[0][0].to_le_bytes();
        let at = bytes.windows(4).position(|window| window == second).unwrap();
        bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        std::fs::write(&path, &bytes).unwrap();
        let error = params.at(1).unwrap_err().to_string();
        assert!(error.ends_with("means3D [1, 0, 0] is NaN, expected a finite number"), "{error}");
        std::fs::write(&path, &bytes[..at]).unwrap();
        assert!(params.at(1).unwrap_err().to_string().contains("means3D "));
    }

    #[test]
    fn extras_are_stored_as_the_source_stores_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        let extras = ParamsExtras {
            foreground: Some(&[true, false, true]),
            log_gains: &[[0.1, 0.2, 0.3]],
            offsets: &[[0.0; 3], [0.5; 3]],
            origin: Some(ParamsOrigin { first_frame: 40, downscale: 2, frame_rate: 29.97 }),
        };
        write_params_npz(&path, &scene(), &extras).unwrap();
        let mut npz = NpzReader::open(&path).unwrap();
        assert_eq!(npz.array("seg_colors").unwrap().values, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
        let (gains, offsets) = (npz.array("cam_m").unwrap(), npz.array("cam_c").unwrap());
        assert_eq!((gains.shape, &gains.values[..4]), (vec![50, 3], &[0.1, 0.2, 0.3, 0.0][..]));
        assert_eq!((offsets.shape, &offsets.values[2..7]), (vec![50, 3], &[0.0, 0.5, 0.5, 0.5, 0.0][..]));

        assert_eq!(read_params_origin(&path).unwrap(), extras.origin);
        assert_eq!(read_params_npz(&path).unwrap(), scene());

        let many = ParamsExtras { log_gains: &[[1.0; 3]; 60], ..extras };
        write_params_npz(&path, &scene(), &many).unwrap();
        assert_eq!(NpzReader::open(&path).unwrap().array("cam_c").unwrap().shape, [60, 3]);

        write_params_npz(&path, &scene(), &ParamsExtras::default()).unwrap();
        assert_eq!(read_params_origin(&path).unwrap(), None);
        let all = NpzReader::open(&path).unwrap().array("seg_colors").unwrap();
        assert_eq!(all.values, [1.0, 0.0, 0.0].repeat(3));
    }

    #[test]
    fn an_origin_out_of_range_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        let problem = |arrays: &[(&str, &[f32])]| {
            let mut npz = NpzWriter::new(File::create(&path).unwrap());
            for (key, values) in arrays {
                npz.array(key, &[values.len()], [*values]).unwrap();
            }
            npz.finish().unwrap();
            let message = read_params_origin(&path).unwrap_err().to_string();
            message.strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned()
        };
        let origin = |first_frame, downscale, frame_rate| {
            problem(&[(FIRST_FRAME, &[first_frame]), (DOWNSCALE, &[downscale]), (FRAME_RATE, &[frame_rate])])
        };
        assert_eq!(origin(1.5, 1.0, 30.0), "tcgs_first_frame is [1.5], expected a whole number from 0");
        assert_eq!(origin(-1.0, 1.0, 30.0), "tcgs_first_frame is [-1.0], expected a whole number from 0");
        assert_eq!(origin(0.0, 0.0, 30.0), "tcgs_downscale is [0.0], expected a whole number of 1 to 65536");
        assert_eq!(origin(0.0, 1.0, -30.0), "tcgs_frame_rate is [-30.0], expected a number, 0 or more");
        assert_eq!(problem(&[(FIRST_FRAME, &[])]), "tcgs_first_frame is [], expected a whole number from 0");
        assert!(problem(&[(FIRST_FRAME, &[0.0])]).starts_with("tcgs_downscale is missing, found "));
    }

    #[test]
    #[should_panic(expected = "logit_opacities vary over 3 timesteps, params.npz holds one")]
    fn opacities_that_vary_are_a_mistake() {
        let mut scene = scene();
        let mut next = scene.at(1);
        next.logit_opacities_mut()[2] += 1.0;
        scene.push(next);
        bytes(&scene, &ParamsExtras::default());
    }

    #[test]
    fn other_shapes_of_the_constant_arrays_are_tolerated() {
        for shape in [vec![3], vec![1, 3], vec![1, 3, 1]] {
            assert_eq!(read_with(|a| a[3].1 = shape.clone()).unwrap(), scene(), "{shape:?}");
        }
        assert_eq!(read_with(|a| a[4].1 = vec![1, 3, 3]).unwrap(), scene());
    }

    #[test]
    fn one_gaussian_at_one_timestep_is_a_scene() {
        let single = |shape: &[usize], values: &[f32]| (shape.to_vec(), values.to_vec());
        let arrays = [
            ("means3D", single(&[1, 1, 3], &[1.0, 2.0, 3.0])),
            ("rgb_colors", single(&[1, 1, 3], &[0.1, 0.2, 0.3])),
            ("unnorm_rotations", single(&[1, 1, 4], &[1.0, 0.0, 0.0, 0.0])),
            ("logit_opacities", single(&[1, 1], &[0.5])),
            ("log_scales", single(&[1, 3], &[-1.0, -2.0, -3.0])),
        ]
        .map(|(key, (shape, values))| (key, shape, values));
        let scene = read(&arrays).unwrap();
        assert_eq!((scene.num_timesteps(), scene.values(Attribute::LogScale, 0)), (1, [-1.0, -2.0, -3.0].as_slice()));
    }

    #[test]
    fn every_inconsistency_names_its_key() {
        for key in 0..5 {
            let name = arrays()[key].0;
            let missing = read_with(|a| drop(a.remove(key))).unwrap_err();
            assert!(missing.starts_with(&format!("{name} is missing, found ")), "{missing}");
            let nan = read_with(|a| a[key].2[1] = f32::NAN).unwrap_err();
            assert!(nan.starts_with(&format!("{name} [")) && nan.contains("is NaN, expected a finite number"), "{nan}");
        }
        let problem = |change: fn(&mut Vec<Array>)| read_with(change).unwrap_err();
        assert_eq!(
            problem(|a| a[0].1 = vec![6, 3]),
            "means3D has the shape (6, 3), expected (timesteps, gaussians, 3)"
        );
        assert_eq!(
            problem(|a| a[0] = ("means3D", vec![0, 3, 3], vec![])),
            "means3D has 0 timesteps of 3 gaussians, expected at least one each"
        );
        assert_eq!(
            problem(|a| a[0] = ("means3D", vec![2, 0, 3], vec![])),
            "means3D has 2 timesteps of 0 gaussians, expected at least one each"
        );
        assert_eq!(
            problem(|a| a[1].1 = vec![3, 2, 3]),
            "rgb_colors has the shape (3, 2, 3), expected (2, 3, 3) to agree with means3D"
        );
        assert_eq!(
            problem(|a| a[2] = ("unnorm_rotations", vec![2, 3, 3], vec![0.0; 18])),
            "unnorm_rotations has the shape (2, 3, 3), expected (2, 3, 4) to agree with means3D"
        );
        assert_eq!(
            problem(|a| a[3] = ("logit_opacities", vec![4, 1], vec![0.0; 4])),
            "logit_opacities has the shape (4, 1), expected (3, 1) to agree with means3D"
        );
        assert_eq!(
            problem(|a| a[4].1 = vec![9]),
            "log_scales has the shape (9,), expected (3, 3) to agree with means3D"
        );
    }

    #[test]
    fn a_cut_or_flipped_file_never_panics_and_never_passes_for_another() {
        let whole = bytes(&scene(), &ParamsExtras::default());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("params.npz");
        // Steps keep the test short; the table of contents at the end is cut at every byte.
        let table = whole.len() - 600;
        for length in (0..table).step_by(7).chain(table..whole.len()) {
            std::fs::write(&path, &whole[..length]).unwrap();
            let message = read_params_npz(&path).unwrap_err().to_string();
            assert!(message.starts_with(&path.display().to_string()) && !message.contains('\n'), "{length}: {message}");
        }
        for at in (0..whole.len()).step_by(3) {
            let mut flipped = whole.clone();
            flipped[at] ^= 0x10;
            std::fs::write(&path, &flipped).unwrap();
            if let Ok(found) = read_params_npz(&path) {
                assert_eq!(found, scene(), "byte {at}");
            }
        }
    }

    #[test]
    #[should_panic(expected = "foreground: [2] against [3]")]
    fn flags_for_another_number_of_gaussians_are_a_mistake() {
        bytes(&scene(), &ParamsExtras { foreground: Some(&[true, false]), ..Default::default() });
    }

    #[test]
    #[should_panic(expected = "a scene of 0 timesteps")]
    fn an_empty_scene_is_a_mistake() {
        bytes(&DynamicGaussians::default(), &ParamsExtras::default());
    }
}

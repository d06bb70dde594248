//! `cameras` and `images` of a model, `.bin` or `.txt`. Source: COLMAP's documentation, "Output Format".

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_core::length;

use super::bytes::{Bytes, lines, number, numbers};
use crate::lens::{Crop, Lens, MAX_SIDE};
use crate::{CaptureError, files};

/// Cameras and images of a COLMAP model.
pub struct ColmapModel {
    /// The file that the cameras were read from.
    pub cameras_file: PathBuf,
    /// The file that the images were read from.
    pub images_file: PathBuf,
    /// Lenses by the ids of cameras.
    pub cameras: BTreeMap<u32, Arc<Lens>>,
    /// In the order of the file.
    pub images: Vec<PosedImage>,
}

/// One image and its pose.
pub struct PosedImage {
    /// The path of the file, relative to the folder of all images.
    pub name: String,
    /// The id of its lens.
    pub camera_id: u32,
    /// Rotation of `camera_from_world`: `w, x, y, z`.
    pub quat: [f64; 4],
    /// Translation of `camera_from_world`, scene units.
    pub translation: [f64; 3],
}

/// A camera model: its name, and the places of its parameters in [`PARAMETERS`].
struct CameraModel {
    id: u32,
    name: &'static str,
    /// Places in the parameters of a lens.
    places: &'static [usize],
}

/// Parameters of a lens: both focal lengths (`F`), principal point, `k1` to `k6`, `p1`, `p2`.
const PARAMETERS: usize = 13;
/// One focal length for both axes.
const F: usize = 12;
const FX: usize = 0;
const FY: usize = 1;
const CX: usize = 2;
const CY: usize = 3;
const K1: usize = 4;
const K2: usize = 5;
const K3: usize = 6;
const K4: usize = 7;
const K5: usize = 8;
const K6: usize = 9;
const P1: usize = 10;
const P2: usize = 11;

/// The pinhole models with distortion; the others are fisheyes.
const MODELS: [CameraModel; 6] = [
    CameraModel { id: 0, name: "SIMPLE_PINHOLE", places: &[F, CX, CY] },
    CameraModel { id: 1, name: "PINHOLE", places: &[FX, FY, CX, CY] },
    CameraModel { id: 2, name: "SIMPLE_RADIAL", places: &[F, CX, CY, K1] },
    CameraModel { id: 3, name: "RADIAL", places: &[F, CX, CY, K1, K2] },
    CameraModel { id: 4, name: "OPENCV", places: &[FX, FY, CX, CY, K1, K2, P1, P2] },
    CameraModel { id: 6, name: "FULL_OPENCV", places: &[FX, FY, CX, CY, K1, K2, P1, P2, K3, K4, K5, K6] },
];

impl CameraModel {
    fn find(found: &str, is: impl Fn(&Self) -> bool) -> Result<&'static Self, String> {
        MODELS.iter().find(|model| is(model)).ok_or_else(|| {
            let names = MODELS.map(|model| model.name).join(", ");
            format!("has the camera model {found}, expected one of {names}; `colmap image_undistorter` converts others")
        })
    }

    fn lens(&self, size: [u64; 2], parameters: &[f64]) -> Result<Arc<Lens>, String> {
        let mut all = [0.0; PARAMETERS];
        for (&place, &value) in self.places.iter().zip(parameters) {
            all[place] = value;
        }
        if self.places[0] == F {
            (all[FX], all[FY]) = (all[F], all[F]);
        }
        let side = |size: u64| usize::try_from(size).ok().filter(|size| (1..=MAX_SIDE).contains(size));
        let (Some(width), Some(height)) = (side(size[0]), side(size[1])) else {
            return Err(format!("is for {}x{} pixels, expected 1 to {MAX_SIDE} a side", size[0], size[1]));
        };
        if all[FX] <= 0.0 || all[FY] <= 0.0 {
            return Err(format!("has the focal lengths {} and {}, expected more than 0", all[FX], all[FY]));
        }
        let mut lens = Lens {
            width,
            height,
            focal: [all[FX], all[FY]],
            principal: [all[CX], all[CY]],
            radial: std::array::from_fn(|i| all[K1 + i]),
            tangential: [all[P1], all[P2]],
            crop: Crop::default(),
        };
        lens.find_crop()?;
        Ok(Arc::new(lens))
    }
}

impl ColmapModel {
    /// Reads the binary files of a folder, else the text files. Crops of lenses are found.
    ///
    /// # Errors
    /// [`CaptureError`] if a file is missing or damaged, or holds what no pinhole camera has.
    pub fn read(folder: &Path) -> Result<Self, CaptureError> {
        let (cameras_file, cameras) = read(folder, "cameras", binary_cameras, text_cameras)?;
        let (images_file, images) = read(folder, "images", binary_images, text_images)?;
        Ok(Self { cameras_file, images_file, cameras, images })
    }
}

/// Reads one of the files of a model, preferring the binary one.
fn read<T>(
    folder: &Path,
    name: &str,
    binary: impl Fn(Bytes<'_>) -> Result<T, String>,
    text: impl Fn(&str) -> Result<T, String>,
) -> Result<(PathBuf, T), CaptureError> {
    let path = folder.join(format!("{name}.bin"));
    if path.is_file() {
        let bytes = files::bytes(&path)?;
        let read = binary(Bytes(&bytes)).map_err(|problem| CaptureError::invalid(&path, problem))?;
        return Ok((path, read));
    }
    let path = folder.join(format!("{name}.txt"));
    if !path.is_file() {
        return Err(CaptureError::invalid(folder, format!("has no {name}.bin or {name}.txt, expected a COLMAP model")));
    }
    let content = files::long_text(&path)?;
    let read = text(&content).map_err(|problem| CaptureError::invalid(&path, problem))?;
    Ok((path, read))
}

type Cameras = BTreeMap<u32, Arc<Lens>>;

fn binary_cameras(mut from: Bytes<'_>) -> Result<Cameras, String> {
    let mut cameras = Cameras::new();
    for _ in 0..from.count(24)? {
        let (id, model_id) = (from.u32()?, from.u32()?);
        let problem = |problem: String| format!("camera {id}: {problem}");
        let size = [from.u64()?, from.u64()?];
        let model = CameraModel::find(&format!("number {model_id}"), |model| model.id == model_id).map_err(problem)?;
        let mut parameters = Vec::new();
        for _ in model.places {
            parameters.extend(from.f64s::<1>()?);
        }
        cameras.insert(id, model.lens(size, &parameters).map_err(problem)?);
    }
    Ok(cameras)
}

fn text_cameras(text: &str) -> Result<Cameras, String> {
    let mut cameras = Cameras::new();
    for (i, line) in lines(text).filter(|(_, line)| !line.is_empty()) {
        let problem = |problem: String| format!("line {i}: {problem}");
        let mut words = line.split_whitespace();
        let id = number(words.next(), "a camera's number").map_err(problem)?;
        let name = words.next().unwrap_or("nothing");
        let model = CameraModel::find(name, |model| model.name == name).map_err(problem)?;
        let mut side = || number(words.next(), "a width and a height").map_err(problem);
        let size = [side()?, side()?];
        let parameters: Vec<f64> =
            words.map(|word| number(Some(word), "a parameter")).collect::<Result<_, _>>().map_err(problem)?;
        if parameters.len() != model.places.len() || parameters.iter().any(|p| !p.is_finite()) {
            let (found, expected) = (parameters.len(), model.places.len());
            return Err(problem(format!("has {found} parameters, expected {expected} finite ones of {name}")));
        }
        cameras.insert(id, model.lens(size, &parameters).map_err(problem)?);
    }
    Ok(cameras)
}

fn binary_images(mut from: Bytes<'_>) -> Result<Vec<PosedImage>, String> {
    /// A point of an image: place and number.
    const POINT_BYTES: usize = 24;
    let mut images = Vec::new();
    for _ in 0..from.count(73)? {
        from.u32()?;
        let (quat, translation) = (from.f64s()?, from.f64s()?);
        let (camera_id, name) = (from.u32()?, from.text()?);
        let points = from.count(POINT_BYTES)?;
        from.skip(points * POINT_BYTES)?;
        images.push(PosedImage { name, camera_id, quat, translation });
    }
    check_quats(images)
}

fn text_images(text: &str) -> Result<Vec<PosedImage>, String> {
    let mut images = Vec::new();
    let mut lines = lines(text);
    while let Some((i, line)) = lines.next() {
        if line.is_empty() {
            continue;
        }
        let problem = |problem: String| format!("line {i}: {problem}");
        let mut words = line.splitn(10, ' ');
        number::<u32>(words.next(), "an image's number").map_err(problem)?;
        let quat = numbers(&mut words, "a rotation qw qx qy qz").map_err(problem)?;
        let translation = numbers(&mut words, "a translation tx ty tz").map_err(problem)?;
        let camera_id = number(words.next(), "a camera's number").map_err(problem)?;
        let name = words.next().ok_or_else(|| problem("found no name, expected that of an image".into()))?.to_owned();
        images.push(PosedImage { name, camera_id, quat, translation });
        // Its points.
        lines.next();
    }
    check_quats(images)
}

fn check_quats(images: Vec<PosedImage>) -> Result<Vec<PosedImage>, String> {
    match images.iter().find(|image| (length(image.quat) - 1.0).abs() > 1e-2) {
        Some(image) => {
            Err(format!("image {}: its quaternion has the length {}, expected 1", image.name, length(image.quat)))
        }
        None => Ok(images),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_stand_where_colmap_has_them() {
        let text = "# a comment\n1 SIMPLE_RADIAL 64 48 50 32 24 0.01\n2 OPENCV 64 48 50 51 32 24 0.01 0.02 0.003 0.004\n\
                    7 FULL_OPENCV 64 48 50 51 32 24 0.01 0.02 0.003 0.004 0.05 0.06 0.07 0.08\n";
        let cameras = text_cameras(text).unwrap();
        let lens = &cameras[&1];
        assert_eq!((lens.focal, lens.principal, lens.radial[..2].to_vec()), ([50.0; 2], [32.0, 24.0], vec![0.01, 0.0]));
        assert_eq!(cameras[&2].tangential, [0.003, 0.004]);
        assert_eq!((cameras[&2].focal, cameras[&2].radial), ([50.0, 51.0], [0.01, 0.02, 0.0, 0.0, 0.0, 0.0]));
        assert_eq!(cameras[&7].radial, [0.01, 0.02, 0.05, 0.06, 0.07, 0.08]);
    }

    #[test]
    fn bad_cameras_are_named() {
        let problem = |text: &str| text_cameras(text).unwrap_err();
        let fisheye = problem("1 OPENCV_FISHEYE 64 48 50 50 32 24 0 0 0 0");
        assert!(fisheye.starts_with("line 1: has the camera model OPENCV_FISHEYE, expected one of SIMPLE_PINHOLE, "));
        assert_eq!(
            problem("# c\n1 PINHOLE 64 48 50 32 24"),
            "line 2: has 3 parameters, expected 4 finite ones of PINHOLE"
        );
        assert_eq!(
            problem("1 SIMPLE_PINHOLE 64 48 -1 32 24"),
            "line 1: has the focal lengths -1 and -1, expected more than 0"
        );
        assert_eq!(problem("1 PINHOLE w 48"), "line 1: found w, expected a width and a height");
    }

    #[test]
    fn text_images_have_a_line_of_points_that_may_be_empty() {
        let text = "# c\n1 1 0 0 0 1 2 3 1 a b.png\n\n2 0 1 0 0 4 5 6 1 c.png\n3.5 4.5 -1 2 3 7\n";
        let images = text_images(text).unwrap();
        let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
        assert_eq!(names, ["a b.png", "c.png"]);
        assert_eq!((images[1].quat, images[1].translation), ([0.0, 1.0, 0.0, 0.0], [4.0, 5.0, 6.0]));
        assert!(text_images("1 1 0 0").err().unwrap().contains("expected a rotation"));
        assert!(text_images("1 2 0 0 0 1 2 3 1 a.png").err().unwrap().contains("quaternion has the length 2"));
    }
}

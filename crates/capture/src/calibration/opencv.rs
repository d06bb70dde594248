//! `intri.yml` and `extri.yml`, which EasyMocap and others write with OpenCV's `FileStorage`.
//!
//! ```text
//! intri.yml   names; for each camera K_<name> [3, 3], dist_<name> [1, 4..8], perhaps H_<name> and W_<name>
//! extri.yml   names; for each camera Rot_<name> [3, 3] or R_<name> [3, 1], T_<name> [3, 1]
//! ```
//!
//! | | |
//! |---|---|
//! | direction | `camera_from_world`; `R` is a rotation vector (Rodrigues) |
//! | axes | x right, y down, z forward |
//! | pixels | the centre of the first pixel is `(0, 0)`; here 0.5 is added |
//! | distortion | `k1 k2 p1 p2 k3 …` |
//! | unit | that of the board, by custom metres; not written in the file |
//! | size | `H`, `W` in newer files, else that of the video is taken |

use std::path::{Path, PathBuf};

use tcgs_core::rotmat_from_vector;
use yaml_rust2::parser::Parser;
use yaml_rust2::{Event, Yaml, YamlLoader};

use super::numbers::{OpenCvCamera, side};
use super::{CalibratedCamera, Format};
use crate::{CaptureError, files};

const INTRINSICS: &str = "intri.yml";
const EXTRINSICS: &str = "extri.yml";

pub(super) const FORMAT: Format = Format {
    name: "opencv",
    mark: "intri.yml with extri.yml (OpenCV, EasyMocap)",
    find: |folder| Ok(Vec::from_iter(Some(folder.join(INTRINSICS)).filter(|path| path.is_file()))),
    is: |path| path.join(INTRINSICS).is_file() || files::name(path) == INTRINSICS,
    read,
    in_metres: false,
};

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
    let intrinsics = Storage::read(folder.join(INTRINSICS))?;
    let extrinsics = Storage::read(folder.join(EXTRINSICS))?;
    let names = intrinsics.names()?;
    let mut cameras = Vec::new();
    for name in names {
        let rotation = match extrinsics.has(&format!("Rot_{name}")) {
            true => rows(extrinsics.numbers(&format!("Rot_{name}"))?),
            false => rotmat_from_vector(extrinsics.numbers(&format!("R_{name}"))?),
        };
        let size = [intrinsics.side(&format!("W_{name}")), intrinsics.side(&format!("H_{name}"))];
        let camera = OpenCvCamera {
            size: size[0].zip(size[1]),
            matrix: rows(intrinsics.numbers(&format!("K_{name}"))?),
            distortion: intrinsics.list(&format!("dist_{name}"))?,
            rotation,
            translation: extrinsics.numbers(&format!("T_{name}"))?,
            names: vec![name.clone()],
        };
        let camera = camera.checked();
        cameras.push(camera.map_err(|problem| intrinsics.invalid(format!("camera {name}: {problem}")))?);
    }
    Ok(cameras)
}

/// A file of OpenCV's `FileStorage`.
struct Storage {
    path: PathBuf,
    root: Yaml,
}

impl Storage {
    fn read(path: PathBuf) -> Result<Self, CaptureError> {
        let text = files::text(&path)?;
        // OpenCV writes `%YAML:1.0`, which is no directive of YAML, and `!!opencv-matrix`, an undeclared tag.
        let body: String = text
            .lines()
            .filter(|line| !line.starts_with('%') && line.trim_end() != "---")
            .map(|line| line.replace("!!opencv-matrix", "") + "\n")
            .collect();
        let documents = check_yaml(&body)
            .and_then(|()| YamlLoader::load_from_str(&body).map_err(|error| format!("is no YAML: {error}")))
            .map_err(|problem| CaptureError::invalid(&path, problem))?;
        match documents.into_iter().next() {
            Some(root @ Yaml::Hash(_)) => Ok(Self { path, root }),
            _ => Err(CaptureError::invalid(path, "holds nothing, expected matrices of OpenCV")),
        }
    }

    fn invalid(&self, problem: String) -> CaptureError {
        CaptureError::invalid(&self.path, problem)
    }

    fn has(&self, key: &str) -> bool {
        !self.root[key].is_badvalue()
    }

    /// The cameras of `names`, else every `K_<name>`.
    fn names(&self) -> Result<Vec<String>, CaptureError> {
        if let Some(names) = self.root["names"].as_vec() {
            return Ok(names.iter().map(text_of).collect());
        }
        let keys = self.root.as_hash().into_iter().flatten();
        let names: Vec<String> = keys.filter_map(|(key, _)| Some(key.as_str()?.strip_prefix("K_")?.into())).collect();
        match names.is_empty() {
            true => Err(self.invalid("has neither names nor matrices K_<camera>, expected intrinsics".into())),
            false => Ok(names),
        }
    }

    /// The elements of a matrix.
    fn list(&self, key: &str) -> Result<Vec<f64>, CaptureError> {
        let data = &self.root[key]["data"];
        let data = data.as_vec().ok_or_else(|| self.invalid(format!("has no matrix {key}, expected one")))?;
        data.iter()
            .map(|value| {
                number(value).ok_or_else(|| self.invalid(format!("{key} holds {value:?}, expected numbers alone")))
            })
            .collect()
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N], CaptureError> {
        let list = self.list(key)?;
        let found = list.len();
        list.try_into().map_err(|_| self.invalid(format!("{key} has {found} numbers, expected {N}")))
    }

    fn side(&self, key: &str) -> Option<usize> {
        number(&self.root[key]).and_then(side)
    }
}

/// Refuses references and deep lists, which no matrix of OpenCV has: references multiply memory, and loading recurses
/// once per level.
fn check_yaml(text: &str) -> Result<(), String> {
    const MAX_DEPTH: usize = 8;
    let mut parser = Parser::new_from_str(text);
    let mut depth = 0_usize;
    loop {
        match parser.next_token().map_err(|error| format!("is no YAML: {error}"))?.0 {
            Event::StreamEnd => return Ok(()),
            Event::Alias(_) => return Err("has a reference, expected matrices of OpenCV".into()),
            Event::SequenceStart(..) | Event::MappingStart(..) => depth += 1,
            Event::SequenceEnd | Event::MappingEnd => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > MAX_DEPTH {
            return Err(format!("has lists inside lists, more than {MAX_DEPTH} deep, expected matrices of OpenCV"));
        }
    }
}

fn rows(m: [f64; 9]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[3 * i + j]))
}

/// OpenCV writes whole numbers as `5.`.
fn number(value: &Yaml) -> Option<f64> {
    match value {
        Yaml::Integer(value) => Some(*value as f64),
        Yaml::Real(text) | Yaml::String(text) => text.trim().parse().ok(),
        _ => None,
    }
}

fn text_of(value: &Yaml) -> String {
    match value {
        Yaml::Integer(value) => value.to_string(),
        Yaml::String(text) | Yaml::Real(text) => text.clone(),
        other => format!("{other:?}"),
    }
}

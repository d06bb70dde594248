//! Point clouds in PLY files, as COLMAP, nerfstudio and most other programs write them.

use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::path::Path;

use serde::Deserialize;
use serde_ply::{DeserializeError, PlyReader, PropertyType, ScalarType};
use tcgs_core::PointCloud;

use crate::InterchangeError;

/// Colour of points that have none.
const GREY: f32 = 0.5;

/// One point. Colours are left out by programs that know none.
#[derive(Deserialize)]
struct Vertex {
    x: f32,
    y: f32,
    z: f32,
    red: Option<f32>,
    green: Option<f32>,
    blue: Option<f32>,
}

/// Reads a point cloud from the element `vertex` of a PLY file: the properties `x`, `y`, `z`, and `red`, `green`,
/// `blue` if present, as bytes (0 to 255) or floats (0 to 1). Points without colours are grey (0.5). All points are
/// foreground, since such files do not tell what moves.
///
/// - returns: positions in the file's unit, colours in `[0, 1]`
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if the file is not a complete PLY
/// file, has no points, or holds a number that is not finite.
pub fn read_ply_points(path: &Path) -> Result<PointCloud, InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    let invalid = |problem| InterchangeError::File { path: path.into(), problem };
    let damaged = |DeserializeError(error)| match error.kind() {
        ErrorKind::UnexpectedEof => invalid("ends early, expected a whole PLY file".into()),
        ErrorKind::InvalidData => invalid(format!("{error}, expected a PLY file of points")),
        _ => failed(error),
    };
    let mut ply = PlyReader::from_reader(BufReader::new(File::open(path).map_err(failed)?)).map_err(damaged)?;
    let Some(element) = ply.current_element().filter(|element| element.name == "vertex") else {
        let found = ply.current_element().map_or("nothing", |element| &element.name);
        return Err(invalid(format!("holds {found} first, expected the element vertex")));
    };
    if let Some(missing) = ["x", "y", "z"].iter().find(|name| !element.has_property(name)) {
        return Err(invalid(format!("has no property {missing}, expected x, y, z, and red, green, blue for colours")));
    }
    let is_float = |name: &str| {
        let property = element.get_property(name).map(|property| &property.property_type);
        matches!(property, Some(PropertyType::Scalar(ScalarType::F32 | ScalarType::F64)))
    };
    let scale = if is_float("red") { 1.0 } else { 1.0 / 255.0 };
    let vertices: Vec<Vertex> = ply.next_element().map_err(damaged)?;
    if vertices.is_empty() {
        return Err(invalid("holds no point, expected at least one".into()));
    }
    let mut cloud = PointCloud::default();
    for (i, vertex) in vertices.iter().enumerate() {
        let point = [vertex.x, vertex.y, vertex.z];
        let color = [vertex.red, vertex.green, vertex.blue].map(|c| c.map_or(GREY, |c| c * scale));
        if let Some(value) = point.iter().chain(&color).find(|x| !x.is_finite()) {
            return Err(invalid(format!("point {i}: {value}, expected a finite number")));
        }
        cloud.points.push(point);
        cloud.colors.push(color.map(|c| c.clamp(0.0, 1.0)));
        cloud.foreground.push(true);
    }
    Ok(cloud)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<PointCloud, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read_ply_points(file.path()).map_err(|error| {
            let message = error.to_string();
            message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
        })
    }

    fn header(format: &str, properties: &[&str]) -> String {
        let properties: String = properties.iter().map(|p| format!("property {p}\n")).collect();
        format!("ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 2\n{properties}end_header\n")
    }

    const PLACE: [&str; 3] = ["float x", "float y", "float z"];

    #[test]
    fn colours_are_bytes_or_floats_or_absent() {
        let with = |colors: [&'static str; 3]| [&PLACE[..], &["float nx"], &colors].concat();
        let bytes_of_colors = with(["uchar red", "uchar green", "uchar blue"]);
        let mut bytes = header("binary_little_endian", &bytes_of_colors).into_bytes();
        for place in [[1.0_f32, 2.0, 3.0, 9.0], [-4.0, 5.0, 0.5, 9.0]] {
            bytes.extend(place.iter().flat_map(|x| x.to_le_bytes()));
            bytes.extend([0, 51, 255]);
        }
        let cloud = read(&bytes).unwrap();
        assert_eq!(cloud.points, [[1.0, 2.0, 3.0], [-4.0, 5.0, 0.5]]);
        let [red, green, blue] = cloud.colors[1];
        assert!((green - 0.2).abs() < 1e-6 && cloud.foreground[1]);
        assert_eq!([red, blue], [0.0, 1.0]);
        let text = header("ascii", &with(["float red", "float green", "float blue"]))
            + "1 2 3 0 0.25 0.5 1\n-4 5 0.5 0 0 1 0\n";
        let cloud = read(text.as_bytes()).unwrap();
        assert_eq!((cloud.points[1], cloud.colors[0]), ([-4.0, 5.0, 0.5], [0.25, 0.5, 1.0]));
        let text = header("ascii", &PLACE) + "1 2 3\n4 5 6\n";
        assert_eq!(read(text.as_bytes()).unwrap().colors, [[0.5; 3]; 2]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let problem = |text: &str| read(text.as_bytes()).unwrap_err();
        assert_eq!(problem(&(header("ascii", &PLACE) + "1 2 3\n")), "ends early, expected a whole PLY file");
        let none = header("ascii", &PLACE).replace("vertex 2", "vertex 0");
        assert_eq!(problem(&none), "holds no point, expected at least one");
        let message = problem(&header("ascii", &PLACE[..2]));
        assert!(message.starts_with("has no property z, expected x, y, z"), "{message}");
        let message = problem(&(header("ascii", &PLACE) + "1 2 3\n4 nan 6\n"));
        assert_eq!(message, "point 1: NaN, expected a finite number");
        assert!(problem("glTF\n").ends_with("expected a PLY file of points"));
    }
}

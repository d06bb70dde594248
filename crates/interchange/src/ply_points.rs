//! Point clouds in PLY files, as COLMAP, nerfstudio and most other programs write them.

use std::io::ErrorKind;
use std::path::Path;

use serde::Deserialize;
use serde_ply::{DeserializeError, PropertyType, ScalarType};
use tcgs_core::PointCloud;

use crate::ply::{least_bytes, open_header};
use crate::{InterchangeError, ReadLimits};

/// Colour of points that have none.
const GREY: f32 = 0.5;

/// Properties of a point's place and of its colour.
const PLACE: [&str; 3] = ["x", "y", "z"];
const COLOR: [&str; 3] = ["red", "green", "blue"];

/// A point of a file without colours. `serde_ply` refuses optional properties in binary files.
#[derive(Deserialize)]
struct Point {
    x: f32,
    y: f32,
    z: f32,
}

/// A point of a file with colours.
#[derive(Deserialize)]
struct ColoredPoint {
    x: f32,
    y: f32,
    z: f32,
    red: f32,
    green: f32,
    blue: f32,
}

/// Reads a point cloud from the element `vertex` of a PLY file: the properties `x`, `y`, `z`, and `red`, `green`,
/// `blue` if all are present. Colours are bytes (0 to 255) or floats (0 to 1). Points without colours are grey (0.5).
/// All points are foreground, since such files do not tell what moves.
///
/// - returns: positions in the file's unit, colours in `[0, 1]`
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if the file is not a complete PLY
/// file, has no points, or holds a number that is not finite; [`InterchangeError::Limit`] if its header claims more
/// memory than `limits` allow.
pub fn read_ply_points(path: &Path, limits: ReadLimits) -> Result<PointCloud, InterchangeError> {
    let invalid = |problem| InterchangeError::File { path: path.into(), problem };
    let ends_early = || invalid("ends early, expected a whole PLY file".into());
    let damaged = |DeserializeError(error): DeserializeError| match error.kind() {
        ErrorKind::UnexpectedEof => ends_early(),
        ErrorKind::InvalidData => invalid(format!("{error}, expected a PLY file of points")),
        _ => InterchangeError::Read { path: path.into(), error },
    };
    let (mut ply, length) = open_header(path, damaged)?;
    let Some(element) = ply.current_element().filter(|element| element.name == "vertex") else {
        let found = ply.current_element().map_or("nothing", |element| &element.name);
        return Err(invalid(format!("holds {found} first, expected the element vertex")));
    };
    if let Some(missing) = PLACE.iter().find(|name| !element.has_property(name)) {
        return Err(invalid(format!("has no property {missing}, expected x, y, z, and red, green, blue for colours")));
    }
    if least_bytes(ply.header()).is_none_or(|least| least > length) {
        return Err(ends_early());
    }
    // The rows as they are read, then points, colours and foreground.
    let row = size_of::<ColoredPoint>() + 2 * size_of::<[f32; 3]>() + 1;
    limits.check_bytes(path, length, element.count as u64 * row as u64)?;
    let is_float = |name: &str| {
        let property = element.get_property(name).map(|property| &property.property_type);
        matches!(property, Some(PropertyType::Scalar(ScalarType::F32 | ScalarType::F64)))
    };
    let scale = if is_float("red") { 1.0 } else { 1.0 / 255.0 };
    let (points, colors): (Vec<_>, Vec<_>) = if COLOR.iter().all(|name| element.has_property(name)) {
        let rows: Vec<ColoredPoint> = ply.next_element().map_err(damaged)?;
        rows.iter().map(|row| ([row.x, row.y, row.z], [row.red, row.green, row.blue].map(|c| c * scale))).unzip()
    } else {
        let rows: Vec<Point> = ply.next_element().map_err(damaged)?;
        rows.iter().map(|row| ([row.x, row.y, row.z], [GREY; 3])).unzip()
    };
    if points.is_empty() {
        return Err(invalid("holds no point, expected at least one".into()));
    }
    for (i, (point, color)) in points.iter().zip(&colors).enumerate() {
        if let Some(value) = point.iter().chain(color).find(|x| !x.is_finite()) {
            return Err(invalid(format!("point {i}: {value}, expected a finite number")));
        }
    }
    Ok(PointCloud {
        foreground: vec![true; points.len()],
        colors: colors.into_iter().map(|color| color.map(|c| c.clamp(0.0, 1.0))).collect(),
        points,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<PointCloud, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read_ply_points(file.path(), ReadLimits::default()).map_err(|error| {
            let message = error.to_string();
            message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
        })
    }

    fn header(format: &str, properties: &[&str]) -> String {
        let properties: String = properties.iter().map(|p| format!("property {p}\n")).collect();
        format!("ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 2\n{properties}end_header\n")
    }

    const PLACE: [&str; 3] = ["float x", "float y", "float z"];

    /// A file of two points: of each the numbers, in the order of the properties.
    fn points(format: &str, properties: &[(&str, &str)], rows: [&[f64]; 2]) -> Vec<u8> {
        let lines: Vec<String> = properties.iter().map(|(kind, name)| format!("{kind} {name}")).collect();
        let mut bytes = header(format, &lines.iter().map(String::as_str).collect::<Vec<_>>()).into_bytes();
        for row in rows {
            for ((kind, _), value) in properties.iter().zip(row) {
                let is_little = format == "binary_little_endian";
                match (format, *kind) {
                    ("ascii", _) => bytes.extend(format!("{value} ").bytes()),
                    (_, "double") if is_little => bytes.extend(value.to_le_bytes()),
                    (_, "double") => bytes.extend(value.to_be_bytes()),
                    (_, "float") if is_little => bytes.extend((*value as f32).to_le_bytes()),
                    (_, "float") => bytes.extend((*value as f32).to_be_bytes()),
                    _ => bytes.push(*value as u8),
                }
            }
            if format == "ascii" {
                bytes.push(b'\n');
            }
        }
        bytes
    }

    #[test]
    fn points_of_every_form_are_read_with_and_without_colours() {
        let further: [&[(&str, &str)]; 5] = [
            &[],
            &[("float", "nx"), ("float", "ny"), ("float", "nz")],
            &[("float", "intensity")],
            &[("uchar", "red"), ("uchar", "green"), ("uchar", "blue")],
            &[("float", "nx"), ("uchar", "red"), ("uchar", "green"), ("uchar", "blue"), ("double", "intensity")],
        ];
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            for kind in ["float", "double"] {
                for further in further {
                    let properties = [&[(kind, "x"), (kind, "y"), (kind, "z")], further].concat();
                    let value = |name: &str| match name {
                        "red" => 255.0,
                        "green" => 51.0,
                        "blue" => 0.0,
                        _ => 7.0,
                    };
                    let rest: Vec<f64> = further.iter().map(|(_, name)| value(name)).collect();
                    let rows = [[1.0, 2.5, -3.0], [-4.0, 0.0, 6.0]].map(|place| [&place[..], &rest].concat());
                    let cloud = read(&points(format, &properties, [&rows[0], &rows[1]])).unwrap();
                    assert_eq!(cloud.points, [[1.0, 2.5, -3.0], [-4.0, 0.0, 6.0]], "{format} {properties:?}");
                    let has_colors = further.iter().any(|(_, name)| *name == "red");
                    let expected = if has_colors { [1.0, 0.2, 0.0] } else { [0.5; 3] };
                    for (found, expected) in cloud.colors.as_flattened().iter().zip([expected; 2].as_flattened()) {
                        assert!((found - expected).abs() < 1e-6, "{format} {properties:?}: {:?}", cloud.colors);
                    }
                }
            }
        }
    }

    #[test]
    fn claims_of_headers_are_bounded() {
        let claimed =
            |count: &str| header("binary_little_endian", &PLACE).replace("vertex 2", &format!("vertex {count}"));
        let message = read(&[claimed("4000000000").as_bytes(), &[0; 100]].concat()).unwrap_err();
        assert_eq!(message, "ends early, expected a whole PLY file");
        let floods = [
            format!("ply\nformat ascii 1.0\n{}end_header\n", "comment flood\n".repeat(100_000)),
            format!("ply\n{}", " ".repeat(2_000_000)),
        ];
        for flood in floods {
            let message = read(flood.as_bytes()).unwrap_err();
            assert_eq!(message, "has a header of more than 1048576 bytes, expected a shorter one");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), header("ascii", &PLACE) + "1 2 3\n4 5 6\n").unwrap();
        let limits = ReadLimits { base_bytes: 90, expansion: 0, ..ReadLimits::default() };
        let message = read_ply_points(file.path(), limits).unwrap_err().to_string();
        assert!(message.ends_with(": needs 98 bytes of memory, limit is 90"), "{message}");
    }

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

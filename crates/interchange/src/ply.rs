//! One PLY file of 3D Gaussian splatting (Kerbl et al. 2023): one timestep.
//!
//! | property of `vertex` | here |
//! |---|---|
//! | `x`, `y`, `z` | `means` |
//! | `nx`, `ny`, `nz` | written as 0, not read |
//! | `f_dc_0` to `f_dc_2` | `colors`, as `(color - 0.5) / 0.28209…`: the coefficient of degree 0 |
//! | `f_rest_0` to `f_rest_44` | spherical harmonics of higher degree: not written; dropped or refused |
//! | `opacity` | `logit_opacities` |
//! | `scale_0` to `scale_2` | `log_scales` |
//! | `rot_0` to `rot_3` | `quats`, `w, x, y, z` |
//!
//! Writing and reading again keeps the bits of everything but colours. A colour changes by up to 3e-8, by the rounding
//! of its offset; a negative colour is read as zero, since renderers of such files clamp colours at zero.

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_ply::{DeserializeError, PlyReader, SerializeOptions};
use tcgs_core::{Attribute, BaseColumns, Gaussians};

use crate::InterchangeError;

/// Value of the spherical harmonic of degree 0: `1 / (2 √π)`.
const HARMONIC_0: f64 = 0.282_094_791_773_878_14;

/// How [`read_ply`] treats view-dependent colours (spherical harmonics above degree 0), which the scene cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HigherHarmonics {
    /// A file with properties `f_rest_…` is refused with [`InterchangeError::HigherHarmonics`].
    Refuse,
    /// The properties `f_rest_…` are ignored: each Gaussian keeps its colour of degree 0.
    Drop,
}

/// One Gaussian; the fields in the order of the original's files.
#[derive(Serialize, Deserialize)]
struct Vertex {
    x: f32,
    y: f32,
    z: f32,
    #[serde(default)]
    nx: f32,
    #[serde(default)]
    ny: f32,
    #[serde(default)]
    nz: f32,
    f_dc_0: f32,
    f_dc_1: f32,
    f_dc_2: f32,
    opacity: f32,
    scale_0: f32,
    scale_1: f32,
    scale_2: f32,
    rot_0: f32,
    rot_1: f32,
    rot_2: f32,
    rot_3: f32,
}

/// Of [`Vertex`], what a file must have.
const REQUIRED: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
    "rot_3",
];

/// The elements of a file.
#[derive(Serialize)]
struct Elements {
    vertex: Vec<Vertex>,
}

/// Reads the Gaussians of one PLY file, in stored form: binary of either byte order, or ASCII. Unknown properties are
/// ignored.
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{HigherHarmonics, read_ply, write_ply_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.ply");
/// let gaussians = Gaussians::zeros(5);
/// write_ply_to(std::fs::File::create(&path)?, &gaussians)?;
/// assert_eq!(read_ply(&path, HigherHarmonics::Refuse)?, gaussians);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::Ply`] if the file is not a complete PLY
/// file, lacks a property, holds a number that is not finite, or has no Gaussian; [`InterchangeError::HigherHarmonics`]
/// if harmonics are present and refused.
pub fn read_ply(path: &Path, harmonics: HigherHarmonics) -> Result<Gaussians, InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    let invalid = |problem| InterchangeError::Ply { path: path.into(), problem };
    let damaged = |DeserializeError(error)| match error.kind() {
        ErrorKind::UnexpectedEof => invalid("ends early, expected a whole PLY file".into()),
        ErrorKind::InvalidData => invalid(format!("{error}, expected a PLY file of 3D Gaussians")),
        _ => failed(error),
    };
    let mut ply = PlyReader::from_reader(BufReader::new(File::open(path).map_err(failed)?)).map_err(damaged)?;
    let Some(element) = ply.current_element().filter(|element| element.name == "vertex") else {
        let found = ply.current_element().map_or("nothing", |element| &element.name);
        return Err(invalid(format!("holds {found} first, expected the element vertex")));
    };
    if let Some(missing) = REQUIRED.iter().find(|name| !element.has_property(name)) {
        return Err(invalid(format!("has no property {missing}, expected {}", REQUIRED.join(", "))));
    }
    let num_rest = element.properties.iter().filter(|property| property.name.starts_with("f_rest_")).count();
    if num_rest > 0 && harmonics == HigherHarmonics::Refuse {
        return Err(InterchangeError::HigherHarmonics { path: path.into(), num_rest });
    }
    let gaussians = from_vertices(&ply.next_element::<Vec<Vertex>>().map_err(damaged)?);
    if gaussians.num_gaussians() == 0 {
        return Err(invalid("holds no Gaussian, expected at least one".into()));
    }
    for attribute in Attribute::BASE {
        let values = gaussians.values(attribute);
        if let Some(i) = values.iter().position(|x| !x.is_finite()) {
            let (name, gaussian) = (attribute.name(), i / attribute.components());
            return Err(invalid(format!("{name} of Gaussian {gaussian}: {}, expected a finite number", values[i])));
        }
    }
    Ok(gaussians)
}

/// Writes the Gaussians of one timestep as a PLY file for viewers of 3D Gaussian splatting: binary little-endian, with
/// colours of degree 0. Equal Gaussians give equal bytes.
///
/// - `writer`: should be buffered
/// - `gaussians`: `[N]`, stored form
///
/// # Errors
/// The errors of `writer`.
pub fn write_ply_to(writer: impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let elements = Elements { vertex: to_vertices(gaussians) };
    serde_ply::to_writer(&elements, SerializeOptions::binary_le(), writer).map_err(|error| error.0)
}

fn from_vertices(vertices: &[Vertex]) -> Gaussians {
    let color = |dc: f32| match (0.5 + HARMONIC_0 * f64::from(dc)) as f32 {
        negative if negative < 0.0 => 0.0,
        color => color,
    };
    Gaussians::from(BaseColumns {
        means: vertices.iter().map(|v| [v.x, v.y, v.z]).collect(),
        quats: vertices.iter().map(|v| [v.rot_0, v.rot_1, v.rot_2, v.rot_3]).collect(),
        log_scales: vertices.iter().map(|v| [v.scale_0, v.scale_1, v.scale_2]).collect(),
        logit_opacities: vertices.iter().map(|v| v.opacity).collect(),
        colors: vertices.iter().map(|v| [v.f_dc_0, v.f_dc_1, v.f_dc_2].map(color)).collect(),
    })
}

fn to_vertices(gaussians: &Gaussians) -> Vec<Vertex> {
    let vertex = |i: usize| {
        let ([x, y, z], [rot_0, rot_1, rot_2, rot_3]) = (gaussians.means()[i], gaussians.quats()[i]);
        let [f_dc_0, f_dc_1, f_dc_2] = gaussians.colors()[i].map(|c| ((f64::from(c) - 0.5) / HARMONIC_0) as f32);
        let ([scale_0, scale_1, scale_2], opacity) = (gaussians.log_scales()[i], gaussians.logit_opacities()[i]);
        let (nx, ny, nz) = (0.0, 0.0, 0.0);
        Vertex {
            x,
            y,
            z,
            nx,
            ny,
            nz,
            f_dc_0,
            f_dc_1,
            f_dc_2,
            opacity,
            scale_0,
            scale_1,
            scale_2,
            rot_0,
            rot_1,
            rot_2,
            rot_3,
        }
    };
    (0..gaussians.num_gaussians()).map(vertex).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value of every property in the files of [`original`]: different for each.
    fn value(gaussian: usize, property: usize) -> f32 {
        0.37 + 0.1 * gaussian as f32 - 0.03 * property as f32
    }

    /// Names of the properties as the original writes them.
    fn names(num_rest: usize) -> Vec<String> {
        let numbered = |name: &str, count: usize| (0..count).map(|i| format!("{name}_{i}")).collect::<Vec<_>>();
        [
            ["x", "y", "z", "nx", "ny", "nz"].map(String::from).to_vec(),
            numbered("f_dc", 3),
            numbered("f_rest", num_rest),
            vec!["opacity".into()],
            numbered("scale", 3),
            numbered("rot", 4),
        ]
        .concat()
    }

    /// A file of three Gaussians as the original program writes it.
    fn original(format: &str, names: &[String], write: impl Fn(f32) -> Vec<u8>) -> Vec<u8> {
        let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let header = format!("ply\nformat {format} 1.0\nelement vertex 3\n{properties}end_header\n");
        let row = |gaussian: usize| -> Vec<u8> {
            let mut row: Vec<u8> = (0..names.len()).flat_map(|property| write(value(gaussian, property))).collect();
            if format == "ascii" {
                row.push(b'\n');
            }
            row
        };
        [header.into_bytes(), (0..3).flat_map(row).collect()].concat()
    }

    fn little_endian(names: &[String]) -> Vec<u8> {
        original("binary_little_endian", names, |x| x.to_le_bytes().to_vec())
    }

    fn read(bytes: &[u8], harmonics: HigherHarmonics) -> Result<Gaussians, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read_ply(file.path(), harmonics).map_err(|error| {
            let message = error.to_string();
            assert!(!message.contains('\n'), "{message}");
            message.strip_prefix(&format!("{}: ", file.path().display())).unwrap().to_owned()
        })
    }

    /// What the files of [`original`] mean.
    fn check(gaussians: &Gaussians, num_rest: usize) {
        assert_eq!(gaussians.num_gaussians(), 3);
        for i in 0..3 {
            let of = |property: usize| value(i, property);
            let color = |dc: f32| 0.5 + 0.282_094_8 * dc;
            let after = 9 + num_rest;
            assert_eq!(gaussians.means()[i], [of(0), of(1), of(2)]);
            for c in 0..3 {
                assert!((gaussians.colors()[i][c] - color(of(6 + c))).abs() < 1e-7);
            }
            assert_eq!(gaussians.logit_opacities()[i], of(after));
            assert_eq!(gaussians.log_scales()[i], [1, 2, 3].map(|c| of(after + c)));
            assert_eq!(gaussians.quats()[i], [4, 5, 6, 7].map(|c| of(after + c)));
        }
    }

    #[test]
    fn files_of_the_original_are_read_in_every_encoding() {
        for num_rest in [0, 9, 45] {
            let names = names(num_rest);
            let files = [
                little_endian(&names),
                original("binary_big_endian", &names, |x| x.to_be_bytes().to_vec()),
                original("ascii", &names, |x| format!("{x} ").into_bytes()),
            ];
            for file in files {
                check(&read(&file, HigherHarmonics::Drop).unwrap(), num_rest);
            }
        }
        let file = little_endian(&names(45));
        let refused = read(&file, HigherHarmonics::Refuse).unwrap_err();
        assert_eq!(
            refused,
            "has spherical harmonics above degree 0 (45 properties f_rest), expected colours of degree 0 alone"
        );
        check(&read(&little_endian(&names(0)), HigherHarmonics::Refuse).unwrap(), 0);
    }

    #[test]
    fn order_and_company_of_properties_do_not_matter() {
        let file = little_endian(&names(0));
        let text = String::from_utf8_lossy(&file[..file.windows(10).position(|w| w == b"end_header").unwrap()]);
        let header = text.replace("property float nx", "property uchar red\nproperty double half");
        let header = header.replace("property float ny\nproperty float nz\n", "").replace("vertex 3", "vertex 1");
        let mut bytes = (header + "element face 0\nproperty list uchar int vertex_indices\nend_header\n").into_bytes();
        for property in 0..17 {
            match property {
                3 => bytes.extend([[200].as_slice(), &0.5_f64.to_le_bytes()].concat()),
                4 | 5 => {}
                _ => bytes.extend(value(0, property).to_le_bytes()),
            }
        }
        let one = read(&bytes, HigherHarmonics::Refuse).unwrap();
        assert_eq!(one, read(&file, HigherHarmonics::Refuse).unwrap().select(&[0]));
    }

    #[test]
    fn gaussians_come_back_with_their_bits() {
        let mut gaussians = read(&little_endian(&names(0)), HigherHarmonics::Refuse).unwrap();
        gaussians.means_mut()[1] = [-0.0, f32::MIN_POSITIVE / 8.0, 1e30];
        gaussians.quats_mut()[2] = [-0.0, 3.0, -7e-20, 0.0];
        gaussians.colors_mut().copy_from_slice(&[[0.0, 1.0, 0.5], [1e-3, 0.1, 0.249_99], [2.0, 0.999_999, 1.0 / 3.0]]);
        let mut first = Vec::new();
        write_ply_to(&mut first, &gaussians).unwrap();
        let found = read(&first, HigherHarmonics::Refuse).unwrap();
        for attribute in Attribute::BASE {
            for (a, b) in gaussians.values(attribute).iter().zip(found.values(attribute)) {
                if attribute == Attribute::Color {
                    assert!((a - b).abs() <= 3e-8, "{a} {b}");
                } else {
                    assert_eq!(a.to_bits(), b.to_bits(), "{attribute:?}");
                }
            }
        }
        let header = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n";
        let properties: String = names(0).iter().map(|name| format!("property float {name}\n")).collect();
        let header = format!("{header}{properties}end_header\n");
        assert_eq!(first[..header.len()], *header.as_bytes(), "{}", String::from_utf8_lossy(&first[..300]));
        assert_eq!(first.len(), header.len() + 3 * 17 * 4);
    }

    #[test]
    fn colours_below_zero_are_black() {
        let mut gaussians = Gaussians::zeros(1);
        gaussians.colors_mut()[0] = [-0.3, 0.0, 1.7];
        let mut bytes = Vec::new();
        write_ply_to(&mut bytes, &gaussians).unwrap();
        let found = read(&bytes, HigherHarmonics::Refuse).unwrap().colors()[0];
        assert_eq!((found[0], found[1]), (0.0, 0.0));
        assert!((found[2] - 1.7).abs() < 1e-6);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let whole = little_endian(&names(0));
        let problem = |bytes: &[u8]| read(bytes, HigherHarmonics::Refuse).unwrap_err();
        let edited = |from: &str, to: &str| {
            let end = whole.windows(10).position(|w| w == b"end_header").unwrap();
            let header = String::from_utf8(whole[..end].to_vec()).unwrap();
            assert!(header.contains(from));
            problem(&[header.replacen(from, to, 1).as_bytes(), &whole[end..]].concat())
        };
        for name in REQUIRED {
            let message = edited(&format!("property float {name}\n"), "property float other\n");
            assert!(message.starts_with(&format!("has no property {name}, expected x, y, z")), "{message}");
        }
        assert_eq!(edited("vertex 3", "vertex 4"), "ends early, expected a whole PLY file");
        assert_eq!(edited("vertex 3", "vertex 18446744073709551615"), "ends early, expected a whole PLY file");
        assert_eq!(edited("vertex 3", "vertex 0"), "holds no Gaussian, expected at least one");
        assert_eq!(edited("element vertex", "element chunk"), "holds chunk first, expected the element vertex");
        let message = edited("property float x", "property list uchar float x");
        assert!(message.ends_with("expected a PLY file of 3D Gaussians"), "{message}");
        let message = problem(b"glTF\n");
        assert!(message.ends_with("expected a PLY file of 3D Gaussians"), "{message}");
        assert_eq!(problem(b"ply\n"), "ends early, expected a whole PLY file");
        let mut spoilt = whole.clone();
        let at = spoilt.len() - 4 * (17 + 8);
        spoilt[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(problem(&spoilt), "logit_opacities of Gaussian 1: NaN, expected a finite number");
        assert!(matches!(
            read_ply(Path::new("/nowhere.ply"), HigherHarmonics::Drop),
            Err(InterchangeError::Read { .. })
        ));
    }
}

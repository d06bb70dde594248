//! The data types of every tcgs crate: Gaussians, cameras, views, images and elementwise maths.
//!
//! What lives here: the data types that pass between crates, and maths on single elements (vectors, quaternions,
//! activations, spherical harmonics). The maths is generic over [`Real`]: one source is run in `f32` and differentiated
//! in `f64`.
//! Three small jobs live here, too: the order of numbered names, text made safe for a terminal, and reading files of
//! bounded size. What does not: formats of files, rendering, optimisation, compression.
//!
//! Conventions: camera space is x right, y down, z forward; pixel centres lie at +0.5; quaternions
//! are `w, x, y, z`; colours are display-referred sRGB in `[0, 1]`, blended as stored.

mod activation;
mod attribute;
mod between;
mod camera;
mod camera_path;
mod columns;
mod drawable;
mod dynamic;
mod extent;
mod file;
mod harmonics;
mod image;
mod layout;
mod lives;
mod median;
mod natural_key;
mod parallel;
mod printable;
mod quat;
mod reader;
mod real;
mod seen_colors;
mod subject;
mod tour;
mod trust;
mod vector;
mod view;

pub use activation::{Activated, ActivatedGrads, activate, activate_bwd, sigmoid, sigmoid_vjp};
pub use attribute::Attribute;
pub use between::{cameras_around, cameras_between};
pub use camera::{Camera, CameraError, MAX_COORDINATE, MAX_INTRINSIC, MAX_PIXELS, MAX_SIDE, Pinhole};
pub use camera_path::{CameraKeyframe, CameraPath, CameraPathError};
pub use columns::{BaseColumns, BaseViewsMut, Columns, GaussianGrads, Gaussians, PointCloud, Sensitivity, role};
pub use drawable::Drawable;
pub use dynamic::DynamicGaussians;
pub use extent::Extent;
pub use file::{open_file, read_file, read_text};
pub use harmonics::{HARMONIC_0, MAX_SH_DEGREE, color_in_direction, color_in_direction_vjp, harmonics, harmonics_vjp};
pub use image::Image;
pub use layout::{Activation, Column, Layout, RateGroup};
pub use lives::{Life, Lives};
pub use median::upper_median;
pub use natural_key::natural_key;
pub use printable::printable;
pub use quat::{
    quat_conjugate, quat_mul, quat_mul_vjp, rotmat_from_quat, rotmat_from_quat_vjp, rotmat_from_unit_quat,
    rotmat_from_unit_quat_vjp, rotmat_from_vector,
};
pub use reader::SceneReader;
pub use real::Real;
pub use seen_colors::{seen_colors, seen_colors_bwd};
pub use subject::{Subject, add_motion};
pub use tour::{Tour, upright_axes};
pub use trust::Trust;
pub use vector::{
    add_scaled, cross, distance, dot, length, mean_vector, normalize, normalize_vjp, squared_distance, sub,
};
pub use view::{Segmentation, View};

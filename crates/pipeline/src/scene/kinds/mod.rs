//! The kinds of scenes: a file for each, with its recognition, its opening and its answers ([`SceneContent`]). What
//! does not live here: the choice of a kind (`open`).
//!
//! A new kind is a file with a [`SceneKind`], and a line in [`KINDS`].
//!
//! [`SceneContent`]: super::content::SceneContent
//! [`SceneKind`]: super::open::SceneKind
//! [`KINDS`]: super::open::KINDS

pub(super) mod chapters;
pub(super) mod compressed;
pub(super) mod floats;
mod found;
pub(super) mod fourdgs;
pub(super) mod params;
pub(super) mod run;
pub(super) mod timestep_files;

pub(super) use run::RunContent;

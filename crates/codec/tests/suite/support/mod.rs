//! Made scenes.

pub mod any_scene;
pub mod cohort_scenes;
pub mod corner_scenes;
pub mod scenes;

//! Which Gaussians the training cameras see, or cameras around them.
//!
//! Training removes Gaussians that the colour loss does not miss. Many of the others are hidden, or smaller than a
//! pixel. Each costs as much as any other. Together they matter little enough for refinement to make up for them.

use std::ops::Range;

use tcgs_core::{Camera, Gaussians, Image, Life, Lives, activate, cameras_around};
use tcgs_render::{CpuTiles, weights_step};
use tcgs_train::are_in_images;

use super::kept::Kept;
use crate::PipelineError;

/// Timesteps at which is looked, at most.
const NUM_TIMESTEPS: usize = 30;
/// Pictures from around the cameras, of all timesteps together. Refinement cannot bring back Gaussians that only these
/// pictures show.
const NUM_AROUND: usize = 48;

/// How much is seen of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// The largest number of pixels that it makes up at a timestep, in images and pictures from around, as a share of
    /// those of all images.
    pub share: f32,
    /// First timestep from which its share stays below the least, so that it need not live. [`Life::NEVER`] if no
    /// training camera ever sees it, since there are few pictures from around.
    pub until: u32,
    /// Whether its centre is in an image, hidden or not. If it never is, the images do not tell whether it is needed.
    pub is_in_images: bool,
}

/// Looks at timesteps spread evenly, of which the first is one. At each those are drawn that live then; those born
/// before the next look are looked at as they are born, among the others.
///
/// - `kept`: of at least one timestep
/// - `lives`: `[N]`
/// - `cameras`: of the images; at least one
/// - `least`: share below which a Gaussian is not seen
/// - returns: `[N]`
///
/// # Errors
/// [`PipelineError`] if a timestep cannot be read.
pub fn seen(kept: &Kept, lives: &Lives, cameras: &[Camera], least: f32) -> Result<Vec<Seen>, PipelineError> {
    let cameras: Vec<Camera> = cameras.iter().map(|camera| camera.downscaled(weights_step(camera))).collect();
    let num_pixels: usize = cameras.iter().map(|camera| camera.width * camera.height).sum();
    let num_timesteps = kept.num_timesteps();
    let stride = num_timesteps.div_ceil(NUM_TIMESTEPS);
    let num_around = NUM_AROUND.div_ceil(num_timesteps.div_ceil(stride));
    let mut seen = vec![Seen::default(); kept.num_gaussians()];
    let mut is_seen_in_images = vec![false; seen.len()];
    for timestep in (0..num_timesteps).step_by(stride) {
        // It is not known when between two looks it vanished.
        let until = (timestep + stride).min(num_timesteps);
        let turn = num_around * (timestep / stride);
        let around = cameras_around(&cameras, turn..turn + num_around);
        let gaussians = kept.at(timestep)?;
        let rows_of = |births: Range<usize>| {
            let is_due =
                |&row: &usize| births.contains(&(lives[row].birth as usize)) && lives[row].death as usize > timestep;
            (0..lives.len()).filter(is_due).collect::<Vec<usize>>()
        };
        let (mut rows, newborn) = (rows_of(0..timestep + 1), rows_of(timestep + 1..until));
        let weights_of = |rows: &[usize]| {
            let gaussians = gaussians.select(rows);
            [&cameras, &around].map(|cameras| weights_of(&gaussians, cameras))
        };
        let mut weights = weights_of(&rows);
        if !newborn.is_empty() {
            rows.extend(newborn);
            let with_newborn = weights_of(&rows);
            for (weights, more) in weights.iter_mut().zip(with_newborn) {
                weights.extend_from_slice(&more[weights.len()..]);
            }
        }
        let are_in = are_in_images(gaussians.select(&rows).means(), &cameras);
        let [in_images, around] = weights;
        for (i, row) in rows.into_iter().enumerate() {
            let [share, with_around] = [in_images[i], in_images[i] + around[i]].map(|sum| sum / num_pixels as f32);
            let seen = &mut seen[row];
            seen.is_in_images |= are_in[i];
            seen.share = seen.share.max(with_around);
            if with_around >= least {
                seen.until = until as u32;
            }
            is_seen_in_images[row] |= share >= least;
        }
    }
    let hidden = seen.iter_mut().zip(is_seen_in_images).filter(|(_, is_seen)| !is_seen);
    hidden.for_each(|(seen, _)| seen.until = Life::NEVER);
    Ok(seen)
}

/// Blending weights of Gaussians, `[N]` pixels, summed over the images of all cameras.
fn weights_of(gaussians: &Gaussians, cameras: &[Camera]) -> Vec<f32> {
    let drawn = activate(gaussians);
    let mut weights = vec![0.0_f32; gaussians.num_gaussians()];
    for camera in cameras {
        let ones = Image::filled(camera.width, camera.height, 1, 1.0);
        let of_view = CpuTiles::new(&drawn, camera).weights(&ones);
        weights.iter_mut().zip(of_view).for_each(|(sum, weight)| *sum += weight);
    }
    weights
}

#[cfg(test)]
mod tests {
    use tcgs_core::{BaseColumns, DynamicGaussians};

    use super::*;

    #[test]
    fn the_dead_hide_nobody_and_who_lives_between_two_looks_is_seen() {
        // One that fills the view, one behind it, and one before them.
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.0, -1.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            log_scales: vec![[2.0, 2.0, -5.0], [-1.5, -1.5, -5.0], [-2.0; 3]],
            logit_opacities: vec![20.0; 3],
            colors: vec![[0.5; 3]; 3],
        });
        let mut scene = DynamicGaussians::default();
        (0..60).for_each(|_| scene.push(gaussians.clone()));
        let kept = Kept::InMemory(scene);
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let look = |lives: [(u32, u32); 3]| {
            let lives = lives.map(|(birth, death)| Life { birth, death }).into();
            seen(&kept, &lives, std::slice::from_ref(&camera), 1e-3).unwrap()
        };
        let hidden = look([(0, 60), (0, 60), (0, 60)]);
        assert!(hidden.iter().all(|seen| seen.is_in_images), "{hidden:?}");
        assert!(hidden[0].share > 0.01 && hidden[1].share < 1e-3 && hidden[1].until == Life::NEVER, "{hidden:?}");
        // The first dies at the last look, and the third is born after it.
        let found = look([(0, 58), (0, 60), (59, 60)]);
        assert_eq!(found.iter().map(|seen| seen.until).collect::<Vec<_>>(), [58, 60, 60]);
        assert!(found.iter().all(|seen| seen.share > 1e-3), "{found:?}");
        // Nor does one that is not born yet.
        let found = look([(31, 60), (0, 60), (0, 60)]);
        assert_eq!((found[0].until, found[1].until), (60, 32));
    }
}

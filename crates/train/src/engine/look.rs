//! Drawing for the gate's look: blending weights, depths, and the pixels that show some Gaussians.

use std::fmt::Debug;
use std::sync::Arc;

use tcgs_core::{Activated, Camera, Image};
use tcgs_render::TileMask;

use crate::TrainError;

/// Draws for the gate's look. Implementations agree but for rounding. All views of a look share their Gaussians: a
/// device loads them once.
pub trait LookRenderer: Debug + Send + Sync {
    /// Blending weights of all Gaussians, summed over the pixels of an image.
    ///
    /// - `gaussians`: `[N]`; their colours do not matter
    /// - `shares`: `[2, H, W]` of the camera's size, each pixel's weight in each of the two sums
    /// - `with_depths`: whether depths are wanted
    /// - returns: `[N]` the two sums, in pixels; and `[2, H, W]` the depths of the Gaussians' centres times blending
    ///   weights, scene units, and these weights, each summed over a pixel's Gaussians. Empty without depths
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the GPU failed.
    fn weights(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        shares: &Image,
        with_depths: bool,
    ) -> Result<(Vec<[f32; 2]>, Image), TrainError>;

    /// The picture of Gaussians of one channel.
    ///
    /// - `tiles`: those that are needed; elsewhere the picture may be 0
    /// - returns: `[1, H, W]`
    ///
    /// # Errors
    /// As for [`Self::weights`].
    fn picture(&self, gaussians: &Arc<Activated>, camera: &Camera, tiles: &TileMask) -> Result<Image, TrainError>;
}

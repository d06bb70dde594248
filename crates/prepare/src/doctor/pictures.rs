//! Pictures of one camera for a person: its image with the points that fall on it, the points as seen from the camera,
//! and the image with the mask's background dimmed.

use tcgs_core::{Image, Pinhole, View};

use super::sheet::dot;
use super::splat::Splats;

/// Pixels from one dot to the next along both axes, and along a side of a dot.
const DOTS: [usize; 2] = [10, 2];
/// Brightness of a mask's background, share of the image's.
const DIMMED: f32 = 0.2;

/// Pictures of one camera, all of the same size.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CameraPictures {
    /// `[3, H, W]`, the image with a dot for some of the points that fall on it: foreground orange, background cyan.
    pub image: Image,
    /// `[3, H, W]`, the points as seen from the camera; black where there are none.
    pub points: Image,
    /// `[3, H, W]`, the image with a dark background, if the camera has a mask.
    pub mask: Option<Image>,
}

pub(super) fn draw(view: &View, splats: &Splats) -> CameraPictures {
    let drawing = splats.draw(&Pinhole::new(&view.camera));
    let (width, height) = (view.image.width, view.image.height);
    let mut pictures = CameraPictures {
        image: view.image.clone(),
        points: Image::filled(width, height, 3, 0.0),
        mask: view.segmentation.as_ref().map(|_| view.image.clone()),
    };
    for pixel in 0..width * height {
        let dot = dot(&drawing, pixel, DOTS);
        let is_dimmed = view.segmentation.as_ref().is_some_and(|mask| !mask.foreground[pixel]);
        for channel in 0..3 {
            if let Some(color) = dot {
                pictures.image.plane_mut(channel)[pixel] = color[channel];
            }
            pictures.points.plane_mut(channel)[pixel] = drawing.colors[pixel][channel];
            if let Some(mask) = pictures.mask.as_mut().filter(|_| is_dimmed) {
                mask.plane_mut(channel)[pixel] *= DIMMED;
            }
        }
    }
    pictures
}

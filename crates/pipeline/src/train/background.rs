//! The colour behind all Gaussians: that of the surroundings, which images show at their borders.

use tcgs_core::{View, upper_median};

/// Median colour of the outermost pixels of all images, sRGB of 255. Black without images.
pub fn border_color(views: &[View]) -> [u8; 3] {
    std::array::from_fn(|channel| {
        let borders = views.iter().flat_map(|view| {
            let (width, height) = (view.image.width, view.image.height);
            let is_border = move |i: &usize| {
                let (x, y) = (i % width, i / width);
                x == 0 || y == 0 || x + 1 == width || y + 1 == height
            };
            let plane = view.image.plane(channel);
            (0..plane.len()).filter(is_border).map(|i| plane[i])
        });
        upper_median(borders).map_or(0, |value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8)
    })
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Camera, Image};

    use super::*;

    #[test]
    fn the_inside_of_an_image_does_not_count() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 8, 6);
        let image = Image::filled(8, 6, 3, 0.8);
        let mut view = View { camera, image, segmentation: None, frame: 0, camera_id: 0 };
        for y in 0..6 {
            for x in 0..8 {
                if x % 7 == 0 || y % 5 == 0 {
                    for (channel, value) in [0.2, 0.4, 1.2].into_iter().enumerate() {
                        view.image.data[(channel * 6 + y) * 8 + x] = value;
                    }
                }
            }
        }
        assert_eq!(border_color(std::slice::from_ref(&view)), [51, 102, 255]);
        // Most of the borders decide.
        let other = View { image: Image::filled(8, 6, 3, 0.0), ..view.clone() };
        assert_eq!(border_color(&[view.clone(), other, view]), [51, 102, 255]);
        assert_eq!(border_color(&[]), [0; 3]);
    }
}

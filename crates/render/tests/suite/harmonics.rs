//! Colours that depend on the direction of view, from a timestep to pixels.

use std::f64::consts::PI;

use crate::support::Random;
use tcgs_core::{Camera, Drawable, Gaussians, Layout};
use tcgs_render::{CpuRasterizer, Draw, RenderSettings};

fn camera(position: [f64; 3]) -> Camera {
    Camera::look_at(position, [0.0; 3], [0.0, -1.0, 0.0], 40.0, 33, 25)
}

/// The colour of the only Gaussian of a picture, from the pixel in its middle: the background is black.
fn color<D: Draw>(renderer: &D, scene: &Drawable, camera: &Camera) -> [f64; 3] {
    let (output, _) = renderer.draw(&scene.seen_by(camera), camera, &RenderSettings::default()).unwrap();
    let middle = camera.height / 2 * camera.width + camera.width / 2;
    let opacity = 1.0 - f64::from(output.transmittance[middle]);
    assert!(opacity > 0.4, "{opacity}");
    [0, 1, 2].map(|channel| f64::from(output.image.plane(channel)[middle]) / opacity)
}

/// A Gaussian at the origin, half opaque, with harmonics of degree 1 along z and x.
fn one() -> Gaussians {
    let mut one = Gaussians::zeros_of(&Layout::with_harmonics(1), 1);
    one.quats_mut()[0] = [1.0, 0.0, 0.0, 0.0];
    one.colors_mut()[0] = [0.5, 0.4, 0.3];
    let sh1 = one.layout().find("sh1").unwrap();
    let rows = one.values_mut(sh1).as_chunks_mut::<3>().0;
    rows[1] = [0.6, 0.0, -0.9]; // √(3/4π) z
    rows[2] = [0.0, 0.2, 0.0]; // -√(3/4π) x
    one
}

fn seen_from_four_sides<D: Draw>(renderer: &D) {
    let scene = Drawable::new(&one());
    let y = (3.0 / (4.0 * PI)).sqrt();
    // The direction is from the camera to the Gaussian.
    for (position, expected) in [
        ([0.0, 0.0, -5.0], [0.5 + 0.6 * y, 0.4, 0.0]), // 0.3 - 0.9 y is below 0
        ([0.0, 0.0, 5.0], [0.5 - 0.6 * y, 0.4, 0.3 + 0.9 * y]),
        ([-5.0, 0.0, 0.0], [0.5, 0.4 - 0.2 * y, 0.3]),
        ([5.0, 0.0, 0.0], [0.5, 0.4 + 0.2 * y, 0.3]),
    ] {
        let found = color(renderer, &scene, &camera(position));
        assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5), "{position:?}: {found:?} against {expected:?}");
    }
}

#[test]
fn a_gaussian_has_another_colour_from_each_side() {
    seen_from_four_sides(&CpuRasterizer);
}

#[cfg(feature = "gpu")]
#[test]
fn the_gpu_draws_the_colours_of_each_camera() {
    let Some(gpu) = crate::support::gpu() else { return };
    // One renderer for all pictures, so that state kept from an earlier camera would show.
    seen_from_four_sides(&tcgs_render::gpu::GpuRasterizer::new(&gpu));
}

#[test]
fn harmonics_of_zero_change_no_bit() {
    let mut random = Random(5);
    let mut plain = Gaussians::zeros(200);
    for i in 0..200 {
        plain.means_mut()[i] = [0; 3].map(|_| random.range(-1.0, 1.0));
        plain.quats_mut()[i] = [0; 4].map(|_| random.range(-1.0, 1.0));
        plain.log_scales_mut()[i] = [0; 3].map(|_| random.range(-3.0, -1.0));
        plain.colors_mut()[i] = [0; 3].map(|_| random.range(0.0, 1.2));
    }
    let picture = |gaussians: &Gaussians| {
        let camera = camera([0.4, -0.3, -4.0]);
        let seen = Drawable::new(gaussians).seen_by(&camera);
        CpuRasterizer.draw(&seen, &camera, &RenderSettings::default()).unwrap().0
    };
    let expected = picture(&plain);
    let mut with = plain.extended(&Layout::with_harmonics(3));
    assert_eq!(picture(&with), expected);
    for band in with.layout().harmonics() {
        with.values_mut(band)[40] = 0.5;
        assert_ne!(picture(&with), expected);
        with.values_mut(band)[40] = 0.0;
    }
}

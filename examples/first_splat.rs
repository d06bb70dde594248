//! Three Gaussians, one camera, one picture, and the gradient of a pixel.
//!
//! `cargo run --release --example first_splat` writes `first_splat.png`.

use tcgs::core::{BaseColumns, Camera, Gaussians, Image, activate, activate_bwd};
use tcgs::render::{CpuRasterizer, Rasterizer, RenderSettings};

fn main() -> anyhow::Result<()> {
    // As stored: logarithms of the standard deviations, the opacities before the logistic function.
    let scene = Gaussians::from(BaseColumns {
        means: vec![[-0.5, 0.1, 0.0], [0.5, 0.0, 0.2], [0.0, -0.4, -0.2]],
        quats: vec![[1.0, 0.0, 0.0, 0.0], [0.9, 0.0, 0.0, 0.4], [1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[-1.5, -1.5, -1.5], [-1.0, -2.0, -2.0], [-2.0, -1.2, -2.0]],
        logit_opacities: vec![3.0, 3.0, 1.0],
        colors: vec![[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.95, 0.8, 0.3]],
    });
    // Axes: x right, y down, z forward. Up is negative y.
    let camera = Camera::look_at([0.0, 0.0, -2.5], [0.0; 3], [0.0, -1.0, 0.0], 500.0, 640, 480);

    let activated = activate(&scene);
    let settings = RenderSettings::default();
    let rasterizer = CpuRasterizer;
    let (output, saved) = rasterizer.forward(&activated, &camera, &settings)?;
    image::save_buffer("first_splat.png", &output.image.to_rgb8(), 640, 480, image::ColorType::Rgb8)?;

    // How the red of the middle pixel depends on everything stored.
    let mut v_image = Image::filled(640, 480, 3, 0.0);
    v_image.plane_mut(0)[240 * 640 + 320] = 1.0;
    let grads = rasterizer.backward(&activated, &camera, &settings, &saved, &v_image)?;
    // By convention `v_x` is the gradient of the result with respect to `x`.
    let v_scene = activate_bwd(&scene, &activated, &grads.activated);
    println!("first_splat.png; moving each centre changes the red of the middle pixel by {:.3?}", v_scene.means());
    Ok(())
}

//! The renderer in its simplest form: f64, no tiles, no tricks. Shares `settings` with the renderers it judges.

use tcgs_core::{Activated, Camera};
use tcgs_render::settings::*;

/// Every scalar of a scene: means, quats, scales, opacities, colors, one Gaussian after another.
#[derive(Clone)]
pub struct Scene {
    pub values: Vec<Vec<f64>>,
    pub num_channels: usize,
    pub is_antialiased: bool,
}

pub const MEAN: usize = 0;
pub const QUAT: usize = 3;
pub const SCALE: usize = 7;
pub const OPACITY: usize = 10;
pub const COLOR: usize = 11;

impl Scene {
    pub fn new(gaussians: &Activated) -> Self {
        let c = gaussians.num_channels;
        let values = (0..gaussians.means.len())
            .map(|i| {
                let mut v: Vec<f64> = gaussians.means[i].iter().map(|&x| f64::from(x)).collect();
                v.extend(gaussians.quats[i].iter().map(|&x| f64::from(x)));
                v.extend(gaussians.scales[i].iter().map(|&x| f64::from(x)));
                v.push(f64::from(gaussians.opacities[i]));
                v.extend(gaussians.colors[i * c..(i + 1) * c].iter().map(|&x| f64::from(x)));
                v
            })
            .collect();
        Self { values, num_channels: c, is_antialiased: gaussians.is_antialiased }
    }
}

/// A picture: the colour of each pixel, and the Gaussians that it blended (in order).
pub struct Render {
    /// `[C, H, W]`
    pub image: Vec<f64>,
    /// `[H, W]`
    pub contributors: Vec<Vec<usize>>,
}

type M3 = [[f64; 3]; 3];

fn mul(a: &M3, b: &M3) -> M3 {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transpose(a: &M3) -> M3 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

fn rotation(q: &[f64]) -> M3 {
    let (w, x, y, z) = (q[0], q[1], q[2], q[3]);
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// A Gaussian as a camera sees it.
struct Splat {
    index: usize,
    mean2d: [f64; 2],
    conic: [f64; 3],
    depth: f64,
    opacity: f64,
}

/// The splats of all Gaussians that are not culled, by depth.
fn splats(scene: &Scene, camera: &Camera) -> Vec<Splat> {
    let m = &camera.camera_from_world;
    let w: M3 = std::array::from_fn(|i| std::array::from_fn(|j| m[i][j]));
    let size = [camera.width as f64, camera.height as f64];
    let mut out = Vec::new();
    for (index, v) in scene.values.iter().enumerate() {
        let p: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| m[i][j] * v[MEAN + j]).sum::<f64>() + m[i][3]);
        if p[2] <= NEAR {
            continue;
        }
        let mut jacobian = [[0.0; 3]; 3];
        for i in 0..2 {
            let (f, c) = (camera.focal[i], camera.principal[i]);
            let margin = FOV_MARGIN * size[i] / (2.0 * f);
            let slope = (p[i] / p[2]).clamp(-c / f - margin, (size[i] - c) / f + margin);
            jacobian[i][i] = f / p[2];
            jacobian[i][2] = -f * slope / p[2];
        }
        let r = rotation(&v[QUAT..]);
        let s: M3 = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { v[SCALE + i] } else { 0.0 }));
        let rs = mul(&r, &s);
        let covariance = mul(&rs, &transpose(&rs));
        let t = mul(&jacobian, &w);
        let c2 = mul(&mul(&t, &covariance), &transpose(&t));
        let (xx, xy, yy) = (c2[0][0] + BLUR_VARIANCE, c2[0][1], c2[1][1] + BLUR_VARIANCE);
        let determinant = xx * yy - xy * xy;
        let mean2d = std::array::from_fn(|i| camera.focal[i] * p[i] / p[2] + camera.principal[i]);
        let conic = [yy / determinant, -xy / determinant, xx / determinant];
        let before = c2[0][0] * c2[1][1] - c2[0][1] * c2[0][1];
        let opacity = v[OPACITY] * if scene.is_antialiased { (before / determinant).sqrt() } else { 1.0 };
        out.push(Splat { index, mean2d, conic, depth: p[2], opacity });
    }
    out.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    out
}

pub fn render(scene: &Scene, camera: &Camera, background: &[f32]) -> Render {
    let splats = splats(scene, camera);
    let num_pixels = camera.width * camera.height;
    let mut image = vec![0.0; scene.num_channels * num_pixels];
    let mut contributors = vec![Vec::new(); num_pixels];
    for pixel in 0..num_pixels {
        let center = [(pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5];
        let mut transmittance = 1.0;
        for Splat { index, mean2d, conic, opacity, .. } in &splats {
            let (dx, dy) = (center[0] - mean2d[0], center[1] - mean2d[1]);
            let exponent = 0.5 * (conic[0] * dx * dx + conic[2] * dy * dy) + conic[1] * dx * dy;
            let v = &scene.values[*index];
            let alpha = (opacity * (-exponent).exp()).min(MAX_ALPHA);
            if alpha < MIN_ALPHA {
                continue;
            }
            if transmittance * (1.0 - alpha) < MIN_TRANSMITTANCE {
                break;
            }
            for channel in 0..scene.num_channels {
                image[channel * num_pixels + pixel] += alpha * transmittance * v[COLOR + channel];
            }
            transmittance *= 1.0 - alpha;
            contributors[pixel].push(*index);
        }
        for channel in 0..scene.num_channels {
            image[channel * num_pixels + pixel] += transmittance * f64::from(background[channel]);
        }
    }
    Render { image, contributors }
}

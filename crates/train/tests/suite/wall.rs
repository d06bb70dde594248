//! A synthetic scene whose Gaussians are known: a wall, and a ball before it.

use tcgs_core::BaseColumns;

/// Initial centre of the ball.
pub const CENTER: [f32; 3] = [-0.3, 0.0, -1.0];

/// A wall of `columns * rows` Gaussians with a pattern at depth 0.
pub fn wall([columns, rows]: [usize; 2]) -> BaseColumns {
    let mut wall = BaseColumns::default();
    let middle = [columns, rows].map(|n| (n as f32 - 1.0) / 2.0);
    for i in 0..columns * rows {
        let (x, y) = (i % columns, i / columns);
        let shade = 0.25 + 0.3 * ((x * 7 + y * 5) % 4) as f32 / 3.0;
        let mean = [(x as f32 - middle[0]) * 0.14, (y as f32 - middle[1]) * 0.14, 0.0];
        add(&mut wall, mean, 0.08, [shade, 0.9 * shade, 0.5]);
    }
    wall
}

/// Appends a ball, or rather a cube, of `side³` Gaussians.
pub fn add_ball(columns: &mut BaseColumns, center: [f32; 3], side: usize) {
    for i in 0..side.pow(3) {
        let at = [i % side, i / side % side, i / side.pow(2)].map(|k| (k as f32 - (side as f32 - 1.0) / 2.0) * 0.1);
        let mean = std::array::from_fn(|d| center[d] + at[d]);
        add(columns, mean, 0.06, [0.9, 0.15 + 0.2 * (i % 4) as f32, 0.1]);
    }
}

fn add(columns: &mut BaseColumns, mean: [f32; 3], scale: f32, color: [f32; 3]) {
    columns.means.push(mean);
    columns.quats.push([1.0, 0.0, 0.0, 0.0]);
    columns.log_scales.push([scale.ln(); 3]);
    columns.logit_opacities.push(2.5);
    columns.colors.push(color);
}

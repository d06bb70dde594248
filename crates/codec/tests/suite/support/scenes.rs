//! Synthetic scenes for tests and benches, the same on every machine.

#![allow(dead_code)] // Benches use a part.

use tcgs_codec::BitMap;
use tcgs_core::{Attribute, DynamicGaussians, Gaussians};

/// splitmix64 (Steele et al. 2014).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// In `[0, 1)`.
    pub fn uniform(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 24) as f32
    }

    /// Approximately normal, with mean 0 and variance 1.
    pub fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.uniform()).sum::<f32>() - 6.0
    }
}

/// A room of 6 m by 6 m by 3 m. One fifth of the Gaussians, on two spheres of half a metre, move along smooth paths and
/// turn; the rest stands still on the walls. Every timestep adds the noise of an optimisation: 1 mm, 0.003 in
/// quaternions, 0.004 in colours.
pub fn room(num_gaussians: usize, num_timesteps: usize) -> DynamicGaussians {
    let random = &mut Random(7);
    let mut base = Gaussians::zeros(num_gaussians);
    let num_moving = num_gaussians / 5;
    for i in 0..num_gaussians {
        let (u, v) = (random.uniform(), random.uniform());
        base.means_mut()[i] = if i < num_moving {
            let (z, angle) = (2.0 * u - 1.0, v * std::f32::consts::TAU);
            let r = 0.5 * (1.0 - z * z).sqrt();
            let center = if i % 2 == 0 { -1.0 } else { 1.0 };
            [center + r * angle.cos(), -1.0 + 0.5 * z, r * angle.sin()]
        } else {
            match i % 5 {
                0 => [6.0 * u - 3.0, 0.0, 6.0 * v - 3.0],
                1 => [6.0 * u - 3.0, -3.0 * v, -3.0],
                2 => [6.0 * u - 3.0, -3.0 * v, 3.0],
                3 => [-3.0, -3.0 * u, 6.0 * v - 3.0],
                _ => [3.0, -3.0 * u, 6.0 * v - 3.0],
            }
        };
        for x in &mut base.means_mut()[i] {
            *x += 0.01 * random.normal();
        }
        let p = base.means()[i];
        let texture = |phase: f32| 0.5 + 0.25 * (1.7 * p[0] + phase).sin() * (2.3 * p[1] + 1.9 * p[2] - phase).cos();
        base.colors_mut()[i] = [0.0, 0.6, 1.3].map(|phase| texture(phase) + 0.06 * random.normal());
        base.quats_mut()[i] = [1.0, 0.0, 0.0, 0.0].map(|x: f32| x + 0.25 * random.normal());
        base.log_scales_mut()[i] = [-3.8; 3].map(|x| x + 0.6 * random.normal());
        base.logit_opacities_mut()[i] = 1.5 + 2.0 * random.normal();
    }
    let mut scene = DynamicGaussians::default();
    for timestep in 0..num_timesteps {
        let mut now = base.clone();
        let secs = timestep as f32 / 30.0;
        for i in 0..num_gaussians {
            if i < num_moving {
                let side = if i % 2 == 0 { 1.0 } else { -1.0 };
                now.means_mut()[i][0] += 0.6 * (side * 2.0 * secs).sin();
                now.means_mut()[i][1] -= 1.5 * secs * (1.6 - secs);
                now.means_mut()[i][2] += 0.4 * side * secs;
                let (sin, cos) = (side * 0.75 * secs).sin_cos();
                now.quats_mut()[i] =
                    tcgs_core::quat_mul([cos, 0.0, sin, 0.0], tcgs_core::normalize(base.quats_mut()[i]));
            }
            now.means_mut()[i] = now.means_mut()[i].map(|x| x + 0.001 * random.normal());
            now.quats_mut()[i] = now.quats_mut()[i].map(|x| x + 0.003 * random.normal());
            now.colors_mut()[i] = now.colors_mut()[i].map(|x| x + 0.004 * random.normal());
        }
        scene.push(now);
    }
    scene
}

/// Random widths of 4 to 8 bits with mean 5.5.
pub fn mixed_widths(num_gaussians: usize) -> BitMap {
    let random = &mut Random(11);
    let mut map = BitMap::uniform(num_gaussians, 16, 4);
    for attribute in &Attribute::BASE[1..] {
        for width in &mut map.widths[attribute.index()] {
            *width = (5.5 + 1.1 * random.normal()).round().clamp(4.0, 8.0) as u8;
        }
    }
    map
}

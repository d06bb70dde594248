//! Textures: display-referred colours as functions of place. Muted for static surfaces, saturated for moving ones, with
//! no detail finer than about a tenth of a metre.

use std::f64::consts::PI;

type Rgb = [f64; 3];

/// Appearance of a body, in its own coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Texture {
    BeachBall,
    StripedCube,
    Spiral,
    Balloon,
    Cabinet,
    Plinth,
    Vase,
}

impl Texture {
    /// Strength of the lamp's reflection; 0 is matt.
    pub fn gloss(self) -> f64 {
        if self == Self::Vase { 0.6 } else { 0.0 }
    }

    /// Colour at a point of the surface.
    ///
    /// - `unit`: local position over half extents: on the unit sphere, or on the cube from -1 to 1
    pub fn color(self, unit: [f64; 3]) -> Rgb {
        let [x, y, z] = unit;
        match self {
            Self::BeachBall => {
                const WEDGES: [Rgb; 6] = [
                    [0.93, 0.16, 0.12],
                    [0.98, 0.93, 0.84],
                    [0.98, 0.72, 0.08],
                    [0.93, 0.16, 0.12],
                    [0.98, 0.93, 0.84],
                    [0.10, 0.36, 0.88],
                ];
                let turn = (z.atan2(x) / (2.0 * PI) * 6.0).rem_euclid(6.0);
                let (wedge, into) = (turn as usize % 6, turn.fract());
                let color = mix(WEDGES[wedge], WEDGES[(wedge + 1) % 6], smoothstep(0.85, 1.0, into));
                mix(color, [0.98, 0.93, 0.84], smoothstep(0.86, 0.93, y.abs()))
            }
            Self::StripedCube => {
                // Bands around the diagonal: every face shows them in another direction.
                let band = smoothstep(-0.25, 0.25, (PI * 1.15 * (x + y - z) + 0.6).sin());
                let (on, off) = if y.abs() >= x.abs().max(z.abs()) {
                    ([1.00, 0.55, 0.05], [0.86, 0.10, 0.42])
                } else {
                    ([0.98, 0.50, 0.08], [0.45, 0.08, 0.62])
                };
                mix(off, on, band)
            }
            Self::Spiral => {
                let band = smoothstep(-0.3, 0.3, (2.0 * z.atan2(x) + 3.6 * y).sin());
                mix([0.03, 0.62, 0.32], [0.72, 0.95, 0.18], band)
            }
            Self::Balloon => {
                let band = smoothstep(-0.4, 0.4, (3.0 * z.atan2(x)).sin());
                mix(mix([0.86, 0.10, 0.30], [0.98, 0.62, 0.70], band), [0.30, 0.02, 0.10], smoothstep(0.75, 0.95, y))
            }
            Self::Cabinet => {
                let grain = 0.5 + 0.5 * (5.0 * y + 1.5 * (2.0 * x).sin()).sin();
                mix([0.46, 0.33, 0.25], [0.60, 0.44, 0.33], grain)
            }
            Self::Plinth => mix([0.55, 0.56, 0.58], [0.70, 0.70, 0.70], 0.5 + 0.5 * (3.0 * x + 2.0 * y - z).sin()),
            Self::Vase => mix([0.34, 0.46, 0.56], [0.66, 0.72, 0.74], smoothstep(-0.5, 0.5, (4.5 * y + 0.5).sin())),
        }
    }
}

/// Colour of the room's inside.
///
/// - `axis`, `high`: the side: its normal axis, and whether it is at the axis's upper end
/// - `p`: position in the world
pub(super) fn room_color(axis: usize, high: bool, p: [f64; 3]) -> Rgb {
    let [x, y, z] = p;
    let cloud = value_noise([x / 0.75, y / 0.75, z / 0.75]) - 0.5;
    match (axis, high) {
        (1, true) => floor_color(x, z, cloud),
        (1, false) => shade([0.86, 0.85, 0.82], 1.0 + 0.10 * cloud),
        (2, true) => picture(x + 0.75, y + 1.62, wall([0.52, 0.61, 0.70], x, y, cloud), 0),
        (2, false) => wall([0.66, 0.60, 0.66], x, y, cloud),
        (_, false) => picture(z - 0.35, y + 1.6, wall([0.60, 0.67, 0.56], z, y, cloud), 1),
        (_, true) => picture(z - 0.25, y + 1.6, wall([0.76, 0.66, 0.53], z, y, cloud), 2),
    }
}

fn floor_color(x: f64, z: f64, cloud: f64) -> Rgb {
    let tile = smoothstep(-0.35, 0.35, (PI * x / 0.8).sin() * (PI * z / 0.8).sin());
    let wood = shade(mix([0.50, 0.39, 0.30], [0.66, 0.53, 0.40], tile), 1.0 + 0.25 * cloud);
    let radius = (x * x + (z - 0.2).powi(2)).sqrt();
    let ring = smoothstep(-0.5, 0.5, (2.0 * PI * radius / 0.62 + 0.4).cos());
    let rug = shade(mix([0.30, 0.42, 0.48], [0.74, 0.71, 0.64], ring), 1.0 + 0.15 * cloud);
    mix(rug, wood, smoothstep(1.45, 1.53, radius))
}

/// Wallpaper with broad stripes above a darker panel.
fn wall(base: Rgb, along: f64, y: f64, cloud: f64) -> Rgb {
    let stripe = 0.05 * smoothstep(-0.5, 0.5, (2.0 * PI * along / 0.7).sin());
    let panel = smoothstep(-0.86, -0.80, y);
    let rail = smoothstep(-0.98, -0.90, y) * (1.0 - panel);
    let papered = mix(shade(base, 0.97 + stripe + 0.22 * cloud), mix(base, [0.95, 0.93, 0.90], 0.5), rail);
    mix(papered, shade(base, 0.68 + 0.12 * cloud), panel)
}

/// A framed picture over a wall.
///
/// - `x`, `y`: metres from its middle
fn picture(x: f64, y: f64, wall: Rgb, which: usize) -> Rgb {
    const HALF: [f64; 2] = [0.62, 0.42];
    const FRAME: f64 = 0.09;
    let outside = (x.abs() - HALF[0]).max(y.abs() - HALF[1]);
    if outside > FRAME + 0.02 {
        return wall;
    }
    let (u, v) = (x / HALF[0], y / HALF[1]);
    let hill = 0.25 + 0.28 * (2.4 * u + which as f64).sin();
    let sky = mix([0.50, 0.70, 0.86], [0.93, 0.86, 0.72], smoothstep(-1.0, 0.5, v));
    let sun = 1.0 - smoothstep(0.22, 0.34, ((u - 0.45).powi(2) + (v + 0.35).powi(2) * 0.46).sqrt());
    let ground = [[0.36, 0.48, 0.34], [0.56, 0.40, 0.32], [0.33, 0.38, 0.54]][which];
    let scenery = mix(mix(sky, [0.99, 0.95, 0.80], sun), ground, smoothstep(hill - 0.06, hill + 0.06, v));
    let framed = mix(scenery, [0.27, 0.22, 0.19], smoothstep(-0.02, 0.02, outside));
    mix(framed, wall, smoothstep(FRAME - 0.02, FRAME + 0.02, outside))
}

fn mix(a: Rgb, b: Rgb, share_of_b: f64) -> Rgb {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * share_of_b)
}

fn shade(color: Rgb, factor: f64) -> Rgb {
    color.map(|c| c * factor)
}

/// 0 below `from`, 1 above `to`, smooth between.
pub(super) fn smoothstep(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Smooth noise in `[0, 1]` that varies over lengths of about 1.
fn value_noise(p: [f64; 3]) -> f64 {
    let cell = p.map(|x| x.floor() as i64);
    let [u, v, w]: [f64; 3] = std::array::from_fn(|i| smoothstep(0.0, 1.0, p[i] - cell[i] as f64));
    let corner = |dx: i64, dy: i64, dz: i64| {
        let key = ((cell[0] + dx) as u64) << 32 ^ ((cell[1] + dy) as u64) << 16 ^ (cell[2] + dz) as u64;
        (mix_bits(key) >> 11) as f64 / (1u64 << 53) as f64
    };
    let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let plane = |dz| lerp(lerp(corner(0, 0, dz), corner(1, 0, dz), u), lerp(corner(0, 1, dz), corner(1, 1, dz), u), v);
    lerp(plane(0), plane(1), w)
}

/// The finaliser of SplitMix64: well-mixed bits from a counter (Steele et al. 2014).
pub(super) fn mix_bits(counter: u64) -> u64 {
    let mut z = counter.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

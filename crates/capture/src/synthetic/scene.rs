//! The bodies in the room and their motion: shape, pose and texture at every timestep. Lengths are in metres, y points
//! down, the floor is y = 0.

use std::f64::consts::PI;

use super::{SYNTHETIC_FRAME_RATE, texture::Texture};

/// Corners of the room.
pub(super) const ROOM: [[f64; 3]; 2] = [[-2.7, -2.7, -2.6], [2.7, 0.0, 2.5]];

const BALL_RADIUS: f64 = 0.29;
const BALLOON_RADIUS: f64 = 0.24;
/// Timestep at which the balloon begins to come through the ceiling: a third of the clip of the default settings.
const BALLOON_ENTERS: f64 = 8.0;
/// Metres a second squared.
const GRAVITY: f64 = 9.8;
/// Seconds from bounce to bounce: 16 frames.
const BOUNCE_SECS: f64 = 16.0 / SYNTHETIC_FRAME_RATE;

/// A solid's outline around its own origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    Ellipsoid,
    Box,
}

/// A solid in the room.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub shape: Shape,
    /// Half extents along the local axes.
    pub half: [f64; 3],
    pub center: [f64; 3],
    /// `world_from_local`, row-major.
    pub rotation: [[f64; 3]; 3],
    pub texture: Texture,
    pub moving: bool,
}

impl Body {
    /// Whether a part of the body is below the ceiling; otherwise it has not entered yet.
    pub fn has_entered(&self) -> bool {
        self.center[1] + self.half[1] > ROOM[0][1]
    }

    /// Radius of the smallest enclosing sphere.
    pub fn reach(&self) -> f64 {
        let [x, y, z] = self.half;
        match self.shape {
            Shape::Ellipsoid => x.max(y).max(z),
            Shape::Box => (x * x + y * y + z * z).sqrt(),
        }
    }
}

/// The bodies at one timestep; the room is static.
#[derive(Clone, Debug)]
pub(super) struct SyntheticScene {
    pub bodies: Vec<Body>,
}

impl SyntheticScene {
    pub fn at(timestep: usize) -> Self {
        let upright = turn_y(0.0);
        let fixed =
            |shape, half, center, texture| Body { shape, half, center, rotation: upright, texture, moving: false };
        Self {
            bodies: vec![
                ball(timestep),
                cube(timestep),
                spinner(timestep),
                balloon(timestep),
                fixed(Shape::Box, [0.6, 0.42, 0.32], [-1.75, -0.42, 1.95], Texture::Cabinet),
                fixed(Shape::Box, [0.3, 0.3, 0.3], [1.85, -0.3, 1.8], Texture::Plinth),
                fixed(Shape::Ellipsoid, [0.27, 0.3, 0.27], [1.85, -0.9, 1.8], Texture::Vase),
            ],
        }
    }
}

/// Centre (world space) and radius, in metres, of the ball of the synthetic capture at a timestep.
///
/// The ball bounces across the room on parabolas, three of its diameters in 24 timesteps, and returns.
///
/// ```
/// let (start, radius) = tcgs_capture::ball_at(0);
/// let (end, _) = tcgs_capture::ball_at(23);
/// assert!((end[0] - start[0]).abs() > 3.0 * 2.0 * radius);
/// ```
pub fn ball_at(timestep: usize) -> ([f64; 3], f64) {
    let secs = timestep as f64 / SYNTHETIC_FRAME_RATE;
    // Starts near the top of a bounce, so that the clip shows two whole ones.
    let since_bounce = (secs + 0.4 * BOUNCE_SECS).rem_euclid(BOUNCE_SECS);
    let height = 0.5 * GRAVITY * since_bounce * (BOUNCE_SECS - since_bounce);
    // There and back, 23 frames each way.
    let way = (timestep as f64 / 23.0).rem_euclid(2.0);
    let along = if way < 1.0 { way } else { 2.0 - way };
    ([-1.05 + 2.1 * along, -BALL_RADIUS - height, -0.10 - 0.10 * along], BALL_RADIUS)
}

fn ball(timestep: usize) -> Body {
    let (center, radius) = ball_at(timestep);
    let spin = rotation([0.35, 0.25, 0.9], 0.06 * timestep as f64);
    Body {
        shape: Shape::Ellipsoid,
        half: [radius; 3],
        center,
        rotation: spin,
        texture: Texture::BeachBall,
        moving: true,
    }
}

/// A striped cube that slides on the floor behind the ball, turning.
fn cube(timestep: usize) -> Body {
    let phase = 2.0 * PI * timestep as f64 / 90.0;
    let center = [0.8 * (phase + 0.6).cos(), -0.29, 0.85 + 0.12 * (phase + 0.6).sin()];
    let rotation = turn_y(0.05 * timestep as f64 + 0.3);
    Body { shape: Shape::Box, half: [0.29; 3], center, rotation, texture: Texture::StripedCube, moving: true }
}

/// An ellipsoid that orbits above both, leaning outwards and bobbing.
fn spinner(timestep: usize) -> Body {
    let phase = 2.0 * PI * timestep as f64 / 75.0 - 0.9;
    let center = [0.55 * phase.cos(), -1.42 + 0.06 * (2.0 * phase).sin(), 0.3 + 0.4 * phase.sin()];
    let rotation = mul(turn_y(-phase), rotation([0.0, 0.0, 1.0], 0.5));
    Body { shape: Shape::Ellipsoid, half: [0.20, 0.37, 0.20], center, rotation, texture: Texture::Spiral, moving: true }
}

/// A balloon that comes down through the ceiling, where nothing was before, and sinks ever slower.
fn balloon(timestep: usize) -> Body {
    let since = (timestep as f64 - BALLOON_ENTERS).max(-1.0) / SYNTHETIC_FRAME_RATE;
    let height = ROOM[0][1] - BALLOON_RADIUS + 1.55 * (1.0 - (-5.0 * since).exp());
    let half = [BALLOON_RADIUS, 1.2 * BALLOON_RADIUS, BALLOON_RADIUS];
    let rotation = turn_y(0.03 * timestep as f64);
    Body {
        shape: Shape::Ellipsoid,
        half,
        center: [-1.0, height, 0.9],
        rotation,
        texture: Texture::Balloon,
        moving: true,
    }
}

fn turn_y(angle: f64) -> [[f64; 3]; 3] {
    rotation([0.0, 1.0, 0.0], angle)
}

fn rotation(axis: [f64; 3], angle: f64) -> [[f64; 3]; 3] {
    let [x, y, z] = tcgs_core::normalize(axis).map(|a| a * (angle / 2.0).sin());
    tcgs_core::rotmat_from_quat([(angle / 2.0).cos(), x, y, z])
}

fn mul(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

//! The point cloud that training starts from: samples of all surfaces at the first timestep.

use std::f64::consts::PI;

use tcgs_core::{PointCloud, length};

use super::{
    scene::{Body, ROOM, Shape, SyntheticScene},
    texture::mix_bits,
    trace::Hit,
};

/// Standard deviation of a point's distance from its surface, along each axis, metres.
const NOISE: f64 = 0.005;
/// One point in three lies on a moving body: they are small, and matter most.
const MOVING_SHARE: usize = 3;

/// Samples points uniformly by area over moving and over static surfaces, whether or not a camera sees them.
pub(super) fn sample(num_points: usize, seed: u64) -> PointCloud {
    let scene = SyntheticScene::at(0);
    let (moving, fixed): (Vec<usize>, Vec<usize>) = (0..scene.bodies.len())
        .filter(|&body| scene.bodies[body].has_entered())
        .partition(|&body| scene.bodies[body].moving);
    let surfaces = |bodies: &[usize]| -> Vec<(Option<usize>, f64)> {
        bodies.iter().map(|&body| (Some(body), area(&scene.bodies[body]))).collect()
    };
    let moving = surfaces(&moving);
    let mut fixed = surfaces(&fixed);
    fixed.push((None, box_area(room_half())));

    let mut random = Random { state: mix_bits(seed) };
    let mut cloud = PointCloud::default();
    for i in 0..num_points {
        let foreground = i % MOVING_SHARE == 0;
        let body = choose(if foreground { &moving } else { &fixed }, &mut random);
        let hit = match body {
            Some(index) => sample_body(index, &scene.bodies[index], &mut random),
            None => sample_room(&mut random),
        };
        let position = hit.position();
        cloud.points.push(std::array::from_fn(|axis| (position[axis] + NOISE * random.normal()) as f32));
        cloud.colors.push(scene.matt_color(&hit).map(|c| c as f32));
        cloud.foreground.push(foreground);
    }
    cloud
}

/// Chooses a random surface by area.
fn choose(surfaces: &[(Option<usize>, f64)], random: &mut Random) -> Option<usize> {
    let mut left = random.uniform() * surfaces.iter().map(|(_, area)| area).sum::<f64>();
    for &(body, area) in surfaces {
        if left < area {
            return body;
        }
        left -= area;
    }
    surfaces.last().and_then(|&(body, _)| body)
}

fn sample_body(index: usize, body: &Body, random: &mut Random) -> Hit {
    let (unit, unit_normal) = match body.shape {
        Shape::Box => sample_cube(body.half, random),
        Shape::Ellipsoid => {
            // Rejection sampling: the unit sphere's area stretches by at most `largest` on the way to the ellipsoid.
            let [a, b, c] = body.half;
            let largest = (b * c).max(a * c).max(a * b);
            let unit = loop {
                let unit: [f64; 3] = tcgs_core::normalize(std::array::from_fn(|_| random.normal()));
                let stretch = [unit[0] * b * c, unit[1] * a * c, unit[2] * a * b];
                if random.uniform() * largest <= length(stretch) {
                    break unit;
                }
            };
            (unit, unit)
        }
    };
    let local = std::array::from_fn(|i| unit[i] * body.half[i]);
    let position = std::array::from_fn(|i| body.center[i] + tcgs_core::dot(body.rotation[i], local));
    Hit::on(Some(index), position, body.world_normal(unit_normal))
}

fn sample_room(random: &mut Random) -> Hit {
    let half = room_half();
    let (unit, outward) = sample_cube(half, random);
    let position = std::array::from_fn(|i| (ROOM[0][i] + ROOM[1][i]) / 2.0 + unit[i] * half[i]);
    Hit::on(None, position, outward.map(|n| -n))
}

/// A point on the cube from -1 to 1, uniform by area once stretched by `half`, and its outward normal.
fn sample_cube(half: [f64; 3], random: &mut Random) -> ([f64; 3], [f64; 3]) {
    let sides: [(Option<usize>, f64); 3] =
        std::array::from_fn(|axis| (Some(axis), half[(axis + 1) % 3] * half[(axis + 2) % 3]));
    let axis = choose(&sides, random).unwrap_or_default();
    let mut unit: [f64; 3] = std::array::from_fn(|_| 2.0 * random.uniform() - 1.0);
    unit[axis] = unit[axis].signum();
    let mut normal = [0.0; 3];
    normal[axis] = unit[axis];
    (unit, normal)
}

fn room_half() -> [f64; 3] {
    std::array::from_fn(|i| (ROOM[1][i] - ROOM[0][i]) / 2.0)
}

fn area(body: &Body) -> f64 {
    let [a, b, c] = body.half;
    match body.shape {
        Shape::Box => box_area(body.half),
        Shape::Ellipsoid => {
            // Thomsen's approximation, within 1.1 %.
            const P: f64 = 1.6075;
            let mean = ((a * b).powf(P) + (a * c).powf(P) + (b * c).powf(P)) / 3.0;
            4.0 * PI * mean.powf(1.0 / P)
        }
    }
}

fn box_area([a, b, c]: [f64; 3]) -> f64 {
    8.0 * (a * b + b * c + c * a)
}

/// A small random generator of our own, so that the capture of a seed never changes.
struct Random {
    state: u64,
}

impl Random {
    /// In `[0, 1)`.
    fn uniform(&mut self) -> f64 {
        self.state = self.state.wrapping_add(1);
        (mix_bits(self.state) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller 1958).
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (2.0 * PI * self.uniform()).cos()
    }
}

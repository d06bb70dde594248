//! Rays: their intersection with the scene, and the light that comes back.

use tcgs_core::{add_scaled, dot, length, normalize, sub};

use super::{
    scene::{Body, ROOM, Shape, SyntheticScene},
    texture::{Texture, room_color, smoothstep},
};

/// A lamp under the ceiling, towards the cameras.
const LAMP: [f64; 3] = [0.5, -2.5, -0.9];
/// Darkening of the floor below a moving object that touches it. It is weak, because a mask calls the floor background,
/// and a background is expected to keep its colour.
const BLOB_SHADOW: f64 = 0.15;

/// Exponent of the lamp's reflections. Reflections are wide, so that the smallest images show them.
const SHININESS: i32 = 12;

/// Two points of a surface closer than this are one, metres.
const NEAR: f64 = 1e-3;

/// A point on a surface.
pub(super) struct Hit {
    /// `None` is the room.
    body: Option<usize>,
    position: [f64; 3],
    /// Unit normal out of the surface, towards the origins of rays.
    normal: [f64; 3],
}

impl Hit {
    pub fn is_moving(&self, scene: &SyntheticScene) -> bool {
        self.body.is_some_and(|body| scene.bodies[body].moving)
    }

    /// Whether its body had not entered in an earlier scene.
    pub fn has_arrived(&self, earlier: &SyntheticScene) -> bool {
        self.body.is_some_and(|body| !earlier.bodies[body].has_entered())
    }

    /// Texture of the hit body; none for the room.
    pub fn texture(&self, scene: &SyntheticScene) -> Option<Texture> {
        self.body.map(|body| scene.bodies[body].texture)
    }

    /// A known point of a surface; `body` is `None` for the room.
    pub fn on(body: Option<usize>, position: [f64; 3], normal: [f64; 3]) -> Self {
        Self { body, position, normal }
    }

    pub fn position(&self) -> [f64; 3] {
        self.position
    }
}

impl SyntheticScene {
    /// The first surface along a ray from inside the room.
    ///
    /// - `direction`: unit
    pub fn hit(&self, origin: [f64; 3], direction: [f64; 3]) -> Hit {
        let along = |distance: f64| add_scaled(origin, distance, direction);
        let (distance, normal) = hit_room(origin, direction);
        let mut nearest = (distance, Hit { body: None, position: along(distance), normal });
        for (index, body) in self.bodies.iter().enumerate() {
            if let Some((distance, normal)) = body.hit(origin, direction)
                && distance < nearest.0
            {
                nearest = (distance, Hit { body: Some(index), position: along(distance), normal });
            }
        }
        nearest.1
    }

    /// Whether a point of a surface is visible from a place in the room.
    pub fn sees(&self, from: [f64; 3], of: &Hit) -> bool {
        let way: [f64; 3] = std::array::from_fn(|i| of.position[i] - from[i]);
        let first = self.hit(from, normalize(way)).position;
        let short: [f64; 3] = std::array::from_fn(|i| of.position[i] - first[i]);
        dot(short, short) < NEAR * NEAR
    }

    /// Display-referred colour of a surface along a ray: the view-independent part, and on glossy surfaces the lamp's
    /// reflection (Blinn 1977).
    ///
    /// - `direction`: unit, towards the surface
    pub fn color_along(&self, direction: [f64; 3], hit: &Hit) -> [f64; 3] {
        let matt = self.matt_color(hit);
        let gloss = hit.texture(self).map_or(0.0, Texture::gloss);
        let to_lamp: [f64; 3] = normalize(std::array::from_fn(|i| LAMP[i] - hit.position[i]));
        let between: [f64; 3] = normalize(std::array::from_fn(|i| to_lamp[i] - direction[i]));
        let reflection = gloss * dot(hit.normal, between).max(0.0).powi(SHININESS);
        matt.map(|c| (c + reflection).min(1.0))
    }

    /// View-independent, display-referred colour of a surface, without reflections.
    pub fn matt_color(&self, hit: &Hit) -> [f64; 3] {
        let albedo = match hit.body {
            Some(body) => self.bodies[body].color(hit.position),
            None => {
                let axis = (0..3).find(|&i| hit.normal[i] != 0.0).unwrap_or(1);
                room_color(axis, hit.normal[axis] < 0.0, hit.position)
            }
        };
        let light = self.light(hit);
        // The square root is the display's curve, for light and albedo alike; albedo is given as displayed.
        albedo.map(|a| (a * light.sqrt()).clamp(0.0, 1.0))
    }

    fn light(&self, hit: &Hit) -> f64 {
        let to_lamp = sub(LAMP, hit.position);
        let distance = length(to_lamp);
        // Light wraps around edges a little, as from a large lamp.
        let facing = ((dot(hit.normal, to_lamp) / distance + 0.35) / 1.35).max(0.0);
        let lamp = 1.05 * facing / (0.75 + 0.055 * distance * distance);
        // Stronger from above than from below (y points down).
        let ambient = 0.36 - 0.10 * hit.normal[1];
        (lamp + ambient) * self.occlusion(hit)
    }

    /// Corners of the room, feet of bodies and the floor below moving bodies receive less light.
    fn occlusion(&self, hit: &Hit) -> f64 {
        let near = |distance: f64| 1.0 - 0.25 * (1.0 - (distance / 0.8).min(1.0)).powi(3);
        let p = hit.position;
        if hit.body.is_some() {
            return near(-p[1]);
        }
        let mut left = 1.0;
        for i in (0..3).filter(|&i| hit.normal[i] == 0.0) {
            left *= near(p[i] - ROOM[0][i]) * near(ROOM[1][i] - p[i]);
        }
        if hit.normal[1] < 0.0 {
            for body in self.bodies.iter().filter(|body| body.has_entered()) {
                let gap = -body.center[1] - body.half[1];
                let reach = 1.5 * body.half[0].max(body.half[2]) + 0.3 * gap;
                let distance = ((p[0] - body.center[0]).powi(2) + (p[2] - body.center[2]).powi(2)).sqrt();
                let strength = if body.moving { BLOB_SHADOW } else { 1.5 * BLOB_SHADOW };
                left *= 1.0 - strength * (1.0 - smoothstep(0.3 * reach, reach, distance)) / (1.0 + 1.5 * gap);
            }
        }
        left
    }
}

impl Body {
    /// Distance and outward normal of the first hit from outside.
    fn hit(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<(f64, [f64; 3])> {
        let to_center = sub(self.center, origin);
        let closest = dot(to_center, direction);
        if dot(to_center, to_center) - closest * closest > self.reach() * self.reach() {
            return None;
        }
        // In units of the half extents, where the body is the unit sphere or cube.
        let (o, d) = (self.unit_from_world(to_center.map(|x| -x)), self.unit_from_world(direction));
        let (distance, unit_normal) = match self.shape {
            Shape::Ellipsoid => {
                let (a, b, c) = (dot(d, d), dot(o, d), dot(o, o) - 1.0);
                let discriminant = b * b - a * c;
                if discriminant < 0.0 {
                    return None;
                }
                let distance = (-b - discriminant.sqrt()) / a;
                (distance, add_scaled(o, distance, d))
            }
            Shape::Box => {
                let (mut enter, mut leave, mut axis) = (f64::NEG_INFINITY, f64::INFINITY, 0);
                for i in 0..3 {
                    let (a, b) = ((-1.0 - o[i]) / d[i], (1.0 - o[i]) / d[i]);
                    if a.min(b) > enter {
                        (enter, axis) = (a.min(b), i);
                    }
                    leave = leave.min(a.max(b));
                }
                if enter > leave {
                    return None;
                }
                (enter, std::array::from_fn(|i| if i == axis { -d[i].signum() } else { 0.0 }))
            }
        };
        (distance > 0.0).then(|| (distance, self.world_normal(unit_normal)))
    }

    /// Colour before light, at a point of the surface.
    fn color(&self, position: [f64; 3]) -> [f64; 3] {
        self.texture.color(self.unit_from_world(sub(position, self.center)))
    }

    /// A vector in the world, in the body's axes and in units of its half extents.
    fn unit_from_world(&self, v: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|j| (0..3).map(|i| self.rotation[i][j] * v[i]).sum::<f64>() / self.half[j])
    }

    /// Unit normal in the world, from a normal in units of the half extents.
    pub fn world_normal(&self, unit_normal: [f64; 3]) -> [f64; 3] {
        let local = std::array::from_fn(|i| unit_normal[i] / self.half[i]);
        normalize(self.rotation.map(|row| dot(row, local)))
    }
}

impl SyntheticScene {
    /// Distance of a point from the nearest moving or static surface; approximate for ellipsoids.
    pub fn distance(&self, point: [f64; 3], moving: bool) -> f64 {
        let walls = (0..3).flat_map(|i| [(point[i] - ROOM[0][i]).abs(), (point[i] - ROOM[1][i]).abs()]);
        let wall = if moving { f64::INFINITY } else { walls.fold(f64::INFINITY, f64::min) };
        self.bodies.iter().filter(|body| body.moving == moving).map(|body| body.distance(point)).fold(wall, f64::min)
    }
}

impl Body {
    fn distance(&self, point: [f64; 3]) -> f64 {
        let unit = self.unit_from_world(sub(point, self.center));
        match self.shape {
            Shape::Ellipsoid => {
                let reach = length(unit);
                let slope: [f64; 3] = std::array::from_fn(|i| unit[i] / self.half[i]);
                (reach * (reach - 1.0) / length(slope)).abs()
            }
            Shape::Box => {
                let over: [f64; 3] = std::array::from_fn(|i| (unit[i].abs() - 1.0) * self.half[i]);
                let outside = over.map(|x| x.max(0.0));
                let inside = over.iter().cloned().fold(f64::NEG_INFINITY, f64::max).min(0.0);
                length(outside) - inside
            }
        }
    }
}

fn hit_room(origin: [f64; 3], direction: [f64; 3]) -> (f64, [f64; 3]) {
    let mut nearest = (f64::INFINITY, [0.0; 3]);
    for i in 0..3 {
        let side = usize::from(direction[i] > 0.0);
        let distance = (ROOM[side][i] - origin[i]) / direction[i];
        if distance < nearest.0 {
            nearest = (distance, [0.0; 3]);
            nearest.1[i] = -direction[i].signum();
        }
    }
    nearest
}

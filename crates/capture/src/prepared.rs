//! Initial points, and how each was made.

use tcgs_core::PointCloud;

/// How a point was made, from the most to the least reliable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// At least three views agree on the point's depth; where cameras stand far apart, two.
    Triangulated,
    /// The point lies on the visual hull of the masks, where stereo found no foreground: foreground without texture.
    Hull,
    /// The point's depth is interpolated between triangulated points: background without texture.
    Filled,
    /// The point lies on the sphere or the floor that encloses the scene, on a ray that met no other point. Its colour
    /// is that of one camera's picture.
    Shell,
    /// The point was strewn where cameras agree in colour, and its depth is unknown.
    Strewn,
}

impl Origin {
    /// All origins, from the most to the least reliable.
    pub const ALL: [Self; 5] = [Self::Triangulated, Self::Hull, Self::Filled, Self::Shell, Self::Strewn];

    /// Whether the images determine the point's place: views agree on its depth, or their masks bound it. Other points
    /// are assumed, and are no evidence for or against a camera.
    pub fn is_measured(self) -> bool {
        matches!(self, Self::Triangulated | Self::Hull)
    }
}

/// Initial points that were made from the images, and how each was made.
#[derive(Clone, Debug, Default)]
pub struct Prepared {
    /// `P` points: positions in scene units, colours in `[0, 1]`, foreground labels from the masks. Without masks all
    /// points are foreground, since anything may move.
    pub cloud: PointCloud,
    /// `[P]`, how each point of `cloud` was made.
    pub origins: Vec<Origin>,
    /// Share of the pixels of all training views whose depth other views confirm, in `[0, 1]`. A small share means that
    /// cameras and images do not fit together.
    pub agreement: f64,
}

impl Prepared {
    /// The points whose depth is measured ([`Origin::is_measured`]).
    pub fn measured(&self) -> PointCloud {
        measured(&self.cloud, &self.origins)
    }

    /// Number of points of one origin.
    pub fn count(&self, origin: Origin) -> usize {
        self.origins.iter().filter(|&&o| o == origin).count()
    }
}

/// The points whose depth is measured.
///
/// - `origins`: of each point of `cloud`
pub(crate) fn measured(cloud: &PointCloud, origins: &[Origin]) -> PointCloud {
    let mut measured = PointCloud::default();
    for (i, _) in origins.iter().enumerate().filter(|(_, origin)| origin.is_measured()) {
        measured.points.push(cloud.points[i]);
        measured.colors.push(cloud.colors[i]);
        measured.foreground.push(cloud.foreground[i]);
    }
    measured
}

//! The visual hull: the space that all masks allow (Laurentini 1994), as small cubes.
//!
//! A few masks may disagree: segmentations lose hands and shoes.

use rayon::prelude::*;
use tcgs_core::{Pinhole, distance, upper_median};

/// A mask and its camera.
pub(crate) struct Silhouette<'a> {
    pub pinhole: &'a Pinhole<f32>,
    /// `[H, W]`
    pub mask: &'a [bool],
}

/// Cubes along each side of the first search space.
const FIRST_GRID: i32 = 24;
/// Cubes are not halved further once there are so many.
const ENOUGH_CUBES: usize = 60_000;
/// Share of the masks with a place in view that may call it empty.
const MISS_SHARE: f32 = 0.08;
/// Share of all masks that must have a place in view.
const MIN_SEEN_SHARE: f32 = 0.3;
/// Number of masks that must have a place in view, if there are more. The lines of sight of two cameras meet in many
/// places.
const MIN_SEEN: usize = 3;

/// A set of equal cubes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Hull {
    /// Side of a cube, scene units.
    pub edge: f32,
    origin: [f32; 3],
    /// Position in the grid, sorted.
    cubes: Vec<[i32; 3]>,
}

impl Hull {
    /// Carves the hull of some silhouettes; empty if they have nothing in common.
    ///
    /// - `finest_px`: cubes are halved until they are about that many pixels wide, or there are enough
    pub fn carve(silhouettes: &[Silhouette], finest_px: f32) -> Self {
        Self::carve_despite(silhouettes, finest_px, MISS_SHARE)
    }

    /// [`Self::carve`] for masks that miss much.
    ///
    /// - `miss_share`: share of the masks with a place in view that may call it empty
    pub fn carve_despite(silhouettes: &[Silhouette], finest_px: f32, miss_share: f32) -> Self {
        let pinholes: Vec<&Pinhole<f32>> = silhouettes.iter().map(|silhouette| silhouette.pinhole).collect();
        let Some((focus, reach)) = focus(&pinholes) else { return Self::default() };
        let counts: Vec<Counts> = silhouettes.iter().map(Counts::new).collect();
        let mut hull = Self {
            edge: 2.0 * reach / FIRST_GRID as f32,
            origin: focus.map(|x| x - reach),
            cubes: (0..FIRST_GRID.pow(3))
                .map(|i| [i / (FIRST_GRID * FIRST_GRID), i / FIRST_GRID % FIRST_GRID, i % FIRST_GRID])
                .collect(),
        };
        hull.keep(&counts, miss_share);
        // Width of a pixel at the middle of the scene.
        let pixel = pinholes
            .iter()
            .map(|pinhole| distance(pinhole.center, focus) / pinhole.focal[0])
            .fold(f32::INFINITY, f32::min);
        while !hull.cubes.is_empty() && hull.cubes.len() < ENOUGH_CUBES && hull.edge > finest_px * pixel {
            hull.edge /= 2.0;
            let halves =
                |&[x, y, z]: &[i32; 3]| (0..8).map(move |i| [2 * x + (i & 1), 2 * y + (i >> 1 & 1), 2 * z + (i >> 2)]);
            hull.cubes = hull.cubes.iter().flat_map(halves).collect();
            hull.keep(&counts, miss_share);
        }
        hull.cubes.sort_unstable();
        hull
    }

    /// Drops cubes that too many masks call empty, or too few see.
    fn keep(&mut self, counts: &[Counts], miss_share: f32) {
        let kept: Vec<bool> = self.cubes.par_iter().map(|&cube| self.allowed(cube, counts, miss_share)).collect();
        let mut kept = kept.into_iter();
        self.cubes.retain(|_| kept.next().unwrap_or_default());
    }

    fn allowed(&self, cube: [i32; 3], counts: &[Counts], miss_share: f32) -> bool {
        let center = self.center(cube);
        let reach = 0.75_f32.sqrt() * self.edge;
        let (mut seen, mut missed) = (0, 0);
        for count in counts {
            match count.meets(center, reach) {
                Some(true) => seen += 1,
                Some(false) => (seen, missed) = (seen + 1, missed + 1),
                None => {}
            }
        }
        let least = MIN_SEEN.min(counts.len().saturating_sub(1)).max(2);
        let enough = ((MIN_SEEN_SHARE * counts.len() as f32).ceil() as usize).max(least);
        seen >= enough && missed <= (miss_share * seen as f32) as usize
    }

    /// Centre of a cube.
    fn center(&self, cube: [i32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| self.origin[i] + (cube[i] as f32 + 0.5) * self.edge)
    }

    /// Centres of the cubes with a free side.
    pub fn surface(&self) -> Vec<[f32; 3]> {
        let has = |cube: [i32; 3]| self.cubes.binary_search(&cube).is_ok();
        let inside = |&[x, y, z]: &[i32; 3]| {
            has([x - 1, y, z])
                && has([x + 1, y, z])
                && has([x, y - 1, z])
                && has([x, y + 1, z])
                && has([x, y, z - 1])
                && has([x, y, z + 1])
        };
        self.cubes.iter().filter(|cube| !inside(cube)).map(|&cube| self.center(cube)).collect()
    }

    /// Nearest and farthest depth of the hull in every pixel; infinity and 0 outside it.
    pub fn depths(&self, surface: &[[f32; 3]], pinhole: &Pinhole<f32>) -> Vec<[f32; 2]> {
        let mut depths = vec![[f32::INFINITY, 0.0_f32]; pinhole.width * pinhole.height];
        for &point in surface {
            let Some(([x, y], z)) = pinhole.project(point) else { continue };
            let half = 0.75_f32.sqrt() * self.edge / z;
            let span = |at: f32, focal: f32, size: usize| {
                let (from, to) = (at - half * focal, at + half * focal);
                (from.max(0.0) as usize)..((to.ceil().max(0.0) as usize).min(size))
            };
            for row in span(y, pinhole.focal[1], pinhole.height) {
                for column in span(x, pinhole.focal[0], pinhole.width) {
                    let [near, far] = &mut depths[row * pinhole.width + column];
                    (*near, *far) = (near.min(z - self.edge), far.max(z + self.edge));
                }
            }
        }
        depths
    }
}

/// The place nearest to all lines of sight, and the radius of the search around it.
///
/// - returns: `None` for fewer than two cameras
pub(super) fn focus(pinholes: &[&Pinhole<f32>]) -> Option<([f32; 3], f32)> {
    if pinholes.len() < 2 {
        return None;
    }
    // Least squares: Σ (I − d dᵀ) (p − c) = 0. A little of the cameras' mean, for lines that are parallel.
    let mean: [f64; 3] = std::array::from_fn(|i| {
        pinholes.iter().map(|pinhole| f64::from(pinhole.center[i])).sum::<f64>() / pinholes.len() as f64
    });
    let mut rows = [[0.0; 4]; 3];
    for pinhole in pinholes {
        let (d, c) = (pinhole.forward().map(f64::from), pinhole.center.map(f64::from));
        for i in 0..3 {
            for j in 0..3 {
                let entry = f64::from(u8::from(i == j)) * 1.001 - d[i] * d[j];
                rows[i][j] += entry;
                rows[i][3] += entry * c[j];
            }
            rows[i][3] += 0.001 * (mean[i] - c[i]);
        }
    }
    let focus = super::solve(rows)?.map(|x| x as f32);
    let typical = upper_median(pinholes.iter().map(|pinhole| distance(pinhole.center, focus)))?;
    Some((focus, 1.2 * typical))
}

/// A mask as a summed-area table.
struct Counts<'a> {
    pinhole: &'a Pinhole<f32>,
    /// `[H + 1, W + 1]`: foreground pixels above and to the left.
    sums: Vec<u32>,
}

impl<'a> Counts<'a> {
    fn new(silhouette: &Silhouette<'a>) -> Self {
        let (width, height) = (silhouette.pinhole.width, silhouette.pinhole.height);
        let mut sums = vec![0; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut row = 0;
            for x in 0..width {
                row += u32::from(silhouette.mask[y * width + x]);
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
            }
        }
        Self { pinhole: silhouette.pinhole, sums }
    }

    /// Whether a ball touches foreground; `None` if its centre is not in the image.
    fn meets(&self, center: [f32; 3], radius: f32) -> Option<bool> {
        let ([x, y], z) = self.pinhole.project(center)?;
        let (width, height) = (self.pinhole.width, self.pinhole.height);
        if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
            return None;
        }
        if z <= radius {
            return Some(true);
        }
        let span = |at: f32, focal: f32, size: usize| {
            // Small cubes are judged by the pixel of their centre.
            let half = (radius * focal / z - 0.5).max(0.0);
            ((at - half).max(0.0) as usize, ((at + half) as usize + 1).min(size))
        };
        let ((left, right), (top, bottom)) =
            (span(x, self.pinhole.focal[0], width), span(y, self.pinhole.focal[1], height));
        let at = |x: usize, y: usize| self.sums[y * (width + 1) + x];
        Some(at(right, bottom) + at(left, top) > at(left, bottom) + at(right, top))
    }
}

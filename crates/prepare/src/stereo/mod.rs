//! Initial points from images and cameras alone, by multi-view stereo.
//!
//! What lives here: the order of the steps, which are one module each.
//!
//! - *patchmatch* estimates the depth of every pixel of every training view, from coarse to fine.
//! - *hull* carves the visual hull of the masks, which bounds the depth of foreground.
//! - *fuse* keeps the points on which several views agree.
//! - *fill* interpolates depth across surfaces without texture.
//! - *sweep* finds the floor that cameras all around share.
//! - *shell* gives the remaining rays of background an end.
//! - *holes* closes the shell where no training image shows anything.
//! - *thin* reduces the points to the wanted number.
//!
//! What does not: reading images ([`Capture`]), and training from the points.
//!
//! One thread works on each view, and random numbers depend on seed, view and pixel alone, so the number of threads
//! does not change the result.

mod fill;
mod fuse;
mod holes;
pub(crate) mod hull;
mod patchmatch;
mod shell;
mod spread;
mod sweep;
mod thin;
pub(crate) mod vantage;

use rayon::prelude::*;
use tcgs_capture::{Capture, Origin, Prepared, Split};
use tcgs_core::{Camera, Pinhole, View, dot, upper_median};

use crate::PrepareError;

pub use holes::close_holes;
pub use spread::spread_points;

use fuse::{Belief, Point, Rule, SureDepths, agreed, num_hidden_from};
use hull::{Hull, Silhouette};
use patchmatch::{DepthMap, MAX_SOURCES, Plane, Range, Search, SourceView};
use shell::{Shell, Wall};
use vantage::Vantage;

/// Settings of [`stereo_points`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StereoSettings {
    /// Approximate upper bound of the number of points; default 80000.
    pub num_points: usize,
    /// Images are downscaled by a whole factor until they are at most this wide, pixels; default 400.
    pub image_width: usize,
    /// Seed of the random depth hypotheses; default 0.
    pub seed: u64,
}

impl Default for StereoSettings {
    fn default() -> Self {
        Self { num_points: 80_000, image_width: 400, seed: 0 }
    }
}

/// Minimum number of cameras.
const MIN_CAMERAS: usize = 3;
/// Smallest images, pixels.
const MIN_SIDE: usize = 16;
/// The coarsest level is at least this wide, pixels.
const COARSEST_WIDTH: usize = 60;
/// Maximum number of pyramid levels.
const MAX_LEVELS: usize = 3;
/// Sweeps over all pixels, at the coarsest level and at each other one.
const SWEEPS: [usize; 2] = [8, 3];
/// Number of views that may confirm a depth.
const NUM_WITNESSES: usize = 10;
/// With so few witnesses cameras stand far apart, and seldom do two of them see a place: one has to do.
const FEW_WITNESSES: usize = 3;
/// Depths at a higher matching cost are guesses.
const MAX_COST: f32 = 0.6;
/// The same for cameras with [`FEW_WITNESSES`].
const MAX_COST_OF_TWO: f32 = 0.3;
/// Least number of connected pixels with depths on which two cameras agree, where no camera can be compared with two.
const MIN_PIXELS: usize = 16;
/// Least radius of the shell, over the distance of the farthest camera from the middle of all, where no camera can be
/// compared with two. The points of such cameras lie between them, and walls lie behind.
const BEHIND_CAMERAS: f32 = 1.5;
/// Factors of the smallest and the largest confirmed inverse depth at the coarsest level, which bound the background.
const RANGE_MARGIN: [f32; 2] = [0.6, 1.6];
/// Share of foreground among the points, where there is any.
const FOREGROUND_SHARE: f64 = 0.3;
/// A surface without texture is continued over this share of the image's width.
const FILL_SHARE: f64 = 0.2;
/// A ray meets a point if a point falls into the ray's block of so many pixels squared.
const BLOCK_PX: usize = 8;
/// Angle to the nearest direction of another camera from which cameras stand all around a scene.
const ALL_AROUND_DEGREES: f32 = 40.0;
/// Number of views from which a point may hide a sure depth.
const MAX_HIDDEN_FROM: usize = 1;

/// Makes initial points by multi-view stereo on the training images of a capture's first frame: PatchMatch (Bleyer et
/// al. 2011), and the visual hull (Laurentini 1994) where there are masks.
///
/// - `capture`: with at least three training cameras; its own points, if there are any, are not used
/// - `report`: called with a description of each step before the step begins
///
/// Equal captures and settings give equal points, whatever the number of threads.
///
/// ```
/// use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
/// use tcgs_prepare::{StereoSettings, stereo_points};
/// let folder = tempfile::tempdir()?;
/// write_synthetic(folder.path(), &SyntheticSettings { num_timesteps: 1, ..Default::default() })?;
/// std::fs::remove_file(folder.path().join("init_pt_cld.npz"))?;
///
/// let capture = Capture::open(folder.path())?;
/// let settings = StereoSettings { num_points: 5000, ..Default::default() };
/// let prepared = stereo_points(&capture, &settings, &mut |step| println!("{step}"))?;
/// assert!(prepared.cloud.points.len() > 2500 && prepared.cloud.foreground.contains(&true));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PrepareError`] if the capture has fewer than three training cameras, or images of fewer than 16 pixels each way,
/// or if an image cannot be decoded. Also if no views agree on any depth, as when cameras are wrong;
/// [`check`](crate::check) looks for the reason. Also if no three cameras look at the same place and no masks give a
/// visual hull.
pub fn stereo_points(
    capture: &Capture,
    settings: &StereoSettings,
    report: &mut dyn FnMut(&str),
) -> Result<Prepared, PrepareError> {
    report("reading images");
    let views = capture.views(Split::Train, 0, 1)?;
    check_enough(capture, &views)?;
    let comparable = check_comparable(capture, &views);
    let prepared = cloud_of(&views, settings, report);
    if prepared.count(Origin::Hull) == 0 {
        comparable?;
    } else if comparable.is_err() {
        return Ok(prepared);
    }
    if prepared.count(Origin::Triangulated) == 0 {
        return Err(PrepareError::NoDepth { path: capture.path().into() });
    }
    Ok(prepared)
}

/// Checks that there are enough cameras and pixels to see depth.
pub(crate) fn check_enough(capture: &Capture, views: &[View]) -> Result<(), PrepareError> {
    let small = views.iter().map(|view| &view.camera).find(|camera| camera.width.min(camera.height) < MIN_SIDE);
    let problem = match small {
        _ if views.len() < MIN_CAMERAS => {
            format!("has {} training cameras, expected at least {MIN_CAMERAS}", views.len())
        }
        Some(camera) => {
            format!("has images of {}x{}, expected at least {MIN_SIDE} pixels each way", camera.width, camera.height)
        }
        None => return Ok(()),
    };
    Err(PrepareError::invalid(capture.path(), problem))
}

/// Checks that some camera has the two others that must agree with it.
pub(crate) fn check_comparable(capture: &Capture, views: &[View]) -> Result<(), PrepareError> {
    let pinholes = pinholes(views);
    if (0..pinholes.len()).any(|i| patchmatch::neighbors(&pinholes, i, MIN_CAMERAS - 1).len() == MIN_CAMERAS - 1) {
        return Ok(());
    }
    let degrees = patchmatch::MIN_DIRECTION_COSINE.acos().to_degrees().round() as usize;
    Err(PrepareError::FarApart { path: capture.path().into(), degrees })
}

/// Whether two views have to do for half of the cameras or more. The points of such cameras may follow a wrong one.
pub(crate) fn are_far_apart(views: &[View]) -> bool {
    let pinholes = pinholes(views);
    let has_few = |&i: &usize| patchmatch::neighbors(&pinholes, i, NUM_WITNESSES).len() <= FEW_WITNESSES;
    2 * (0..pinholes.len()).filter(has_few).count() >= pinholes.len()
}

/// Whether half of the cameras or more look in another direction than any other by at least [`ALL_AROUND_DEGREES`].
fn are_all_around(views: &[View]) -> bool {
    let directions: Vec<[f32; 3]> = pinholes(views).iter().map(Pinhole::forward).collect();
    let nearest = ALL_AROUND_DEGREES.to_radians().cos();
    let is_alone = |&i: &usize| (0..directions.len()).all(|j| j == i || dot(directions[i], directions[j]) < nearest);
    2 * (0..directions.len()).filter(is_alone).count() >= directions.len()
}

fn pinholes(views: &[View]) -> Vec<Pinhole<f32>> {
    views.iter().map(|view| Pinhole::new(&view.camera)).collect()
}

/// [`stereo_points`] on decoded images.
pub(crate) fn cloud_of(views: &[View], settings: &StereoSettings, report: &mut dyn FnMut(&str)) -> Prepared {
    let widest = views.iter().map(|view| view.camera.width).max().unwrap_or(1);
    let finest = widest.div_ceil(settings.image_width).max(1);
    let stereo = Stereo::search(views, finest, settings.seed, report);
    report("joining depths");
    let fused = stereo.fuse();
    report("continuing surfaces");
    // Cameras all around measure too few depths to show the floor, and too many wrong ones.
    let floor = are_all_around(views).then(|| sweep::find_floor(views)).flatten();
    stereo.points(&fused, settings.num_points, floor)
}

/// Share of the pixels whose depth other views confirm: small where cameras do not fit their images.
pub(crate) fn agreement(views: &[View], image_width: usize) -> f64 {
    let widest = views.iter().map(|view| view.camera.width).max().unwrap_or(1);
    let stereo = Stereo::search(views, widest.div_ceil(image_width).max(1), 0, &mut |_| ());
    stereo.fuse().agreement
}

/// Depths of all views.
struct Stereo {
    vantages: Vec<Vantage>,
    maps: Vec<DepthMap>,
    witnesses: Vec<Vec<usize>>,
    hull: Hull,
    /// Centres of the hull's outer cubes.
    hull_surface: Vec<[f32; 3]>,
    /// Cameras around those of the views.
    around: Vec<Pinhole<f32>>,
}

/// The depths and points on which views agree.
struct Fused {
    sure: Vec<SureDepths>,
    points: Vec<Point>,
    agreement: f64,
}

impl Stereo {
    fn search(views: &[View], finest: usize, seed: u64, report: &mut dyn FnMut(&str)) -> Self {
        let narrowest = views.iter().map(|view| view.camera.width.min(view.camera.height)).min().unwrap_or(1);
        let mut factors = vec![finest.min(narrowest / 2).max(1)];
        while factors.len() < MAX_LEVELS
            && views.iter().all(|view| view.camera.width / (2 * factors[0]) >= COARSEST_WIDTH)
            && narrowest / (2 * factors[0]) >= 2
        {
            factors.insert(0, 2 * factors[0]);
        }
        let all_at = |factor: usize| -> Vec<Vantage> { views.par_iter().map(|v| Vantage::new(v, factor)).collect() };
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
        let mut stereo = Self {
            vantages: all_at(factors[factors.len() - 1]),
            maps: Vec::new(),
            witnesses: Vec::new(),
            hull: Hull::default(),
            hull_surface: Vec::new(),
            around: holes::around(&cameras, factors[factors.len() - 1]),
        };
        report("carving the visual hull");
        let silhouettes: Vec<Silhouette> = stereo
            .vantages
            .iter()
            .filter_map(|v| v.mask.as_ref().map(|mask| Silhouette { pinhole: &v.pinhole, mask }))
            .collect();
        stereo.hull = Hull::carve(&silhouettes, 1.5);
        stereo.hull_surface = stereo.hull.surface();
        let pinholes = pinholes(views);
        let of_all = |count: usize| -> Vec<Vec<usize>> {
            (0..pinholes.len()).map(|i| patchmatch::neighbors(&pinholes, i, count)).collect()
        };
        let neighbors = of_all(MAX_SOURCES);
        stereo.witnesses = of_all(NUM_WITNESSES);
        let mut background: Vec<Range> =
            (0..views.len()).map(|i| patchmatch::widest_range(&stereo.vantages, i, &neighbors[i])).collect();

        for (level, &factor) in factors.iter().enumerate() {
            let vantages = all_at(factor);
            let pinhole = &vantages[0].pinhole;
            report(&format!("searching depths at {}x{}", pinhole.width, pinhole.height));
            let coarse = std::mem::take(&mut stereo.maps);
            let coarse_widths: Vec<usize> = stereo.vantages.iter().map(|v| v.pinhole.width).collect();
            stereo.maps = (0..views.len())
                .into_par_iter()
                .map(|i| {
                    let ranges = stereo.ranges(&vantages[i], background[i]);
                    let sources = neighbors[i].iter().map(|&j| SourceView::new(&vantages[i], &vantages[j])).collect();
                    let seed = seed.wrapping_mul(1 << 20).wrapping_add((i * MAX_LEVELS + level) as u64);
                    let search = Search { vantage: &vantages[i], sources, ranges: &ranges, seed };
                    let mut map = search.begin(coarse.get(i).map(|map| (map, coarse_widths[i])));
                    search.refine(&mut map, SWEEPS[usize::from(level > 0)]);
                    map
                })
                .collect();
            stereo.vantages = vantages;
            if level == 0 {
                stereo.narrow(&mut background);
            }
        }
        stereo
    }

    /// Search ranges: foreground within the hull, background within the view's given range.
    fn ranges(&self, vantage: &Vantage, background: Range) -> Vec<Range> {
        let mut ranges = vec![background; vantage.gray.len()];
        if !self.hull_surface.is_empty() {
            let depths = self.hull.depths(&self.hull_surface, &vantage.pinhole);
            for (pixel, range) in ranges.iter_mut().enumerate() {
                let [near, far] = depths[pixel];
                if near < far && vantage.is_foreground(pixel) {
                    *range = [1.0 / far, 1.0 / near.max(0.1 * far)];
                }
            }
        }
        ranges
    }

    /// Limits the search to about the depths on which views agree so far.
    fn narrow(&self, background: &mut [Range]) {
        let fused = self.fuse();
        for (range, sure) in background.iter_mut().zip(&fused.sure) {
            let mut known: Vec<f32> = sure.depths.iter().filter(|&&depth| depth > 0.0).map(|d| 1.0 / d).collect();
            known.sort_by(f32::total_cmp);
            // A handful may all be wrong.
            if known.len() >= 50 {
                let [low, high] = [known[known.len() / 100], known[known.len() - 1 - known.len() / 100]];
                *range = [range[0].max(RANGE_MARGIN[0] * low), range[1].min(RANGE_MARGIN[1] * high)];
            }
        }
    }

    fn fuse(&self) -> Fused {
        let num_pixels: usize = self.vantages.iter().map(|v| v.gray.len()).sum();
        let mut sure: Vec<SureDepths> = self.vantages.iter().map(|v| SureDepths::unknown(&v.pinhole)).collect();
        let mut points = self.join(&mut sure, MAX_COST, |witnesses| {
            let min_agreeing = if witnesses < 6 { 2 } else { 3 };
            Some(Rule { same_depth: 0.02, same_place_px: 1.5, min_agreeing, min_pixels: 1 })
        });
        let min_pixels = if self.are_pairs() { MIN_PIXELS } else { 1 };
        points.extend(self.join(&mut sure, MAX_COST_OF_TWO, |witnesses| {
            let rule = Rule { same_depth: 0.01, same_place_px: 1.0, min_agreeing: 1, min_pixels };
            (witnesses <= FEW_WITNESSES).then_some(rule)
        }));
        Fused { sure, agreement: points.len() as f64 / num_pixels.max(1) as f64, points }
    }

    /// Whether no view can be compared with two others.
    fn are_pairs(&self) -> bool {
        self.witnesses.iter().all(|witnesses| witnesses.len() <= 1)
    }

    /// Adds the depths on which views agree, of pixels without a sure depth. The points hide no depth that was sure
    /// before.
    ///
    /// - `max_cost`: matching cost from which a depth is a guess
    /// - `rule`: by the number of a view's witnesses; none if its depths do not count
    fn join(&self, sure: &mut [SureDepths], max_cost: f32, rule: impl Fn(usize) -> Option<Rule> + Sync) -> Vec<Point> {
        let beliefs: Vec<Belief> = self.maps.iter().map(|map| Belief::of(map, max_cost)).collect();
        let agreed_in = |of: usize| {
            let witnesses = &self.witnesses[of];
            let Some(rule) = rule(witnesses.len()) else { return Vec::new() };
            let is_unsure = |pixel: usize| sure[of].depths[pixel] == 0.0;
            let mut found = agreed(&self.vantages, &beliefs, &rule, of, witnesses, is_unsure);
            found.retain(|(_, point)| num_hidden_from(&self.vantages, sure, point.position) == 0);
            found
        };
        let found: Vec<Vec<(usize, Point)>> = (0..self.vantages.len()).into_par_iter().map(agreed_in).collect();
        for ((sure, vantage), found) in sure.iter_mut().zip(&self.vantages).zip(&found) {
            for (pixel, point) in found {
                sure.depths[*pixel] = vantage.pinhole.camera_point(point.position)[2];
            }
        }
        found.into_iter().flatten().map(|(_, point)| point).collect()
    }

    fn points(&self, fused: &Fused, num_points: usize, floor: Option<Wall>) -> Prepared {
        let is_above = |point: &&Point| floor.is_none_or(|floor| floor.distance(point.position) > 0.0);
        let above = fused.points.iter().filter(is_above);
        let (foreground, background): (Vec<Point>, Vec<Point>) = above.partition(|p| p.foreground);
        let hides = |point: &Point| num_hidden_from(&self.vantages, &fused.sure, point.position) > MAX_HIDDEN_FROM;
        let visible = |points: Vec<Point>| -> Vec<Point> { points.into_par_iter().filter(|p| !hides(p)).collect() };
        let foreground = [visible(foreground), visible(self.hull_points())];
        let min_radius = if self.are_pairs() { BEHIND_CAMERAS } else { 0.0 };
        let positions: Vec<[f32; 3]> = background.iter().map(|point| point.position).collect();
        let pinholes: Vec<Pinhole<f32>> = self.vantages.iter().map(|vantage| vantage.pinhole.clone()).collect();
        let shell = Shell::fit(&pinholes, &positions, min_radius, floor);
        let background = [visible(background), visible(self.filled(&fused.sure))];
        let mut all = [&foreground[..], &background].concat();
        all.push(visible(self.ended(&all, &shell)));
        let holes = visible(holes::hole_ends(&self.around, &all, &shell));
        let outside = holes::outside_ends(&pinholes, &shell, num_points);
        let holes = holes::colored(holes, outside, &all[2..], num_points);

        let wanted = if foreground.iter().all(Vec::is_empty) { 0.0 } else { FOREGROUND_SHARE };
        let foreground = thin::thin(&foreground, (wanted * num_points as f64) as usize);
        let rest = num_points.saturating_sub(foreground.len() + holes.len());
        let mut background = thin::thin(&all[2..], rest);
        background.extend(holes.into_iter().map(|point| (2, point)));

        let masks = self.vantages.iter().any(|v| v.mask.is_some());
        let mut prepared = Prepared { agreement: fused.agreement, ..Prepared::default() };
        let origins =
            [&[Origin::Triangulated, Origin::Hull][..], &[Origin::Triangulated, Origin::Filled, Origin::Shell]];
        for (points, origins) in [foreground, background].iter().zip(origins) {
            for &(list, Point { position, color, foreground }) in points {
                prepared.cloud.points.push(position);
                prepared.cloud.colors.push(color.map(|c| c.clamp(0.0, 1.0)));
                // Without masks anything may move.
                prepared.cloud.foreground.push(foreground || !masks);
                prepared.origins.push(origins[list]);
            }
        }
        prepared
    }

    /// Background between sure depths, where the continued surfaces of several views meet.
    fn filled(&self, sure: &[SureDepths]) -> Vec<Point> {
        let beliefs: Vec<Belief> = (0..self.vantages.len())
            .into_par_iter()
            .map(|i| {
                let vantage = &self.vantages[i];
                let levels = (FILL_SHARE * vantage.pinhole.width as f64).log2().round().max(0.0) as usize;
                let filled = fill::fill(vantage, &sure[i], levels);
                let planes = filled.iter().zip(&sure[i].depths).map(|(&filled, &depth)| {
                    let inverse_depth = if depth > 0.0 { 1.0 / depth } else { filled };
                    Plane { inverse_depth, gradient: [0.0; 2] }
                });
                let planes: Vec<Plane> = planes.collect();
                let known = planes.iter().map(|plane| plane.inverse_depth > 0.0).collect();
                Belief { planes: planes.into(), known }
            })
            .collect();
        let rule = Rule { same_depth: 0.04, same_place_px: 3.0, min_agreeing: 2, min_pixels: 1 };
        let of = |i: usize| {
            let unsure = |pixel: usize| sure[i].depths[pixel] == 0.0 && !self.vantages[i].is_foreground(pixel);
            let points = agreed(&self.vantages, &beliefs, &rule, i, &self.witnesses[i], unsure);
            points.into_iter().map(|(_, point)| point).collect()
        };
        (0..self.vantages.len()).into_par_iter().map(of).collect::<Vec<Vec<Point>>>().concat()
    }

    /// The ends of background rays that meet no point.
    fn ended(&self, points: &[Vec<Point>], shell: &Shell) -> Vec<Point> {
        let of = |vantage: &Vantage| {
            let pinhole = &vantage.pinhole;
            let free = unmet(pinhole, points).into_iter().filter(|&pixel| !vantage.is_foreground(pixel));
            let end = |pixel: usize| {
                let place = pinhole.pixel_center(pixel);
                let depth = shell.depth(pinhole.center, pinhole.ray(place))?;
                Some(Point {
                    position: pinhole.unproject(place, depth),
                    color: vantage.colors[pixel],
                    foreground: false,
                })
            };
            free.filter_map(end).collect()
        };
        self.vantages.par_iter().map(of).collect::<Vec<Vec<Point>>>().concat()
    }

    /// The hull's surface, in the colours of the views that see it.
    fn hull_points(&self) -> Vec<Point> {
        let nearest: Vec<Vec<[f32; 2]>> =
            self.vantages.par_iter().map(|v| self.hull.depths(&self.hull_surface, &v.pinhole)).collect();
        let point = |&position: &[f32; 3]| {
            let mut colors: Vec<[f32; 3]> = Vec::new();
            for (vantage, depths) in self.vantages.iter().zip(&nearest) {
                if let Some((at, depth)) = vantage.pinhole.pixel(position)
                    && vantage.is_foreground(at)
                    && depth < depths[at][0] + 3.0 * self.hull.edge
                {
                    colors.push(vantage.colors[at]);
                }
            }
            (!colors.is_empty()).then(|| Point { position, color: median(&colors), foreground: true })
        };
        self.hull_surface.par_iter().filter_map(point).collect()
    }
}

/// Pixels of a camera that no point falls near: none into the pixel's block.
fn unmet(pinhole: &Pinhole<f32>, points: &[Vec<Point>]) -> Vec<usize> {
    let across = pinhole.width.div_ceil(BLOCK_PX);
    let block = |pixel: usize| pixel / pinhole.width / BLOCK_PX * across + pixel % pinhole.width / BLOCK_PX;
    let mut met = vec![false; across * pinhole.height.div_ceil(BLOCK_PX)];
    for point in points.iter().flatten() {
        if let Some((pixel, _)) = pinhole.pixel(point.position) {
            met[block(pixel)] = true;
        }
    }
    (0..pinhole.width * pinhole.height).filter(|&pixel| !met[block(pixel)]).collect()
}

/// Median, channel by channel; black without colours.
fn median(colors: &[[f32; 3]]) -> [f32; 3] {
    [0, 1, 2].map(|channel| upper_median(colors.iter().map(|color| color[channel])).unwrap_or_default())
}

/// Solves linear equations by Gaussian elimination with pivoting; `None` if they have no single solution.
///
/// - `rows`: coefficients, then the right side; `M` is `N + 1`
fn solve<const N: usize, const M: usize>(mut rows: [[f64; M]; N]) -> Option<[f64; N]> {
    for i in 0..N {
        let pivot = (i..N).max_by(|&a, &b| rows[a][i].abs().total_cmp(&rows[b][i].abs()))?;
        rows.swap(i, pivot);
        if rows[i][i].abs() < 1e-12 {
            return None;
        }
        for j in 0..N {
            if j != i {
                let factor = rows[j][i] / rows[i][i];
                for k in i..M {
                    rows[j][k] -= factor * rows[i][k];
                }
            }
        }
    }
    Some(std::array::from_fn(|i| rows[i][N] / rows[i][i]))
}

#[cfg(test)]
mod tests;

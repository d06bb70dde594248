//! Chooses the Gaussians that a timestep trains, and collects their surroundings.
//!
//! - A Gaussian's blending weights are summed over the pixels of each view, at half the resolution.
//! - Foreground Gaussians that are hidden or masked have no evidence of their own. They follow their neighbours by
//!   vote; otherwise they would hold the others back through the losses on motion.
//! - A view draws the tiles with evidence and those in which active Gaussians are visible. Without the latter, a
//!   Gaussian would fit the changed views alone and degrade the others.
//! - The small state holds the active Gaussians, then the held ones, which edges of the losses on motion tie to active
//!   ones. Losses that are means over the scene's Gaussians are weighted by the small state's share ([`Shares`]).
//!   Quantizers are not updated, since locked Gaussians share them.
//! - Stillness is the share of a Gaussian's weight on unchanged content. The loss that uses it pulls and does not
//!   decide: a Gaussian whose colours fit better elsewhere still moves there.

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{Activated, Camera, Image, Pinhole};
use tcgs_render::{TileMask, gaussians_reaching, tiles_reached, weights_step};

use super::{Blocks, Evidence};
use crate::TrainError;
use crate::config::{GateConfig, MaskConfig};
use crate::engine::cpu::Drawn;
use crate::engine::{LookRenderer, Scenery, Target, ViewScenery};
use crate::losses::{Loss, LossTerms, WeightConfig};
use crate::motion::Past;
use crate::neighbors::Neighbors;
use crate::parameters::scatter;
use crate::row::Row;
use crate::state::{GradientStatistic, State};

/// Blending weight, summed over views, below which a Gaussian is not seen.
const MIN_WEIGHT: f32 = 1e-3;
/// Rounds in which neighbours wake each other.
const MAX_VOTES: usize = 10;
/// Depth margin behind the picture's surface within which a Gaussian counts as visible, in extents of a pixel.
const BEHIND: f32 = 4.0;
/// Least share of a pixel's colour for which active Gaussians answer.
const MIN_SHARE: f32 = 0.1;

/// The part of a scene that a timestep trains: Gaussians, and tiles of views.
#[derive(Clone, Debug)]
pub(crate) struct Activity {
    /// Indices of the active Gaussians, ascending.
    pub active: Vec<usize>,
    /// Indices of the Gaussians that are held because the losses on motion tie them to active ones, ascending.
    pub held: Vec<usize>,
    /// `[N]` share of each Gaussian's blending weight on content that has not changed, 0 to 1; 0 if no view sees it.
    /// Empty if no view has changed.
    pub stillness: Vec<f32>,
    /// `[N]` share of the pixels of all views that each Gaussian makes up; empty if no view has changed.
    pub pixels: Vec<f32>,
    /// `[cameras]`, the tiles that are drawn.
    pub tiles: Vec<TileMask>,
    /// Positions of the views with such tiles; empty if no Gaussian is active.
    pub cameras: Vec<usize>,
    /// The active Gaussians as drawn before the timestep.
    pub before: Activated,
    /// The scenery of the timestep; none if no Gaussian is active.
    pub scenery: Option<Scenery>,
    /// `[cameras][active]` blending weights before the timestep, in pixels; 0 if the centre is hidden. Empty without
    /// matches.
    pub weights: Vec<Vec<f32>>,
    /// `[active, 3]` corrections to their positions at constant velocity, scene units; empty for none.
    pub corrections: Vec<[f32; 3]>,
}

impl Activity {
    /// - `state`: after the previous timestep
    /// - `pictures`: `[cameras]`, of this state
    ///
    /// # Errors
    /// Those of the renderer.
    pub(super) fn new(
        renderer: &dyn LookRenderer,
        state: &State,
        mask: &MaskConfig,
        targets: &[Target],
        evidence: Vec<Evidence>,
        pictures: &[Image],
        config: &GateConfig,
    ) -> Result<Self, TrainError> {
        let channels = pictures[0].num_channels;
        let mut activity = Self {
            active: Vec::new(),
            held: Vec::new(),
            stillness: Vec::new(),
            pixels: Vec::new(),
            cameras: Vec::new(),
            before: Activated { num_channels: channels, ..Activated::default() },
            tiles: evidence.iter().map(|e| e.tiles.clone()).collect(),
            scenery: None,
            weights: Vec::new(),
            corrections: Vec::new(),
        };
        if evidence.iter().all(|e| e.tiles.is_empty()) {
            return Ok(activity);
        }
        let drawn = Drawn::new(state, mask, channels > 3);
        let all = drawn.activated();
        let looks: Vec<ViewLook> = (targets, &evidence)
            .into_par_iter()
            .map(|(t, e)| ViewLook::new(renderer, all, t, e, config.matches))
            .collect::<Result<_, _>>()?;
        let mut weights = vec![[0.0_f32; 2]; all.num_gaussians()];
        for look in &looks {
            for (sum, weights) in weights.iter_mut().zip(&look.weights) {
                *sum = [sum[0] + weights[0], sum[1] + weights[1]];
            }
        }
        let num_pixels: usize =
            targets.iter().map(|target| looked_at(&target.camera)).map(|c| c.width * c.height).sum();
        activity.pixels = weights.iter().map(|[_, whole]| whole / num_pixels as f32).collect();
        let unchanged = |&[changed, whole]: &[f32; 2]| (1.0 - changed / whole).max(0.0);
        let stillness = |weights: &[f32; 2]| if weights[1] > MIN_WEIGHT { unchanged(weights) } else { 0.0 };
        activity.stillness = weights.iter().map(stillness).collect();
        let is_seen: Vec<bool> = weights.iter().map(|[_, whole]| *whole > MIN_WEIGHT).collect();
        let mut is_active: Vec<bool> =
            weights.iter().map(|&[changed, whole]| changed > MIN_WEIGHT && changed >= config.share * whole).collect();
        let mut is_held = vec![false; is_active.len()];
        if let Some(past) = &state.past {
            vote(&past.neighbors, &is_seen, &mut is_active);
            for (near, far) in links(&past.neighbors) {
                is_held[near] |= is_active[far];
                is_held[far] |= is_active[near];
            }
        }
        let indices = |flags: &[bool]| (0..flags.len()).filter(|&i| flags[i]).collect::<Vec<_>>();
        activity.active = indices(&is_active);
        if activity.active.is_empty() {
            return Ok(activity);
        }
        if config.matches {
            let shown = |look: &ViewLook| {
                activity.active.iter().map(|&i| if look.is_shown[i] { look.weights[i][1] } else { 0.0 }).collect()
            };
            activity.weights = looks.iter().map(shown).collect();
        }
        activity.active.iter().for_each(|&i| is_held[i] = false);
        activity.held = indices(&is_held);
        activity.before = all.select(&activity.active);
        // Active Gaussians answer for every tile in which they are visible, changed or not.
        let colors: Vec<f32> = is_active.iter().map(|&is_active| f32::from(u8::from(is_active))).collect();
        let marked = Arc::new(Activated { colors, num_channels: 1, background: Vec::new(), ..Activated::clone(all) });
        (&mut activity.tiles, targets).into_par_iter().try_for_each(|(tiles, target)| {
            tiles.union(&tiles_shown(renderer, &marked, &activity.before, &target.camera)?);
            Ok::<_, TrainError>(())
        })?;
        activity.cameras = (0..targets.len()).filter(|&i| !activity.tiles[i].is_empty()).collect();
        let cameras: Vec<&Camera> = targets.iter().map(|target| &target.camera).collect();
        let (rows, num_active) = (activity.rows(), activity.active.len());
        activity.scenery = Some(scenery_of(&drawn, &rows, num_active, &activity.tiles, pictures, &cameras));
        Ok(activity)
    }

    /// - `num_gaussians`: of the scene
    pub fn trained(&self, num_gaussians: usize) -> Trained {
        let tiles = |count: &dyn Fn(&TileMask) -> usize| self.tiles.iter().map(count).sum::<usize>() as f64;
        Trained {
            gaussians: self.active.len() as f64 / num_gaussians as f64,
            tiles: tiles(&TileMask::len) / tiles(&|mask| mask.grid()[0] * mask.grid()[1]),
        }
    }

    /// The rows of the small state: active, then held.
    pub fn rows(&self) -> Vec<usize> {
        [&self.active[..], &self.held].concat()
    }

    /// The small state: the rows of `state`, with their part of the past.
    pub fn excerpt(&self, state: &State) -> State {
        let rows = self.rows();
        let parameters = state.parameters.select(&rows);
        let kept: Vec<Row> = rows.iter().map(|&i| Row::Kept(i)).collect();
        let mut optimizer = state.optimizer.clone();
        optimizer.gather(&kept);
        let mut lifetimes = state.lifetimes.clone();
        lifetimes.gather(&kept, state.timestep as u32);
        let mut quantizers = state.quantizers.clone();
        if let Some(quantizers) = &mut quantizers {
            quantizers.select(&rows);
        }
        let neighbors = |past: &Past| self.neighbors(&past.neighbors, state.parameters.num_gaussians());
        let stillness: Vec<f32> = rows.iter().map(|&i| self.stillness[i]).collect();
        let past = state.past.as_ref().map(|past| Past { stillness, ..past.select(&rows, |_| neighbors(past)) });
        let statistic = GradientStatistic::new(rows.len());
        State { parameters, lifetimes, optimizer, quantizers, past, statistic, timestep: state.timestep, num_fixed: 0 }
    }

    /// The edges that start or end at an active Gaussian. An edge between two held Gaussians is replaced by one of
    /// weight 0, since all nodes have the same number of edges.
    fn neighbors(&self, whole: &Neighbors<f32>, num_gaussians: usize) -> Neighbors<f32> {
        let rows = self.rows();
        let mut row_of = vec![u32::MAX; num_gaussians];
        rows.iter().enumerate().for_each(|(row, &i)| row_of[i] = row as u32);
        // Rows of the foreground, each with its position among the whole foreground.
        let mut at: Vec<(u32, usize)> = (whole.foreground.iter().enumerate())
            .filter(|(_, i)| row_of[**i as usize] != u32::MAX)
            .map(|(node, &i)| (row_of[i as usize], node))
            .collect();
        at.sort_unstable();
        let mut position = vec![u32::MAX; whole.foreground.len()];
        at.iter().enumerate().for_each(|(new, &(_, node))| position[node] = new as u32);
        let per_node = whole.per_node;
        let is_active = |node: usize| (row_of[whole.foreground[node] as usize] as usize) < self.active.len();
        let (mut indices, mut weights, mut distances) = (Vec::new(), Vec::new(), Vec::new());
        for (new, &(_, node)) in at.iter().enumerate() {
            for edge in node * per_node..(node + 1) * per_node {
                let end = whole.indices[edge] as usize;
                if is_active(node) || (position[end] != u32::MAX && is_active(end)) {
                    indices.push(position[end]);
                    weights.push(whole.weights[edge]);
                    distances.push(whole.distances[edge]);
                } else {
                    indices.push(new as u32);
                    weights.push(0.0);
                    distances.push(0.0);
                }
            }
        }
        let foreground = at.iter().map(|&(row, _)| row).collect();
        Neighbors::from_edges(foreground, per_node, indices, weights, distances)
    }

    /// Copies the trained values back into the whole state.
    ///
    /// - `small`: the trained state from [`Self::excerpt`]
    pub fn put_back(&self, small: &State, state: &mut State) {
        let scatter = |from: &[f32], to: &mut [f32], components: usize| scatter(&self.active, from, to, components);
        state.parameters.put(&self.active, &small.parameters);
        let o = &mut state.optimizer;
        for column in state.parameters.gaussians.layout().columns() {
            let (a, components) = (column.attribute, column.components());
            scatter(small.optimizer.first.values(a), o.first.values_mut(a), components);
            scatter(small.optimizer.second.values(a), o.second.values_mut(a), components);
        }
        scatter(&small.optimizer.mask.first, &mut o.mask.first, 1);
        scatter(&small.optimizer.mask.second, &mut o.mask.second, 1);
        o.steps.clone_from(&small.optimizer.steps);
        o.mask.step = small.optimizer.mask.step;
    }

    /// The small state's share of the scene's Gaussians.
    pub fn shares(&self, state: &State) -> Shares {
        let foreground = &state.parameters.foreground;
        let rows: Vec<bool> = self.rows().into_iter().map(|i| foreground[i]).collect();
        Shares::of(&rows, foreground)
    }
}

/// The scenery of some rows in some tiles.
///
/// - `drawn`: the scene, with these rows
/// - `rows`: indices into the scene; the first `num_active` are trained
/// - `tiles`, `pictures`, `cameras`: `[cameras]`; the pictures are of the scene
pub(crate) fn scenery_of(
    drawn: &Drawn,
    rows: &[usize],
    num_active: usize,
    tiles: &[TileMask],
    pictures: &[Image],
    cameras: &[&Camera],
) -> Scenery {
    let all = drawn.activated();
    let channels = all.num_channels;
    let mut is_row = vec![false; all.num_gaussians()];
    rows.iter().for_each(|&i| is_row[i] = true);
    // Indices into the scene, for each view.
    let reaching: Vec<Vec<u32>> = (tiles, cameras)
        .into_par_iter()
        .map(|(tiles, camera)| {
            if tiles.is_empty() {
                return Vec::new();
            }
            let mut is_drawn = is_row.clone();
            gaussians_reaching(all, camera, tiles).iter().for_each(|&i| is_drawn[i as usize] = true);
            (0..all.num_gaussians() as u32).filter(|&i| is_drawn[i as usize]).collect()
        })
        .collect();
    let mut is_drawn = is_row;
    reaching.iter().flatten().for_each(|&i| is_drawn[i as usize] = true);
    let reached: Vec<usize> = (0..all.num_gaussians()).filter(|&i| is_drawn[i]).collect();
    let mut place_of = vec![u32::MAX; all.num_gaussians()];
    reached.iter().enumerate().for_each(|(place, &i)| place_of[i] = place as u32);
    let colors = |camera: usize, indices: &[u32]| {
        let all = drawn.colors_seen_by(cameras[camera]).filter(|_| !indices.is_empty())?;
        let row = |&i: &u32| &all[i as usize * channels..][..channels];
        Some(indices.iter().flat_map(row).copied().collect())
    };
    let view = |(camera, indices): (usize, Vec<u32>)| ViewScenery {
        tiles: tiles[camera].clone(),
        picture: if indices.is_empty() { Image::default() } else { pictures[camera].clone() },
        gaussians: indices.iter().map(|&i| place_of[i as usize]).collect(),
        colors: colors(camera, &indices),
    };
    Scenery {
        num_active,
        drawn: all.select(&reached),
        places: rows.iter().map(|&i| place_of[i]).collect(),
        views: reaching.into_iter().enumerate().map(view).collect(),
    }
}

/// The trained share of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trained {
    /// Share of the Gaussians that were active, in `[0, 1]`.
    pub gaussians: f64,
    /// Share of the tiles of all views that were drawn, in `[0, 1]`.
    pub tiles: f64,
}

impl Trained {
    /// A timestep that trains everything.
    pub const ALL: Self = Self { gaussians: 1.0, tiles: 1.0 };
}

/// The small state's share of the scene's Gaussians, which weights its losses. A mean over the small state times its
/// share is its part of the mean over the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shares {
    all: f64,
    foreground: f64,
    background: f64,
}

impl Shares {
    /// - `rows`: for each Gaussian of the small state, whether it is foreground
    /// - `scene`: the same for the scene
    pub fn of(rows: &[bool], scene: &[bool]) -> Self {
        let share = |part: usize, whole: usize| if whole == 0 { 1.0 } else { part as f64 / whole as f64 };
        let count = |rows: &[bool]| rows.iter().filter(|foreground| **foreground).count();
        let (part, whole) = (count(rows), count(scene));
        Self {
            all: share(rows.len(), scene.len()),
            foreground: share(part, whole),
            background: share(rows.len() - part, scene.len() - whole),
        }
    }

    fn of_loss(self, loss: Loss) -> f64 {
        match loss {
            // Sums over the pixels drawn, already divided by those of the whole image.
            Loss::Image | Loss::Segmentation => 1.0,
            Loss::Rigid | Loss::Rot | Loss::Iso | Loss::Floor => self.foreground,
            Loss::Background => self.background,
            Loss::Stillness | Loss::SoftColor | Loss::Mask | Loss::MaskConsistency => self.all,
        }
    }

    /// Weights of a small state's losses.
    pub fn weights(self, weights: &WeightConfig) -> WeightConfig {
        let values = weights.values();
        WeightConfig::from_values(std::array::from_fn(|i| values[i] * self.of_loss(Loss::ALL[i]) as f32))
    }

    /// A small state's losses as parts of the scene's.
    pub fn terms(self, terms: LossTerms) -> LossTerms {
        let values = terms.values();
        LossTerms::from_values(std::array::from_fn(|i| values[i] * self.of_loss(Loss::ALL[i])))
    }
}

/// The gate's look at every Gaussian in one view, at the lower resolution.
struct ViewLook {
    /// `[N]` blending weight on changed pixels, and on all; in pixels.
    weights: Vec<[f32; 2]>,
    /// `[N]` whether the centre is no further than the surface that the picture shows there; empty without matches.
    is_shown: Vec<bool>,
}

impl ViewLook {
    /// - `all`: `[N]`
    fn new(
        renderer: &dyn LookRenderer,
        all: &Arc<Activated>,
        target: &Target,
        evidence: &Evidence,
        with_matches: bool,
    ) -> Result<Self, TrainError> {
        let (step, camera) = (weights_step(&target.camera), looked_at(&target.camera));
        let mut shares = Image::filled(camera.width, camera.height, 2, 1.0);
        mark(&evidence.blocks, step, camera.width, shares.plane_mut(0));
        let (weights, depths) = renderer.weights(all, &camera, &shares, with_matches)?;
        let is_shown = if with_matches { shown(&depths, &all.means, &camera) } else { Vec::new() };
        Ok(Self { weights, is_shown })
    }
}

/// The camera at the resolution at which weights are measured.
fn looked_at(camera: &Camera) -> Camera {
    camera.downscaled(weights_step(camera))
}

/// Whether each Gaussian's centre is no further than the surface that the picture shows there.
///
/// - `depths`: `[2, H, W]`, depths times blending weights, and these weights
/// - `means`: `[N]`
/// - returns: `[N]`
fn shown(depths: &Image, means: &[[f32; 3]], camera: &Camera) -> Vec<bool> {
    let pinhole = Pinhole::<f32>::new(camera);
    let is_shown = |&mean: &[f32; 3]| {
        let Some((pixel, depth)) = pinhole.pixel(mean) else { return false };
        let [sum, weight] = [0, 1].map(|channel| depths.plane(channel)[pixel]);
        depth * weight <= sum + BEHIND * weight * depth / pinhole.focal[0]
    };
    means.iter().map(is_shown).collect()
}

/// The tiles in which some Gaussians make up a visible part of the picture.
///
/// - `marked`: all Gaussians of the scene; one channel, 1 for these and 0 for the others
/// - `these`: these Gaussians alone
fn tiles_shown(
    renderer: &dyn LookRenderer,
    marked: &Arc<Activated>,
    these: &Activated,
    camera: &Camera,
) -> Result<TileMask, TrainError> {
    let mut tiles = TileMask::none(camera.width, camera.height);
    let (step, camera) = (weights_step(camera), looked_at(camera));
    let reached = tiles_reached(these, &camera);
    let picture = renderer.picture(marked, &camera, &reached)?;
    for (i, _) in picture.data.iter().enumerate().filter(|(_, share)| **share > MIN_SHARE) {
        let [x, y] = [i % camera.width * step, i / camera.width * step];
        tiles.insert_pixels(x..x + step, y..y + step);
    }
    Ok(tiles)
}

/// 1 at pixels of marked blocks, 0 elsewhere.
///
/// - `step`: pixels of the blocks' image per pixel of the plane
fn mark(blocks: &Blocks, step: usize, width: usize, plane: &mut [f32]) {
    for (i, value) in plane.iter_mut().enumerate() {
        *value = f32::from(u8::from(blocks.at(i % width * step, i / width * step)));
    }
}

/// Wakes a Gaussian if at least as many of its neighbours are active as are seen to be still. The inside of a moving
/// object changes less than its edges, and hidden or masked Gaussians move with their surroundings.
///
/// - `is_seen`: `[N]`, whether a Gaussian's own evidence counts
/// - `is_active`: `[N]`, added to
fn vote(neighbors: &Neighbors<f32>, is_seen: &[bool], is_active: &mut [bool]) {
    let Neighbors { foreground, per_node, indices, .. } = neighbors;
    for _ in 0..MAX_VOTES {
        let woken: Vec<u32> = (foreground.par_iter().enumerate())
            .filter(|(node, i)| {
                // The list of a node that lacks neighbours is filled with edges to itself.
                let ends = indices[node * per_node..(node + 1) * per_node].iter().filter(|end| **end as usize != *node);
                let ends = ends.map(|&end| foreground[end as usize]);
                let (mut active, mut still) = (0, 0);
                for end in ends {
                    active += usize::from(is_active[end as usize]);
                    still += usize::from(is_seen[end as usize] && !is_active[end as usize]);
                }
                !is_active[**i as usize] && active > 0 && active >= still
            })
            .map(|(_, &i)| i)
            .collect();
        woken.iter().for_each(|&i| is_active[i as usize] = true);
        if woken.is_empty() {
            break;
        }
    }
}

/// Both ends of every edge.
fn links(neighbors: &Neighbors<f32>) -> impl Iterator<Item = (usize, usize)> + '_ {
    let foreground = &neighbors.foreground;
    (neighbors.indices.iter().enumerate())
        .map(|(edge, &end)| (foreground[edge / neighbors.per_node] as usize, foreground[end as usize] as usize))
}

#[cfg(test)]
mod tests {
    use tcgs_core::PointCloud;

    use super::*;
    use crate::engine::cpu::CpuLook;
    use crate::motion::Pose;
    use crate::parameters::Parameters;

    #[test]
    fn who_lies_on_what_has_changed_is_not_still_and_who_is_unseen_is_unknown() {
        // Before the camera on the left and on the right, and behind it.
        let points = vec![[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, -9.0]];
        let cloud = PointCloud { colors: vec![[0.5; 3]; 3], foreground: vec![true; 3], points };
        let mut parameters = Parameters::from_cloud(&cloud, 1, 1.0);
        parameters.gaussians.log_scales_mut().fill([-2.5; 3]);
        let mut state = State::new(parameters);
        let first = state.parameters.gaussians.clone();
        state.past = Some(Past::new(Pose::of(&first), first, &[true; 3]));
        let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let target = Target { camera, image: Image::filled(64, 48, 3, 0.0) };
        // The left half of the image, and the part of the middle that the right Gaussian still reaches.
        let (mut blocks, mut tiles) = (Blocks::none(64, 48), TileMask::none(64, 48));
        blocks.mark(0..44, 0..48);
        tiles.insert_pixels(0..44, 0..48);
        let evidence = vec![Evidence { blocks, tiles }];
        let (config, mask) = (GateConfig { matches: false, ..GateConfig::ON }, crate::TrainConfig::default().mask);
        let pictures = [Image::filled(64, 48, 3, 0.0)];
        let activity = Activity::new(&CpuLook, &state, &mask, &[target], evidence, &pictures, &config).unwrap();
        let [left, right, behind] = activity.stillness[..] else { panic!("{:?}", activity.stillness) };
        assert!(left < 1e-3 && (0.2..0.9).contains(&right) && behind == 0.0, "{:?}", activity.stillness);
        let small = activity.excerpt(&state);
        let expected: Vec<f32> = activity.rows().into_iter().map(|i| activity.stillness[i]).collect();
        assert_eq!(small.past.unwrap().stillness, expected);
    }

    #[test]
    fn who_was_born_with_few_others_is_woken_by_them() {
        // Enough Gaussians at first that the six others lack most of their edges.
        let means: Vec<[f32; 3]> = (0..36).map(|i| [0.001 * i as f32, 0.0, 0.0]).collect();
        let births: Vec<u32> = (0..36).map(|i| if i < 30 { 0 } else { 4 }).collect();
        let neighbors = Neighbors::among(&means, &[true; 36], &births);
        assert_eq!(neighbors.per_node, 20);
        let mut is_active = [false; 36];
        is_active[30..35].fill(true);
        vote(&neighbors, &[true; 36], &mut is_active);
        assert!(is_active[35] && !is_active[..30].contains(&true));
    }
}

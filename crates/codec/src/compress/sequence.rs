//! Sequences of timesteps whose Gaussians change in number or order: finds correspondences between the Gaussians of
//! successive timesteps.
//!
//! Programs that make one scene per frame do not store correspondences. A Gaussian that is followed over several
//! timesteps costs its changes; any other costs all of its attributes again.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher;

use tcgs_core::{DynamicGaussians, Gaussians, Life, Lives, SceneReader, distance, dot, normalize, upper_median};

use super::settings::middle;
use super::statistics::read_one;
use crate::compact::MAX_TIMESTEPS;
use crate::error::CompressError;

/// Least share of a timestep's Gaussians that must match the timestep before; with fewer the timestep begins a new
/// part.
const MIN_KNOWN: f64 = 0.5;
/// Largest distance between two Gaussians that match, as a multiple of the middle one of the three scales.
const MAX_DISTANCE: f32 = 2.0;
/// Largest difference in each log scale.
const MAX_LOG_SCALE: f32 = 0.7;
/// Largest difference in the logit of the opacity.
const MAX_LOGIT: f32 = 2.0;
/// Largest difference in each channel of the colour.
const MAX_COLOR: f32 = 0.15;
/// Least cosine of half the angle between the rotations.
const MIN_COSINE: f32 = 0.9;

/// Successive timesteps of a sequence, with Gaussians followed over them.
#[derive(Clone, Debug)]
pub struct Followed {
    /// First timestep.
    pub start: usize,
    /// All Gaussians of the part. Before its life a Gaussian has the values of its first timestep, after its life
    /// those of its last.
    pub scene: DynamicGaussians,
    /// `[N]` lives, counted from [`Self::start`].
    pub lives: Lives,
}

impl Followed {
    /// Whether every Gaussian lives in all timesteps.
    pub fn all_live(&self) -> bool {
        let whole = Life { birth: 0, death: self.scene.num_timesteps() as u32 };
        self.lives.iter().all(|life| *life == whole)
    }
}

/// Follows Gaussians through a sequence, part by part.
///
/// ```
/// use tcgs_codec::FollowedParts;
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// (0..3).for_each(|_| scene.push(Gaussians::zeros(4)));
/// let parts: Vec<_> = FollowedParts::new(&mut &scene, 30).collect::<Result<_, _>>()?;
/// assert_eq!((parts.len(), parts[0].lives.len(), parts[0].all_live()), (1, 4, true));
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
pub struct FollowedParts<'a, R> {
    reader: &'a mut R,
    max_timesteps: usize,
    next: usize,
    /// The timestep at `next`, if it is already read.
    ahead: Option<Gaussians>,
}

impl<'a, R: SceneReader> FollowedParts<'a, R> {
    /// - `max_timesteps`: largest number of timesteps of a part; memory holds one part
    pub fn new(reader: &'a mut R, max_timesteps: usize) -> Self {
        Self { reader, max_timesteps: max_timesteps.clamp(1, MAX_TIMESTEPS as usize), next: 0, ahead: None }
    }

    fn read(&mut self) -> Result<Option<Gaussians>, CompressError> {
        if let Some(ahead) = self.ahead.take() {
            return Ok(Some(ahead));
        }
        (self.next < self.reader.num_timesteps()).then(|| read_one(self.reader, self.next)).transpose()
    }

    fn part(&mut self) -> Result<Option<Followed>, CompressError> {
        let start = self.next;
        let Some(first) = self.read()? else { return Ok(None) };
        self.next += 1;
        // For every Gaussian of the part: its first timestep, and its rows from there on.
        let mut tracks: Vec<(usize, Vec<u32>)> = (0..first.num_gaussians() as u32).map(|row| (0, vec![row])).collect();
        let mut of_row: Vec<usize> = (0..tracks.len()).collect();
        let mut timesteps = vec![first];
        while timesteps.len() < self.max_timesteps {
            let Some(now) = self.read()? else { break };
            let before = &timesteps[timesteps.len() - 1];
            let known = matches(before, &now);
            let count = known.iter().flatten().count();
            let most = before.num_gaussians().max(now.num_gaussians());
            if (count as f64) < MIN_KNOWN * most as f64 {
                self.ahead = Some(now);
                break;
            }
            let mut next_of_row = Vec::with_capacity(known.len());
            for (row, before) in known.into_iter().enumerate() {
                let track = before.map_or(tracks.len(), |before| of_row[before as usize]);
                if before.is_some() {
                    tracks[track].1.push(row as u32);
                } else {
                    tracks.push((timesteps.len(), vec![row as u32]));
                }
                next_of_row.push(track);
            }
            of_row = next_of_row;
            timesteps.push(now);
            self.next += 1;
        }
        let mut scene = DynamicGaussians::new(timesteps[0].layout().clone());
        for t in 0..timesteps.len() {
            // Values are constant before and after a life.
            let held = |(birth, rows): &(usize, Vec<u32>)| {
                let last = birth + rows.len() - 1;
                let at = t.clamp(*birth, last);
                (at, rows[at - birth] as usize)
            };
            let places: Vec<(usize, usize)> = tracks.iter().map(held).collect();
            scene.push(Gaussians::gather(&timesteps, &places));
        }
        let life = |(birth, rows): &(usize, Vec<u32>)| {
            let [birth, death] = [*birth, birth + rows.len()].map(|t| t as u32);
            Life { birth, death }
        };
        Ok(Some(Followed { start, lives: tracks.iter().map(life).collect(), scene }))
    }
}

impl<R: SceneReader> Iterator for FollowedParts<'_, R> {
    type Item = Result<Followed, CompressError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.part().transpose()
    }
}

/// For each Gaussian of `now` the matching Gaussian of `before`, if any; matches are unique.
///
/// First come Gaussians that are equal in every value, then similar ones in the same row, then the nearest similar
/// ones.
fn matches(before: &Gaussians, now: &Gaussians) -> Vec<Option<u32>> {
    let mut known = vec![None; now.num_gaussians()];
    let mut is_free = vec![true; before.num_gaussians()];
    let mut by_hash: HashMap<u64, Vec<u32>> = HashMap::new();
    for row in (0..before.num_gaussians()).rev() {
        by_hash.entry(hash(before, row)).or_default().push(row as u32);
    }
    for (row, known) in known.iter_mut().enumerate() {
        *known = by_hash.get_mut(&hash(now, row)).and_then(Vec::pop);
        if let Some(found) = *known {
            is_free[found as usize] = false;
        }
    }
    let cost = |b: usize, n: usize| cost(before, b, now, n);
    for row in 0..now.num_gaussians().min(before.num_gaussians()) {
        if known[row].is_none() && is_free[row] && cost(row, row).is_some() {
            known[row] = Some(row as u32);
            is_free[row] = false;
        }
    }
    let grid = Grid::new(before, &is_free);
    for row in 0..now.num_gaussians() {
        if known[row].is_some() {
            continue;
        }
        let mut best: Option<(f32, u32)> = None;
        for candidate in grid.near(now.means()[row]) {
            let found = is_free[candidate as usize].then(|| cost(candidate as usize, row)).flatten();
            if let Some(found) = found
                && best.is_none_or(|(least, _)| found < least)
            {
                best = Some((found, candidate));
            }
        }
        if let Some((_, found)) = best {
            known[row] = Some(found);
            is_free[found as usize] = false;
        }
    }
    known
}

fn hash(gaussians: &Gaussians, row: usize) -> u64 {
    let mut hasher = DefaultHasher::new();
    for attribute in gaussians.layout().attributes() {
        let components = attribute.components();
        let values = &gaussians.values(attribute)[row * components..][..components];
        values.iter().for_each(|x| hasher.write_u32(x.to_bits()));
    }
    hasher.finish()
}

/// Difference of two Gaussians; `None` if it is too large for a match.
fn cost(before: &Gaussians, b: usize, now: &Gaussians, n: usize) -> Option<f32> {
    let unit = middle(&before.log_scales()[b]).exp().max(f32::MIN_POSITIVE);
    let largest = |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f32::max);
    let distance = distance(before.means()[b], now.means()[n]) / unit;
    let scale = largest(before.log_scales()[b], now.log_scales()[n]);
    let logit = (before.logit_opacities()[b] - now.logit_opacities()[n]).abs();
    let color = largest(before.colors()[b], now.colors()[n]);
    let cosine = dot(normalize(before.quats()[b]), normalize(now.quats()[n])).abs();
    let is_alike = distance <= MAX_DISTANCE
        && scale <= MAX_LOG_SCALE
        && logit <= MAX_LOGIT
        && color <= MAX_COLOR
        && cosine >= MIN_COSINE;
    let parts = [distance / MAX_DISTANCE, scale / MAX_LOG_SCALE, logit / MAX_LOGIT, color / MAX_COLOR];
    is_alike.then(|| parts.into_iter().map(|x| x * x).sum::<f32>() + (1.0 - cosine) / (1.0 - MIN_COSINE))
}

/// A hash grid of Gaussians.
struct Grid {
    cell: f32,
    cells: HashMap<[i32; 3], Vec<u32>>,
}

impl Grid {
    /// Makes cells as wide as the largest distance of a match at the median scale.
    fn new(gaussians: &Gaussians, is_member: &[bool]) -> Self {
        let typical = upper_median(gaussians.log_scales().iter().map(middle)).unwrap_or_default();
        let mut grid = Self { cell: (MAX_DISTANCE * typical.exp()).max(1e-6), cells: HashMap::new() };
        for (row, mean) in gaussians.means().iter().enumerate().filter(|(row, _)| is_member[*row]) {
            grid.cells.entry(grid.cell_of(*mean)).or_default().push(row as u32);
        }
        grid
    }

    fn cell_of(&self, point: [f32; 3]) -> [i32; 3] {
        point.map(|x| (x / self.cell).floor() as i32)
    }

    /// The Gaussians in the cell of a point and in the 26 cells around it.
    fn near(&self, point: [f32; 3]) -> impl Iterator<Item = u32> {
        let [x, y, z] = self.cell_of(point);
        let around = (0..27).map(move |i| [i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1]);
        let cells = around.map(move |[a, b, c]| [x.saturating_add(a), y.saturating_add(b), z.saturating_add(c)]);
        cells.filter_map(|cell| self.cells.get(&cell)).flatten().copied()
    }
}

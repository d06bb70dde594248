//! From the depths of single views to points on which several views agree.

use std::borrow::Cow;

use tcgs_core::Pinhole;

use super::{
    patchmatch::{DepthMap, Plane},
    vantage::Vantage,
};

/// Relative depth margin: a point nearer than a view's sure depth by more than this hides it.
const HIDING: f32 = 0.06;

/// The condition for agreement of views.
pub(super) struct Rule {
    /// Relative difference of depth up to which two views mean the same surface.
    pub same_depth: f32,
    /// Largest reprojection error of a place, there and back again, pixels.
    pub same_place_px: f32,
    /// Other views that must agree.
    pub min_agreeing: usize,
    /// Least number of connected pixels with depths on which views agree.
    pub min_pixels: usize,
}

/// Depths of a view that count as known.
pub(super) struct Belief<'a> {
    /// `[H, W]`
    pub planes: Cow<'a, [Plane]>,
    /// `[H, W]`, whether the depth of a pixel is known.
    pub known: Vec<bool>,
}

impl<'a> Belief<'a> {
    /// The depths where the images match at less than this cost.
    pub fn of(map: &'a DepthMap, max_cost: f32) -> Self {
        let known =
            map.costs.iter().zip(&map.planes).map(|(&cost, plane)| cost < max_cost && plane.inverse_depth > 0.0);
        Self { planes: Cow::Borrowed(&map.planes), known: known.collect() }
    }
}

/// Depths of a view on which other views agree; 0 where there are none.
pub(super) struct SureDepths {
    /// `[H, W]`
    pub depths: Vec<f32>,
}

impl SureDepths {
    pub fn unknown(pinhole: &Pinhole<f32>) -> Self {
        Self { depths: vec![0.0; pinhole.width * pinhole.height] }
    }
}

/// A place on a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub position: [f32; 3],
    pub color: [f32; 3],
    pub foreground: bool,
}

/// Pixels of one view on which enough other views agree, and for each the mean of the points of all agreeing views.
///
/// - `others`: views to ask
/// - `wanted`: the pixels that are tested
pub(super) fn agreed(
    vantages: &[Vantage],
    beliefs: &[Belief],
    rule: &Rule,
    of: usize,
    others: &[usize],
    wanted: impl Fn(usize) -> bool,
) -> Vec<(usize, Point)> {
    let (me, belief) = (&vantages[of], &beliefs[of]);
    let mut points = Vec::new();
    for pixel in (0..belief.known.len()).filter(|&pixel| belief.known[pixel] && wanted(pixel)) {
        let place = me.pinhole.pixel_center(pixel);
        let position = me.pinhole.unproject(place, 1.0 / belief.planes[pixel].inverse_depth);
        let (mut sum, mut color, mut count) = (position, me.colors[pixel], 1.0);
        for &other in others {
            if let Some((theirs, at)) = seen_by(&vantages[other], &beliefs[other], rule, position, &me.pinhole, place)
                && vantages[other].is_foreground(at) == me.is_foreground(pixel)
            {
                for i in 0..3 {
                    sum[i] += theirs[i];
                    color[i] += vantages[other].colors[at][i];
                }
                count += 1.0;
            }
        }
        if count > rule.min_agreeing as f32 {
            let mean = |sum: [f32; 3]| sum.map(|x| x / count);
            points
                .push((pixel, Point { position: mean(sum), color: mean(color), foreground: me.is_foreground(pixel) }));
        }
    }
    retain_patches(&mut points, &me.pinhole, rule);
    points
}

/// Removes points of small patches. A patch is a set of connected pixels whose depths differ by less than the rule's
/// difference a pixel. Where few views are asked, single pixels agree by chance.
pub(super) fn retain_patches(points: &mut Vec<(usize, Point)>, pinhole: &Pinhole<f32>, rule: &Rule) {
    if rule.min_pixels <= 1 {
        return;
    }
    let (width, height) = (pinhole.width, pinhole.height);
    let mut depths = vec![0.0; width * height];
    points.iter().for_each(|(pixel, point)| depths[*pixel] = pinhole.camera_point(point.position)[2]);
    let mut is_kept = vec![false; depths.len()];
    let mut is_visited = is_kept.clone();
    for (start, _) in &*points {
        let mut patch = Vec::new();
        let mut open = vec![*start];
        while let Some(pixel) = open.pop() {
            if std::mem::replace(&mut is_visited[pixel], true) {
                continue;
            }
            patch.push(pixel);
            let (x, y) = (pixel % width, pixel / width);
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    let other = y * width + x;
                    let is_near = (depths[other] / depths[pixel] - 1.0).abs() < rule.same_depth;
                    if !is_visited[other] && depths[other] > 0.0 && is_near {
                        open.push(other);
                    }
                }
            }
        }
        if patch.len() >= rule.min_pixels {
            patch.iter().for_each(|&pixel| is_kept[pixel] = true);
        }
    }
    points.retain(|&(pixel, _)| is_kept[pixel]);
}

/// The point of another view where `point` falls into its image, and the pixel, if it is the same point.
fn seen_by(
    other: &Vantage,
    belief: &Belief,
    rule: &Rule,
    point: [f32; 3],
    pinhole: &Pinhole<f32>,
    place: [f32; 2],
) -> Option<([f32; 3], usize)> {
    let ([x, y], depth) = other.pinhole.project(point)?;
    let (at, _) = other.pinhole.pixel(point)?;
    let plane = belief.planes[at];
    let [cx, cy] = other.pinhole.pixel_center(at);
    let inverse_depth = plane.inverse_depth + plane.gradient[0] * (x - cx) + plane.gradient[1] * (y - cy);
    if !belief.known[at] || (inverse_depth * depth - 1.0).abs() > rule.same_depth {
        return None;
    }
    let theirs = other.pinhole.unproject([x, y], 1.0 / inverse_depth);
    let (back, _) = pinhole.project(theirs)?;
    let miss = (back[0] - place[0]).hypot(back[1] - place[1]);
    (miss <= rule.same_place_px).then_some((theirs, at))
}

/// Number of views from which a point would hide a sure depth.
pub(super) fn num_hidden_from(vantages: &[Vantage], sure: &[SureDepths], point: [f32; 3]) -> usize {
    let hides = |(vantage, sure): &(&Vantage, &SureDepths)| {
        vantage.pinhole.pixel(point).is_some_and(|(at, depth)| sure.depths[at] > depth * (1.0 + HIDING))
    };
    vantages.iter().zip(sure).filter(hides).count()
}

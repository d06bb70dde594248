//! Scenes of version 2: cohorts that come and go, lives, further attributes that Gaussians may lack.

use std::sync::Arc;

use tcgs_codec::{BitMap, ColorSpace, CompactScene, Quantizer, Quantizers, SceneInfo, Tracks, UpAxis};
use tcgs_core::{Activation, Attribute, Column, Layout, Life, Lives};

use super::any_scene::Numbers;
use super::corner_scenes;

/// A file of version 2: its description, and its cohorts.
pub type File = (SceneInfo, Vec<CompactScene>);

/// Properties of a cohort; everything else is random.
#[derive(Clone)]
struct Shape {
    start: u32,
    num_timesteps: u32,
    segment_length: u32,
    layers: Vec<u32>,
    layout: Arc<Layout>,
    has_lives: bool,
    /// Approximate number of Gaussians in ten that lack a further attribute.
    lacking: u64,
    /// Whether no attribute varies.
    is_still: bool,
}

impl Shape {
    /// Timesteps `start..start + num_timesteps`, one layer, five attributes, and no lives.
    fn new(num_gaussians: u32, start: u32, num_timesteps: u32) -> Self {
        let layers = vec![num_gaussians];
        let layout = Layout::base();
        Self { start, num_timesteps, segment_length: 4, layers, layout, has_lives: false, lacking: 0, is_still: false }
    }
}

/// A layout with attributes beyond the five, by name, components, activation, and whether they vary.
fn with_columns(columns: &[(&str, usize, Activation, bool)]) -> Arc<Layout> {
    let mut layout = Layout::default();
    for &(name, components, activation, varies) in columns {
        let unit = format!("unit of {name}");
        layout.push(name, components, Column { activation, unit, varies, ..Column::like(Attribute::Color) });
    }
    Arc::new(layout)
}

fn info(num_gaussians: u32, num_timesteps: u32) -> SceneInfo {
    SceneInfo {
        num_gaussians,
        num_timesteps,
        first_frame: 0,
        frame_rate: 30.0,
        downscale: 1,
        name: String::new(),
        generator: "vectors".into(),
        color_space: ColorSpace::Srgb,
        up: UpAxis::MinusY,
    }
}

/// A file of some cohorts.
///
/// - `further`: timesteps after the last cohort
fn file(cohorts: Vec<CompactScene>, further: u32) -> File {
    let num_gaussians = cohorts.iter().map(|cohort| cohort.info.num_gaussians).sum();
    let end = cohorts.iter().map(|cohort| cohort.start + cohort.info.num_timesteps).max();
    (info(num_gaussians, end.unwrap_or(0) + further), cohorts)
}

/// Widths of codes. All have quantizers, even unused ones, so that cohorts may share a plan.
const WIDTHS: [u8; 3] = [3, 6, 9];

fn cohort(shape: &Shape, random: &mut Numbers) -> CompactScene {
    let num_gaussians = shape.layers.iter().sum::<u32>() as usize;
    let layout = &shape.layout;
    let is_further = |a: Attribute| matches!(a, Attribute::Extra { .. });
    let varies_by_name = |a| if is_further(a) { layout.column(a).varies } else { a != Attribute::LogScale };
    let varies = |a| !shape.is_still && shape.num_timesteps > 1 && varies_by_name(a);
    let mut scene = CompactScene {
        layout: Arc::clone(layout),
        info: info(num_gaussians as u32, shape.num_timesteps),
        start: shape.start,
        lives: shape.has_lives.then(|| lives_of(num_gaussians, shape.num_timesteps, random)),
        bit_map: BitMap::default(),
        quantizers: Quantizers { attributes: Vec::new() },
        varies: layout.attributes().map(varies).collect(),
        layers: shape.layers.clone(),
        segment_length: shape.segment_length,
        tracks: Vec::new(),
    };
    let mut widths = Vec::new();
    for attribute in layout.attributes() {
        let quantizers = WIDTHS.map(|width| {
            // The range of means, and of all other attributes.
            let range = [4.0, 2.0][attribute.index().min(1)];
            let quantizer = |c| Quantizer::new(range / f32::from(1_u16 << width), 0.125 * c as f32, width).unwrap();
            (width, (0..attribute.components()).map(quantizer).collect())
        });
        scene.quantizers.attributes.push(quantizers.into());
        let lacking = if is_further(attribute) { shape.lacking } else { 0 };
        let width = |_| if random.below(10) < lacking { 0 } else { WIDTHS[random.below(3) as usize] };
        widths.push((0..num_gaussians).map(width).collect::<Vec<u8>>());
        let tracks = tracks(&scene, attribute, &widths[attribute.index()], random);
        scene.tracks.push(tracks);
    }
    scene.bit_map = BitMap::new(Arc::clone(layout), widths);
    scene
}

fn lives_of(num_gaussians: usize, num_timesteps: u32, random: &mut Numbers) -> Lives {
    let mut lives: Lives = (0..num_gaussians).map(|_| life(num_timesteps, random)).collect();
    // No Gaussian is predicted from the last one, so `forge_v2.py` lets it move within its only timestep.
    lives.0[num_gaussians - 1] = Life { birth: 6, death: 7 };
    lives
}

/// One timestep, from the first, to the last, all or any.
fn life(num_timesteps: u32, random: &mut Numbers) -> Life {
    let last = num_timesteps - 1;
    let mut any = || random.below(u64::from(num_timesteps)) as u32;
    let (one, other) = (any(), any());
    let [birth, last] = match random.below(6) {
        0 => [one, one],
        1 => [0, one],
        2 => [one, last],
        3 => [0, last],
        _ => [one.min(other), one.max(other)],
    };
    Life { birth, death: last + 1 }
}

/// Tracks that mostly move with those of other Gaussians. Opacities, and attributes with an odd index, have separate
/// times for every component; the others share them.
fn tracks(scene: &CompactScene, attribute: Attribute, widths: &[u8], random: &mut Numbers) -> Tracks<i16> {
    let (index, components) = (attribute.index(), attribute.components());
    let mut tracks = Tracks::default();
    let drift: Vec<i64> = (0..components).map(|_| random.below(9) as i64 - 4).collect();
    for (gaussian, &width) in widths.iter().enumerate() {
        let whole = Life { birth: 0, death: scene.info.num_timesteps };
        let life = scene.lives.as_ref().map_or(whole, |lives| lives[gaussian]);
        let [first, last] = [life.birth, life.death - 1].map(|t| t as u16);
        let moves = scene.varies[index] && first < last && width > 0 && random.below(4) > 0;
        let mut times = vec![0];
        for (c, drift) in drift.iter().enumerate() {
            if moves && (c == 0 || index % 2 == 1) {
                let share = random.below(4);
                times = (first..=last).filter(|&t| t == first || t == last || random.below(4) < share).collect();
            }
            if width == 0 {
                tracks.push(&[0], &[0]);
                continue;
            }
            let half = 1_i64 << (width - 1);
            let start = random.below(2 * half as u64) as i64 - half;
            let code = |&t: &u16| {
                let line = start + drift * (i64::from(t) - i64::from(times[0])) * half / 32;
                (line + random.below(2) as i64).clamp(-half, half - 1) as i16
            };
            tracks.push(&times, &times.iter().map(code).collect::<Vec<i16>>());
        }
    }
    tracks
}

/// The Gaussian of version 1's file of this name, at timesteps 1 and 2 of three.
pub fn one_gaussian() -> File {
    file(vec![CompactScene { start: 1, ..corner_scenes::one_gaussian() }], 0)
}

/// A file without cohorts.
pub fn no_cohorts() -> File {
    file(vec![], 2)
}

/// Four cohorts with interleaved segments; two begin at the same timestep, and one follows after a gap.
pub fn cohorts() -> File {
    let random = &mut Numbers(30);
    let spans = [(7, 0, 13), (5, 3, 9), (6, 3, 4), (1, 5, 1), (4, 15, 6)];
    let shape = |(num_gaussians, start, num_timesteps)| Shape::new(num_gaussians, start, num_timesteps);
    file(spans.map(|span| cohort(&shape(span), random)).into(), 2)
}

/// Gaussians that come and go within their cohort: for one timestep, at its ends, and within one segment.
pub fn lives() -> File {
    let random = &mut Numbers(31);
    file(vec![cohort(&Shape { has_lives: true, ..Shape::new(30, 2, 19) }, random)], 0)
}

/// Further attributes, some of which Gaussians may lack.
pub fn sparse() -> File {
    let random = &mut Numbers(32);
    let layout = with_columns(&[
        ("wetness", 2, Activation::Sigmoid, true),
        ("normal", 3, Activation::Normalize, true),
        ("label", 1, Activation::Identity, false),
        ("glow", 5, Activation::Exp, true),
    ]);
    file(vec![cohort(&Shape { layout, lacking: 4, ..Shape::new(24, 0, 6) }, random)], 0)
}

/// Spherical harmonics of degree 3 as in 3D Gaussian splatting. One band varies, and Gaussians may lack any.
pub fn harmonics() -> File {
    let random = &mut Numbers(33);
    let bands = [("sh1", 9, true), ("sh2", 15, false), ("sh3", 21, false)];
    let layout = with_columns(&bands.map(|(name, count, varies)| (name, count, Activation::Identity, varies)));
    file(vec![cohort(&Shape { layout, lacking: 2, ..Shape::new(12, 0, 5) }, random)], 0)
}

/// Two plans: the second and the last cohort use that of the first, the fourth uses that of the third.
pub fn shared_plan() -> File {
    let random = &mut Numbers(34);
    let shape = |start, further| {
        let layout = with_columns(&[("wetness", 2, Activation::Sigmoid, false)]);
        Shape { layout, lacking: further, ..Shape::new(9, start, 7) }
    };
    let shapes = [shape(0, 0), shape(2, 0), shape(4, 5), shape(4, 5), shape(6, 0)];
    file(shapes.iter().map(|shape| cohort(shape, random)).collect(), 0)
}

/// Three layers in segments, with lives and an attribute of the largest number of components.
pub fn layers() -> File {
    let random = &mut Numbers(35);
    let layout = with_columns(&[("spectrum", 32, Activation::Identity, true)]);
    let shape = Shape { layout, has_lives: true, lacking: 3, layers: vec![4, 8, 12], ..Shape::new(0, 1, 9) };
    file(vec![cohort(&shape, random)], 0)
}

/// Two layers in which nothing varies, so that there is one segment, whatever its length. `forge_v2.py` adds an
/// attribute to skip, which varies.
pub fn still() -> File {
    let random = &mut Numbers(37);
    file(vec![cohort(&Shape { is_still: true, layers: vec![2, 3], ..Shape::new(0, 1, 10) }, random)], 0)
}

/// Two antialiased cohorts, one with lives.
pub fn antialiased() -> File {
    let random = &mut Numbers(38);
    let shape =
        |start, has_lives| Shape { layout: Layout::base().antialiased(true), has_lives, ..Shape::new(6, start, 7) };
    file(vec![cohort(&shape(0, true), random), cohort(&shape(5, false), random)], 0)
}

/// Frames of a flip-book: one cohort per timestep, each with a different number of Gaussians, and one timestep with
/// none.
pub fn flip_book() -> File {
    let random = &mut Numbers(36);
    let frames = [(5, 0), (9, 1), (2, 2), (40, 4), (1, 5)];
    file(frames.map(|(num_gaussians, start)| cohort(&Shape::new(num_gaussians, start, 1), random)).into(), 0)
}

//! Files to play, and sources that behave as networks do.

#![allow(dead_code)] // a bench uses a part
#![allow(clippy::unwrap_used)] // clippy does not count a bench as a test

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;
use std::sync::Arc;

use tcgs_codec::{BitMap, CompactScene, CompressSettings, SceneInfo, compress, encode, encode_cohorts};
use tcgs_core::{DynamicGaussians, Gaussians, Layout, Life};
use tcgs_play::{BytesSource, Piece, Player, PlayerSettings, RangeSource, SourceError};

#[path = "../../../../codec/tests/suite/support/scenes.rs"]
pub mod scenes;

/// The file of a room with a moving part.
pub fn room_file(num_gaussians: usize, num_timesteps: usize, settings: &CompressSettings) -> Vec<u8> {
    let scene = scenes::room(num_gaussians, num_timesteps);
    let compact = compress(&scene, &scenes::mixed_widths(num_gaussians), None, SceneInfo::of(&scene), settings);
    encode(&compact.unwrap()).unwrap()
}

/// A file of many small segments.
pub fn small_file() -> Vec<u8> {
    room_file(400, 40, &CompressSettings { segment_length: Some(5), ..Default::default() })
}

/// Part of a room with the columns of a layout, moved sideways.
fn room_like(layout: &Arc<Layout>, num_gaussians: usize, num_timesteps: usize, aside: f32) -> DynamicGaussians {
    let room = scenes::room(num_gaussians, num_timesteps);
    let mut scene = DynamicGaussians::new(Arc::clone(layout));
    for timestep in 0..num_timesteps {
        let mut now: Gaussians = room.at(timestep).extended(layout);
        now.means_mut().iter_mut().for_each(|mean| mean[0] += aside);
        for band in layout.harmonics() {
            let values = now.values_mut(band).iter_mut().enumerate();
            values.for_each(|(i, value)| *value = 0.3 * (0.7 * i as f32 + band.components() as f32).sin());
        }
        scene.push(now);
    }
    scene
}

/// Twelve timesteps of version 2, in three kinds of cohort:
/// - a room with the columns of `layout` that lives throughout, in segments of five timesteps;
/// - another one that lives from timestep 3 to 8, in which half of the Gaussians come and go;
/// - at each timestep some Gaussians of its own, more and more.
pub fn cohorts_file(num_gaussians: usize, layout: &Arc<Layout>) -> Vec<u8> {
    let cohort = |n: usize, start: u32, num_timesteps: usize, aside: f32| {
        let scene = room_like(layout, n, num_timesteps, aside);
        let bits = BitMap::uniform_of(scene.layout(), n, 16, 8);
        let settings = CompressSettings { segment_length: Some(5), ..CompressSettings::default() };
        CompactScene { start, ..compress(&scene, &bits, None, SceneInfo::of(&scene), &settings).unwrap() }
    };
    let n = num_gaussians;
    let mut cohorts = vec![cohort(n, 0, 12, 0.0)];
    let life = |g: usize| [(0, 6), (1, 4), (2, 3), (0, 6)][g % 4];
    let lives = (0..n / 2).map(life).map(|(birth, death)| Life { birth, death }).collect();
    let brief = cohort(n / 2, 3, 6, 1.0).with_lives(lives);
    cohorts.extend((0..12).map(|t| cohort(n / 8 + 10 * t as usize, t, 1, 0.1 * t as f32 - 2.0)));
    cohorts.push(brief);
    cohorts.sort_by_key(|cohort| cohort.start);
    let num_gaussians = cohorts.iter().map(|cohort| cohort.info.num_gaussians).sum();
    let info = SceneInfo { num_gaussians, num_timesteps: 12, ..cohorts[0].info.clone() };
    encode_cohorts(&info, &cohorts, &[]).unwrap()
}

/// How a network behaves.
#[derive(Clone, Debug, Default)]
pub struct Behaviour {
    /// Bytes per piece; 0: all at once.
    pub piece: usize,
    /// Number of empty polls between two pieces.
    pub stalls: usize,
    /// The file appears to end here.
    pub ends_at: Option<u64>,
    /// Whether the server hides the length.
    pub hides_length: bool,
    /// Number of broken connections, each after a piece.
    pub breaks: usize,
}

/// The ranges requested from a network.
#[derive(Clone, Debug, Default)]
pub struct Log(Rc<RefCell<Vec<Range<u64>>>>);

impl Log {
    pub fn ranges(&self) -> Vec<Range<u64>> {
        self.0.borrow().clone()
    }
}

/// A server with ranges and the given behaviour.
pub struct Network {
    inner: BytesSource,
    behaviour: Behaviour,
    rest: Range<u64>,
    stalled: usize,
    arrived: bool,
    pub log: Log,
}

impl Network {
    pub fn new(file: &[u8], behaviour: Behaviour) -> Self {
        let end = behaviour.ends_at.map_or(file.len(), |end| end as usize);
        let inner = BytesSource::new(&file[..end]);
        Self { inner, behaviour, rest: 0..0, stalled: 0, arrived: false, log: Log::default() }
    }
}

impl RangeSource for Network {
    fn request(&mut self, range: Range<u64>) {
        assert!(!range.is_empty(), "a request for nothing");
        self.log.0.borrow_mut().push(range.clone());
        self.rest = range;
        self.stalled = 0;
        self.arrived = false;
    }

    fn poll(&mut self) -> Result<Piece, SourceError> {
        if self.stalled < self.behaviour.stalls {
            self.stalled += 1;
            return Ok(Piece::Waiting);
        }
        self.stalled = 0;
        if self.arrived && self.behaviour.breaks > 0 {
            self.behaviour.breaks -= 1;
            self.rest = 0..0;
            return Err(SourceError::Interrupted { what: "a network".into(), problem: "it broke".into() });
        }
        let piece = if self.behaviour.piece == 0 { u64::MAX } else { self.behaviour.piece as u64 };
        let end = self.rest.end.min(self.rest.start.saturating_add(piece));
        if self.rest.start == end {
            return Ok(Piece::End);
        }
        self.inner.request(self.rest.start..end);
        self.rest.start = end;
        self.arrived = true;
        self.inner.poll()
    }

    fn length(&self) -> Option<u64> {
        if self.behaviour.hides_length { None } else { self.inner.length() }
    }
}

/// Updates until all layers of the due timestep are decoded; asserts that this ends.
pub fn wait<S: RangeSource>(player: &mut Player<S>, now_ms: &mut f64) {
    for _ in 0..10_000_000 {
        player.update(*now_ms).unwrap();
        if player.current().is_some_and(|moment| moment.is_whole) {
            return;
        }
        *now_ms += 1.0;
    }
    panic!("nothing came");
}

/// The first request is shorter than the tables, so that small files need several requests too.
pub fn settings(max_segment_bytes: usize) -> PlayerSettings {
    PlayerSettings { max_segment_bytes, opening_bytes: 100, ..Default::default() }
}

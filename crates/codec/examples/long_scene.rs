//! Makes a long scene in which Gaussians come and go, writes it cohort by cohort, and shows the cost of reading one of
//! its timesteps.
//!
//! ```sh
//! cargo run --release --example long_scene -p tcgs-codec -- 10000 1.0 long.tcgs
//! ```
//!
//! Arguments: timesteps, size (1: about a million Gaussians, 50,000 alive at a time), file.

use std::cell::Cell;
use std::convert::Infallible;
use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom};
use std::sync::Arc;
use std::time::Instant;

use tcgs_codec::{
    BitMap, CompactScene, CompressSettings, Contemporaries, DecodeLimits, FileWriter, SceneFile, SceneInfo,
    SegmentCache, compress_reader, contemporaries,
};
use tcgs_core::{DynamicGaussians, Gaussians, Layout, Life, Lives, SceneReader};

/// Longest life of the lowest level, timesteps.
const SHORTEST: usize = 40;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [timesteps, size, path] = &arguments[..] else { return Err("expected: timesteps, size, file".into()) };
    let (num_timesteps, size): (u32, f64) = (timesteps.parse()?, size.parse()?);
    let begin = Instant::now();
    let lives = lives(num_timesteps, size);
    let cohorts = contemporaries(&lives, SHORTEST);
    let info =
        SceneInfo { num_gaussians: lives.len() as u32, num_timesteps, ..SceneInfo::of(&DynamicGaussians::default()) };
    let mut file = BufWriter::new(File::create(path)?);
    let mut writer = FileWriter::new(&mut file, &info, &[], cohorts.len())?;
    let mut raw = 0_u64;
    for cohort in &cohorts {
        let mut scene = Made::new(&lives, cohort);
        let num_gaussians = cohort.gaussians.len();
        let (num_timesteps, bits) = (cohort.timesteps.len() as u32, BitMap::uniform(num_gaussians, 16, 6));
        let of_cohort = SceneInfo { num_gaussians: num_gaussians as u32, num_timesteps, ..info.clone() };
        let (compact, order) = compress_reader(&mut scene, &bits, None, of_cohort, &CompressSettings::default())?;
        let (start, end) = (cohort.timesteps.start as u32, cohort.timesteps.end as u32);
        let own: Lives = order.iter().map(|&g| lives[cohort.gaussians[g]].within(start..end)).collect();
        raw += own.iter().map(|life| 40 * u64::from(life.death - life.birth) + 16).sum::<u64>();
        let compact = CompactScene { start, ..compact.with_lives(own) };
        writer.add(&compact)?;
    }
    writer.finish()?;
    drop(file);
    let bytes = std::fs::metadata(path)?.len();
    println!(
        "{} Gaussians in {} cohorts, {num_timesteps} timesteps: {bytes} bytes, 1/{} of {raw}, written in {:.0} s, at most {} MB",
        lives.len(),
        cohorts.len(),
        raw / bytes,
        begin.elapsed().as_secs_f64(),
        most_memory()? >> 20
    );

    let read = Cell::new(0);
    let source = Counted { file: File::open(path)?, bytes: &read };
    let begin = Instant::now();
    let mut scene = SceneFile::open(source, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES)?;
    let opened = read.get();
    let timestep = num_timesteps as usize * 7 / 10;
    let now = scene.at(timestep)?;
    println!(
        "opened with {opened} bytes; timestep {timestep}: {} Gaussians, {} bytes in all, {:.2} % of the file, {:.0} ms",
        now.num_gaussians(),
        read.get(),
        100.0 * read.get() as f64 / bytes as f64,
        1e3 * begin.elapsed().as_secs_f64()
    );
    Ok(())
}

/// Some Gaussians live throughout, some for a fifth of the time, most for a moment.
fn lives(num_timesteps: u32, size: f64) -> Lives {
    let mut lives = vec![Life { birth: 0, death: num_timesteps }; (20_000.0 * size) as usize];
    // Number alive at a time, and mean length of a life.
    for (alive, length) in [(15_000.0 * size, num_timesteps / 5), (15_000.0 * size, num_timesteps / 65)] {
        let length = length.max(1);
        let count = (alive * f64::from(num_timesteps) / f64::from(length)) as u32;
        lives.extend((0..count).map(|i| {
            let birth = (f64::from(i) / f64::from(count) * f64::from(num_timesteps)) as u32;
            let last = birth + length / 2 + (random(i.into()) * length as f32) as u32;
            Life { birth, death: (last + 1).min(num_timesteps) }
        }));
    }
    Lives(lives)
}

/// Gaussians of a cohort, made on request.
struct Made<'a> {
    lives: &'a Lives,
    cohort: &'a Contemporaries,
    /// Gaussians at the beginnings of their lives.
    first: Gaussians,
}

impl<'a> Made<'a> {
    fn new(lives: &'a Lives, cohort: &'a Contemporaries) -> Self {
        let mut first = Gaussians::zeros(cohort.gaussians.len());
        for (row, &g) in cohort.gaussians.iter().enumerate() {
            let r = |i: u64| random(g as u64 * 16 + i) - 0.5;
            first.means_mut()[row] = [8.0 * r(0), 8.0 * r(1), 4.0 * r(2)];
            first.quats_mut()[row] = [1.0, r(3), r(4), r(5)];
            first.log_scales_mut()[row] = [9, 10, 11].map(|i| -3.5 + r(i));
            first.logit_opacities_mut()[row] = 4.0 * r(12) + 1.0;
            first.colors_mut()[row] = [13, 14, 15].map(|i| 0.5 + 0.8 * r(i));
        }
        Self { lives, cohort, first }
    }
}

impl SceneReader for Made<'_> {
    type Error = Infallible;

    fn layout(&self) -> &Arc<Layout> {
        self.first.layout()
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.cohort.gaussians.len()
    }

    fn num_timesteps(&self) -> usize {
        self.cohort.timesteps.len()
    }

    /// Before and after its life a Gaussian has the values at its ends.
    fn at(&mut self, timestep: usize) -> Result<Gaussians, Infallible> {
        let (timestep, mut now) = (self.cohort.timesteps.start + timestep, self.first.clone());
        for (row, &g) in self.cohort.gaussians.iter().enumerate() {
            let [birth, death] = [self.lives[g].birth, self.lives[g].death].map(|t| t as usize);
            // Gaussians born at timestep 0 stand still.
            if birth == 0 {
                continue;
            }
            let r = |i: u64| random(g as u64 * 16 + i) - 0.5;
            let age = (timestep.clamp(birth, death - 1) - birth) as f32;
            let angle = age * (0.05 + 0.1 * r(6)) + 6.0 * r(7);
            let path = [angle.cos(), angle.sin(), (0.7 * angle).cos()];
            (0..3).for_each(|i| now.means_mut()[row][i] += 0.3 * path[i] + 0.01 * r(8 + i as u64) * age);
            now.quats_mut()[row][1] += 0.3 * angle.sin();
        }
        Ok(now)
    }
}

/// splitmix64 (Steele et al. 2014), as a number in [0, 1).
fn random(seed: u64) -> f32 {
    let mut z = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 40) as f32 / (1 << 24) as f32
}

/// Peak memory of the process, bytes; 0 where the system does not report it.
fn most_memory() -> Result<u64, Box<dyn Error>> {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.map_or(Ok(0), |line| Ok(line.trim().trim_end_matches(" kB").parse::<u64>()? << 10))
}

/// Counts the bytes that are read.
struct Counted<'a> {
    file: File,
    bytes: &'a Cell<u64>,
}

impl Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.bytes.set(self.bytes.get() + count as u64);
        Ok(count)
    }
}

impl Seek for Counted<'_> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

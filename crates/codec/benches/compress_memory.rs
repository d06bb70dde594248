//! Memory of compressing a scene that is read one timestep at a time.
//!
//! `cargo bench -p tcgs-codec --bench compress_memory` prints the peak memory of the process. `TCGS_GAUSSIANS` and
//! `TCGS_TIMESTEPS` set the size: `50000` and `3000` are a scene of 6 GB of floats. `TCGS_WHOLE=1` compresses the same
//! scene from memory, for comparison.

use std::convert::Infallible;
use std::io::Cursor;
use std::sync::Arc;
use std::time::Instant;

use tcgs_codec::{
    CompressSettings, DecodeLimits, SceneFile, SceneInfo, SegmentCache, compress_ordered, compress_reader, encode_to,
};
use tcgs_core::{DynamicGaussians, Gaussians, Layout, SceneReader};

#[path = "../tests/suite/support/scenes.rs"]
mod scenes;

/// A room in which a twentieth of the Gaussians move all the time. The rest trembles by a tenth of the tolerances, like
/// still Gaussians in an optimisation.
struct Made {
    base: Gaussians,
    num_timesteps: usize,
}

impl SceneReader for Made {
    type Error = Infallible;

    fn layout(&self) -> &Arc<Layout> {
        self.base.layout()
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.base.num_gaussians()
    }

    fn num_timesteps(&self) -> usize {
        self.num_timesteps
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, Infallible> {
        let mut now = self.base.clone();
        let num_moving = now.num_gaussians() / 20;
        let secs = timestep as f32 / 30.0;
        let mut state = timestep as u64;
        let mut noise = |size: f32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            size * ((state >> 40) as f32 / (1 << 24) as f32 - 0.5)
        };
        for (i, mean) in now.means_mut().iter_mut().enumerate() {
            if i < num_moving {
                mean[0] += 0.6 * (2.0 * secs + i as f32).sin();
                mean[1] += 0.3 * (3.1 * secs).cos();
            }
            *mean = mean.map(|x| x + noise(3e-4));
        }
        for quat in now.quats_mut() {
            *quat = quat.map(|x| x + noise(1e-3));
        }
        for (i, color) in now.colors_mut().iter_mut().enumerate() {
            let shade = if i < num_moving { 0.1 * (1.3 * secs + i as f32).sin() } else { 0.0 };
            *color = color.map(|x| x + shade + noise(2e-3));
        }
        Ok(now)
    }
}

fn main() {
    let size = |name: &str, default: usize| {
        std::env::var(name).map_or(default, |text| text.parse().expect("a number of Gaussians or timesteps"))
    };
    let (num_gaussians, num_timesteps) = (size("TCGS_GAUSSIANS", 50_000), size("TCGS_TIMESTEPS", 100));
    let mut made = Made { base: scenes::room(num_gaussians, 1).at(0), num_timesteps };
    let mut one = DynamicGaussians::default();
    one.push(made.base.clone());
    let info = SceneInfo { num_timesteps: num_timesteps as u32, ..SceneInfo::of(&one) };
    let (bit_map, settings) = (scenes::mixed_widths(num_gaussians), CompressSettings::default());
    let begin = Instant::now();
    let (compact, order) = if std::env::var_os("TCGS_WHOLE").is_some() {
        let mut whole = DynamicGaussians::default();
        (0..num_timesteps).for_each(|t| made.at(t).map_or_else(|never| match never {}, |now| whole.push(now)));
        compress_ordered(&whole, &bit_map, None, info, &settings).expect("a legal scene")
    } else {
        compress_reader(&mut made, &bit_map, None, info, &settings).expect("a legal scene")
    };
    let compressed = begin.elapsed();
    let mut file = Cursor::new(Vec::new());
    encode_to(&compact, &[], &mut file).expect("a legal scene");
    let encoded = begin.elapsed() - compressed;
    let last = compact.at(num_timesteps - 1);
    drop(compact);
    println!(
        "{num_gaussians} Gaussians, {num_timesteps} timesteps: {} bytes, compressed in {compressed:.1?}, encoded in \
         {encoded:.1?}, at most {} MiB held",
        file.get_ref().len(),
        peak_mib().map_or_else(|| "unknown".to_owned(), |mib| mib.to_string())
    );
    // Checks one timestep of the file against the scene, within the tolerances.
    let mut file =
        SceneFile::open(file, &DecodeLimits::none(), SegmentCache::DEFAULT_BYTES).expect("a file just written");
    let found = file.at(num_timesteps - 1).expect("a file just written");
    assert_eq!(found, last);
    let Ok(expected) = made.at(num_timesteps - 1);
    let squared =
        |i: usize, g: usize| (0..3).map(|c| (found.means()[i][c] - expected.means()[g][c]).powi(2)).sum::<f32>();
    let mse = order.iter().enumerate().map(|(i, &g)| squared(i, g)).sum::<f32>() / num_gaussians as f32;
    assert!(mse < 1e-3, "a mean squared distance of {mse}");
}

/// Peak memory of the process; known on Linux.
fn peak_mib() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<usize>().ok().map(|kib| kib / 1024)
}

//! Damaged files: whatever bytes change, reading gives finite numbers or one line, and never panics.

use tcgs_core::{Gaussians, SceneReader};
use tcgs_interchange::{FourdgsFile, InterchangeError, ReadSettings, read_gaussians};

use super::{ONE_TIMESTEP, SCENES, file};

/// A linear congruential generator.
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % end.max(1)
    }

    /// Some bytes changed, most of them near the start, where headers are; some cut away.
    fn mutant(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        for _ in 0..=self.below(4) {
            let end = if self.below(3) == 0 { bytes.len() } else { bytes.len().min(1500) };
            let at = self.below(end);
            bytes[at] = match self.below(3) {
                0 => [0, 1, 127, 128, 255][self.below(5)],
                1 => bytes[at] ^ (1 << self.below(8)),
                _ => b"0123456789"[self.below(10)],
            };
        }
        if self.below(8) == 0 {
            bytes.truncate(self.below(bytes.len()).max(1));
        }
        bytes
    }
}

/// Asserts the invariants of every answer; returns whether there was a scene.
fn is_right(answer: Result<Gaussians, InterchangeError>) -> bool {
    match answer {
        Ok(gaussians) => {
            let is_finite = |a| gaussians.values(a).iter().all(|x: &f32| x.is_finite());
            assert!(gaussians.layout().attributes().all(is_finite));
            true
        }
        Err(error) => {
            assert!(!error.to_string().contains('\n'), "{error}");
            false
        }
    }
}

#[test]
fn damaged_files_of_one_timestep_do_no_harm() {
    for (seed, name) in ONE_TIMESTEP.into_iter().enumerate() {
        // The name tells some kinds.
        let ending = &name[name.rfind('.').unwrap()..];
        let target = tempfile::Builder::new().suffix(ending).tempfile().unwrap();
        let (bytes, mut random) = (std::fs::read(file(name)).unwrap(), Random(seed as u64));
        let mut refused = 0;
        for _ in 0..400 {
            std::fs::write(target.path(), random.mutant(&bytes)).unwrap();
            refused += usize::from(!is_right(read_gaussians(target.path(), ReadSettings::default())));
        }
        assert!(refused > 0, "{name}: no mutant was refused");
    }
}

#[test]
fn damaged_files_of_whole_scenes_do_no_harm() {
    let target = tempfile::NamedTempFile::new().unwrap();
    for (seed, name) in SCENES.into_iter().enumerate() {
        let (bytes, mut random) = (std::fs::read(file(name)).unwrap(), Random(seed as u64));
        let mut refused = 0;
        for _ in 0..150 {
            std::fs::write(target.path(), random.mutant(&bytes)).unwrap();
            match FourdgsFile::open(target.path(), ReadSettings::default()) {
                Ok(mut scene) => {
                    let last = scene.num_timesteps() - 1;
                    for timestep in [0, last] {
                        let gaussians = SceneReader::at(&mut scene, timestep);
                        is_right(gaussians);
                    }
                }
                Err(error) => refused += usize::from(!is_right(Err(error))),
            }
        }
        assert!(refused > 0, "{name}: no mutant was refused");
    }
}

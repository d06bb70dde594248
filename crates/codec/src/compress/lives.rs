//! Gaussians that live for only a part of the timesteps.

use crate::compact::{CompactScene, Tracks};

impl CompactScene {
    /// Restricts each Gaussian to a life with its own first and last timestep. Keypoints outside the life are dropped;
    /// at both ends of the life tracks keep their values, rounded to codes.
    ///
    /// - `lives`: `[N]` first and last timestep
    ///
    /// ```
    /// use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress};
    /// use tcgs_core::{DynamicGaussians, Gaussians};
    /// let mut scene = DynamicGaussians::default();
    /// (0..4).for_each(|_| scene.push(Gaussians::zeros(1)));
    /// let map = BitMap::uniform(1, 16, 6);
    /// let compact = compress(&scene, &map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
    /// assert_eq!(compact.with_lives(vec![[1, 2]]).lives, Some(vec![[1, 2]]));
    /// # Ok::<(), tcgs_codec::CompressError>(())
    /// ```
    ///
    /// # Panics
    /// If `lives` has not one life for each Gaussian, or a life is not within the timesteps.
    pub fn with_lives(mut self, lives: Vec<[u16; 2]>) -> Self {
        let num_timesteps = self.num_timesteps();
        assert_eq!(lives.len(), self.num_gaussians(), "a life for each Gaussian");
        assert!(lives.iter().all(|l| l[0] <= l[1] && usize::from(l[1]) < num_timesteps), "lives within the timesteps");
        for attribute in self.layout.attributes() {
            let tracks = &self.tracks[attribute.index()];
            let components = attribute.components();
            let mut restricted = Tracks::default();
            for (gaussian, &life) in lives.iter().enumerate() {
                let own: Vec<Track> =
                    (0..components).map(|c| restrict(tracks.track(gaussian * components + c), life)).collect();
                // Components that share their times must continue to do so.
                let is_still = own.iter().all(|(_, codes)| codes.iter().all(|&code| code == codes[0]));
                for (times, codes) in own {
                    if is_still {
                        restricted.push(&[0], &codes[..1]);
                    } else {
                        restricted.push(&times, &codes);
                    }
                }
            }
            self.tracks[attribute.index()] = restricted;
        }
        self.lives = Some(lives);
        self
    }
}

/// Times and codes of a track.
type Track = (Vec<u16>, Vec<i16>);

/// The part of a track within a life; its ends become keypoints.
fn restrict((times, codes): (&[u16], &[i16]), [birth, death]: [u16; 2]) -> Track {
    if times.len() == 1 || birth == death {
        return (vec![0], vec![code_at(times, codes, birth)]);
    }
    let inner = times.iter().zip(codes).filter(|(time, _)| birth < **time && **time < death);
    let (mut of_life, mut values) = (vec![birth], vec![code_at(times, codes, birth)]);
    of_life.extend(inner.clone().map(|(&time, _)| time));
    values.extend(inner.map(|(_, &code)| code));
    of_life.push(death);
    values.push(code_at(times, codes, death));
    (of_life, values)
}

/// The code nearest to a track's value at a timestep.
fn code_at(times: &[u16], codes: &[i16], timestep: u16) -> i16 {
    let after = times.partition_point(|&time| time <= timestep);
    let before = after.saturating_sub(1);
    let Some(&end) = times.get(after) else { return codes[before] };
    let share = f64::from(timestep - times[before]) / f64::from(end - times[before]);
    let [from, to] = [codes[before], codes[after]].map(f64::from);
    (from + (to - from) * share).round() as i16
}

//! Gaussians that live for only a part of the timesteps.

use tcgs_core::{Life, Lives};

use crate::compact::{CompactScene, Tracks};

impl CompactScene {
    /// Restricts each Gaussian to its life. Keypoints outside the life are dropped. At both ends of the life tracks
    /// keep their values, rounded to codes.
    ///
    /// - `lives`: `[N]`
    ///
    /// ```
    /// use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress};
    /// use tcgs_core::{DynamicGaussians, Gaussians, Life, Lives};
    /// let mut scene = DynamicGaussians::default();
    /// (0..4).for_each(|_| scene.push(Gaussians::zeros(1)));
    /// let map = BitMap::uniform(1, 16, 6);
    /// let compact = compress(&scene, &map, None, SceneInfo::of(&scene), &CompressSettings::default())?;
    /// let lives = Lives::from([Life { birth: 1, death: 3 }]);
    /// assert_eq!(compact.with_lives(lives.clone()).lives, Some(lives));
    /// # Ok::<(), tcgs_codec::CompressError>(())
    /// ```
    ///
    /// # Panics
    /// If `lives` has not one life for each Gaussian, or a life is not within the timesteps.
    pub fn with_lives(mut self, lives: Lives) -> Self {
        assert_eq!(lives.len(), self.num_gaussians(), "a life for each Gaussian");
        let is_within = |life: &Life| life.birth < life.death && life.death <= self.info.num_timesteps;
        assert!(lives.iter().all(is_within), "lives within the timesteps");
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

/// The part of a track within a life; its first and last timestep become keypoints.
fn restrict((times, codes): (&[u16], &[i16]), life: Life) -> Track {
    let [first, last] = [life.birth, life.death - 1].map(|t| t as u16);
    if times.len() == 1 || first == last {
        return (vec![0], vec![code_at(times, codes, first)]);
    }
    let inner = times.iter().zip(codes).filter(|(time, _)| first < **time && **time < last);
    let (mut of_life, mut values) = (vec![first], vec![code_at(times, codes, first)]);
    of_life.extend(inner.clone().map(|(&time, _)| time));
    values.extend(inner.map(|(_, &code)| code));
    of_life.push(last);
    values.push(code_at(times, codes, last));
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

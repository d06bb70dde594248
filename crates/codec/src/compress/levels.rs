//! Division of a long scene's Gaussians into cohorts, so that a timestep needs few Gaussians beyond those that live at
//! it.

use std::ops::Range;

use tcgs_core::Life;

/// Number of parts of a level's longest life; the Gaussians of a cohort are born within one part.
const BIRTHS: usize = 4;

/// Gaussians to be described together as a cohort.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contemporaries {
    /// Timesteps from the first birth up to the last death.
    pub timesteps: Range<usize>,
    /// Indices of the Gaussians, ascending.
    pub gaussians: Vec<usize>,
}

/// Divides Gaussians into cohorts by levels of time: Gaussians with lives of similar length, born at about the same
/// time, share a cohort.
///
/// Level `k` has lives of at most `shortest * 2^k` timesteps, and its cohorts group births within a quarter of that. So
/// at most six cohorts of each level live at a timestep. They hold at most 5 / 4 of the Gaussians born in such a life.
///
/// - `lives`: `[N]`, each with a death
/// - `shortest`: longest life of the lowest level, at least 1
/// - returns: cohorts by ascending first timestep
///
/// ```
/// use tcgs_core::Life;
/// let lives = [(0, 10_000), (5, 7), (7, 9), (5000, 5004)].map(|(birth, death)| Life { birth, death });
/// let cohorts = tcgs_codec::contemporaries(&lives, 60);
/// assert_eq!(cohorts.iter().map(|c| c.gaussians.len()).collect::<Vec<_>>(), [1, 2, 1]);
/// assert_eq!(cohorts[1].timesteps, 5..9);
/// ```
///
/// # Panics
/// If a life has no timestep, or `shortest` is 0.
pub fn contemporaries(lives: &[Life], shortest: usize) -> Vec<Contemporaries> {
    assert!(shortest > 0, "lives of no timestep");
    let mut cohorts = std::collections::BTreeMap::<(u32, usize), Contemporaries>::new();
    for (gaussian, life) in lives.iter().enumerate() {
        let [birth, death] = [life.birth, life.death].map(|t| t as usize);
        assert!(birth < death, "a life from {birth} up to {death}");
        let level = (death - birth).div_ceil(shortest).next_power_of_two().ilog2();
        let together = (shortest << level).div_ceil(BIRTHS);
        let fresh = || Contemporaries { timesteps: birth..death, gaussians: Vec::new() };
        let cohort = cohorts.entry((level, birth / together)).or_insert_with(fresh);
        cohort.timesteps = cohort.timesteps.start.min(birth)..cohort.timesteps.end.max(death);
        cohort.gaussians.push(gaussian);
    }
    let mut cohorts: Vec<Contemporaries> = cohorts.into_values().collect();
    cohorts.sort_by_key(|cohort| cohort.timesteps.start);
    cohorts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_timestep_needs_few_cohorts_and_little_but_what_lives() {
        let life = |i: u32| {
            let birth = i * 7 % 9000;
            Life { birth, death: (birth + i * i % 300).min(9999) + 1 }
        };
        let lives: Vec<_> = (0..20_000).map(life).collect();
        let cohorts = contemporaries(&lives, 20);
        let mut all: Vec<usize> = cohorts.iter().flat_map(|cohort| cohort.gaussians.clone()).collect();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..lives.len()));
        assert!(cohorts.is_sorted_by_key(|cohort| cohort.timesteps.start));
        for timestep in (400..9000).step_by(333) {
            let here: Vec<_> = cohorts.iter().filter(|cohort| cohort.timesteps.contains(&timestep)).collect();
            let read: usize = here.iter().map(|cohort| cohort.gaussians.len()).sum();
            let alive = lives.iter().filter(|life| life.contains(timestep)).count();
            assert!(here.len() <= 6 * 5 && read < 4 * alive, "{} cohorts, {read} of {alive}", here.len());
        }
    }
}

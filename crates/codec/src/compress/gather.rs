//! Transposition of timesteps into tracks, with quaternions normalised and made sign-continuous over time.

use tcgs_core::{Attribute, Gaussians, dot};

use crate::compact::unit_quat;

/// Number of Gaussians whose tracks are gathered together: a cache line or more of each timestep.
pub(super) const BLOCK: usize = 64;

/// Rotation before the first timestep: the identity, so that `w >= 0` at the first.
pub(super) const IDENTITY: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

/// `[gaussians, components, timesteps]` values of one attribute. Quaternions have unit length, and neighbours in time
/// lie in one hemisphere.
///
/// - `gaussians`: their indices
/// - `before`: the rotation of each at the timestep before; replaced by that of the last timestep
pub(super) fn gather(
    timesteps: &[Gaussians],
    attribute: Attribute,
    gaussians: &[u32],
    before: &mut [[f32; 4]],
) -> Vec<f32> {
    let (components, count) = (attribute.components(), timesteps.len());
    let mut tracks = vec![0.0; gaussians.len() * components * count];
    for (timestep, now) in timesteps.iter().enumerate() {
        let values = now.values(attribute);
        for (tracks, &gaussian) in tracks.chunks_exact_mut(components * count).zip(gaussians) {
            let row = &values[gaussian as usize * components..][..components];
            for (track, value) in tracks.chunks_exact_mut(count).zip(row) {
                track[timestep] = *value;
            }
        }
    }
    if attribute == Attribute::Quat {
        for (tracks, before) in tracks.chunks_exact_mut(4 * count).zip(before) {
            for timestep in 0..count {
                let mut quat = unit_quat(std::array::from_fn(|c| tracks[c * count + timestep]));
                if dot(quat, *before) < 0.0 {
                    quat = quat.map(|x| -x);
                }
                for (channel, &x) in quat.iter().enumerate() {
                    tracks[channel * count + timestep] = x;
                }
                *before = quat;
            }
        }
    }
    tracks
}

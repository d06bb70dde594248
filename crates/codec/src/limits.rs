//! Bounds on the memory and the counts that a file may request. Decoders check them before they allocate.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::DecodeError;

/// Limits beyond which a decoder refuses a file with [`DecodeError::Limit`].
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeError, DecodeLimits, SceneInfo, compress, decode, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
///
/// let limits = DecodeLimits { max_gaussians: 2, ..DecodeLimits::default() };
/// let error = decode(&encode(&compact)?, &limits).unwrap_err();
/// assert!(matches!(error, DecodeError::Limit { needed: 3, limit: 2, .. }));
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodeLimits {
    /// Largest number of Gaussians of a scene. Default 16,777,216: forty times a large scene.
    pub max_gaussians: u32,
    /// Largest number of timesteps of a scene. Default 65,536, the most that the format can hold.
    pub max_timesteps: u32,
    /// Largest memory of the decoded scene and of decoding, in bytes. Default 4 GiB.
    pub max_bytes: u64,
    /// Largest number of bytes of memory per byte of the file, beyond [`Self::FREE_BYTES`]: refuses decompression
    /// bombs. Default 1024; real scenes need about ten.
    pub max_expansion: u32,
}

impl DecodeLimits {
    /// Memory that [`Self::max_expansion`] allows to a file of any length, 16 MiB.
    pub const FREE_BYTES: u64 = 1 << 24;

    /// No limits, for files that the program itself wrote.
    pub fn none() -> Self {
        Self { max_gaussians: u32::MAX, max_timesteps: u32::MAX, max_bytes: u64::MAX, max_expansion: u32::MAX }
    }
}

impl Default for DecodeLimits {
    fn default() -> Self {
        Self { max_gaussians: 1 << 24, max_timesteps: 1 << 16, max_bytes: 1 << 32, max_expansion: 1024 }
    }
}

/// Memory charged against [`DecodeLimits`] while one file is decoded. Freed memory is not credited: the sum of all
/// allocations bounds their peak.
#[derive(Debug)]
pub(crate) struct Budget {
    limit: u64,
    used: AtomicU64,
}

impl Budget {
    /// - `file_bytes`: length of the file
    pub(crate) fn new(limits: &DecodeLimits, file_bytes: u64) -> Self {
        let expanded = file_bytes.saturating_mul(limits.max_expansion.into()).saturating_add(DecodeLimits::FREE_BYTES);
        Self { limit: limits.max_bytes.min(expanded), used: AtomicU64::new(0) }
    }

    /// A budget with the remaining memory, for allocations that do not outlive the decoding of a part.
    pub(crate) fn fork(&self) -> Self {
        Self { limit: self.limit, used: AtomicU64::new(self.used.load(Ordering::Relaxed)) }
    }

    /// Charges the memory of `count` values of `size` bytes; call it before the allocation.
    ///
    /// # Errors
    /// [`DecodeError::Limit`] if the sum of all charges exceeds the limit.
    pub(crate) fn reserve(&self, what: &'static str, count: u64, size: usize) -> Result<(), DecodeError> {
        let bytes = count.saturating_mul(size as u64).min(1 << 62);
        let used = self.used.fetch_add(bytes, Ordering::Relaxed);
        let needed = used.saturating_add(bytes);
        if needed > self.limit || used > self.limit {
            // Nothing is allocated after a failure, and the sum must not wrap around.
            self.used.fetch_sub(bytes, Ordering::Relaxed);
            return Err(DecodeError::Limit { what, unit: "bytes", needed, limit: self.limit });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reservations_add_up_and_do_not_overflow() {
        let budget = Budget::new(&DecodeLimits { max_bytes: 100, ..Default::default() }, 1);
        budget.reserve("codes", 10, 6).unwrap();
        let error = budget.reserve("codes", 11, 4).unwrap_err();
        assert_eq!(error.to_string(), "codes needs 104 bytes, limit is 100");
        assert!(budget.reserve("codes", u64::MAX, 16).is_err());
        budget.reserve("codes", 10, 4).unwrap();
    }

    #[test]
    fn a_small_file_may_not_take_much() {
        let budget = Budget::new(&DecodeLimits::default(), 100);
        assert!(budget.reserve("layer", 17 << 20, 1).is_err());
        budget.reserve("layer", 16 << 20, 1).unwrap();
    }
}

//! How much a file may ask for.

use crate::error::DecodeError;

/// What a decoder is willing to spend on a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodeLimits {
    /// Default 16,777,216: forty times a large scene.
    pub max_gaussians: u32,
    /// Default 65,536: what the format can say.
    pub max_timesteps: u32,
    /// Memory for the decoded scene and what is needed on the way, in bytes. Default 4 GiB.
    pub max_bytes: u64,
}

impl Default for DecodeLimits {
    fn default() -> Self {
        Self { max_gaussians: 1 << 24, max_timesteps: 1 << 16, max_bytes: 1 << 32 }
    }
}

/// What is left of [`DecodeLimits::max_bytes`] while decoding one file. Never given back: the sum of all
/// allocations bounds their peak.
pub(crate) struct Budget {
    limit: u64,
    used: u64,
}

impl Budget {
    pub(crate) fn new(limits: &DecodeLimits) -> Self {
        Self { limit: limits.max_bytes, used: 0 }
    }

    /// To be asked before `count` things of `size` bytes are allocated. Returns `count`.
    pub(crate) fn reserve(&mut self, what: &'static str, count: u64, size: usize) -> Result<usize, DecodeError> {
        let bytes = count.checked_mul(size as u64);
        let needed = bytes.and_then(|b| b.checked_add(self.used)).unwrap_or(u64::MAX);
        let too_large = DecodeError::Limit { what, unit: "bytes", needed, limit: self.limit };
        if needed > self.limit {
            return Err(too_large);
        }
        self.used = needed;
        usize::try_from(count).map_err(|_| too_large)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reservations_add_up_and_do_not_overflow() {
        let mut budget = Budget::new(&DecodeLimits { max_bytes: 100, ..Default::default() });
        assert_eq!(budget.reserve("codes", 10, 6).unwrap(), 10);
        let error = budget.reserve("codes", 11, 4).unwrap_err();
        assert_eq!(error.to_string(), "codes needs 104 bytes, limit is 100");
        assert!(budget.reserve("codes", u64::MAX, 16).is_err());
        assert_eq!(budget.reserve("codes", 10, 4).unwrap(), 10);
    }
}

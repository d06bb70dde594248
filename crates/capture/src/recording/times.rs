//! Presentation times of a recording's frames.

use tcgs_core::upper_median;

/// Presentation times of the frames of one recording, ascending, seconds.
#[derive(Clone, Debug, PartialEq)]
pub enum Times {
    /// Frames at a constant rate from 0 on.
    AtRate {
        /// Number of frames.
        num_frames: usize,
        /// Frames per second.
        fps: f64,
    },
    /// Listed one by one.
    Listed(Vec<f64>),
}

impl Times {
    /// Frames at a constant rate from 0 on.
    pub fn at_rate(num_frames: usize, fps: f64) -> Self {
        Self::AtRate { num_frames, fps }
    }

    /// Times one by one.
    ///
    /// - `secs`: ascending
    pub fn listed(secs: Vec<f64>) -> Self {
        Self::Listed(secs)
    }

    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        match self {
            Self::AtRate { num_frames, .. } => *num_frames,
            Self::Listed(secs) => secs.len(),
        }
    }

    /// The time of a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn secs(&self, frame: usize) -> f64 {
        match self {
            Self::AtRate { fps, .. } => frame as f64 / fps,
            Self::Listed(secs) => secs[frame],
        }
    }

    /// The time of the first frame.
    pub fn first_secs(&self) -> f64 {
        self.secs(0)
    }

    /// The time of the last frame.
    pub fn last_secs(&self) -> f64 {
        self.secs(self.num_frames() - 1)
    }

    /// The usual number of frames per second: 1 over the median of the gaps. `None` for a single frame.
    pub fn fps(&self) -> Option<f64> {
        match self {
            Self::AtRate { fps, .. } => Some(*fps),
            Self::Listed(secs) => {
                let median = upper_median(secs.windows(2).map(|pair| pair[1] - pair[0]))?;
                let mean = (secs[secs.len() - 1] - secs[0]) / (secs.len() - 1) as f64;
                // Rounded times alternate; at a constant rate the mean is more exact.
                let fps = 1.0 / if (median / mean - 1.0).abs() < 0.05 { mean } else { median };
                (fps.is_finite() && fps > 0.0).then_some(fps)
            }
        }
    }

    /// Whether some gap between frames differs from the usual one by more than half.
    pub fn is_variable(&self) -> bool {
        match (self, self.fps()) {
            (Self::Listed(secs), Some(fps)) => {
                secs.windows(2).any(|pair| ((pair[1] - pair[0]) * fps - 1.0).abs() > 0.5)
            }
            _ => false,
        }
    }

    /// The frame nearest to a moment; of two equally near frames the earlier one.
    pub fn nearest(&self, secs: f64) -> usize {
        let last = self.num_frames() - 1;
        match self {
            Self::AtRate { fps, .. } => ((secs * fps - 0.5).ceil().max(0.0) as usize).min(last),
            Self::Listed(all) => {
                let after = all.partition_point(|&time| time < secs).min(last);
                let before = after.saturating_sub(1);
                if (secs - all[before]).abs() <= (all[after] - secs).abs() { before } else { after }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_frame_is_found() {
        let listed = Times::listed(vec![0.0, 0.1, 0.2, 0.5, 0.6]);
        let found: Vec<usize> = [-1.0, 0.04, 0.06, 0.149, 0.34, 0.36, 0.7].map(|secs| listed.nearest(secs)).to_vec();
        assert_eq!(found, [0, 0, 1, 1, 2, 3, 4]);
        let at_rate = Times::at_rate(5, 10.0);
        let found: Vec<usize> = [-1.0, 0.04, 0.06, 0.149, 0.34, 0.36, 0.7].map(|secs| at_rate.nearest(secs)).to_vec();
        assert_eq!(found, [0, 0, 1, 1, 3, 4, 4]);
    }

    #[test]
    fn the_rate_is_that_of_most_frames() {
        let rounded = Times::listed((0..100).map(|i| (i as f64 * 1000.0 / 29.97).round() / 1000.0).collect());
        assert!((rounded.fps().unwrap() - 29.97).abs() < 0.01 && !rounded.is_variable());
        // A phone that leaves out every tenth frame.
        let dropping = Times::listed((0..100).filter(|i| i % 10 != 9).map(|i| f64::from(i) / 30.0).collect());
        assert!((dropping.fps().unwrap() - 30.0).abs() < 1e-9 && dropping.is_variable());
        assert_eq!(Times::listed(vec![0.0]).fps(), None);
    }
}

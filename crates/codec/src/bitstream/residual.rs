//! Codes as symbols without sign, alone or relative to a prediction.

/// How the symbols of a stream relate to the codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Transform {
    /// `code + 2^(width-1)`.
    Plain = 0,
    /// Difference to the code before, modulo `2^width`; small ones of either sign are small symbols.
    Difference = 1,
    /// The same difference to the code before moved as the [`Neighbor`] moves meanwhile: what lies close
    /// together often moves together.
    Motion = 2,
}

impl Transform {
    /// Symbol below `2^width` of a code.
    ///
    /// - `prediction`: of the code, any number; [`Self::Plain`] has no use for one
    #[inline(always)]
    pub(super) fn symbol(self, code: i16, prediction: i32, width: u8) -> u16 {
        let mask = mask(width);
        match self {
            Self::Plain => (i32::from(code) + half(width)) as u16 & mask,
            Self::Difference | Self::Motion => {
                let difference = wrap(i32::from(code).wrapping_sub(prediction), width);
                ((difference << 1) ^ (difference >> 31)) as u16 & mask
            }
        }
    }

    /// Inverse of [`Self::symbol`]; within the width whatever the symbol.
    #[inline(always)]
    pub(super) fn code(self, symbol: u16, prediction: i32, width: u8) -> i16 {
        let symbol = i32::from(symbol & mask(width));
        match self {
            Self::Plain => (symbol - half(width)) as i16,
            Self::Difference | Self::Motion => {
                let difference = (symbol >> 1) ^ -(symbol & 1);
                wrap(prediction.wrapping_add(difference), width) as i16
            }
        }
    }
}

/// The last track before this one, of the same channel and width, that is not constant. Gaussians follow a
/// Morton curve, so it is near.
#[derive(Default)]
pub(super) struct Neighbor {
    times: Vec<u16>,
    codes: Vec<i16>,
}

impl Neighbor {
    /// Takes the place of the one before, unless constant.
    ///
    /// - `times`, `codes`: `[K]`; times from 0 to the last timestep
    pub(super) fn replace(&mut self, times: &[u16], codes: &[i16]) {
        if times.len() > 1 {
            self.times.clear();
            self.times.extend_from_slice(times);
            self.codes.clear();
            self.codes.extend_from_slice(codes);
        }
    }

    /// Prediction of the code at a keypoint from the code at the keypoint before it.
    #[inline(always)]
    pub(super) fn predict(&self, transform: Transform, before: i16, time_before: u16, time: u16) -> i32 {
        let motion = if transform == Transform::Motion { self.at(time) - self.at(time_before) } else { 0 };
        i32::from(before) + motion
    }

    /// Code at a time, linear between keypoints, rounded towards minus infinity; 0 without a neighbour.
    fn at(&self, time: u16) -> i32 {
        let after = self.times.partition_point(|&t| t <= time);
        if after == 0 || after == self.times.len() {
            return self.codes.last().map_or(0, |&code| code.into());
        }
        let [start, end] = [self.times[after - 1], self.times[after]].map(i64::from);
        let [a, b] = [self.codes[after - 1], self.codes[after]].map(i64::from);
        (a + ((b - a) * (i64::from(time) - start)).div_euclid(end - start)) as i32
    }
}

/// The number in `[-2^(width-1), 2^(width-1))` that is equal modulo `2^width`.
#[inline(always)]
fn wrap(x: i32, width: u8) -> i32 {
    let unused = 32 - u32::from(width);
    (x << unused) >> unused
}

fn half(width: u8) -> i32 {
    1 << (width - 1)
}

fn mask(width: u8) -> u16 {
    ((1_u32 << width) - 1) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_comes_back_after_every_other() {
        for width in 1..=8_u8 {
            let range = -(1_i16 << (width - 1))..(1 << (width - 1));
            for (code, before) in range.clone().flat_map(|c| range.clone().map(move |b| (c, b))) {
                for transform in [Transform::Plain, Transform::Difference] {
                    let symbol = transform.symbol(code, before.into(), width);
                    assert!(u32::from(symbol) < 1 << width);
                    assert_eq!(transform.code(symbol, before.into(), width), code, "{transform:?} {width} {before}");
                }
            }
        }
        for (code, prediction) in [(i16::MIN, i32::MAX), (i16::MAX, i32::MIN), (0, -40_000), (-1, 40_000)] {
            let symbol = Transform::Motion.symbol(code, prediction, 16);
            assert_eq!(Transform::Motion.code(symbol, prediction, 16), code);
        }
    }

    #[test]
    fn small_differences_are_small_symbols() {
        let symbols = [0, -1, 1, -2, 2].map(|d| Transform::Difference.symbol(100 + d, 100, 16));
        assert_eq!(symbols, [0, 1, 2, 3, 4]);
    }

    #[test]
    fn a_track_that_moves_like_its_neighbor_has_symbols_of_zero() {
        let mut neighbor = Neighbor::default();
        assert_eq!(neighbor.predict(Transform::Motion, 5, 0, 9), 5);
        neighbor.replace(&[0, 4, 9], &[10, 30, -20]);
        neighbor.replace(&[0], &[77]);
        assert_eq!(neighbor.predict(Transform::Motion, 105, 0, 2), 115);
        assert_eq!(neighbor.predict(Transform::Motion, 115, 2, 9), 75);
        assert_eq!(neighbor.predict(Transform::Difference, 115, 2, 9), 115);
    }
}

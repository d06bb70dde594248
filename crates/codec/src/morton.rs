//! Morton order (Z-order): points that are neighbours in space are mostly neighbours in the file.

/// Interleaves three coordinates of at most 16 bits; bit 0 of `x` is the lowest.
pub(crate) fn interleave(coordinates: [u16; 3]) -> u64 {
    let [x, y, z] = coordinates.map(spread);
    x | y << 1 | z << 2
}

/// Inverse of [`interleave`].
pub(crate) fn deinterleave(key: u64) -> [u16; 3] {
    [0, 1, 2].map(|axis| gather(key >> axis))
}

/// Moves bit `i` to bit `3 i`.
fn spread(x: u16) -> u64 {
    let x = u64::from(x);
    let x = (x | x << 16) & 0x0000_ff00_00ff;
    let x = (x | x << 8) & 0x00f0_0f00_f00f;
    let x = (x | x << 4) & 0x0c30_c30c_30c3;
    (x | x << 2) & 0x2492_4924_9249
}

/// Moves bit `3 i` to bit `i` and drops the others.
fn gather(x: u64) -> u16 {
    let x = x & 0x2492_4924_9249;
    let x = (x | x >> 2) & 0x0c30_c30c_30c3;
    let x = (x | x >> 4) & 0x00f0_0f00_f00f;
    let x = (x | x >> 8) & 0x0000_ff00_00ff;
    (x | x >> 16) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_take_turns_and_come_back() {
        assert_eq!(interleave([0b11, 0b01, 0b10]), 0b101_011);
        assert_eq!(interleave([u16::MAX; 3]), (1 << 48) - 1);
        for i in 0..16 {
            assert_eq!(interleave([1 << i, 0, 0]), 1 << (3 * i));
            assert_eq!(interleave([0, 0, 1 << i]), 1 << (3 * i + 2));
        }
        let mut state = 1_u64;
        for _ in 0..1000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let coordinates = [16, 32, 48].map(|s| (state >> s) as u16);
            assert_eq!(deinterleave(interleave(coordinates)), coordinates);
        }
    }
}

//! Coding of numbers of up to 16 bits as symbols of `coder` (`docs/FORMAT.md`, "Symbols": number,
//! signed number, code).

use super::coder::{Coder, SymbolModel};

/// Numbers below this are their own symbols.
const DIRECT: u32 = 8;
/// Symbol of all numbers from 64 on; a second symbol gives the exponent.
const LARGE: u32 = 14;

/// Coder of numbers in `[0, 2^16)` that are mostly small. A symbol gives the number or its magnitude; then follow the
/// bits within the magnitude, of which the leading ones are modelled.
#[derive(Clone, Debug)]
pub(super) struct Numbers {
    /// Models by context.
    symbols: Vec<SymbolModel>,
    /// Exponents of large numbers, minus 6.
    exponents: SymbolModel,
    /// The highest three bits or fewer, by number of bits.
    leading: Vec<SymbolModel>,
}

impl Numbers {
    pub(super) fn new(num_contexts: usize) -> Self {
        let leading = (0..16_u32).map(|bits| SymbolModel::new(1 << bits.min(3))).collect();
        Self { symbols: vec![SymbolModel::new(16); num_contexts], exponents: SymbolModel::new(10), leading }
    }

    #[inline(always)]
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, context: usize, number: u32) -> u32 {
        // A decoder has no number yet: its symbol comes from the bytes.
        let symbol = coder.symbol(&mut self.symbols[context], symbol_of(number));
        if symbol < DIRECT {
            return symbol;
        }
        let (base, bits) = if symbol < LARGE {
            // Two symbols for each power of two.
            let exponent = symbol / 2 - 1;
            ((2 + symbol % 2) << (exponent - 1), exponent - 1)
        } else {
            let exponent = 6 + coder.symbol(&mut self.exponents, number.max(64).ilog2() - 6).min(9);
            (1 << exponent, exponent)
        };
        let high = bits.min(3);
        let rest = number.wrapping_sub(base);
        let leading = coder.symbol(&mut self.leading[bits as usize], rest >> (bits - high) & 7) & ((1 << high) - 1);
        let trailing = coder.bits(bits - high, rest & ((1 << (bits - high)) - 1));
        base + (leading << (bits - high)) + trailing
    }
}

fn symbol_of(number: u32) -> u32 {
    match number {
        0..8 => number,
        8..64 => {
            let exponent = number.ilog2();
            2 * exponent + 2 + (number >> (exponent - 1) & 1)
        }
        _ => LARGE,
    }
}

/// Maps signed to unsigned numbers: 0, -1, 1, -2, 2, ... to 0, 1, 2, 3, 4, ...
#[inline(always)]
pub(super) fn zigzag(x: i32) -> u32 {
    ((x << 1) ^ (x >> 31)) as u32
}

/// Inverse of [`zigzag`].
#[inline(always)]
pub(super) fn unzigzag(z: u32) -> i32 {
    (z >> 1) as i32 ^ -((z & 1) as i32)
}

/// The number in `[-2^(width-1), 2^(width-1))` that is congruent to `x` modulo `2^width`.
#[inline(always)]
pub(super) fn wrap(x: i32, width: u8) -> i32 {
    let unused = 32 - u32::from(width);
    (x << unused) >> unused
}

/// The largest integer not above `x`, which lies within 31 bits. `f64::floor` is a function call for target processors
/// without an instruction for it.
#[inline(always)]
pub(super) fn floor(x: f64) -> i32 {
    let toward_zero = x as i32;
    toward_zero - i32::from(f64::from(toward_zero) > x)
}

/// Coder of codes of 1 to 16 bits that need not be near their prediction: the four highest bits, then four more, then
/// the rest.
#[derive(Clone, Debug)]
pub(super) struct Codes {
    /// Models by context.
    high: Vec<SymbolModel>,
    /// Models by class of context and highest bits.
    middle: Vec<SymbolModel>,
    contexts_per_class: usize,
}

impl Codes {
    /// - `contexts_per_class`: number of consecutive contexts that share the models of lower bits
    pub(super) fn new(num_contexts: usize, contexts_per_class: usize) -> Self {
        Self {
            high: vec![SymbolModel::new(16); num_contexts],
            middle: vec![SymbolModel::new(16); num_contexts / contexts_per_class * 16],
            contexts_per_class,
        }
    }

    /// - `code`: shifted by `2^(width-1)`, so not negative
    #[inline(always)]
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, context: usize, width: u8, code: u32) -> u32 {
        let width = u32::from(width);
        let high_bits = width.min(4);
        let middle_bits = (width - high_bits).min(4);
        let low_bits = width - high_bits - middle_bits;
        let high = coder.symbol(&mut self.high[context], code >> (width - high_bits)) & ((1 << high_bits) - 1);
        let mut value = high;
        if middle_bits > 0 {
            let class = context / self.contexts_per_class;
            let model = &mut self.middle[16 * class + high as usize];
            let mask = (1 << middle_bits) - 1;
            value = value << middle_bits | coder.symbol(model, code >> low_bits & mask) & mask;
        }
        value << low_bits | coder.bits(low_bits, code & ((1 << low_bits) - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::super::coder::{Decoder, Encoder};
    use super::*;

    #[test]
    fn every_number_comes_back() {
        let (mut encoder, mut numbers) = (Encoder::default(), Numbers::new(1));
        for n in 0..1 << 16 {
            numbers.code(&mut encoder, 0, n);
        }
        let bytes = encoder.finish();
        let (mut decoder, mut numbers) = (Decoder::new(&bytes), Numbers::new(1));
        for n in 0..1 << 16 {
            assert_eq!(numbers.code(&mut decoder, 0, 0), n);
        }
        assert!(decoder.finished());
    }

    #[test]
    fn every_code_comes_back() {
        for width in 1..=16 {
            let (mut encoder, mut codes) = (Encoder::default(), Codes::new(2, 1));
            for n in 0..1_u32 << width {
                codes.code(&mut encoder, n as usize & 1, width, n);
            }
            let bytes = encoder.finish();
            let (mut decoder, mut codes) = (Decoder::new(&bytes), Codes::new(2, 1));
            for n in 0..1_u32 << width {
                assert_eq!(codes.code(&mut decoder, n as usize & 1, width, 0), n);
            }
            assert!(decoder.finished());
        }
    }

    #[test]
    fn floors_are_those_of_the_library() {
        for x in [-3.0, -2.5, -1e-300, -0.0, 0.0, 0.49, 1.0, 7.999_999, -1e6, 1e6 + 0.5] {
            assert_eq!(f64::from(floor(x)), x.floor());
        }
    }

    #[test]
    fn signs_alternate() {
        for (z, x) in [0, -1, 1, -2, 2].into_iter().enumerate() {
            assert_eq!((zigzag(x), unzigzag(z as u32)), (z as u32, x));
        }
    }
}

//! Entropy coding (`docs/FORMAT.md`, "Symbols"): adaptive models of up to sixteen symbols, and an asymmetric numeral
//! system (rANS).
//!
//! All arithmetic is exact and in integers, so that all machines agree. Code that is generic over [`Coder`] serves both
//! directions: it passes a symbol to the coder and continues with the symbol that the coder returns. The [`Encoder`]
//! returns the symbol it was given. The [`Decoder`] ignores it and returns the symbol from the bytes.

/// Number of symbols of a model.
pub(super) const NUM_SYMBOLS: usize = 16;
/// Binary logarithm of the coder's total frequency.
const FREQUENCY_BITS: u32 = 15;
/// Fractional bits of a model's cumulative frequency, which the coder drops.
const FRACTION_BITS: u32 = 15;
const ONE: i32 = 1 << (FREQUENCY_BITS + FRACTION_BITS);
/// Least frequency of a symbol: two units of the coder, because rounding may take up to one.
const MIN_FREQUENCY: i32 = 2 << FRACTION_BITS;
/// Largest shift of the adaptation: the first symbol moves the model by a half, later ones by less, at least by 2⁻⁷.
const SLOWEST: u32 = 7;
/// Lowest state of the coder between symbols.
const LOWEST: u64 = 1 << 31;

/// Cumulative frequencies towards which each symbol moves the model.
const TARGETS: [[i32; NUM_SYMBOLS]; NUM_SYMBOLS] = {
    let mut targets = [[0; NUM_SYMBOLS]; NUM_SYMBOLS];
    let mut symbol = 0;
    while symbol < NUM_SYMBOLS {
        let mut i = 1;
        while i < NUM_SYMBOLS {
            targets[symbol][i] =
                if i <= symbol { i as i32 * MIN_FREQUENCY } else { ONE - (NUM_SYMBOLS - i) as i32 * MIN_FREQUENCY };
            i += 1;
        }
        symbol += 1;
    }
    targets
};

/// Adaptive probabilities of the symbols.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct SymbolModel {
    /// Sum of the frequencies of all symbols before each, ascending from 0; the last symbol ends at [`ONE`].
    cumulative: [i32; NUM_SYMBOLS],
    /// Number of symbols seen, plus one.
    age: u32,
}

impl SymbolModel {
    /// A model in which the first `num_symbols` symbols are equally likely, and the others have the least frequency.
    pub(super) const fn new(num_symbols: usize) -> Self {
        let mut cumulative = [0; NUM_SYMBOLS];
        let rest = (NUM_SYMBOLS - num_symbols) as i32 * MIN_FREQUENCY;
        let each = (ONE - rest) / num_symbols as i32;
        let mut i = 1;
        while i < NUM_SYMBOLS {
            cumulative[i] =
                if i < num_symbols { i as i32 * each } else { ONE - (NUM_SYMBOLS - i) as i32 * MIN_FREQUENCY };
            i += 1;
        }
        Self { cumulative, age: 1 }
    }

    /// Start and length of a symbol's interval within `2^FREQUENCY_BITS`.
    #[inline(always)]
    fn interval(&self, symbol: usize) -> (u32, u32) {
        let at = |i: usize| if i < NUM_SYMBOLS { self.cumulative[i] >> FRACTION_BITS } else { 1 << FREQUENCY_BITS };
        (at(symbol) as u32, (at(symbol + 1) - at(symbol)) as u32)
    }

    /// The symbol whose interval holds `slot`.
    #[inline(always)]
    fn symbol_at(&self, slot: u32) -> usize {
        let bound = ((slot + 1) << FRACTION_BITS) as i32;
        let below: i32 = self.cumulative.iter().map(|&c| i32::from(c < bound)).sum();
        (below - 1) as usize & (NUM_SYMBOLS - 1)
    }

    #[inline(always)]
    fn update(&mut self, symbol: usize) {
        self.age += 1;
        let shift = self.age.ilog2().min(SLOWEST);
        for (cumulative, target) in self.cumulative.iter_mut().zip(&TARGETS[symbol]) {
            *cumulative += (target - *cumulative) >> shift;
        }
    }
}

/// One direction of coding.
pub(super) trait Coder {
    /// Codes a symbol below 16.
    fn symbol(&mut self, model: &mut SymbolModel, symbol: u32) -> u32;
    /// Codes `count` bits, at most 15, without a model.
    fn bits(&mut self, count: u32, value: u32) -> u32;
    /// Whether the decoder has run out of bytes; further symbols are meaningless.
    fn exhausted(&self) -> bool;
}

/// Collects symbols. rANS codes them in reverse order.
#[derive(Default)]
pub(super) struct Encoder {
    /// Start and length of each symbol's interval.
    intervals: Vec<(u16, u16)>,
}

impl Coder for Encoder {
    #[inline(always)]
    fn symbol(&mut self, model: &mut SymbolModel, symbol: u32) -> u32 {
        let (start, length) = model.interval(symbol as usize);
        self.intervals.push((start as u16, length as u16));
        model.update(symbol as usize);
        symbol
    }

    #[inline(always)]
    fn bits(&mut self, count: u32, value: u32) -> u32 {
        debug_assert!(value >> count == 0);
        if count > 0 {
            let rest = FREQUENCY_BITS - count;
            self.intervals.push(((value << rest) as u16, (1 << rest) as u16));
        }
        value
    }

    fn exhausted(&self) -> bool {
        false
    }
}

impl Encoder {
    /// Returns the state, then 32-bit words in the order of decoding.
    pub(super) fn finish(self) -> Vec<u8> {
        let mut state = LOWEST;
        let mut words = Vec::new();
        for &(start, length) in self.intervals.iter().rev() {
            let length = u64::from(length);
            if state >= length << (63 - FREQUENCY_BITS) {
                words.push(state as u32);
                state >>= 32;
            }
            state = ((state / length) << FREQUENCY_BITS) + state % length + u64::from(start);
        }
        let mut bytes = state.to_le_bytes().to_vec();
        bytes.extend(words.iter().rev().flat_map(|w| w.to_le_bytes()));
        bytes
    }
}

/// Decodes the output of an [`Encoder`]. Any other bytes decode to arbitrary symbols.
pub(super) struct Decoder<'a> {
    state: u64,
    words: std::slice::Iter<'a, [u8; 4]>,
    whole: bool,
    exhausted: bool,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let (state, words) = bytes.split_first_chunk().unwrap_or((&[0; 8], &[]));
        let (words, rest) = words.as_chunks();
        let state = u64::from_le_bytes(*state);
        let legal = (LOWEST..LOWEST << 32).contains(&state);
        Self {
            state: if legal { state } else { LOWEST },
            words: words.iter(),
            whole: rest.is_empty(),
            exhausted: !legal,
        }
    }

    #[inline(always)]
    fn advance(&mut self, start: u32, length: u32) {
        let slot = self.state & ((1 << FREQUENCY_BITS) - 1);
        self.state = u64::from(length) * (self.state >> FREQUENCY_BITS) + slot - u64::from(start);
        if self.state < LOWEST {
            match self.words.next() {
                Some(word) => self.state = self.state << 32 | u64::from(u32::from_le_bytes(*word)),
                None => self.exhausted = true,
            }
        }
    }

    /// Whether the decoder has read the exact output of an encoder, no more and no less. When fuzzing, unread bytes are
    /// accepted: random input would not get past the first section.
    pub(super) fn finished(&self) -> bool {
        if cfg!(fuzzing) {
            return !self.exhausted;
        }
        self.whole && !self.exhausted && self.state == LOWEST && self.words.len() == 0
    }
}

impl Coder for Decoder<'_> {
    #[inline(always)]
    fn symbol(&mut self, model: &mut SymbolModel, _: u32) -> u32 {
        let symbol = model.symbol_at(self.state as u32 & ((1 << FREQUENCY_BITS) - 1));
        let (start, length) = model.interval(symbol);
        self.advance(start, length);
        model.update(symbol);
        symbol as u32
    }

    #[inline(always)]
    fn bits(&mut self, count: u32, _: u32) -> u32 {
        if count == 0 {
            return 0;
        }
        let rest = FREQUENCY_BITS - count;
        let value = (self.state as u32 & ((1 << FREQUENCY_BITS) - 1)) >> rest;
        self.advance(value << rest, 1 << rest);
        value
    }

    fn exhausted(&self) -> bool {
        self.exhausted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(seed: u64) -> impl Iterator<Item = u32> {
        let mut state = seed;
        std::iter::repeat_with(move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32
        })
    }

    #[test]
    fn models_stay_whole_whatever_they_see() {
        for symbols in [[0, 0], [15, 15], [0, 15], [7, 8]] {
            let mut model = SymbolModel::new(16);
            for i in 0..5000 {
                model.update(symbols[i % 2]);
                let lengths: u32 = (0..NUM_SYMBOLS).map(|s| model.interval(s).1).sum();
                assert_eq!(lengths, 1 << FREQUENCY_BITS);
                assert!((0..NUM_SYMBOLS).all(|s| model.interval(s).1 > 0), "{symbols:?} after {i}");
            }
        }
        for num_symbols in 1..=16 {
            let model = SymbolModel::new(num_symbols);
            assert!((0..NUM_SYMBOLS).all(|s| model.interval(s).1 > 0));
            let all: u32 = (0..num_symbols).map(|s| model.interval(s).1).sum();
            assert!(all > (1 << FREQUENCY_BITS) - 40);
        }
    }

    #[test]
    fn symbols_and_bits_come_back() {
        type Step<'a> = &'a mut dyn FnMut(&mut SymbolModel, u32, u32, u32) -> (u32, u32);
        let code = |coder: Step<'_>| -> Vec<(u32, u32)> {
            let mut models = vec![SymbolModel::new(16); 3];
            numbers(5)
                .take(20_000)
                .enumerate()
                .map(|(i, x)| {
                    let symbol = (x & 15).min(x >> 4 & 15).min(x >> 8 & 15);
                    let count = x >> 12 & 15;
                    coder(&mut models[i % 3], symbol, count, x >> 16 & ((1 << count) - 1))
                })
                .collect()
        };
        let mut encoder = Encoder::default();
        let written =
            code(&mut |model, symbol, count, bits| (encoder.symbol(model, symbol), encoder.bits(count, bits)));
        let bytes = encoder.finish();
        let mut decoder = Decoder::new(&bytes);
        let read = code(&mut |model, _, count, _| (decoder.symbol(model, 0), decoder.bits(count, 0)));
        assert_eq!(read, written);
        assert!(decoder.finished());
        // A surplus or missing word is detected.
        let mut decoder = Decoder::new(&bytes[..bytes.len() - 4]);
        code(&mut |model, _, count, _| (decoder.symbol(model, 0), decoder.bits(count, 0)));
        assert!(decoder.exhausted() && !decoder.finished());
        let longer = [&bytes[..], &[0; 4]].concat();
        let mut decoder = Decoder::new(&longer);
        code(&mut |model, _, count, _| (decoder.symbol(model, 0), decoder.bits(count, 0)));
        assert!(!decoder.exhausted() && !decoder.finished());
    }

    #[test]
    fn what_repeats_costs_next_to_nothing() {
        let mut encoder = Encoder::default();
        let mut model = SymbolModel::new(16);
        (0..100_000).for_each(|_| {
            encoder.symbol(&mut model, 3);
        });
        assert!(encoder.finish().len() < 60);
    }
}

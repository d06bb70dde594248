//! Assembles the text of a shader: constants defined in Rust, then the parts that use them.

use std::fmt::Write;

/// A value of a constant in WGSL.
pub trait WgslValue {
    /// Its type in WGSL.
    const TYPE: &'static str;

    /// Literal in WGSL.
    ///
    /// # Panics
    /// If WGSL has no such value: a float that is not finite, an integer beyond 32 bits.
    fn literal(&self) -> String;
}

impl WgslValue for f32 {
    const TYPE: &'static str = "f32";

    fn literal(&self) -> String {
        assert!(self.is_finite(), "a constant of {self}");
        format!("{self:?}")
    }
}

impl WgslValue for u32 {
    const TYPE: &'static str = "u32";

    fn literal(&self) -> String {
        format!("{self}u")
    }
}

impl WgslValue for usize {
    const TYPE: &'static str = "u32";

    fn literal(&self) -> String {
        u32::try_from(*self).expect("a constant of 32 bits").literal()
    }
}

impl WgslValue for bool {
    const TYPE: &'static str = "bool";

    fn literal(&self) -> String {
        self.to_string()
    }
}

/// A shader's source under construction. A number that both sides need is defined once, in Rust, and [`Self::constant`]
/// declares it here.
///
/// ```
/// use tcgs_render::device::Wgsl;
/// let source = Wgsl::new().constant("TILE", 16_u32).part("fn area() -> u32 { return TILE * TILE; }").finish();
/// assert_eq!(source, "const TILE: u32 = 16u;\nfn area() -> u32 { return TILE * TILE; }\n");
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wgsl(String);

impl Wgsl {
    /// An empty source.
    pub fn new() -> Self {
        Self::default()
    }

    /// Declares `const NAME` at module scope.
    ///
    /// # Panics
    /// As [`WgslValue::literal`].
    #[must_use]
    pub fn constant<V: WgslValue>(mut self, name: &str, value: V) -> Self {
        let _ = writeln!(self.0, "const {name}: {} = {};", V::TYPE, value.literal());
        self
    }

    /// Declares `harmonics(direction: vec3<f32>) -> array<f32, 15>`, the real spherical harmonics of degrees 1 to 3,
    /// and their constants.
    #[must_use]
    pub fn harmonics(self) -> Self {
        self.part(include_str!("harmonics.wgsl"))
    }

    /// Appends declarations as they are.
    #[must_use]
    pub fn part(mut self, text: &str) -> Self {
        self.0.push_str(text);
        self.0.push('\n');
        self
    }

    /// The source.
    pub fn finish(self) -> String {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_keep_their_bits() {
        for value in [1e-20_f32, 1.0 / 255.0, 0.1 + 0.2, 3.0, 1e30, f32::MIN_POSITIVE] {
            assert_eq!(value.literal().parse::<f32>().map(f32::to_bits), Ok(value.to_bits()), "{}", value.literal());
        }
    }
}

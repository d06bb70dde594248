//! The sequence parameter set of H.264: the fields that decide whether a stream can be decoded, and its colours.
//!
//! ITU-T H.264, 7.3.2.1 and E.1.1.

use super::yuv::{ColorSpace, Matrix};

/// Content of a sequence parameter set.
#[derive(Debug, PartialEq)]
pub(super) struct Sps {
    /// 1 is 4:2:0.
    chroma_format: u32,
    /// Bit depths of luma and chroma.
    bits: [u32; 2],
    /// Whether frames are progressive, not interlaced.
    progressive: bool,
    pub color: ColorSpace,
}

impl Sps {
    /// - `unit`: with its header byte
    /// - returns: `None` if it is damaged
    pub fn parse(unit: &[u8]) -> Option<Self> {
        let mut from = Bits::new(unit.get(1..)?);
        let profile = from.bits(8)?;
        from.bits(16)?; // constraints, level
        from.golomb()?; // id
        let (mut chroma_format, mut bits) = (1, [8; 2]);
        if [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135].contains(&profile) {
            chroma_format = from.golomb()?;
            if chroma_format == 3 {
                from.bits(1)?;
            }
            bits = [8 + from.golomb()?, 8 + from.golomb()?];
            from.bits(1)?;
            if from.bits(1)? == 1 {
                for list in 0..if chroma_format == 3 { 12 } else { 8 } {
                    from.scaling_list(if list < 6 { 16 } else { 64 })?;
                }
            }
        }
        from.golomb()?;
        match from.golomb()? {
            0 => {
                from.golomb()?;
            }
            1 => {
                from.bits(1)?;
                from.golomb()?;
                from.golomb()?;
                for _ in 0..from.golomb()?.min(255) {
                    from.golomb()?;
                }
            }
            _ => {}
        }
        from.golomb()?; // reference frames
        from.bits(1)?;
        from.golomb()?; // width
        from.golomb()?; // height
        let progressive = from.bits(1)? == 1;
        if !progressive {
            from.bits(1)?;
        }
        from.bits(1)?;
        if from.bits(1)? == 1 {
            for _ in 0..4 {
                from.golomb()?; // crop
            }
        }
        // Without a description of colours, players' defaults apply.
        let color = if from.bits(1)? == 1 { color(&mut from)? } else { ColorSpace::default() };
        Some(Self { chroma_format, bits, progressive, color })
    }

    /// Checks that the decoder supports the stream.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self { bits: [8, 8], chroma_format: 1, progressive: true, .. } => Ok(()),
            Self { progressive: false, .. } => Err("is interlaced".into()),
            Self { bits: [8, 8], .. } => Err("does not have colours of half width and height (4:2:0)".into()),
            Self { bits, .. } => Err(format!("has {} bits a channel", bits[0])),
        }
    }
}

/// Reads colours from the start of the video usability information (VUI).
fn color(from: &mut Bits<'_>) -> Option<ColorSpace> {
    const EXTENDED_ASPECT: u32 = 255;
    if from.bits(1)? == 1 && from.bits(8)? == EXTENDED_ASPECT {
        from.bits(32)?;
    }
    if from.bits(1)? == 1 {
        from.bits(1)?; // overscan
    }
    let mut color = ColorSpace::default();
    if from.bits(1)? == 1 {
        from.bits(3)?;
        color.full_range = from.bits(1)? == 1;
        if from.bits(1)? == 1 {
            from.bits(16)?; // primaries, transfer
            color.matrix = match from.bits(8)? {
                1 => Matrix::Bt709,
                9 | 10 => Matrix::Bt2020,
                _ => Matrix::Bt601,
            };
        }
    }
    Some(color)
}

/// Bits of a unit, most significant first, without emulation prevention bytes.
struct Bits<'a> {
    bytes: &'a [u8],
    position: usize,
    zeros: usize,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, position: 0, zeros: 0 }
    }

    fn bit(&mut self) -> Option<u32> {
        if self.position.is_multiple_of(8) {
            let byte = *self.bytes.get(self.position / 8)?;
            if self.zeros >= 2 && byte == 3 {
                self.position += 8;
                self.zeros = 0;
                return self.bit();
            }
            self.zeros = if byte == 0 { self.zeros + 1 } else { 0 };
        }
        let byte = *self.bytes.get(self.position / 8)?;
        let bit = byte >> (7 - self.position % 8) & 1;
        self.position += 1;
        Some(bit.into())
    }

    fn bits(&mut self, count: usize) -> Option<u32> {
        (0..count).try_fold(0_u32, |value, _| Some(value << 1 | self.bit()?))
    }

    /// Exp-Golomb, 9.1.
    fn golomb(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.bit()? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1_u32 << zeros) - 1 + self.bits(zeros)?)
    }

    /// Skips a scaling list, 7.3.2.1.1.1.
    fn scaling_list(&mut self, size: usize) -> Option<()> {
        if self.bits(1)? == 0 {
            return Some(());
        }
        let (mut last, mut next) = (8_i64, 8_i64);
        for _ in 0..size {
            if next != 0 {
                let code = i64::from(self.golomb()?);
                let delta = if code % 2 == 1 { (code + 1) / 2 } else { -code / 2 };
                next = (last + delta).rem_euclid(256);
            }
            if next != 0 {
                last = next;
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(hex: &str) -> Sps {
        let bytes: Vec<u8> = hex.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        for cut in 2..bytes.len() - 8 {
            // Truncated bytes may parse or not; they must not cause a panic.
            Sps::parse(&bytes[..cut]);
        }
        Sps::parse(&bytes).unwrap()
    }

    // Parameter sets that ffmpeg's libx264 wrote, with the options named.

    #[test]
    fn colours_are_read() {
        let plain = parse("67 64 00 0a ac d9 44 7b 01 10 00 00 03 00 10 00 00 03 03 20 f1 22 59 60");
        assert_eq!((plain.color, plain.check()), (ColorSpace::default(), Ok(())));
        // -colorspace bt709 -color_range pc
        let full = parse("67 64 00 0a ac d9 44 7b 01 6e 02 02 02 80 00 00 03 00 80 00 00 19 07 89 12 cb");
        assert_eq!(full.color, ColorSpace { matrix: Matrix::Bt709, full_range: true });
        // -colorspace bt2020nc -aspect 2:1
        let wide = parse("67 64 00 0a ac d9 44 7b 0f 6a 12 02 12 80 00 00 03 00 80 00 00 19 07 89 12 cb");
        assert_eq!(wide.color, ColorSpace { matrix: Matrix::Bt2020, full_range: false });
        // -profile:v baseline
        assert!(parse("67 42 c0 0a d9 04 7b 01 10 00 00 03 00 10 00 00 03 03 20 f1 22 64 80").check().is_ok());
    }

    #[test]
    fn what_the_decoder_cannot_do_is_named() {
        let problem = |hex: &str| parse(hex).check().unwrap_err();
        // -pix_fmt yuv422p, yuv444p, yuv420p10le, -x264-params interlaced=1
        let halves = problem("67 7a 00 0a bc d9 44 7b 01 10 00 00 03 00 10 00 00 03 03 20 f1 22 59 60");
        assert_eq!(halves, "does not have colours of half width and height (4:2:0)");
        assert_eq!(halves, problem("67 f4 00 0a 91 9b 28 8f 60 22 00 00 03 00 02 00 00 03 00 64 1e 24 4b 2c"));
        let deep = problem("67 6e 00 0a a6 cd 94 47 b0 11 00 00 03 00 01 00 00 03 00 32 0f 12 25 96");
        assert_eq!(deep, "has 10 bits a channel");
        let lines = problem("67 64 00 15 ac d9 44 4f cb 80 88 00 00 03 00 08 00 00 03 01 90 f8 a1 4c b0");
        assert_eq!(lines, "is interlaced");
    }
}

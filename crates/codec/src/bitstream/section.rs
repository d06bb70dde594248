//! Which sections a file has, and reading one field after another.

use tcgs_core::Attribute;

use crate::error::DecodeError;

/// A section: its tag and its name in messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Section {
    pub(super) tag: [u8; 4],
    pub(super) name: &'static str,
}

/// Counts and provenance.
pub(super) const INFO: Section = Section { tag: *b"INFO", name: "info" };
/// Bit widths.
pub(super) const BITS: Section = Section { tag: *b"BITS", name: "bit map" };
/// Quantizers.
pub(super) const QNTZ: Section = Section { tag: *b"QNTZ", name: "quantizers" };

/// Keypoints of an attribute.
pub(super) fn of_attribute(attribute: Attribute) -> Section {
    let tag = match attribute {
        Attribute::Mean => *b"MEAN",
        Attribute::Quat => *b"QUAT",
        Attribute::LogScale => *b"SCAL",
        Attribute::LogitOpacity => *b"OPAC",
        Attribute::Color => *b"COLR",
    };
    Section { tag, name: attribute.name() }
}

/// All sections, in the order of a file.
pub(super) fn all() -> [Section; 8] {
    let [means, quats, log_scales, logit_opacities, colors] = Attribute::ALL.map(of_attribute);
    [INFO, BITS, QNTZ, means, quats, log_scales, logit_opacities, colors]
}

/// Reads fields from the bytes of one section; never past its end.
pub(super) struct Cursor<'a> {
    section: &'static str,
    /// Of the section in the file.
    offset: usize,
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(section: &'static str, offset: usize, bytes: &'a [u8]) -> Self {
        Self { section, offset, bytes, position: 0 }
    }

    /// An error at the current position.
    pub(super) fn invalid(&self, field: &'static str, problem: &'static str) -> DecodeError {
        DecodeError::Format { section: self.section, field, offset: (self.offset + self.position) as u64, problem }
    }

    pub(super) fn take(&mut self, field: &'static str, length: usize) -> Result<&'a [u8], DecodeError> {
        let rest = &self.bytes[self.position..];
        let taken = rest.get(..length).ok_or_else(|| self.invalid(field, "reaches past the end"))?;
        self.position += length;
        Ok(taken)
    }

    fn array<const L: usize>(&mut self, field: &'static str) -> Result<[u8; L], DecodeError> {
        let mut bytes = [0; L];
        bytes.copy_from_slice(self.take(field, L)?);
        Ok(bytes)
    }

    pub(super) fn u8(&mut self, field: &'static str) -> Result<u8, DecodeError> {
        self.array(field).map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self, field: &'static str) -> Result<u16, DecodeError> {
        self.array(field).map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self, field: &'static str) -> Result<u32, DecodeError> {
        self.array(field).map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self, field: &'static str) -> Result<u64, DecodeError> {
        self.array(field).map(u64::from_le_bytes)
    }

    pub(super) fn f32(&mut self, field: &'static str) -> Result<f32, DecodeError> {
        self.array(field).map(f32::from_le_bytes)
    }

    pub(super) fn tag(&mut self, field: &'static str) -> Result<[u8; 4], DecodeError> {
        self.array(field)
    }

    /// Nothing may be left.
    pub(super) fn finish(self) -> Result<(), DecodeError> {
        if self.position == self.bytes.len() { Ok(()) } else { Err(self.invalid("end", "bytes are left over")) }
    }
}

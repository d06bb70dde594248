//! Boxes of an MP4 file: a size, a kind of four letters, and a body of numbers or of further boxes.
//!
//! ISO/IEC 14496-12, 4.2. Every number is read from its box's own bytes, so no box reaches beyond another.

/// Bytes of a size and a kind.
pub(super) const HEAD_BYTES: usize = 8;

/// A box without its head, or the unread rest of it. All numbers are big-endian.
#[derive(Clone, Copy)]
pub(super) struct Body<'a> {
    pub kind: [u8; 4],
    rest: &'a [u8],
}

impl<'a> Body<'a> {
    pub fn new(kind: [u8; 4], rest: &'a [u8]) -> Self {
        Self { kind, rest }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or_else(|| self.ends_early())?;
        self.rest = rest;
        Ok(*taken)
    }

    pub fn u8(&mut self) -> Result<u8, String> {
        self.take::<1>().map(|[byte]| byte)
    }

    pub fn u16(&mut self) -> Result<u16, String> {
        self.take().map(u16::from_be_bytes)
    }

    pub fn u32(&mut self) -> Result<u32, String> {
        self.take().map(u32::from_be_bytes)
    }

    pub fn u64(&mut self) -> Result<u64, String> {
        self.take().map(u64::from_be_bytes)
    }

    /// A number that has 64 bits in version 1 of its box, 32 in version 0.
    pub fn long(&mut self, version: u8) -> Result<u64, String> {
        if version == 1 { self.u64() } else { self.u32().map(u64::from) }
    }

    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or_else(|| self.ends_early())?;
        self.rest = rest;
        Ok(taken)
    }

    /// The version and the flags at the start of many boxes.
    pub fn version(&mut self) -> Result<(u8, u32), String> {
        let [version, a, b, c] = self.take()?;
        Ok((version, u32::from_be_bytes([0, a, b, c])))
    }

    /// A count, followed by as many entries.
    pub fn entries<const N: usize>(&mut self) -> Result<&'a [[u8; N]], String> {
        let count = self.u32()? as usize;
        self.rest.as_chunks().0.get(..count).ok_or_else(|| self.ends_early())
    }

    fn ends_early(&self) -> String {
        format!("its box {} ends early", self.kind.escape_ascii())
    }

    /// The boxes inside. A rest at the end that is shorter than a head is no box: QuickTime ends some lists with a
    /// zero.
    pub fn boxes(self) -> impl Iterator<Item = Result<Body<'a>, String>> {
        let mut rest = self.rest;
        std::iter::from_fn(move || {
            let (&[a, b, c, d, kind @ ..], _) = rest.split_first_chunk::<HEAD_BYTES>()?;
            let size = u32::from_be_bytes([a, b, c, d]) as usize;
            match rest.split_at_checked(size).filter(|_| size >= HEAD_BYTES) {
                Some((inside, after)) => {
                    rest = after;
                    Some(Ok(Body { kind, rest: &inside[HEAD_BYTES..] }))
                }
                None => {
                    let (outer, kind) = (self.kind.escape_ascii(), kind.escape_ascii());
                    let most = rest.len();
                    rest = &[];
                    Some(Err(format!("its box {kind} inside {outer} has the size {size}, expected 8 to {most}")))
                }
            }
        })
    }

    /// The first box of a kind inside.
    pub fn find(self, kind: &[u8; 4]) -> Result<Option<Body<'a>>, String> {
        self.boxes().find(|found| found.as_ref().map_or(true, |found| found.kind == *kind)).transpose()
    }

    /// The first box of a kind inside, which must be there.
    pub fn need(self, kind: &[u8; 4]) -> Result<Body<'a>, String> {
        self.find(kind)?
            .ok_or_else(|| format!("its box {} has no box {}", self.kind.escape_ascii(), kind.escape_ascii()))
    }
}

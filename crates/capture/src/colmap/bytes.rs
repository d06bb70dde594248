//! Numbers of a binary file, read in order.

/// The unread rest of a file.
pub(super) struct Bytes<'a>(pub &'a [u8]);

impl<'a> Bytes<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.0.split_first_chunk::<N>().ok_or(ENDS_EARLY)?;
        self.0 = rest;
        Ok(*taken)
    }

    pub fn u8s<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.take()
    }

    pub fn u32(&mut self) -> Result<u32, String> {
        self.take().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Result<u64, String> {
        self.take().map(u64::from_le_bytes)
    }

    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.take()?);
        }
        finite(numbers)
    }

    /// Count of the entries that follow, each of at least `least_bytes`.
    pub fn count(&mut self, least_bytes: usize) -> Result<usize, String> {
        let count = self.u64()?;
        let possible = (self.0.len() / least_bytes) as u64;
        if count > possible { Err(ENDS_EARLY.into()) } else { Ok(count as usize) }
    }

    pub fn skip(&mut self, bytes: usize) -> Result<(), String> {
        self.0 = self.0.get(bytes..).ok_or(ENDS_EARLY)?;
        Ok(())
    }

    /// Text up to a zero byte, which is skipped.
    pub fn text(&mut self) -> Result<String, String> {
        let end = self.0.iter().position(|&byte| byte == 0).ok_or(ENDS_EARLY)?;
        let text = String::from_utf8(self.0[..end].to_vec()).map_err(|_| "has a name that is not UTF-8")?;
        self.0 = &self.0[end + 1..];
        Ok(text)
    }
}

const ENDS_EARLY: &str = "ends early, expected a whole file of COLMAP";

pub(super) fn finite<const N: usize>(numbers: [f64; N]) -> Result<[f64; N], String> {
    match numbers.iter().find(|number| !number.is_finite()) {
        Some(number) => Err(format!("holds {number}, expected finite numbers")),
        None => Ok(numbers),
    }
}

/// Lines of a text file that are no comments, with their numbers from 1. Empty lines count: an image without points has
/// one.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line.trim())).filter(|(_, line)| !line.starts_with('#'))
}

/// A number in a line.
///
/// - `what`: for the message
pub(super) fn number<T: std::str::FromStr>(word: Option<&str>, what: &str) -> Result<T, String> {
    let found = word.unwrap_or("nothing");
    word.and_then(|word| word.parse().ok()).ok_or_else(|| format!("found {found}, expected {what}"))
}

/// Several finite numbers.
pub(super) fn numbers<'a, const N: usize>(
    words: &mut impl Iterator<Item = &'a str>,
    what: &str,
) -> Result<[f64; N], String> {
    let mut numbers = [0.0; N];
    for value in &mut numbers {
        *value = number(words.next(), what)?;
    }
    finite(numbers)
}

//! File names by frame, without a string for every frame.
//!
//! Cameras number their files. If all names of a camera are one pattern around a number that counts frames, only the
//! pattern is kept. Other names are stored in one text, one after another.

use std::path::{Path, PathBuf};

/// The files of one camera, by frame.
#[derive(Clone, Debug)]
pub(crate) struct Files {
    /// The folder that names are relative to.
    pub folder: PathBuf,
    pub names: Names,
}

impl Files {
    /// The file of a frame.
    pub fn path(&self, frame: usize) -> PathBuf {
        self.folder.join(self.names.name(frame))
    }
}

/// Names by frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Names {
    /// A number between two texts; it grows by the same step with every frame.
    Pattern(Pattern),
    /// Names one after another.
    Listed {
        /// Frame of the first name.
        first_frame: usize,
        /// All names.
        text: Box<str>,
        /// End of each frame's name in the text, from the first frame on. A frame without name ends where the frame
        /// before it does.
        ends: Box<[usize]>,
    },
}

/// Names such as `3/000007.jpg`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Pattern {
    before: Box<str>,
    after: Box<str>,
    /// Minimum number of digits, padded with zeros.
    num_digits: usize,
    first_frame: usize,
    first_number: u64,
    /// Growth of the number from frame to frame.
    step: u64,
}

impl Names {
    /// - `names`: frames, ascending, and the name of each; frames may be missing
    pub fn of<S: AsRef<str>>(names: &[(usize, S)]) -> Self {
        if let Some(pattern) = Pattern::of(names) {
            return Self::Pattern(pattern);
        }
        let first_frame = names.first().map_or(0, |(frame, _)| *frame);
        let mut text = String::with_capacity(names.iter().map(|(_, name)| name.as_ref().len()).sum());
        let mut ends = Vec::new();
        for (frame, name) in names {
            ends.resize(frame - first_frame, text.len());
            text.push_str(name.as_ref());
            ends.push(text.len());
        }
        Self::Listed { first_frame, text: text.into(), ends: ends.into() }
    }

    /// The name of a frame.
    ///
    /// # Panics
    /// If names are listed, and there is none of this frame.
    pub fn name(&self, frame: usize) -> String {
        match self {
            Self::Pattern(pattern) => pattern.name(frame),
            Self::Listed { first_frame, text, ends } => {
                let i = frame - first_frame;
                let begin = if i == 0 { 0 } else { ends[i - 1] };
                text[begin..ends[i]].to_owned()
            }
        }
    }

    /// The same names with another extension.
    ///
    /// - `frames`: the frames that have a name
    pub fn with_extension(&self, extension: &str, frames: impl Iterator<Item = usize>) -> Self {
        let renamed = |frame: usize| Path::new(&self.name(frame)).with_extension(extension);
        let names: Vec<(usize, String)> =
            frames.map(|frame| (frame, renamed(frame).to_string_lossy().into_owned())).collect();
        Self::of(&names)
    }
}

impl Pattern {
    /// The pattern of all names, if there is one.
    fn of<S: AsRef<str>>(names: &[(usize, S)]) -> Option<Self> {
        let [(frame, name), (next_frame, next), ..] = names else { return None };
        let (name, next) = (name.as_ref(), next.as_ref());
        // The number begins at its first digit, not where the two names begin to differ.
        let same = name.bytes().zip(next.bytes()).take_while(|(a, b)| a == b).count();
        let digits_before = name.as_bytes()[..same].iter().rev().take_while(|byte| byte.is_ascii_digit()).count();
        let begin = same - digits_before;
        // At most as many digits as fit into the number's type.
        let digits = |text: &str| text.bytes().skip(begin).take_while(u8::is_ascii_digit).take(19).count();
        let (num_digits, next_digits) = (digits(name), digits(next));
        let number = |name: &str, digits: usize| name.get(begin..begin + digits)?.parse::<u64>().ok();
        let (first_number, next_number) = (number(name, num_digits)?, number(next, next_digits)?);
        let (frames, grown) = ((next_frame - frame) as u64, next_number.checked_sub(first_number)?);
        let pattern = Self {
            before: name.get(..begin)?.into(),
            after: name.get(begin + num_digits..)?.into(),
            num_digits,
            first_frame: *frame,
            first_number,
            step: (frames > 0 && grown.is_multiple_of(frames)).then(|| grown / frames)?,
        };
        names.iter().all(|(frame, name)| pattern.name(*frame) == name.as_ref()).then_some(pattern)
    }

    fn name(&self, frame: usize) -> String {
        let Self { before, after, num_digits, first_frame, first_number, step } = self;
        let number = u128::from(*first_number) + u128::from(*step) * (frame - first_frame) as u128;
        format!("{before}{number:0num_digits$}{after}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(names: &[(usize, &str)], is_pattern: bool) {
        let found = Names::of(names);
        assert_eq!(matches!(found, Names::Pattern(_)), is_pattern, "{found:?}");
        for (frame, name) in names {
            assert_eq!(found.name(*frame), *name);
        }
    }

    #[test]
    fn numbered_names_are_a_pattern() {
        check(&[(0, "3/000000.jpg"), (1, "3/000001.jpg"), (2, "3/000002.jpg")], true);
        check(&[(0, "a8.png"), (1, "a9.png"), (2, "a10.png"), (3, "a11.png")], true);
        check(&[(4, "Birthday_undist_00099_03.png"), (5, "Birthday_undist_00100_03.png")], true);
        // The camera's clock ticks thrice a frame, and frames are missing.
        check(&[(2, "cam2/0007.jpg"), (3, "cam2/0010.jpg"), (7, "cam2/0022.jpg")], true);
        let names: Vec<(usize, String)> = (0..3000).map(|t| (t, format!("30/{t:06}.jpg"))).collect();
        let found = Names::of(&names);
        assert!(matches!(found, Names::Pattern(_)) && found.name(2999) == "30/002999.jpg");
        let masks = found.with_extension("png", 0..3000);
        assert!(matches!(masks, Names::Pattern(_)) && masks.name(17) == "30/000017.png");
    }

    #[test]
    fn other_names_are_listed() {
        check(&[(0, "only.png")], false);
        check(&[(0, "a.png"), (1, "b.png"), (2, "c.png")], false);
        check(&[(0, "a01.png"), (1, "a02.png"), (2, "a04.png")], false);
        check(&[(0, "a09.png"), (1, "a8.png")], false);
        check(&[(0, "1/001.png"), (1, "2/002.png")], false);
        check(&[(0, "same.png"), (1, "same.png")], false);
        check(&[(3, "ä1.png"), (5, "ö2.png"), (9, "")], false);
        check(&[(0, "99999999999999999999998.png"), (1, "99999999999999999999999.png")], false);
    }
}

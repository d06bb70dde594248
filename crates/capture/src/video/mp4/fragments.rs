//! Fragments: frames that are listed piece by piece through the file, as in live recordings and DASH.
//!
//! ISO/IEC 14496-12, 8.8.

use std::collections::BTreeMap;

use super::boxes::Body;
use super::{MAX_FRAMES, Sample, too_many};

/// Most frames of all tracks together, sound among them. A run of equal frames takes no bytes, so only this number
/// bounds the time of reading.
const MAX_SAMPLES: usize = 16 * MAX_FRAMES;

/// Default values of frames.
#[derive(Clone, Copy, Default)]
struct Defaults {
    duration: u32,
    size: u32,
    flags: u32,
}

/// State between two fragments.
pub(super) struct Fragments {
    track: u32,
    by_track: BTreeMap<u32, Defaults>,
    /// Decoding time of the next frame, and the duration of all frames.
    next: i64,
    pub duration: u64,
    num_samples: usize,
}

impl Fragments {
    /// - `movie`: the box `moov`
    /// - `track`: number of the wanted track
    pub fn new(movie: Body<'_>, track: u32) -> Result<Self, String> {
        let mut by_track = BTreeMap::new();
        if let Some(extension) = movie.find(b"mvex")? {
            for found in extension.boxes() {
                let mut found = found?;
                if found.kind == *b"trex" {
                    found.version()?;
                    let (track, _entry) = (found.u32()?, found.u32()?);
                    let defaults = Defaults { duration: found.u32()?, size: found.u32()?, flags: found.u32()? };
                    by_track.insert(track, defaults);
                }
            }
        }
        Ok(Self { track, by_track, next: 0, duration: 0, num_samples: 0 })
    }

    /// Appends the frames of a fragment.
    ///
    /// - `fragment`: the box `moof`, which begins at the byte `start` of the file
    pub fn read(&mut self, fragment: Body<'_>, start: u64, samples: &mut Vec<Sample>) -> Result<(), String> {
        let mut end = start;
        for found in fragment.boxes() {
            let found = found?;
            if found.kind == *b"traf" {
                end = self.of_track(found, start, end, samples)?;
            }
        }
        Ok(())
    }

    /// - `before`: end of the previous track's bytes
    /// - returns: end of this track's bytes
    fn of_track(
        &mut self,
        fragment: Body<'_>,
        start: u64,
        before: u64,
        samples: &mut Vec<Sample>,
    ) -> Result<u64, String> {
        let mut head = fragment.need(b"tfhd")?;
        let (_, flags) = head.version()?;
        let track = head.u32()?;
        let mut defaults = self.by_track.get(&track).copied().unwrap_or_default();
        let mut at = if flags & 0x1 != 0 {
            head.u64()?
        } else if flags & 0x2_0000 != 0 {
            start
        } else {
            before
        };
        let base = at;
        if flags & 0x2 != 0 {
            head.u32()?;
        }
        for (flag, field) in [(0x8, &mut defaults.duration), (0x10, &mut defaults.size), (0x20, &mut defaults.flags)] {
            if flags & flag != 0 {
                *field = head.u32()?;
            }
        }
        if let Some(mut time) = fragment.find(b"tfdt")?.filter(|_| track == self.track) {
            let (version, _) = time.version()?;
            self.next = time.long(version)?.try_into().unwrap_or(i64::MAX);
        }
        for found in fragment.boxes() {
            let found = found?;
            if found.kind == *b"trun" {
                let wanted = if track == self.track { Some(&mut *samples) } else { None };
                at = self.run(found, base, at, defaults, wanted)?;
            }
        }
        Ok(at)
    }

    /// - `base`: origin of the run's place; `at`: end of the previous run
    /// - returns: end of this run
    fn run(
        &mut self,
        mut run: Body<'_>,
        base: u64,
        mut at: u64,
        defaults: Defaults,
        mut samples: Option<&mut Vec<Sample>>,
    ) -> Result<u64, String> {
        let (_, flags) = run.version()?;
        let count = run.u32()? as usize;
        self.num_samples = self.num_samples.saturating_add(count);
        let num_wanted = samples.as_ref().map_or(0, |samples| samples.len().saturating_add(count));
        if self.num_samples > MAX_SAMPLES || num_wanted > MAX_FRAMES {
            return Err(too_many(num_wanted.max(self.num_samples)));
        }
        if flags & 0x1 != 0 {
            at = base.saturating_add_signed(run.u32()?.cast_signed().into());
        }
        let mut first_flags = if flags & 0x4 != 0 { Some(run.u32()?) } else { None };
        for _ in 0..count {
            let mut field = |flag: u32, default: u32| if flags & flag != 0 { run.u32() } else { Ok(default) };
            let duration = field(0x100, defaults.duration)?;
            let size = field(0x200, defaults.size)?;
            let own_flags = field(0x400, first_flags.take().unwrap_or(defaults.flags))?;
            let offset = field(0x800, 0)?.cast_signed();
            let end = at.saturating_add(size.into());
            if let Some(samples) = samples.as_deref_mut() {
                // The flag says that a frame depends on others.
                let begins = own_flags & 0x1_0000 == 0;
                let composed = self.next.saturating_add(offset.into());
                samples.push(Sample { bytes: at..end, composed, begins });
                self.next = self.next.saturating_add(duration.into());
                self.duration = self.duration.saturating_add(duration.into());
            }
            at = end;
        }
        Ok(at)
    }
}

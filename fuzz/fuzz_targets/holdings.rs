//! What a player holds, on any file and any clock: what is due is there after a bounded number of parts, and
//! prefetching ends. Checksums are off.
#![no_main]

// The player's other modules need a GPU, which is slow to build with sanitizers.
#[allow(dead_code, unused_imports)]
#[path = "../../crates/play/src/clock.rs"]
mod clock;
#[allow(dead_code)]
#[path = "../../crates/play/src/holdings.rs"]
mod holdings;

use std::ops::Range;

use clock::Clock;
use holdings::{Holdings, Part};
use libfuzzer_sys::fuzz_target;
use tcgs_codec::{Archive, DecodeLimits, Opening};

/// A player without a source: all bytes are there.
struct Player<'a> {
    bytes: &'a [u8],
    archive: Archive,
    holdings: Holdings,
    clock: Clock,
}

impl Player<'_> {
    fn range(&self, range: Range<u64>) -> &[u8] {
        self.bytes.get(range.start as usize..(range.end as usize).min(self.bytes.len())).unwrap_or(&[])
    }

    /// Decodes the next part, as `player.rs` does.
    ///
    /// - returns: whether the due timestep lacked it; none if there is nothing to decode
    fn step(&mut self) -> Result<Option<bool>, ()> {
        let Some((part, is_due)) = self.holdings.next_part(&self.archive, &self.clock) else { return Ok(None) };
        match part {
            Part::Tables => unreachable!("the tables are there"),
            Part::Head(index) | Part::Start(index) => {
                let head = self.archive.head_range(index);
                let head = self.bytes.get(head.start as usize..head.end as usize).ok_or(())?;
                let mut cohort = self.archive.open_cohort(index, head).map_err(drop)?;
                if matches!(part, Part::Start(_)) {
                    cohort.read_shared(self.range(cohort.shared_range(cohort.num_layers()))).map_err(drop)?;
                    if cohort.layers_read() < cohort.num_layers() {
                        return Err(());
                    }
                }
                self.holdings.insert_cohort(&self.archive, &self.clock, index, cohort);
            }
            Part::Shared(index, layers) => {
                let mut cohort = self.holdings.take_cohort(index).expect("a cohort that is read further");
                cohort.read_shared(self.range(cohort.shared_range(layers))).map_err(drop)?;
                if cohort.layers_read() < layers {
                    return Err(());
                }
                self.holdings.insert_cohort(&self.archive, &self.clock, index, cohort);
            }
            Part::Segment { cohort: index, segment, layers } => {
                self.holdings.make_room(&self.archive, &self.clock);
                let cohort = self.holdings.cohort(index).expect("a cohort whose segment is missing");
                let decoded = cohort.read_segment(segment, self.range(cohort.segment_range(segment, layers)));
                let decoded = decoded.map_err(drop)?;
                if decoded.num_layers() < layers {
                    return Err(());
                }
                self.holdings.insert_segment(&self.archive, &self.clock, decoded);
            }
        }
        Ok(Some(is_due))
    }

    /// Decodes what is due, then what comes next.
    fn settle(&mut self) -> Result<(), ()> {
        let num_due = self.archive.cohorts_at(self.clock.timestep()).count();
        // Of a cohort the head of its plan, its own, the first layer and all of them, the same of the segment.
        let most = 8 * num_due + 8;
        let mut count = 0;
        while self.step()? == Some(true) {
            count += 1;
            assert!(count <= most, "{count} parts of {num_due} cohorts are due");
        }
        let moment = self.holdings.moment(&self.archive, self.clock.timestep());
        assert!(moment.is_some_and(|moment| moment.is_whole && moment.segments.len() == num_due));
        for count in 0.. {
            if self.step()?.is_none() {
                return Ok(());
            }
            assert!(count < MOST_PREFETCHED, "prefetching does not end");
        }
        Ok(())
    }
}

/// Files of more cohorts or timesteps are left to the other targets.
const MOST: usize = 64;
/// Of every timestep a cohort in every part, about.
const MOST_PREFETCHED: usize = 6 * MOST * MOST;

fuzz_target!(|input: (u16, Vec<u8>, &[u8])| {
    let (max_bytes, commands, bytes) = input;
    let limits = DecodeLimits { max_bytes: 1 << 22, ..Default::default() };
    let Ok(Opening::Ready(archive)) = Archive::open(bytes, &limits) else { return };
    let num_timesteps = archive.info().num_timesteps as usize;
    if archive.num_cohorts() > MOST || num_timesteps > MOST {
        return;
    }
    let clock = Clock::new(num_timesteps, archive.info().frame_rate.into());
    let holdings = Holdings::new(max_bytes.into());
    let mut player = Player { bytes, archive: *archive, holdings, clock };
    let mut now_ms = 0.0;
    for command in commands.into_iter().take(16) {
        let amount = command >> 3;
        match command & 7 {
            0 => player.clock.seek(amount.into()),
            1 => player.clock.set_speed(f64::from(amount) / 4.0 - 4.0),
            2 => player.clock.set_looping(amount & 1 > 0),
            3 => player.clock.step(i64::from(amount) - 16),
            4 => {
                player.clock.play();
                now_ms += 40.0 * f64::from(amount);
                player.clock.advance(now_ms);
            }
            5 if player.settle().is_err() => return,
            _ if player.step().is_err() => return,
            _ => {}
        }
    }
    let _ = player.settle();
});

//! The player's logic: the order of fetching, eviction, errors.

use std::io::Cursor;
use std::path::Path;

use crate::support::{Behaviour, Network, cohorts_file, room_file, scenes, settings, small_file, wait};
use tcgs_codec::{Archive, Cohort, CompressSettings, DecodeLimits, Opening, SceneFile, decode};
use tcgs_core::{Gaussians, Layout};
use tcgs_play::{BytesSource, FileSource, PlayError, Player, PlayerSettings, RangeSource, SourceError};

/// The only cohort of a file of version 1.
fn cohort(file: &[u8]) -> Cohort {
    match Archive::open(file, &DecodeLimits::default()).unwrap() {
        Opening::Ready(mut archive) => archive.open_cohort(0, &[]).unwrap(),
        Opening::More(more) => panic!("{more} of {} bytes", file.len()),
    }
}

/// The timestep shown now, as floats.
fn shown<S: RangeSource>(player: &Player<S>) -> (usize, Gaussians) {
    let moment = player.current().unwrap();
    (moment.timestep, moment.gaussians())
}

fn seek<S: RangeSource>(player: &mut Player<S>, timestep: usize) {
    player.clock_mut().unwrap().seek(timestep);
}

#[test]
fn seeking_in_random_order_shows_what_playing_shows() {
    let file = small_file();
    let expected = decode(&file, &DecodeLimits::default()).unwrap();
    let num_timesteps = expected.num_timesteps();
    // Room for all, for about two, and for none but the one on show.
    for bound in [1 << 30, 40_000, 1] {
        let mut now = 0.0;
        let mut player = Player::new(BytesSource::new(&file[..]), settings(bound), 0);
        wait(&mut player, &mut now);
        player.clock_mut().unwrap().play();
        let mut played: Vec<Option<Gaussians>> = vec![None; num_timesteps];
        // Twice around, a third of a timestep each time.
        for _ in 0..6 * num_timesteps {
            now += 1000.0 / 90.0;
            wait(&mut player, &mut now);
            let (timestep, gaussians) = shown(&player);
            assert!(played[timestep].as_ref().is_none_or(|before| *before == gaussians));
            played[timestep] = Some(gaussians);
        }
        let mut order: Vec<usize> = (0..num_timesteps).collect();
        let random = &mut scenes::Random(3);
        for i in (1..order.len()).rev() {
            order.swap(i, random.next() as usize % (i + 1));
        }
        let mut other = Player::new(BytesSource::new(&file[..]), settings(bound), 0);
        wait(&mut other, &mut now);
        for &timestep in &order {
            seek(&mut other, timestep);
            wait(&mut other, &mut now);
            let sought = shown(&other);
            assert_eq!(sought, (timestep, expected.at(timestep)));
            assert_eq!(Some(&sought.1), played[timestep].as_ref(), "timestep {timestep} was played");
        }
    }
}

#[test]
fn playing_shows_every_timestep_in_order_and_the_next_segment_is_there_in_time() {
    let file = small_file();
    let mut now = 0.0;
    let mut player = Player::new(BytesSource::new(&file[..]), settings(1 << 30), 0);
    wait(&mut player, &mut now);
    // Updates between frames fetch the rest.
    player.update(now).unwrap();
    player.clock_mut().unwrap().play();
    let mut seen = vec![0];
    for _ in 0..400 {
        now += 10.0;
        player.update(now).unwrap();
        let (timestep, _) = shown(&player);
        if seen.last() != Some(&timestep) {
            seen.push(timestep);
        }
    }
    let expected: Vec<usize> = (0..seen.len()).map(|i| i % 40).collect();
    assert_eq!(seen, expected);
    assert!(seen.len() > 110, "{} timesteps in four seconds of 30 each", seen.len());
}

#[test]
fn how_the_bytes_arrive_does_not_matter() {
    let file = small_file();
    let expected = decode(&file, &DecodeLimits::default()).unwrap();
    let behaviours = [
        Behaviour { piece: 1, ..Default::default() },
        Behaviour { piece: 1000, stalls: 50, ..Default::default() },
        Behaviour { piece: 7, stalls: 1, hides_length: true, ..Default::default() },
    ];
    for behaviour in behaviours {
        let mut now = 0.0;
        let mut player = Player::new(Network::new(&file, behaviour.clone()), settings(1 << 30), 0);
        wait(&mut player, &mut now);
        for timestep in [0, 39, 17] {
            seek(&mut player, timestep);
            wait(&mut player, &mut now);
            assert_eq!(shown(&player), (timestep, expected.at(timestep)), "{behaviour:?}");
        }
    }
}

#[test]
fn a_stall_holds_the_clock_and_nothing_else() {
    let file = small_file();
    let mut player = Player::new(Network::new(&file, Behaviour { stalls: 1000, ..Default::default() }), settings(1), 0);
    let mut now = 0.0;
    wait(&mut player, &mut now);
    player.clock_mut().unwrap().play();
    // Into the next segment, which did not fit as prefetch.
    while player.current().is_some() {
        now += 5.0;
        player.update(now).unwrap();
    }
    let stalled_at = player.clock().unwrap().position();
    for _ in 0..100 {
        now += 1.0;
        player.update(now).unwrap();
        assert!(player.current().is_none());
        assert_eq!(player.clock().unwrap().position(), stalled_at);
    }
    // Seeking back during the stall shows decoded data at once, or fetches them.
    seek(&mut player, 0);
    wait(&mut player, &mut now);
    assert_eq!(shown(&player).0, 0);
}

#[test]
fn opening_at_the_last_timestep_fetches_tables_shared_part_and_one_segment() {
    // Larger than the first request.
    let file = room_file(4000, 60, &CompressSettings { segment_length: Some(6), ..Default::default() });
    let cohort = cohort(&file);
    let (layers, last) = (cohort.num_layers(), cohort.num_segments() - 1);
    let (shared, segment) = (cohort.shared_range(layers), cohort.segment_range(last, layers));
    let opening = PlayerSettings::default().opening_bytes;
    assert!(opening < shared.end && shared.end < segment.start && last == 9);

    let network = Network::new(&file, Behaviour { piece: 1000, stalls: 1, ..Default::default() });
    let log = network.log.clone();
    let mut now = 0.0;
    // No room for another segment, so there is no prefetch.
    let mut player = Player::new(network, PlayerSettings { max_segment_bytes: 1, ..Default::default() }, 59);
    wait(&mut player, &mut now);
    assert_eq!(shown(&player).0, 59);
    for _ in 0..1000 {
        player.update(now).unwrap();
    }
    assert_eq!(log.ranges(), [0..opening, opening..shared.end, segment.clone()]);
    assert_eq!(player.bytes_loaded(), shared.end + segment.end - segment.start);
    // With room, each of the others is fetched once, in the clock's order: around the end first.
    let network = Network::new(&file, Behaviour::default());
    let log = network.log.clone();
    let mut player = Player::new(network, PlayerSettings::default(), 59);
    wait(&mut player, &mut now);
    let until_shown = log.ranges().len();
    assert!(until_shown <= 4, "{:?}", log.ranges());
    for _ in 0..100 {
        player.update(now).unwrap();
    }
    let rest: Vec<_> = (0..last).map(|s| cohort.segment_range(s, layers)).collect();
    assert_eq!(log.ranges()[3..], rest);
    assert_eq!(player.bytes_loaded(), file.len() as u64);
}

#[test]
fn a_small_file_takes_one_request() {
    let file = room_file(20, 4, &CompressSettings::default());
    let settings = PlayerSettings::default();
    let opening = settings.opening_bytes;
    assert!((file.len() as u64) < opening);
    let network = Network::new(&file, Behaviour::default());
    let log = network.log.clone();
    let mut player = Player::new(network, settings, 0);
    wait(&mut player, &mut 0.0);
    assert_eq!(log.ranges(), std::iter::once(0..opening).collect::<Vec<_>>());
}

#[test]
fn the_memory_bound_holds_over_a_long_loop() {
    let file = small_file();
    let cohort = cohort(&file);
    let largest = {
        let mut player = Player::new(BytesSource::new(&file[..]), settings(1 << 30), 0);
        let mut now = 0.0;
        (0..8)
            .map(|s| {
                seek(wait_in(&mut player, &mut now), 5 * s);
                wait(&mut player, &mut now);
                player.current().unwrap().segments[0].bytes()
            })
            .max()
            .unwrap()
    };
    assert_eq!(cohort.num_segments(), 8);
    for (segments, speed) in [(2, 1.0), (3, -1.0), (5, 4.0)] {
        let bound = segments * largest;
        let mut now = 0.0;
        let mut player = Player::new(BytesSource::new(&file[..]), settings(bound), 0);
        wait(&mut player, &mut now);
        player.clock_mut().unwrap().play();
        player.clock_mut().unwrap().set_speed(speed);
        let (mut most, mut missing) = (0, 0);
        for _ in 0..20_000 {
            now += 8.0;
            player.update(now).unwrap();
            missing += usize::from(player.current().is_none());
            most = most.max(player.segment_bytes());
        }
        assert!(most <= bound, "{most} bytes, bound {bound}");
        assert!(most > bound - largest - largest / 2, "{most} bytes: the room of {bound} is used");
        // Two segments are enough to have the next one in time.
        assert!(missing <= 4, "{missing} of 20000 updates without a picture");
    }
}

/// Test vectors of version 2, and a room of several cohorts.
fn files_of_cohorts() -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v2");
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = paths
        .filter(|path| path.extension().is_some_and(|extension| extension == "tcgs"))
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap()))
        .collect();
    assert!(files.len() > 8);
    files.push(("room".into(), cohorts_file(160, &Layout::with_harmonics(1))));
    files
}

#[test]
fn cohorts_come_and_go_as_they_are_due() {
    for (name, file) in files_of_cohorts() {
        let mut expected = SceneFile::open(Cursor::new(&file[..]), &DecodeLimits::default(), 1 << 20).unwrap();
        let num_timesteps = expected.info().num_timesteps as usize;
        let expected: Vec<Gaussians> = (0..num_timesteps).map(|t| expected.at(t).unwrap()).collect();
        for bound in [1 << 30, 20_000, 1] {
            let mut now = 0.0;
            let mut player = Player::new(BytesSource::new(&file[..]), settings(bound), 0);
            for timestep in (0..num_timesteps).chain((0..num_timesteps).map(|i| i * 5 % num_timesteps)) {
                wait_for_tables(&mut player, &mut now);
                seek(&mut player, timestep);
                wait(&mut player, &mut now);
                let (found, gaussians) = shown(&player);
                assert_eq!(found, timestep, "{name}");
                assert_eq!(gaussians.num_gaussians(), expected[timestep].num_gaussians(), "{name}, {timestep}");
                for column in gaussians.layout().attributes() {
                    assert_eq!(gaussians.values(column), expected[timestep].values(column), "{name}, {timestep}");
                }
            }
            // Backwards around the end; no stall if there is room for all.
            player.clock_mut().unwrap().set_speed(-1.0);
            (0..200).for_each(|_| player.update(now).unwrap());
            player.clock_mut().unwrap().play();
            for _ in 0..200 {
                now += 10.0;
                player.update(now).unwrap();
                if bound == 1 << 30 {
                    let (found, gaussians) = shown(&player);
                    assert_eq!(gaussians.means(), expected[found].means(), "{name}, {found}");
                } else {
                    wait(&mut player, &mut now);
                }
            }
        }
    }
}

fn wait_for_tables<S: RangeSource>(player: &mut Player<S>, now: &mut f64) {
    while player.clock().is_none() {
        player.update(*now).unwrap();
        *now += 1.0;
    }
}

#[test]
fn a_timestep_fetches_what_lives_at_it_and_nothing_else() {
    let file = cohorts_file(160, &Layout::with_harmonics(1));
    let network = Network::new(&file, Behaviour::default());
    let log = network.log.clone();
    let mut player = Player::new(network, settings(1), 11);
    let mut now = 0.0;
    wait(&mut player, &mut now);
    for _ in 0..100 {
        player.update(now).unwrap();
    }
    let archive = player.archive().unwrap();
    let alive: Vec<usize> = archive.cohorts_at(11).collect();
    assert_eq!(alive.len(), 2, "the room, and the last flash");
    let starts: u64 =
        alive.iter().map(|&cohort| archive.start_range(cohort)).map(|range| range.end - range.start).sum();
    let fetched: u64 = log.ranges().iter().map(|range| range.end - range.start).sum();
    let tables = archive.head_range(0).start;
    assert!(
        fetched < tables + starts + (file.len() as u64 - tables) / 8,
        "{fetched} of {}: {:?}",
        file.len(),
        log.ranges()
    );
    assert_eq!(player.bytes_loaded(), fetched);
}

#[test]
fn the_first_layer_of_a_long_file_is_shown_first() {
    let file = room_file(40_000, 30, &CompressSettings { segment_length: Some(10), ..Default::default() });
    let cohort = cohort(&file);
    let (layers, first) = (cohort.num_layers(), cohort.layers()[0] as usize);
    assert!(layers == 3 && cohort.shared_range(layers).end > 1 << 17);
    let network = Network::new(&file, Behaviour { piece: 10_000, stalls: 1, ..Default::default() });
    let log = network.log.clone();
    let mut player = Player::new(network, PlayerSettings::default(), 15);
    let mut now = 0.0;
    let coarse = loop {
        player.update(now).unwrap();
        now += 1.0;
        if let Some(moment) = player.current() {
            break moment;
        }
    };
    assert_eq!((coarse.timestep, coarse.is_whole, coarse.gaussians().num_gaussians()), (15, false, first));
    let so_far = player.bytes_loaded();
    assert!(so_far < file.len() as u64 / 5, "{so_far} of {}", file.len());
    // Time waits for the rest.
    player.clock_mut().unwrap().play();
    now += 200.0;
    player.update(now).unwrap();
    assert_eq!(player.clock().unwrap().timestep(), 15);
    player.clock_mut().unwrap().pause();
    wait(&mut player, &mut now);
    let expected = decode(&file, &DecodeLimits::default()).unwrap().at(15);
    assert_eq!(shown(&player), (15, expected.clone()));
    for attribute in expected.layout().attributes() {
        let n = first * attribute.components();
        assert_eq!(coarse.gaussians().values(attribute), &expected.values(attribute)[..n], "{attribute:?}");
    }
    // The rest of the file is fetched without repeating a byte.
    for _ in 0..100_000 {
        now += 1.0;
        player.update(now).unwrap();
    }
    assert_eq!(player.bytes_loaded(), file.len() as u64, "{:?}", log.ranges());
}

fn wait_in<'a, S: RangeSource>(player: &'a mut Player<S>, now: &mut f64) -> &'a mut Player<S> {
    wait(player, now);
    player
}

fn failure(source: impl RangeSource) -> PlayError {
    let mut player = Player::new(source, settings(1 << 30), 0);
    for step in 0..100_000 {
        if let Err(error) = player.update(f64::from(step)) {
            let again = player.update(f64::from(step)).unwrap_err();
            assert_eq!(format!("{again:?}"), format!("{error:?}"), "told again");
            return error;
        }
    }
    panic!("nothing went wrong");
}

#[test]
fn an_early_end_is_told_with_both_lengths() {
    let file = small_file();
    let cohort = cohort(&file);
    let shared = cohort.shared_range(cohort.num_layers());
    let len = file.len() as u64;
    for ends_at in [0, 10, 40, shared.start, shared.end - 1, shared.end + 5, len - 1] {
        for hides_length in [false, true] {
            let behaviour = Behaviour { ends_at: Some(ends_at), hides_length, piece: 100, ..Default::default() };
            let error = failure(Network::new(&file, behaviour));
            let PlayError::Truncated { found, expected } = error else { panic!("{ends_at}: {error:?}") };
            assert_eq!(error.code().as_str(), "truncated");
            assert_eq!(found, ends_at);
            assert!(expected > found && expected <= len, "{ends_at}: {expected}");
        }
    }
}

#[test]
fn what_is_no_scene_is_told_apart() {
    let file = small_file();
    let failure_of = |bytes: &[u8]| failure(BytesSource::new(bytes));
    assert_eq!(failure_of(b"<!DOCTYPE html><html>").code().as_str(), "not-tcgs");
    assert_eq!(failure_of(b"PK\x03\x04").code().as_str(), "not-tcgs");
    let mut newer = file.clone();
    newer[4] = 9;
    assert!(matches!(failure_of(&newer), PlayError::NewerVersion { found: 9, expected: 2 }));
    assert_eq!(failure_of(&newer).code().as_str(), "newer-version");
    // A flipped bit in the tables, the shared part, the first segment.
    let cohort = cohort(&file);
    let layers = cohort.num_layers();
    for at in [20, cohort.shared_range(layers).start + 3, cohort.segment_range(0, layers).start + 3] {
        let mut damaged = file.clone();
        damaged[at as usize] ^= 4;
        let error = failure_of(&damaged);
        assert_eq!(error.code().as_str(), "damaged", "{at}: {error}");
    }
    let mut limits = settings(1 << 30);
    limits.limits.max_gaussians = 100;
    let mut player = Player::new(BytesSource::new(&file[..]), limits, 0);
    assert_eq!(player.update(0.0).unwrap_err().code().as_str(), "out-of-memory");
    let absent = FileSource::open(Path::new("/no/such/scene.tcgs")).unwrap_err();
    assert!(absent.to_string().starts_with("/no/such/scene.tcgs cannot be read: "), "{absent}");
}

#[test]
fn a_connection_that_breaks_is_tried_again_but_not_for_ever() {
    let file = small_file();
    // While opening, the error is reported at once.
    let error = failure(Network::new(&file, Behaviour { piece: 100, breaks: 1, ..Default::default() }));
    assert_eq!(
        (error.code().as_str(), error.to_string().as_str()),
        ("network", "the connection to a network failed: it broke")
    );

    let expected = decode(&file, &DecodeLimits::default()).unwrap();
    let mut player = Player::new(Breaks::new(&file, 3), settings(1), 0);
    let mut now = 0.0;
    wait(&mut player, &mut now);
    let begin = now;
    seek(&mut player, 39);
    wait(&mut player, &mut now);
    assert_eq!(shown(&player), (39, expected.at(39)));
    assert!(now - begin >= 250.0 + 500.0 + 1000.0, "{} ms", now - begin);

    let mut player = Player::new(Breaks::new(&file, usize::MAX), settings(1), 0);
    wait(&mut player, &mut now);
    seek(&mut player, 39);
    let error = (0..100_000).find_map(|step| player.update(now + f64::from(step)).err()).unwrap();
    assert_eq!(error.code().as_str(), "network");
}

/// A network that fails this many times before the last segment.
struct Breaks {
    inner: BytesSource,
    breaks: usize,
    last: u64,
    is_last: bool,
}

impl Breaks {
    fn new(file: &[u8], breaks: usize) -> Self {
        let cohort = cohort(file);
        let last = cohort.segment_range(cohort.num_segments() - 1, 0).start;
        Self { inner: BytesSource::new(file), breaks, last, is_last: false }
    }
}

impl RangeSource for Breaks {
    fn request(&mut self, range: std::ops::Range<u64>) {
        self.is_last = range.start >= self.last;
        self.inner.request(range);
    }

    fn poll(&mut self) -> Result<tcgs_play::Piece, SourceError> {
        if self.is_last && self.breaks > 0 {
            self.breaks -= 1;
            return Err(SourceError::Interrupted { what: "a network".into(), problem: "no answer".into() });
        }
        self.inner.poll()
    }

    fn length(&self) -> Option<u64> {
        self.inner.length()
    }
}

//! Videos with wrong bytes are refused in a line, or decoded. Reading neither panics nor runs for ever.

use std::io::Cursor;
use std::time::{Duration, Instant};

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::*;

/// Time limit for the tables of a file of some kilobytes: a hundred times their usual time.
const MOST: Duration = Duration::from_secs(1);

fn file(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/video").join(name)).unwrap()
}

/// Reads the tables of a file, or returns the fault.
fn read(bytes: &[u8]) -> Result<Option<Track>, String> {
    let begin = Instant::now();
    let track = mp4::read(BufReader::new(Cursor::new(bytes)), bytes.len() as u64);
    assert!(begin.elapsed() < MOST, "{:?}", begin.elapsed());
    track.map_err(|error| match error {
        Mp4Error::Format(problem) => problem,
        Mp4Error::Io(error) => panic!("{error} of bytes in memory"),
    })
}

/// One change of a file: a byte, two zeros, or a number that is none.
fn mutated(whole: &[u8], at: usize, random: &mut Pcg64Mcg) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    let mut put = |new: &[u8]| {
        let end = (at + new.len()).min(bytes.len());
        bytes[at..end].copy_from_slice(&new[..end - at]);
    };
    match random.random_range(0..6) {
        0 => put(&[random.random()]),
        1 => put(&[0, 0]),
        2 => put(&[0; 4]),
        3 => put(&[0xff; 4]),
        4 => put(&[0x7f, 0xff, 0xff, 0xff]),
        _ => put(&random.random::<u32>().to_be_bytes()),
    }
    bytes
}

#[test]
fn tables_of_any_bytes_are_read_or_refused_at_once() {
    let mut random = Pcg64Mcg::new(7);
    for name in ["frames.mp4", "halves.mp4", "hevc.mp4"] {
        let whole = file(name);
        assert!(read(&whole).unwrap().is_some());
        // Every place beside the coded pictures.
        let media = whole.windows(4).position(|w| w == b"mdat").unwrap();
        let begins = (0..media + 4).chain(whole.windows(4).position(|w| w == b"moov").unwrap()..whole.len());
        for at in begins {
            for _ in 0..8 {
                let mut bytes = mutated(&whole, at, &mut random);
                if random.random() {
                    let other = random.random_range(0..whole.len());
                    bytes = mutated(&bytes, other, &mut random);
                }
                if let Err(problem) = read(&bytes) {
                    assert!(!problem.contains('\n') && problem.len() < 200, "{name} {at}: {problem}");
                }
            }
        }
        for length in 0..whole.len() {
            let _ = read(&whole[..length]);
        }
    }
}

#[test]
fn videos_of_any_bytes_are_decoded_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mp4");
    let mut random = Pcg64Mcg::new(8);
    let mut num_refused = 0;
    for name in ["frames.mp4", "halves.mp4", "hevc.mp4"] {
        let whole = file(name);
        for _ in 0..60 {
            let at = random.random_range(0..whole.len());
            std::fs::write(&path, mutated(&whole, at, &mut random)).unwrap();
            let begin = Instant::now();
            let shown = Video::open(&path).and_then(|video| video.frame(video.num_frames() - 1).map(drop));
            assert!(begin.elapsed() < Duration::from_secs(10), "{name} {at}: {:?}", begin.elapsed());
            if let Err(error) = shown {
                let message = error.to_string();
                assert!(message.contains("a.mp4: ") && !message.contains('\n'), "{name} {at}: {message}");
                num_refused += 1;
            }
        }
    }
    assert!((120..180).contains(&num_refused), "{num_refused}");
}

/// A file with another number at a place of four bytes.
///
/// - `after`: the kind of its box; `offset`: bytes from the end of the kind
fn with_number(after: &[u8; 4], offset: usize, number: u32) -> Vec<u8> {
    let mut bytes = file("frames.mp4");
    let at = bytes.windows(4).position(|w| w == after).unwrap() + 4 + offset;
    bytes[at..at + 4].copy_from_slice(&number.to_be_bytes());
    bytes
}

#[test]
fn a_box_of_no_size_is_refused() {
    let mut bytes = file("frames.mp4");
    assert_eq!((&bytes[1325..1329], &bytes[1329..1333]), (&[0, 0, 0, 45][..], &b"hdlr"[..]));
    bytes[1328] = 0;
    assert_eq!(read(&bytes).unwrap_err(), "its box hdlr inside mdia has the size 0, expected 8 to 580");
}

#[test]
fn a_file_that_ends_in_a_long_size_is_refused() {
    // Found by the fuzz target `mp4`.
    assert_eq!(read(b"\0\0\0\x01\0\0\x01\0m").unwrap_err(), "ends inside the head of a box");
}

#[test]
fn tables_that_contradict_each_other_are_refused() {
    for (kind, offset, number, expected) in [
        (b"stts", 8, 5, "its table stts has the times of 5 of 12 frames"),
        (b"ctts", 8, 0, "its table ctts has the times of 11 of 12 frames"),
        (b"ctts", 4, 99, "its box ctts ends early"),
        (b"stsz", 8, 13, "its box stsz ends early"),
        (b"stsc", 8, 2, "its table stsc has no chunks, empty ones, or others than 1, 2, 3 … in this order"),
        (b"stsc", 12, 0, "its table stsc has no chunks, empty ones, or others than 1, 2, 3 … in this order"),
        (b"stsc", 12, 7, "its chunks hold 7 of 12 frames"),
        (b"stco", 4, 2, "its box stco ends early"),
    ] {
        let problem = read(&with_number(kind, offset, number)).map(drop);
        let problem = problem.err().unwrap_or_default();
        assert!(problem.starts_with(expected), "{problem}\nexpected {expected}");
    }
    // All frames are of one size, and there are too many, or too many for the file.
    let mut many = with_number(b"stsz", 4, 1);
    let at = many.windows(4).position(|w| w == b"stsz").unwrap() + 12;
    many[at..at + 4].copy_from_slice(&u32::MAX.to_be_bytes());
    assert_eq!(read(&many).unwrap_err(), "has 4294967295 frames, expected at most 2097152");
}

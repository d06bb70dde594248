//! Any bytes, cut anywhere: the same events, or the same error. Checksums are off.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tcgs_codec::{DecodeLimits, Decoder, Event};

/// Events until the end or an error, in words, and whether there was an error.
fn events<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> (Vec<String>, bool) {
    let mut decoder = Decoder::new(DecodeLimits { max_bytes: 1 << 22, ..Default::default() });
    let mut seen = Vec::new();
    for piece in pieces {
        match decoder.push(piece) {
            Ok(events) => seen.extend(events.iter().map(describe)),
            Err(_) => return (seen, true),
        }
    }
    (seen, false)
}

fn describe(event: &Event) -> String {
    match event {
        Event::Segment(segment) => {
            let values = segment.at(segment.timesteps().start);
            let bits: Vec<u32> = values.means().as_flattened().iter().map(|x| x.to_bits()).collect();
            format!("{} {} {bits:?}", segment.index(), segment.num_layers())
        }
        other => format!("{other:?}"),
    }
}

fuzz_target!(|input: (Vec<u8>, &[u8])| {
    let (cuts, bytes) = input;
    let (whole, failed) = events([bytes]);
    let mut pieces = Vec::new();
    let mut rest = bytes;
    for cut in cuts {
        let (piece, after) = rest.split_at((cut as usize).min(rest.len()));
        pieces.push(piece);
        rest = after;
    }
    pieces.push(rest);
    let (cut, cut_failed) = events(pieces);
    assert_eq!(failed, cut_failed);
    // Where one piece holds both an event and an error, only the error is returned.
    assert!(if failed { cut.starts_with(&whole) } else { cut == whole });
});

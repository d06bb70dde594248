//! Parts of a file: segments, layers, bytes as they arrive.

use std::ops::Range;

use crate::support::any_scene::any_scene;
use crate::support::scenes;
use proptest::prelude::*;
use tcgs_codec::{
    Archive, Cohort, CompactScene, CompressSettings, DecodeLimits, Decoder, Event, Opening, Sampler, SceneFile,
    SceneInfo, SegmentCache, compress, decode, encode, encode_with,
};
use tcgs_core::Gaussians;

fn bytes(file: &[u8], range: Range<u64>) -> &[u8] {
    &file[range.start as usize..range.end as usize]
}

/// Opens a file with as few bytes as possible.
fn open(file: &[u8]) -> Archive {
    let mut length = 0;
    loop {
        match Archive::open(&file[..length], &DecodeLimits::default()).unwrap() {
            Opening::Ready(archive) => return *archive,
            Opening::More(more) => {
                assert!(more > length as u64);
                length = more as usize;
            }
        }
    }
}

/// The only cohort of a file.
fn open_cohort(file: &[u8]) -> Cohort {
    let mut archive = open(file);
    let head = archive.head_range(0);
    archive.open_cohort(0, bytes(file, head)).unwrap()
}

/// The Gaussians of the first layers of a scene.
fn first(scene: &CompactScene, timestep: usize, layers: usize) -> Gaussians {
    let count: u32 = scene.layers[..layers].iter().sum();
    scene.at(timestep).select(&(0..count as usize).collect::<Vec<_>>())
}

/// An event as text, for comparison.
fn describe(event: &Event) -> String {
    match event {
        Event::Segment(segment) => {
            let last = segment.timesteps().end - 1;
            format!("{} {} {:?}", segment.index(), segment.num_layers(), segment.at(last))
        }
        other => format!("{other:?}"),
    }
}

fn events(pieces: &[&[u8]]) -> Vec<String> {
    let mut decoder = Decoder::new(DecodeLimits::default());
    let events: Vec<String> =
        pieces.iter().flat_map(|piece| decoder.push(piece).unwrap()).map(|event| describe(&event)).collect();
    assert!(decoder.is_finished());
    events
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(50))]

    #[test]
    fn every_timestep_of_a_segment_equals_the_whole(
        num_gaussians in 0_usize..20,
        num_timesteps in 1_usize..90,
        seed: u64,
        layers: prop::sample::Index,
    ) {
        let scene = any_scene(num_gaussians, num_timesteps, seed);
        let file = encode(&scene).unwrap();
        let mut archive = open_cohort(&file);
        let layers = layers.index(archive.num_layers() + 1);
        archive.read_shared(bytes(&file, archive.shared_range(layers))).unwrap();
        prop_assert_eq!(archive.layers_read(), layers);
        // A later segment first: the order does not matter.
        for segment in (0..archive.num_segments()).rev() {
            let decoded = archive.read_segment(segment, bytes(&file, archive.segment_range(segment, layers))).unwrap();
            prop_assert_eq!(decoded.num_layers(), layers);
            let mut sampler = Sampler::new(&decoded);
            for timestep in decoded.timesteps() {
                prop_assert_eq!(archive.segment_at(timestep), segment);
                let expected = first(&scene, timestep, layers);
                prop_assert_eq!(&decoded.at(timestep), &expected);
                prop_assert_eq!(sampler.at(timestep), &expected);
            }
            // Backwards, too.
            for timestep in decoded.timesteps().rev() {
                prop_assert_eq!(sampler.at(timestep), &first(&scene, timestep, layers));
            }
        }
    }

    #[test]
    fn where_the_input_is_cut_does_not_matter(
        num_gaussians in 0_usize..12,
        num_timesteps in 1_usize..40,
        seed: u64,
        cuts in prop::collection::vec(any::<prop::sample::Index>(), 0..6),
    ) {
        let file = encode(&any_scene(num_gaussians, num_timesteps, seed)).unwrap();
        let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.index(file.len() + 1)).collect();
        cuts.extend([0, file.len()]);
        cuts.sort_unstable();
        let pieces: Vec<&[u8]> = cuts.windows(2).map(|pair| &file[pair[0]..pair[1]]).collect();
        prop_assert_eq!(events(&pieces), events(&[&file]));
    }
}

#[test]
fn events_come_in_order_and_say_what_the_whole_says() {
    let mut scene = any_scene(12, 20, 7);
    scene.layers = vec![2, 4, 6];
    scene.segment_length = 8;
    let file = encode(&scene).unwrap();
    let mut decoder = Decoder::new(DecodeLimits::default());
    let mut seen = Vec::new();
    for byte in &file {
        for event in decoder.push(std::slice::from_ref(byte)).unwrap() {
            seen.push(match &event {
                Event::Header => "header".to_owned(),
                Event::Layer { layers, .. } => format!("layer {layers}"),
                Event::Segment(segment) => {
                    for timestep in segment.timesteps() {
                        assert_eq!(segment.at(timestep), first(&scene, timestep, segment.num_layers()));
                    }
                    format!("segment {} of {} layers", segment.index(), segment.num_layers())
                }
                Event::End => "end".to_owned(),
            });
        }
    }
    let segments = (0..3).flat_map(|s| (1..=3).map(move |l| format!("segment {s} of {l} layers")));
    let layers = (1..=3).map(|l| format!("layer {l}"));
    let expected: Vec<String> =
        std::iter::once("header".to_owned()).chain(layers).chain(segments).chain(["end".to_owned()]).collect();
    assert_eq!(seen, expected);
    assert!(decoder.push(&[]).unwrap().is_empty());
    let error = decoder.push(&[0]).unwrap_err().to_string();
    assert!(error.ends_with("bytes are left over"), "{error}");
}

#[test]
fn the_first_bytes_of_another_file_are_refused_at_once() {
    let mut decoder = Decoder::new(DecodeLimits::default());
    assert!(decoder.push(b"TC").unwrap().is_empty());
    assert!(decoder.push(b"XX").is_err());
}

/// Found by fuzzing: an empty segment for each of 65,536 timesteps.
#[test]
fn segments_of_nothing_cost_nothing() {
    let empty = CompactScene { segment_length: 1, ..any_scene(0, 65_536, 1) };
    let mut still = any_scene(40, 1, 2);
    still.info.num_timesteps = 65_536;
    still.varies = vec![false; 5];
    still.segment_length = 1;
    still.layers = vec![1; 40];
    for scene in [empty, still] {
        let file = encode(&scene).unwrap();
        assert_eq!(decode(&file, &DecodeLimits::default()).unwrap(), scene);
        assert_eq!(open_cohort(&file).num_segments(), 1);
        assert!(events(&[&file]).len() < 100);
    }
}

#[test]
fn threads_do_not_matter_when_decoding() {
    let scene = scenes::room(900, 30);
    let settings = CompressSettings { segment_length: Some(7), ..Default::default() };
    let compact = compress(&scene, &scenes::mixed_widths(900), None, SceneInfo::of(&scene), &settings).unwrap();
    let run = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        pool.install(|| {
            let file = encode(&compact).unwrap();
            let decoded = decode(&file, &DecodeLimits::default()).unwrap();
            assert_eq!(decoded, compact);
            (file, decoded.at(12))
        })
    };
    assert_eq!(run(1), run(5));
}

#[test]
fn a_segment_needs_few_of_the_bytes() {
    let scene = scenes::room(3000, 60);
    let settings = CompressSettings { segment_length: Some(10), ..Default::default() };
    let compact = compress(&scene, &scenes::mixed_widths(3000), None, SceneInfo::of(&scene), &settings).unwrap();
    let file = encode(&compact).unwrap();
    let archive = open_cohort(&file);
    let all = archive.num_layers();
    let segments: u64 = (0..6).map(|s| archive.segment_range(s, all)).map(|r| r.end - r.start).sum();
    let shared = archive.shared_range(all);
    assert_eq!(shared.end + segments, file.len() as u64);
    let coarse = archive.shared_range(1);
    assert!(coarse.end - coarse.start < (shared.end - shared.start) / 5);
}

#[test]
fn data_of_applications_are_known_from_the_start() {
    let scene = any_scene(9, 24, 6);
    let (plain, data) = (encode(&scene).unwrap(), [("a", &b"one"[..]), ("", &b""[..]), ("b", &[0xff; 300][..])]);
    let file = encode_with(&scene, &data).unwrap();
    let lengths: usize = data.iter().map(|(name, bytes)| 16 + 2 + name.len() + bytes.len()).sum();
    assert_eq!(file.len(), plain.len() + lengths);
    let archive = open(&file);
    let ranges = archive.application_ranges();
    assert!(ranges.iter().all(|range| range.end <= open_cohort(&file).shared_range(1).start), "{ranges:?}");
    let read = |(index, range): (usize, &Range<u64>)| {
        let (name, found) = archive.read_application(index, bytes(&file, range.clone())).unwrap().unwrap();
        (name, found.to_vec())
    };
    let found: Vec<_> = ranges.iter().enumerate().map(read).collect();
    assert_eq!(found, data.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())));
    assert!(archive.read_application(0, b"other").is_err());
    // Application data change nothing else.
    assert_eq!(decode(&file, &DecodeLimits::default()).unwrap(), scene);
    assert_eq!(events(&[&file[..]]), events(&[&plain[..]]));
    // Skipped data are verified all the same.
    let mut damaged = file.clone();
    damaged[ranges[0].end as usize - 1] ^= 1;
    let error = Decoder::new(DecodeLimits::default()).push(&damaged).unwrap_err().to_string();
    assert!(error.contains("checksum in application data"), "{error}");
}

/// A player in a loop decodes the same segments endlessly.
#[test]
fn a_segment_may_be_decoded_any_number_of_times() {
    let scene = scenes::room(900, 30);
    let settings = CompressSettings { segment_length: Some(10), ..Default::default() };
    let compact = compress(&scene, &scenes::mixed_widths(900), None, SceneInfo::of(&scene), &settings).unwrap();
    let file = encode(&compact).unwrap();
    // Just enough memory to read each segment once.
    let limits = DecodeLimits { max_bytes: 1 << 19, ..Default::default() };
    let Opening::Ready(mut archive) = Archive::open(&file, &limits).unwrap() else { panic!("more bytes are needed") };
    let mut archive = archive.open_cohort(0, &[]).unwrap();
    let layers = archive.num_layers();
    archive.read_shared(bytes(&file, archive.shared_range(layers))).unwrap();
    for turn in 0..100 {
        let segment = archive.read_segment(turn % 3, bytes(&file, archive.segment_range(turn % 3, layers))).unwrap();
        assert_eq!(segment.num_layers(), layers);
    }
    // The limit still applies to a single segment.
    let limits = DecodeLimits { max_bytes: 1 << 16, ..Default::default() };
    let Opening::Ready(mut archive) = Archive::open(&file, &limits).unwrap() else { panic!("more bytes are needed") };
    let mut archive = archive.open_cohort(0, &[]).unwrap();
    let read = archive.read_shared(bytes(&file, archive.shared_range(layers)));
    let read = read.and_then(|()| archive.read_segment(0, bytes(&file, archive.segment_range(0, layers))).map(|_| ()));
    assert!(matches!(read, Err(tcgs_codec::DecodeError::Limit { .. })), "{read:?}");
}

/// Codes and the places of their units agree with the floats.
#[test]
fn keypoints_are_those_of_the_floats() {
    let compact = any_scene(9, 17, 3);
    let file = encode(&compact).unwrap();
    let mut archive = open_cohort(&file);
    let layers = archive.num_layers();
    archive.read_shared(bytes(&file, archive.shared_range(layers))).unwrap();
    for index in 0..archive.num_segments() {
        let segment = archive.read_segment(index, bytes(&file, archive.segment_range(index, layers))).unwrap();
        for attribute in tcgs_core::Attribute::BASE {
            let Some(keypoints) = segment.keypoints(attribute) else { continue };
            let units: Vec<_> = segment.moving_units(attribute).collect();
            assert_eq!(keypoints.starts.len(), units.len() + 1);
            for (i, (place, width)) in units.into_iter().enumerate() {
                let range = keypoints.starts[i] as usize..keypoints.starts[i + 1] as usize;
                let times = &keypoints.times[range.clone()];
                assert!(usize::from(times[0]) <= segment.timesteps().start, "{times:?}");
                assert!(usize::from(times[times.len() - 1]) + 1 >= segment.timesteps().end, "{times:?}");
                for (k, &time) in range.zip(times).filter(|(_, t)| segment.timesteps().contains(&usize::from(**t))) {
                    let now = segment.at(time.into());
                    for channel in 0..keypoints.channels {
                        if attribute == tcgs_core::Attribute::Quat {
                            continue; // normalised
                        }
                        let quantizers = &segment.quantizers().attributes[attribute.index()][&width];
                        let quantizer = quantizers[place as usize % attribute.components() + channel];
                        let code = keypoints.codes[k * keypoints.channels + channel];
                        let value = now.values(attribute)[place as usize + channel];
                        assert_eq!(value, quantizer.dequantize(code.into()));
                    }
                }
            }
        }
    }
}

/// Counts the bytes that are read.
struct Counted<'a> {
    file: std::io::Cursor<&'a [u8]>,
    bytes: &'a std::cell::Cell<usize>,
}

impl std::io::Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.bytes.set(self.bytes.get() + count);
        Ok(count)
    }
}

impl std::io::Seek for Counted<'_> {
    fn seek(&mut self, to: std::io::SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

#[test]
fn a_file_is_decoded_where_it_is_read() {
    let scene = scenes::room(900, 60);
    let settings = CompressSettings { segment_length: Some(10), ..CompressSettings::default() };
    let compact = compress(&scene, &scenes::mixed_widths(900), None, SceneInfo::of(&scene), &settings).unwrap();
    let file = encode(&compact).unwrap();
    let bytes = std::cell::Cell::new(0);
    let open = |file, max_segment_bytes| {
        bytes.set(0);
        let source = Counted { file: std::io::Cursor::new(file), bytes: &bytes };
        SceneFile::open(source, &DecodeLimits::default(), max_segment_bytes)
    };
    let mut reader = open(&file[..], usize::MAX).unwrap();
    let length = |segment| {
        let cohort = open_cohort(&file);
        let range = cohort.segment_range(segment, cohort.num_layers());
        (range.end - range.start) as usize
    };
    let (third, fourth) = (length(2), length(3));
    let opened = bytes.get();
    assert_eq!(reader.at(25).unwrap(), compact.at(25));
    assert_eq!(reader.at(29).unwrap(), compact.at(29));
    assert_eq!(bytes.get() - opened, third, "one segment is read once");
    assert_eq!(reader.at(30).unwrap(), compact.at(30));
    assert_eq!(reader.at(21).unwrap(), compact.at(21));
    assert_eq!(bytes.get() - opened, third + fourth);

    // Space for two segments: of three, the least recently used is read again.
    let two = 2 * (0..6).map(|i| reader.segment(0, i).unwrap().bytes()).max().unwrap();
    let mut reader = open(&file[..], two).unwrap();
    for timestep in [0, 10, 0, 20] {
        assert_eq!(reader.at(timestep).unwrap(), compact.at(timestep));
    }
    assert!(reader.cached_bytes() <= two);
    let before = bytes.get();
    reader.at(0).unwrap();
    assert_eq!(bytes.get(), before);
    reader.at(10).unwrap();
    assert!(bytes.get() > before);
    // Without space for any, the segment in use is held.
    let mut reader = open(&file[..], 0).unwrap();
    assert!((0..60).rev().all(|t| reader.at(t).unwrap() == compact.at(t)));

    let refuses = |file: &[u8], message: &str| {
        let source = std::io::Cursor::new(file);
        let error = SceneFile::open(source, &DecodeLimits::default(), 0).err().unwrap();
        assert_eq!(error.to_string(), message);
    };
    let end = file.len() - 1;
    refuses(&file[..end], &format!("invalid end in file at byte {end}: the file ends early"));
    refuses(&file[..100], "invalid end in file at byte 100: the file ends early");
    let longer = [&file[..], &[0]].concat();
    refuses(&longer, &format!("invalid end in file at byte {}: bytes are left over", longer.len()));
    // A damaged segment is an error when it is read; the others can be read.
    let mut damaged = file.clone();
    damaged[end] ^= 1;
    let mut reader = open(&damaged, usize::MAX).unwrap();
    assert_eq!(reader.at(49).unwrap(), compact.at(49));
    assert!(reader.at(50).is_err());
    assert_eq!(reader.at(49).unwrap(), compact.at(49));
}

#[test]
fn the_least_recently_used_segment_goes_first() {
    let scene = scenes::room(200, 40);
    let settings = CompressSettings { segment_length: Some(10), ..CompressSettings::default() };
    let compact = compress(&scene, &scenes::mixed_widths(200), None, SceneInfo::of(&scene), &settings).unwrap();
    let file = std::io::Cursor::new(encode(&compact).unwrap());
    let mut reader = SceneFile::open(file, &DecodeLimits::default(), 0).unwrap();
    let segments: Vec<_> = (0..4).map(|i| reader.segment(0, i).unwrap()).collect();
    let largest = segments.iter().map(|s| s.bytes()).max().unwrap();
    let mut cache = SegmentCache::new(2 * largest);
    cache.insert(segments[0].clone());
    cache.insert(segments[1].clone());
    assert!(cache.recall(0).is_some());
    cache.insert(segments[2].clone());
    assert!(cache.recall(0).is_some() && cache.recall(1).is_none() && cache.recall(2).is_some());
    cache.make_room();
    assert!(cache.bytes() <= largest && cache.recall(2).is_some());
    // A single segment may exceed the bound.
    let mut cache = SegmentCache::new(1);
    cache.insert(segments[3].clone());
    assert!(cache.recall(3).is_some());
}

/// A header of version 1 without sections is shorter than any of version 2; found by fuzzing.
#[test]
fn a_short_header_is_refused_however_it_arrives() {
    let mut header = b"TCGS".to_vec();
    header.extend([1, 0, 0, 0, 0, 0, 0, 0]);
    let checksum = crc32fast::hash(&header);
    header.extend(checksum.to_le_bytes());
    for cut in 0..=header.len() {
        let mut decoder = Decoder::new(DecodeLimits::default());
        let events = decoder.push(&header[..cut]).and_then(|_| decoder.push(&header[cut..]));
        assert!(events.is_err(), "cut at {cut}: {events:?}");
    }
}

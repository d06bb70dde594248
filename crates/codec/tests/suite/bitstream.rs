//! Symbols survive as bytes, and bytes that are not a file are refused.

use std::ops::Range;

use crate::support::any_scene::any_scene;
use crate::support::scenes;
use proptest::prelude::*;
use tcgs_codec::{
    BitMap, CompactScene, CompressSettings, DecodeError, DecodeLimits, Decoder, Event, SceneInfo, Segment, Tracks,
    compress, decode, encode, inspect,
};
use tcgs_core::Attribute;

/// Bytes before the table of contents, and of each of its entries.
const HEADER_BYTES: usize = 16;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    #[test]
    fn every_scene_comes_back_field_by_field(
        num_gaussians in 0_usize..30,
        num_timesteps in prop::sample::select(vec![1_usize, 2, 3, 24, 255, 256, 257, 300]),
        seed: u64,
    ) {
        let scene = any_scene(num_gaussians, num_timesteps, seed);
        let file = encode(&scene).unwrap();
        prop_assert_eq!(&encode(&scene).unwrap(), &file);
        let decoded = decode(&file, &DecodeLimits::default()).unwrap();
        prop_assert_eq!(&decoded.info, &scene.info);
        prop_assert_eq!(&decoded.bit_map, &scene.bit_map);
        prop_assert_eq!(&decoded.quantizers, &scene.quantizers);
        for attribute in Attribute::BASE {
            prop_assert_eq!(&decoded.tracks[attribute.index()], &scene.tracks[attribute.index()], "{:?}", attribute);
        }
        prop_assert_eq!(&decoded, &scene);
        // The memory that docs/FORMAT.md requires every decoder to allow is enough.
        let max_bytes = 1024 + 512 * num_gaussians as u64 + 16 * num_codes(&file);
        let limits = DecodeLimits { max_bytes, ..Default::default() };
        prop_assert!(decode(&file, &limits).is_ok());
        let info = inspect(&file, &DecodeLimits::default()).unwrap();
        prop_assert!(info.checksums_ok());
        let contents = info.contents.unwrap();
        let means: Vec<f64> = contents.keypoints_mean.iter().map(|(_, mean)| *mean).collect();
        prop_assert_eq!(means, scene.keypoints_mean());
        let histograms: Vec<_> = contents.bits_histogram.into_iter().map(|(_, histogram)| histogram).collect();
        prop_assert_eq!(histograms, scene.bit_map.histogram());
        for mean in (0..num_timesteps).step_by(29).flat_map(|t| scene.at(t).means().to_vec()) {
            for i in 0..3 {
                let slack = 1e-6 * mean[i].abs();
                prop_assert!(info.bounds[0][i] - slack <= mean[i] && mean[i] <= info.bounds[1][i] + slack);
            }
        }
    }

    /// Damage with correct checksums: a file that still decodes gives a usable scene.
    #[test]
    fn resealed_damage_never_panics(
        seed: u64,
        num_timesteps in 1_usize..40,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut file = encode(&any_scene(5, num_timesteps, seed)).unwrap();
        let start = sections(&file)[0].1.start;
        for (at, value) in damage {
            let at = start + at.index(file.len() - start);
            file[at] = value;
        }
        reseal(&mut file);
        if let Ok(scene) = decode(&file, &DecodeLimits { max_bytes: 1 << 24, ..Default::default() }) {
            scene.at(scene.num_timesteps() - 1);
            prop_assert_eq!(decode(&encode(&scene).unwrap(), &DecodeLimits::default()).unwrap().tracks, scene.tracks);
        }
    }
}

/// Number of codes at keypoints in all segments; those that two segments share count twice.
fn num_codes(file: &[u8]) -> u64 {
    let mut decoder = Decoder::new(DecodeLimits::none());
    let events = decoder.push(file).unwrap();
    let layers = events.iter().filter(|event| matches!(event, Event::Layer { .. })).count();
    let of_segment = |segment: &Segment| {
        Attribute::BASE
            .into_iter()
            .filter_map(|a| segment.keypoints(a))
            .map(|keypoints| keypoints.codes.len() as u64)
            .sum()
    };
    let codes = events.iter().map(|event| match event {
        Event::Segment(segment) if segment.num_layers() == layers => of_segment(segment),
        _ => 0,
    });
    codes.sum()
}

/// Tag, place, segment and layer of every section.
fn sections(file: &[u8]) -> Vec<([u8; 4], Range<usize>)> {
    let number = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
    let count = number(8);
    let mut start = HEADER_BYTES + 16 * count;
    (0..count)
        .map(|i| {
            let entry = HEADER_BYTES + 16 * i;
            let end = start + number(entry + 8);
            (file[entry..entry + 4].try_into().unwrap(), std::mem::replace(&mut start, end)..end)
        })
        .collect()
}

/// Corrects all checksums.
fn reseal(file: &mut [u8]) {
    let sections = sections(file);
    for (i, (_, range)) in sections.iter().enumerate() {
        let checksum = crc32fast::hash(&file[range.clone()]);
        file[HEADER_BYTES + 16 * i + 12..][..4].copy_from_slice(&checksum.to_le_bytes());
    }
    let header = [&file[..12], &file[HEADER_BYTES..HEADER_BYTES + 16 * sections.len()]].concat();
    file[12..16].copy_from_slice(&crc32fast::hash(&header).to_le_bytes());
}

/// Changes bytes of a section, corrects the checksums, and returns the reason of the refusal.
fn refusal(scene: &CompactScene, tag: &[u8; 4], offset: usize, bytes: &[u8]) -> String {
    let mut file = encode(scene).unwrap();
    let (_, range) = sections(&file).into_iter().find(|(t, _)| t == tag).unwrap();
    file[range.start + offset..][..bytes.len()].copy_from_slice(bytes);
    reseal(&mut file);
    decode(&file, &DecodeLimits::default()).expect_err("it was damaged").to_string()
}

#[test]
fn a_file_cut_anywhere_is_refused() {
    let file = encode(&any_scene(4, 24, 1)).unwrap();
    assert!(decode(&file, &DecodeLimits::default()).is_ok());
    for length in 0..file.len() {
        assert!(decode(&file[..length], &DecodeLimits::default()).is_err(), "cut to {length} of {}", file.len());
        assert!(inspect(&file[..length], &DecodeLimits::default()).is_err(), "cut to {length} of {}", file.len());
    }
}

#[test]
fn a_file_with_any_byte_changed_is_refused() {
    let file = encode(&any_scene(4, 24, 2)).unwrap();
    for at in 0..file.len() {
        for mask in [0x01, 0x80, 0xff] {
            let mut changed = file.clone();
            changed[at] ^= mask;
            assert!(decode(&changed, &DecodeLimits::default()).is_err(), "byte {at} of {} ^ {mask}", file.len());
        }
    }
}

#[test]
fn a_damaged_section_is_reported_by_name() {
    let mut file = encode(&any_scene(4, 24, 3)).unwrap();
    let (_, range) = sections(&file).into_iter().find(|(tag, _)| tag == b"QUAT").unwrap();
    file[range.start] ^= 1;
    let info = inspect(&file, &DecodeLimits::default()).unwrap();
    assert!(!info.checksums_ok() && info.contents.is_none());
    let damaged: Vec<&str> =
        info.sections.iter().filter(|s| s.checksum_ok != Some(true)).map(|s| s.name.as_str()).collect();
    assert_eq!(damaged, ["quats"]);
    let error = decode(&file, &DecodeLimits::default()).unwrap_err().to_string();
    assert_eq!(error, format!("invalid checksum in quats at byte {}: the section is damaged", range.start));
}

#[test]
fn sections_and_header_make_up_the_file() {
    let file = encode(&any_scene(50, 24, 4)).unwrap();
    let info = inspect(&file, &DecodeLimits::default()).unwrap();
    assert_eq!(info.bytes, file.len() as u64);
    let header = (HEADER_BYTES + 16 * info.sections.len()) as u64;
    assert_eq!(info.sections.iter().map(|s| s.bytes).sum::<u64>() + header, info.bytes);
    assert!(info.bytes_by_attribute().iter().all(|(_, bytes)| *bytes > 0));
    // Segments follow each other to the end of the file.
    let segments = &info.cohorts[0].segments;
    let ends: Vec<u64> = segments.iter().map(|(_, bytes)| bytes.end).collect();
    assert_eq!(ends.last(), Some(&info.bytes));
    assert!(segments.windows(2).all(|pair| pair[0].1.end == pair[1].1.start && pair[0].0.end == pair[1].0.start));
}

#[test]
fn another_version_trailing_bytes_and_other_files_are_refused() {
    let file = encode(&any_scene(1, 1, 5)).unwrap();
    let refused = |file: &[u8]| decode(file, &DecodeLimits::default()).unwrap_err();
    let mut newer = file.clone();
    newer[4] = 3;
    assert!(matches!(refused(&newer), DecodeError::Version { found: 3, expected: 2 }));
    let mut longer = file.clone();
    longer.push(0);
    assert_eq!(
        refused(&longer).to_string(),
        format!("invalid end in file at byte {}: bytes are left over", longer.len())
    );
    assert_eq!(refused(b"PK\x03\x04").to_string(), "invalid magic in header at byte 0: this is not a .tcgs file");
    assert_eq!(refused(&[]).to_string(), "invalid end in file at byte 0: the file ends early");
}

/// Appends a section to the table of contents and to the file.
fn with_section(file: &[u8], tag: &[u8; 4], bytes: &[u8]) -> Vec<u8> {
    let count = sections(file).len();
    let (header, body) = file.split_at(HEADER_BYTES + 16 * count);
    let entry = [&tag[..], &[0xff, 0xff, 0, 0], &(bytes.len() as u32).to_le_bytes(), &[0; 4]].concat();
    let mut longer = [header, &entry, body, bytes].concat();
    longer[8..12].copy_from_slice(&(count as u32 + 1).to_le_bytes());
    reseal(&mut longer);
    longer
}

#[test]
fn unknown_sections_are_skipped_if_they_may_be() {
    let scene = any_scene(9, 24, 6);
    let file = encode(&scene).unwrap();
    let limits = DecodeLimits::default();
    let optional = with_section(&file, b"new1", b"something");
    assert_eq!(decode(&optional, &limits).unwrap(), scene);
    let application = with_section(&optional, b"appl", b"\x05\0notesabc");
    assert_eq!(decode(&application, &limits).unwrap(), scene);
    let data = tcgs_codec::application_data(&application, &limits).unwrap();
    assert_eq!(data, [("notes".to_owned(), &b"abc"[..])]);
    // A name that is not UTF-8, or that is longer than its section: no decoder needs it.
    for nameless in [&b"\x02\0\xff\xfe"[..], b"\x05\0not", b""] {
        let file = with_section(&application, b"appl", nameless);
        assert_eq!(decode(&file, &limits).unwrap(), scene);
        assert_eq!(tcgs_codec::application_data(&file, &limits).unwrap(), data);
    }
    let error = decode(&with_section(&file, b"NEW1", b""), &limits).unwrap_err().to_string();
    assert!(error.ends_with("a section that this decoder does not know and may not skip"), "{error}");
    let error = decode(&with_section(&file, b"MEAN", b""), &limits).unwrap_err().to_string();
    assert!(error.ends_with("a section too many"), "{error}");
}

#[test]
fn huge_counts_are_refused_before_anything_is_allocated() {
    let scene = any_scene(4, 24, 6);
    let gaussians = refusal(&scene, b"INFO", 0, &u32::MAX.to_le_bytes());
    assert_eq!(gaussians, "scene needs 4294967295 Gaussians, limit is 16777216");
    let timesteps = refusal(&scene, b"INFO", 4, &u32::MAX.to_le_bytes());
    assert_eq!(timesteps, "scene needs 4294967295 timesteps, limit is 65536");
    // Within the limits of counts, but more than so small a file may use.
    let mut file = encode(&CompactScene { layers: vec![4], ..scene }).unwrap();
    let info = sections(&file)[0].1.clone();
    file[info.start..info.start + 4].copy_from_slice(&16_000_000_u32.to_le_bytes());
    file[info.end - 4..info.end].copy_from_slice(&16_000_000_u32.to_le_bytes());
    reseal(&mut file);
    let error = decode(&file, &DecodeLimits::default()).unwrap_err();
    assert!(matches!(error, DecodeError::Limit { what: "layer", unit: "bytes", .. }), "{error}");
    // A length beyond the end of the file.
    file[HEADER_BYTES + 8..HEADER_BYTES + 12].copy_from_slice(&u32::MAX.to_le_bytes());
    let header = [&file[..12], &file[HEADER_BYTES..info.start]].concat();
    file[12..16].copy_from_slice(&crc32fast::hash(&header).to_le_bytes());
    let error = decode(&file, &DecodeLimits::default()).unwrap_err().to_string();
    assert!(error.ends_with("the file ends early"), "{error}");
}

#[test]
fn memory_stays_within_its_limit() {
    let scene = scenes::room(3000, 24);
    let bit_map = scenes::mixed_widths(3000);
    let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default()).unwrap();
    let file = encode(&compact).unwrap();
    let limited = |max_bytes| decode(&file, &DecodeLimits { max_bytes, ..Default::default() });
    for max_bytes in [0, 1000, 100_000, 300_000] {
        assert!(matches!(limited(max_bytes).unwrap_err(), DecodeError::Limit { unit: "bytes", .. }), "{max_bytes}");
    }
    assert_eq!(limited(2_000_000).unwrap(), compact);
}

/// Codes of 4 bits, all 0, at 0, 2 and 4 of five timesteps.
fn small_scene() -> CompactScene {
    let mut scene = any_scene(1, 5, 0);
    scene.varies = vec![true, true, false, false, true];
    scene.layers = vec![1];
    scene.segment_length = 5;
    scene.info.name.clear();
    scene.bit_map = BitMap::uniform(1, 4, 4);
    for attribute in Attribute::BASE {
        let a = attribute.index();
        scene.tracks[a] = Tracks::default();
        let times: &[u16] = if scene.varies[a] { &[0, 2, 4] } else { &[0] };
        (0..attribute.components()).for_each(|_| scene.tracks[a].push(times, &vec![0; times.len()]));
        let channels = vec![tcgs_codec::Quantizer::new(1.0, 0.0, 4).unwrap(); attribute.components()];
        scene.quantizers.attributes[a] = [(4, channels)].into();
    }
    scene
}

#[test]
fn values_out_of_range_are_refused_with_their_place() {
    const NEWER: &str = "not known to this decoder; a newer one may read the file";
    let scene = small_scene();
    let ends = |tag: &[u8; 4], offset, bytes: &[u8], problem: &str| {
        let error = refusal(&scene, tag, offset, bytes);
        assert!(error.ends_with(problem), "{error}, expected {problem}");
    };
    ends(b"INFO", 4, &0_u32.to_le_bytes(), "not within 1 to 65536");
    ends(b"INFO", 12, &0_u32.to_le_bytes(), "zero");
    ends(b"INFO", 16, &f32::NAN.to_le_bytes(), "negative or not finite");
    ends(b"INFO", 20, &f32::INFINITY.to_le_bytes(), "not finite or not ascending");
    ends(b"INFO", 20, &1e9_f32.to_le_bytes(), "not finite or not ascending");
    ends(b"INFO", 44, &[2], NEWER);
    ends(b"INFO", 45, &[7], NEWER);
    ends(b"INFO", 46, &9999_u16.to_le_bytes(), "reaches past the end");
    // Flags, then for means: interpolation, number of widths, width, step, offset.
    ends(b"PLAN", 0, &[0x20], "more attributes than there are");
    ends(b"PLAN", 1, &[0x80], "more attributes than there are");
    ends(b"PLAN", 2, &[1], NEWER);
    ends(b"PLAN", 4, &[0], "the width is not within 1 to 16 bits");
    ends(b"PLAN", 4, &[5], "a width without quantizers");
    ends(b"PLAN", 5, &0.0_f32.to_le_bytes(), "the step is not a positive finite number");
    ends(b"PLAN", 9, &f32::NAN.to_le_bytes(), "the offset is not finite");
    // A decoder's state is never below 2^31.
    ends(b"MAPS", 0, &[0; 8], "not exactly as many as there should be");
}

#[test]
fn a_constant_track_is_no_line() {
    let mut scene = small_scene();
    scene.tracks[Attribute::Color.index()] = Tracks::default();
    for _ in 0..3 {
        scene.tracks[Attribute::Color.index()].push(&[0], &[-8]);
    }
    let decoded = decode(&encode(&scene).unwrap(), &DecodeLimits::default()).unwrap();
    assert_eq!(decoded, scene);
    assert_eq!(decoded.at(4).colors(), [[-8.0; 3]]);
}

#[test]
fn a_scene_with_a_code_outside_its_width_is_not_encoded() {
    let mut scene = small_scene();
    scene.tracks[Attribute::LogitOpacity.index()] = Tracks::default();
    scene.tracks[Attribute::LogitOpacity.index()].push(&[0], &[8]);
    let message = "invalid codes in logit_opacities: a code outside its width";
    assert_eq!(encode(&scene).unwrap_err().to_string(), message);
}

/// A segment's number has 16 bits, and 65535 marks sections that all segments share.
#[test]
fn a_scene_of_65_536_segments_is_not_encoded() {
    let mut scene = any_scene(1, 65_536, 0);
    for attribute in Attribute::BASE {
        let tracks = &mut scene.tracks[attribute.index()];
        *tracks = Tracks::default();
        (0..attribute.components()).for_each(|_| tracks.push(&[0], &[0]));
    }
    scene.varies = vec![true, false, false, false, false];
    scene.segment_length = 1;
    let error = encode(&scene).unwrap_err().to_string();
    assert_eq!(error, "invalid number of segments: found 65536, expected 65535");
    // One timestep fewer, and so one segment fewer.
    scene.info.num_timesteps -= 1;
    let file = encode(&scene).unwrap();
    assert_eq!(decode(&file, &DecodeLimits::default()).unwrap(), scene);
    let info = sections(&file)[0].1.clone();
    let mut one_more = file;
    one_more[info.start + 4..info.start + 8].copy_from_slice(&65_536_u32.to_le_bytes());
    reseal(&mut one_more);
    let error = decode(&one_more, &DecodeLimits::default()).unwrap_err().to_string();
    let place = format!("invalid segment_length in info at byte {}", info.start);
    assert_eq!(error, format!("{place}: more than 65535 segments"));
}

#[test]
fn a_position_beyond_what_floats_say_is_not_encoded() {
    let mut scene = small_scene();
    scene.quantizers.attributes[Attribute::Mean.index()].values_mut().flatten().for_each(|q| q.step = f32::MAX);
    scene.tracks[Attribute::Mean.index()] = Tracks::default();
    (0..3).for_each(|_| scene.tracks[Attribute::Mean.index()].push(&[0], &[-8]));
    let message = "invalid codes in means: a code that stands for no finite number";
    assert_eq!(encode(&scene).unwrap_err().to_string(), message);
}

/// Size of a realistic scene. The ceiling is 2 % above the measured size: growth needs a reason.
#[test]
fn a_room_stays_small() {
    let num_gaussians = 20_000;
    let scene = scenes::room(num_gaussians, 24);
    for (name, bit_map, ceiling) in [
        ("4 to 8 bits", scenes::mixed_widths(num_gaussians), 18.0),
        ("6 bits", BitMap::uniform(num_gaussians, 16, 6), 16.7),
    ] {
        let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default()).unwrap();
        let file = encode(&compact).unwrap();
        let per_gaussian = |bytes: u64| bytes as f64 / num_gaussians as f64;
        let info = inspect(&file, &DecodeLimits::default()).unwrap();
        for section in &info.sections {
            println!("{name}: {:.3} bytes per Gaussian of {}", per_gaussian(section.bytes), section.name);
        }
        let total = per_gaussian(info.bytes);
        println!("{name}: {total:.3} in all, plain {:.3}", per_gaussian(compact.plain_bytes()));
        println!("{name}: keypoints {:.2?}", compact.keypoints_mean());
        assert!(total < ceiling, "{name}: {total} bytes per Gaussian, expected below {ceiling}");
    }
}

//! Files of version 2: cohorts, lives, further attributes, which Gaussians may lack.

use std::io::Cursor;
use std::ops::Range;

use crate::support::any_scene::{any_cohort, any_cohorts, any_scene};
use proptest::prelude::*;
use tcgs_codec::{
    Archive, CompactScene, DecodeError, DecodeLimits, Decoder, Event, FileWriter, Opening, Sampler, SceneFile,
    SceneInfo, SegmentCache, application_data, decode, decode_cohorts, encode, encode_cohorts, inspect,
};
use tcgs_core::Gaussians;

/// The Gaussians that live at a timestep, by definition, and their indices among all.
fn alive(cohorts: &[CompactScene], timestep: usize) -> (Vec<Gaussians>, Vec<usize>) {
    let (mut parts, mut indices, mut before) = (Vec::new(), Vec::new(), 0);
    for cohort in cohorts {
        let first = before;
        before += cohort.num_gaussians();
        let start = cohort.start as usize;
        if !(start..start + cohort.num_timesteps()).contains(&timestep) {
            continue;
        }
        let now = timestep - start;
        let lives = |g: usize| {
            cohort.lives.as_ref().is_none_or(|lives| (lives[g].birth..lives[g].death).contains(&(now as u32)))
        };
        let living: Vec<usize> = (0..cohort.num_gaussians()).filter(|&g| lives(g)).collect();
        parts.push(cohort.at(now).select(&living));
        indices.extend(living.iter().map(|g| first + g));
    }
    (parts, indices)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn every_file_comes_back(count in 0_usize..5, seed: u64) {
        let (info, cohorts) = any_cohorts(count, seed);
        let file = encode_cohorts(&info, &cohorts, &[("notes", b"red")]).unwrap();
        let limits = DecodeLimits::default();
        let (described, decoded) = decode_cohorts(&file, &limits).unwrap();
        prop_assert_eq!((&described, &decoded), (&info, &cohorts));
        prop_assert_eq!(&encode_cohorts(&info, &decoded, &[("notes", b"red")]).unwrap(), &file);
        prop_assert_eq!(application_data(&file, &limits).unwrap(), [("notes".to_owned(), &b"red"[..])]);
        let described = inspect(&file, &limits).unwrap();
        prop_assert!(described.checksums_ok() && described.version == 2 && described.contents.is_some());
        prop_assert_eq!(described.cohorts.len(), count);

        let mut reader = SceneFile::open(Cursor::new(&file[..]), &limits, SegmentCache::DEFAULT_BYTES).unwrap();
        prop_assert_eq!(reader.info(), &info);
        let layout = cohorts.first().map_or_else(tcgs_core::Layout::base, |cohort| cohort.layout.clone());
        for timestep in (0..info.num_timesteps as usize).rev().chain(0..info.num_timesteps as usize) {
            let (parts, indices) = alive(&cohorts, timestep);
            prop_assert_eq!(reader.at(timestep).unwrap(), Gaussians::concat(&layout, &parts), "{}", timestep);
            prop_assert_eq!(reader.living(timestep).unwrap(), indices, "{}", timestep);
        }
    }

    /// Each cohort's segments come with all of its layers, in the order in which they are needed.
    #[test]
    fn a_file_that_arrives_in_pieces_says_the_same(count in 1_usize..4, seed: u64, piece in 1_usize..200) {
        let (info, cohorts) = any_cohorts(count, seed);
        let file = encode_cohorts(&info, &cohorts, &[]).unwrap();
        let mut decoder = Decoder::new(DecodeLimits::default());
        let (mut begun, mut timesteps) = (0, vec![0; count]);
        for bytes in file.chunks(piece) {
            for event in decoder.push(bytes).unwrap() {
                let Event::Segment(segment) = event else { continue };
                let which = segment.cohort();
                prop_assert!(segment.timesteps().start >= begun);
                begun = segment.timesteps().start;
                if segment.num_layers() == cohorts[which].layers.len() {
                    timesteps[which] += segment.timesteps().len();
                    let mut sampler = Sampler::new(&segment);
                    for timestep in segment.timesteps() {
                        let living = segment.alive(timestep);
                        let living = living.unwrap_or_else(|| (0..segment.num_gaussians()).collect());
                        let expected = cohorts[which].at(timestep - segment.start()).select(&living);
                        prop_assert_eq!(sampler.at(timestep).select(&living), expected);
                    }
                }
            }
        }
        prop_assert!(decoder.is_finished());
        let expected: Vec<usize> = cohorts.iter().map(CompactScene::num_timesteps).collect();
        prop_assert_eq!(timesteps, expected);
    }

    #[test]
    fn a_file_that_was_cut_gives_the_timesteps_that_are_whole(count in 1_usize..4, seed: u64, at: prop::sample::Index) {
        let (info, cohorts) = any_cohorts(count, seed);
        let file = encode_cohorts(&info, &cohorts, &[]).unwrap();
        let cut = &file[..at.index(file.len())];
        let limits = DecodeLimits::default();
        prop_assert!(SceneFile::open(Cursor::new(cut), &limits, 0).is_err());
        if let Ok(mut reader) = SceneFile::recover(Cursor::new(cut), &limits, 0) {
            let (left, layout) = (reader.info().clone(), reader.layout().clone());
            prop_assert!(left.num_timesteps > 0 && reader.loss().is_some());
            for timestep in 0..left.num_timesteps as usize {
                let now = reader.at(timestep).unwrap();
                if left.num_gaussians == info.num_gaussians {
                    prop_assert_eq!(now, Gaussians::concat(&layout, &alive(&cohorts, timestep).0));
                }
            }
        }
    }

    #[test]
    fn damage_with_right_checksums_never_panics(
        seed: u64,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let (info, cohorts) = any_cohorts(2, seed);
        let mut file = encode_cohorts(&info, &cohorts, &[]).unwrap();
        for (at, value) in damage {
            let at = 20 + at.index(file.len() - 20);
            file[at] = value;
        }
        reseal(&mut file);
        let limits = DecodeLimits { max_bytes: 1 << 24, ..Default::default() };
        for cohort in decode_cohorts(&file, &limits).map(|(_, cohorts)| cohorts).unwrap_or_default() {
            cohort.at(cohort.num_timesteps() - 1);
        }
        if let Ok(mut reader) = SceneFile::recover(Cursor::new(&file[..]), &limits, 0) {
            for timestep in 0..reader.info().num_timesteps.min(50) as usize {
                let _ = reader.at(timestep);
            }
        }
    }
}

fn number(file: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(file[at..at + 8].try_into().unwrap())
}

/// Corrects the checksums of the header, of sections and of heads.
fn reseal(file: &mut [u8]) {
    let crc = |file: &[u8], range: Range<u64>| {
        let range = range.start.min(file.len() as u64) as usize..range.end.min(file.len() as u64) as usize;
        crc32fast::hash(file.get(range).unwrap_or(&[])).to_le_bytes()
    };
    let count = usize::from(u16::from_le_bytes([file[6], file[7]])).min((file.len() - 20) / 24);
    let entry = |file: &[u8], i: usize| {
        let start = number(file, 20 + 24 * i + 8);
        start..start.saturating_add(number(file, 20 + 24 * i + 16))
    };
    if count > 1 {
        let cohorts = entry(file, 1);
        let end = cohorts.end.min(file.len() as u64) as usize;
        let first = (cohorts.start as usize).saturating_add(4);
        for at in (first..end.saturating_sub(35)).step_by(36) {
            let head_bytes = u32::from_le_bytes(file[at + 16..at + 20].try_into().unwrap());
            let start = number(file, at + 28);
            let sum = crc(file, start..start.saturating_add(head_bytes.into()));
            file[at + 20..at + 24].copy_from_slice(&sum);
        }
    }
    for i in 0..count {
        let sum = crc(file, entry(file, i));
        file[20 + 24 * i + 4..][..4].copy_from_slice(&sum);
    }
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&file[..16]);
    hasher.update(&file[20..20 + 24 * count]);
    file[16..20].copy_from_slice(&hasher.finalize().to_le_bytes());
}

#[test]
fn one_cohort_of_all_timesteps_is_the_scene_of_version_1() {
    let scene = any_scene(30, 40, 3);
    let file = encode_cohorts(&scene.info, std::slice::from_ref(&scene), &[]).unwrap();
    assert_eq!(decode(&file, &DecodeLimits::default()).unwrap(), scene);
    // The tables of version 2 are no longer than those of version 1, apart from the names of attributes.
    let first = encode(&scene).unwrap();
    assert!(file.len() < first.len() + 256, "{} bytes, {} in version 1", file.len(), first.len());
}

#[test]
fn what_version_1_cannot_hold_is_said() {
    let cohort = (0..).map(|seed| any_cohort(3, 9, 0, seed)).find(|cohort| cohort.lives.is_some()).unwrap();
    let error = encode(&cohort).unwrap_err().to_string();
    assert!(error.contains("sh1"), "{error}");
    let (info, cohorts) = any_cohorts(2, 1);
    let file = encode_cohorts(&info, &cohorts, &[]).unwrap();
    let error = decode(&file, &DecodeLimits::default()).unwrap_err().to_string();
    assert!(error.contains("number of cohorts"), "{error}");
}

/// Reads only what lives: a frame of a flip-book needs the start of the file and that frame.
#[test]
fn a_timestep_needs_what_lives_at_it() {
    let frames: Vec<CompactScene> = (0..50)
        .map(|i| {
            let mut frame = any_scene(100, 1, i);
            (frame.start, frame.layers) = (i as u32, vec![100]);
            frame
        })
        .collect();
    let info = SceneInfo { num_gaussians: 5000, num_timesteps: 50, ..frames[0].info.clone() };
    let file = encode_cohorts(&info, &frames, &[]).unwrap();
    let Opening::Ready(mut archive) = Archive::open(&file, &DecodeLimits::default()).unwrap() else { panic!("whole") };
    assert_eq!(archive.cohorts_at(31).collect::<Vec<_>>(), [31]);
    let range = archive.start_range(31);
    let frame = &file[range.start as usize..range.end as usize];
    assert!(frame.len() < file.len() / 25, "{} of {}", frame.len(), file.len());
    let mut cohort = archive.open_cohort(31, frame).unwrap();
    let shared = (cohort.shared_range(1).start - range.start) as usize;
    cohort.read_shared(&frame[shared..]).unwrap();
    let segment = cohort.segment_range(0, 1);
    let segment = cohort.read_segment(0, &file[segment.start as usize..segment.end as usize]).unwrap();
    assert!(segment.at(31) == frames[31].at(0));
}

#[test]
fn a_writer_refuses_what_does_not_fit() {
    let (info, cohorts) = any_cohorts(2, 5);
    let mut file = Cursor::new(Vec::new());
    let mut writer = FileWriter::new(&mut file, &info, &[], 2).unwrap();
    writer.add(&cohorts[0]).unwrap();
    let late = CompactScene { start: info.num_timesteps, ..cohorts[1].clone() };
    assert!(writer.add(&late).unwrap_err().to_string().contains("beyond the end of the scene"));
    let mut file = Cursor::new(Vec::new());
    let more = SceneInfo { num_gaussians: info.num_gaussians + 1, ..info };
    let mut writer = FileWriter::new(&mut file, &more, &[], 2).unwrap();
    cohorts.iter().for_each(|cohort| writer.add(cohort).unwrap());
    assert!(writer.finish().unwrap_err().to_string().contains("Gaussians of all cohorts"));
}

#[test]
fn parts_out_of_place_are_refused() {
    let (info, cohorts) = any_cohorts(3, 9);
    let file = encode_cohorts(&info, &cohorts, &[]).unwrap();
    let refused = |file: &[u8]| decode_cohorts(file, &DecodeLimits::default()).unwrap_err();
    // A gap before the first piece: everything after the table of cohorts moves by a byte.
    let cohorts_at = number(&file, 20 + 24 + 8) as usize;
    let mut gap = file.clone();
    let end = cohorts_at + number(&file, 20 + 24 + 16) as usize;
    gap.insert(end, 0);
    gap[8..16].copy_from_slice(&(file.len() as u64 + 1).to_le_bytes());
    reseal(&mut gap);
    assert!(matches!(refused(&gap), DecodeError::Format { .. }), "{}", refused(&gap));
}

/// The outline of a file equals its description, apart from what only its sections contain.
#[test]
fn an_outline_is_a_description_without_contents() {
    for count in 0..5 {
        let (info, cohorts) = any_cohorts(count, 5 + count as u64);
        let file = encode_cohorts(&info, &cohorts, &[("notes", b"a red ball")]).unwrap();
        let mut described = inspect(&file, &DecodeLimits::default()).unwrap();
        let mut scene = SceneFile::open(Cursor::new(&file), &DecodeLimits::default(), 0).unwrap();
        described.contents = None;
        described.sections.iter_mut().for_each(|section| section.checksum_ok = None);
        assert_eq!(scene.outline().unwrap(), described);
    }
}

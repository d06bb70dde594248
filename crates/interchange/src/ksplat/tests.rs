use std::fs;

use tcgs_core::{Layout, sigmoid};

use super::*;
use crate::{HigherHarmonics, InterchangeError, ReadLimits, read_gaussians};

/// A section: its entry in the table, and its bytes.
type Part = ([u8; 1024], Vec<u8>);

/// An entry of the table.
///
/// - `counts`: Gaussians, room, Gaussians of a full bucket, buckets, full ones, partial ones
fn entry(counts: [u32; 6], block: f32, range: u32, sh_degree: u16) -> [u8; 1024] {
    let mut entry = [0; 1024];
    let mut put = |at: usize, bytes: &[u8]| entry[at..][..bytes.len()].copy_from_slice(bytes);
    for (at, count) in [0, 4, 8, 12, 32, 36].into_iter().zip(counts) {
        put(at, &count.to_le_bytes());
    }
    put(16, &block.to_le_bytes());
    put(20, &12_u16.to_le_bytes());
    put(24, &range.to_le_bytes());
    put(40, &sh_degree.to_le_bytes());
    entry
}

fn file(level: u16, num_gaussians: u32, harmonics: [f32; 2], parts: &[Part]) -> Vec<u8> {
    let mut bytes = vec![0; 4096];
    let mut put = |at: usize, field: &[u8]| bytes[at..][..field.len()].copy_from_slice(field);
    put(1, &[1]);
    put(4, &(parts.len() as u32).to_le_bytes());
    put(16, &num_gaussians.to_le_bytes());
    put(20, &level.to_le_bytes());
    put(36, &harmonics[0].to_le_bytes());
    put(40, &harmonics[1].to_le_bytes());
    parts.iter().for_each(|(entry, _)| bytes.extend(entry));
    parts.iter().for_each(|(_, content)| bytes.extend(content));
    bytes
}

fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn shorts(numbers: &[u16]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn read_with(bytes: &[u8], settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.KSPLAT");
    fs::write(&path, bytes).unwrap();
    read_gaussians(&path, settings)
}

fn read(bytes: &[u8]) -> Result<Gaussians, String> {
    read_with(bytes, ReadSettings::default()).map_err(|error| {
        let message = error.to_string();
        message.split_once("a.KSPLAT: ").unwrap().1.to_owned()
    })
}

/// Half floats of 1, 2, 0.5, -1 and 0.
const ONE: u16 = 0x3C00;
const TWO: u16 = 0x4000;
const HALF: u16 = 0x3800;
const MINUS_ONE: u16 = 0xBC00;

/// One Gaussian without harmonics of levels 1 and 2.
fn row(position: [u16; 3]) -> Vec<u8> {
    let numbers = [ONE, TWO, HALF, HALF, MINUS_ONE, 0, ONE];
    [shorts(&position), shorts(&numbers), vec![255, 0, 51, 102]].concat()
}

/// Level 1: a full bucket of two Gaussians, partial ones of one and two.
fn bucketed() -> Vec<u8> {
    let middles = floats(&[10.0, 20.0, 30.0, -10.0, 0.0, 0.0, 0.0, 0.0, 100.0]);
    let positions = [[100, 100, 100], [200, 0, 100], [100, 150, 100], [100; 3], [100, 100, 50]];
    let rows = positions.map(row).concat();
    let content = [[1_u32, 2].map(u32::to_le_bytes).concat(), middles, rows].concat();
    file(1, 5, [0.0; 2], &[(entry([5, 5, 2, 3, 1, 2], 4.0, 100, 0), content)])
}

#[test]
fn positions_are_those_in_their_buckets() {
    let found = read(&bucketed()).unwrap();
    let expected = [[10.0, 20.0, 30.0], [12.0, 18.0, 30.0], [-10.0, 1.0, 0.0], [0.0, 0.0, 100.0], [0.0, 0.0, 99.0]];
    assert_eq!(found.means(), expected);
    let ln_2 = std::f32::consts::LN_2;
    assert!(found.log_scales().iter().all(|scales| *scales == [0.0, ln_2, -ln_2]));
    assert!(found.quats().iter().all(|quat| *quat == [0.5, -1.0, 0.0, 1.0]));
    assert!(found.colors().iter().all(|color| *color == [1.0, 0.0, 0.2]));
    assert!(found.logit_opacities().iter().all(|&logit| (sigmoid(logit) - 0.4).abs() < 1e-6));
}

/// Level 0: a section with harmonics of degree 1, an empty one, and one without harmonics.
fn whole() -> Vec<u8> {
    let numbers = [1.0, -2.0, 3.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    let coefficients: Vec<f32> = (1..=9).map(|i| i as f32).collect();
    let first = [floats(&numbers), vec![255, 255, 255, 255], floats(&coefficients)].concat();
    let second = [floats(&numbers.map(|x| 2.0 * x)), vec![0; 4]].concat();
    let parts = [
        (entry([1, 1, 0, 0, 0, 0], 0.0, 0, 1), first),
        ([0; 1024], Vec::new()),
        // Room for one more, which is unused.
        (entry([1, 2, 0, 0, 0, 0], 0.0, 0, 0), [second, vec![9; 44]].concat()),
    ];
    file(0, 2, [0.0; 2], &parts)
}

#[test]
fn sections_may_differ_in_degree() {
    let found = read(&whole()).unwrap();
    assert_eq!(found.means(), [[1.0, -2.0, 3.0], [2.0, -4.0, 6.0]]);
    // A scale of zero is replaced.
    assert!(found.log_scales()[0][1] < -19.0);
    let band = found.layout().harmonics()[0];
    let coefficients = [1.0, 4.0, 7.0, 2.0, 5.0, 8.0, 3.0, 6.0, 9.0];
    assert_eq!(found.values(band), [coefficients, [0.0; 9]].concat());
    let dropped = read_with(&whole(), HigherHarmonics::Drop.into()).unwrap();
    assert_eq!((dropped.layout(), dropped.means()), (&Layout::base(), found.means()));
    let turned = read_with(&whole(), ReadSettings { axes: Some(Axes::RUB), ..ReadSettings::default() }).unwrap();
    assert_eq!(turned.means()[0], [1.0, 2.0, -3.0]);
}

#[test]
fn harmonics_of_level_2_are_shares_of_a_range() {
    let of = |range: [f32; 2]| {
        let coefficients: Vec<u8> = (0..24).map(|i| if i == 9 { 255 } else { 51 }).collect();
        let content = [floats(&[0.0; 3]), row([7; 3]), coefficients].concat();
        let found = read(&file(2, 1, range, &[(entry([1, 1, 1, 1, 1, 0], 1.0, 0, 2), content)])).unwrap();
        let [first, second] = found.layout().harmonics()[..] else { panic!("two bands") };
        (found.values(first).to_vec(), found.values(second).to_vec())
    };
    let (first, second) = of([-1.0, 4.0]);
    assert!(first.iter().chain(&second[1..]).all(|x| x.abs() < 1e-6) && second[0] == 4.0);
    // Without a range it is that from -1.5 to 1.5.
    let (first, second) = of([0.0, 0.0]);
    assert!(first.iter().all(|x| (x + 0.9).abs() < 1e-6) && second[0] == 1.5);
}

#[test]
fn half_floats_of_every_kind() {
    let of = |bits: u16| half(&bits.to_le_bytes(), 0);
    assert_eq!(
        [0x3C00, 0xC000, 0x7BFF, 0x0400, 0x0001].map(of),
        [1.0, -2.0, 65504.0, 2.0_f32.powi(-14), 2.0_f32.powi(-24)]
    );
    assert_eq!(
        (of(0x8000).to_bits(), of(0x7C00), of(0xFC00)),
        ((-0.0_f32).to_bits(), f32::INFINITY, f32::NEG_INFINITY)
    );
    assert!(of(0x7E00).is_nan());
}

#[test]
fn what_is_wrong_is_named() {
    let problem = |bytes: &[u8], at: usize, with: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes[at..][..with.len()].copy_from_slice(with);
        read(&bytes).unwrap_err()
    };
    let (whole, bucketed) = (whole(), bucketed());
    assert_eq!(problem(&whole, 1, &[2]), "is a .ksplat file of version 0.2, expected version 0.1");
    assert_eq!(problem(&whole, 20, &[3]), "has compression level 3, expected 0 to 2");
    let count = "has 2 Gaussians in its sections, expected 3 as in its header";
    assert_eq!(problem(&whole, 16, &[3]), count);
    assert_eq!(read(&file(0, 0, [0.0; 2], &[])).unwrap_err(), "holds no Gaussian, expected at least one");
    let first = 4096;
    let room = "has a section of 2 Gaussians, expected at most 1, its room";
    assert_eq!(problem(&whole, first, &[2]), room);
    let degree = "has spherical harmonics of degree 3, expected 0 to 2";
    assert_eq!(problem(&whole, first + 40, &[3]), degree);
    assert_eq!(problem(&bucketed, first + 20, &[16]), "has buckets of 16 bytes, expected 12");
    let buckets = "has a section of 3 buckets, expected 4: full and partial ones";
    assert_eq!(problem(&bucketed, first + 32, &[2]), buckets);
    let few = "has a section with buckets of 4 Gaussians, expected 5";
    assert_eq!(problem(&bucketed, first + 8, &[1]), few);
    let infinite = problem(&bucketed, first + 16, &f32::NAN.to_le_bytes());
    assert_eq!(infinite, "means of Gaussian 0: NaN, expected a finite number");

    let early = "ends early, expected a whole .ksplat file";
    for (bytes, at, with) in [
        (&whole, 4, u32::MAX),
        (&whole, first + 4, u32::MAX),
        (&bucketed, first + 12, u32::MAX),
        (&bucketed, first + 4, 1 << 30),
    ] {
        assert_eq!(problem(bytes, at, &with.to_le_bytes()), early, "{at}");
    }
    for length in [0, 100, 4096, 5120, bucketed.len() - 1] {
        assert_eq!(read(&bucketed[..length]).unwrap_err(), early, "{length}");
    }
    let tight = ReadLimits { base_bytes: 100, expansion: 0, ..ReadLimits::default() };
    let refused = read_with(&whole, ReadSettings { limits: tight, ..ReadSettings::default() }).unwrap_err();
    assert!(matches!(refused, InterchangeError::Limit { .. }), "{refused}");
}

/// A table may claim buckets of any size.
#[test]
fn huge_buckets_take_no_time() {
    let mut bytes = bucketed();
    bytes[4096 + 8..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    let found = read(&bytes).unwrap();
    assert!(found.means().iter().all(|mean| mean[1] >= 18.0));
}

//! Where a `.ksplat` file has its parts: a header of 4096 bytes, then 1024 bytes for each section. Nothing is allocated
//! by a number of the file before it was compared with the file's length.
//!
//! | bytes of the header | field | here |
//! |---|---|---|
//! | 0, 1 | major and minor version | 0 and 1 |
//! | 4–7 | number of sections in the table | also empty ones |
//! | 8–11 | number of sections with Gaussians | not read |
//! | 12–15 | room for Gaussians | not read |
//! | 16–19 | number of Gaussians | the sum of those of the sections |
//! | 20–21 | compression level | 0 to 2 |
//! | 24–35 | middle of the scene | not read |
//! | 36–43 | least and largest harmonic of level 2; 0 stands for -1.5 and 1.5 | |
//!
//! | bytes of a section | field | here |
//! |---|---|---|
//! | 0–3 | number of Gaussians | at most the room |
//! | 4–7 | room for Gaussians | rows in the file |
//! | 8–11 | Gaussians of a full bucket | |
//! | 12–15 | number of buckets | at least that of full and of partial ones |
//! | 16–19 | side of a bucket, a float | `block` |
//! | 20–21 | bytes of a bucket | 12 |
//! | 24–27 | largest offset from a bucket's middle; 0 stands for 32767 | `range` |
//! | 28–31 | bytes of the section | not read |
//! | 32–35 | number of full buckets | |
//! | 36–39 | number of partial buckets | |
//! | 40–41 | degree of the harmonics | 0 to 2 |

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;

use tcgs_core::Layout;

use super::{Level, float, half, short};
use crate::stored::Head;
use crate::{HigherHarmonics, InterchangeError, ReadSettings, input};

const HEADER: usize = 4096;
const SECTION: usize = 1024;
/// Bytes of the middle of a bucket.
const MIDDLE: usize = 12;
/// Largest degree of harmonics.
const MAX_DEGREE: usize = 2;
/// Range of harmonics of a file that gives none.
const USUAL_RANGE: f32 = 1.5;
/// Largest offset from a bucket's middle in a section that gives none.
const USUAL_OFFSET: u32 = 32767;

/// The table of a file.
pub struct Table {
    pub level: Level,
    /// Range of the harmonics of level 2.
    harmonics: [f32; 2],
    /// The sections that have bytes, in the order of the file.
    pub sections: Vec<Section>,
    pub head: Head,
}

/// One section.
pub struct Section {
    pub num_gaussians: usize,
    /// Gaussians of a full bucket.
    pub bucket_size: usize,
    pub num_full: usize,
    pub num_partial: usize,
    /// Bytes of all buckets' middles.
    pub middles_bytes: usize,
    /// Side of a bucket.
    pub block: f64,
    /// Largest offset from a bucket's middle.
    pub range: f64,
    pub sh_degree: usize,
    pub row_bytes: usize,
    /// Bytes of all of it.
    pub bytes: u64,
}

impl Table {
    /// Opens a file and reads its table. The reader stands at the first section.
    ///
    /// # Errors
    /// As [`super::read_head`].
    pub fn open(path: &Path, settings: ReadSettings) -> Result<(Self, BufReader<File>), InterchangeError> {
        let invalid = |problem| InterchangeError::File { path: path.into(), problem };
        let (file, file_bytes) = input::open(path)?;
        let mut file = BufReader::new(file);
        let mut header = [0; HEADER];
        read_exact(path, &mut file, &mut header)?;
        let (major, minor) = (header[0], header[1]);
        if (major, minor) != (0, 1) {
            return Err(invalid(format!("is a .ksplat file of version {major}.{minor}, expected version 0.1")));
        }
        let level = short(&header, 20);
        let Some(level) = Level::of(level) else {
            return Err(invalid(format!("has compression level {level}, expected 0 to 2")));
        };
        let num_sections = u64::from(int(&header, 4));
        let mut end = HEADER as u64 + num_sections * SECTION as u64;
        if end > file_bytes {
            return Err(ends_early(path));
        }
        let mut sections = Vec::new();
        for _ in 0..num_sections {
            let mut bytes = [0; SECTION];
            read_exact(path, &mut file, &mut bytes)?;
            let section = Section::parse(&bytes, level).map_err(invalid)?;
            end = end.saturating_add(section.bytes);
            if end > file_bytes {
                return Err(ends_early(path));
            }
            if section.bytes > 0 {
                sections.push(section);
            }
        }
        let found: u64 = sections.iter().map(|section| section.num_gaussians as u64).sum();
        let expected = int(&header, 16);
        if found != u64::from(expected) {
            let problem = format!("has {found} Gaussians in its sections, expected {expected} as in its header");
            return Err(invalid(problem));
        }
        let num_gaussians = expected as usize;
        if num_gaussians == 0 {
            return Err(invalid("holds no Gaussian, expected at least one".into()));
        }
        let sh_degree = match settings.higher_harmonics {
            HigherHarmonics::Keep => sections.iter().map(|section| section.sh_degree).max().unwrap_or(0),
            HigherHarmonics::Drop => 0,
        };
        let layout = Layout::with_harmonics(sh_degree);
        settings.limits.check_bytes(path, file_bytes, file_bytes + layout.raw_bytes(num_gaussians, 1))?;
        let harmonics = [(36, -USUAL_RANGE), (40, USUAL_RANGE)].map(|(at, usual)| match float(&header, at) {
            0.0 => usual,
            given => given,
        });
        Ok((Self { level, harmonics, sections, head: Head { num_gaussians, layout } }, file))
    }

    /// A coefficient of harmonics.
    ///
    /// - `array`: those of a Gaussian
    pub fn coefficient(&self, array: &[u8], index: usize) -> f32 {
        let [low, high] = self.harmonics;
        match self.level {
            Level::Floats => float(array, 4 * index),
            Level::Halves => half(array, 2 * index),
            Level::Bytes => low + (high - low) * (f32::from(array[index]) / 255.0),
        }
    }
}

impl Section {
    /// Parses an entry of the table, or says what is wrong with it.
    fn parse(bytes: &[u8; SECTION], level: Level) -> Result<Self, String> {
        let [num_gaussians, room, bucket_size, num_buckets] = [0, 4, 8, 12].map(|at| int(bytes, at) as usize);
        let [num_full, num_partial] = [32, 36].map(|at| int(bytes, at) as usize);
        if num_gaussians > room {
            return Err(format!("has a section of {num_gaussians} Gaussians, expected at most {room}, its room"));
        }
        let of_bucket = usize::from(short(bytes, 20));
        if num_buckets > 0 && of_bucket != MIDDLE {
            return Err(format!("has buckets of {of_bucket} bytes, expected {MIDDLE}"));
        }
        let both = num_full.saturating_add(num_partial);
        if both > num_buckets {
            return Err(format!("has a section of {num_buckets} buckets, expected {both}: full and partial ones"));
        }
        let sh_degree = usize::from(short(bytes, 40));
        if sh_degree > MAX_DEGREE {
            return Err(format!("has spherical harmonics of degree {sh_degree}, expected 0 to {MAX_DEGREE}"));
        }
        let [.., harmonics_at] = level.places();
        let row_bytes = harmonics_at + level.coefficient_bytes() * 3 * ((sh_degree + 1).pow(2) - 1);
        // Products of two numbers of 32 bits at most.
        let middles = MIDDLE as u64 * num_buckets as u64;
        let size = 4 * num_partial as u64 + middles + row_bytes as u64 * room as u64;
        let range = if int(bytes, 24) == 0 { USUAL_OFFSET } else { int(bytes, 24) };
        Ok(Self {
            num_gaussians,
            bucket_size,
            num_full,
            num_partial,
            // The file is at least as long, so it fits.
            middles_bytes: middles as usize,
            block: float(bytes, 16).into(),
            range: range.into(),
            sh_degree,
            row_bytes,
            bytes: size,
        })
    }
}

/// The error of a file that is shorter than its table says.
pub fn ends_early(path: &Path) -> InterchangeError {
    InterchangeError::File { path: path.into(), problem: "ends early, expected a whole .ksplat file".into() }
}

fn read_exact(path: &Path, file: &mut BufReader<File>, bytes: &mut [u8]) -> Result<(), InterchangeError> {
    file.read_exact(bytes).map_err(|error| match error.kind() {
        ErrorKind::UnexpectedEof => ends_early(path),
        _ => InterchangeError::Read { path: path.into(), error },
    })
}

fn int(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

//! Shared by fuzz targets of readers: a file to read, tight limits, and an allocator that counts.

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use tcgs_core::{Gaussians, SceneReader};
use tcgs_interchange::{InterchangeError, ReadLimits, ReadSettings};

/// So tight that short inputs reach them.
pub const LIMITS: ReadLimits = ReadLimits { base_bytes: 1 << 20, expansion: 16, max_timesteps: 1000 };

/// [`LIMITS`], and else what is usual.
#[allow(dead_code, reason = "not all targets read Gaussians")]
pub fn settings() -> ReadSettings {
    ReadSettings { limits: LIMITS, ..ReadSettings::default() }
}

/// Buffers and tables of readers, whatever a file holds.
const FIXED_BYTES: u64 = 2 << 20;
/// Bytes for each byte of a file, for its JSON, its header, its table of contents.
const TABLES_PER_BYTE: u64 = 400;

static HELD: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: all is left to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let held = HELD.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(held, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(place, layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let held = HELD.fetch_add(size, Ordering::Relaxed) + size - layout.size();
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        MOST.fetch_max(held, Ordering::Relaxed);
        unsafe { System.realloc(place, layout, size) }
    }
}

/// Writes a file and reads it, and fails if reading holds more at once than [`LIMITS`] allow.
///
/// - `name`: of the file, whose ending may count
pub fn read<T>(
    name: &str,
    bytes: &[u8],
    read: impl FnOnce(&Path) -> Result<T, InterchangeError>,
) -> Result<T, InterchangeError> {
    let file: PathBuf = std::env::temp_dir().join(format!("tcgs-fuzz-{}-{name}", std::process::id()));
    std::fs::write(&file, bytes).expect("a temporary file");
    let before = HELD.load(Ordering::Relaxed);
    MOST.store(before, Ordering::Relaxed);
    let found = read(&file);
    let most = (MOST.load(Ordering::Relaxed) - before) as u64;
    // A vector that grows has up to twice the room that it needs.
    let length = bytes.len() as u64;
    let allowed = 2 * LIMITS.bytes(length) + FIXED_BYTES + TABLES_PER_BYTE * length;
    assert!(most <= allowed, "{most} bytes are held at once, limit is {allowed} for {length} bytes");
    if let Err(error) = &found {
        assert!(!error.to_string().contains('\n'), "{error}");
    }
    found
}

/// Invariants of Gaussians that were read.
#[allow(dead_code, reason = "not all targets read Gaussians")]
pub fn check(gaussians: &Gaussians) {
    assert!(gaussians.num_gaussians() > 0);
    assert!(gaussians.layout().attributes().all(|a| gaussians.values(a).iter().all(|x: &f32| x.is_finite())));
}

/// Invariants of a scene at its first timesteps.
#[allow(dead_code, reason = "two of the targets read scenes")]
pub fn check_scene<R: SceneReader>(scene: &mut R) {
    assert!(scene.num_timesteps() as u64 <= LIMITS.max_timesteps);
    for timestep in 0..scene.num_timesteps().min(4) {
        let expected = scene.num_gaussians_at(timestep);
        if let Ok(gaussians) = scene.at(timestep) {
            assert_eq!(gaussians.num_gaussians(), expected, "at {timestep}");
        }
    }
}

/// So many zeros: none, or a power of two up to 4 MiB.
#[allow(dead_code, reason = "some targets repeat no zeros")]
pub fn zeros(byte: u8) -> Vec<u8> {
    vec![0; if byte < 128 { 0 } else { 1 << (byte % 23) }]
}

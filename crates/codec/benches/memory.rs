//! Memory of decoding one segment: the peak of allocations beyond the file and the shared layers, compared with the
//! size of the decoded segment.
//!
//! `cargo bench -p tcgs-codec --bench memory` prints a line for each scene.

use std::alloc::{GlobalAlloc, Layout, System};
use std::hint::black_box;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use tcgs_codec::{Archive, CompressSettings, DecodeLimits, Opening, Sampler, SceneInfo, compress, encode};

#[path = "../tests/suite/support/scenes.rs"]
mod scenes;

/// Counts allocated bytes. A block that grows counts twice meanwhile: not every system can grow it in place.
struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

fn more(bytes: usize) {
    MOST.fetch_max(NOW.fetch_add(bytes, Ordering::SeqCst) + bytes, Ordering::SeqCst);
}

// SAFETY: every call passes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        more(layout.size());
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::SeqCst);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        more(new_size);
        NOW.fetch_sub(layout.size(), Ordering::SeqCst);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.realloc(block, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The result of `f`, the bytes that it keeps allocated, and the peak of allocated bytes.
fn measure<T>(f: impl FnOnce() -> T) -> (T, usize, usize) {
    let before = NOW.load(Ordering::SeqCst);
    MOST.store(before, Ordering::SeqCst);
    let result = f();
    let (stays, most) = (NOW.load(Ordering::SeqCst) - before, MOST.load(Ordering::SeqCst) - before);
    (result, stays, most)
}

fn main() {
    // Few Gaussians show the models' fixed share; many are a real scene.
    for (num_gaussians, num_timesteps) in [(20_000, 100), (200_000, 50)] {
        let scene = scenes::room(num_gaussians, num_timesteps);
        let bit_map = scenes::mixed_widths(num_gaussians);
        let compact = compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default());
        let compact = compact.expect("a legal scene");
        let expected = compact.at(0);
        let file = encode(&compact).expect("a legal scene");
        drop((scene, bit_map, compact));
        let bytes = |range: Range<u64>| &file[range.start as usize..range.end as usize];
        let Ok(Opening::Ready(mut archive)) = Archive::open(&file, &DecodeLimits::default()) else {
            panic!("a file just written")
        };
        let mut archive = archive.open_cohort(0, &[]).expect("the only one");
        let layers = archive.num_layers();
        let range = archive.shared_range(layers);
        let (read, shared, shared_most) = measure(|| archive.read_shared(bytes(range)));
        read.expect("whole");
        let range = archive.segment_range(0, layers);
        let (segment, stays, most) = measure(|| archive.read_segment(0, bytes(range)));
        let segment = segment.expect("whole");
        let (sampler, floats, floats_most) = measure(|| Sampler::new(&segment));
        let mut sampler = black_box(sampler);
        assert_eq!(*sampler.at(0), expected);
        let timesteps = segment.timesteps().len();
        println!(
            "{num_gaussians} Gaussians, {timesteps} timesteps: shared {shared} bytes, at most {shared_most} ({:.2}); \
             segment {} bytes, stays {stays}, at most {most} ({:.2}); sampler {floats}, at most {floats_most}; all \
             timesteps as floats {}",
            shared_most as f64 / shared as f64,
            segment.bytes(),
            most as f64 / segment.bytes() as f64,
            timesteps * num_gaussians * 14 * 4
        );
    }
}

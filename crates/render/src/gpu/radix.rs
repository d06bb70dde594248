//! A stable sort of 32-bit keys, each with a 32-bit value; only the GPU knows their number.
//!
//! A radix sort from the lowest digit up, 8 bits a pass, in reduce-then-scan form: count the digits of each block
//! of `SORT_BLOCK` keys, scan the counts, scatter. Nothing waits for another workgroup, so it needs no promise of
//! forward progress, and no subgroups.
//!
//! The floor, per key and pass: 12 bytes read (the key twice, the value once), 8 written. The table of counts adds 2
//! bytes read and 2 written: 256 counts for 1024 keys, each written, scanned in place and read. A pass has three
//! dispatches. Scattered writes come in runs of 4 keys per block and digit on average, and meet their neighbours' runs
//! in the cache.

use super::raw::Bound;
use super::{Gpu, GpuError};
use crate::device::{FEW_BLOCKS, MAX_KEYS, NUM_DIGITS, SORT_BLOCK, sort_passes, sort_source};

/// Number of blocks of `SORT_BLOCK` keys that a sort covers; each block beyond the keys costs a workgroup.
#[derive(Clone, Copy, Debug)]
pub enum Dispatch<'a> {
    /// This number.
    Blocks(u32),
    /// The three 32-bit values at this offset (bytes) of the buffer: the blocks, 1, 1.
    Indirect(&'a wgpu::Buffer, u64),
}

/// The sort, ready to be recorded.
#[derive(Clone, Debug)]
pub struct Radix {
    passes: Vec<Pass>,
    scan_groups: u32,
}

#[derive(Clone, Debug)]
struct Pass {
    count: Bound,
    scan: Bound,
    scatter: Bound,
}

impl Radix {
    /// Prepares a sort by the lowest `bits` of the keys; higher bits must be 0.
    ///
    /// - `keys`, `values`: `[capacity]` each; unsorted in the first of both, sorted in those of [`Self::result_index`].
    ///   Entries past the count stay unchanged
    /// - `count`: its first value is the number of keys; values above `capacity` count as `capacity`
    ///
    /// # Errors
    /// [`GpuError::Memory`] if there is no room for the counts; [`GpuError::Unfit`] if `capacity` exceeds the 67
    /// million keys that can be sorted.
    ///
    /// # Panics
    /// If `bits` exceeds the 32 of a key.
    pub fn new(
        gpu: &Gpu,
        keys: [&wgpu::Buffer; 2],
        values: [&wgpu::Buffer; 2],
        count: &wgpu::Buffer,
        capacity: usize,
        bits: u32,
    ) -> Result<Self, GpuError> {
        if capacity > MAX_KEYS {
            let problem = format!("would have to sort {capacity} keys, expected at most {MAX_KEYS}");
            return Err(GpuError::Unfit { name: gpu.info().name.clone(), problem });
        }
        let device = gpu.device();
        let source = sort_source();
        let [count_kernel, scan_kernel, scatter_kernel] =
            ["radix_count", "radix_scan", "radix_scatter"].map(|entry| gpu.kernel(&source, entry));
        let table = gpu.storage("counts of sorted digits", NUM_DIGITS * capacity.div_ceil(SORT_BLOCK))?;
        let totals = gpu.storage("totals of sorted digits", NUM_DIGITS)?;
        let mut passes = Vec::new();
        for (pass, uniform) in sort_passes(capacity, bits).into_iter().enumerate() {
            let [from, to] = if pass % 2 == 0 { [0, 1] } else { [1, 0] };
            let sort = gpu.uniform("pass of a sort", size_of_val(&uniform))?;
            gpu.queue().write_buffer(&sort, 0, bytemuck::bytes_of(&uniform));
            passes.push(Pass {
                count: count_kernel.bind(device, &[(0, keys[from]), (4, count), (5, &table), (7, &sort)]),
                scan: scan_kernel.bind(device, &[(4, count), (5, &table), (6, &totals), (7, &sort)]),
                scatter: scatter_kernel.bind(
                    device,
                    &[
                        (0, keys[from]),
                        (1, values[from]),
                        (2, keys[to]),
                        (3, values[to]),
                        (4, count),
                        (5, &table),
                        (6, &totals),
                        (7, &sort),
                    ],
                ),
            });
        }
        let scan_groups = if capacity <= FEW_BLOCKS * SORT_BLOCK { 1 } else { NUM_DIGITS as u32 };
        Ok(Self { passes, scan_groups })
    }

    /// Which of the two buffers of keys and values holds the sorted ones.
    pub fn result_index(&self) -> usize {
        self.passes.len() % 2
    }

    /// Records all passes.
    ///
    /// - `dispatch`: at least as many blocks as the keys fill
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, dispatch: Dispatch<'_>) {
        let over_blocks = |bound: &Bound, pass: &mut wgpu::ComputePass<'_>| match dispatch {
            Dispatch::Blocks(num_blocks) => bound.dispatch(pass, [num_blocks, 1, 1]),
            Dispatch::Indirect(arguments, offset) => bound.dispatch_indirect(pass, arguments, offset),
        };
        for Pass { count, scan, scatter } in &self.passes {
            over_blocks(count, pass);
            scan.dispatch(pass, [self.scan_groups, 1, 1]);
            over_blocks(scatter, pass);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::super::GpuChoice;
    use super::*;

    fn gpu() -> Option<Gpu> {
        let name = std::env::var("TCGS_TEST_GPU").unwrap_or_else(|_| "llvmpipe".into());
        match Gpu::open(GpuChoice::Named(&name)) {
            Ok(gpu) => Some(gpu),
            Err(error) => {
                assert!(std::env::var_os("REQUIRE_GPU").is_none(), "REQUIRE_GPU is set: {error}");
                writeln!(std::io::stderr(), "skipped: {error}").unwrap();
                None
            }
        }
    }

    /// Evenly spread over 32 bits, a permutation of the indices.
    fn hash(i: u32) -> u32 {
        let i = (i ^ (i >> 16)).wrapping_mul(0x7feb_352d);
        let i = (i ^ (i >> 15)).wrapping_mul(0x846c_a68b);
        i ^ (i >> 16)
    }

    const UNTOUCHED: u32 = 0xdead_beef;

    /// Sorts keys on the GPU, with their indices as values, and compares with a stable sort on the CPU.
    fn check(gpu: &Gpu, keys: &[u32], capacity: usize, bits: u32, is_indirect: bool) {
        let what = format!("{} of {capacity} keys of {bits} bits, indirect: {is_indirect}", keys.len());
        let padded = |values: &[u32]| {
            let mut padded = values.to_vec();
            padded.resize(capacity, UNTOUCHED);
            gpu.upload("test", &padded).unwrap()
        };
        let indices: Vec<u32> = (0..keys.len() as u32).collect();
        let key_buffers = [padded(keys), padded(&[])];
        let value_buffers = [padded(&indices), padded(&[])];
        let count = gpu.upload("test", &[keys.len() as u32]).unwrap();
        let num_blocks = keys.len().div_ceil(SORT_BLOCK) as u32;
        let arguments = gpu.storage("test", 5).unwrap();
        gpu.queue().write_buffer(&arguments, 8, bytemuck::cast_slice(&[num_blocks, 1, 1]));
        let [key_refs, value_refs] = [key_buffers.each_ref(), value_buffers.each_ref()];
        let radix = Radix::new(gpu, key_refs, value_refs, &count, capacity, bits).unwrap();

        let mut encoder = gpu.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            let all = capacity.div_ceil(SORT_BLOCK) as u32;
            radix
                .record(&mut pass, if is_indirect { Dispatch::Indirect(&arguments, 8) } else { Dispatch::Blocks(all) });
        }
        gpu.submit(encoder);
        let result = radix.result_index();
        let sorted_keys: Vec<u32> = gpu.read(&key_buffers[result], capacity).unwrap();
        let sorted_values: Vec<u32> = gpu.read(&value_buffers[result], capacity).unwrap();

        let mut expected = indices;
        expected.sort_by_key(|&i| keys[i as usize]);
        let expected_keys: Vec<u32> = expected.iter().map(|&i| keys[i as usize]).collect();
        // assert_eq would print a hundred thousand values.
        assert!(sorted_keys[..keys.len()] == expected_keys, "keys: {what}");
        assert!(sorted_values[..keys.len()] == expected, "values: {what}");
        for rest in [&sorted_keys[keys.len()..], &sorted_values[keys.len()..]] {
            assert!(rest.iter().all(|&value| value == UNTOUCHED), "past the count: {what}");
        }
    }

    #[test]
    fn sorts_any_number_of_keys() {
        let Some(gpu) = gpu() else { return };
        for num_keys in [0, 1, 255, 256, 1023, 1024, 1025, 32_768, 32_769, 100_000] {
            let keys: Vec<u32> = (0..num_keys).map(hash).collect();
            check(&gpu, &keys, 100_000, 32, false);
            check(&gpu, &keys, 100_000, 32, true);
            // Only as many blocks as the buffers hold.
            check(&gpu, &keys, num_keys.max(1) as usize, 32, true);
        }
        check(&gpu, &(0..2500).map(hash).collect::<Vec<_>>(), 2500, 32, true);
    }

    #[test]
    fn equal_keys_stay_in_order() {
        let Some(gpu) = gpu() else { return };
        for bits in [8, 10, 16, 24] {
            let few: Vec<u32> = (0..9000).map(|i| (hash(i) % 3) << (bits - 2)).collect();
            check(&gpu, &few, 10_000, bits, true);
            let all_equal = vec![5; 3000];
            check(&gpu, &all_equal, 10_000, bits, true);
            let many: Vec<u32> = (0..9000).map(|i| hash(i) >> (32 - bits)).collect();
            check(&gpu, &many, 10_000, bits, false);
        }
    }

    #[test]
    fn scans_more_blocks_than_one_turn_takes() {
        let Some(gpu) = gpu() else { return };
        let keys: Vec<u32> = (0..1_100_000).map(|i| hash(i) >> 24).collect();
        check(&gpu, &keys, 1_200_000, 8, true);
    }

    #[test]
    fn a_count_beyond_the_capacity_is_the_capacity() {
        let Some(gpu) = gpu() else { return };
        let keys = [gpu.upload("test", &[3_u32, 1, 2, 9]).unwrap(), gpu.upload("test", &[0_u32; 4]).unwrap()];
        let values = [gpu.upload("test", &[0_u32, 1, 2, 9]).unwrap(), gpu.upload("test", &[0_u32; 4]).unwrap()];
        let count = gpu.upload("test", &[5000_u32]).unwrap();
        let radix = Radix::new(&gpu, keys.each_ref(), values.each_ref(), &count, 3, 8).unwrap();
        let mut encoder = gpu.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            radix.record(&mut pass, Dispatch::Blocks(5));
        }
        gpu.submit(encoder);
        assert_eq!(gpu.read::<u32>(&keys[radix.result_index()], 4).unwrap(), [1, 2, 3, 0]);
        assert_eq!(gpu.read::<u32>(&values[radix.result_index()], 4).unwrap(), [1, 2, 0, 0]);
    }
}

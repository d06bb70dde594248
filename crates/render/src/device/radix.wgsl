// One pass of a stable radix sort by a digit of 8 bits, in three kernels; a workgroup of count and scatter takes
// SORT_BLOCK keys in their order.
//
// - radix_count: keys_in [len] -> table [DIGITS, stride]: number of occurrences of each digit in each block
// - radix_scan: table -> each row's exclusive prefix sums over the blocks, in place; totals [DIGITS]: the rows' sums
// - radix_scatter: keys_in, values_in [len], table, totals -> keys_out, values_out [len]
//
// len = min(count[0], capacity). Entries past len are neither read nor written.

struct Sort {
    // Position of the digit's lowest bit.
    shift: u32,
    // Capacity of the buffers, keys.
    capacity: u32,
    // Length of the table's rows: blocks of a full buffer.
    stride: u32,
    padding: u32,
}

@group(0) @binding(0) var<storage, read> keys_in: array<u32>;
@group(0) @binding(1) var<storage, read> values_in: array<u32>;
@group(0) @binding(2) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(3) var<storage, read_write> values_out: array<u32>;
@group(0) @binding(4) var<storage, read> count: array<u32>;
@group(0) @binding(5) var<storage, read_write> table: array<u32>;
@group(0) @binding(6) var<storage, read_write> totals: array<u32>;
@group(0) @binding(7) var<uniform> sort: Sort;

// DIGITS, the number of values of a digit, is also the number of threads of a workgroup: thread d handles digit d too.

// Words of 32 bits that hold a bit for each thread.
const WORDS: u32 = DIGITS / 32u;
// Blocks that a thread of radix_scan adds up by itself.
const RUN: u32 = 4u;
// Up to FEW blocks, the first workgroup scans all rows, one thread per row.

var<workgroup> counts: array<atomic<u32>, DIGITS>;
var<workgroup> sums: array<u32, 2u * DIGITS>;
var<workgroup> next: array<u32, DIGITS>;
// [WORDS, DIGITS]: the threads that hold each digit. The digits are adjacent, so that thread d has no bank conflicts.
var<workgroup> holders: array<atomic<u32>, WORDS * DIGITS>;

fn num_keys() -> u32 {
    return min(count[0], sort.capacity);
}

fn digit_of(key: u32) -> u32 {
    return (key >> sort.shift) & (DIGITS - 1u);
}

// Inclusive prefix sum of `value` over the threads. Leaves thread i's sum in sums[i]; a caller needs a barrier between
// its last read of sums and the next call.
fn inclusive_sum(thread: u32, value: u32) -> u32 {
    var sum = value;
    var side = 0u;
    sums[thread] = sum;
    for (var distance = 1u; distance < DIGITS; distance *= 2u) {
        workgroupBarrier();
        if (thread >= distance) {
            sum += sums[side + thread - distance];
        }
        // The two halves alternate, so one barrier per step is enough.
        side = DIGITS - side;
        sums[side + thread] = sum;
    }
    workgroupBarrier();
    return sum;
}

@compute @workgroup_size(DIGITS)
fn radix_count(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let len = num_keys();
    let first = group.x * SORT_BLOCK;
    if (first >= len) {
        return;
    }
    atomicStore(&counts[thread], 0u);
    workgroupBarrier();
    for (var i = first + thread; i < min(first + SORT_BLOCK, len); i += DIGITS) {
        atomicAdd(&counts[digit_of(keys_in[i])], 1u);
    }
    workgroupBarrier();
    table[thread * sort.stride + group.x] = atomicLoad(&counts[thread]);
}

@compute @workgroup_size(DIGITS)
fn radix_scan(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let num_blocks = (num_keys() + SORT_BLOCK - 1u) / SORT_BLOCK;
    if (num_blocks <= FEW) {
        if (group.x == 0u) {
            var at = 0u;
            for (var i = thread * sort.stride; i < thread * sort.stride + num_blocks; i++) {
                let number = table[i];
                table[i] = at;
                at += number;
            }
            totals[thread] = at;
        }
        return;
    }
    let row = group.x * sort.stride;
    var before = 0u;
    for (var first = 0u; first < num_blocks; first += RUN * DIGITS) {
        let own = first + thread * RUN;
        var run: array<u32, RUN>;
        var sum = 0u;
        for (var i = 0u; i < RUN; i++) {
            if (own + i < num_blocks) {
                run[i] = table[row + own + i];
                sum += run[i];
            }
        }
        var at = before + inclusive_sum(thread, sum) - sum;
        for (var i = 0u; i < RUN; i++) {
            if (own + i < num_blocks) {
                table[row + own + i] = at;
                at += run[i];
            }
        }
        before += sums[DIGITS - 1u];
        workgroupBarrier();
    }
    if (thread == 0u) {
        totals[group.x] = before;
    }
}

// The DIGITS keys of a round are ranked at once: a key goes to the next place of its digit, plus the number of earlier
// threads with the same digit.
@compute @workgroup_size(DIGITS)
fn radix_scatter(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let len = num_keys();
    let first = group.x * SORT_BLOCK;
    if (first >= len) {
        return;
    }
    let total = totals[thread];
    next[thread] = inclusive_sum(thread, total) - total + table[thread * sort.stride + group.x];
    for (var i = 0u; i < WORDS; i++) {
        atomicStore(&holders[i * DIGITS + thread], 0u);
    }
    workgroupBarrier();

    let word = thread / 32u;
    let bit = 1u << (thread % 32u);
    for (var start = first; start < min(first + SORT_BLOCK, len); start += DIGITS) {
        let i = start + thread;
        let is_key = i < len;
        var key = 0u;
        var digit = 0u;
        if (is_key) {
            key = keys_in[i];
            digit = digit_of(key);
            atomicOr(&holders[word * DIGITS + digit], bit);
        }
        workgroupBarrier();
        if (is_key) {
            var place = next[digit] + countOneBits(atomicLoad(&holders[word * DIGITS + digit]) & (bit - 1u));
            for (var earlier = 0u; earlier < word; earlier++) {
                place += countOneBits(atomicLoad(&holders[earlier * DIGITS + digit]));
            }
            keys_out[place] = key;
            values_out[place] = values_in[i];
        }
        workgroupBarrier();
        var held = 0u;
        for (var i = 0u; i < WORDS; i++) {
            held += countOneBits(atomicLoad(&holders[i * DIGITS + thread]));
            atomicStore(&holders[i * DIGITS + thread], 0u);
        }
        next[thread] += held;
        workgroupBarrier();
    }
}

// sort: one digit of a stable radix sort of keys with values.
// sort_histogram  one workgroup: how often each digit occurs in one block. Dispatch: blocks, folded.
// sort_scatter    one workgroup: moves one block, the histogram scanned in between. Dispatch: blocks, folded.
// Bindings:
//   0 step        uniform      Sort
//   1 counters    read         [3] the number of keys is in slot `count`, unless that is NOWHERE
//   2 keys_in     read         [n]
//   3 values_in   read         [n]
//   4 histogram   read_write   [DIGITS, blocks] counts, then what precedes them
//   5 keys_out    read_write   [n]
//   6 values_out  read_write   [n]
// Overrides: WORKGROUP ITEMS
// Twin: crates/gs-reference/src/sort.rs

override WORKGROUP: u32;
override ITEMS: u32;

struct Sort {
    // Keys for which there is room.
    n: u32,
    n_blocks: u32,
    // Slot of the counters for the number of keys; NOWHERE: n.
    count: u32,
    // Position of the digit's lowest bit.
    shift: u32,
}

const DIGITS: u32 = 16;
// Rows of packed counts: each word has that of digit d in its low half and that of digit d + ROWS in its high half.
const ROWS: u32 = 8;

@group(0) @binding(0) var<uniform> step: Sort;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> histogram: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

var<workgroup> digit_counts: array<atomic<u32>, 16>;
// [ROWS, WORKGROUP] counts of each invocation's own keys, then what precedes them in the block.
var<workgroup> packed: array<u32, ROWS * WORKGROUP>;
var<workgroup> partial: array<u32, WORKGROUP>;
// Place of the first key of a digit in the output, minus its place in the sorted block.
var<workgroup> digit_base: array<u32, 16>;

fn key_count() -> u32 {
    if step.count == NOWHERE {
        return step.n;
    }
    return min(counters[step.count], step.n);
}

fn digit_of(key: u32) -> u32 {
    return (key >> step.shift) & (DIGITS - 1u);
}

@compute @workgroup_size(WORKGROUP)
fn sort_histogram(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = folded(workgroup, grid);
    if block >= step.n_blocks {
        return;
    }
    let n = key_count();
    for (var item = 0u; item < ITEMS; item++) {
        let index = (block * ITEMS + item) * WORKGROUP + local;
        if index < n {
            atomicAdd(&digit_counts[digit_of(keys_in[index])], 1u);
        }
    }
    workgroupBarrier();
    if local < DIGITS {
        histogram[local * step.n_blocks + block] = atomicLoad(&digit_counts[local]);
    }
}

@compute @workgroup_size(WORKGROUP)
fn sort_scatter(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = folded(workgroup, grid);
    if block >= step.n_blocks {
        return;
    }
    let n = key_count();
    // An invocation owns ITEMS neighbouring keys, so that ranks by (digit, invocation, item) keep equal keys in order.
    let first = (block * WORKGROUP + local) * ITEMS;
    for (var item = 0u; item < ITEMS; item++) {
        let index = first + item;
        if index < n {
            let digit = digit_of(keys_in[index]);
            packed[(digit % ROWS) * WORKGROUP + local] += one_of(digit);
        }
    }
    workgroupBarrier();
    // Exclusive prefix sums over all words, each half by itself: at most WORKGROUP * ITEMS, they do not overflow.
    var sum = 0u;
    for (var row = 0u; row < ROWS; row++) {
        sum += packed[local * ROWS + row];
    }
    partial[local] = sum;
    for (var reach = 1u; reach < WORKGROUP; reach *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if local >= reach {
            before = partial[local - reach];
        }
        workgroupBarrier();
        partial[local] += before;
    }
    workgroupBarrier();
    // Digits of the high halves come after all of the low ones.
    let n_low = partial[WORKGROUP - 1u] & 0xffffu;
    var before = partial[local] - sum + (n_low << 16u);
    for (var row = 0u; row < ROWS; row++) {
        let count = packed[local * ROWS + row];
        packed[local * ROWS + row] = before;
        before += count;
    }
    workgroupBarrier();
    if local < DIGITS {
        digit_base[local] = histogram[local * step.n_blocks + block] - half_of(packed[(local % ROWS) * WORKGROUP], local);
    }
    workgroupBarrier();
    for (var item = 0u; item < ITEMS; item++) {
        let index = first + item;
        if index < n {
            let key = keys_in[index];
            let digit = digit_of(key);
            let word = (digit % ROWS) * WORKGROUP + local;
            let place = digit_base[digit] + half_of(packed[word], digit);
            packed[word] += one_of(digit);
            keys_out[place] = key;
            values_out[place] = values_in[index];
        }
    }
}

fn one_of(digit: u32) -> u32 {
    return select(1u, 0x10000u, digit >= ROWS);
}

fn half_of(word: u32, digit: u32) -> u32 {
    return select(word & 0xffffu, word >> 16u, digit >= ROWS);
}

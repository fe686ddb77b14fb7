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

@group(0) @binding(0) var<uniform> step: Sort;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> histogram: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

var<workgroup> digit_counts: array<atomic<u32>, 16>;
// Counts of each invocation's own keys, four bits a digit: at most ITEMS < 16.
var<workgroup> own: array<vec2u, WORKGROUP>;
// [groups, DIGITS] keys of DIGITS neighbouring invocations, then the place in the output of the first of them.
var<workgroup> group_place: array<u32, WORKGROUP>;

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
    if block * WORKGROUP * ITEMS >= n {
        return;
    }
    // An invocation owns ITEMS neighbouring keys, so that ranks by (digit, invocation, item) keep equal keys in order.
    let first = (block * WORKGROUP + local) * ITEMS;
    var counts = vec2u(0u);
    for (var item = 0u; item < ITEMS; item++) {
        let index = first + item;
        if index < n {
            let digit = digit_of(keys_in[index]);
            counts[digit / 8u] += 1u << (4u * (digit % 8u));
        }
    }
    own[local] = counts;
    workgroupBarrier();
    // One invocation for each digit of each group of invocations.
    let digit = local % DIGITS;
    let group = local / DIGITS;
    var count = 0u;
    for (var member = 0u; member < DIGITS; member++) {
        count += (own[group * DIGITS + member][digit / 8u] >> (4u * (digit % 8u))) & 0xfu;
    }
    group_place[local] = count;
    workgroupBarrier();
    var place = histogram[digit * step.n_blocks + block];
    for (var before = 0u; before < group; before++) {
        place += group_place[before * DIGITS + digit];
    }
    workgroupBarrier();
    group_place[local] = place;
    workgroupBarrier();
    // Keys of the invocations before this one in its group, eight bits a digit: at most DIGITS * ITEMS < 256.
    var preceding = vec4u(0u);
    for (var member = group * DIGITS; member < local; member++) {
        let counts = own[member].xxyy >> vec4u(0u, 4u, 0u, 4u);
        preceding += counts & vec4u(0x0f0f0f0fu);
    }
    for (var item = 0u; item < ITEMS; item++) {
        let index = first + item;
        if index < n {
            let key = keys_in[index];
            let digit = digit_of(key);
            let word = digit / 8u * 2u + digit % 2u;
            let shift = digit % 8u / 2u * 8u;
            let rank = (preceding[word] >> shift) & 0xffu;
            preceding[word] += 1u << shift;
            let place = group_place[group * DIGITS + digit] + rank;
            keys_out[place] = key;
            values_out[place] = values_in[index];
        }
    }
}

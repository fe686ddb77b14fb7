// scan: exclusive prefix sum, in place. Sums that do not fit saturate, so that a total that is too large stays so.
// scan_reduce  one workgroup: the sum of one block. Dispatch: blocks, folded.
// scan_sums    one workgroup, alone: prefix sums of the sums. Dispatch: 1.
// scan_apply   one workgroup: prefix sums of one block. Dispatch: blocks, folded.
// Bindings:
//   0 scan       uniform      Scan
//   1 values     read_write   [n]
//   2 sums       read_write   [blocks] sums of blocks, then what precedes each block
//   3 counters   read_write   [3] the total goes to slot `total`
// Overrides: WORKGROUP ITEMS
// Twin: crates/gs-reference/src/scan.rs

override WORKGROUP: u32;
override ITEMS: u32;

struct Scan {
    n: u32,
    n_blocks: u32,
    // Slot of the counters for the total; NOWHERE for none.
    total: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> scan: Scan;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: array<u32>;

// Invocations whose sums one invocation adds up.
const ROW: u32 = 16u;

var<workgroup> partial: array<u32, WORKGROUP>;

fn saturating_add(a: u32, b: u32) -> u32 {
    return select(a + b, 0xffffffffu, a + b < a);
}

// The sum of what the invocations before this one give, and that of all.
fn sums_of(given: u32, local: u32) -> vec2u {
    partial[local] = given;
    workgroupBarrier();
    if local < WORKGROUP / ROW {
        var sum = 0u;
        for (var at = local * ROW; at < (local + 1u) * ROW; at++) {
            sum = saturating_add(sum, partial[at]);
            partial[at] = sum;
        }
    }
    workgroupBarrier();
    var before = 0u;
    var all = 0u;
    for (var start = 0u; start < WORKGROUP; start += ROW) {
        if local >= start {
            before = all;
        }
        all = saturating_add(all, partial[start + ROW - 1u]);
    }
    if local % ROW > 0u {
        before = saturating_add(before, partial[local - 1u]);
    }
    return vec2u(before, all);
}

@compute @workgroup_size(WORKGROUP)
fn scan_reduce(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = folded(workgroup, grid);
    if block >= scan.n_blocks {
        return;
    }
    var sum = 0u;
    for (var item = 0u; item < ITEMS; item++) {
        let index = (block * ITEMS + item) * WORKGROUP + local;
        if index < scan.n {
            sum = saturating_add(sum, values[index]);
        }
    }
    let all = sums_of(sum, local).y;
    if local == 0u {
        sums[block] = all;
    }
}

@compute @workgroup_size(WORKGROUP)
fn scan_sums(@builtin(local_invocation_index) local: u32) {
    var carry = 0u;
    for (var start = 0u; start < scan.n_blocks; start += WORKGROUP) {
        let index = start + local;
        var value = 0u;
        if index < scan.n_blocks {
            value = sums[index];
        }
        let added = sums_of(value, local);
        if index < scan.n_blocks {
            sums[index] = saturating_add(carry, added.x);
        }
        carry = saturating_add(carry, added.y);
        workgroupBarrier();
    }
    if local == 0u && scan.total != NOWHERE {
        counters[scan.total] = carry;
    }
}

@compute @workgroup_size(WORKGROUP)
fn scan_apply(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = folded(workgroup, grid);
    if block >= scan.n_blocks {
        return;
    }
    // An invocation owns ITEMS neighbouring numbers, so that one sum over the invocations is enough.
    let first = (block * WORKGROUP + local) * ITEMS;
    let end = min(first + ITEMS, scan.n);
    var sum = 0u;
    for (var index = first; index < end; index++) {
        sum = saturating_add(sum, values[index]);
    }
    var before = saturating_add(sums[block], sums_of(sum, local).x);
    for (var index = first; index < end; index++) {
        let value = values[index];
        values[index] = before;
        before = saturating_add(before, value);
    }
}

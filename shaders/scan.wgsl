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

var<workgroup> partial: array<u32, WORKGROUP>;

fn saturating_add(a: u32, b: u32) -> u32 {
    return select(a + b, 0xffffffffu, a + b < a);
}

// Replaces partial by its inclusive prefix sums.
fn scan_partial(local: u32) {
    for (var step = 1u; step < WORKGROUP; step *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if local >= step {
            before = partial[local - step];
        }
        workgroupBarrier();
        partial[local] = saturating_add(partial[local], before);
    }
    workgroupBarrier();
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
    partial[local] = sum;
    scan_partial(local);
    if local == 0u {
        sums[block] = partial[WORKGROUP - 1u];
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
        partial[local] = value;
        scan_partial(local);
        if index < scan.n_blocks {
            var before = 0u;
            if local > 0u {
                before = partial[local - 1u];
            }
            sums[index] = saturating_add(carry, before);
        }
        carry = saturating_add(carry, partial[WORKGROUP - 1u]);
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
    var carry = sums[block];
    for (var item = 0u; item < ITEMS; item++) {
        let index = (block * ITEMS + item) * WORKGROUP + local;
        var value = 0u;
        if index < scan.n {
            value = values[index];
        }
        partial[local] = value;
        scan_partial(local);
        var before = 0u;
        if local > 0u {
            before = partial[local - 1u];
        }
        if index < scan.n {
            values[index] = saturating_add(carry, before);
        }
        carry = saturating_add(carry, partial[WORKGROUP - 1u]);
        workgroupBarrier();
    }
}

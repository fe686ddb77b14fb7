//! Prefix sums.

use super::{Chain, exact, gpu, of, one, words};
use crate::check::Row;
use crate::losses::noise;
use gs_raster::gpu::{Gpu, PassBuffer};
use gs_reference::scan::scan;
use gs_shaders::{Features, ITEMS, N_COUNTERS, N_PAIRS, NOWHERE, SCAN, Scan, WORKGROUP};

const BLOCK: usize = (WORKGROUP * ITEMS) as usize;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let mut rows = steps(gpu, &input.lists.counts, &truth.lists.counts, N_PAIRS);
    // The twin of the chain and that of the steps are the same.
    let (offsets, total) = scan(&uniform(&truth.lists.counts, NOWHERE), &truth.lists.counts);
    rows.extend(exact("chain", &truth.lists.offsets, &offsets));
    rows.extend(exact("total", &[truth.lists.counters[N_PAIRS as usize]], &[total]));
    rows
}

pub(super) fn perturb(chain: &mut Chain) {
    chain.lists.counts[17] += 1;
}

fn uniform(values: &[u32], total: u32) -> Scan {
    Scan { n: values.len() as u32, n_blocks: values.len().div_ceil(BLOCK) as u32, total, padding: 0 }
}

/// The three entry points, each given what the twin makes of the step before it.
fn steps(gpu: &mut Gpu, values: &[u32], truth: &[u32], total: u32) -> Vec<Row> {
    let uniform = uniform(values, total);
    let no_features = Features { sh_degree: 0, antialias: false, depth: false };
    // Narrower than a folded grid ever is.
    let blocks = [uniform.n_blocks.min(3), uniform.n_blocks.div_ceil(3)];
    let sums: Vec<u32> =
        truth.chunks(BLOCK).map(|block| scan(&self::uniform(block, NOWHERE), block).1).collect();
    let (before, sum) = scan(&self::uniform(&sums, NOWHERE), &sums);
    let (expected, _) = scan(&self::uniform(truth, NOWHERE), truth);
    let mut counters = [5u32; N_COUNTERS];

    let mut run = |entry_point: &str, grid, sums: &[u32]| {
        let buffers = [one(&uniform), of(values), of(sums), of(&counters)];
        gpu.run_pass(&SCAN, entry_point, no_features, grid, &buffers).expect("the pass runs")
    };
    let nothing = vec![7; sums.len()];
    let reduced = run("scan_reduce", blocks, &nothing);
    let summed = run("scan_sums", [1, 1], &sums);
    let applied = run("scan_apply", blocks, &before);
    if total != NOWHERE {
        counters[total as usize] = sum;
    }
    [
        exact("values after scan_reduce", truth, &words(&reduced[1])),
        exact("sums after scan_reduce", &sums, &words(&reduced[2])),
        exact("sums after scan_sums", &before, &words(&summed[2])),
        exact("counters", &counters, &words(&summed[3])),
        exact("values", &expected, &words(&applied[1])),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[test]
#[ignore = "gpu"]
fn sizes_around_blocks() {
    // The last are as many blocks as scan_sums takes at a time, and more.
    let round = WORKGROUP as usize * BLOCK;
    let sizes = [1, 63, 64, 65, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK, round, round + 1, 3 * round + 77];
    for n in sizes {
        let values: Vec<u32> = (0..n).map(|i| (noise(3, i).abs() * 100.0) as u32).collect();
        for total in [N_PAIRS, NOWHERE] {
            for row in steps(&mut gpu(), &values, &values, total) {
                assert!(row.holds(), "{n}, {}: {:?}", row.output, row.deviation);
            }
        }
    }
}

#[test]
#[ignore = "gpu"]
fn sums_that_do_not_fit_saturate() {
    let n = 3 * BLOCK + 5;
    // Beyond 2^32 within an invocation, within a block, between blocks, and just not.
    for (at, value) in
        [(0, u32::MAX), (1, u32::MAX - 2), (BLOCK, u32::MAX / 2 + 1), (2 * BLOCK + 9, u32::MAX)]
    {
        let mut values = vec![0; n];
        values[n - 1] = 1;
        values[at] = value;
        values[at + 1] = value;
        for row in steps(&mut gpu(), &values, &values, N_PAIRS) {
            assert!(row.holds(), "{value} at {at}, {}: {:?}", row.output, row.deviation);
        }
    }
    let mut fits = vec![0; n];
    (fits[3], fits[n - 2]) = (u32::MAX - 7, 7);
    for row in steps(&mut gpu(), &fits, &fits, N_PAIRS) {
        assert!(row.holds(), "{}: {:?}", row.output, row.deviation);
    }
}

#[test]
#[ignore = "gpu"]
fn buffers_that_an_entry_point_does_not_use_need_not_be_given() {
    let uniform = uniform(&[1, 2, 3], NOWHERE);
    let features = Features { sh_degree: 0, antialias: false, depth: false };
    let buffers = [one(&uniform), of::<u32>(&[1, 2, 3]), of::<u32>(&[0]), PassBuffer::Unused];
    let out = gpu().run_pass(&SCAN, "scan_reduce", features, [1, 1], &buffers).expect("the pass runs");
    assert_eq!(words::<u32>(&out[2]), [6]);
    assert!(out[3].is_empty());
}

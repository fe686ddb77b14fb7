//! The radix sort, digit by digit and as a whole.

use super::{Chain, UNTOUCHED, exact, gpu, of, one, words};
use crate::check::Row;
use crate::losses::noise;
use gs_raster::gpu::Gpu;
use gs_reference::scan::scan;
use gs_reference::sort::{sort_histogram, sort_scatter};
use gs_shaders::{
    Features, ITEMS, N_COUNTERS, N_PAIRS, NOWHERE, SCAN, SORT, SORT_DIGIT_BITS, Scan, Sort, WORKGROUP,
};

const BLOCK: usize = (WORKGROUP * ITEMS) as usize;
const NO_FEATURES: Features = Features { sh_degree: 0, antialias: false, depth: false };

/// Keys with values, and more room than there are.
#[derive(Clone)]
struct Keyed {
    keys: Vec<u32>,
    values: Vec<u32>,
}

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let depths = |chain: &Chain| Keyed {
        keys: chain.lists.footprints.depth_keys.clone(),
        values: chain.lists.footprints.order.clone(),
    };
    let tiles = |chain: &Chain| Keyed {
        keys: chain.lists.pairs.tiles.clone(),
        values: chain.lists.pairs.index.clone(),
    };
    let counters = &truth.lists.counters;
    let mut rows = digits(gpu, depths(input), depths(truth), counters);
    rows.extend(digits(gpu, tiles(input), tiles(truth), counters));
    rows
}

pub(super) fn perturb(chain: &mut Chain) {
    chain.lists.footprints.order.swap(3, 4);
}

/// Every digit, each on what the twin makes of the digits before it.
fn digits(gpu: &mut Gpu, mut input: Keyed, mut truth: Keyed, counters: &[u32; N_COUNTERS]) -> Vec<Row> {
    let n = truth.keys.len();
    let mut rows = Vec::new();
    for shift in (0..u32::BITS).step_by(SORT_DIGIT_BITS as usize) {
        let step = Sort { n: n as u32, n_blocks: n.div_ceil(BLOCK) as u32, count: NOWHERE, shift };
        let histogram = sort_histogram(&step, counters, &truth.keys);
        let (offsets, _) = scan(&scan_of(&histogram), &histogram);
        let (keys, values) = sort_scatter(&step, counters, &truth.keys, &truth.values);
        let nothing = [vec![UNTOUCHED; histogram.len()], vec![UNTOUCHED; n], vec![UNTOUCHED; n]];
        let counted =
            run(gpu, "sort_histogram", &step, counters, &input, [&nothing[0], &nothing[1], &nothing[2]]);
        let moved = run(gpu, "sort_scatter", &step, counters, &input, [&offsets, &nothing[1], &nothing[2]]);
        rows.extend(exact(&format!("histogram at bit {shift}"), &histogram, &counted[0]));
        rows.extend(exact(&format!("keys at bit {shift}"), &keys, &moved[1]));
        rows.extend(exact(&format!("values at bit {shift}"), &values, &moved[2]));
        let (keys, values) = sort_scatter(&step, counters, &input.keys, &input.values);
        input = Keyed { keys, values };
        let (keys, values) = sort_scatter(&step, counters, &truth.keys, &truth.values);
        truth = Keyed { keys, values };
    }
    rows
}

fn scan_of(values: &[u32]) -> Scan {
    Scan { n: values.len() as u32, n_blocks: values.len().div_ceil(BLOCK) as u32, total: NOWHERE, padding: 0 }
}

/// Blocks in a grid that is narrower than a folded one ever is.
fn blocks(n: u32) -> [u32; 2] {
    [n.min(5), n.div_ceil(5)]
}

/// One entry point: the histogram, keys and values afterwards.
fn run(
    gpu: &mut Gpu,
    entry_point: &str,
    step: &Sort,
    counters: &[u32; N_COUNTERS],
    input: &Keyed,
    [histogram, keys, values]: [&[u32]; 3],
) -> [Vec<u32>; 3] {
    let buffers =
        [one(step), of(counters), of(&input.keys), of(&input.values), of(histogram), of(keys), of(values)];
    let out = gpu
        .run_pass(&SORT, entry_point, NO_FEATURES, blocks(step.n_blocks), &buffers)
        .expect("the pass runs");
    [words(&out[4]), words(&out[5]), words(&out[6])]
}

/// Sorts on the GPU alone; of `room` for keys, there are as many as the counter says.
fn sorted(gpu: &mut Gpu, mut input: Keyed, bits: u32, counters: &[u32; N_COUNTERS], count: u32) -> Keyed {
    let n = input.keys.len() as u32;
    for shift in (0..bits).step_by(SORT_DIGIT_BITS as usize) {
        let step = Sort { n, n_blocks: n.div_ceil(BLOCK as u32), count, shift };
        let nothing = vec![UNTOUCHED; n as usize];
        let empty = vec![UNTOUCHED; (step.n_blocks as usize) << SORT_DIGIT_BITS];
        let [mut histogram, ..] =
            run(gpu, "sort_histogram", &step, counters, &input, [&empty, &nothing, &nothing]);
        let uniform = scan_of(&histogram);
        let mut sums = vec![UNTOUCHED; uniform.n_blocks as usize];
        for entry_point in ["scan_reduce", "scan_sums", "scan_apply"] {
            let grid = if entry_point == "scan_sums" { [1, 1] } else { blocks(uniform.n_blocks) };
            let buffers = [one(&uniform), of(&histogram), of(&sums), of(counters)];
            let out = gpu.run_pass(&SCAN, entry_point, NO_FEATURES, grid, &buffers).expect("the pass runs");
            (histogram, sums) = (words(&out[1]), words(&out[2]));
        }
        let out = run(gpu, "sort_scatter", &step, counters, &input, [&histogram, &nothing, &nothing]);
        let [_, keys, values] = out;
        input = Keyed { keys, values };
    }
    input
}

/// 0..n in any order: i · a + b, a prime to n.
fn shuffled(n: usize) -> Vec<u32> {
    let step = (n * 5 / 8..).find(|&step| gcd(step, n) == 1).expect("there are primes");
    (0..n).map(|i| ((i as u64 * step as u64 + 11) % n as u64) as u32).collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Sizes around those of workgroups, blocks and powers of two; the last takes more than one round of `scan_sums`.
const SIZES: [usize; 16] = [
    1,
    2,
    3,
    63,
    64,
    65,
    BLOCK - 1,
    BLOCK,
    BLOCK + 1,
    4095,
    4097,
    32_767,
    32_769,
    65_535,
    65_537,
    (((WORKGROUP as usize * BLOCK) >> SORT_DIGIT_BITS) + 1) * BLOCK,
];

#[test]
#[ignore = "gpu"]
fn shuffled_numbers_come_out_as_they_are_and_their_values_with_them() {
    for n in SIZES {
        let keys = shuffled(n);
        // A monotonic output proves nothing: each value must have stayed with its key.
        let values: Vec<u32> = keys.iter().map(|key| key.wrapping_mul(2_654_435_761)).collect();
        let bits = u32::BITS - (n as u32).leading_zeros();
        let out = sorted(&mut gpu(), Keyed { keys, values }, bits, &[0; N_COUNTERS], NOWHERE);
        for (i, (key, value)) in out.keys.iter().zip(&out.values).enumerate() {
            assert_eq!((*key, *value), (i as u32, (i as u32).wrapping_mul(2_654_435_761)), "of {n}");
        }
    }
}

#[test]
#[ignore = "gpu"]
fn equal_keys_keep_their_order() {
    for n in [2, 257, 2049, 10_000] {
        for kinds in [1, 2, 3, 17] {
            let keys: Vec<u32> = (0..n).map(|i| (i as u32).wrapping_mul(7919) % kinds).collect();
            let values: Vec<u32> = (0..n as u32).collect();
            let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
            expected.sort();
            let out = sorted(&mut gpu(), Keyed { keys, values }, 8, &[0; N_COUNTERS], NOWHERE);
            let found: Vec<(u32, u32)> = out.keys.into_iter().zip(out.values).collect();
            assert_eq!(found, expected, "{n} of {kinds} kinds");
        }
    }
}

#[test]
#[ignore = "gpu"]
fn keys_of_all_bits() {
    let mut keys: Vec<u32> = (0..5000).map(|i| noise(5, i).to_bits() ^ (i as u32) << 20).collect();
    keys.extend([0, u32::MAX, 1, 1 << 31, u32::MAX, 0, f32::INFINITY.to_bits(), 0x7fff_ffff, 0xf]);
    keys.extend((0..u32::BITS).flat_map(|bit| [1 << bit, (1 << bit) - 1, !(1 << bit)]));
    let values: Vec<u32> = (0..keys.len() as u32).collect();
    let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    expected.sort();
    let out = sorted(&mut gpu(), Keyed { keys, values }, u32::BITS, &[0; N_COUNTERS], NOWHERE);
    assert_eq!(out.keys.into_iter().zip(out.values).collect::<Vec<_>>(), expected);
}

#[test]
#[ignore = "gpu"]
fn what_lies_behind_the_number_of_keys_is_not_looked_at() {
    let room = 3 * BLOCK;
    for n in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, room, room + 5] {
        let mut counters = [0; N_COUNTERS];
        counters[N_PAIRS as usize] = n as u32;
        let keys: Vec<u32> = (0..room as u32).map(|i| i.wrapping_mul(7919) % 251).collect();
        let values: Vec<u32> = (0..room as u32).collect();
        let n = n.min(room);
        let mut expected: Vec<(u32, u32)> =
            keys.iter().copied().zip(values.iter().copied()).take(n).collect();
        expected.sort();
        let out = sorted(&mut gpu(), Keyed { keys, values }, 8, &counters, N_PAIRS);
        assert!(out.keys[n..].iter().chain(&out.values[n..]).all(|&word| word == UNTOUCHED), "{n}");
        assert_eq!(out.keys.into_iter().zip(out.values).take(n).collect::<Vec<_>>(), expected, "{n}");
    }
}

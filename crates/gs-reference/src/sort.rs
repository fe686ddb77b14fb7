//! Twin of the pass `sort`: one digit of a stable sort of keys with values.

use gs_shaders::{ITEMS, N_COUNTERS, NOWHERE, SORT_DIGIT_BITS, Sort, WORKGROUP};

/// How often each digit occurs in each block, `[digits, blocks]`.
#[must_use]
pub fn sort_histogram(step: &Sort, counters: &[u32; N_COUNTERS], keys: &[u32]) -> Vec<u32> {
    let blocks = step.n_blocks as usize;
    let mut histogram = vec![0; blocks << SORT_DIGIT_BITS];
    for (block, keys) in keys[..key_count(step, counters)].chunks((WORKGROUP * ITEMS) as usize).enumerate() {
        for &key in keys {
            histogram[digit_of(step, key) as usize * blocks + block] += 1;
        }
    }
    histogram
}

/// The keys and their values in the order of the digit, equal digits as they were. Of what lies behind the number of keys, if
/// a counter has it, nothing is returned.
#[must_use]
pub fn sort_scatter(
    step: &Sort,
    counters: &[u32; N_COUNTERS],
    keys: &[u32],
    values: &[u32],
) -> (Vec<u32>, Vec<u32>) {
    let mut pairs: Vec<(u32, u32)> =
        keys[..key_count(step, counters)].iter().copied().zip(values.iter().copied()).collect();
    pairs.sort_by_key(|&(key, _)| digit_of(step, key));
    pairs.into_iter().unzip()
}

fn key_count(step: &Sort, counters: &[u32; N_COUNTERS]) -> usize {
    let count = if step.count == NOWHERE { step.n } else { counters[step.count as usize].min(step.n) };
    count as usize
}

fn digit_of(step: &Sort, key: u32) -> u32 {
    (key >> step.shift) & ((1 << SORT_DIGIT_BITS) - 1)
}

//! Sorting networks over 32 keys in eight registers.
//!
//! Keys are compared as f64: their bits are those of finite doubles, at least +0, which order as the integers do, and
//! a minimum or maximum of doubles is one instruction where one of integers would be two. Key `j` of a sorted run lies
//! in lane `j / 8` of register `j % 8`, so that most steps of a merge are between registers and need no shuffle.

use crate::search::NO_CANDIDATE;
use std::arch::x86_64::*;

/// Keys of a run.
pub(super) const RUN: usize = 32;

/// Sorted keys in memory, register by register.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub(super) struct Run([[u64; 4]; 8]);

type Registers = [__m256d; 8];

impl Run {
    pub(super) const EMPTY: Self = Self([[NO_CANDIDATE; 4]; 8]);

    /// The `j`-th key.
    pub(super) fn key(&self, j: usize) -> u64 {
        self.0[j % 8][j / 8]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn load(&self) -> Registers {
        let mut registers = [_mm256_setzero_pd(); 8];
        for (register, row) in registers.iter_mut().zip(&self.0) {
            // SAFETY: a row is as large as a register.
            *register = unsafe { _mm256_loadu_pd(row.as_ptr().cast()) };
        }
        registers
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn store(&mut self, registers: Registers) {
        for (row, register) in self.0.iter_mut().zip(registers) {
            // SAFETY: a row is as large as a register.
            unsafe { _mm256_storeu_pd(row.as_mut_ptr().cast(), register) }
        }
    }
}

/// Eight keys, in any order.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn keys(sq_distances: __m256, indices: __m256i) -> (__m256d, __m256d) {
    let high = _mm256_castps_si256(sq_distances);
    (
        _mm256_castsi256_pd(_mm256_unpacklo_epi32(indices, high)),
        _mm256_castsi256_pd(_mm256_unpackhi_epi32(indices, high)),
    )
}

/// Puts the lower of each lane into the first register of each pair. Written out: in a loop over pairs the registers
/// would live in memory.
macro_rules! order {
    ($r:ident: $($a:literal $b:literal),*) => {
        $(($r[$a], $r[$b]) = (_mm256_min_pd($r[$a], $r[$b]), _mm256_max_pd($r[$a], $r[$b]));)*
    };
}

/// The lower of each lane and its partner where `$high` has 0, the higher where it has 1.
macro_rules! choose {
    ($high:literal, $register:expr, $partner:expr) => {
        _mm256_blend_pd::<$high>(_mm256_min_pd($register, $partner), _mm256_max_pd($register, $partner))
    };
}

/// Sorts 32 keys.
#[target_feature(enable = "avx2")]
pub(super) fn sort(mut r: Registers) -> Registers {
    // Batcher's odd-even merge sort of eight registers: four sorted columns.
    order!(r: 0 1, 2 3, 4 5, 6 7, 0 2, 1 3, 4 6, 5 7, 1 2, 5 6, 0 4, 1 5, 2 6, 3 7, 2 4, 3 5, 1 2, 3 4, 5 6);
    // A sorted column and another one reversed are bitonic: 0 with 1 and 2 with 3.
    let mut pairs = r;
    for i in 0..8 {
        pairs[i] = choose!(0b1010, r[i], swap_columns(r[7 - i]));
    }
    sort_bitonic_columns(&mut pairs);
    // Then both pairs.
    let mut all = pairs;
    for i in 0..8 {
        all[i] = choose!(0b1100, pairs[i], reverse_columns(pairs[7 - i]));
    }
    sort_bitonic_pairs(&mut all);
    all
}

/// The lower and the higher half of two sorted runs, each sorted.
#[target_feature(enable = "avx2")]
pub(super) fn merge(a: Registers, b: Registers) -> (Registers, Registers) {
    let mut high = a;
    for i in 0..8 {
        high[i] = _mm256_max_pd(a[i], reverse_columns(b[7 - i]));
    }
    sort_bitonic(&mut high);
    (merge_low(a, b), high)
}

/// The lower half of two sorted runs, sorted.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn merge_low(a: Registers, b: Registers) -> Registers {
    let mut low = a;
    for i in 0..8 {
        low[i] = _mm256_min_pd(a[i], reverse_columns(b[7 - i]));
    }
    sort_bitonic(&mut low);
    low
}

#[inline]
#[target_feature(enable = "avx2")]
fn sort_bitonic(r: &mut Registers) {
    for r in r.iter_mut() {
        *r = choose!(0b1100, *r, _mm256_permute4x64_pd::<0b01_00_11_10>(*r));
    }
    sort_bitonic_pairs(r);
}

/// Columns 0 and 1, 2 and 3.
#[inline]
#[target_feature(enable = "avx2")]
fn sort_bitonic_pairs(r: &mut Registers) {
    for r in r.iter_mut() {
        *r = choose!(0b1010, *r, swap_columns(*r));
    }
    sort_bitonic_columns(r);
}

#[inline]
#[target_feature(enable = "avx2")]
fn sort_bitonic_columns(r: &mut Registers) {
    order!(r: 0 4, 1 5, 2 6, 3 7, 0 2, 1 3, 4 6, 5 7, 0 1, 2 3, 4 5, 6 7);
}

/// Columns 1, 0, 3, 2.
#[inline]
#[target_feature(enable = "avx2")]
fn swap_columns(r: __m256d) -> __m256d {
    _mm256_permute_pd::<0b0101>(r)
}

/// Columns 3, 2, 1, 0.
#[inline]
#[target_feature(enable = "avx2")]
fn reverse_columns(r: __m256d) -> __m256d {
    _mm256_permute4x64_pd::<0b00_01_10_11>(r)
}

/// Indices and squared distances of a sorted run in its order, eight by eight.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn in_order(r: Registers) -> [(__m256i, __m256); 4] {
    let low = transpose([r[0], r[1], r[2], r[3]]);
    let high = transpose([r[4], r[5], r[6], r[7]]);
    [
        split_keys(low[0], high[0]),
        split_keys(low[1], high[1]),
        split_keys(low[2], high[2]),
        split_keys(low[3], high[3]),
    ]
}

#[inline]
#[target_feature(enable = "avx2")]
fn transpose(r: [__m256d; 4]) -> [__m256d; 4] {
    let (a, b) = (_mm256_unpacklo_pd(r[0], r[1]), _mm256_unpackhi_pd(r[0], r[1]));
    let (c, d) = (_mm256_unpacklo_pd(r[2], r[3]), _mm256_unpackhi_pd(r[2], r[3]));
    [
        _mm256_permute2f128_pd::<0x20>(a, c),
        _mm256_permute2f128_pd::<0x20>(b, d),
        _mm256_permute2f128_pd::<0x31>(a, c),
        _mm256_permute2f128_pd::<0x31>(b, d),
    ]
}

/// Indices and squared distances of eight keys.
#[inline]
#[target_feature(enable = "avx2")]
fn split_keys(a: __m256d, b: __m256d) -> (__m256i, __m256) {
    let (a, b) = (_mm256_castpd_ps(a), _mm256_castpd_ps(b));
    // Both take two of every four lanes of a, then of b, so that the middle quarters are to be swapped.
    let indices = _mm256_castps_pd(_mm256_shuffle_ps::<0b10_00_10_00>(a, b));
    let sq_distances = _mm256_castps_pd(_mm256_shuffle_ps::<0b11_01_11_01>(a, b));
    (
        _mm256_castpd_si256(_mm256_permute4x64_pd::<0b11_01_10_00>(indices)),
        _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(sq_distances)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Keys of real distances with many ties, zero and infinity among them.
    fn some_keys() -> impl Strategy<Value = Vec<u64>> {
        let sq_distance =
            prop_oneof![Just(0.0f32), Just(1e-45), Just(f32::INFINITY), 0.0..f32::MAX, 0.0f32..2.0];
        let key = (sq_distance, prop_oneof![0..4u32, any::<u32>()]);
        prop::collection::vec(key.prop_map(|(d, i)| crate::search::key(d, i)), 2 * RUN)
    }

    #[target_feature(enable = "avx2")]
    fn through_registers(keys: &[u64]) -> [Vec<u64>; 3] {
        let run = |keys: &[u64]| {
            let rows = std::array::from_fn(|i| std::array::from_fn(|j| keys[4 * i + j]));
            sort(Run(rows).load())
        };
        let list = |registers: Registers| {
            let mut run = Run::EMPTY;
            run.store(registers);
            let keys: Vec<u64> = (0..RUN).map(|j| run.key(j)).collect();
            let (mut indices, mut sq_distances) = ([0; RUN], [0.0; RUN]);
            for (register, (i, d)) in in_order(registers).into_iter().enumerate() {
                crate::avx2::vector::store_u32(&mut indices[8 * register..], i);
                crate::avx2::vector::store(&mut sq_distances[8 * register..], d);
            }
            let again: Vec<u64> =
                sq_distances.iter().zip(indices).map(|(&d, i)| crate::search::key(d, i)).collect();
            assert_eq!(keys, again);
            keys
        };
        let (a, b) = (run(&keys[..RUN]), run(&keys[RUN..]));
        let (low, high) = merge(a, b);
        assert_eq!(list(low), list(merge_low(a, b)));
        [list(a), list(low), list(high)]
    }

    proptest! {
        #[test]
        fn networks_sort(keys in some_keys()) {
            if is_x86_feature_detected!("avx2") {
                // SAFETY: just detected.
                let [first, low, high] = unsafe { through_registers(&keys) };
                let mut expected = keys.clone();
                expected[..RUN].sort_unstable();
                prop_assert_eq!(&first, &expected[..RUN]);
                expected.sort_unstable();
                prop_assert_eq!([low, high].concat(), expected);
            }
        }
    }
}

//! 32 windows at a time, without histograms.
//!
//! Let S be Σ c log2 c over the levels in a window. Pixels that join it one after the other raise S by `step(r)` each,
//! r being how many pixels of the same level are there already (its rank), and step(r) the rise from r log2 r to
//! (r + 1) log2 (r + 1). When a window moves down by a row, `size` pixels join and `size` leave; for both, the rank
//! is the number of equals among the `size - 1` rows that stay, and among the pixels to the left in the own row.
//!
//! A pixel belongs to `size` windows of a row, and the equals that they see are sums of runs of columns: one comparison
//! with each pixel of 2·size - 1 columns and `size - 1` rows around it serves all of them ([`ranks`]). Comparisons and
//! sums work on bytes; steps are looked up by shuffles, one byte of their three at a time ([`add_steps`]).
// Closures would be compiled without AVX2, hence the loops over short arrays.
#![allow(unsafe_code)] // Loads, stores, and the call of functions that are compiled for AVX2.

use super::Steps;
use cpu_isa::Isa;
use std::arch::x86_64::*;

/// Windows per step: the bytes of a register.
pub(super) const LANES: usize = 32;

/// Bytes that a row must have from the place on at which a step begins.
pub(super) const REACH: usize = 64;

/// Largest window: ranks fit six bits.
pub(super) const MAX_SIZE: usize = 7;

/// Ranks are stored with this added, so that bit 7 says "16 or more": a shuffle gives 0 there.
const BIAS: u8 = 0x70;

/// The steps of ranks 0 to 48, by bytes: low, middle, high.
pub(super) struct ByteSteps {
    size: usize,
    bytes: [[[u8; 16]; 4]; 3],
}

impl ByteSteps {
    /// None if AVX2 is not in use, or the window is none that these functions are made for.
    pub(super) fn new(size: usize, steps: &Steps) -> Option<Self> {
        if Isa::in_use() < Isa::Avx2 || !matches!(size, 3 | 5 | MAX_SIZE) {
            return None;
        }
        let mut bytes = [[[0; 16]; 4]; 3];
        for (rank, step) in steps.up.iter().enumerate() {
            let [low, middle, high, none] = step.to_le_bytes();
            assert!(none == 0, "a step of {step} units has more than 24 bits");
            for (bytes, byte) in bytes.iter_mut().zip([low, middle, high]) {
                bytes[rank / 16][rank % 16] = byte;
            }
        }
        Some(Self { size, bytes })
    }
}

/// All windows of a row of the picture.
pub(super) struct Windows<'a> {
    steps: &'a ByteSteps,
    /// S of each window in the units of [`Steps`]; beyond the last, to a multiple of [`LANES`], what is padding.
    pub(super) sums: Vec<i32>,
    /// Biased ranks of the pixels that join and leave, by their column in the window: `[size, 2, stride]`.
    ranks: Vec<u8>,
}

impl<'a> Windows<'a> {
    /// Windows that see nothing yet, `width` in a row.
    pub(super) fn new(width: usize, steps: &'a ByteSteps) -> Self {
        let stride = (width + steps.size - 1).next_multiple_of(LANES) + LANES;
        Self {
            steps,
            sums: vec![0; width.next_multiple_of(LANES)],
            ranks: vec![BIAS; 2 * steps.size * stride],
        }
    }

    /// Bytes of a padded row: [`Self::slide`] takes no shorter ones.
    pub(super) fn row_len(width: usize, size: usize) -> usize {
        (width + size - 1).next_multiple_of(LANES) + REACH - LANES
    }

    /// Moves the windows: the row `joins` comes in, `leaves` goes, `stay` are the other rows that the windows see. In
    /// each row, the first pixel of the first window lies at `size - 1`.
    pub(super) fn slide(&mut self, joins: Option<&[u8]>, leaves: Option<&[u8]>, stay: &[&[u8]]) {
        // SAFETY: a `ByteSteps` exists only where the processor has AVX2.
        unsafe {
            match self.steps.size {
                3 => slide::<3, 1, 1>(self, joins, leaves, stay),
                5 => slide::<5, 2, 2>(self, joins, leaves, stay),
                _ => slide::<MAX_SIZE, 3, 4>(self, joins, leaves, stay),
            }
        }
    }
}

/// [`Windows::slide`] for `N`×`N` windows. Ranks below `N² - 1` fit `LOW` tables of 16, rank `N² - 1` fits `TOP`.
#[target_feature(enable = "avx2")]
fn slide<const N: usize, const LOW: usize, const TOP: usize>(
    windows: &mut Windows,
    joins: Option<&[u8]>,
    leaves: Option<&[u8]>,
    stay: &[&[u8]],
) {
    let Some(present) = joins.or(leaves) else { return };
    let Windows { steps, sums, ranks: planes } = windows;
    let stride = planes.len() / (2 * N);
    let rows = [joins.unwrap_or(present), leaves.unwrap_or(present)];
    // The number of rows that stay is the same nearly everywhere: known, the loop over them is unrolled.
    match (N, stay.len()) {
        (3, 2) => ranks::<N, 2>(rows, stay, planes, stride),
        (5, 4) => ranks::<N, 4>(rows, stay, planes, stride),
        (7, 6) => ranks::<N, 6>(rows, stay, planes, stride),
        _ => ranks::<N, 0>(rows, stay, planes, stride),
    }
    for (plane, ranks) in planes.chunks_exact_mut(stride).enumerate() {
        // A row that is not there: a pixel of rank 0 makes no difference.
        if [joins, leaves][plane % 2].is_none() {
            ranks.fill(BIAS);
        }
    }
    add_steps::<N, LOW, TOP>(planes, stride, steps, sums);
}

/// Ranks of the pixels of the two `rows` among the rows `stay` (`K` of them, if `K` is not 0) and their own, for each
/// column j of an `N`×`N` window in which they may be: planes 2 j and 2 j + 1 of `planes`.
#[target_feature(enable = "avx2")]
fn ranks<const N: usize, const K: usize>(rows: [&[u8]; 2], stay: &[&[u8]], planes: &mut [u8], stride: usize) {
    let end = stride - LANES;
    assert!(stay.iter().chain(&rows).all(|row| row.len() >= end + REACH - LANES), "rows are padded");
    assert!(planes.len() >= 2 * N * stride, "a plane for each column and row");
    let mut known = [rows[0]; K];
    known.copy_from_slice(&stay[..K]);
    for x in (0..end).step_by(LANES) {
        // SAFETY: x is at most `end - LANES`, and a row is read from there on at most `2 * MAX_SIZE - 2 + LANES` bytes
        // far, which is below `REACH`.
        let load = |row: &[u8], column: usize| unsafe { load(row, x + column) };
        let pixels = [load(rows[0], N - 1), load(rows[1], N - 1)];
        // Equals in the first columns, from `N - 1` to the left of the pixel on, modulo 256.
        let mut equals = [_mm256_setzero_si256(); 2];
        let mut up_to = [equals; 2 * MAX_SIZE];
        for column in 0..2 * N - 1 {
            if K > 0 {
                for row in known {
                    count(&mut equals, pixels, load(row, column));
                }
            } else {
                for row in stay {
                    count(&mut equals, pixels, load(row, column));
                }
            }
            up_to[column + 1] = equals;
        }
        for (i, row) in rows.into_iter().enumerate() {
            let mut rank = _mm256_set1_epi8(BIAS as i8);
            for j in 0..N {
                if j > 0 {
                    rank = _mm256_sub_epi8(rank, _mm256_cmpeq_epi8(pixels[i], load(row, N - 1 - j)));
                }
                let above = _mm256_sub_epi8(up_to[2 * N - 1 - j][i], up_to[N - 1 - j][i]);
                let plane = (2 * j + i) * stride;
                // SAFETY: `x + LANES` is at most `stride`, and there are `2 * N` planes.
                unsafe { store(planes, plane + x, _mm256_add_epi8(rank, above)) };
            }
        }
    }
}

/// Counts where the two registers of `pixels` equal `other`.
#[inline]
#[target_feature(enable = "avx2")]
fn count(equals: &mut [__m256i; 2], pixels: [__m256i; 2], other: __m256i) {
    equals[0] = _mm256_sub_epi8(equals[0], _mm256_cmpeq_epi8(pixels[0], other));
    equals[1] = _mm256_sub_epi8(equals[1], _mm256_cmpeq_epi8(pixels[1], other));
}

/// Adds the steps of all joining pixels of a window to its sum, and takes those of the leaving ones away.
#[target_feature(enable = "avx2")]
fn add_steps<const N: usize, const LOW: usize, const TOP: usize>(
    planes: &[u8],
    stride: usize,
    steps: &ByteSteps,
    sums: &mut [i32],
) {
    assert!(planes.len() >= 2 * N * stride && sums.len() + N <= stride, "ranks for all windows");
    let (mut low, mut top) = ([[_mm256_setzero_si256(); LOW]; 3], [[_mm256_setzero_si256(); TOP]; 3]);
    for (byte, bytes) in steps.bytes.iter().enumerate() {
        low[byte] = tables(bytes);
        top[byte] = tables(bytes);
    }
    // Bytes b0, b1 and b2 of a step make b0 + 256 b1, by a multiplication, + 65536 b2, by an unpacking.
    let (weights, zero) = (_mm256_set1_epi32(0x0100_0001), _mm256_setzero_si256());
    for (sums, x) in sums.chunks_exact_mut(LANES).zip((0..).step_by(LANES)) {
        // Sums of each byte, 16 bits: pixels 0 to 7 and 16 to 23, then 8 to 15 and 24 to 31.
        let mut rises = [[zero; 2]; 3];
        for (byte, rises) in rises.iter_mut().enumerate() {
            for j in 0..N {
                let start = 2 * j * stride + x + j;
                // SAFETY: `x + j + LANES` is at most `sums.len() + N`, hence `stride`, and there are `2 * N` planes.
                let ranks = unsafe { [load(planes, start), load(planes, start + stride)] };
                // Only the last pixel of a window may find `N² - 1` equals.
                if j + 1 < N {
                    add_bytes(rises, &low[byte], ranks);
                } else {
                    add_bytes(rises, &top[byte], ranks);
                }
            }
        }
        // Within each half of the registers: pixels 0 to 3, 4 to 7, 8 to 11, 12 to 15.
        let [b0, b1, b2] = rises;
        let mut quarters = [zero; 4];
        for h in 0..2 {
            let first = _mm256_madd_epi16(_mm256_unpacklo_epi16(b0[h], b1[h]), weights);
            let second = _mm256_madd_epi16(_mm256_unpackhi_epi16(b0[h], b1[h]), weights);
            quarters[2 * h] = _mm256_add_epi32(first, _mm256_unpacklo_epi16(zero, b2[h]));
            quarters[2 * h + 1] = _mm256_add_epi32(second, _mm256_unpackhi_epi16(zero, b2[h]));
        }
        let [q0, q1, q2, q3] = quarters;
        let in_order = [
            _mm256_permute2x128_si256::<0x20>(q0, q1),
            _mm256_permute2x128_si256::<0x20>(q2, q3),
            _mm256_permute2x128_si256::<0x31>(q0, q1),
            _mm256_permute2x128_si256::<0x31>(q2, q3),
        ];
        for (sums, rises) in sums.chunks_exact_mut(8).zip(in_order) {
            // SAFETY: 8 sums are the 32 bytes that are read and written.
            unsafe {
                let old = _mm256_loadu_si256(sums.as_ptr().cast());
                _mm256_storeu_si256(sums.as_mut_ptr().cast(), _mm256_add_epi32(old, rises));
            }
        }
    }
}

/// Adds a byte of the steps of joining less leaving `ranks`.
#[inline]
#[target_feature(enable = "avx2")]
fn add_bytes<const T: usize>(rises: &mut [__m256i; 2], tables: &[__m256i; T], ranks: [__m256i; 2]) {
    let mut bytes = [_mm256_setzero_si256(); 2];
    for (bytes, ranks) in bytes.iter_mut().zip(ranks) {
        for (t, &table) in tables.iter().enumerate() {
            let index = _mm256_sub_epi8(ranks, _mm256_set1_epi8(16 * t as i8));
            *bytes = _mm256_xor_si256(*bytes, _mm256_shuffle_epi8(table, index));
        }
    }
    let join_less_leave = _mm256_set1_epi16(i16::from_le_bytes([1, -1i8 as u8]));
    let first = _mm256_maddubs_epi16(_mm256_unpacklo_epi8(bytes[0], bytes[1]), join_less_leave);
    let second = _mm256_maddubs_epi16(_mm256_unpackhi_epi8(bytes[0], bytes[1]), join_less_leave);
    *rises = [_mm256_add_epi16(rises[0], first), _mm256_add_epi16(rises[1], second)];
}

/// Tables for the shuffles, 16 ranks each, whose `xor` is the byte: a biased rank less 16 t finds an entry in table t
/// also if the rank is smaller than 16 t, but none if it is 16 t + 16 or more. Hence table t holds the bytes of its
/// own ranks, `xor` those of the next 16.
#[inline]
#[target_feature(enable = "avx2")]
fn tables<const T: usize>(bytes: &[[u8; 16]; 4]) -> [__m256i; T] {
    let mut tables = [_mm256_setzero_si256(); T];
    let mut next = _mm256_setzero_si256();
    for (table, bytes) in tables.iter_mut().zip(bytes).rev() {
        // SAFETY: the array has the 16 bytes that are read.
        let entries = _mm256_broadcastsi128_si256(unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) });
        *table = _mm256_xor_si256(entries, next);
        next = entries;
    }
    tables
}

/// # Safety
/// `from` has [`LANES`] bytes from `start` on.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn load(from: &[u8], start: usize) -> __m256i {
    debug_assert!(start + LANES <= from.len());
    // SAFETY: the caller's.
    unsafe { _mm256_loadu_si256(from.as_ptr().add(start).cast()) }
}

/// # Safety
/// `to` has [`LANES`] bytes from `start` on.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn store(to: &mut [u8], start: usize, register: __m256i) {
    debug_assert!(start + LANES <= to.len());
    // SAFETY: the caller's.
    unsafe { _mm256_storeu_si256(to.as_mut_ptr().add(start).cast(), register) }
}

//! Vectors of eight f32 or u32.

use std::arch::x86_64::*;

/// Lanes of a vector.
pub(super) const LANES: usize = 8;

/// For each mask of eight lanes, the lanes that are set, packed to the front.
static PACKED: [[u8; LANES]; 256] = {
    let mut table = [[0; LANES]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut slot) = (0, 0);
        while lane < LANES {
            if mask >> lane & 1 == 1 {
                table[mask][slot] = lane as u8;
                slot += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
};

/// The lanes of a mask, packed to the front; anything behind them.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn pack(floats: __m256, integers: __m256i, mask: u8) -> (__m256, __m256i) {
    let lanes = _mm_cvtsi64_si128(i64::from_le_bytes(PACKED[usize::from(mask)]));
    let lanes = _mm256_cvtepu8_epi32(lanes);
    (_mm256_permutevar8x32_ps(floats, lanes), _mm256_permutevar8x32_epi32(integers, lanes))
}

/// `dx*dx + dy*dy + dz*dz`, each operation rounded, in this order.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn squared_norm(dx: __m256, dy: __m256, dz: __m256) -> __m256 {
    let xy = _mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy));
    _mm256_add_ps(xy, _mm256_mul_ps(dz, dz))
}

/// One integer in every lane.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn set_u32(value: u32) -> __m256i {
    _mm256_set1_epi32(value.cast_signed())
}

/// The first eight elements.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn load(from: &[f32]) -> __m256 {
    let from = &from[..LANES];
    // SAFETY: eight floats are there.
    unsafe { _mm256_loadu_ps(from.as_ptr()) }
}

/// The first eight elements.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn load_u32(from: &[u32]) -> __m256i {
    let from = &from[..LANES];
    // SAFETY: eight integers are there.
    unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
}

/// To the first eight elements.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn store(to: &mut [f32], value: __m256) {
    let to = &mut to[..LANES];
    // SAFETY: there is room for eight floats.
    unsafe { _mm256_storeu_ps(to.as_mut_ptr(), value) }
}

/// To the first eight elements.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn store_u32(to: &mut [u32], value: __m256i) {
    let to = &mut to[..LANES];
    // SAFETY: there is room for eight integers.
    unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), value) }
}

//! The pixels of a tile as vectors: in patches of 4×4 pixels, because of most splats it takes fewer patches than rows to cover them. A patch is
//! one vector of AVX-512, two of AVX2, four of NEON.

use super::{Grid, TILE};
use cpu_kernels::pulp::Simd;

/// Side of a patch, pixels; and how many are in a row of a tile.
pub(super) const SIDE: usize = 4;
/// Pixels of a patch.
pub(super) const LANES: usize = SIDE * SIDE;
/// Patches of a tile.
pub(super) const PATCHES: usize = TILE * TILE / LANES;

/// One number per pixel of a tile, patch by patch.
pub(super) type Plane<T = f32> = [[T; LANES]; PATCHES];

/// Patch and lane of a pixel of a tile.
#[inline(always)]
pub(super) fn patch(x: usize, y: usize) -> (usize, usize) {
    (y / SIDE * SIDE + x / SIDE, y % SIDE * SIDE + x % SIDE)
}

/// Which patch of a tile, and which vector of the patch.
pub(super) type Place = (usize, usize);

/// The vector of a plane.
#[inline(always)]
pub(super) fn at<S: Simd>(plane: &Plane, (patch, v): Place) -> S::f32s {
    vectors::<S>(&plane[patch])[v]
}

/// Replaces it.
#[inline(always)]
pub(super) fn put<S: Simd>(plane: &mut Plane, (patch, v): Place, vector: S::f32s) {
    vectors_mut::<S>(&mut plane[patch])[v] = vector;
}

/// As [`at`], of integers.
#[inline(always)]
pub(super) fn integers_at<S: Simd>(plane: &Plane<i32>, (patch, v): Place) -> S::i32s {
    S::as_simd_i32s(&plane[patch]).0[v]
}

/// As [`put`], of integers.
#[inline(always)]
pub(super) fn put_integers<S: Simd>(plane: &mut Plane<i32>, (patch, v): Place, vector: S::i32s) {
    S::as_mut_simd_i32s(&mut plane[patch]).0[v] = vector;
}

/// A patch in vectors.
#[inline(always)]
fn vectors<S: Simd>(lanes: &[f32; LANES]) -> &[S::f32s] {
    S::as_simd_f32s(lanes).0
}

/// A patch in vectors that can be written.
#[inline(always)]
fn vectors_mut<S: Simd>(lanes: &mut [f32; LANES]) -> &mut [S::f32s] {
    S::as_mut_simd_f32s(lanes).0
}

/// Whether a mask is true anywhere.
#[inline(always)]
fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    simd.first_true_m32s(mask) < S::F32_LANES
}

/// Centres of the pixels of a tile, from its left edge and from its top.
#[inline(always)]
pub(super) fn centres<S: Simd>(place: Place) -> [S::f32s; 2] {
    [at::<S>(&ACROSS.0, place), at::<S>(&DOWN.0, place)]
}

/// A plane whose vectors are read in one step.
#[repr(align(64))]
struct Aligned(Plane);

static ACROSS: Aligned = Aligned(plane_of_centres(false));
static DOWN: Aligned = Aligned(plane_of_centres(true));

const fn plane_of_centres(down: bool) -> Plane {
    let mut plane = [[0.0; LANES]; PATCHES];
    let mut pixel = 0;
    while pixel < TILE * TILE {
        let (patch, lane) = (pixel / LANES, pixel % LANES);
        let (x, y) = (patch % SIDE * SIDE + lane % SIDE, patch / SIDE * SIDE + lane / SIDE);
        plane[patch][lane] = if down { y as f32 + 0.5 } else { x as f32 + 0.5 };
        pixel += 1;
    }
    plane
}

/// The top-left corner of a tile, pixels.
pub(super) fn origin(grid: Grid, tile: usize) -> [u32; 2] {
    [(tile % grid.columns * TILE) as u32, (tile / grid.columns * TILE) as u32]
}

/// Where in a tile, a bit for each strip: four columns of a vector's pixels (AVX-512 has four rows of them, AVX2 two, NEON one), or one row of
/// vectors that are shorter. From the left, then from the top.
#[derive(Debug, Clone, Copy)]
pub(super) struct Strips(u64);

impl Strips {
    pub(super) const NONE: Self = Self(0);

    /// Rows of pixels of a strip.
    #[inline(always)]
    pub(super) const fn rows<S: Simd>() -> usize {
        if S::F32_LANES < SIDE { 1 } else { S::F32_LANES / SIDE }
    }

    /// The strips of each row of strips, a bit for each.
    #[inline(always)]
    pub(super) fn of_rows(rows: &[u32]) -> Self {
        let mut strips = 0;
        for (row, &found) in rows.iter().enumerate() {
            strips |= u64::from(found) << (row * SIDE);
        }
        Self(strips)
    }

    /// The strips with a number above 0.
    #[inline(always)]
    pub(super) fn above_zero<S: Simd>(simd: S, plane: &Plane) -> Self {
        let mut rows = [0; TILE];
        for (y, patches) in plane.as_chunks::<SIDE>().0.iter().enumerate() {
            for v in 0..LANES / S::F32_LANES {
                let row = (y * SIDE + v * S::F32_LANES / SIDE) / Self::rows::<S>();
                for (x, patch) in patches.iter().enumerate() {
                    let is_above = simd.greater_than_f32s(vectors::<S>(patch)[v], simd.splat_f32s(0.0));
                    rows[row] |= u32::from(any(simd, is_above)) << x;
                }
            }
        }
        Self::of_rows(&rows[..TILE / Self::rows::<S>()])
    }

    #[inline(always)]
    pub(super) fn is_empty(self) -> bool {
        self.0 == 0
    }

    #[inline(always)]
    pub(super) fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Calls `visit` with the number and the place of each vector.
    #[inline(always)]
    pub(super) fn for_each<S: Simd>(self, mut visit: impl FnMut(usize, Place)) {
        let mut rest = self.0;
        let mut number = 0;
        while rest != 0 {
            let strip = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let (x, y) = (strip % SIDE, strip / SIDE * Self::rows::<S>());
            let (patch, first) = ((y / SIDE * SIDE + x) % PATCHES, y % SIDE * SIDE / S::F32_LANES);
            for v in first..first + SIDE.div_ceil(S::F32_LANES) {
                visit(number % (PATCHES * LANES / S::F32_LANES), (patch, v));
                number += 1;
            }
        }
    }
}

/// A number for each pixel of a splat, vector by vector as they are visited.
#[repr(align(64))]
pub(super) struct Buffer(Plane);

impl Buffer {
    pub(super) const EMPTY: Self = Self([[0.0; LANES]; PATCHES]);

    #[inline(always)]
    pub(super) fn vectors<S: Simd>(&mut self) -> &mut [S::f32s] {
        S::as_mut_simd_f32s(self.0.as_flattened_mut()).0
    }
}

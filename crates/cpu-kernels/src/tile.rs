//! Sums of a tile of a matrix product, in registers. Lengths are checked once per tile; within its loop a check would push the
//! sums out of the registers, so pointers are used there.
#![allow(unsafe_code)]

use pulp::Simd;

/// For each of up to ROWS rows, `stride` apart, `start` and the sum over k of row[k] times the first VECTORS * lanes numbers of row k of the panel, whose rows are
/// `columns` long. Of a tile that is not full the last row is computed several times.
#[inline(always)]
pub(crate) fn of_rows<S: Simd, const VECTORS: usize, const ROWS: usize>(
    simd: S,
    (rows, stride, count): (&[f32], usize, usize),
    (panel, columns): (&[f32], usize),
    start: [S::f32s; VECTORS],
) -> [[S::f32s; VECTORS]; ROWS] {
    assert!(VECTORS * S::F32_LANES <= columns, "columns of the panel");
    let depth = panel.len() / columns;
    let last = count.checked_sub(1).expect("a row");
    assert!(last * stride + depth <= rows.len(), "a value of every row for every row of the panel");
    let rows: [*const f32; ROWS] = std::array::from_fn(|i| rows[i.min(last) * stride..].as_ptr());
    let panel = panel.as_ptr();
    // SAFETY: k < depth, which every row and the panel have.
    unsafe { sums(simd, depth, |i, k| *rows[i].add(k), |k| panel.add(k * columns), start) }
}

/// The sum over k < depth of the first ROWS values of A's row k times the first VECTORS * lanes values of B's; rows begin a
/// stride apart.
#[inline(always)]
pub(crate) fn of_columns<S: Simd, const VECTORS: usize, const ROWS: usize>(
    simd: S,
    (a, a_stride): (&[f32], usize),
    (b, b_stride): (&[f32], usize),
    depth: usize,
) -> [[S::f32s; VECTORS]; ROWS] {
    let needed = |stride: usize, width: usize| depth.checked_sub(1).map_or(0, |last| last * stride + width);
    assert!(needed(a_stride, ROWS) <= a.len(), "rows of A");
    assert!(needed(b_stride, VECTORS * S::F32_LANES) <= b.len(), "rows of B");
    let (a, b) = (a.as_ptr(), b.as_ptr());
    let zero = [simd.splat_f32s(0.0); VECTORS];
    // SAFETY: k < depth, and i < ROWS values from the beginning of such a row lie within A, a tile's columns within B.
    unsafe { sums(simd, depth, |i, k| *a.add(k * a_stride + i), |k| b.add(k * b_stride), zero) }
}

/// `start` and the sum over k of a(i, k) times the vectors at b(k).
///
/// # Safety
/// `a` may be called for i < ROWS and k < depth, and VECTORS * lanes values lie at b(k).
#[inline(always)]
unsafe fn sums<S: Simd, const VECTORS: usize, const ROWS: usize>(
    simd: S,
    depth: usize,
    a: impl Fn(usize, usize) -> f32,
    b: impl Fn(usize) -> *const f32,
    start: [S::f32s; VECTORS],
) -> [[S::f32s; VECTORS]; ROWS] {
    let mut sums = [start; ROWS];
    for k in 0..depth {
        let b = b(k).cast::<S::f32s>();
        // SAFETY: the caller's promise.
        let b: [S::f32s; VECTORS] = std::array::from_fn(|j| unsafe { b.add(j).read_unaligned() });
        for (i, sums) in sums.iter_mut().enumerate() {
            let a = simd.splat_f32s(a(i, k));
            for (sum, b) in sums.iter_mut().zip(b) {
                *sum = simd.mul_add_e_f32s(a, b, *sum);
            }
        }
    }
    sums
}

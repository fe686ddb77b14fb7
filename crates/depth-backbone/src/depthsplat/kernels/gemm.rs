//! Matrix products on slices: rows of A as they lie, B packed once, no copy of A.

use super::math::mul_add;
use multiversion::{multiversion, target::target_cfg_f};

/// Columns of a panel of B: one 512-bit or two 256-bit registers.
pub(in crate::depthsplat) const PANEL: usize = 16;
/// Rows of B per pass: a panel of them stays in the first-level cache. Each pass sums from zero, which keeps the
/// rounding of long sums small.
const DEPTH: usize = 384;

/// B `[depth, columns]` in panels of 16 columns, each `[depth, 16]`; the last one is filled up with zeros.
#[derive(Debug, Clone)]
pub(in crate::depthsplat) struct Packed {
    depth: usize,
    columns: usize,
    panels: Vec<f32>,
}

impl Packed {
    /// Packs B given by value(row, column).
    pub(in crate::depthsplat) fn new(
        depth: usize,
        columns: usize,
        value: impl Fn(usize, usize) -> f32,
    ) -> Self {
        let mut panels = vec![0.0; depth * columns.next_multiple_of(PANEL)];
        for (p, panel) in panels.chunks_exact_mut((depth * PANEL).max(1)).enumerate() {
            let first = p * PANEL;
            for (k, row) in panel.chunks_exact_mut(PANEL).enumerate() {
                for (j, v) in row.iter_mut().enumerate().take(columns - first) {
                    *v = value(k, first + j);
                }
            }
        }
        Self { depth, columns, panels }
    }

    /// Packs B that is stored transposed, `[columns, depth]`, as weights are.
    pub(in crate::depthsplat) fn transposed(depth: usize, columns: usize, rows: &[f32]) -> Self {
        Self::new(depth, columns, |k, n| rows[n * depth + k])
    }

    /// Rows of B.
    pub(in crate::depthsplat) fn depth(&self) -> usize {
        self.depth
    }

    /// Columns of B.
    pub(in crate::depthsplat) fn columns(&self) -> usize {
        self.columns
    }

    /// Number of panels.
    pub(super) fn panel_count(&self) -> usize {
        self.columns.div_ceil(PANEL)
    }

    /// One panel, `[depth, 16]`.
    pub(super) fn panel(&self, p: usize) -> &[f32] {
        &self.panels[p * self.depth * PANEL..][..self.depth * PANEL]
    }
}

/// Rows of a matrix: `count` rows of `depth` values, each `stride` after the one before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a> {
    pub(super) values: &'a [f32],
    pub(super) stride: usize,
    pub(super) count: usize,
}

/// C = A B. C has `rows.count` rows of `b.columns()`, `stride` apart.
pub(super) fn multiply(a: Rows<'_>, b: &Packed, c: &mut [f32], stride: usize) {
    for start in (0..b.depth).step_by(DEPTH) {
        let depth = DEPTH.min(b.depth - start);
        let part = Rows { values: &a.values[start.min(a.values.len())..], ..a };
        for p in 0..b.panel_count() {
            let panel = &b.panel(p)[start * PANEL..][..depth * PANEL];
            let columns = PANEL.min(b.columns - p * PANEL);
            panel_product(part, panel, &mut c[p * PANEL..], stride, columns, start > 0);
        }
    }
}

/// Columns `0..columns` of C (+)= A times one panel.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
pub(super) fn panel_product(a: Rows, panel: &[f32], c: &mut [f32], stride: usize, columns: usize, add: bool) {
    // As many rows at a time as there are registers for their sums.
    if target_cfg_f!(target_feature = "avx512f") {
        tiles::<true, 12>(a, panel, c, stride, columns, add);
    } else if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        tiles::<true, 6>(a, panel, c, stride, columns, add);
    } else {
        tiles::<false, 2>(a, panel, c, stride, columns, add);
    }
}

#[inline(always)]
fn tiles<const FMA: bool, const ROWS: usize>(
    a: Rows<'_>,
    panel: &[f32],
    c: &mut [f32],
    stride: usize,
    columns: usize,
    add: bool,
) {
    let panel = panel.as_chunks::<PANEL>().0;
    for first in (0..a.count).step_by(ROWS) {
        // A tile that is not full computes its last row several times.
        let row = |i: usize| (first + i).min(a.count - 1);
        let rows: [&[f32]; ROWS] = std::array::from_fn(|i| &a.values[row(i) * a.stride..][..panel.len()]);
        let sums = tile::<FMA, ROWS>(rows, panel);
        for (i, sums) in sums.iter().enumerate().take(a.count - first) {
            let out = &mut c[(first + i) * stride..][..columns];
            if let Ok(out) = <&mut [f32; PANEL]>::try_from(&mut *out) {
                for j in 0..PANEL {
                    out[j] = if add { out[j] + sums[j] } else { sums[j] };
                }
            } else {
                for (out, sum) in out.iter_mut().zip(sums) {
                    *out = if add { *out + sum } else { *sum };
                }
            }
        }
    }
}

/// Sums of a tile. A's values are taken before any is used, so that nothing can fail between the sums and they stay in registers.
#[inline(always)]
fn tile<const FMA: bool, const ROWS: usize>(
    rows: [&[f32]; ROWS],
    panel: &[[f32; PANEL]],
) -> [[f32; PANEL]; ROWS] {
    let mut sums = [[0.0_f32; PANEL]; ROWS];
    for (k, b) in panel.iter().enumerate() {
        let a: [f32; ROWS] = std::array::from_fn(|i| rows[i][k]);
        for i in 0..ROWS {
            for j in 0..PANEL {
                sums[i][j] = mul_add::<FMA>(a[i], b[j], sums[i][j]);
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn products_agree_with_f64(
            count in 1_usize..30, depth in 1_usize..800, columns in 1_usize..50, gap in 0_usize..5, seed: u32,
        ) {
            let value = |i: usize| {
                let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
                ((mixed ^ (mixed >> 15)) >> 8) as f32 / 8_388_608.0 - 1.0
            };
            let a: Vec<f32> = (0..count * (depth + gap)).map(value).collect();
            let rows: Vec<f32> = (0..columns * depth).map(|i| value(i + 77_777)).collect();
            let b = Packed::transposed(depth, columns, &rows);
            let stride = columns + gap;
            let mut c = vec![f32::NAN; count * stride];
            multiply(Rows { values: &a, stride: depth + gap, count }, &b, &mut c, stride);
            for i in 0..count {
                for j in 0..columns {
                    let terms = (0..depth)
                        .map(|k| f64::from(a[i * (depth + gap) + k]) * f64::from(rows[j * depth + k]));
                    let (sum, size) = terms.fold((0.0, 0.0), |(s, n), t| (s + t, n + t.abs()));
                    let error = (f64::from(c[i * stride + j]) - sum).abs();
                    prop_assert!(error <= 1e-5 * size + 1e-30, "({i}, {j}): {error:e} of {size}");
                }
            }
            // What lies between the rows is left alone.
            prop_assert!((0..count).all(|i| (columns..stride).all(|j| c[i * stride + j].is_nan())));
        }
    }
}

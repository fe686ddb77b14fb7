//! Matrix products on slices: rows of A as they lie, B in packed panels.

use super::math::mul_add;
use multiversion::{multiversion, target::target_cfg_f};

/// Columns of a panel of B: one 512-bit or two 256-bit registers.
const PANEL: usize = 16;

/// B `[depth, columns]` in panels of 16 columns, each `[depth, 16]`; the last one is filled up with zeros.
#[derive(Debug, Clone, Default)]
pub(super) struct Packed {
    depth: usize,
    columns: usize,
    panels: Vec<[f32; PANEL]>,
}

impl Packed {
    /// B as it lies: `depth` rows.
    pub(super) fn rows(b: Rows<'_>) -> Self {
        let mut packed = Self::default();
        packed.fill(b);
        packed
    }

    /// B given as its transpose, `[columns, depth]`, as weights are.
    pub(super) fn transposed(b: Rows<'_>) -> Self {
        let (depth, columns) = (b.width, b.count);
        let mut panels = vec![[0.0; PANEL]; depth * columns.div_ceil(PANEL)];
        for column in 0..columns {
            let panel = &mut panels[column / PANEL * depth..][..depth];
            for (to, &from) in panel.iter_mut().zip(b.row(column)) {
                to[column % PANEL] = from;
            }
        }
        Self { depth, columns, panels }
    }

    /// Packs another B into the same memory.
    fn fill(&mut self, b: Rows<'_>) {
        (self.depth, self.columns) = (b.count, b.width);
        self.panels.clear();
        for first in (0..b.width).step_by(PANEL) {
            for k in 0..b.count {
                let row = &b.row(k)[first..];
                self.panels.push(match row.first_chunk() {
                    Some(row) => *row,
                    None => std::array::from_fn(|j| row.get(j).copied().unwrap_or(0.0)),
                });
            }
        }
    }

    fn panel(&self, p: usize) -> &[[f32; PANEL]] {
        &self.panels[p * self.depth..][..self.depth]
    }
}

/// Rows of a matrix: `count` rows of `width` values, each `stride` after the one before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a> {
    values: &'a [f32],
    count: usize,
    width: usize,
    stride: usize,
}

impl<'a> Rows<'a> {
    /// Rows without gaps.
    pub(super) fn new(values: &'a [f32], count: usize, width: usize) -> Self {
        assert_eq!(values.len(), count * width, "{count} rows of {width}");
        Self { values, count, width, stride: width }
    }

    /// `width` columns of these from `first` on.
    pub(super) fn columns(self, first: usize, width: usize) -> Self {
        assert!(first + width <= self.width, "columns {first}.. of {}", self.width);
        Self { values: &self.values[first.min(self.values.len())..], width, ..self }
    }

    /// The rows `range`.
    pub(super) fn slice(self, range: std::ops::Range<usize>) -> Self {
        assert!(range.end <= self.count, "rows {range:?} of {}", self.count);
        let values = &self.values[(range.start * self.stride).min(self.values.len())..];
        Self { values, count: range.len(), ..self }
    }

    /// How many.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Values in each.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// One row after the other.
    pub(super) fn iter(self) -> impl Iterator<Item = &'a [f32]> {
        (0..self.count).map(move |i| self.row(i))
    }

    #[inline(always)]
    fn row(&self, i: usize) -> &'a [f32] {
        &self.values[i * self.stride..][..self.width]
    }
}

/// C += A B, where C has as many rows as A, `stride` apart.
pub(super) fn multiply(a: Rows<'_>, b: &Packed, c: &mut [f32], stride: usize) {
    assert_eq!(a.width, b.depth, "columns of A and rows of B");
    for first in (0..b.columns).step_by(PANEL) {
        panel_product(a, b.panel(first / PANEL), &mut c[first..], stride, PANEL.min(b.columns - first));
    }
}

/// Memory of [`multiply_transposed`].
#[derive(Debug, Default)]
pub(super) struct Repacked {
    a: Vec<f32>,
    b: Packed,
}

/// C += Aᵀ B, where C has as many rows as A has columns, without gaps: a sum over rows.
pub(super) fn multiply_transposed(a: Rows<'_>, b: Rows<'_>, c: &mut [f32], scratch: &mut Repacked) {
    assert_eq!(a.count, b.count, "rows of A and B");
    scratch.b.fill(b);
    transposed_products(a, &scratch.b, c, &mut scratch.a);
}

/// Columns `0..columns` of C += A times one panel.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn panel_product(a: Rows, panel: &[[f32; PANEL]], c: &mut [f32], stride: usize, columns: usize) {
    // As many rows at a time as there are registers for their sums.
    if target_cfg_f!(target_feature = "avx512f") {
        panel_tiles::<true, 12>(a, panel, c, stride, columns);
    } else if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        panel_tiles::<true, 6>(a, panel, c, stride, columns);
    } else {
        panel_tiles::<false, 2>(a, panel, c, stride, columns);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn transposed_products(a: Rows, b: &Packed, c: &mut [f32], scratch: &mut Vec<f32>) {
    if target_cfg_f!(target_feature = "avx512f") {
        transposed_tiles::<true, 12>(a, b, c, scratch);
    } else if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        transposed_tiles::<true, 6>(a, b, c, scratch);
    } else {
        transposed_tiles::<false, 2>(a, b, c, scratch);
    }
}

#[inline(always)]
fn panel_tiles<const FMA: bool, const ROWS: usize>(
    a: Rows<'_>,
    panel: &[[f32; PANEL]],
    c: &mut [f32],
    stride: usize,
    columns: usize,
) {
    for first in (0..a.count).step_by(ROWS) {
        // A tile that is not full computes its last row several times.
        let rows: [&[f32]; ROWS] =
            std::array::from_fn(|i| &a.row((first + i).min(a.count - 1))[..panel.len()]);
        let c = &mut c[first * stride..];
        let count = ROWS.min(a.count - first);
        tile::<FMA, ROWS>(|k| std::array::from_fn(|i| rows[i][k]), panel, c, stride, count, columns);
    }
}

#[inline(always)]
fn transposed_tiles<const FMA: bool, const ROWS: usize>(
    a: Rows<'_>,
    b: &Packed,
    c: &mut [f32],
    packed: &mut Vec<f32>,
) {
    // A in strips of ROWS columns: what one tile reads lies together.
    packed.clear();
    for first in (0..a.width).step_by(ROWS) {
        for k in 0..a.count {
            let row = &a.row(k)[first..];
            match row.first_chunk::<ROWS>() {
                Some(row) => packed.extend_from_slice(row),
                None => packed.extend((0..ROWS).map(|i| row.get(i).copied().unwrap_or(0.0))),
            }
        }
    }
    let strips = packed.as_chunks::<ROWS>().0;
    for left in (0..b.columns).step_by(PANEL) {
        let (panel, columns) = (b.panel(left / PANEL), PANEL.min(b.columns - left));
        for first in (0..a.width).step_by(ROWS) {
            let strip = &strips[first / ROWS * a.count..][..panel.len()];
            let c = &mut c[first * b.columns + left..];
            tile::<FMA, ROWS>(|k| strip[k], panel, c, b.columns, ROWS.min(a.width - first), columns);
        }
    }
}

/// `rows` rows and `columns` columns of C += sum over k of A's column k times row k of the panel.
#[inline(always)]
fn tile<const FMA: bool, const ROWS: usize>(
    a: impl Fn(usize) -> [f32; ROWS],
    panel: &[[f32; PANEL]],
    c: &mut [f32],
    stride: usize,
    rows: usize,
    columns: usize,
) {
    let mut sums = [[0.0_f32; PANEL]; ROWS];
    for (k, b) in panel.iter().enumerate() {
        let a = a(k);
        for i in 0..ROWS {
            for j in 0..PANEL {
                sums[i][j] = mul_add::<FMA>(a[i], b[j], sums[i][j]);
            }
        }
    }
    for (i, sums) in sums.iter().enumerate().take(rows) {
        let out = &mut c[i * stride..][..columns];
        if let Some(out) = out.first_chunk_mut::<PANEL>() {
            for j in 0..PANEL {
                out[j] += sums[j];
            }
        } else {
            for (out, sum) in out.iter_mut().zip(sums) {
                *out += sum;
            }
        }
    }
}

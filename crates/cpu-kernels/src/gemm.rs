//! Matrix products on slices: rows of A as they lie, B in packed panels, no copy of A.

use crate::{dispatch, tile};
use cpu_isa::Isa;
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Rows of B per pass: a panel of them stays near the first-level cache. Each pass sums from zero, which keeps the rounding of
/// long sums small.
const DEPTH: usize = 384;

/// Columns of a panel of B: as many vectors as a tile has, so that its sums fill the registers.
#[must_use]
pub fn panel_columns(isa: Isa) -> usize {
    match isa {
        Isa::Scalar | Isa::Neon | Isa::Avx2 => 16,
        Isa::Avx512 => 32,
    }
}

/// Rows of a matrix: `count` rows of `width` values, each `stride` after the one before.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    values: &'a [f32],
    count: usize,
    width: usize,
    stride: usize,
}

impl<'a> Rows<'a> {
    /// Rows without gaps.
    ///
    /// # Panics
    /// If there are not `count * width` values.
    #[must_use]
    pub fn new(values: &'a [f32], count: usize, width: usize) -> Self {
        assert_eq!(values.len(), count * width, "{count} rows of {width}");
        Self { values, count, width, stride: width }
    }

    /// Rows that begin `stride` values apart; the last one may be followed by nothing.
    ///
    /// # Panics
    /// If the rows overlap, or `values` ends before they do.
    #[must_use]
    pub fn strided(values: &'a [f32], count: usize, width: usize, stride: usize) -> Self {
        assert!(width <= stride || count <= 1, "rows of {width} that begin {stride} apart");
        Self::overlapping(values, count, width, stride)
    }

    /// Rows that begin `stride` values apart and may overlap, as the windows along a line of pixels do.
    ///
    /// # Panics
    /// If `values` ends before they do.
    #[must_use]
    pub fn overlapping(values: &'a [f32], count: usize, width: usize, stride: usize) -> Self {
        let needed = count.checked_sub(1).map_or(0, |before| before * stride + width);
        assert!(needed <= values.len(), "{count} rows of {width}, {stride} apart, in {}", values.len());
        Self { values, count, width, stride }
    }

    /// `width` columns of these from `first` on.
    ///
    /// # Panics
    /// If there are not so many.
    #[must_use]
    pub fn columns(self, first: usize, width: usize) -> Self {
        assert!(first + width <= self.width, "columns {first}.. of {}", self.width);
        Self { values: &self.values[first.min(self.values.len())..], width, ..self }
    }

    /// The rows `range`.
    ///
    /// # Panics
    /// If there are not so many.
    #[must_use]
    pub fn slice(self, range: Range<usize>) -> Self {
        assert!(range.end <= self.count, "rows {range:?} of {}", self.count);
        let values = &self.values[(range.start * self.stride).min(self.values.len())..];
        Self { values, count: range.len(), ..self }
    }

    /// How many.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Values in each.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// One row after the other.
    pub fn iter(self) -> impl Iterator<Item = &'a [f32]> {
        (0..self.count).map(move |i| self.row(i))
    }

    /// Row `i`.
    ///
    /// # Panics
    /// If there is none.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, i: usize) -> &'a [f32] {
        &self.values[i * self.stride..][..self.width]
    }
}

/// B `[depth, columns]` in panels for one instruction set, each `[depth, panel_columns]`; the last one is filled up with zeros.
#[derive(Debug, Clone)]
pub struct Packed {
    isa: Isa,
    depth: usize,
    columns: usize,
    panels: Vec<f32>,
}

impl Packed {
    /// Packs B given by value(row, column).
    pub fn new(isa: Isa, depth: usize, columns: usize, value: impl Fn(usize, usize) -> f32) -> Self {
        let width = panel_columns(isa);
        let mut panels = vec![0.0; depth * columns.next_multiple_of(width)];
        for (p, panel) in panels.chunks_exact_mut((depth * width).max(1)).enumerate() {
            let first = p * width;
            for (k, row) in panel.chunks_exact_mut(width).enumerate() {
                for (j, v) in row.iter_mut().enumerate().take(columns - first) {
                    *v = value(k, first + j);
                }
            }
        }
        Self { isa, depth, columns, panels }
    }

    /// B as it lies, `[depth, columns]`.
    #[must_use]
    pub fn rows(isa: Isa, b: Rows<'_>) -> Self {
        let width = panel_columns(isa);
        let mut panels = Vec::with_capacity(b.count * b.width.next_multiple_of(width));
        for first in (0..b.width).step_by(width) {
            let live = width.min(b.width - first);
            for row in b.iter() {
                panels.extend_from_slice(&row[first..first + live]);
                panels.resize(panels.len() + width - live, 0.0);
            }
        }
        Self { isa, depth: b.count, columns: b.width, panels }
    }

    /// B that is stored transposed, `[columns, depth]`, as weights are.
    #[must_use]
    pub fn transposed(isa: Isa, b: Rows<'_>) -> Self {
        Self::new(isa, b.width, b.count, |k, column| b.row(column)[k])
    }

    /// The instruction set that it is packed for, on which products with it run.
    #[must_use]
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// Rows of B.
    #[must_use]
    pub fn depth(&self) -> usize {
        self.depth
    }

    /// Columns of B.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of panels.
    #[must_use]
    pub fn panel_count(&self) -> usize {
        self.columns.div_ceil(panel_columns(self.isa))
    }

    /// Columns `first..` of C = A times panel `p` of B, all its columns, those that B lacks as zeros. C has as many rows as A,
    /// `stride` apart.
    ///
    /// # Panics
    /// If A's rows are not as long as B's columns, there is no such panel, or C is too small.
    pub fn multiply_panel(&self, p: usize, a: Rows<'_>, c: &mut [f32], stride: usize) {
        assert_eq!(a.width, self.depth, "columns of A and rows of B");
        assert!(p < self.panel_count(), "panel {p} of {}", self.panel_count());
        let width = panel_columns(self.isa);
        let panel = &self.panels[p * self.depth * width..][..self.depth * width];
        if self.depth == 0 {
            (0..a.count).for_each(|i| c[i * stride..][..width].fill(0.0));
        }
        for start in (0..self.depth).step_by(DEPTH) {
            let depth = DEPTH.min(self.depth - start);
            let into = Into { c: &mut *c, stride, columns: width, add: start > 0 };
            dispatch(
                self.isa,
                Panel {
                    a: a.columns(start, depth),
                    panel: &panel[start * width..][..depth * width],
                    width,
                    bias: &[],
                    into,
                },
            );
        }
    }
}

/// C = A B, or C += A B. C has as many rows as A, `stride` apart; what lies between its rows is left alone.
///
/// # Panics
/// If A's rows are not as long as B's columns, or C is too small.
pub fn multiply(a: Rows<'_>, b: &Packed, c: &mut [f32], stride: usize, add: bool) {
    product(a, b, &[], c, stride, add);
}

/// As [`multiply`], with `bias` added to every row.
///
/// # Panics
/// As [`multiply`], or if the bias has not a number for each column of B.
pub fn multiply_with_bias(a: Rows<'_>, b: &Packed, bias: &[f32], c: &mut [f32], stride: usize, add: bool) {
    assert_eq!(bias.len(), b.columns, "a bias for every column");
    product(a, b, bias, c, stride, add);
}

/// Without a bias it is empty.
fn product(a: Rows<'_>, b: &Packed, bias: &[f32], c: &mut [f32], stride: usize, add: bool) {
    assert_eq!(a.width, b.depth, "columns of A and rows of B");
    if a.count == 0 || b.columns == 0 {
        return;
    }
    assert!(b.columns <= stride || a.count == 1, "rows of {} that begin {stride} apart", b.columns);
    assert!(
        (a.count - 1) * stride + b.columns <= c.len(),
        "{} rows, {stride} apart, in {}",
        a.count,
        c.len()
    );
    if b.depth == 0 && !add {
        (0..a.count).for_each(|i| c[i * stride..][..b.columns].fill(0.0));
    }
    if b.depth == 0 && !bias.is_empty() {
        for i in 0..a.count {
            c[i * stride..][..b.columns].iter_mut().zip(bias).for_each(|(c, bias)| *c += bias);
        }
    }
    dispatch(b.isa, Product { a, b, bias, c, stride, add });
}

/// C += Aᵀ B, a sum over the rows of both. C has as many rows as A has columns, `stride` apart; what lies between its
/// rows is left alone.
///
/// # Panics
/// If A and B differ in their number of rows, or C is too small.
pub fn multiply_transposed(isa: Isa, a: Rows<'_>, b: Rows<'_>, c: &mut [f32], stride: usize) {
    assert_eq!(a.count, b.count, "rows of A and B");
    if a.width == 0 || b.width == 0 {
        return;
    }
    assert!(b.width <= stride || a.width == 1, "rows of {} that begin {stride} apart", b.width);
    assert!((a.width - 1) * stride + b.width <= c.len(), "{} rows, {stride} apart, in {}", a.width, c.len());
    dispatch(isa, TransposedProduct { a, b, c, stride });
}

/// Where a tile's sums go.
struct Into<'a> {
    c: &'a mut [f32],
    stride: usize,
    columns: usize,
    add: bool,
}

struct Product<'a> {
    a: Rows<'a>,
    b: &'a Packed,
    bias: &'a [f32],
    c: &'a mut [f32],
    stride: usize,
    add: bool,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, b, bias, c, stride, add } = self;
        let width = panel_columns(b.isa);
        for start in (0..b.depth).step_by(DEPTH) {
            let depth = DEPTH.min(b.depth - start);
            let a = a.columns(start, depth);
            for first in (0..b.columns).step_by(width) {
                let panel = &b.panels[first * b.depth + start * width..][..depth * width];
                let columns = width.min(b.columns - first);
                let into = Into { c: &mut c[first..], stride, columns, add: add || start > 0 };
                // Once, with the first rows of B.
                let bias = if start > 0 { &[] } else { bias.get(first..first + columns).unwrap_or_default() };
                Panel { a, panel, width, bias, into }.with_simd(simd);
            }
        }
    }
}

/// Some columns of C (+)= A times one panel.
struct Panel<'a> {
    a: Rows<'a>,
    /// Rows of `width` numbers.
    panel: &'a [f32],
    width: usize,
    /// Of its columns; none if it is shorter.
    bias: &'a [f32],
    into: Into<'a>,
}

impl WithSimd for Panel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Vectors and rows of a tile: enough sums to hide the latency of their additions, and no more than stay in registers,
        // with the pointers to the rows.
        // Of the last panel there may be no more columns than one vector has.
        let is_narrow = self.into.columns <= S::F32_LANES;
        match S::F32_LANES {
            1 => self.tiles::<S, 16, 2>(simd),
            4 => self.tiles::<S, 4, 6>(simd),
            8 | 16 if is_narrow => self.tiles::<S, 1, 8>(simd),
            8 => self.tiles::<S, 2, 6>(simd),
            _ => self.tiles::<S, 2, 8>(simd),
        }
    }
}

impl Panel<'_> {
    #[inline(always)]
    fn tiles<S: Simd, const VECTORS: usize, const ROWS: usize>(self, simd: S) {
        let Self { a, panel, width, bias, mut into } = self;
        let mut start = [simd.splat_f32s(0.0); VECTORS];
        for (start, bias) in start.iter_mut().zip(bias.chunks(S::F32_LANES)) {
            *start = simd.partial_load_f32s(bias);
        }
        for first in (0..a.count).step_by(ROWS) {
            let count = ROWS.min(a.count - first);
            let rows = (&a.values[first * a.stride..], a.stride, count);
            let sums = tile::of_rows::<S, VECTORS, ROWS>(simd, rows, (panel, width), start);
            into.store(simd, first, count, &sums);
        }
    }
}

struct TransposedProduct<'a> {
    a: Rows<'a>,
    b: Rows<'a>,
    c: &'a mut [f32],
    stride: usize,
}

impl WithSimd for TransposedProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            1 => self.tiles::<S, 16, 2>(simd),
            4 => self.tiles::<S, 4, 6>(simd),
            8 => self.tiles::<S, 2, 6>(simd),
            _ => self.tiles::<S, 2, 8>(simd),
        }
    }
}

impl TransposedProduct<'_> {
    #[inline(always)]
    fn tiles<S: Simd, const VECTORS: usize, const ROWS: usize>(self, simd: S) {
        let Self { a, b, c, stride } = self;
        let columns = VECTORS * S::F32_LANES;
        // What is left of B's columns after the last whole tile, and of A's: filled up with zeros.
        let edge_b = edge(b, columns);
        let edge_a = edge(a, ROWS);
        for first in (0..a.width).step_by(ROWS) {
            let count = ROWS.min(a.width - first);
            let a = if count == ROWS { a.columns(first, ROWS) } else { Rows::new(&edge_a, a.count, ROWS) };
            for left in (0..b.width).step_by(columns) {
                let live = columns.min(b.width - left);
                let part = if live == columns {
                    b.columns(left, columns)
                } else {
                    Rows::new(&edge_b, b.count, columns)
                };
                let sums = tile::of_columns::<S, VECTORS, ROWS>(
                    simd,
                    (a.values, a.stride),
                    (part.values, part.stride),
                    a.count,
                );
                let mut into = Into { c: &mut c[left..], stride, columns: live, add: true };
                into.store(simd, first, count, &sums);
            }
        }
    }
}

/// The columns that are left over after whole groups of `group`, filled up to one with zeros.
#[inline(always)]
fn edge(rows: Rows<'_>, group: usize) -> Vec<f32> {
    let live = rows.width % group;
    let mut out = Vec::new();
    if live > 0 {
        for row in rows.iter() {
            out.extend_from_slice(&row[rows.width - live..]);
            out.resize(out.len() + group - live, 0.0);
        }
    }
    out
}

impl Into<'_> {
    /// Stores the first `count` rows of a tile from row `first` on.
    #[inline(always)]
    fn store<S: Simd, const VECTORS: usize, const ROWS: usize>(
        &mut self,
        simd: S,
        first: usize,
        count: usize,
        sums: &[[S::f32s; VECTORS]; ROWS],
    ) {
        let c = &mut self.c[first * self.stride..];
        let columns = VECTORS * S::F32_LANES;
        if count == ROWS && self.columns == columns {
            // Of a whole tile the sums go from the registers to their places.
            for (i, sums) in sums.iter().enumerate() {
                put(simd, &mut c[i * self.stride..][..columns], sums, self.add);
            }
        } else {
            for (i, sums) in sums.iter().enumerate().take(count) {
                put(simd, &mut c[i * self.stride..][..self.columns], sums, self.add);
            }
        }
    }
}

/// Stores sums in a row, or adds them to it.
#[inline(always)]
fn put<S: Simd, const VECTORS: usize>(simd: S, row: &mut [f32], sums: &[S::f32s; VECTORS], add: bool) {
    if let Some(row) = S::as_mut_simd_f32s(row).0.first_chunk_mut::<VECTORS>() {
        for (out, sum) in row.iter_mut().zip(sums) {
            *out = if add { simd.add_f32s(*out, *sum) } else { *sum };
        }
    } else {
        for (row, sum) in row.chunks_mut(S::F32_LANES).zip(sums) {
            let before = if add { simd.partial_load_f32s(row) } else { simd.splat_f32s(0.0) };
            simd.partial_store_f32s(row, simd.add_f32s(before, *sum));
        }
    }
}

//! Means over the cells of a fine and a coarse grid: a layer shortens h_j to 32 numbers for each grid, an anchor sees the means of both
//! over the cells that it lies in, and a layer of these means is its message.
//!
//! To replace the rows of a cell by their mean is its own transpose, so the gradient goes through the same function.

use super::linear::Linear;
use super::maximum::Maxima;
use super::message::{Anchors, Kept, Message, resize};
use super::network::BLOCK;
use super::range_rows;
use super::sums::Sums;
use crate::{CELL_WIDTH, Inputs, Layout, WIDTH};
use cpu_kernels::{Isa, Rows, rows};
use rayon::prelude::*;

/// Numbers that an anchor shows, of the fine cell first.
const SHOWN: usize = 2 * CELL_WIDTH;

/// Parameters of the grid in a layer.
#[derive(Debug)]
pub(super) struct Grid<'a> {
    cell: Linear<'a>,
    join: Linear<'a>,
}

/// Gradients of the means that a block has seen, `[rows, SHOWN]`; after [`Message::return_sent`] those of what it shows.
#[derive(Debug, Default)]
pub(super) struct Sent(Vec<f32>);

impl<'a> Message<'a> for Grid<'a> {
    const SHOWN: usize = SHOWN;
    const LOOKS: bool = false;
    const READS_OWN: bool = false;
    const KEEPS_HIDDEN: bool = true;
    type Work = ();
    type Sent = Sent;

    fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        Self {
            cell: Linear::new(isa, layout, values, &format!("{name}.cell")),
            join: Linear::new(isa, layout, values, &format!("{name}.join")),
        }
    }

    fn show(&self, h: Rows<'_>, shown: &mut [f32]) {
        self.cell.apply(h, shown, SHOWN);
    }

    fn share(inputs: &Inputs<'_>, shown: &mut [f32]) {
        to_means(inputs.cells, shown);
    }

    fn add(&self, anchors: Anchors<'_>, y: &mut [f32], _: Option<&mut Maxima>, (): &mut ()) {
        self.join.add(means(anchors), y);
    }

    fn backward(
        &self,
        anchors: Anchors<'_>,
        _: &Maxima,
        grad: &[f32],
        _: &mut [f32],
        sent: &mut Sent,
        sums: &mut Sums<'_>,
        (): &mut (),
    ) {
        let grad = Rows::new(grad, anchors.count, WIDTH);
        self.join.weight_gradient(means(anchors), grad, sums);
        resize(&mut sent.0, anchors.count * SHOWN);
        self.join.input_gradient_alone(grad, &mut sent.0);
    }

    fn return_sent(inputs: &Inputs<'_>, sent: &mut [Sent]) {
        let mut all = Vec::with_capacity(inputs.n * SHOWN);
        sent.iter().for_each(|Sent(grad)| all.extend_from_slice(grad));
        to_means(inputs.cells, &mut all);
        for (Sent(grad), all) in sent.iter_mut().zip(all.chunks(BLOCK * SHOWN)) {
            grad.copy_from_slice(all);
        }
    }

    fn shown_backward(
        &self,
        anchors: Anchors<'_>,
        kept: Kept<'_, Sent>,
        grad_h: &mut [f32],
        sums: &mut Sums<'_>,
        (): &mut (),
    ) {
        let Sent(grad) = kept.sent_by(anchors.first);
        let grad = Rows::new(grad, anchors.count, SHOWN);
        self.cell.weight_gradient(anchors.h(), grad, sums);
        self.cell.input_gradient(grad, grad_h);
    }
}

/// The means that a block sees.
fn means(anchors: Anchors<'_>) -> Rows<'_> {
    let shown = &anchors.all.shown[anchors.first * SHOWN..][..anchors.count * SHOWN];
    Rows::new(shown, anchors.count, SHOWN)
}

/// Replaces rows `[n, SHOWN]` by their means over each anchor's fine and coarse cell. Anchors are summed in their order.
fn to_means(cells: &[[u32; 2]], rows: &mut [f32]) {
    let isa = Isa::in_use();
    let of_level = |level: usize| {
        let mut sums = vec![0.0; cells.len() * CELL_WIDTH];
        let mut counts = vec![0_u32; cells.len()];
        for (row, cells) in rows.chunks_exact(SHOWN).zip(cells) {
            let cell = cells[level] as usize;
            counts[cell] += 1;
            rows::add(
                isa,
                &mut sums[cell * CELL_WIDTH..][..CELL_WIDTH],
                &row[level * CELL_WIDTH..][..CELL_WIDTH],
            );
        }
        for (sums, count) in sums.chunks_exact_mut(CELL_WIDTH).zip(counts).filter(|(_, count)| *count > 1) {
            sums.iter_mut().for_each(|sum| *sum /= count as f32);
        }
        sums
    };
    let (fine, coarse) = rayon::join(|| of_level(0), || of_level(1));
    let some = range_rows(cells.len());
    rows.par_chunks_mut(some * SHOWN).zip(cells.par_chunks(some)).for_each(|(rows, cells)| {
        for (row, cells) in rows.chunks_exact_mut(SHOWN).zip(cells) {
            let (of_fine, of_coarse) = row.split_at_mut(CELL_WIDTH);
            of_fine.copy_from_slice(&fine[cells[0] as usize * CELL_WIDTH..][..CELL_WIDTH]);
            of_coarse.copy_from_slice(&coarse[cells[1] as usize * CELL_WIDTH..][..CELL_WIDTH]);
        }
    });
}

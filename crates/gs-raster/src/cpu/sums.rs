//! Where the backward pass adds the gradients of Gaussians.

use super::footprint::BLOCK;
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION};

/// Gradients by the numbers of the Gaussians' [`Source`](super::Source), summed over views, in its layout. Those by colours are by SH
/// coefficients in any case.
#[derive(Debug)]
pub(crate) enum Sums<'a> {
    /// `[N, 11]` and `[N, (degree+1)², 3]`.
    Stored { geometry: &'a mut [f32], sh: &'a mut [f32] },
    /// One array per parameter. Colours are in the first of the `color_row` numbers of each Gaussian.
    Activated {
        means: &'a mut [f32],
        quats: &'a mut [f32],
        scales: &'a mut [f32],
        opacities: &'a mut [f32],
        colors: &'a mut [f32],
        color_row: usize,
    },
}

impl Sums<'_> {
    /// The sums of every `size` Gaussians; `sh_row` is the length of a row of stored SH coefficients.
    pub(super) fn chunks(&mut self, size: usize, sh_row: usize) -> Vec<Sums<'_>> {
        match self {
            Self::Stored { geometry, sh } => {
                let chunks =
                    geometry.chunks_mut(size * Gaussians::GEOMETRY).zip(sh.chunks_mut(size * sh_row));
                chunks.map(|(geometry, sh)| Sums::Stored { geometry, sh }).collect()
            }
            Self::Activated { means, quats, scales, opacities, colors, color_row } => {
                let color_row = *color_row;
                let shapes = means.chunks_mut(size * 3).zip(quats.chunks_mut(size * 4));
                let shapes = shapes.zip(scales.chunks_mut(size * 3));
                let looks = opacities.chunks_mut(size).zip(colors.chunks_mut(size * color_row));
                let chunks = shapes.zip(looks).map(|(((means, quats), scales), (opacities, colors))| {
                    Sums::Activated { means, quats, scales, opacities, colors, color_row }
                });
                chunks.collect()
            }
        }
    }

    /// Adds what stands at `place` of the columns of geometry to the sums of a Gaussian.
    #[inline(always)]
    pub(super) fn add_geometry(
        &mut self,
        gaussian: usize,
        columns: &[[f32; BLOCK]; Gaussians::GEOMETRY],
        place: usize,
    ) {
        match self {
            Self::Stored { geometry, .. } => {
                let row = &mut geometry[gaussian * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
                add_columns(row, columns, place);
            }
            Self::Activated { means, quats, scales, opacities, .. } => {
                add_columns(&mut means[3 * gaussian..][..3], &columns[MEAN], place);
                add_columns(&mut quats[4 * gaussian..][..4], &columns[QUATERNION], place);
                add_columns(&mut scales[3 * gaussian..][..3], &columns[LOG_SCALE], place);
                add(&mut opacities[gaussian], columns[OPACITY_LOGIT][place]);
            }
        }
    }

    /// The sums of a Gaussian by its SH coefficients, of which there are `sh_row` numbers.
    #[inline(always)]
    pub(super) fn sh(&mut self, gaussian: usize, sh_row: usize) -> &mut [f32] {
        match self {
            Self::Stored { sh, .. } => &mut sh[gaussian * sh_row..][..sh_row],
            Self::Activated { colors, color_row, .. } => &mut colors[gaussian * *color_row..][..sh_row],
        }
    }
}

#[inline(always)]
fn add_columns(row: &mut [f32], columns: &[[f32; BLOCK]], place: usize) {
    for (sum, column) in row.iter_mut().zip(columns) {
        add(sum, column[place]);
    }
}

/// Adds a gradient to those of other views, at most to the largest number there is.
#[inline(always)]
pub(super) fn add(sum: &mut f32, gradient: f32) {
    *sum = (*sum + gradient).clamp(f32::MIN, f32::MAX);
}

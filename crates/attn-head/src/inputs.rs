use crate::{Config, Error, Kind, Result};
use rayon::prelude::*;

/// What a head sees of `n` anchors with `k` neighbours each.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// Number of anchors.
    pub n: usize,
    /// Neighbours per anchor, without the anchor itself.
    pub k: usize,
    /// Geometric features g, `[n, config.geometry]`.
    pub geometry: &'a [f32],
    /// Image features v, `[n, config.image]`.
    pub image: &'a [f32],
    /// Index of each neighbour, `[n, k]`, the nearest first.
    pub neighbours: &'a [u32],
    /// Where each neighbour lies as seen from its anchor, p_j - p_i, `[n, k, 3]`; in whatever frame and unit the
    /// head is trained with. That of the anchor itself, 0, is not stored.
    pub relative: &'a [[f32; 3]],
    /// The fine and the coarse cell of a grid that each anchor lies in, `[n, 2]`; a cell is named by any anchor, the same for all that lie
    /// in it. Only [`Kind::Grid`] looks at them: others take none as well.
    pub cells: &'a [[u32; 2]],
}

impl Inputs<'_> {
    /// Lengths agree with each other and with `config`, neighbours exist, and all is finite.
    ///
    /// # Errors
    /// Naming what does not fit, and where.
    pub fn check(&self, config: &Config) -> Result<()> {
        config.check()?;
        let &Self { n, k, .. } = self;
        config.check_neighbours(k)?;
        // No slice is so long that a product which saturates could be its length.
        let lengths = [
            ("geometry", n.saturating_mul(config.geometry), self.geometry.len()),
            ("image", n.saturating_mul(config.image), self.image.len()),
            ("neighbours", n.saturating_mul(k), self.neighbours.len()),
            ("relative", n.saturating_mul(k), self.relative.len()),
        ];
        for (what, expected, found) in lengths {
            if expected != found {
                return Err(Error::Length { what, expected, found });
            }
        }
        check_neighbours(self.neighbours, n, k)?;
        check_cells(config, self.cells, n)?;
        let values = [
            ("geometry", self.geometry, config.geometry),
            ("image", self.image, config.image),
            ("relative", self.relative.as_flattened(), 3 * k),
        ];
        for (what, values, per_anchor) in values {
            if let Some(index) = first_not_finite(values) {
                return Err(Error::InputNotFinite { what, anchor: index / per_anchor });
            }
        }
        Ok(())
    }
}

/// The first number that is NaN or infinite.
fn first_not_finite(values: &[f32]) -> Option<usize> {
    const CHUNK: usize = 1 << 14;
    // Without an early end, so that a chunk is read in vectors.
    let is_finite = |chunk: &[f32]| chunk.iter().fold(true, |all, value| all & value.is_finite());
    let chunk = values.par_chunks(CHUNK).position_first(|chunk| !is_finite(chunk))?;
    let first = chunk * CHUNK;
    values[first..].iter().position(|value| !value.is_finite()).map(|index| first + index)
}

/// That every anchor has its cells, if the head looks at them, and that they are named by anchors.
pub(crate) fn check_cells(config: &Config, cells: &[[u32; 2]], n: usize) -> Result<()> {
    if cells.len() != n && (config.kind == Kind::Grid || !cells.is_empty()) {
        return Err(Error::Length { what: "cells", expected: n, found: cells.len() });
    }
    match cells.iter().flatten().position(|&cell| cell as usize >= n) {
        Some(index) => Err(Error::Cell { anchor: index / 2, found: cells[index / 2][index % 2], n }),
        None => Ok(()),
    }
}

/// That all of `[n, k]` neighbours exist.
pub(crate) fn check_neighbours(neighbours: &[u32], n: usize, k: usize) -> Result<()> {
    match neighbours.iter().position(|&j| j as usize >= n) {
        Some(index) => Err(Error::Neighbour { anchor: index / k, found: neighbours[index], n }),
        None => Ok(()),
    }
}

//! The cells of the two grids whose means a grid head sees.
//!
//! A cell is a cube. Its edge follows the local spacing of anchors, so that a cell holds about as many of them wherever it is: [`FINE`] squared
//! and [`COARSE`] squared on a surface. Edges are powers of two, and anchors whose edges differ share no cell. Turning or scaling the
//! scene, or another first anchor, changes which anchors share a cell, but not how many do on average.

use crate::anchored::Anchored;
use glam::DVec3;
use rayon::prelude::*;

/// Edge of a fine cell in widths of the surface per anchor, before it is rounded to a power of two.
const FINE: f64 = 4.0;
/// The same of a coarse cell.
const COARSE: f64 = 16.0;
/// Where in its cell the first anchor lies, in edges along every axis. No round number: surfaces that lie along the axes, at round
/// distances from that anchor, would fall on boundaries of cells, and rounding would decide on which side.
const FIRST: f64 = 0.382;

/// The fine and the coarse cell of each anchor, named by the first anchor in it.
pub(super) fn cells(anchored: &Anchored) -> Vec<[u32; 2]> {
    let n = anchored.anchors.len();
    let width = |i: usize| {
        let spacing = f64::from(anchored.spacing[i]);
        // Of duplicates the area is 0.
        let area = anchored.area_per_anchor(i).filter(|&area| area > 0.0);
        area.map_or(spacing, f64::sqrt)
    };
    let widths: Vec<f64> = (0..n).into_par_iter().map(width).collect();
    let [fine, coarse] = [FINE, COARSE].map(|edge| of_edge(&anchored.anchors.positions, &widths, edge));
    fine.into_iter().zip(coarse).map(<[u32; 2]>::from).collect()
}

/// The cells whose edges are about `edge` times the widths.
fn of_edge(positions: &[[f64; 3]], widths: &[f64], edge: f64) -> Vec<u32> {
    let Some(&origin) = positions.first() else { return Vec::new() };
    let key = |(i, (&position, &width)): (usize, (&[f64; 3], &f64))| {
        let level = (edge * width).max(f64::MIN_POSITIVE).log2().round();
        // Beyond the range of an integer there is one cell.
        let place = (DVec3::from(position) - DVec3::from(origin)) / level.exp2() + FIRST;
        ((level as i64, place.floor().to_array().map(|place| place as i64)), i as u32)
    };
    let mut keyed: Vec<_> =
        positions.par_iter().zip(widths.par_iter()).enumerate().map(|(i, pair)| key((i, pair))).collect();
    keyed.par_sort_unstable();
    let mut cells = vec![0; positions.len()];
    for cell in keyed.chunk_by(|(a, _), (b, _)| a == b) {
        let (_, first) = cell[0];
        cell.iter().for_each(|&(_, anchor)| cells[anchor as usize] = first);
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn near_anchors_of_like_spacing_share_a_cell() {
        let positions =
            [[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [0.9, 0.1, 0.7], [0.6, 0.5, 0.5], [-0.1, 0.5, 0.5]]
                .map(|[x, y, z]| [x + 1e4 - 0.5, y - 0.5, z - 0.5]);
        // Edges of 1, but for the fourth, which has one of 2. The first anchor's cell begins at -0.382.
        let widths = [0.25, 0.26, 0.24, 0.5, 0.25];
        assert_eq!(of_edge(&positions, &widths, FINE), [0, 1, 2, 3, 4]);
        assert_eq!(of_edge(&positions, &widths.map(|w| 4.0 * w), FINE), [0, 0, 0, 3, 0]);
    }

    #[test]
    fn extreme_widths_and_no_anchors_have_cells() {
        assert!(of_edge(&[], &[], FINE).is_empty());
        for width in [0.0, f64::MIN_POSITIVE, 1e-300, 1e300] {
            let cells = of_edge(&[[0.0; 3], [1e8; 3], [-1e8; 3], [0.0; 3]], &[width; 4], COARSE);
            assert_eq!(cells[3], 0, "{width:e}: {cells:?}");
        }
    }

    proptest! {
        /// Against a comparison of all pairs.
        #[test]
        fn a_cell_is_named_by_its_first_anchor(
            points in prop::collection::vec((-2.0..2.0_f64, -2.0..2.0_f64, 0.05..0.6_f64), 1..40),
        ) {
            let positions: Vec<_> = points.iter().map(|&(x, y, _)| [x, y, 0.0]).collect();
            let widths: Vec<_> = points.iter().map(|p| p.2).collect();
            let found = of_edge(&positions, &widths, FINE);
            let edge = |i: usize| (FINE * widths[i]).log2().round().exp2();
            let corner = |i: usize, axis: usize| {
                ((positions[i][axis] - positions[0][axis]) / edge(i) + FIRST).floor()
            };
            let same = |i: usize, j: usize| {
                edge(i).to_bits() == edge(j).to_bits()
                    && (0..3).all(|axis| (corner(i, axis) - corner(j, axis)).abs() < 0.5)
            };
            for (i, &cell) in found.iter().enumerate() {
                prop_assert_eq!(Some(cell as usize), (0..=i).find(|&j| same(i, j)));
            }
        }
    }
}

//! The anchors of every view, by square cells of its picture.

use crate::Anchors;
use gs_scene::Camera;
use std::ops::Range;

/// Anchors of a cell, on average. With fewer a search visits more cells, with more it computes more distances.
const PER_CELL: usize = 1;

/// Pixels. Above the rounding of places in the largest picture.
const MARGIN: f64 = 1e-3;

/// What a search needs of an anchor.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Entry {
    /// Column of its pixel; pictures have at most 2³¹ pixels, and i32 becomes f64 in one instruction.
    pub(crate) x: i32,
    /// Row of its pixel.
    pub(crate) y: i32,
    /// z-depth in its view.
    pub(crate) depth: f32,
    pub(crate) index: u32,
}

/// The cells of one view, row after row, in the arrays of [`Grids`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grid {
    /// Side of a cell, pixels.
    side: usize,
    /// Cells per pixel.
    per_pixel: f64,
    /// Cells per row; 0 for a view without anchors.
    columns: usize,
    rows: usize,
    /// The first cell.
    first: usize,
}

/// Cells of a view.
pub(crate) struct Window {
    pub(crate) columns: Range<usize>,
    pub(crate) rows: Range<usize>,
}

/// The cells of all views, and their anchors.
pub(crate) struct Grids {
    /// One per view.
    pub(crate) of: Vec<Grid>,
    /// Where the entries of each cell start, and where the last cell's end.
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

impl Grid {
    /// For `count` anchors in a picture of this size.
    fn new(width: usize, height: usize, count: usize, first: usize) -> Self {
        if count == 0 {
            return Self { side: 1, per_pixel: 1.0, columns: 0, rows: 0, first };
        }
        let area = (PER_CELL * width * height) as f64 / count as f64;
        let mut side = (area.sqrt().round() as usize).max(1);
        let cells = |side| width.div_ceil(side).saturating_mul(height.div_ceil(side));
        // A picture of one row has more cells than its area says.
        while cells(side) > 2 * count {
            side *= 2;
        }
        let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
        Self { side, per_pixel: 1.0 / side as f64, columns, rows, first }
    }

    /// Whether there are no anchors.
    pub(crate) fn is_empty(&self) -> bool {
        self.columns == 0
    }

    fn cell(&self, x: usize, y: usize) -> usize {
        self.first + y / self.side * self.columns + x / self.side
    }
}

impl Window {
    /// Whether it holds all cells of the view.
    pub(crate) fn is_all(&self, grid: &Grid) -> bool {
        (self.columns.len(), self.rows.len()) == (grid.columns, grid.rows)
    }
}

impl Grids {
    pub(crate) fn new(anchors: &Anchors, cameras: &[Camera]) -> Self {
        let mut counts = vec![0; cameras.len()];
        anchors.views.iter().for_each(|&view| counts[view as usize] += 1);
        let (mut of, mut cells) = (Vec::with_capacity(cameras.len()), 0);
        for (camera, &count) in cameras.iter().zip(&counts) {
            let grid = Grid::new(camera.width(), camera.height(), count, cells);
            cells += grid.columns * grid.rows;
            of.push(grid);
        }

        // Counting sort by cell.
        let mut starts = vec![0u32; cells + 1];
        let widths: Vec<u32> = cameras.iter().map(|camera| camera.width() as u32).collect();
        let places: Vec<(u32, i32, i32)> = anchors
            .views
            .iter()
            .zip(anchors.pixels)
            .map(|(&view, &pixel)| {
                let (x, y) = (pixel % widths[view as usize], pixel / widths[view as usize]);
                let cell = of[view as usize].cell(x as usize, y as usize);
                starts[cell + 1] += 1;
                (cell as u32, x as i32, y as i32)
            })
            .collect();
        for cell in 0..cells {
            starts[cell + 1] += starts[cell];
        }
        let mut next = starts.clone();
        let mut entries = vec![Entry::default(); places.len()];
        for (index, (&(cell, x, y), &depth)) in places.iter().zip(anchors.depths).enumerate() {
            let slot = &mut next[cell as usize];
            entries[*slot as usize] = Entry { x, y, depth, index: index as u32 };
            *slot += 1;
        }
        Self { of, starts, entries }
    }

    /// The cells in which all pixels lie whose centres are within `reach` pixels of a place in the picture, by columns and
    /// rows. Not empty.
    #[inline(always)]
    pub(crate) fn window(grid: &Grid, [x, y]: [f64; 2], reach: f64) -> Window {
        // Casts round down and take what is negative to 0. The margin is for rounding.
        let range = |place: f64, cells: usize| {
            let first = ((place - 0.5 - reach - MARGIN) * grid.per_pixel) as usize;
            let last = ((place - 0.5 + reach + MARGIN) * grid.per_pixel) as usize;
            first.min(cells - 1)..last.min(cells - 1) + 1
        };
        Window { columns: range(x, grid.columns), rows: range(y, grid.rows) }
    }

    /// The anchors of a row of cells.
    #[inline(always)]
    pub(crate) fn entries(&self, grid: &Grid, row: usize, columns: &Range<usize>) -> &[Entry] {
        let row = grid.first + row * grid.columns;
        let (start, end) = (self.starts[row + columns.start], self.starts[row + columns.end]);
        &self.entries[start as usize..end as usize]
    }

    /// Anchors per square pixel around a place in the picture; above 0, so that a search begins nearby.
    #[inline(always)]
    pub(crate) fn density(&self, grid: &Grid, place: [f64; 2]) -> f64 {
        let Window { columns, rows } = Self::window(grid, place, grid.side as f64);
        let count: usize = rows.map(|row| self.entries(grid, row, &columns).len()).sum();
        // Of three by three cells. Fewer at the border of the picture, where a search has to reach farther, too.
        count.max(1) as f64 * (grid.per_pixel * grid.per_pixel / 9.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::Intrinsics;

    fn camera(width: usize, height: usize) -> Camera {
        let lens = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0, width, height };
        Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap()
    }

    #[test]
    fn every_anchor_is_in_the_windows_that_reach_its_pixel() {
        let cameras = [camera(40, 30), camera(7, 1), camera(1000, 1), camera(3, 3)];
        let views: Vec<u32> = (0..600).map(|i| [0, 0, 0, 1, 2, 0][i % 6]).collect();
        let pixels: Vec<u32> =
            (0..600).map(|i| i * 389 % [1200, 7, 1000][views[i as usize] as usize]).collect();
        let positions = vec![[0.0; 3]; 600];
        let anchors = Anchors { positions: &positions, views: &views, pixels: &pixels, depths: &[1.0; 600] };
        let grids = Grids::new(&anchors, &cameras);
        assert!(grids.of[3].is_empty());
        for (view, camera) in cameras[..3].iter().enumerate() {
            let (grid, width) = (&grids.of[view], camera.width() as u32);
            for (place, reach) in
                [([0.0, 0.0], 0.0), ([3.5, 0.5], 0.0), ([6.9, 0.99], 4.0), ([5.0, 0.0], 1e150)]
            {
                let Window { columns, rows } = Grids::window(grid, place, reach);
                let held: Vec<u32> = rows
                    .flat_map(|row| grids.entries(grid, row, &columns))
                    .map(|entry| entry.index)
                    .collect();
                let near = |&i: &u32| {
                    let pixel = pixels[i as usize];
                    let (x, y) = (f64::from(pixel % width) + 0.5, f64::from(pixel / width) + 0.5);
                    views[i as usize] == view as u32 && (x - place[0]).hypot(y - place[1]) <= reach
                };
                assert!((0..600).filter(near).all(|i| held.contains(&i)), "view {view}, {place:?}, {reach}");
            }
            let all = Grids::window(grid, [0.0, 0.0], 1e4);
            assert!(all.is_all(grid));
            let count: usize = all.rows.map(|row| grids.entries(grid, row, &all.columns).len()).sum();
            assert_eq!(count, views.iter().filter(|&&of| of as usize == view).count());
        }
    }

    #[test]
    fn cells_are_at_most_two_per_anchor() {
        for (width, height) in [(1 << 31, 1), (1, 1 << 31), (480, 320), (1, 1), (46_340, 46_340)] {
            for count in [1, 2, 10, 25_000] {
                let grid = Grid::new(width, height, count, 0);
                assert!(grid.columns * grid.rows <= 2 * count, "{width}x{height}, {count}");
                assert!(grid.columns * grid.side >= width && grid.rows * grid.side >= height);
            }
        }
    }
}

use crate::Result;
use crate::error::check;
use crate::search::{Among, search};
use crate::tree::Tree;

/// The nearest points of every row, nearest first; equal distances by ascending index.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbors {
    /// Number of rows: one per point ([`knn`]) or per query ([`query`]).
    pub rows: usize,
    /// Neighbours per row: what was asked for, or all there are if that is less.
    pub k: usize,
    /// `[rows, k]`: indices of the neighbours.
    pub indices: Vec<u32>,
    /// `[rows, k]`: squared distances, `dx*dx + dy*dy + dz*dz` in f32.
    pub sq_distances: Vec<f32>,
}

impl Neighbors {
    /// Indices and squared distances of one row's neighbours, nearest first.
    ///
    /// # Panics
    /// If there is no such row.
    #[must_use]
    pub fn row(&self, row: usize) -> (&[u32], &[f32]) {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        let range = row * self.k..(row + 1) * self.k;
        (&self.indices[range.clone()], &self.sq_distances[range])
    }
}

/// The `k` nearest other points of every point. A point is excluded from its own row by its index, so that an
/// exact duplicate is a neighbour at distance 0. With fewer than `k` other points, each row holds all of them.
///
/// # Errors
/// If a coordinate is not finite or the points are more than a `u32` can index.
pub fn knn(points: &[[f32; 3]], k: usize) -> Result<Neighbors> {
    check("point", points)?;
    let k = k.min(points.len().saturating_sub(1));
    if k == 0 {
        return Ok(without_neighbours(points.len()));
    }
    Ok(Tree::build(points).knn(k))
}

/// The `k` nearest points of every query. With fewer than `k` points, each row holds all of them.
///
/// # Errors
/// If a coordinate is not finite or the points are more than a `u32` can index.
pub fn query(points: &[[f32; 3]], queries: &[[f32; 3]], k: usize) -> Result<Neighbors> {
    check("point", points)?;
    check("query", queries)?;
    let k = k.min(points.len());
    if k == 0 || queries.is_empty() {
        return Ok(Neighbors { k, ..without_neighbours(queries.len()) });
    }
    Ok(Tree::build(points).search(queries, k))
}

impl Tree {
    /// The tree of a set of points, for many searches in it.
    ///
    /// # Errors
    /// If a coordinate is not finite or the points are more than a `u32` can index.
    pub fn new(points: &[[f32; 3]]) -> Result<Self> {
        check("point", points)?;
        Ok(Self::build(points))
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.n_points
    }

    /// Whether there are no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.n_points == 0
    }

    /// As [`knn`] of the tree's points.
    #[must_use]
    pub fn knn(&self, k: usize) -> Neighbors {
        let k = k.min(self.n_points.saturating_sub(1));
        if k == 0 {
            return without_neighbours(self.n_points);
        }
        search(self, self, k, Among::Others)
    }

    /// As [`query`] in the tree's points.
    ///
    /// # Errors
    /// If a coordinate is not finite or the queries are more than a `u32` can index.
    pub fn query(&self, queries: &[[f32; 3]], k: usize) -> Result<Neighbors> {
        check("query", queries)?;
        Ok(self.search(queries, k))
    }

    /// Of queries that have been checked.
    fn search(&self, queries: &[[f32; 3]], k: usize) -> Neighbors {
        let k = k.min(self.n_points);
        if k == 0 || queries.is_empty() {
            return Neighbors { k, ..without_neighbours(queries.len()) };
        }
        // The queries get a tree too: its leaves are the blocks of near queries that are searched together.
        search(self, &Self::build(queries), k, Among::All)
    }
}

fn without_neighbours(rows: usize) -> Neighbors {
    Neighbors { rows, k: 0, indices: Vec::new(), sq_distances: Vec::new() }
}

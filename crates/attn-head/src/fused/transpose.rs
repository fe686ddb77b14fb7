//! The transposed neighbour lists: for each anchor, the anchors that it is a neighbour of.

use crate::Inputs;

/// For every anchor those that have it as a neighbour, in ascending order.
#[derive(Debug)]
pub(super) struct Lookers {
    /// Where each anchor's part of `pairs` begins, and the last one's ends.
    starts: Vec<usize>,
    /// Places in `Inputs::neighbours`.
    pairs: Vec<usize>,
    /// Neighbours of each.
    pub(super) k: usize,
}

impl Lookers {
    pub(super) fn new(inputs: &Inputs<'_>) -> Self {
        let mut starts = vec![0; inputs.n + 1];
        for &j in inputs.neighbours {
            starts[j as usize + 1] += 1;
        }
        for j in 0..inputs.n {
            starts[j + 1] += starts[j];
        }
        let mut next = starts.clone();
        let mut pairs = vec![0; inputs.neighbours.len()];
        for (pair, &j) in inputs.neighbours.iter().enumerate() {
            pairs[next[j as usize]] = pair;
            next[j as usize] += 1;
        }
        Self { starts, pairs, k: inputs.k }
    }

    /// Those who look at `anchor`, itself first, and its place among the k + 1 that each looks at.
    #[inline(always)]
    pub(super) fn of(&self, anchor: usize) -> impl Iterator<Item = (usize, usize)> {
        std::iter::once((anchor, 0)).chain(self.others(anchor))
    }

    /// The same without itself.
    #[inline(always)]
    pub(super) fn others(&self, anchor: usize) -> impl Iterator<Item = (usize, usize)> {
        let pairs = self.pairs[self.starts[anchor]..self.starts[anchor + 1]].iter();
        pairs.map(|&pair| (pair / self.k, pair % self.k + 1))
    }
}

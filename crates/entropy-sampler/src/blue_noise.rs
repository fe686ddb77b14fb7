//! Blue-noise thresholds: the pixels below any level are spread evenly.

use crate::random::Stream;

/// Side of the square that repeats.
const SIDE: usize = 64;

/// Ranks of the square's pixels, u16 little endian, by the void-and-cluster method (R. Ulichney, "The void-and-cluster
/// method for dither array generation", 1993): the pixels of rank below k are spread evenly, for every k, also across
/// the edges. Written by `examples/make_blue_noise.rs`.
static RANKS: &[u8; 2 * SIDE * SIDE] = include_bytes!("blue_noise.bin");

/// Thresholds of all pixels of a view. Those of a single pixel are uniform over the draws.
#[derive(Clone, Copy)]
pub(crate) struct Thresholds {
    shift: [usize; 2],
    jitter: u32,
}

impl Thresholds {
    /// Bits of a threshold: those of a rank, and jitter below.
    pub(crate) const BITS: u32 = 31;
    const RANK_BITS: u32 = (SIDE * SIDE).ilog2();

    /// The square at a random place.
    pub(crate) fn new(draws: Stream) -> Self {
        let shift = [0, 1].map(|i| draws.bits(i) as usize % SIDE);
        let jitter = draws.bits(2) as u32 >> (u32::BITS - (Self::BITS - Self::RANK_BITS));
        Self { shift, jitter }
    }

    /// Threshold of a pixel, below 2^31.
    #[inline]
    pub(crate) fn at(self, x: usize, y: usize) -> u32 {
        let [x, y] = [x + self.shift[0], y + self.shift[1]].map(|i| i % SIDE);
        let rank = u16::from_le_bytes([RANKS[2 * (y * SIDE + x)], RANKS[2 * (y * SIDE + x) + 1]]);
        u32::from(rank) << (Self::BITS - Self::RANK_BITS) | self.jitter
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_rank_comes_once() {
        let mut ranks: Vec<u16> = RANKS.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        ranks.sort_unstable();
        assert!(ranks.into_iter().eq(0..(SIDE * SIDE) as u16));
    }

    /// As far from each other as points at random are not: those lie 0.5 / √density apart, in the mean.
    #[test]
    fn level_sets_are_spread() {
        let thresholds = Thresholds { shift: [0, 0], jitter: 0 };
        for share in [0.02, 0.05, 0.1, 0.2] {
            let level = (share * f64::from(1u32 << Thresholds::BITS)) as u32;
            let all = (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE));
            let set: Vec<(usize, usize)> = all.filter(|&(x, y)| thresholds.at(x, y) < level).collect();
            assert!((set.len() as f64 - share * (SIDE * SIDE) as f64).abs() <= 1.0);
            let around = |a: usize, b: usize| a.abs_diff(b).min(SIDE - a.abs_diff(b)) as f64;
            let nearest = |p: &(usize, usize)| {
                let others = set.iter().filter(|q| *q != p);
                others.map(|q| around(p.0, q.0).hypot(around(p.1, q.1))).fold(f64::INFINITY, f64::min)
            };
            let mean = set.iter().map(nearest).sum::<f64>() / set.len() as f64;
            assert!(mean * share.sqrt() > 0.7, "{share}: {mean} px");
        }
    }
}

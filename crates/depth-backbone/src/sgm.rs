//! Semi-global matching (Hirschmüller 2008): costs are summed along eight paths through the picture, with a small
//! price for a step of one plane and a larger one, cheaper across image edges, for a jump.

use crate::cost::COST_LEVELS;
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::{Isa, dispatch};

/// Price of a one-plane step, in levels of the costs.
const STEP_PRICE: u16 = (0.06 * COST_LEVELS) as u16;
/// Price of a jump where the picture is flat, same unit.
const JUMP_PRICE: f32 = 0.8 * COST_LEVELS;
/// Luma difference (8-bit levels) that halves the price of a jump.
const EDGE_LEVELS: f32 = 8.0;

/// Beyond every path cost, and far enough below `u16::MAX` that adding a price does not wrap.
const WALL: u16 = 30_000;

/// Planes of a volume are a multiple of these: the lanes of the widest vectors that are used.
pub(crate) const LANES: usize = 16;

/// Costs of pixels at planes of their own.
#[derive(Clone, Copy)]
pub(crate) struct Volume<'a> {
    /// `[height, width, planes]`.
    pub(crate) costs: &'a [u16],
    pub(crate) width: usize,
    /// A multiple of [`LANES`].
    pub(crate) planes: usize,
    /// The number of each pixel's first plane, where they differ: planes of the same number are at the same depth.
    pub(crate) first: Option<&'a [i32]>,
}

/// The costs of paths at one pixel, between walls that are wider by two than there are planes, and their minimum.
#[derive(Clone)]
struct Path {
    costs: Vec<u16>,
    minimum: u16,
}

impl Path {
    fn new(planes: usize) -> Self {
        let mut costs = vec![WALL; 3 * planes + 4];
        costs[planes + 2..][..planes].fill(0);
        Self { costs, minimum: 0 }
    }

    /// A path that begins here: before the picture's edge nothing was paid.
    fn restart(&mut self, planes: usize) {
        self.costs[planes + 2..][..planes].fill(0);
        self.minimum = 0;
    }
}

/// One step along a path: `next = cost + min(previous, neighbours + step, minimum + jump) - minimum`, added to `sums`. The first
/// plane of this pixel is `shift` beyond that of the previous one.
#[inline(always)]
fn advance<S: Simd>(
    simd: S,
    costs: &[u16],
    previous: &Path,
    shift: i32,
    jump: u16,
    next: &mut Path,
    sums: &mut [u16],
) {
    let planes = costs.len();
    // Farther apart than this, no plane is next to one of the other pixel's.
    let apart = planes as i32 + 1;
    let start = (apart + shift.clamp(-apart, apart)) as usize;
    let from = &previous.costs[start..][..planes + 2];
    let n = planes / S::U16_LANES;
    let before = &S::as_simd_u16s(&from[..planes]).0[..n];
    let middle = &S::as_simd_u16s(&from[1..][..planes]).0[..n];
    let after = &S::as_simd_u16s(&from[2..]).0[..n];
    let costs = &S::as_simd_u16s(costs).0[..n];
    let out = &mut S::as_mut_simd_u16s(&mut next.costs[planes + 2..][..planes]).0[..n];
    let sums = &mut S::as_mut_simd_u16s(sums).0[..n];
    let minimum = simd.splat_u16s(previous.minimum);
    let ceiling = simd.splat_u16s(previous.minimum + jump);
    let step = simd.splat_u16s(STEP_PRICE);
    let mut smallest = simd.splat_u16s(u16::MAX);
    for i in 0..n {
        let neighbours = simd.add_u16s(simd.min_u16s(before[i], after[i]), step);
        let best = simd.min_u16s(simd.min_u16s(middle[i], neighbours), ceiling);
        let value = simd.add_u16s(costs[i], simd.sub_u16s(best, minimum));
        out[i] = value;
        sums[i] = simd.add_u16s(sums[i], value);
        smallest = simd.min_u16s(smallest, value);
    }
    next.minimum = least::<S>(smallest);
}

/// The least of the lanes.
#[inline(always)]
fn least<S: Simd>(lanes: S::u16s) -> u16 {
    // As many as the widest vectors have.
    let mut all = [u16::MAX; 32];
    S::as_mut_simd_u16s(&mut all).0[0] = lanes;
    let mut n = S::U16_LANES;
    while n > 1 {
        n /= 2;
        for i in 0..n {
            all[i] = all[i].min(all[i + n]);
        }
    }
    all[0]
}

/// Sums costs along eight paths; `luma` (8-bit levels, one per pixel) sets where jumps are cheap. The result has the layout of the
/// costs.
pub(crate) fn aggregate(isa: Isa, volume: Volume, luma: &[f32]) -> Vec<u16> {
    assert!(volume.planes.is_multiple_of(LANES), "whole vectors of planes");
    let mut sums = vec![0_u16; volume.costs.len()];
    // Vectors of AVX-512 would be wider than a short list of planes.
    dispatch(isa.min(Isa::Avx2), Aggregate { volume, luma, sums: &mut sums });
    sums
}

struct Aggregate<'a> {
    volume: Volume<'a>,
    luma: &'a [f32],
    sums: &'a mut [u16],
}

impl WithSimd for Aggregate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { volume: Volume { costs, width, planes, first }, luma, sums } = self;
        let height = luma.len() / width;
        for backward in [false, true] {
            let mut along = Path::new(planes);
            let mut spare = Path::new(planes);
            // Three diagonal and vertical paths per column: of the row before, and of this row.
            let mut before: Vec<[Path; 3]> = vec![std::array::from_fn(|_| Path::new(planes)); width];
            let mut current = before.clone();
            let begin = Path::new(planes);
            for row in 0..height {
                let y = if backward { height - 1 - row } else { row };
                along.restart(planes);
                if !backward {
                    // Written before they are read: of fresh memory that is read first, the system makes each page twice.
                    sums[y * width * planes..][..width * planes].fill(0);
                }
                for column in 0..width {
                    let x = if backward { width - 1 - column } else { column };
                    let pixel = y * width + x;
                    let costs = &costs[pixel * planes..][..planes];
                    let sums = &mut sums[pixel * planes..][..planes];
                    // What a jump from a pixel costs, and how far the first planes lie apart.
                    let between = |from: usize| {
                        let edge = (luma[pixel] - luma[from]).abs();
                        let jump =
                            (JUMP_PRICE / (1.0 + edge / EDGE_LEVELS)).max(f32::from(STEP_PRICE)) as u16;
                        (first.map_or(0, |first| first[pixel] - first[from]), jump)
                    };
                    // `toward` steps against the direction of travel along the row.
                    let toward = |x: usize, by: isize| {
                        let x = x as isize + if backward { -by } else { by };
                        (0..width as isize).contains(&x).then_some(x as usize)
                    };
                    let previous_row = if backward { pixel + width } else { pixel.wrapping_sub(width) };

                    let (shift, jump) = toward(x, -1).map_or((0, 0), |from| between(y * width + from));
                    advance(simd, costs, &along, shift, jump, &mut spare, sums);
                    std::mem::swap(&mut along, &mut spare);
                    for (path, by) in [-1, 0, 1].into_iter().enumerate() {
                        let next = &mut current[x][path];
                        match toward(x, by).filter(|_| row > 0) {
                            Some(from) => {
                                let (shift, jump) = between(previous_row - x + from);
                                advance(simd, costs, &before[from][path], shift, jump, next, sums);
                            }
                            None => advance(simd, costs, &begin, 0, 0, next, sums),
                        }
                    }
                }
                std::mem::swap(&mut before, &mut current);
            }
        }
    }
}

/// The best plane of every pixel with sub-plane precision: a parabola through the minimum and its neighbours. Ties go
/// to the farther plane.
pub(crate) fn winners(sums: &[u16], planes: usize, count: usize) -> Vec<f32> {
    sums.chunks_exact(planes).map(|sums| winner(&sums[..count])).collect()
}

/// How far the least sum of every pixel lies below their mean, as a share of the largest matching costs of eight paths.
pub(crate) fn distinctness(sums: &[u16], planes: usize, count: usize) -> Vec<f32> {
    let share = |sums: &[u16]| {
        let least = sums.iter().copied().min().unwrap_or(0);
        let mean = sums.iter().map(|&sum| f32::from(sum)).sum::<f32>() / sums.len() as f32;
        (mean - f32::from(least)) / (8.0 * COST_LEVELS)
    };
    sums.chunks_exact(planes).map(|sums| share(&sums[..count])).collect()
}

fn winner(sums: &[u16]) -> f32 {
    let least = sums.iter().fold(u16::MAX, |least, &sum| least.min(sum));
    let best = sums.iter().position(|&sum| sum == least).unwrap_or(0);
    let cost = |i: usize| f32::from(sums[i]);
    if best == 0 || best + 1 == sums.len() {
        return best as f32;
    }
    let curvature = cost(best - 1) - 2.0 * cost(best) + cost(best + 1);
    let shift = if curvature > 0.0 { 0.5 * (cost(best - 1) - cost(best + 1)) / curvature } else { 0.0 };
    best as f32 + shift.clamp(-0.5, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The textbook recursion, one path direction at a time; `first` is the number of each pixel's first plane.
    fn aggregate_plainly(cost: &[u16], luma: &[f32], width: usize, planes: usize, first: &[i32]) -> Vec<u16> {
        let height = (luma.len() / width) as isize;
        let mut total = vec![0_u16; cost.len()];
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)] {
            let mut path = vec![0_i32; cost.len()];
            let mut order: Vec<(isize, isize)> =
                (0..height).flat_map(|y| (0..width as isize).map(move |x| (x, y))).collect();
            order.sort_by_key(|&(x, y)| (y * dy, x * dx));
            for (x, y) in order {
                let pixel = y as usize * width + x as usize;
                let (px, py) = (x - dx, y - dy);
                let inside = (0..width as isize).contains(&px) && (0..height).contains(&py);
                let from = (py * width as isize + px) as usize;
                for d in 0..planes {
                    let own_cost = i32::from(cost[pixel * planes + d]);
                    path[pixel * planes + d] = own_cost;
                    if inside {
                        let last = &path[from * planes..][..planes];
                        let minimum = *last.iter().min().unwrap();
                        let edge = (luma[pixel] - luma[from]).abs();
                        let jump =
                            (JUMP_PRICE / (1.0 + edge / EDGE_LEVELS)).max(f32::from(STEP_PRICE)) as i32;
                        let mut best = minimum + jump;
                        for (step, price) in [(0, 0), (-1, STEP_PRICE), (1, STEP_PRICE)] {
                            let there = d as i32 + first[pixel] - first[from] + step;
                            if let Some(last) = usize::try_from(there).ok().and_then(|there| last.get(there))
                            {
                                best = best.min(last + i32::from(price));
                            }
                        }
                        path[pixel * planes + d] += best - minimum;
                    }
                }
            }
            for (sum, value) in total.iter_mut().zip(path) {
                *sum += value as u16;
            }
        }
        total
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn equals_the_textbook(width in 1usize..9, height in 1usize..7, vectors in 1usize..4, spread in 0i32..60, seed: u64) {
            let mut state = seed;
            let mut random = || { state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1); (state >> 56) as u8 };
            let planes = vectors * LANES;
            let luma: Vec<f32> = (0..width * height).map(|_| f32::from(random())).collect();
            let costs: Vec<u16> = (0..width * height * planes).map(|_| u16::from(random())).collect();
            let first: Vec<i32> = (0..width * height).map(|_| i32::from(random()) * spread / 255).collect();
            let expected = aggregate_plainly(&costs, &luma, width, planes, &first);
            for isa in Isa::available() {
                let volume = Volume { costs: &costs, width, planes, first: Some(&first) };
                prop_assert_eq!(&aggregate(isa, volume, &luma), &expected, "{}", isa);
                if spread == 0 {
                    prop_assert_eq!(&aggregate(isa, Volume { first: None, ..volume }, &luma), &expected, "{}", isa);
                }
            }
        }
    }

    #[test]
    fn winners_interpolate_and_ties_go_to_the_first_plane() {
        let plane = winner(&[90, 50, 10, 20, 90, 90, 90]);
        assert!(plane > 2.0 && plane < 2.5);
        assert_eq!(winner(&[7, 7, 7, 7, 7]), 0.0);
        assert_eq!(winner(&[3]), 0.0);
        assert_eq!(winners(&[5, 4, 0, 9, 8, 1], 3, 2), [1.0, 1.0]);
    }
}

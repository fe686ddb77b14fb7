//! Semi-global matching (Hirschmüller 2008): costs are summed along eight paths through the picture, with a small
//! price for a step of one plane and a larger one, cheaper across image edges, for a jump.

use multiversion::multiversion;

/// Price of a one-plane step, in units of 1/255 of the largest cost.
const STEP_PRICE: u16 = 15;
/// Price of a jump where the picture is flat, same unit.
const JUMP_PRICE: f32 = 204.0;
/// Luma difference (8-bit levels) that halves the price of a jump.
const EDGE_LEVELS: f32 = 8.0;

/// Beyond every path cost, and far enough below `u16::MAX` that adding a price does not wrap.
const WALL: u16 = 30_000;

/// One path's costs at one pixel: `planes` values between two walls, and their minimum.
#[derive(Clone)]
struct Path {
    costs: Vec<u16>,
    minimum: u16,
}

impl Path {
    fn new(planes: usize) -> Self {
        let mut costs = vec![0; planes + 2];
        costs[0] = WALL;
        costs[planes + 1] = WALL;
        Self { costs, minimum: 0 }
    }

    /// A path that begins here: before the picture's edge nothing was paid.
    fn restart(&mut self) {
        let planes = self.costs.len() - 2;
        self.costs[1..=planes].fill(0);
        self.minimum = 0;
    }
}

/// One step along a path: `next = cost + min(previous, neighbours + step, minimum + jump) - minimum`, added to `sum`.
#[multiversion(targets("x86_64+avx2", "aarch64+neon"))]
fn advance(cost: &[u8], previous: &[u16], minimum: u16, jump: u16, next: &mut [u16], sum: &mut [u16]) -> u16 {
    let n = cost.len();
    let (before, at, after) = (&previous[..n], &previous[1..][..n], &previous[2..][..n]);
    let (next, sum) = (&mut next[1..][..n], &mut sum[..n]);
    let ceiling = minimum + jump;
    let mut smallest = u16::MAX;
    for i in 0..n {
        let step = before[i].min(after[i]) + STEP_PRICE;
        let value = u16::from(cost[i]) + at[i].min(step).min(ceiling) - minimum;
        next[i] = value;
        sum[i] += value;
        smallest = smallest.min(value);
    }
    smallest
}

/// Sums the costs `[height, width, planes]` along eight paths; `luma` (8-bit levels) sets where jumps are cheap.
/// The result has the same layout.
pub(crate) fn aggregate(cost: &[u8], luma: &[f32], width: usize, planes: usize) -> Vec<u16> {
    let height = luma.len() / width;
    let mut sum = vec![0_u16; cost.len()];
    for backward in [false, true] {
        let mut along = Path::new(planes);
        let mut spare = Path::new(planes);
        // Three diagonal and vertical paths per column: of the row before, and of this row.
        let mut before: Vec<[Path; 3]> = vec![std::array::from_fn(|_| Path::new(planes)); width];
        let mut current = before.clone();
        for row in 0..height {
            let y = if backward { height - 1 - row } else { row };
            along.restart();
            for column in 0..width {
                let x = if backward { width - 1 - column } else { column };
                let pixel = y * width + x;
                let costs = &cost[pixel * planes..][..planes];
                let sums = &mut sum[pixel * planes..][..planes];
                let jump = |from: usize| {
                    let edge = (luma[pixel] - luma[from]).abs();
                    (JUMP_PRICE / (1.0 + edge / EDGE_LEVELS)).max(f32::from(STEP_PRICE)) as u16
                };
                // `toward` steps against the direction of travel along the row.
                let toward = |x: usize, by: isize| {
                    let x = x as isize + if backward { -by } else { by };
                    (0..width as isize).contains(&x).then_some(x as usize)
                };
                let previous_row = if backward { pixel + width } else { pixel.wrapping_sub(width) };

                let price = toward(x, -1).map_or(0, |from| jump(y * width + from));
                spare.minimum = advance(costs, &along.costs, along.minimum, price, &mut spare.costs, sums);
                std::mem::swap(&mut along, &mut spare);
                for (path, by) in [-1, 0, 1].into_iter().enumerate() {
                    let next = &mut current[x][path];
                    match toward(x, by).filter(|_| row > 0) {
                        Some(from) => {
                            let price = jump(previous_row - x + from);
                            let last = &before[from][path];
                            next.minimum =
                                advance(costs, &last.costs, last.minimum, price, &mut next.costs, sums);
                        }
                        None => {
                            spare.restart();
                            next.minimum = advance(costs, &spare.costs, 0, 0, &mut next.costs, sums);
                        }
                    }
                }
            }
            std::mem::swap(&mut before, &mut current);
        }
    }
    sum
}

/// The best plane of every pixel with sub-plane precision: a parabola through the minimum and its neighbours. Ties go
/// to the farther plane.
pub(crate) fn winners(sum: &[u16], planes: usize) -> Vec<f32> {
    sum.chunks_exact(planes).map(winner).collect()
}

fn winner(sums: &[u16]) -> f32 {
    let best = (0..sums.len()).min_by_key(|&i| sums[i]).unwrap_or(0);
    let at = |i: usize| f32::from(sums[i]);
    if best == 0 || best + 1 == sums.len() {
        return best as f32;
    }
    let curvature = at(best - 1) - 2.0 * at(best) + at(best + 1);
    let shift = if curvature > 0.0 { 0.5 * (at(best - 1) - at(best + 1)) / curvature } else { 0.0 };
    best as f32 + shift.clamp(-0.5, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The textbook recursion, one path direction at a time.
    fn aggregate_plainly(cost: &[u8], luma: &[f32], width: usize, planes: usize) -> Vec<u16> {
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
                    let own = i32::from(cost[pixel * planes + d]);
                    path[pixel * planes + d] = own;
                    if inside {
                        let last = &path[from * planes..][..planes];
                        let minimum = *last.iter().min().unwrap();
                        let edge = (luma[pixel] - luma[from]).abs();
                        let jump =
                            (JUMP_PRICE / (1.0 + edge / EDGE_LEVELS)).max(f32::from(STEP_PRICE)) as i32;
                        let mut best = last[d].min(minimum + jump);
                        if d > 0 {
                            best = best.min(last[d - 1] + i32::from(STEP_PRICE));
                        }
                        if d + 1 < planes {
                            best = best.min(last[d + 1] + i32::from(STEP_PRICE));
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
        fn equals_the_textbook(width in 1usize..9, height in 1usize..7, planes in 1usize..20, seed: u64) {
            let mut state = seed;
            let mut random = || { state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1); (state >> 56) as u8 };
            let luma: Vec<f32> = (0..width * height).map(|_| f32::from(random())).collect();
            let cost: Vec<u8> = (0..width * height * planes).map(|_| random()).collect();
            prop_assert_eq!(aggregate(&cost, &luma, width, planes), aggregate_plainly(&cost, &luma, width, planes));
        }
    }

    #[test]
    fn winners_interpolate_and_ties_go_to_the_first_plane() {
        let plane = winner(&[90, 50, 10, 20, 90, 90, 90]);
        assert!(plane > 2.0 && plane < 2.5);
        assert_eq!(winner(&[7, 7, 7, 7, 7]), 0.0);
        assert_eq!(winner(&[3]), 0.0);
    }
}

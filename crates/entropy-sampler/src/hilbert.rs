//! Pixels in the order of a Hilbert curve: what is near along it is near in the picture.

/// Pixel indices of a `width` × `height` picture along the Hilbert curve of the smallest power-of-two square around
/// it; the curve's way outside the picture is skipped.
pub(crate) fn hilbert_order(width: usize, height: usize) -> Vec<u32> {
    let side = width.max(height).next_power_of_two() as i64;
    let mut walk =
        Walk { width: width as i64, height: height as i64, order: Vec::with_capacity(width * height) };
    walk.square([0, 0], [side, 0], [0, side]);
    walk.order
}

struct Walk {
    width: i64,
    height: i64,
    order: Vec<u32>,
}

impl Walk {
    /// The square with a corner at `o` and the sides `a`, `b`; the curve runs from `o` to `o + a`.
    fn square(&mut self, o: [i64; 2], a: [i64; 2], b: [i64; 2]) {
        let low = [0, 1].map(|i| o[i].min(o[i] + a[i] + b[i]));
        if low[0] >= self.width || low[1] >= self.height {
            return;
        }
        if (a[0] + b[0]).abs() == 1 {
            self.order.push((low[1] * self.width + low[0]) as u32);
            return;
        }
        let point = |s: i64, t: i64| [0, 1].map(|i| o[i] + (s * a[i] + t * b[i]) / 2);
        let half = |v: [i64; 2], sign: i64| v.map(|c| sign * c / 2);
        self.square(o, half(b, 1), half(a, 1));
        self.square(point(0, 1), half(a, 1), half(b, 1));
        self.square(point(1, 1), half(a, 1), half(b, 1));
        self.square(point(2, 1), half(b, -1), half(a, -1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(order: &[u32], width: u32) -> Vec<u32> {
        let xy = |p: u32| (p % width, p / width);
        order
            .windows(2)
            .map(|pair| {
                let ((x0, y0), (x1, y1)) = (xy(pair[0]), xy(pair[1]));
                x0.abs_diff(x1) + y0.abs_diff(y1)
            })
            .collect()
    }

    #[test]
    fn every_pixel_comes_once() {
        for (width, height) in [(1, 1), (1, 9), (5, 4), (64, 64), (33, 70)] {
            let mut order = hilbert_order(width, height);
            order.sort_unstable();
            assert!(order.iter().copied().eq(0..(width * height) as u32), "{width}x{height}");
        }
    }

    #[test]
    fn steps_go_to_a_neighbour() {
        assert!(steps(&hilbert_order(64, 64), 64).iter().all(|&step| step == 1));
        let skipping = steps(&hilbert_order(448, 256), 448);
        let jumps = skipping.iter().filter(|&&step| step > 1).count();
        assert!(jumps < 20, "{jumps} jumps where the curve leaves the picture");
    }
}

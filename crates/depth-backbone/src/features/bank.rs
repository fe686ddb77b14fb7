//! The bank at chosen pixels. Few pixels of a picture become anchors, so only theirs is computed: of the rows around them sums from the left
//! edge are kept, and a window is the difference of two such sums in each of its rows.

use super::FEATURE_NAMES;
use crate::Result;
use gs_scene::{DepthMap, View};
use rayon::prelude::*;

/// Half the windows of the local means and deviations: 3×3, 7×7 and 15×15 pixels.
const RADII: [usize; 3] = [1, 3, 7];
/// The middle one.
const SMOOTH: usize = RADII[1];
/// The widest window reaches this far.
const REACH: usize = RADII[2];
/// Rows of which sums are kept: those of the widest window, a power of two.
const KEPT: usize = (2 * REACH + 1).next_power_of_two();
/// Rows of a task: each begins with the sums of [`REACH`] rows before it.
const STRIP: usize = 64;

/// Sums over some pixels of red, green, blue, luma and its square, relative inverse depth and its square; the last is 0. f64,
/// so that windows at the far end of a row lose nothing.
type Sums = [f64; 8];
const LUMA: usize = 3;
const INVERSE_DEPTH: usize = 5;

/// What the bank is made of.
pub(crate) struct Bank<'a> {
    rgb: &'a [f32],
    luma: Vec<f32>,
    depth: &'a [f32],
    confidence: &'a [f32],
    cost: &'a [f32],
    /// Median of the depths that there are.
    median: f32,
    width: usize,
    height: usize,
}

impl<'a> Bank<'a> {
    /// The bank of one view. `cost` is the matching cost per pixel, 0..1. Where depth is missing its channels are 0.
    ///
    /// # Errors
    /// If a plane has another size than the picture.
    pub(crate) fn new(
        view: &'a View,
        depth: &'a DepthMap,
        confidence: &'a [f32],
        cost: &'a [f32],
    ) -> Result<Self> {
        let luma = view.image().luma();
        for (what, found) in [("confidence", confidence.len()), ("matching cost", cost.len())] {
            if found != luma.len() {
                return Err(gs_scene::Error::Length { what, expected: luma.len(), found }.into());
            }
        }
        let mut known: Vec<f32> = depth.data().iter().copied().filter(|&d| d > 0.0).collect();
        let middle = known.len() / 2;
        let median =
            if known.is_empty() { 1.0 } else { *known.select_nth_unstable_by(middle, f32::total_cmp).1 };
        let (rgb, depth, width) = (view.image().data(), depth.data(), depth.width());
        Ok(Self { rgb, depth, confidence, cost, median, width, height: luma.len() / width, luma })
    }

    /// The channels of [`FEATURE_NAMES`] at the pixels (row-major indices), `[pixels, 32]`.
    ///
    /// # Panics
    /// If a pixel lies outside.
    pub(crate) fn at(&self, pixels: &[u32]) -> Vec<f32> {
        let pixel = |i: u32| pixels[i as usize] as usize;
        let strip = |i: u32| pixel(i) / self.width / STRIP;
        let mut order: Vec<u32> = (0..pixels.len() as u32).collect();
        order.sort_unstable_by_key(|&i| pixel(i));
        let strips: Vec<&[u32]> = order.chunk_by(|&a, &b| strip(a) == strip(b)).collect();
        let strip_channels = |strip: &&[u32]| {
            let mut window = Window::new(self);
            strip.iter().map(|&i| window.channels(pixel(i))).collect::<Vec<_>>()
        };
        let found: Vec<Vec<[f32; FEATURE_NAMES.len()]>> = strips.par_iter().map(strip_channels).collect();
        let mut rows = vec![[0.0; FEATURE_NAMES.len()]; pixels.len()];
        for (&i, channels) in order.iter().zip(found.iter().flatten()) {
            rows[i as usize] = *channels;
        }
        rows.into_flattened()
    }

    /// Inverse depth in units of that of the median; 0 where there is none. A single depth next to 0 must not swallow the sums of its row.
    fn inverse_depth(&self, pixel: usize) -> f32 {
        const LARGEST: f32 = 1e6;
        let depth = self.depth[pixel];
        if depth > 0.0 { (self.median / depth).min(LARGEST) } else { 0.0 }
    }

    /// Logarithm of depth over its median; 0 where there is none. Finite whatever the depths.
    fn log_depth(&self, pixel: usize) -> f32 {
        let depth = self.depth[pixel];
        if depth > 0.0 { (depth / self.median).clamp(f32::MIN_POSITIVE, f32::MAX).ln() } else { 0.0 }
    }

    /// Pixels to the left, to the right, above and below; at the border the pixel itself.
    fn around(&self, pixel: usize) -> [usize; 4] {
        let (x, y) = (pixel % self.width, pixel / self.width);
        [
            pixel - usize::from(x > 0),
            pixel + usize::from(x + 1 < self.width),
            if y > 0 { pixel - self.width } else { pixel },
            if y + 1 < self.height { pixel + self.width } else { pixel },
        ]
    }
}

/// Sums of the rows around those pixels that are asked for, from top to bottom.
struct Window<'a> {
    bank: &'a Bank<'a>,
    /// Sums of all pixels to the left, `[KEPT, width + 1]`; row y is in place y modulo [`KEPT`].
    from_left: Vec<Sums>,
    /// The first row that was not summed yet.
    next: usize,
}

impl<'a> Window<'a> {
    fn new(bank: &'a Bank<'a>) -> Self {
        Self { bank, from_left: vec![[0.0; 8]; KEPT * (bank.width + 1)], next: 0 }
    }

    /// Sums the rows that windows around row `y` reach and that were not summed yet.
    fn advance(&mut self, y: usize) {
        let bank = self.bank;
        let last = (y + REACH).min(bank.height - 1);
        for row in self.next.max(y.saturating_sub(REACH))..=last {
            let out = &mut self.from_left[row % KEPT * (bank.width + 1)..][..=bank.width];
            let mut sums = [0.0; 8];
            for (x, out) in out[1..].iter_mut().enumerate() {
                let pixel = row * bank.width + x;
                let rgb = &bank.rgb[3 * pixel..][..3];
                let (luma, inverse) = (f64::from(bank.luma[pixel]), f64::from(bank.inverse_depth(pixel)));
                let values = [
                    f64::from(rgb[0]),
                    f64::from(rgb[1]),
                    f64::from(rgb[2]),
                    luma,
                    luma * luma,
                    inverse,
                    inverse * inverse,
                    0.0,
                ];
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum += value;
                }
                *out = sums;
            }
            out[0] = [0.0; 8];
        }
        self.next = last + 1;
    }

    /// Pairs of sums whose differences are those over the rows of the window around a pixel, cut at the border, and its number of pixels.
    fn rows(&self, pixel: usize, radius: usize) -> (impl Iterator<Item = (&Sums, &Sums)>, f64) {
        let (width, height) = (self.bank.width, self.bank.height);
        let part = |i: usize, n: usize| i.saturating_sub(radius)..(i + radius + 1).min(n);
        let (columns, rows) = (part(pixel % width, width), part(pixel / width, height));
        let count = (columns.len() * rows.len()) as f64;
        let pairs = rows.map(move |row| {
            let sums = &self.from_left[row % KEPT * (width + 1)..][..=width];
            (&sums[columns.end], &sums[columns.start])
        });
        (pairs, count)
    }

    /// Means over the window around a pixel.
    fn means(&self, pixel: usize, radius: usize) -> Sums {
        let (rows, count) = self.rows(pixel, radius);
        let mut sums = [0.0; 8];
        for (to, from) in rows {
            for (sum, (to, from)) in sums.iter_mut().zip(to.iter().zip(from)) {
                *sum += to - from;
            }
        }
        sums.map(|sum| sum / count)
    }

    /// Mean luma over the window of the middle size.
    fn smooth(&self, pixel: usize) -> f32 {
        let (rows, count) = self.rows(pixel, SMOOTH);
        (rows.map(|(to, from)| to[LUMA] - from[LUMA]).sum::<f64>() / count) as f32
    }

    /// All channels of a pixel, which is in no row above those that were asked for.
    fn channels(&mut self, pixel: usize) -> [f32; FEATURE_NAMES.len()] {
        self.advance(pixel / self.bank.width);
        let bank = self.bank;
        let (x, y) = (pixel % bank.width, pixel / bank.width);
        let around = bank.around(pixel);
        let means = RADII.map(|radius| self.means(pixel, radius));
        let deviation = |means: &Sums, index: usize| {
            (means[index + 1] - means[index] * means[index]).max(0.0).sqrt() as f32
        };
        let rgb = [0, 1, 2].map(|channel| bank.rgb[3 * pixel + channel]);
        let mean = |means: &Sums, channel: usize| means[channel] as f32;
        let luma = around.map(|pixel| bank.luma[pixel]);
        let smooth = around.map(|pixel| self.smooth(pixel));
        let log_depth = around.map(|pixel| bank.log_depth(pixel));
        let horizontal = |[left, right, _, _]: [f32; 4]| 0.5 * (right - left);
        let vertical = |[_, _, up, down]: [f32; 4]| 0.5 * (down - up);
        let laplacian = |around: [f32; 4], centre: f32| 0.25 * around.iter().sum::<f32>() - centre;
        let centred = |i: usize, n: usize| (2 * i + 1) as f32 / n as f32 - 1.0;
        let [red, green, blue] = rgb;
        let [three, seven, fifteen] = &means;
        [
            red,
            green,
            blue,
            mean(three, 0),
            mean(three, 1),
            mean(three, 2),
            mean(seven, 0),
            mean(seven, 1),
            mean(seven, 2),
            mean(fifteen, 0),
            mean(fifteen, 1),
            mean(fifteen, 2),
            deviation(three, LUMA),
            deviation(seven, LUMA),
            deviation(fifteen, LUMA),
            red - mean(seven, 0),
            green - mean(seven, 1),
            blue - mean(seven, 2),
            horizontal(luma),
            vertical(luma),
            horizontal(smooth),
            vertical(smooth),
            laplacian(luma, bank.luma[pixel]),
            laplacian(smooth, mean(seven, LUMA)),
            bank.log_depth(pixel),
            10.0 * horizontal(log_depth),
            10.0 * vertical(log_depth),
            10.0 * deviation(seven, INVERSE_DEPTH),
            bank.confidence[pixel],
            bank.cost[pixel],
            centred(x, bank.width),
            centred(y, bank.height),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Image, Intrinsics};
    use proptest::prelude::*;

    fn view(width: usize, height: usize, data: Vec<f32>) -> View {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 3.0, cy: 2.0, width, height };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        View::new("v", Image::new(width, height, data).unwrap(), camera, None).unwrap()
    }

    #[test]
    fn a_depth_next_to_nothing_or_beyond_all_is_finite_and_spoils_no_other_window() {
        let (width, height) = (40, 3);
        let view = view(width, height, vec![0.5; 3 * width * height]);
        let mut depths: Vec<f32> = (0..width * height).map(|i| 1.0 + (i % 5) as f32).collect();
        let plain = DepthMap::new(width, height, depths.clone()).unwrap();
        for (pixel, depth) in [(0, 1e-40), (1, 1e-30), (2, f32::MAX), (width, f32::MIN_POSITIVE)] {
            depths[pixel] = depth;
        }
        let hostile = DepthMap::new(width, height, depths).unwrap();
        let some = vec![0.5; width * height];
        let pixels: Vec<u32> = (0..(width * height) as u32).collect();
        let [plain, hostile] =
            [&plain, &hostile].map(|depth| Bank::new(&view, depth, &some, &some).unwrap().at(&pixels));
        assert!(hostile.iter().all(|value| value.is_finite()));
        let last = (width - 1) * FEATURE_NAMES.len() + 27;
        assert!(
            (plain[last] - hostile[last]).abs() < 0.01 * plain[last],
            "{} {}",
            plain[last],
            hostile[last]
        );
    }

    #[test]
    fn no_pixels_have_no_rows() {
        let depth = DepthMap::new(1, 1, vec![2.0]).unwrap();
        let view = view(1, 1, vec![0.5; 3]);
        let bank = Bank::new(&view, &depth, &[1.0], &[0.1]).unwrap();
        assert!(bank.at(&[]).is_empty());
        assert_eq!(bank.at(&[0, 0]).len(), 2 * FEATURE_NAMES.len());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn windows_equal_the_plain_sums(width in 1usize..40, height in 1usize..200, seed: u64, chosen in 1usize..30) {
            let mut state = seed;
            let mut random = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 40) as f32 / (1 << 24) as f32
            };
            let n = width * height;
            let view = view(width, height, (0..3 * n).map(|_| random()).collect());
            let depth: Vec<f32> = (0..n).map(|_| (random() - 0.2).max(0.0)).collect();
            let depth = DepthMap::new(width, height, depth).unwrap();
            let pixels: Vec<u32> = (0..chosen).map(|_| (random() * n as f32) as u32 % n as u32).collect();
            let half = vec![0.5; n];
            let bank = Bank::new(&view, &depth, &half, &half).unwrap();
            let found = bank.at(&pixels);
            let mean = |pixel: u32, radius: usize, value: &dyn Fn(usize) -> f64| {
                let (x, y) = (pixel as usize % width, pixel as usize / width);
                let near = |i: &usize| (i % width).abs_diff(x) <= radius && (i / width).abs_diff(y) <= radius;
                let inside: Vec<f64> = (0..n).filter(near).map(value).collect();
                inside.iter().sum::<f64>() / inside.len() as f64
            };
            for (row, &pixel) in found.chunks_exact(FEATURE_NAMES.len()).zip(&pixels) {
                let close = |channel: usize, expected: f64| (f64::from(row[channel]) - expected).abs() < 1e-5 * expected.abs().max(1.0);
                for (size, radius) in RADII.into_iter().enumerate() {
                    for channel in 0..3 {
                        let expected = mean(pixel, radius, &|i| f64::from(bank.rgb[3 * i + channel]));
                        prop_assert!(close(3 + 3 * size + channel, expected));
                    }
                    let middle = mean(pixel, radius, &|i| f64::from(bank.luma[i]));
                    let variance = mean(pixel, radius, &|i| (f64::from(bank.luma[i]) - middle).powi(2));
                    prop_assert!(close(12 + size, variance.sqrt()));
                }
                let middle = mean(pixel, SMOOTH, &|i| f64::from(bank.inverse_depth(i)));
                let variance = mean(pixel, SMOOTH, &|i| (f64::from(bank.inverse_depth(i)) - middle).powi(2));
                prop_assert!(close(27, 10.0 * variance.sqrt()), "{} {}", row[27], 10.0 * variance.sqrt());
                let around = bank.around(pixel as usize);
                let [left, right, up, down] = around.map(|i| f64::from(bank.luma[i]));
                let centre = f64::from(bank.luma[pixel as usize]);
                prop_assert!(close(18, 0.5 * (right - left)) && close(19, 0.5 * (down - up)));
                prop_assert!(close(22, 0.25 * (left + right + up + down) - centre));
                let log_depth = |i: usize| {
                    let depth = f64::from(depth.data()[i]);
                    if depth > 0.0 { (depth / f64::from(bank.median)).ln() } else { 0.0 }
                };
                let [left, right, up, down] = around.map(log_depth);
                prop_assert!(close(24, log_depth(pixel as usize)));
                prop_assert!(close(25, 5.0 * (right - left)) && close(26, 5.0 * (down - up)));
                let [left, right, up, down] = bank.around(pixel as usize).map(|i| mean(i as u32, SMOOTH, &|i| f64::from(bank.luma[i])));
                prop_assert!(close(20, 0.5 * (right - left)) && close(21, 0.5 * (down - up)));
                let smooth = mean(pixel, SMOOTH, &|i| f64::from(bank.luma[i]));
                prop_assert!(close(23, 0.25 * (left + right + up + down) - smooth));
            }
        }
    }
}

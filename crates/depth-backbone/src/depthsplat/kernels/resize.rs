//! Changes of resolution on slices, `[image, row, column, channel]`.

use super::convolution::Maps;
use cpu_kernels::Isa;
use cpu_kernels::rows::mix;
use rayon::prelude::*;

/// The two neighbours of each output position along an axis, and the weight of the second: corners stay corners.
fn axis(input: usize, output: usize) -> Vec<(usize, usize, f32)> {
    let step = if output > 1 { (input - 1) as f32 / (output - 1) as f32 } else { 0.0 };
    let position = |i: usize| {
        let coordinate = i as f32 * step;
        let first = (coordinate.floor() as usize).min(input - 1);
        (first, (first + 1).min(input - 1), coordinate - first as f32)
    };
    (0..output).map(position).collect()
}

/// Bilinear resize that maps corners to corners.
pub(in crate::depthsplat) fn bilinear(x: Maps<'_>, height: usize, width: usize) -> Vec<f32> {
    let (rows, columns) = (axis(x.height, height), axis(x.width, width));
    let isa = Isa::in_use();
    let row = width * x.channels;
    let mut y = vec![0.0; x.count() * height * row];
    y.par_chunks_mut(row).enumerate().for_each_init(
        || vec![0.0; x.width * x.channels],
        |between, (i, y)| {
            let (image, (a, b, weight)) = (i / height, rows[i % height]);
            let line =
                |v: usize| &x.values[(image * x.height + v) * x.width * x.channels..][..x.width * x.channels];
            mix(isa, line(a), line(b), weight, between);
            for (y, &(a, b, weight)) in y.chunks_exact_mut(x.channels).zip(&columns) {
                let pixel = |u: usize| &between[u * x.channels..][..x.channels];
                mix(isa, pixel(a), pixel(b), weight, y);
            }
        },
    );
    y
}

/// Every pixel `factor` x `factor` times.
pub(in crate::depthsplat) fn nearest(x: Maps<'_>, factor: usize) -> Vec<f32> {
    let row = x.width * factor * x.channels;
    let mut y = vec![0.0; x.count() * x.height * factor * row];
    y.par_chunks_mut(row).enumerate().for_each(|(i, y)| {
        let (image, v) = (i / (x.height * factor), i % (x.height * factor) / factor);
        for (u, y) in y.chunks_exact_mut(x.channels).enumerate() {
            y.copy_from_slice(x.pixel(image, v, u / factor));
        }
    });
    y
}

/// `[.., factor, factor, channels]` per pixel to `factor` x `factor` pixels: the end of a transposed convolution whose
/// windows do not overlap.
pub(in crate::depthsplat) fn spread(x: Maps<'_>, factor: usize) -> Vec<f32> {
    let channels = x.channels / (factor * factor);
    let row = x.width * factor * channels;
    let mut y = vec![0.0; x.values.len()];
    y.par_chunks_mut(row).enumerate().for_each(|(i, y)| {
        let (image, v) = (i / (x.height * factor), i % (x.height * factor));
        for (u, y) in y.chunks_exact_mut(factor * channels).enumerate() {
            let part = v % factor * factor * channels;
            y.copy_from_slice(&x.pixel(image, v / factor, u)[part..][..factor * channels]);
        }
    });
    y
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_stay_corners() {
        let values: Vec<f32> = (0..2 * 3 * 4 * 2).map(|i| (i as f32).sin()).collect();
        let x = Maps { values: &values, height: 3, width: 4, channels: 2 };
        assert_eq!(bilinear(x, 3, 4), values);
        let (height, width) = (7, 5);
        let y = bilinear(x, height, width);
        for (image, v, u, c) in
            (0..y.len()).map(|i| (i / 2 / width / height, i / 2 / width % height, i / 2 % width, i % 2))
        {
            let (row, column) = (v as f64 * 2.0 / 6.0, u as f64 * 3.0 / 4.0);
            let sample = |a: usize, b: usize| f64::from(x.pixel(image, a.min(2), b.min(3))[c]);
            let (a, b, p, q) = (row as usize, column as usize, row.fract(), column.fract());
            let expected = (sample(a, b) * (1.0 - q) + sample(a, b + 1) * q) * (1.0 - p)
                + (sample(a + 1, b) * (1.0 - q) + sample(a + 1, b + 1) * q) * p;
            let found = f64::from(y[((image * height + v) * width + u) * 2 + c]);
            assert!((found - expected).abs() < 1e-6, "({v}, {u}): {found}, not {expected}");
        }
        // A single row or pixel has no second neighbour.
        let one = Maps { values: &[3.0], height: 1, width: 1, channels: 1 };
        assert_eq!(bilinear(one, 2, 3), [3.0; 6]);
        assert_eq!(bilinear(Maps { height: 1, width: 2, values: &[1.0, 2.0], channels: 1 }, 1, 1), [1.0]);
    }

    #[test]
    fn pixels_are_repeated_or_spread() {
        let x = Maps { values: &[1.0, 2.0, 3.0, 4.0], height: 1, width: 1, channels: 4 };
        assert_eq!(spread(x, 2), [1.0, 2.0, 3.0, 4.0]);
        let x = Maps { values: &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], height: 1, width: 2, channels: 4 };
        assert_eq!(spread(x, 2), [1.0, 2.0, 5.0, 6.0, 3.0, 4.0, 7.0, 8.0]);
        let x = Maps { values: &[1.0, 2.0, 3.0, 4.0], height: 2, width: 1, channels: 2 };
        assert_eq!(
            nearest(x, 2),
            [1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 3.0, 4.0, 3.0, 4.0]
        );
    }
}

//! Normalisations on slices, `[image, pixel, channel]`.

use cpu_kernels::{Activation, Isa, LayerNorm, Rows, rows};
use rayon::prelude::*;

/// Pixels whose moments are taken at a time, and per task of the second pass.
const STRIP: usize = 64;

/// (x - mean) / sqrt(variance + eps) · weight + bias along each row of `weight.len()` channels.
pub(in crate::depthsplat) fn layer_norm(x: &[f32], weight: &[f32], bias: &[f32], eps: f32) -> Vec<f32> {
    let norm = LayerNorm { weight, bias, epsilon: eps };
    let (isa, strip) = (Isa::in_use(), weight.len() * STRIP);
    let mut y = vec![0.0; x.len()];
    y.par_chunks_mut(strip).zip(x.par_chunks(strip)).for_each(|(y, x)| norm.apply(isa, x, y));
    y
}

/// Normalisation over all pixels of an image, per group of channels.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct GroupNorm<'a> {
    pub(in crate::depthsplat) channels: usize,
    pub(in crate::depthsplat) groups: usize,
    /// Weight and bias, `[channels]` each.
    pub(in crate::depthsplat) affine: Option<(&'a [f32], &'a [f32])>,
    pub(in crate::depthsplat) eps: f64,
    pub(in crate::depthsplat) activation: Activation,
    /// Added last, and followed by a ReLU.
    pub(in crate::depthsplat) residual: Option<&'a [f32]>,
}

/// Mean and sum of squared deviations of a number of values.
#[derive(Clone, Copy, Default)]
struct Moments {
    count: f64,
    mean: f64,
    deviations: f64,
}

impl Moments {
    /// Those of both sets (Chan, Golub, LeVeque 1979).
    fn joined(self, other: Self) -> Self {
        let count = self.count + other.count;
        if count == 0.0 {
            return self;
        }
        let apart = other.mean - self.mean;
        Self {
            count,
            mean: self.mean + apart * other.count / count,
            deviations: self.deviations + other.deviations + apart * apart * self.count * other.count / count,
        }
    }
}

impl GroupNorm<'_> {
    /// The normalisation of images of `pixels` pixels.
    pub(in crate::depthsplat) fn apply(&self, x: &[f32], pixels: usize) -> Vec<f32> {
        let isa = Isa::in_use();
        let image = pixels * self.channels;
        let strip = STRIP * self.channels;
        let mut y = vec![0.0; x.len()];
        y.par_chunks_mut(image).zip(x.par_chunks(image)).enumerate().for_each(|(i, (y, x))| {
            let (mean, factor) = self.statistics(x);
            y.par_chunks_mut(strip).zip(x.par_chunks(strip)).enumerate().for_each(|(s, (y, x))| {
                rows::scale_apart(isa, x, &mean, &factor, y);
                if let Some((_, bias)) = self.affine {
                    rows::add_to_each(isa, y, bias);
                }
                self.activation.apply(isa, y);
                if let Some(residual) = self.residual {
                    rows::add_and_clip(isa, y, &residual[i * image + s * strip..][..y.len()]);
                }
            });
        });
        y
    }

    /// Mean and factor, per channel.
    fn statistics(&self, x: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let parts: Vec<Vec<Moments>> =
            x.par_chunks(STRIP * self.channels).map(|strip| moments(strip, self.channels)).collect();
        let of_channel = |c: usize| parts.iter().fold(Moments::default(), |sum, part| sum.joined(part[c]));
        let per_group = self.channels / self.groups;
        let (mut mean, mut factor) = (Vec::new(), Vec::new());
        for group in 0..self.groups {
            let all = (group * per_group..(group + 1) * per_group)
                .fold(Moments::default(), |sum, c| sum.joined(of_channel(c)));
            let scale = 1.0 / (all.deviations / all.count + self.eps).sqrt();
            for c in group * per_group..(group + 1) * per_group {
                mean.push(all.mean as f32);
                factor.push((scale * self.affine.map_or(1.0, |(weight, _)| f64::from(weight[c]))) as f32);
            }
        }
        (mean, factor)
    }
}

/// Moments of each channel of a few pixels.
fn moments(x: &[f32], channels: usize) -> Vec<Moments> {
    let (isa, pixels) = (Isa::in_use(), Rows::new(x, x.len() / channels, channels));
    let count = pixels.count() as f32;
    let (mut mean, mut deviations) = (vec![0.0_f32; channels], vec![0.0_f32; channels]);
    rows::add_sum(isa, pixels, &mut mean);
    mean.iter_mut().for_each(|v| *v /= count);
    rows::add_squares(isa, pixels, &mean, &mut deviations);
    let moments = |(&mean, &deviations): (&f32, &f32)| Moments {
        count: count.into(),
        mean: mean.into(),
        deviations: deviations.into(),
    };
    mean.iter().zip(&deviations).map(moments).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn normalised(values: &[f64], eps: f64) -> Vec<f64> {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        values.iter().map(|v| (v - mean) / (variance + eps).sqrt()).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn norms_agree_with_the_definition(
            pixels in 2_usize..200, groups in 1_usize..5, per_group in 1_usize..9, images in 1_usize..3, seed: u32,
        ) {
            let channels = groups * per_group;
            let value = |i: usize| {
                let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
                ((mixed ^ (mixed >> 15)) >> 8) as f32 / 8_388_608.0 - 0.2
            };
            let x: Vec<f32> = (0..images * pixels * channels).map(value).collect();
            let weight: Vec<f32> = (0..channels).map(|i| value(i + 4242)).collect();
            let bias: Vec<f32> = (0..channels).map(|i| value(i + 8484)).collect();
            let norm = GroupNorm {
                channels, groups, affine: Some((&weight, &bias)), eps: 1e-5,
                activation: Activation::Identity, residual: None,
            };
            let found = norm.apply(&x, pixels);
            let with_residual = GroupNorm { residual: Some(&x), ..norm }.apply(&x, pixels);
            for (image, group) in (0..images * groups).map(|i| (i / groups, i % groups)) {
                let places: Vec<usize> = (0..pixels * per_group)
                    .map(|i| (image * pixels + i / per_group) * channels + group * per_group + i % per_group)
                    .collect();
                let values: Vec<f64> = places.iter().map(|&p| f64::from(x[p])).collect();
                for (&p, v) in places.iter().zip(normalised(&values, 1e-5)) {
                    let expected = v * f64::from(weight[p % channels]) + f64::from(bias[p % channels]);
                    prop_assert!((f64::from(found[p]) - expected).abs() < 2e-5);
                    let clipped = (expected + f64::from(x[p])).max(0.0);
                    prop_assert!((f64::from(with_residual[p]) - clipped).abs() < 2e-5);
                }
            }
            let found = layer_norm(&x, &weight, &bias, 1e-6);
            for (row, found) in x.chunks_exact(channels).zip(found.chunks_exact(channels)) {
                let row: Vec<f64> = row.iter().map(|&v| f64::from(v)).collect();
                // A row of nearly equal values magnifies the rounding of its mean.
                let spread = row.iter().fold(0.0_f64, |s, v| s.max((v - row[0]).abs()));
                for (c, v) in normalised(&row, 1e-6).iter().enumerate() {
                    let expected = v * f64::from(weight[c]) + f64::from(bias[c]);
                    let tolerance = 2e-5 * (1.0 + 0.1 / (spread + 1e-3));
                    prop_assert!((f64::from(found[c]) - expected).abs() < tolerance);
                }
            }
        }
    }
}

//! Floors of what a mean gradient is divided by: a multiple of its kind's typical size.
//!
//! Adam alone moves every number by its rate, whatever its gradient. A Gaussian of which views show little then moves as far as one that
//! fills them, on the word of a few pixels. A floor makes its step small, as plain gradient descent does.

use crate::adam::{Means, Moments};
use crate::limits::Limits;
use gs_raster::Gradients;
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, sh_coefficients};
use rayon::prelude::*;
use std::ops::Range;

/// Gaussians per parallel task: sums are taken task by task, in the same order on any number of threads.
const ROWS: usize = 1 << 12;

/// Kinds of parameters, in the columns of a row of geometry.
const KINDS: [Range<usize>; 4] = [MEAN, QUATERNION, LOG_SCALE, OPACITY_LOGIT..OPACITY_LOGIT + 1];

/// The floor of every kind. Of means by a pixel's width at the Gaussian, as their rates.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Floors {
    geometry: [f32; KINDS.len()],
    pub(crate) colour: f32,
}

impl Floors {
    /// `damping` times the mean size over the Gaussians that have had a gradient. Moments are those before the update by `gradients`.
    pub(crate) fn new(
        damping: f32,
        gradients: &Gradients,
        (geometry, sh): (&Moments, &Moments),
        limits: &[Limits],
        means: Means,
    ) -> Self {
        if damping == 0.0 {
            return Self::default();
        }
        const WIDTH: usize = Gaussians::GEOMETRY;
        let rows = gradients.geometry.par_chunks(ROWS * WIDTH).zip(geometry.second.par_chunks(ROWS * WIDTH));
        let sums: Vec<([f64; KINDS.len()], usize)> = rows
            .zip(limits.par_chunks(ROWS))
            .map(|((gradients, second), limits)| {
                let (mut sums, mut count) = ([0.0; KINDS.len()], 0);
                let rows = gradients.chunks_exact(WIDTH).zip(second.chunks_exact(WIDTH)).zip(limits);
                for ((gradients, second), limits) in rows {
                    let size = |column: usize| f64::from(means.size(second[column], gradients[column]));
                    for (sum, (kind, columns)) in sums.iter_mut().zip(KINDS.iter().enumerate()) {
                        let unit = if kind == 0 { f64::from(limits.footprint) } else { 1.0 };
                        let width = columns.len() as f64;
                        *sum += unit * columns.clone().map(size).sum::<f64>() / width;
                    }
                    count += usize::from(size(OPACITY_LOGIT) > 0.0);
                }
                (sums, count)
            })
            .collect();
        let row = gradients.sh.len() / limits.len().max(1);
        debug_assert!((0..=3).any(|degree| row == sh_coefficients(degree) * 3) || limits.is_empty());
        let of_colours: Vec<f64> = gradients
            .sh
            .par_chunks(ROWS * row.max(1))
            .zip(sh.second.par_chunks(ROWS * row.max(1)))
            .map(|(gradients, second)| {
                let rows = gradients.chunks_exact(row).zip(second.chunks_exact(row));
                let size = |(gradients, second): (&[f32], &[f32])| {
                    (0..3).map(|c| f64::from(means.size(second[c], gradients[c]))).sum::<f64>() / 3.0
                };
                rows.map(size).sum()
            })
            .collect();
        let count = sums.iter().map(|(_, count)| count).sum::<usize>().max(1) as f64;
        let floor = |sum: f64| (f64::from(damping) * sum / count) as f32;
        Self {
            geometry: std::array::from_fn(|kind| floor(sums.iter().map(|(sums, _)| sums[kind]).sum())),
            colour: floor(of_colours.iter().sum()),
        }
    }

    /// Fills the floors of a row of geometry.
    pub(crate) fn fill(&self, footprint: f32, row: &mut [f32]) {
        for (floor, columns) in self.geometry.iter().zip(KINDS) {
            row[columns].fill(*floor);
        }
        // A Gaussian without a width moves nowhere, whatever the floor.
        if footprint > 0.0 {
            row[MEAN].iter_mut().for_each(|floor| *floor /= footprint);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{cameras, photographs, wall};

    #[test]
    fn a_floor_is_a_multiple_of_the_mean_size_whatever_the_unit_of_length() {
        let scene = wall(6, 1.0);
        let views = photographs(&scene, &cameras(2, (40, 32), 1.0));
        let limits = Limits::of_scene(&scene, &views, 1.0);
        let n = scene.len();
        let row: Vec<f32> = (0..Gaussians::GEOMETRY).map(|column| column as f32 + 1.0).collect();
        // Every second Gaussian is in no picture.
        let geometry =
            (0..n).flat_map(|i| row.iter().map(move |g| if i % 2 == 0 { *g } else { 0.0 })).collect();
        let sh = (0..n).flat_map(|i| [if i % 2 == 0 { -2.0 } else { 0.0 }; 3]).collect();
        let mut rasterizer = gs_raster::Rasterizer::cpu();
        let (_, tape) = rasterizer.record(&scene, &[*views[0].camera()], &Default::default()).unwrap();
        let image = vec![0.0; 40 * 32 * 3];
        let pixels = gs_raster::PixelGradients { image: image.into(), alpha: None, depth: None };
        let mut gradients = rasterizer.backward(&scene, &tape, &[pixels]).unwrap();
        (gradients.geometry, gradients.sh) = (geometry, sh);
        let moments = (&Moments::new(n * Gaussians::GEOMETRY), &Moments::new(scene.sh().len()));
        let means = Means::of_step(1, 0.5);
        let floors = Floors::new(3.0, &gradients, moments, &limits, means);
        let width: f32 = limits.iter().step_by(2).map(|l| l.footprint).sum::<f32>() / n.div_ceil(2) as f32;
        let mut filled = [0.0; Gaussians::GEOMETRY];
        floors.fill(width, &mut filled);
        let near = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-3;
        assert!(near(filled[0], 3.0 * 2.0), "{filled:?}");
        assert!(near(filled[3], 3.0 * 5.5) && near(filled[7], 3.0 * 9.0) && near(filled[10], 3.0 * 11.0));
        assert!(near(floors.colour, 6.0));
        let none = Floors::new(0.0, &gradients, moments, &limits, means);
        assert_eq!((none.geometry, none.colour), ([0.0; 4], 0.0));
    }
}

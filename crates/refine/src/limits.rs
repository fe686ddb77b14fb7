//! Limits of a Gaussian's parameters, and the reach of a step of its mean.

use glam::DVec3;
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, View};
use rayon::prelude::*;

/// Smallest standard deviation, in pixels of the nearest view. The low-pass filter of the renderer (0.55 px)
/// hides what is finer.
const SMALLEST: f32 = 1e-2;
/// Opacity logits lie between the negative of this and this: between 1e-4 and 1 - 1e-4.
const LOGIT: f32 = 9.2;

/// Per Gaussian, what its numbers are measured by.
#[derive(Debug, Clone)]
pub(crate) struct Limits {
    /// Width of a pixel at the Gaussian, scene units, in the view that is nearest to it; 0 if it lies behind
    /// all of them or nowhere: it does not move then.
    pub(crate) footprint: f32,
    log_scale: (f32, f32),
    logit: (f32, f32),
}

impl Limits {
    /// Of every Gaussian as it is at the start. What lies beyond a limit then may stay there. `largest` is that of
    /// [`Config`](crate::Config::largest).
    pub(crate) fn of_scene(gaussians: &Gaussians, views: &[View], largest: f32) -> Vec<Self> {
        let rows = gaussians.geometry().par_chunks_exact(Gaussians::GEOMETRY);
        rows.map(|row| Self::of_row(row, views, largest)).collect()
    }

    fn of_row(row: &[f32], views: &[View], largest: f32) -> Self {
        let mean = DVec3::from_slice(&[row[0], row[1], row[2]].map(f64::from));
        let (mut footprint, mut nearest) = (f64::INFINITY, f64::INFINITY);
        for view in views {
            let lens = view.camera().intrinsics();
            let depth = view.camera().to_camera(mean).z;
            let width = depth / (lens.fx * lens.fy).sqrt();
            if depth > 0.0 && width < footprint {
                (footprint, nearest) = (width, depth);
            }
        }
        if !(footprint as f32).is_finite() {
            (footprint, nearest) = (0.0, 0.0);
        }
        let (low, high) = ((footprint as f32 * SMALLEST).ln(), (nearest as f32 * largest).ln());
        // Of 0 the logarithm is -∞: the bounds then are what the Gaussian has.
        let scales = &row[LOG_SCALE];
        let least = scales.iter().copied().fold(if low.is_finite() { low } else { f32::INFINITY }, f32::min);
        let most = scales.iter().copied().fold(high, f32::max);
        let logit = row[OPACITY_LOGIT];
        Self {
            footprint: footprint as f32,
            log_scale: (least, most),
            logit: (logit.min(-LOGIT), logit.max(LOGIT)),
        }
    }

    /// Brings the row of a Gaussian that has been moved back within the limits; its quaternion becomes a unit
    /// one, so that rates of rotation are angles.
    pub(crate) fn apply(&self, row: &mut [f32]) {
        let norm = row[QUATERNION].iter().map(|q| q * q).sum::<f32>().sqrt();
        if norm.is_normal() {
            row[QUATERNION].iter_mut().for_each(|q| *q /= norm);
        }
        // Not `clamp`, which panics on the NaN of a Gaussian that never was one.
        let within = |value: f32, (low, high): (f32, f32)| value.max(low).min(high);
        row[LOG_SCALE].iter_mut().for_each(|s| *s = within(*s, self.log_scale));
        row[OPACITY_LOGIT] = within(row[OPACITY_LOGIT], self.logit);
    }
}

/// Fills the step sizes of a row.
pub(crate) fn row_rates(rates: &crate::Rates, factor: f32, footprint: f32, row: &mut [f32]) {
    row[MEAN].fill(factor * rates.mean * footprint);
    row[QUATERNION].fill(factor * rates.rotation);
    row[LOG_SCALE].fill(factor * rates.scale);
    row[OPACITY_LOGIT] = factor * rates.opacity;
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use gs_scene::{Camera, Image, Intrinsics};

    fn views() -> Vec<View> {
        let lens = Intrinsics { fx: 50.0, fy: 200.0, cx: 4.0, cy: 4.0, width: 8, height: 8 };
        let view = |z: f64| {
            let camera =
                Camera::from_camera_to_world(lens, DMat3::IDENTITY, DVec3::new(0.0, 0.0, z)).unwrap();
            View::new("v", Image::filled(8, 8, [0.0; 3]).unwrap(), camera, None).unwrap()
        };
        vec![view(-8.0), view(0.0)]
    }

    fn row(z: f32, log_scale: f32, logit: f32) -> [f32; 11] {
        [0.0, 0.0, z, 2.0, 0.0, 0.0, 0.0, log_scale, log_scale, log_scale, logit]
    }

    #[test]
    fn a_footprint_is_that_of_the_nearest_view() {
        let views = views();
        assert_eq!(Limits::of_row(&row(2.0, 0.0, 0.0), &views, 1.0).footprint, 0.02);
        // Behind the second view, in front of the first.
        assert_eq!(Limits::of_row(&row(-3.0, 0.0, 0.0), &views, 1.0).footprint, 0.05);
        for lost in [-9.0, f32::NAN, f32::INFINITY] {
            assert_eq!(Limits::of_row(&row(lost, 0.0, 0.0), &views, 1.0).footprint, 0.0, "{lost}");
        }
    }

    #[test]
    fn nothing_leaves_its_limits_and_what_is_beyond_stays() {
        let views = views();
        let limits = Limits::of_row(&row(2.0, -3.0, 0.0), &views, 1.0);
        let mut grown = row(2.0, 50.0, 99.0);
        limits.apply(&mut grown);
        assert_eq!((grown[7], grown[10]), (2.0f32.ln(), 9.2));
        assert_eq!(grown[3], 1.0);
        Limits::of_row(&row(2.0, -3.0, 0.0), &views, 0.1).apply(&mut grown);
        assert_eq!(grown[7], 0.2f32.ln());
        let mut shrunk = row(2.0, -50.0, -99.0);
        limits.apply(&mut shrunk);
        assert_eq!((shrunk[7], shrunk[10]), ((0.02f32 * 0.01).ln(), -9.2));
        for beyond in [row(2.0, 50.0, 99.0), row(2.0, -50.0, -99.0), row(-20.0, -1.0, 1.0)] {
            let mut found = beyond;
            Limits::of_row(&beyond, &views, 1.0).apply(&mut found);
            assert_eq!(found[7..], beyond[7..]);
        }
        let mut nowhere = [f32::NAN; 11];
        limits.apply(&mut nowhere);
    }
}

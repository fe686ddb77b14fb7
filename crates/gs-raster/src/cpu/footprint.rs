//! The EWA projection of a Gaussian (Zwicker et al. 2001), shared by the pass forward and the pass backward.
//!
//! In f64, and rounded once by the callers: scenes far from the origin, needles and huge scales keep their precision. No
//! branches and no calls, so that loops over Gaussians become vector instructions. A Gaussian that is not drawn gives an arbitrary
//! number, possibly NaN.

use super::math;
use crate::activated::inside;
use crate::{Activated, RenderSettings, SLOPE_MARGIN};
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Camera, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION};
use std::f64::consts::LOG2_E;

/// Gaussians that go through the arithmetic together.
pub(super) const BLOCK: usize = 64;
/// Added to the squared Mahalanobis distance that bounds a footprint: far above the rounding of the blending stage,
/// which takes the decision itself, and too small to cost anything.
const BOUND_SLACK: f64 = 1e-3;
/// Longest standard deviation of a footprint, pixels. Longer axes are shortened, not thickened: over an image, no
/// falloff changes by more than rounding, and the footprint's numbers and their squares fit f32. What is centred so much
/// farther outside than this is not drawn.
const SIGMA_MAX: f64 = 1e12;

/// log₂ of the alpha at which footprints end.
pub(super) fn log2_alpha_bound(settings: &RenderSettings) -> f32 {
    (-0.5 * LOG2_E * bound_max(settings)) as f32
}

/// Squared Mahalanobis distance that bounds the footprint of an opaque Gaussian.
fn bound_max(settings: &RenderSettings) -> f64 {
    -2.0 * f64::from(settings.alpha_min).ln() + BOUND_SLACK
}

/// What is the same for all Gaussians of a view.
#[derive(Clone, Copy)]
pub(super) struct View {
    pub(super) rotation: DMat3,
    pub(super) translation: DVec3,
    /// Camera centre, world.
    pub(super) position: DVec3,
    /// In x and y, pixels; as is the principal point `centre`.
    pub(super) focal: [f64; 2],
    pub(super) centre: [f64; 2],
    pub(super) size: [f64; 2],
    /// Least and largest x/z and y/z at which the Jacobian is evaluated: the image and 15 % of its size around it.
    slope_min: [f64; 2],
    slope_max: [f64; 2],
    /// Least and largest z-depth of a centre that is drawn, exclusive. At most what f32 can hold.
    pub(super) near: f64,
    pub(super) far: f64,
    pub(super) alpha_min: f64,
    pub(super) eps2d: f64,
    pub(super) antialias: bool,
    /// Least factor of the compensation.
    compensation_min: f64,
    /// See [`bound_max`].
    pub(super) bound_max: f64,
}

impl View {
    pub(super) fn new(camera: &Camera, settings: &RenderSettings) -> Self {
        let lens = camera.intrinsics();
        let (focal, centre) = ([lens.fx, lens.fy], [lens.cx, lens.cy]);
        let size = [lens.width as f64, lens.height as f64];
        let margin = |axis: usize| SLOPE_MARGIN * size[axis] / focal[axis];
        Self {
            rotation: camera.rotation(),
            translation: camera.translation(),
            position: camera.position(),
            focal,
            centre,
            size,
            slope_min: [0, 1].map(|axis| -centre[axis] / focal[axis] - margin(axis)),
            slope_max: [0, 1].map(|axis| (size[axis] - centre[axis]) / focal[axis] + margin(axis)),
            near: f64::from(settings.near),
            far: f64::from(settings.far.min(f32::MAX)),
            alpha_min: f64::from(settings.alpha_min),
            eps2d: f64::from(settings.eps2d),
            antialias: settings.antialias,
            compensation_min: f64::from(settings.compensation_min),
            bound_max: bound_max(settings),
        }
    }

    /// The slope at which the Jacobian is evaluated.
    #[inline(always)]
    pub(super) fn clamp(&self, axis: usize, slope: f64) -> f64 {
        slope.max(self.slope_min[axis]).min(self.slope_max[axis])
    }

    /// Whether what reaches `extent` pixels around `centre` misses every pixel centre.
    #[inline(always)]
    pub(super) fn is_outside(&self, axis: usize, centre: f64, extent: f64) -> bool {
        (centre + extent < 0.5) | (centre - extent > self.size[axis] - 0.5)
    }
}

/// The geometry of some Gaussians, column by column, as their source holds it: scales and opacity, or their logarithms and logit.
#[derive(Clone, Copy)]
pub(super) struct Columns {
    numbers: [[f32; BLOCK]; Gaussians::GEOMETRY],
    /// Whether they are scales and opacity.
    pub(super) is_activated: bool,
}

/// Scales and opacities of the Gaussians of [`Columns`].
pub(super) struct Activations {
    /// Standard deviations along the three axes, scene units.
    scales: [[f64; BLOCK]; 3],
    opacities: [f64; BLOCK],
    /// The derivative of the logarithm of the opacity by the number that the source holds.
    by_number: [f64; BLOCK],
}

impl Columns {
    pub(super) fn new(is_activated: bool) -> Self {
        Self { numbers: [[0.0; BLOCK]; Gaussians::GEOMETRY], is_activated }
    }

    /// Puts a row of stored geometry at `place`.
    #[inline(always)]
    pub(super) fn set(&mut self, place: usize, row: &[f32]) {
        let row: &[f32; Gaussians::GEOMETRY] = row.try_into().expect("a row of geometry");
        self.set_numbers(place, row.iter());
    }

    /// Puts an activated Gaussian at `place`.
    #[inline(always)]
    pub(super) fn set_activated(&mut self, place: usize, gaussians: &Activated<'_>, gaussian: usize) {
        let mean = &gaussians.means[3 * gaussian..][..3];
        let quat = &gaussians.quats[4 * gaussian..][..4];
        let scale = &gaussians.scales[3 * gaussian..][..3];
        let opacity = &gaussians.opacities[gaussian];
        self.set_numbers(place, mean.iter().chain(quat).chain(scale).chain([opacity]));
    }

    #[inline(always)]
    fn set_numbers<'a>(&mut self, place: usize, numbers: impl Iterator<Item = &'a f32>) {
        for (column, number) in self.numbers.iter_mut().zip(numbers) {
            column[place] = *number;
        }
    }

    /// Moves a row to an earlier place.
    #[inline(always)]
    pub(super) fn copy(&mut self, from: usize, to: usize) {
        for column in &mut self.numbers {
            column[to] = column[from];
        }
    }

    /// Whether every number at `place` is finite.
    #[inline(always)]
    pub(super) fn is_finite(&self, place: usize) -> bool {
        let mut zero = 0.0;
        for column in &self.numbers {
            zero += column[place] * 0.0;
        }
        zero == 0.0
    }

    #[inline(always)]
    fn vector(&self, first: usize, place: usize) -> DVec3 {
        let column = |k: usize| f64::from(self.numbers[first + k][place]);
        DVec3::new(column(0), column(1), column(2))
    }

    #[inline(always)]
    pub(super) fn mean(&self, place: usize) -> DVec3 {
        self.vector(MEAN.start, place)
    }

    #[inline(always)]
    pub(super) fn quaternion(&self, place: usize) -> DQuat {
        let column = |k: usize| f64::from(self.numbers[QUATERNION.start + k][place]);
        DQuat::from_xyzw(column(1), column(2), column(3), column(0))
    }

    /// The largest scale of each Gaussian.
    #[inline(always)]
    pub(super) fn largest_scales(&self) -> [f64; BLOCK] {
        let mut found = [0.0; BLOCK];
        for (place, found) in found.iter_mut().enumerate() {
            *found = self.vector(LOG_SCALE.start, place).max_element();
        }
        if !self.is_activated {
            found.iter_mut().for_each(|number| *number = math::exp(*number));
        }
        found
    }

    /// Scales and opacities: exp of what is stored, and its sigmoid.
    #[inline(always)]
    pub(super) fn activate(&self) -> Activations {
        let mut found =
            Activations { scales: [[0.0; BLOCK]; 3], opacities: [0.0; BLOCK], by_number: [0.0; BLOCK] };
        let Activations { scales, opacities, by_number } = &mut found;
        let numbers = &self.numbers[OPACITY_LOGIT];
        let columns = scales.iter_mut().zip(&self.numbers[LOG_SCALE]);
        if self.is_activated {
            columns.for_each(|(scales, numbers)| {
                scales.iter_mut().zip(numbers).for_each(|(scale, number)| *scale = f64::from(*number));
            });
            for place in 0..BLOCK {
                opacities[place] = inside(numbers[place]);
                by_number[place] = opacities[place].recip();
            }
        } else {
            columns.for_each(|(scales, numbers)| {
                scales
                    .iter_mut()
                    .zip(numbers)
                    .for_each(|(scale, number)| *scale = math::exp(f64::from(*number)));
            });
            for place in 0..BLOCK {
                let e = math::exp(-f64::from(numbers[place]));
                opacities[place] = (1.0 + e).recip();
                // One less the opacity.
                by_number[place] = e * opacities[place];
            }
        }
        found
    }
}

impl Activations {
    #[inline(always)]
    fn scale(&self, place: usize) -> DVec3 {
        DVec3::new(self.scales[0][place], self.scales[1][place], self.scales[2][place])
    }

    /// The derivative of the logarithm of the opacity by the number that the source holds.
    #[inline(always)]
    pub(super) fn log_opacity_by_number(&self, place: usize) -> f64 {
        self.by_number[place]
    }
}

/// One Gaussian as one view sees it, before anything is bounded.
pub(super) struct Footprint {
    /// The mean in camera axes.
    pub(super) mean: DVec3,
    pub(super) inverse_z: f64,
    /// x/z and y/z, as they are and as they enter the Jacobian.
    pub(super) slope: [f64; 2],
    pub(super) clamped: [f64; 2],
    /// Length of the given quaternion, which is of unit length in `quaternion`.
    pub(super) norm: f64,
    pub(super) quaternion: DQuat,
    /// Columns: the Gaussian's axes in the world.
    pub(super) axes: DMat3,
    /// Standard deviations as given and as drawn, see [`SIGMA_MAX`].
    pub(super) given_scale: DVec3,
    pub(super) scale: DVec3,
    /// Rows of J · Rv, J the Jacobian of the projection: in the world's axes and in the Gaussian's.
    pub(super) jacobian: [DVec3; 2],
    pub(super) turned: [DVec3; 2],
    /// Rows of V = J · Rv · R · S.
    pub(super) rows: [DVec3; 2],
    /// Determinants of V Vᵀ and of the 2D covariance [a b; b c].
    pub(super) det0: f64,
    pub(super) det: f64,
    pub(super) a: f64,
    pub(super) b: f64,
    pub(super) c: f64,
    /// Opacity as given, and what compensates it for the low-pass filter.
    pub(super) opacity: f64,
    pub(super) compensation: f64,
    /// Whether the compensation is that of the footprint, not the least one.
    pub(super) compensates: bool,
}

impl Footprint {
    #[inline(always)]
    pub(super) fn new(view: &View, columns: &Columns, activations: &Activations, place: usize) -> Self {
        let mean = view.rotation * columns.mean(place) + view.translation;
        let inverse_z = mean.z.recip();
        let slope = [mean.x * inverse_z, mean.y * inverse_z];
        let clamped = [view.clamp(0, slope[0]), view.clamp(1, slope[1])];

        let quaternion = columns.quaternion(place);
        let norm = quaternion.length();
        let quaternion = quaternion * norm.recip();
        let axes = DMat3::from_quat(quaternion);
        let given_scale = activations.scale(place);
        let scale = given_scale.min(DVec3::splat(SIGMA_MAX * mean.z / view.focal[0].max(view.focal[1])));

        let forward = view.rotation.row(2);
        // No closures over arrays here: those are not always inlined.
        let j0 = (view.rotation.row(0) - forward * clamped[0]) * (view.focal[0] * inverse_z);
        let j1 = (view.rotation.row(1) - forward * clamped[1]) * (view.focal[1] * inverse_z);
        let t0 = DVec3::new(j0.dot(axes.x_axis), j0.dot(axes.y_axis), j0.dot(axes.z_axis));
        let t1 = DVec3::new(j1.dot(axes.x_axis), j1.dot(axes.y_axis), j1.dot(axes.z_axis));
        let (u, v) = (t0 * scale, t1 * scale);
        // The determinant as a sum of positive terms (Cauchy–Binet), because a c - b² cancels for needles.
        let (a0, b, c0) = (u.length_squared(), u.dot(v), v.length_squared());
        let det0 = u.cross(v).length_squared();
        let eps = view.eps2d;
        let det = det0 + eps * (a0 + c0) + eps * eps;

        let ratio = (det0 / det).sqrt();
        let least = if view.antialias { view.compensation_min } else { 1.0 };
        let compensates = view.antialias & (ratio > least);
        let compensation = if compensates { ratio } else { least };
        Self {
            mean,
            inverse_z,
            slope,
            clamped,
            norm,
            quaternion,
            axes,
            given_scale,
            scale,
            jacobian: [j0, j1],
            turned: [t0, t1],
            rows: [u, v],
            det0,
            det,
            a: a0 + eps,
            b,
            c: c0 + eps,
            opacity: activations.opacities[place],
            compensation,
            compensates,
        }
    }
}

//! The EWA projection of a Gaussian (Zwicker et al. 2001), shared by the pass forward and the pass backward.
//!
//! In f64, and rounded once by the callers: scenes far from the origin, needles and huge scales keep their precision. In vectors of
//! several Gaussians, without branches. A Gaussian that is not drawn gives an arbitrary number, possibly NaN.

use super::math;
use super::vector3::Vector3;
use crate::activated::OPACITIES;
use crate::{Activated, RenderSettings, SLOPE_MARGIN};
use cpu_kernels::lanes::{F64s, Lanes, Mask};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION};
use std::f64::consts::LOG2_E;

/// Gaussians that are taken from their source together; a multiple of the lanes of every instruction set.
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
    pub(super) fn clamp<S: Lanes>(&self, axis: usize, slope: F64s<S>) -> F64s<S> {
        slope.clamp(self.slope_min[axis], self.slope_max[axis])
    }

    /// Whether what reaches `extent` pixels around `centre` misses every pixel centre.
    #[inline(always)]
    pub(super) fn is_outside<S: Lanes>(&self, axis: usize, centre: F64s<S>, extent: F64s<S>) -> Mask<S> {
        let end = centre.all(self.size[axis] - 0.5);
        (centre + extent).is_below(centre.all(0.5)) | end.is_below(centre - extent)
    }

    /// A camera axis in the world: a row of the rotation, the same in every lane.
    #[inline(always)]
    pub(super) fn row<S: Lanes>(&self, simd: S, axis: usize) -> Vector3<S> {
        Vector3::splat(simd, self.rotation.row(axis))
    }

    /// Turns a vector of the world into camera axes.
    #[inline(always)]
    pub(super) fn turn<S: Lanes>(&self, v: Vector3<S>) -> Vector3<S> {
        let simd = v.x.simd();
        Vector3::new(self.row(simd, 0).dot(v), self.row(simd, 1).dot(v), self.row(simd, 2).dot(v))
    }

    /// The direction from the camera to a place in the world, and one over the distance.
    #[inline(always)]
    pub(super) fn direction<S: Lanes>(&self, place: Vector3<S>) -> (Vector3<S>, F64s<S>) {
        let offset = place - Vector3::splat(place.x.simd(), self.position);
        let inverse = offset.length_squared().sqrt().recip();
        (offset * inverse, inverse)
    }

    /// Camera coordinates of a place in the world.
    #[inline(always)]
    pub(super) fn place<S: Lanes>(&self, place: Vector3<S>) -> Vector3<S> {
        self.turn(place) + Vector3::splat(place.x.simd(), self.translation)
    }
}

/// The geometry of some Gaussians, column by column, as their source holds it: scales and opacity, or their logarithms and logit.
#[derive(Clone, Copy)]
pub(super) struct Columns {
    numbers: [[f32; BLOCK]; Gaussians::GEOMETRY],
    /// Whether they are scales and opacity.
    pub(super) is_activated: bool,
}

/// Scales and opacities of Gaussians.
pub(super) struct Activations<S: Lanes> {
    /// Standard deviations along the three axes, scene units.
    scale: Vector3<S>,
    opacity: F64s<S>,
    /// The derivative of the logarithm of the opacity by the number that the source holds.
    pub(super) log_opacity_by_number: F64s<S>,
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

    /// Vector number `index` of a column.
    #[inline(always)]
    fn vector<S: Lanes>(&self, simd: S, column: usize, index: usize) -> F64s<S> {
        F64s::widen(simd, &self.numbers[column], index)
    }

    /// Whether every number is finite.
    #[inline(always)]
    pub(super) fn is_finite<S: Lanes>(&self, simd: S, index: usize) -> Mask<S> {
        let zero = F64s::splat(simd, 0.0);
        let mut sum = zero;
        for column in 0..Gaussians::GEOMETRY {
            sum = self.vector(simd, column, index).mul_add(zero, sum);
        }
        sum.equals(zero)
    }

    #[inline(always)]
    fn three<S: Lanes>(&self, simd: S, first: usize, index: usize) -> Vector3<S> {
        Vector3::new(
            self.vector(simd, first, index),
            self.vector(simd, first + 1, index),
            self.vector(simd, first + 2, index),
        )
    }

    #[inline(always)]
    pub(super) fn mean<S: Lanes>(&self, simd: S, index: usize) -> Vector3<S> {
        self.three(simd, MEAN.start, index)
    }

    /// (w, x, y, z).
    #[inline(always)]
    fn quaternion<S: Lanes>(&self, simd: S, index: usize) -> [F64s<S>; 4] {
        let Vector3 { x, y, z } = self.three(simd, QUATERNION.start + 1, index);
        [self.vector(simd, QUATERNION.start, index), x, y, z]
    }

    /// The largest scale of each Gaussian.
    #[inline(always)]
    pub(super) fn largest_scale<S: Lanes>(&self, simd: S, index: usize) -> F64s<S> {
        let found = self.three(simd, LOG_SCALE.start, index).max_element();
        if self.is_activated { found } else { math::exp(found) }
    }

    /// Scales and opacities: exp of what is stored, and its sigmoid.
    #[inline(always)]
    pub(super) fn activate<S: Lanes>(&self, simd: S, index: usize) -> Activations<S> {
        let scale = self.three(simd, LOG_SCALE.start, index);
        let number = self.vector(simd, OPACITY_LOGIT, index);
        if self.is_activated {
            let opacity = number.clamp(f64::from(OPACITIES.0), f64::from(OPACITIES.1));
            Activations { scale, opacity, log_opacity_by_number: opacity.recip() }
        } else {
            let e = math::exp(-number);
            let opacity = (1.0 + e).recip();
            Activations {
                scale: Vector3::new(math::exp(scale.x), math::exp(scale.y), math::exp(scale.z)),
                opacity,
                // One less the opacity.
                log_opacity_by_number: e * opacity,
            }
        }
    }
}

/// Gaussians as one view sees them, before anything is bounded.
pub(super) struct Footprint<S: Lanes> {
    /// The mean in camera axes.
    pub(super) mean: Vector3<S>,
    pub(super) inverse_z: F64s<S>,
    /// x/z and y/z, as they are and as they enter the Jacobian.
    pub(super) slope: [F64s<S>; 2],
    pub(super) clamped: [F64s<S>; 2],
    /// Length of the given quaternion, which is of unit length in `quaternion`.
    pub(super) norm: F64s<S>,
    /// (w, x, y, z).
    pub(super) quaternion: [F64s<S>; 4],
    /// Columns: the Gaussian's axes in the world.
    pub(super) axes: [Vector3<S>; 3],
    /// Standard deviations as given and as drawn, see [`SIGMA_MAX`].
    pub(super) given_scale: Vector3<S>,
    pub(super) scale: Vector3<S>,
    /// Rows of J · Rv, J the Jacobian of the projection: in the world's axes and in the Gaussian's.
    pub(super) jacobian: [Vector3<S>; 2],
    pub(super) turned: [Vector3<S>; 2],
    /// Rows of V = J · Rv · R · S.
    pub(super) rows: [Vector3<S>; 2],
    /// Determinants of V Vᵀ and of the 2D covariance [a b; b c].
    pub(super) det0: F64s<S>,
    pub(super) det: F64s<S>,
    pub(super) a: F64s<S>,
    pub(super) b: F64s<S>,
    pub(super) c: F64s<S>,
    /// Opacity as given, and what compensates it for the low-pass filter.
    pub(super) opacity: F64s<S>,
    pub(super) compensation: F64s<S>,
    /// Whether the compensation is that of the footprint, not the least one.
    pub(super) compensates: Mask<S>,
}

impl<S: Lanes> Footprint<S> {
    /// `index` is the number of the vector in the columns; `activations` are those of the same Gaussians.
    #[inline(always)]
    pub(super) fn new(
        simd: S,
        view: &View,
        columns: &Columns,
        activations: &Activations<S>,
        index: usize,
    ) -> Self {
        let mean = view.place(columns.mean(simd, index));
        let inverse_z = mean.z.recip();
        let slope = [mean.x * inverse_z, mean.y * inverse_z];
        let clamped = [view.clamp(0, slope[0]), view.clamp(1, slope[1])];

        let [w, x, y, z] = columns.quaternion(simd, index);
        let norm = w.mul_add(w, z.mul_add(z, y.mul_add(y, x * x))).sqrt();
        let inverse = norm.recip();
        let quaternion = [w * inverse, x * inverse, y * inverse, z * inverse];
        let axes = axes(quaternion);
        let given_scale = activations.scale;
        let scale = given_scale.min(mean.z * (SIGMA_MAX / view.focal[0].max(view.focal[1])));

        let forward = view.row(simd, 2);
        let j0 = forward.mul_add(-clamped[0], view.row(simd, 0)) * (view.focal[0] * inverse_z);
        let j1 = forward.mul_add(-clamped[1], view.row(simd, 1)) * (view.focal[1] * inverse_z);
        let t0 = Vector3::new(j0.dot(axes[0]), j0.dot(axes[1]), j0.dot(axes[2]));
        let t1 = Vector3::new(j1.dot(axes[0]), j1.dot(axes[1]), j1.dot(axes[2]));
        let (u, v) = (t0 * scale, t1 * scale);
        // The determinant as a sum of positive terms (Cauchy–Binet), because a c - b² cancels for needles.
        let (a0, b, c0) = (u.length_squared(), u.dot(v), v.length_squared());
        let det0 = u.cross(v).length_squared();
        let eps = view.eps2d;
        let det = (a0 + c0).mul_add(a0.all(eps), det0) + eps * eps;

        let least = F64s::splat(simd, if view.antialias { view.compensation_min } else { 1.0 });
        let ratio = (det0 / det).sqrt();
        // Without compensation nothing is above the least.
        let above = if view.antialias { least } else { least.all(f64::INFINITY) };
        let compensates = above.is_below(ratio);
        let compensation = compensates.select(ratio, least);
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
            opacity: activations.opacity,
            compensation,
            compensates,
        }
    }

    /// The centres in the image along an axis, pixels.
    #[inline(always)]
    pub(super) fn centre(&self, view: &View, axis: usize) -> F64s<S> {
        let slope = self.slope[axis];
        slope.mul_add(slope.all(view.focal[axis]), slope.all(view.centre[axis]))
    }
}

/// Columns of the rotation matrices of quaternions of unit length.
#[inline(always)]
fn axes<S: Lanes>([w, x, y, z]: [F64s<S>; 4]) -> [Vector3<S>; 3] {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, xy, xz) = (x * x2, x * y2, x * z2);
    let (yy, yz, zz) = (y * y2, y * z2, z * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    [
        Vector3::new(1.0 - (yy + zz), xy + wz, xz - wy),
        Vector3::new(xy - wz, 1.0 - (xx + zz), yz + wx),
        Vector3::new(xz + wy, yz - wx, 1.0 - (xx + yy)),
    ]
}

//! Shapes and colours of the splats of a block: culling, projection, bounds.
//!
//! Each step is a kernel of its own, because each loop needs all registers.

use super::footprint::{BLOCK, Columns, Footprint, View};
use super::project::Splat;
use super::span::Bounds;
use super::{math, sh};
use cpu_kernels::lanes::{F32s, F64s, Kernel, Lanes, Mask, U64s};
use gs_scene::sh_coefficients;
use std::f64::consts::{LN_2, LOG2_E};

/// Outcomes: not in the image; in it; not drawable.
pub(super) const CULLED: u64 = 0;
pub(super) const DRAWN: u64 = 1;
pub(super) const REJECTED: u64 = 2;

/// What can be said of Gaussians before their shapes are known: the outcomes of the first `count`.
pub(super) struct FirstLook<'a> {
    pub(super) outcomes: &'a mut [u64; BLOCK],
    pub(super) view: &'a View,
    pub(super) columns: &'a Columns,
    pub(super) count: usize,
}

impl Kernel for FirstLook<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes>(self, simd: S) {
        for index in 0..self.count.div_ceil(S::F64_LANES) {
            outcome_at_first(simd, self.view, self.columns, index).store(self.outcomes, index);
        }
    }
}

/// Every test is written so that NaN fails it.
#[inline(always)]
fn outcome_at_first<S: Lanes>(simd: S, view: &View, columns: &Columns, index: usize) -> U64s<S> {
    let mean = view.place(columns.mean(simd, index));
    let before = F64s::splat(simd, view.near).is_below(mean.z) & mean.z.is_below(mean.z.all(view.far));
    // Most Gaussians outside the image are far outside: an opaque ball around such a one misses it, too. The ball
    // is a little larger because a valid rotation may be off by 1e-4.
    let inverse_z = mean.z.recip();
    let radius = 1.001 * columns.largest_scale(simd, index);
    let outside = is_ball_outside(view, 0, mean.x * inverse_z, inverse_z, radius)
        | is_ball_outside(view, 1, mean.y * inverse_z, inverse_z, radius);
    let outcome = (before & !outside).select_bits(U64s::splat(simd, DRAWN), U64s::splat(simd, CULLED));
    columns.is_finite(simd, index).select_bits(outcome, U64s::splat(simd, REJECTED))
}

/// Whether a ball misses the image along an axis.
#[inline(always)]
fn is_ball_outside<S: Lanes>(
    view: &View,
    axis: usize,
    slope: F64s<S>,
    inverse_z: F64s<S>,
    radius: F64s<S>,
) -> Mask<S> {
    let clamped = view.clamp(axis, slope);
    let jacobian = view.focal[axis] * inverse_z * clamped.mul_add(clamped, clamped.all(1.0)).sqrt();
    let reach = view.bound_max.sqrt() * jacobian.mul_add(radius, radius.all(view.eps2d.sqrt()));
    view.is_outside(axis, slope.mul_add(slope.all(view.focal[axis]), slope.all(view.centre[axis])), reach)
}

/// The shapes of the first `count` Gaussians, which passed the first look.
pub(super) struct FindShapes<'a> {
    pub(super) shapes: &'a mut Shapes,
    pub(super) view: &'a View,
    pub(super) columns: &'a Columns,
    pub(super) count: usize,
}

impl Kernel for FindShapes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes>(self, simd: S) {
        for index in 0..self.count.div_ceil(S::F64_LANES) {
            self.shapes.set(simd, index, self.view, self.columns);
        }
    }
}

/// The SH basis of the directions of the first `count` Gaussians, coefficient by coefficient.
pub(super) struct FindBasis<'a, const DEGREE: usize> {
    pub(super) basis: &'a mut [[f32; BLOCK]; sh::COEFFICIENTS_MAX],
    pub(super) direction: &'a [[f32; BLOCK]; 3],
    pub(super) count: usize,
}

impl<const DEGREE: usize> Kernel for FindBasis<'_, DEGREE> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes>(self, simd: S) {
        let [x, y, z] = self.direction;
        for index in 0..self.count.div_ceil(S::F32_LANES) {
            let direction =
                [F32s::load(simd, x, index), F32s::load(simd, y, index), F32s::load(simd, z, index)];
            let values = sh::basis::<DEGREE, S>(direction);
            for (column, values) in self.basis.iter_mut().zip(values).take(sh_coefficients(DEGREE)) {
                values.store(column, index);
            }
        }
    }
}

/// The colours, before they are cut at 0, of Gaussians with numbers `gaussians` in the block whose coefficients are `sh`. One Gaussian at
/// a time: its coefficients lie together in memory, and each is used only once, so columns of them would take longer to make than they save.
#[inline(always)]
pub(super) fn find_colours<const DEGREE: usize, const FMA: bool>(
    colours: &mut [[f32; 3]; BLOCK],
    basis: &[[f32; BLOCK]; sh::COEFFICIENTS_MAX],
    gaussians: &[usize],
    sh: &[f32],
) {
    let coefficients = sh_coefficients(DEGREE);
    for (place, (rgb, &gaussian)) in colours.iter_mut().zip(gaussians).enumerate() {
        *rgb = [0.5; 3];
        let sh = &sh[gaussian * coefficients * 3..][..coefficients * 3];
        for k in 0..coefficients {
            for channel in 0..3 {
                rgb[channel] = math::mul_add::<FMA>(basis[k][place], sh[3 * k + channel], rgb[channel]);
            }
        }
    }
}

/// The splats of a block but for their colours, field by field.
pub(super) struct Shapes {
    pub(super) outcome: [u64; BLOCK],
    mean: [[f64; BLOCK]; 2],
    falloff: [[f32; BLOCK]; 2],
    log2_opacity: [f32; BLOCK],
    depth: [f32; BLOCK],
    shear: [f32; BLOCK],
    half_width: [f32; BLOCK],
    /// First and last column and row of the image that the ellipse may touch.
    first: [[f64; BLOCK]; 2],
    last: [[f64; BLOCK]; 2],
    /// From the camera to the Gaussian.
    pub(super) direction: [[f32; BLOCK]; 3],
}

impl Shapes {
    pub(super) fn new() -> Self {
        Self {
            outcome: [CULLED; BLOCK],
            mean: [[0.0; BLOCK]; 2],
            falloff: [[0.0; BLOCK]; 2],
            log2_opacity: [0.0; BLOCK],
            depth: [0.0; BLOCK],
            shear: [0.0; BLOCK],
            half_width: [0.0; BLOCK],
            first: [[0.0; BLOCK]; 2],
            last: [[0.0; BLOCK]; 2],
            direction: [[0.0; BLOCK]; 3],
        }
    }

    #[inline(always)]
    fn set<S: Lanes>(&mut self, simd: S, index: usize, view: &View, columns: &Columns) {
        let shape = Footprint::new(simd, view, columns, &columns.activate(simd, index), index);
        let Footprint { a, b, c, det, .. } = shape;
        let opacity = shape.opacity * shape.compensation;
        let centre = [shape.centre(view, 0), shape.centre(view, 1)];
        // alpha ≥ alpha_min where the squared Mahalanobis distance is at most `bound`.
        let log2_opacity = math::log2_of(opacity);
        let bound = log2_opacity.mul_add(a.all(2.0 * LN_2), a.all(view.bound_max));
        let extent = [(bound * a).sqrt(), (bound * c).sqrt()];
        let inverse_c = c.recip();
        // The conic [A B; B C] in the form A (dx - shear dy)² + dy² / c, with A = c / det and shear = -B / A = b / c.
        let falloff = [-0.5 * LOG2_E * c / det, -0.5 * LOG2_E * inverse_c];
        let shear = b * inverse_c;
        let numbers = [extent[0], extent[1], centre[0], centre[1], falloff[0], falloff[1], shear];
        let zero = F64s::splat(simd, 0.0);
        let mut sum = zero;
        for number in numbers {
            sum = number.mul_add(zero, sum);
        }
        let is_drawn = F64s::splat(simd, view.alpha_min).is_at_most(opacity);
        let is_shaped = !shape.norm.equals(zero)
            & shape.given_scale.max_element().is_at_most(zero.all(f64::from(f32::MAX)))
            & (!is_drawn | sum.equals(zero));
        // Pixels whose centres are between the ends of the ellipse.
        let mut is_inside = is_drawn;
        for axis in 0..2 {
            let first = (centre[axis] - extent[axis] - 0.5).ceil().max(zero);
            let last = (centre[axis] + extent[axis] - 0.5).floor().min(zero.all(view.size[axis] - 1.0));
            is_inside = is_inside & first.is_at_most(last);
            first.store(&mut self.first[axis], index);
            last.store(&mut self.last[axis], index);
        }
        let outcome = is_inside.select_bits(U64s::splat(simd, DRAWN), U64s::splat(simd, CULLED));
        is_shaped.select_bits(outcome, U64s::splat(simd, REJECTED)).store(&mut self.outcome, index);
        centre[0].store(&mut self.mean[0], index);
        centre[1].store(&mut self.mean[1], index);
        falloff[0].narrow(&mut self.falloff[0], index);
        falloff[1].narrow(&mut self.falloff[1], index);
        log2_opacity.narrow(&mut self.log2_opacity, index);
        shape.mean.z.narrow(&mut self.depth, index);
        shear.narrow(&mut self.shear, index);
        extent[0].narrow(&mut self.half_width, index);
        let (direction, _) = view.direction(columns.mean(simd, index));
        direction.narrow(&mut self.direction, index);
    }

    #[inline(always)]
    pub(super) fn splat(&self, place: usize, rgb: [f32; 3], gaussian: u32) -> Splat {
        Splat {
            mean: [self.mean[0][place], self.mean[1][place]],
            falloff: [self.falloff[0][place], self.falloff[1][place]],
            log2_opacity: self.log2_opacity[place],
            rgb,
            depth: self.depth[place],
            shear: self.shear[place],
            half_width: self.half_width[place],
            gaussian,
        }
    }

    #[inline(always)]
    pub(super) fn bounds(&self, place: usize) -> Bounds {
        Bounds { columns: self.ends(0, place), rows: self.ends(1, place) }
    }

    #[inline(always)]
    fn ends(&self, axis: usize, place: usize) -> [u32; 2] {
        [math::small_integer(self.first[axis][place]), math::small_integer(self.last[axis][place])]
    }
}

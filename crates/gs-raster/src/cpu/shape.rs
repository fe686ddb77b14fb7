//! Shapes and colours of the splats of a block: culling, projection, bounds.
//!
//! Every function here is a loop over a block that the compiler turns into vector instructions, inside
//! [`compiled_for`](cpu_kernels::compiled_for). They are functions of their own so that the compiler knows that what they
//! read and what they write lies apart.

use super::footprint::{Activations, BLOCK, Columns, Footprint, View};
use super::project::Splat;
use super::span::Bounds;
use super::{math, sh};
use gs_scene::sh_coefficients;
use std::f64::consts::{LN_2, LOG2_E};

/// Outcomes: not in the image; in it; not drawable.
pub(super) const CULLED: u32 = 0;
pub(super) const DRAWN: u32 = 1;
pub(super) const REJECTED: u32 = 2;

/// What can be said of Gaussians before their shapes are known.
#[inline(always)]
pub(super) fn first_look(outcomes: &mut [u32; BLOCK], view: &View, columns: &Columns) {
    let scales = columns.largest_scales();
    for (place, outcome) in outcomes.iter_mut().enumerate() {
        *outcome = outcome_at_first(view, columns, scales[place], place);
    }
}

/// Every test is written so that NaN fails it.
#[inline(always)]
fn outcome_at_first(view: &View, columns: &Columns, scale: f64, place: usize) -> u32 {
    let mean = view.rotation * columns.mean(place) + view.translation;
    let before = (mean.z > view.near) & (mean.z < view.far);
    // Most Gaussians outside the image are far outside: an opaque ball around such a one misses it, too. The ball
    // is a little larger because a valid rotation may be off by 1e-4.
    let inverse_z = mean.z.recip();
    let radius = 1.001 * scale;
    let outside = |axis: usize, slope: f64| {
        let clamped = view.clamp(axis, slope);
        let jacobian = view.focal[axis] * inverse_z * (1.0 + clamped * clamped).sqrt();
        let reach = view.bound_max.sqrt() * (jacobian * radius + view.eps2d.sqrt());
        view.is_outside(axis, view.focal[axis] * slope + view.centre[axis], reach)
    };
    let outside = outside(0, mean.x * inverse_z) | outside(1, mean.y * inverse_z);
    if columns.is_finite(place) { if before & !outside { DRAWN } else { CULLED } } else { REJECTED }
}

/// The shapes of Gaussians that passed the first look.
#[inline(always)]
pub(super) fn find_shapes(shapes: &mut Shapes, view: &View, columns: &Columns) {
    // Copies: of what is only referred to, the compiler does not see that no store changes it, and then makes no vectors of the loop.
    let (view, columns) = (*view, *columns);
    let activations = columns.activate();
    for place in 0..BLOCK {
        shapes.set(place, &view, &columns, &activations);
    }
}

/// The colours, before they are cut at 0, of Gaussians with numbers `gaussians` in the block whose coefficients are `sh`.
#[inline(always)]
pub(super) fn find_colours<const DEGREE: usize, const FMA: bool>(
    colours: &mut [[f32; 3]; BLOCK],
    direction: &[[f32; BLOCK]; 3],
    gaussians: &[usize],
    sh: &[f32],
) {
    let coefficients = sh_coefficients(DEGREE);
    let mut basis = [[0.0; BLOCK]; sh::COEFFICIENTS_MAX];
    for place in 0..BLOCK {
        let values = sh::basis::<DEGREE>([direction[0][place], direction[1][place], direction[2][place]]);
        for k in 0..coefficients {
            basis[k][place] = values[k];
        }
    }
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
    pub(super) outcome: [u32; BLOCK],
    mean: [[f64; BLOCK]; 2],
    falloff: [[f32; BLOCK]; 2],
    log2_opacity: [f32; BLOCK],
    depth: [f32; BLOCK],
    shear: [f32; BLOCK],
    half_width: [f32; BLOCK],
    /// First and last column and row of the image that the ellipse may touch.
    first: [[u32; BLOCK]; 2],
    last: [[u32; BLOCK]; 2],
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
            first: [[0; BLOCK]; 2],
            last: [[0; BLOCK]; 2],
            direction: [[0.0; BLOCK]; 3],
        }
    }

    #[inline(always)]
    fn set(&mut self, place: usize, view: &View, columns: &Columns, activations: &Activations) {
        let shape = Footprint::new(view, columns, activations, place);
        let Footprint { a, b, c, det, .. } = shape;
        let opacity = shape.opacity * shape.compensation;
        let centre = [
            view.focal[0] * shape.slope[0] + view.centre[0],
            view.focal[1] * shape.slope[1] + view.centre[1],
        ];
        // alpha ≥ alpha_min where the squared Mahalanobis distance is at most `bound`.
        let log2_opacity = math::log2(opacity);
        let bound = 2.0 * LN_2 * log2_opacity + view.bound_max;
        let extent = [(bound * a).sqrt(), (bound * c).sqrt()];
        let inverse_c = c.recip();
        // The conic [A B; B C] in the form A (dx - shear dy)² + dy² / c, with A = c / det and shear = -B / A = b / c.
        let falloff = [-0.5 * LOG2_E * c / det, -0.5 * LOG2_E * inverse_c];
        let shear = b * inverse_c;
        let numbers = [extent[0], extent[1], centre[0], centre[1], falloff[0], falloff[1], shear];
        let mut zero = 0.0;
        for number in numbers {
            zero += number * 0.0;
        }
        let is_drawn = opacity >= view.alpha_min;
        let is_shaped = (shape.norm != 0.0)
            & (shape.given_scale.max_element() <= f64::from(f32::MAX))
            & (!is_drawn | (zero == 0.0));
        // Pixels whose centres are between the ends of the ellipse.
        let mut is_inside = true;
        for axis in 0..2 {
            let first = (centre[axis] - extent[axis] - 0.5).ceil().max(0.0);
            let last = (centre[axis] + extent[axis] - 0.5).floor().min(view.size[axis] - 1.0);
            is_inside &= first <= last;
            self.first[axis][place] = math::small_integer(first);
            self.last[axis][place] = math::small_integer(last);
        }
        self.outcome[place] =
            if is_shaped { if is_drawn & is_inside { DRAWN } else { CULLED } } else { REJECTED };
        self.mean[0][place] = centre[0];
        self.mean[1][place] = centre[1];
        self.falloff[0][place] = falloff[0] as f32;
        self.falloff[1][place] = falloff[1] as f32;
        self.log2_opacity[place] = log2_opacity as f32;
        self.depth[place] = shape.mean.z as f32;
        self.shear[place] = shear as f32;
        self.half_width[place] = extent[0] as f32;
        let direction = columns.mean(place) - view.position;
        let direction = direction * direction.length_squared().sqrt().recip();
        self.direction[0][place] = direction.x as f32;
        self.direction[1][place] = direction.y as f32;
        self.direction[2][place] = direction.z as f32;
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
            rows: [self.first[1][place], self.last[1][place]],
            gaussian,
        }
    }

    #[inline(always)]
    pub(super) fn bounds(&self, place: usize) -> Bounds {
        let of = |axis: usize| [self.first[axis][place], self.last[axis][place]];
        Bounds { columns: of(0), rows: of(1) }
    }
}

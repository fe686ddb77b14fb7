//! From sums per splat to gradients with respect to the numbers of the source and the pose: [`Footprint`] and the colours backwards, in f64.

use super::blend::Lists;
use super::blend_backward::{MOMENTS, SHARES, Summed};
use super::footprint::{BLOCK, Columns, Footprint, View};
use super::project::{CHUNK, Splat};
use super::sums::{Sums, add};
use super::vector3::Vector3;
use super::{Source, sh};
use crate::gradients::finite;
use crate::{CameraGradient, RenderSettings};
use cpu_kernels::lanes::{F32s, F64s, Kernel, Lanes, Mask, dispatch};
use cpu_kernels::{Isa, compiled_for};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Gaussians, sh_coefficients};
use rayon::prelude::*;
use std::f64::consts::{LN_2, LOG2_E};

/// Adds the gradients of the splats, whose sums are in `order`, to `sums`, and the sums of their shares to `shares`
/// if there are any; returns the gradients by the camera.
pub(super) fn project_backward(
    source: Source<'_>,
    camera: &Camera,
    settings: &RenderSettings,
    (Lists { splats, isa, .. }, order): (Lists, &[u32]),
    summed: &Summed<'_>,
    sums: &mut Sums<'_>,
    shares: Option<&mut [[f32; 2]]>,
) -> CameraGradient {
    let mut places = vec![0; splats.end()];
    for (place, &index) in (0u32..).zip(order) {
        places[index as usize] = place;
    }
    let view = View::new(camera, settings);
    let degree = source.sh_degree();
    let chunk_backward = match degree {
        0 => compiled::<0>,
        1 => compiled::<1>,
        2 => compiled::<2>,
        _ => compiled::<3>,
    };
    let sh_row = sh_coefficients(degree) * 3;
    let mut shares: Vec<&mut [[f32; 2]]> = match shares {
        Some(shares) => shares.chunks_mut(CHUNK).collect(),
        None => (0..source.len().div_ceil(CHUNK)).map(|_| <&mut [[f32; 2]]>::default()).collect(),
    };
    let cameras: Vec<CameraGradient> = splats
        .chunks()
        .zip(places.par_chunks(CHUNK))
        .zip(sums.chunks(CHUNK, sh_row))
        .zip(&mut shares)
        .enumerate()
        .map(|(index, (((splats, places), sums), shares))| {
            let mut chunk = Chunk { splats, places, source, first: index * CHUNK, sums, shares };
            chunk_backward(isa, &mut chunk, &view, summed)
        })
        .collect();
    let mut sum = CameraGradient { rotation: DMat3::ZERO, translation: DVec3::ZERO, focal: 0.0 };
    for camera in cameras {
        sum.rotation += camera.rotation;
        sum.translation += camera.translation;
        sum.focal += camera.focal;
    }
    sum
}

/// Gaussians of one task.
struct Chunk<'a> {
    splats: &'a [Splat],
    /// Where the sums of each splat are.
    places: &'a [u32],
    source: Source<'a>,
    /// Number of the first Gaussian.
    first: usize,
    sums: Sums<'a>,
    /// Empty if nobody asks for them.
    shares: &'a mut [[f32; 2]],
}

fn compiled<const DEGREE: usize>(
    isa: Isa,
    chunk: &mut Chunk<'_>,
    view: &View,
    summed: &Summed<'_>,
) -> CameraGradient {
    compiled_for!(isa, chunk_backward::<DEGREE>(isa, chunk, view, summed))
}

#[inline(always)]
fn chunk_backward<const DEGREE: usize>(
    isa: Isa,
    chunk: &mut Chunk<'_>,
    view: &View,
    summed: &Summed<'_>,
) -> CameraGradient {
    let coefficients = sh_coefficients(DEGREE);
    let mut room = [0.0; 3];
    let mut columns = Columns::new(chunk.source.is_activated());
    let mut block = Block::new();
    let mut moments = [[0.0; MOMENTS]; BLOCK];
    for (splats, places) in chunk.splats.chunks(BLOCK).zip(chunk.places.chunks(BLOCK)) {
        // These lie anywhere; fetched together, the waits for memory overlap.
        for (moments, &place) in moments.iter_mut().zip(places) {
            *moments = summed.moments[place as usize];
        }
        block.active = [0.0; BLOCK];
        for (index, (splat, moments)) in splats.iter().zip(&moments).enumerate() {
            let row = splat.gaussian as usize;
            let gaussian = chunk.first + row;
            let sh = match chunk.source {
                Source::Stored(scene) => {
                    let row = &scene.geometry()[gaussian * Gaussians::GEOMETRY..];
                    columns.set(index, &row[..Gaussians::GEOMETRY]);
                    &scene.sh()[gaussian * coefficients * 3..]
                }
                Source::Activated(arrays) => {
                    columns.set_activated(index, arrays, gaussian);
                    arrays.sh_of(gaussian, &mut room)
                }
            };
            block.active[index] = f64::from(moments[..SHARES].iter().any(|&moment| moment != 0.0));
            for (column, &moment) in block.moments.iter_mut().zip(moments) {
                column[index] = moment;
            }
            if let Some(shares) = chunk.shares.get_mut(row) {
                add(&mut shares[0], moments[SHARES]);
                add(&mut shares[1], moments[SHARES + 1]);
            }
            let rgb = colour_gradient(splat, moments);
            let sh = &sh[..coefficients * 3];
            for k in 0..coefficients {
                block.weights[k][index] =
                    sh[3 * k] * rgb[0] + sh[3 * k + 1] * rgb[1] + sh[3 * k + 2] * rgb[2];
            }
        }
        let (count, unit) = (splats.len(), summed.unit);
        dispatch(isa, ColourBackward::<DEGREE> { block: &mut block, view, columns: &columns, count });
        dispatch(isa, Backward { block: &mut block, view, columns: &columns, count, unit });
        for (index, splat) in splats.iter().enumerate() {
            if block.active[index] == 0.0 {
                continue;
            }
            let row = splat.gaussian as usize;
            chunk.sums.add_geometry(row, &block.geometry, index);
            let rgb = colour_gradient(splat, &moments[index]);
            let rgb = rgb.map(|channel| finite(summed.unit * f64::from(channel)));
            let found = chunk.sums.sh(row, coefficients * 3);
            for k in 0..coefficients {
                for channel in 0..3 {
                    add(&mut found[3 * k + channel], block.basis[k][index] * rgb[channel]);
                }
            }
        }
    }
    block.camera(summed.unit)
}

/// The gradient by the colour before it was cut at 0.
#[inline(always)]
fn colour_gradient(splat: &Splat, moments: &[f32; MOMENTS]) -> [f32; 3] {
    std::array::from_fn(
        |channel| {
            if splat.rgb[channel].is_sign_negative() { 0.0 } else { moments[6 + channel] }
        },
    )
}

/// Some Gaussians, column by column.
struct Block {
    /// 1 where the Gaussian has any gradient, else 0; there all columns may hold anything.
    active: [f64; BLOCK],
    moments: [[f32; BLOCK]; SHARES],
    /// Per SH coefficient, the gradient by its basis function; and the basis.
    weights: [[f32; BLOCK]; sh::COEFFICIENTS_MAX],
    basis: [[f32; BLOCK]; sh::COEFFICIENTS_MAX],
    /// The gradient by the mean through the direction of the view.
    shift: [[f64; BLOCK]; 3],
    geometry: [[f32; BLOCK]; Gaussians::GEOMETRY],
    /// Sums over blocks: by rotation, column by column, by translation, and by the logarithm of the focal length.
    camera: [[f64; BLOCK]; 13],
}

/// The basis of the directions of the first `count` Gaussians, and the gradients by the means through them.
struct ColourBackward<'a, const DEGREE: usize> {
    block: &'a mut Block,
    view: &'a View,
    columns: &'a Columns,
    count: usize,
}

impl<const DEGREE: usize> Kernel for ColourBackward<'_, DEGREE> {
    type Output = ();

    /// Directions in f64, harmonics in f32.
    #[inline(always)]
    fn run<S: Lanes>(self, simd: S) {
        let Self { block, view, columns, count } = self;
        let (mut direction, mut inverse) = ([[0.0; BLOCK]; 3], [0.0; BLOCK]);
        let (mut rounded, mut gradient) = ([[0.0; BLOCK]; 3], [[0.0; BLOCK]; 3]);
        for index in 0..count.div_ceil(S::F64_LANES) {
            let (d, one_over) = view.direction(columns.mean(simd, index));
            d.store(&mut direction, index);
            d.narrow(&mut rounded, index);
            one_over.store(&mut inverse, index);
        }
        for index in 0..count.div_ceil(S::F32_LANES) {
            let [x, y, z] = &rounded;
            let d = [F32s::load(simd, x, index), F32s::load(simd, y, index), F32s::load(simd, z, index)];
            let basis = sh::basis::<DEGREE, S>(d);
            let mut weights = [F32s::splat(simd, 0.0); sh::COEFFICIENTS_MAX];
            for k in 0..sh_coefficients(DEGREE) {
                basis[k].store(&mut block.basis[k], index);
                weights[k] = F32s::load(simd, &block.weights[k], index);
            }
            let by = sh::direction_gradient::<DEGREE, S>(d, &weights);
            for axis in 0..3 {
                by[axis].store(&mut gradient[axis], index);
            }
        }
        for index in 0..count.div_ceil(S::F64_LANES) {
            let (d, g) = (Vector3::load(simd, &direction, index), Vector3::widen(simd, &gradient, index));
            let across = d.mul_add(-d.dot(g), g);
            (across * F64s::load(simd, &inverse, index)).store(&mut block.shift, index);
        }
    }
}

/// The gradients of the first `count` Gaussians, times `unit`.
struct Backward<'a> {
    block: &'a mut Block,
    view: &'a View,
    columns: &'a Columns,
    count: usize,
    unit: f64,
}

impl Kernel for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes>(self, simd: S) {
        for index in 0..self.count.div_ceil(S::F64_LANES) {
            self.block.backward(simd, index, self.view, self.columns, self.unit);
        }
    }
}

impl Block {
    fn new() -> Self {
        Self {
            active: [0.0; BLOCK],
            moments: [[0.0; BLOCK]; SHARES],
            weights: [[0.0; BLOCK]; sh::COEFFICIENTS_MAX],
            basis: [[0.0; BLOCK]; sh::COEFFICIENTS_MAX],
            shift: [[0.0; BLOCK]; 3],
            geometry: [[0.0; BLOCK]; Gaussians::GEOMETRY],
            camera: [[0.0; BLOCK]; 13],
        }
    }

    #[inline(always)]
    fn backward<S: Lanes>(&mut self, simd: S, index: usize, view: &View, columns: &Columns, unit: f64) {
        let activations = columns.activate(simd, index);
        let shape = Footprint::new(simd, view, columns, &activations, index);
        let (s, s_dx, s_dxdx) =
            (self.moment(simd, 0, index), self.moment(simd, 1, index), self.moment(simd, 2, index));
        let (s_dy, s_dydy, s_dxdy) =
            (self.moment(simd, 3, index), self.moment(simd, 4, index), self.moment(simd, 5, index));
        let by_z = self.moment(simd, 9, index);

        // log₂ α = p dx² + r dy² + log₂ opacity with dx = x - mean_x - shear (y - mean_y), p = k / m, r = k / c, where m =
        // a - b² / c is the variance along a row, and shear = b / c.
        let Footprint { b, c, det, .. } = shape;
        let k = -0.5 * LOG2_E;
        let inverse_c = c.recip();
        let inverse_m = c / det;
        let (p, r, shear) = (k * inverse_m, k * inverse_c, b * inverse_c);
        let by_centre = [-2.0 * p * s_dx, 2.0 * (p * shear * s_dx - r * s_dy)];
        let by_m = -p * inverse_m * s_dxdx;
        let by_c = -r * inverse_c * s_dydy;
        let by_b = -2.0 * p * s_dxdy * inverse_c;
        // m, shear and c by the rows of V. What is left of the first without the second keeps needles exact.
        let [u, v] = shape.rows;
        let rest = v.mul_add(-shear, u);
        let mut by_u = rest.mul_add(2.0 * by_m, v * by_b);
        let mut by_v =
            rest.mul_add(-2.0 * shear * by_m, v.mul_add(-2.0 * shear, u).mul_add(by_b, v * (2.0 * by_c)));

        // The opacity times the compensation √(det0 / det); both by their logarithms.
        let by_log = s * (1.0 / LN_2);
        let by_opacity = by_log * activations.log_opacity_by_number;
        let normal = u.cross(v);
        let eps = view.eps2d;
        let squares = u.length_squared() + v.length_squared() + eps;
        let by_normal = by_log * eps * squares / (shape.det0 * det);
        let by_eps = by_log * eps / det;
        let compensates = shape.compensates;
        by_u = by_u + Vector3::or_zero(compensates, v.cross(normal) * by_normal - u * by_eps);
        by_v = by_v + Vector3::or_zero(compensates, normal.cross(u) * by_normal - v * by_eps);

        // V = J Rv R S.
        let scale = shape.scale;
        let [turned_u, turned_v] = shape.turned;
        let by_scale = by_u * turned_u + by_v * turned_v;
        // By the number that the source holds.
        let by_scale = if columns.is_activated { by_scale } else { by_scale * scale };
        let given = shape.given_scale;
        let by_scale = [
            unless(scale.x.is_below(given.x), by_scale.x),
            unless(scale.y.is_below(given.y), by_scale.y),
            unless(scale.z.is_below(given.z), by_scale.z),
        ];
        let [ju, jv] = shape.jacobian;
        let (tu, tv) = (by_u * scale, by_v * scale);
        let by_jacobian = [combine(shape.axes, tu), combine(shape.axes, tv)];
        let by_axes = [ju.mul_add(tu.x, jv * tv.x), ju.mul_add(tu.y, jv * tv.y), ju.mul_add(tu.z, jv * tv.z)];
        let by_quaternion = quaternion_gradient(shape.quaternion, by_axes);
        let inverse_norm = shape.norm.recip();

        // J at the clamped slope, and the centre at the slope itself.
        let forward = view.row(simd, 2);
        let inverse_z = shape.inverse_z;
        let by_row =
            [by_jacobian[0] * (view.focal[0] * inverse_z), by_jacobian[1] * (view.focal[1] * inverse_z)];
        let [slope_x, slope_y] = shape.slope;
        let [clamped_x, clamped_y] = shape.clamped;
        let is_clamped = [!slope_x.equals(clamped_x), !slope_y.equals(clamped_y)];
        let by_slope = [
            view.focal[0] * by_centre[0] - unless(is_clamped[0], forward.dot(by_row[0])),
            view.focal[1] * by_centre[1] - unless(is_clamped[1], forward.dot(by_row[1])),
        ];
        let along = by_slope[0].mul_add(slope_x, by_slope[1] * slope_y);
        let shrink = along + ju.dot(by_jacobian[0]) + jv.dot(by_jacobian[1]);
        let by_mean =
            Vector3::new(by_slope[0] * inverse_z, by_slope[1] * inverse_z, by_z - shrink * inverse_z);
        let by_forward = by_row[0] * -clamped_x - by_row[1] * clamped_y;

        let mean = columns.mean(simd, index);
        let shift = Vector3::load(simd, &self.shift, index);
        let axis = view.rotation;
        let world = shift
            + Vector3::new(
                Vector3::splat(simd, axis.x_axis).dot(by_mean),
                Vector3::splat(simd, axis.y_axis).dot(by_mean),
                Vector3::splat(simd, axis.z_axis).dot(by_mean),
            );
        let [qw, qx, qy, qz] = by_quaternion;
        let by_quaternion = [qw * inverse_norm, qx * inverse_norm, qy * inverse_norm, qz * inverse_norm];
        self.set_geometry(index, unit, 0, [world.x, world.y, world.z]);
        self.set_geometry(index, unit, 3, by_quaternion);
        self.set_geometry(index, unit, 7, by_scale);
        self.set_geometry(index, unit, 10, [by_opacity]);

        let zero = F64s::splat(simd, 0.0);
        let active = zero.is_below(F64s::load(simd, &self.active, index));
        // A longer focal length moves the centre along its slope, and stretches what the rows of J map without the slope.
        let by_focal = along + by_row[0].dot(view.row(simd, 0)) + by_row[1].dot(view.row(simd, 1));
        self.add_camera(index, 12, active, by_focal);
        // The camera centre is -Rᵀ t; the colours move with it as they do with the mean, the other way.
        let translation = Vector3::splat(simd, view.translation);
        let by_x = by_mean.mul_add(mean.x, translation * shift.x)
            + Vector3::new(by_row[0].x, by_row[1].x, by_forward.x);
        let by_y = by_mean.mul_add(mean.y, translation * shift.y)
            + Vector3::new(by_row[0].y, by_row[1].y, by_forward.y);
        let by_z = by_mean.mul_add(mean.z, translation * shift.z)
            + Vector3::new(by_row[0].z, by_row[1].z, by_forward.z);
        self.add_vector(index, 0, active, by_x);
        self.add_vector(index, 3, active, by_y);
        self.add_vector(index, 6, active, by_z);
        self.add_vector(index, 9, active, by_mean + view.turn(shift));
    }

    #[inline(always)]
    fn moment<S: Lanes>(&self, simd: S, k: usize, index: usize) -> F64s<S> {
        F64s::widen(simd, &self.moments[k], index)
    }

    /// Columns of geometry from `first` on, as [`finite`] makes them.
    #[inline(always)]
    fn set_geometry<S: Lanes, const N: usize>(
        &mut self,
        index: usize,
        unit: f64,
        first: usize,
        values: [F64s<S>; N],
    ) {
        for (column, value) in self.geometry[first..].iter_mut().zip(values) {
            let value = unit * value;
            let within = value.clamp(f64::from(f32::MIN), f64::from(f32::MAX));
            value.equals(value).select(within, value.all(0.0)).narrow(column, index);
        }
    }

    /// Adds to column `k` of the camera where `active`.
    #[inline(always)]
    fn add_camera<S: Lanes>(&mut self, index: usize, k: usize, active: Mask<S>, by: F64s<S>) {
        let sum = F64s::load(by.simd(), &self.camera[k], index);
        (sum + active.select(by, by.all(0.0))).store(&mut self.camera[k], index);
    }

    /// As [`Block::add_camera`], to three columns.
    #[inline(always)]
    fn add_vector<S: Lanes>(&mut self, index: usize, first: usize, active: Mask<S>, by: Vector3<S>) {
        self.add_camera(index, first, active, by.x);
        self.add_camera(index, first + 1, active, by.y);
        self.add_camera(index, first + 2, active, by.z);
    }

    /// The sums over all blocks, times `unit`.
    fn camera(&self, unit: f64) -> CameraGradient {
        let sums = self.camera.map(|column| {
            let sum = unit * column.iter().sum::<f64>();
            if sum.is_nan() { 0.0 } else { sum.clamp(f64::MIN, f64::MAX) }
        });
        CameraGradient {
            rotation: DMat3::from_cols_slice(&sums[..9]),
            translation: DVec3::from_slice(&sums[9..12]),
            focal: sums[12],
        }
    }
}

/// 0 where the mask is set.
#[inline(always)]
fn unless<S: Lanes>(mask: Mask<S>, value: F64s<S>) -> F64s<S> {
    mask.select(value.all(0.0), value)
}

/// A matrix of columns times a vector.
#[inline(always)]
fn combine<S: Lanes>([x, y, z]: [Vector3<S>; 3], v: Vector3<S>) -> Vector3<S> {
    z.mul_add(v.z, y.mul_add(v.y, x * v.x))
}

/// The derivative by a quaternion (w, x, y, z) of unit length, through its normalisation, of what has `by` as derivative by the columns
/// of its matrix.
#[inline(always)]
fn quaternion_gradient<S: Lanes>([w, x, y, z]: [F64s<S>; 4], [c0, c1, c2]: [Vector3<S>; 3]) -> [F64s<S>; 4] {
    let (xy, xz, yz) = (c1.x + c0.y, c2.x + c0.z, c2.y + c1.z);
    let (turn_x, turn_y, turn_z) = (c1.z - c2.y, c2.x - c0.z, c0.y - c1.x);
    let by_w = 2.0 * (x * turn_x + y * turn_y + z * turn_z);
    let by_x = 2.0 * (y * xy + z * xz + w * turn_x) - 4.0 * x * (c1.y + c2.z);
    let by_y = 2.0 * (x * xy + z * yz + w * turn_y) - 4.0 * y * (c0.x + c2.z);
    let by_z = 2.0 * (x * xz + y * yz + w * turn_z) - 4.0 * z * (c0.x + c1.y);
    let along = x * by_x + y * by_y + z * by_z + w * by_w;
    [by_w - w * along, by_x - x * along, by_y - y * along, by_z - z * along]
}

//! From sums per splat to gradients with respect to the numbers of the source and the pose: [`Footprint`] and the colours backwards, in f64.

use super::blend::Lists;
use super::blend_backward::{MOMENTS, SHARES, Summed};
use super::footprint::{Activations, BLOCK, Columns, Footprint, View};
use super::project::{CHUNK, Splat};
use super::sums::{Sums, add};
use super::{Source, sh};
use crate::gradients::finite;
use crate::{CameraGradient, RenderSettings};
use cpu_kernels::{Isa, compiled_for};
use glam::{DMat3, DQuat, DVec3};
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
        .map(|(at, (((splats, places), sums), shares))| {
            let mut chunk = Chunk { splats, places, source, first: at * CHUNK, sums, shares };
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
    compiled_for!(isa, chunk_backward::<DEGREE>(chunk, view, summed))
}

#[inline(always)]
fn chunk_backward<const DEGREE: usize>(
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
        block.active = [false; BLOCK];
        for (at, (splat, moments)) in splats.iter().zip(&moments).enumerate() {
            let row = splat.gaussian as usize;
            let gaussian = chunk.first + row;
            let sh = match chunk.source {
                Source::Stored(scene) => {
                    let row = &scene.geometry()[gaussian * Gaussians::GEOMETRY..];
                    columns.set(at, &row[..Gaussians::GEOMETRY]);
                    &scene.sh()[gaussian * coefficients * 3..]
                }
                Source::Activated(arrays) => {
                    columns.set_activated(at, arrays, gaussian);
                    arrays.sh_of(gaussian, &mut room)
                }
            };
            block.active[at] = moments[..SHARES].iter().any(|&moment| moment != 0.0);
            for (column, &moment) in block.moments.iter_mut().zip(moments) {
                column[at] = moment;
            }
            if let Some(shares) = chunk.shares.get_mut(row) {
                add(&mut shares[0], moments[SHARES]);
                add(&mut shares[1], moments[SHARES + 1]);
            }
            let rgb = colour_gradient(splat, moments);
            let sh = &sh[..coefficients * 3];
            for k in 0..coefficients {
                block.weights[k][at] = sh[3 * k] * rgb[0] + sh[3 * k + 1] * rgb[1] + sh[3 * k + 2] * rgb[2];
            }
        }
        for at in 0..BLOCK {
            block.colour_backward::<DEGREE>(at, view, &columns);
        }
        let activations = columns.activate();
        for at in 0..BLOCK {
            block.backward(at, view, (&columns, &activations), summed.unit);
        }
        for (at, splat) in splats.iter().enumerate() {
            if !block.active[at] {
                continue;
            }
            let row = splat.gaussian as usize;
            chunk.sums.add_geometry(row, &block.geometry, at);
            let rgb = colour_gradient(splat, &moments[at]);
            let rgb = rgb.map(|channel| finite(summed.unit * f64::from(channel)));
            let found = chunk.sums.sh(row, coefficients * 3);
            for k in 0..coefficients {
                for channel in 0..3 {
                    add(&mut found[3 * k + channel], block.basis[k][at] * rgb[channel]);
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
    /// Whether the Gaussian has any gradient; elsewhere all columns may hold anything.
    active: [bool; BLOCK],
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

impl Block {
    fn new() -> Self {
        Self {
            active: [false; BLOCK],
            moments: [[0.0; BLOCK]; SHARES],
            weights: [[0.0; BLOCK]; sh::COEFFICIENTS_MAX],
            basis: [[0.0; BLOCK]; sh::COEFFICIENTS_MAX],
            shift: [[0.0; BLOCK]; 3],
            geometry: [[0.0; BLOCK]; Gaussians::GEOMETRY],
            camera: [[0.0; BLOCK]; 13],
        }
    }

    #[inline(always)]
    fn colour_backward<const DEGREE: usize>(&mut self, at: usize, view: &View, columns: &Columns) {
        let offset = columns.mean(at) - view.position;
        let inverse = offset.length_squared().sqrt().recip();
        let direction = offset * inverse;
        let d = [direction.x as f32, direction.y as f32, direction.z as f32];
        let basis = sh::basis::<DEGREE>(d);
        let mut weights = [0.0; sh::COEFFICIENTS_MAX];
        for k in 0..sh_coefficients(DEGREE) {
            self.basis[k][at] = basis[k];
            weights[k] = self.weights[k][at];
        }
        let g = sh::direction_gradient::<DEGREE>(d, &weights);
        let g = DVec3::new(f64::from(g[0]), f64::from(g[1]), f64::from(g[2]));
        let shift = (g - direction * direction.dot(g)) * inverse;
        self.shift[0][at] = shift.x;
        self.shift[1][at] = shift.y;
        self.shift[2][at] = shift.z;
    }

    #[inline(always)]
    fn backward(
        &mut self,
        at: usize,
        view: &View,
        (columns, activations): (&Columns, &Activations),
        unit: f64,
    ) {
        let shape = Footprint::new(view, columns, activations, at);
        let moment = |k: usize| f64::from(self.moments[k][at]);
        let (s, s_dx, s_dxdx) = (moment(0), moment(1), moment(2));
        let (s_dy, s_dydy, s_dxdy) = (moment(3), moment(4), moment(5));
        let by_z = moment(9);

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
        let rest = u - v * shear;
        let mut by_u = rest * (2.0 * by_m) + v * by_b;
        let mut by_v = rest * (-2.0 * shear * by_m) + (u - v * (2.0 * shear)) * by_b + v * (2.0 * by_c);

        // The opacity times the compensation √(det0 / det); both by their logarithms.
        let by_log = s / LN_2;
        let by_opacity = by_log * activations.log_opacity_by_number(at);
        let normal = u.cross(v);
        let eps = view.eps2d;
        let squares = u.length_squared() + v.length_squared() + eps;
        let by_normal = by_log * eps * squares / (shape.det0 * det);
        let by_eps = by_log * eps / det;
        if shape.compensates {
            by_u += v.cross(normal) * by_normal - u * by_eps;
            by_v += normal.cross(u) * by_normal - v * by_eps;
        }

        // V = J Rv R S.
        let scale = shape.scale;
        let [turned_u, turned_v] = shape.turned;
        let by_scale = by_u * turned_u + by_v * turned_v;
        // By the number that the source holds.
        let by_scale = if columns.is_activated { by_scale } else { by_scale * scale };
        let given = shape.given_scale;
        let by_scale = DVec3::new(
            if scale.x < given.x { 0.0 } else { by_scale.x },
            if scale.y < given.y { 0.0 } else { by_scale.y },
            if scale.z < given.z { 0.0 } else { by_scale.z },
        );
        let [ju, jv] = shape.jacobian;
        let (tu, tv) = (by_u * scale, by_v * scale);
        let by_jacobian = [shape.axes * tu, shape.axes * tv];
        let by_axes = DMat3::from_cols(ju * tu.x + jv * tv.x, ju * tu.y + jv * tv.y, ju * tu.z + jv * tv.z);
        let by_quaternion = quaternion_gradient(shape.quaternion, by_axes) * shape.norm.recip();

        // J at the clamped slope, and the centre at the slope itself.
        let forward = view.rotation.row(2);
        let by_row = [
            by_jacobian[0] * (view.focal[0] * shape.inverse_z),
            by_jacobian[1] * (view.focal[1] * shape.inverse_z),
        ];
        let by_slope = |i: usize| {
            let is_free = shape.slope[i] == shape.clamped[i];
            view.focal[i] * by_centre[i] - if is_free { forward.dot(by_row[i]) } else { 0.0 }
        };
        let by_slope = [by_slope(0), by_slope(1)];
        let shrink = by_slope[0] * shape.slope[0]
            + by_slope[1] * shape.slope[1]
            + ju.dot(by_jacobian[0])
            + jv.dot(by_jacobian[1]);
        let inverse_z = shape.inverse_z;
        let by_mean = DVec3::new(by_slope[0] * inverse_z, by_slope[1] * inverse_z, by_z - shrink * inverse_z);
        let by_forward = by_row[0] * -shape.clamped[0] - by_row[1] * shape.clamped[1];

        let mean = columns.mean(at);
        let shift = DVec3::new(self.shift[0][at], self.shift[1][at], self.shift[2][at]);
        let (r, t) = (view.rotation, view.translation);
        let world = DVec3::new(r.x_axis.dot(by_mean), r.y_axis.dot(by_mean), r.z_axis.dot(by_mean)) + shift;
        // The camera centre is -Rᵀ t; the colours move with it as they do with the mean, the other way.
        let by_translation = by_mean + r * shift;
        let column = |mean: f64, shift: f64, rows: [f64; 3]| by_mean * mean + t * shift + DVec3::from(rows);
        let by_x = column(mean.x, shift.x, [by_row[0].x, by_row[1].x, by_forward.x]);
        let by_y = column(mean.y, shift.y, [by_row[0].y, by_row[1].y, by_forward.y]);
        let by_z = column(mean.z, shift.z, [by_row[0].z, by_row[1].z, by_forward.z]);

        let q = by_quaternion;
        let k = by_scale;
        let geometry = [world.x, world.y, world.z, q.w, q.x, q.y, q.z, k.x, k.y, k.z, by_opacity];
        for (column, value) in self.geometry.iter_mut().zip(geometry) {
            column[at] = finite(unit * value);
        }
        let active = self.active[at];
        // A longer focal length moves the centre along its slope, and stretches what the rows of J map without the slope.
        let by_focal = by_slope[0] * shape.slope[0]
            + by_slope[1] * shape.slope[1]
            + by_row[0].dot(view.rotation.row(0))
            + by_row[1].dot(view.rotation.row(1));
        self.camera[12][at] += if active { by_focal } else { 0.0 };
        let pose = [by_x, by_y, by_z, by_translation];
        for (sums, by) in self.camera.chunks_exact_mut(3).zip(pose) {
            sums[0][at] += if active { by.x } else { 0.0 };
            sums[1][at] += if active { by.y } else { 0.0 };
            sums[2][at] += if active { by.z } else { 0.0 };
        }
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

/// The derivative by a quaternion of unit length, through its normalisation, of what has `by` as derivative by its matrix.
#[inline(always)]
fn quaternion_gradient(q: DQuat, by: DMat3) -> DQuat {
    let DQuat { w, x, y, z } = q;
    let (c0, c1, c2) = (by.x_axis, by.y_axis, by.z_axis);
    let (xy, xz, yz) = (c1.x + c0.y, c2.x + c0.z, c2.y + c1.z);
    let (turn_x, turn_y, turn_z) = (c1.z - c2.y, c2.x - c0.z, c0.y - c1.x);
    let gradient = DQuat::from_xyzw(
        2.0 * (y * xy + z * xz + w * turn_x) - 4.0 * x * (c1.y + c2.z),
        2.0 * (x * xy + z * yz + w * turn_y) - 4.0 * y * (c0.x + c2.z),
        2.0 * (x * xz + y * yz + w * turn_z) - 4.0 * z * (c0.x + c1.y),
        2.0 * (x * turn_x + y * turn_y + z * turn_z),
    );
    gradient - q * q.dot(gradient)
}

//! Gaussians to footprints: culling, projection, bounds, colour.

use super::footprint::{BLOCK, Columns, Footprint, View};
use super::{math, sh};
use crate::RenderSettings;
use gs_scene::{Camera, Gaussians, sh_coefficients};
use multiversion::{multiversion, target::target_cfg_f};
use rayon::prelude::*;
use std::f64::consts::{LN_2, LOG2_E};

/// log₂ of [`CHUNK`].
const CHUNK_BITS: u32 = 12;
/// Gaussians per task; fixed, so that the result does not depend on the number of threads.
pub(super) const CHUNK: usize = 1 << CHUNK_BITS;

/// The footprint of one Gaussian in the image: 64 bytes, one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Splat {
    /// Centre, pixels.
    pub(super) mean: [f64; 2],
    /// (p, r): in a pixel at (dx, dy) from the centre, log₂ of the falloff is p (dx - shear dy)² + r dy². This form of
    /// the quadratic adds terms of one sign, where p dx² + q dx dy + r dy² would cancel for needles.
    pub(super) falloff: [f32; 2],
    /// log₂ of the opacity.
    pub(super) log2_opacity: f32,
    /// Colour. Where it was cut at 0 from below, and so has no gradient, it is -0.
    pub(super) rgb: [f32; 3],
    /// z-depth of the centre, scene units.
    pub(super) depth: f32,
    /// Half width and half height of the ellipse outside which alpha is below `alpha_min`, pixels.
    pub(super) extent: [f32; 2],
    /// dx of the middle of the ellipse's row at dy = 1 (its centre's is at 0).
    pub(super) shear: f32,
    /// Half width of the ellipse's row at dy = 0, pixels.
    pub(super) half_width: f32,
    /// Which Gaussian of its chunk.
    pub(super) row: u32,
}

/// What is left of a scene in one view: chunk by chunk the visible Gaussians, in the order of the scene.
#[derive(Debug, Default)]
pub(super) struct Splats {
    chunks: Vec<Chunk>,
}

/// What is left of [`CHUNK`] Gaussians.
#[derive(Debug, Default)]
struct Chunk {
    splats: Vec<Splat>,
    rejected: usize,
}

impl Splats {
    /// Projects every Gaussian of a scene; what was here is forgotten.
    pub(super) fn project(&mut self, gaussians: &Gaussians, camera: &Camera, settings: &RenderSettings) {
        let view = View::new(camera, settings);
        let project_chunk = match gaussians.sh_degree() {
            0 => project_chunk::<0>,
            1 => project_chunk::<1>,
            2 => project_chunk::<2>,
            _ => project_chunk::<3>,
        };
        let sh_row = sh_coefficients(gaussians.sh_degree()) * 3;
        self.chunks.resize_with(gaussians.len().div_ceil(CHUNK), Chunk::default);
        self.chunks
            .par_iter_mut()
            .zip(gaussians.geometry().par_chunks(CHUNK * Gaussians::GEOMETRY))
            .zip(gaussians.sh().par_chunks(CHUNK * sh_row))
            .for_each(|((chunk, geometry), sh)| project_chunk(chunk, &view, geometry, sh));
    }

    /// The splat of an index; not all numbers below [`Splats::end`] are one.
    #[inline(always)]
    pub(super) fn get(&self, index: u32) -> &Splat {
        &self.chunks[(index >> CHUNK_BITS) as usize].splats[index as usize % CHUNK]
    }

    /// The splats of each chunk; the first of chunk k has index k · [`CHUNK`].
    pub(super) fn chunks(&self) -> impl IndexedParallelIterator<Item = &[Splat]> {
        self.chunks.par_iter().map(|chunk| chunk.splats.as_slice())
    }

    /// All indices are below this.
    pub(super) fn end(&self) -> usize {
        self.chunks.len() * CHUNK
    }

    /// How many there are.
    pub(super) fn visible(&self) -> usize {
        self.chunks.iter().map(|chunk| chunk.splats.len()).sum()
    }

    /// See [`RenderStats::rejected`](crate::RenderStats::rejected).
    pub(super) fn rejected(&self) -> usize {
        self.chunks.iter().map(|chunk| chunk.rejected).sum()
    }
}

const CULLED: u32 = 0;
const DRAWN: u32 = 1;
const REJECTED: u32 = 2;

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn project_chunk<const DEGREE: usize>(chunk: &mut Chunk, view: &View, geometry: &[f32], sh: &[f32]) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        project_chunk_with::<DEGREE, true>(chunk, view, geometry, sh);
    } else {
        project_chunk_with::<DEGREE, false>(chunk, view, geometry, sh);
    }
}

#[inline(always)]
fn project_chunk_with<const DEGREE: usize, const FMA: bool>(
    chunk: &mut Chunk,
    view: &View,
    geometry: &[f32],
    sh: &[f32],
) {
    let coefficients = sh_coefficients(DEGREE);
    chunk.splats.clear();
    chunk.splats.reserve_exact(geometry.len() / Gaussians::GEOMETRY);
    chunk.rejected = 0;
    let mut stored = Columns::new();
    let mut outcome = [CULLED; BLOCK];
    let mut rows = [0; BLOCK];
    let mut shapes = Shapes::new();
    let mut basis = [[0.0; BLOCK]; sh::COEFFICIENTS_MAX];
    for (block, geometry) in geometry.chunks(BLOCK * Gaussians::GEOMETRY).enumerate() {
        let count = geometry.len() / Gaussians::GEOMETRY;
        for (place, row) in geometry.chunks_exact(Gaussians::GEOMETRY).enumerate() {
            stored.set(place, row);
        }
        for (place, outcome) in outcome.iter_mut().enumerate() {
            *outcome = first_look(view, &stored, place);
        }
        let mut kept = 0;
        for place in 0..count {
            chunk.rejected += usize::from(outcome[place] == REJECTED);
            if outcome[place] == DRAWN {
                stored.copy(place, kept);
                rows[kept] = block * BLOCK + place;
                kept += 1;
            }
        }
        if kept == 0 {
            continue;
        }
        for place in 0..BLOCK {
            shapes.set(place, view, &stored);
        }
        for place in 0..BLOCK {
            let direction = shapes.direction;
            let values = sh::basis::<DEGREE>([direction[0][place], direction[1][place], direction[2][place]]);
            for k in 0..coefficients {
                basis[k][place] = values[k];
            }
        }
        for (place, &row) in rows[..kept].iter().enumerate() {
            if shapes.outcome[place] != DRAWN {
                chunk.rejected += usize::from(shapes.outcome[place] == REJECTED);
                continue;
            }
            let mut rgb = [0.5; 3];
            let sh = &sh[row * coefficients * 3..][..coefficients * 3];
            for k in 0..coefficients {
                for channel in 0..3 {
                    rgb[channel] = math::mul_add::<FMA>(basis[k][place], sh[3 * k + channel], rgb[channel]);
                }
            }
            if rgb.iter().all(|channel| channel.is_finite()) {
                let rgb = rgb.map(|channel| if channel < 0.0 { -0.0 } else { channel });
                chunk.splats.push(shapes.splat(place, rgb, row as u32));
            } else {
                chunk.rejected += 1;
            }
        }
    }
}

/// What can be said of a Gaussian before its shape is known. Every test is written so that NaN fails it.
#[inline(always)]
fn first_look(view: &View, stored: &Columns, place: usize) -> u32 {
    let mean = view.rotation * stored.mean(place) + view.translation;
    let before = (mean.z > view.near) & (mean.z < view.far);
    // Most Gaussians outside the image are far outside: an opaque ball around such a one misses it, too. The ball
    // is a little larger because a valid rotation may be off by 1e-4.
    let inverse_z = mean.z.recip();
    let radius = 1.001 * math::exp(stored.log_scale(place).max_element());
    let outside = |axis: usize, slope: f64| {
        let clamped = view.clamp(axis, slope);
        let jacobian = view.focal[axis] * inverse_z * (1.0 + clamped * clamped).sqrt();
        let reach = view.bound_max.sqrt() * (jacobian * radius + view.eps2d.sqrt());
        view.is_outside(axis, view.focal[axis] * slope + view.centre[axis], reach)
    };
    let outside = outside(0, mean.x * inverse_z) | outside(1, mean.y * inverse_z);
    if stored.is_finite(place) { if before & !outside { DRAWN } else { CULLED } } else { REJECTED }
}

/// The splats of a block but for their colours, field by field.
struct Shapes {
    outcome: [u32; BLOCK],
    mean: [[f64; BLOCK]; 2],
    falloff: [[f32; BLOCK]; 2],
    log2_opacity: [f32; BLOCK],
    depth: [f32; BLOCK],
    extent: [[f32; BLOCK]; 2],
    shear: [f32; BLOCK],
    half_width: [f32; BLOCK],
    /// From the camera to the Gaussian.
    direction: [[f32; BLOCK]; 3],
}

impl Shapes {
    fn new() -> Self {
        Self {
            outcome: [CULLED; BLOCK],
            mean: [[0.0; BLOCK]; 2],
            falloff: [[0.0; BLOCK]; 2],
            log2_opacity: [0.0; BLOCK],
            depth: [0.0; BLOCK],
            extent: [[0.0; BLOCK]; 2],
            shear: [0.0; BLOCK],
            half_width: [0.0; BLOCK],
            direction: [[0.0; BLOCK]; 3],
        }
    }

    #[inline(always)]
    fn set(&mut self, place: usize, view: &View, stored: &Columns) {
        let shape = Footprint::new(view, stored, place);
        let Footprint { a, b, c, det, .. } = shape;
        let opacity = shape.opacity * shape.compensation;
        let centre = [0, 1].map(|axis| view.focal[axis] * shape.slope[axis] + view.centre[axis]);
        // alpha ≥ alpha_min where the squared Mahalanobis distance is at most `bound`.
        let log2_opacity = math::log2(opacity);
        let bound = 2.0 * LN_2 * log2_opacity + view.bound_max;
        let extent = [(bound * a).sqrt(), (bound * c).sqrt()];
        let inverse_c = c.recip();
        let half_width = (bound * det * inverse_c).sqrt();
        // The conic [A B; B C] in the form A (dx - shear dy)² + dy² / c, with A = c / det and shear = -B / A = b / c.
        let falloff = [-0.5 * LOG2_E * c / det, -0.5 * LOG2_E * inverse_c];
        let shear = b * inverse_c;
        let numbers = [extent[0], extent[1], half_width, centre[0], centre[1], falloff[0], falloff[1], shear];
        let mut zero = 0.0;
        for number in numbers {
            zero += number * 0.0;
        }
        let is_drawn = opacity >= view.alpha_min;
        let is_shaped = (shape.norm != 0.0)
            & (shape.stored_scale.max_element() <= f64::from(f32::MAX))
            & (!is_drawn | (zero == 0.0));
        let outside = view.is_outside(0, centre[0], extent[0]) | view.is_outside(1, centre[1], extent[1]);
        self.outcome[place] =
            if is_shaped { if is_drawn & !outside { DRAWN } else { CULLED } } else { REJECTED };
        self.mean[0][place] = centre[0];
        self.mean[1][place] = centre[1];
        self.falloff[0][place] = falloff[0] as f32;
        self.falloff[1][place] = falloff[1] as f32;
        self.log2_opacity[place] = log2_opacity as f32;
        self.depth[place] = shape.mean.z as f32;
        self.extent[0][place] = extent[0] as f32;
        self.extent[1][place] = extent[1] as f32;
        self.shear[place] = shear as f32;
        self.half_width[place] = half_width as f32;
        let direction = stored.mean(place) - view.position;
        let direction = direction * direction.length_squared().sqrt().recip();
        self.direction[0][place] = direction.x as f32;
        self.direction[1][place] = direction.y as f32;
        self.direction[2][place] = direction.z as f32;
    }

    #[inline(always)]
    fn splat(&self, place: usize, rgb: [f32; 3], row: u32) -> Splat {
        Splat {
            mean: self.mean.map(|column| column[place]),
            falloff: self.falloff.map(|column| column[place]),
            log2_opacity: self.log2_opacity[place],
            rgb,
            depth: self.depth[place],
            extent: self.extent.map(|column| column[place]),
            shear: self.shear[place],
            half_width: self.half_width[place],
            row,
        }
    }
}

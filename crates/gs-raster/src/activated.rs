//! Gaussians as optimisers hold them: arrays of activated numbers. The CPU draws and differentiates them as they are; here is the way to
//! the stored parametrisation, which a GPU gets.
//!
//! stored = (mean, quaternion, ln scale, logit of the opacity, SH).

use crate::cpu::math;
use crate::{Error, Result};
use cpu_kernels::{Isa, compiled_for};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, SH_C0, dc_from_rgb, sh_coefficients};
use rayon::prelude::*;
use std::f64::consts::LN_2;
use std::ops::Range;

/// Gaussians per task.
pub(crate) const CHUNK: usize = 1 << 12;
/// Gaussians that are converted together.
const BLOCK: usize = 64;
/// Numbers per Gaussian in the geometry buffer.
const ROW: usize = Gaussians::GEOMETRY;

/// Opacities are brought into this range before they are drawn, or their logit is taken. Nothing is drawn below `alpha_min`, which is at least 1e-6,
/// and the renderer's `alpha_max` is at most the largest number below 1: the picture is that of the limits 0 and 1.
pub(crate) const OPACITIES: (f32, f32) = (f32::MIN_POSITIVE, 1.0 - f32::EPSILON / 2.0);

/// N Gaussians as arrays of activated numbers, row-major, borrowed from whoever holds them.
///
/// [`Rasterizer::render_activated`](crate::Rasterizer::render_activated) and
/// [`Rasterizer::record_activated`](crate::Rasterizer::record_activated) read them in place on the CPU. A GPU gets them by
/// [`Activated::store`], which rounds logarithms and logits: scales from 1e-13 to 1e13 and opacities then have a relative error of at most 1e-6.
#[derive(Debug, Clone, Copy)]
pub struct Activated<'a> {
    /// `[N, 3]`, scene units.
    pub means: &'a [f32],
    /// `[N, 4]`, (w, x, y, z) of any norm above 0.
    pub quats: &'a [f32],
    /// `[N, 3]`, standard deviations above 0, scene units.
    pub scales: &'a [f32],
    /// `[N]`, 0 to 1.
    pub opacities: &'a [f32],
    /// Colours or SH coefficients, in the shape that `kind` states.
    pub colors: &'a [f32],
    /// Meaning of `colors`.
    pub kind: Colors,
}

/// Meaning of the numbers of a colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colors {
    /// `[N, 3]`: the colour that is drawn.
    Rgb,
    /// `[N, per_gaussian, 3]` SH coefficients, of which those up to `degree` are used.
    Sh {
        /// 0 to 3.
        degree: usize,
        /// At least (degree + 1)².
        per_gaussian: usize,
    },
}

impl Colors {
    /// SH degree of the stored Gaussians.
    #[must_use]
    pub fn degree(self) -> usize {
        match self {
            Self::Rgb => 0,
            Self::Sh { degree, .. } => degree,
        }
    }

    /// Numbers per Gaussian in the array.
    pub(crate) fn row(self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Sh { per_gaussian, .. } => per_gaussian * 3,
        }
    }
}

/// Natural logarithm of a positive number, rounded once. Without a call, so that loops over it become vector instructions.
#[inline(always)]
fn ln(x: f32) -> f32 {
    (math::log2(f64::from(x)) * LN_2) as f32
}

/// An opacity in the range of [`OPACITIES`].
#[inline(always)]
pub(crate) fn inside(opacity: f32) -> f64 {
    f64::from(opacity.clamp(OPACITIES.0, OPACITIES.1))
}

/// Logit of an opacity, which is brought into [`OPACITIES`] before.
#[inline(always)]
fn logit(opacity: f32) -> f32 {
    let opacity = inside(opacity);
    (math::log2(opacity / (1.0 - opacity)) * LN_2) as f32
}

impl<'a> Activated<'a> {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacities.is_empty()
    }

    /// The stored Gaussians.
    ///
    /// # Errors
    /// If the lengths of the arrays do not fit each other, the SH degree is above 3, a number is not finite, a scale is not above 0,
    /// an opacity lies outside 0 to 1, or a quaternion is 0. The first such Gaussian is named.
    pub fn store(&self) -> Result<Gaussians> {
        self.check_lengths()?;
        let (n, degree) = (self.len(), self.kind.degree());
        let sh_row = sh_coefficients(degree) * 3;
        let (mut geometry, mut sh) = (vec![0.0; n * ROW], vec![0.0; n * sh_row]);
        let isa = Isa::in_use();
        let is_good = geometry
            .par_chunks_mut(CHUNK * ROW)
            .zip(sh.par_chunks_mut(CHUNK * sh_row))
            .enumerate()
            .map(|(chunk, (geometry, sh))| self.store_chunk(isa, chunk * CHUNK, geometry, sh))
            .reduce(|| true, |a, b| a & b);
        if !is_good {
            // Numbers that are not used may be at fault, which is none.
            self.check_numbers()?;
        }
        Ok(Gaussians::new(degree, geometry, sh)?)
    }

    /// Whether all numbers are those of Gaussians.
    fn store_chunk(&self, isa: Isa, first: usize, geometry: &mut [f32], sh: &mut [f32]) -> bool {
        let sh_row = sh_coefficients(self.kind.degree()) * 3;
        let blocks = geometry.chunks_mut(BLOCK * ROW).zip(sh.chunks_mut(BLOCK * sh_row));
        let mut is_good = true;
        for (block, (geometry, sh)) in blocks.enumerate() {
            let part = self.part(first + block * BLOCK, geometry.len() / ROW);
            compiled_for!(isa, {
                is_good &= part.is_good();
                part.store_geometry(geometry);
                part.store_sh(sh);
            });
        }
        is_good
    }

    /// `n` Gaussians from `first` on.
    #[inline(always)]
    pub(crate) fn part(&self, first: usize, n: usize) -> Self {
        let row = self.kind.row();
        Self {
            means: &self.means[3 * first..][..3 * n],
            quats: &self.quats[4 * first..][..4 * n],
            scales: &self.scales[3 * first..][..3 * n],
            opacities: &self.opacities[first..][..n],
            colors: &self.colors[row * first..][..row * n],
            kind: self.kind,
        }
    }

    /// Whether all numbers are those of Gaussians, colours that are not used among them. Loops without branches, which the compiler
    /// vectorises.
    #[inline(always)]
    pub(crate) fn is_good(&self) -> bool {
        all_finite(self.means)
            & all_finite(self.quats)
            & all_finite(self.scales)
            & all_finite(self.colors)
            & self.scales.iter().fold(true, |good, scale| good & (*scale > 0.0))
            & self.opacities.iter().fold(true, |good, o| good & (0.0..=1.0).contains(o))
            & self
                .quats
                .chunks_exact(4)
                .fold(true, |good, q| good & ((q[0] != 0.0) | (q[1] != 0.0) | (q[2] != 0.0) | (q[3] != 0.0)))
    }

    /// Writes rows of stored geometry; at most [`BLOCK`].
    #[inline(always)]
    fn store_geometry(&self, geometry: &mut [f32]) {
        let (mut logs, mut logits) = ([0.0; 3 * BLOCK], [0.0; BLOCK]);
        logs.iter_mut().zip(self.scales).for_each(|(log, scale)| *log = ln(*scale));
        logits.iter_mut().zip(self.opacities).for_each(|(logit_of, opacity)| *logit_of = logit(*opacity));
        for (index, geometry) in geometry.chunks_exact_mut(ROW).enumerate() {
            geometry[MEAN].copy_from_slice(&self.means[3 * index..][..3]);
            geometry[QUATERNION].copy_from_slice(&self.quats[4 * index..][..4]);
            geometry[LOG_SCALE].copy_from_slice(&logs[3 * index..][..3]);
            geometry[OPACITY_LOGIT] = logits[index];
        }
    }

    /// Writes SH coefficients as they are stored.
    #[inline(always)]
    fn store_sh(&self, sh: &mut [f32]) {
        let (row, sh_row) = (self.kind.row(), sh_coefficients(self.kind.degree()) * 3);
        match self.kind {
            Colors::Rgb => sh.iter_mut().zip(self.colors).for_each(|(dc, rgb)| *dc = (rgb - 0.5) / SH_C0),
            Colors::Sh { .. } if row == sh_row => sh.copy_from_slice(self.colors),
            Colors::Sh { .. } => {
                let rows = sh.chunks_exact_mut(sh_row).zip(self.colors.chunks_exact(row));
                rows.for_each(|(sh, colors)| sh.copy_from_slice(&colors[..sh_row]));
            }
        }
    }

    /// SH coefficients as they are stored: in place where the array has that layout, else written to `room`.
    #[inline(always)]
    pub(crate) fn sh<'b>(&self, room: &'b mut [f32]) -> &'b [f32]
    where
        'a: 'b,
    {
        let sh_row = sh_coefficients(self.kind.degree()) * 3;
        if matches!(self.kind, Colors::Sh { .. }) && self.kind.row() == sh_row {
            return self.colors;
        }
        let room = &mut room[..self.len() * sh_row];
        self.store_sh(room);
        room
    }

    /// As [`Activated::sh`], of one Gaussian; more may follow.
    #[inline(always)]
    pub(crate) fn sh_of<'b>(&self, gaussian: usize, room: &'b mut [f32; 3]) -> &'b [f32]
    where
        'a: 'b,
    {
        let colors = &self.colors[gaussian * self.kind.row()..];
        match self.kind {
            Colors::Rgb => {
                *room = dc_from_rgb([colors[0], colors[1], colors[2]]);
                room
            }
            Colors::Sh { .. } => colors,
        }
    }

    /// Whether the lengths of the arrays fit each other.
    ///
    /// # Errors
    /// If not, and if the SH degree is above 3.
    pub(crate) fn check_lengths(&self) -> Result<()> {
        let (n, degree) = (self.len(), self.kind.degree());
        if degree > 3 {
            return Err(gs_scene::Error::ShDegree { found: degree }.into());
        }
        if let Colors::Sh { per_gaussian, .. } = self.kind
            && per_gaussian < sh_coefficients(degree)
        {
            let expected = sh_coefficients(degree);
            return Err(Error::Coefficients { degree, expected, found: per_gaussian });
        }
        let lengths = [
            ("means", self.means, 3),
            ("quats", self.quats, 4),
            ("scales", self.scales, 3),
            ("colors", self.colors, self.kind.row()),
        ];
        for (what, array, per_gaussian) in lengths {
            let (expected, found) = (n.saturating_mul(per_gaussian), array.len());
            if expected != found {
                return Err(Error::ArrayLength { what, gaussians: n, expected, found });
            }
        }
        Ok(())
    }

    /// Looks for numbers that no Gaussian has.
    ///
    /// # Errors
    /// Names the first of them.
    pub(crate) fn check_numbers(&self) -> Result<()> {
        let chunks = (0..self.len().div_ceil(CHUNK)).into_par_iter();
        let range = |chunk: usize| chunk * CHUNK..self.len().min((chunk + 1) * CHUNK);
        let faults = chunks.filter_map(|chunk| self.fault(range(chunk)));
        faults.min_by_key(|(gaussian, _)| *gaussian).map_or(Ok(()), |(_, error)| Err(error))
    }

    /// The first number of some Gaussians that no Gaussian has, and whose it is.
    #[cold]
    fn fault(&self, mut gaussians: Range<usize>) -> Option<(usize, Error)> {
        gaussians.find_map(|gaussian| Some((gaussian, self.fault_of(gaussian)?)))
    }

    fn fault_of(&self, gaussian: usize) -> Option<Error> {
        // Coefficients that are not used may hold anything.
        let used = sh_coefficients(self.kind.degree()) * 3;
        let part = self.part(gaussian, 1);
        let arrays = [
            ("means", part.means),
            ("quats", part.quats),
            ("scales", part.scales),
            ("opacities", part.opacities),
            ("colors", &part.colors[..used]),
        ];
        for (what, numbers) in arrays {
            if let Some(&found) = numbers.iter().find(|number| !number.is_finite()) {
                return Some(Error::NotFinite { what, gaussian, found });
            }
        }
        if let Some(&found) = part.scales.iter().find(|scale| **scale <= 0.0) {
            return Some(Error::Scale { gaussian, found });
        }
        let found = part.opacities[0];
        if !(0.0..=1.0).contains(&found) {
            return Some(Error::Opacity { gaussian, found });
        }
        part.quats.iter().all(|q| *q == 0.0).then_some(Error::Quaternion { gaussian })
    }
}

/// Whether no number is NaN or infinite, by the largest of the bits that hold exponent and fraction.
#[inline(always)]
fn all_finite(numbers: &[f32]) -> bool {
    const INFINITE: i32 = f32::INFINITY.to_bits() as i32;
    let magnitude = |number: &f32| number.abs().to_bits() as i32;
    numbers.iter().fold(0, |largest, number| largest.max(magnitude(number))) < INFINITE
}

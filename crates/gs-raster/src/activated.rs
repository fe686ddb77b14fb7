//! Gaussians as optimisers hold them: arrays of activated numbers, and the way to and from the stored parametrisation that the renderer
//! differentiates.
//!
//! stored = (mean, quaternion, ln scale, logit of the opacity, SH). The chain rule for a loss L:
//! ∂L/∂scale = ∂L/∂(ln scale) / scale, ∂L/∂opacity = ∂L/∂logit / (o (1 - o)), ∂L/∂rgb = ∂L/∂dc / Y₀.

use crate::cpu::math;
use crate::{Error, Gradients, Result};
use cpu_kernels::{Isa, compiled_for};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, SH_C0, sh_coefficients};
use rayon::prelude::*;
use std::f64::consts::LN_2;
use std::ops::Range;

/// Gaussians per task.
const CHUNK: usize = 1 << 12;
/// Gaussians that are converted together.
const BLOCK: usize = 64;
/// Numbers per Gaussian in the geometry buffer.
const ROW: usize = Gaussians::GEOMETRY;

/// Opacities are brought into this range before their logit is taken. Nothing is drawn below `alpha_min`, which is at least 1e-6,
/// and the renderer's `alpha_max` is at most the largest number below 1: the picture is that of the limits 0 and 1.
const OPACITIES: (f32, f32) = (f32::MIN_POSITIVE, 1.0 - f32::EPSILON / 2.0);

/// N Gaussians as arrays of activated numbers, row-major, borrowed from whoever holds them.
///
/// [`Rasterizer::render_activated`](crate::Rasterizer::render_activated) reads them in place. Its pictures equal those of
/// [`Activated::store`] to the bit.
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

/// Gradients in the shapes of the arrays that they belong to.
#[derive(Debug, Clone, PartialEq)]
pub struct ActivatedGradients {
    /// `[N, 3]`, 1 / scene units.
    pub means: Vec<f32>,
    /// `[N, 4]`.
    pub quats: Vec<f32>,
    /// `[N, 3]`, 1 / scene units.
    pub scales: Vec<f32>,
    /// `[N]`.
    pub opacities: Vec<f32>,
    /// In the shape of [`Activated::colors`]; 0 for coefficients that are not used.
    pub colors: Vec<f32>,
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
    fn row(self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Sh { per_gaussian, .. } => per_gaussian * 3,
        }
    }
}

/// Natural logarithm of a positive number, rounded once. Without a call, so that loops over it become vector instructions.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    (math::log2(f64::from(x)) * LN_2) as f32
}

/// Logit of an opacity, which is brought into [`OPACITIES`] before.
#[inline(always)]
pub(crate) fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity.clamp(OPACITIES.0, OPACITIES.1));
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
        let sh = vec![0.0; n * sh_coefficients(degree) * 3];
        let mut stored = Gaussians::new(degree, vec![0.0; n * ROW], sh)?;
        self.store_into(&mut stored)?;
        Ok(stored)
    }

    /// As [`Activated::store`], into Gaussians that are there. On an error they hold some content.
    ///
    /// # Errors
    /// As [`Activated::store`]; if `stored` has another length or SH degree.
    pub fn store_into(&self, stored: &mut Gaussians) -> Result<()> {
        self.check_lengths()?;
        let (expected, expected_degree) = (self.len(), self.kind.degree());
        let (found, found_degree) = (stored.len(), stored.sh_degree());
        if (found, found_degree) != (expected, expected_degree) {
            return Err(Error::OtherScene { expected, expected_degree, found, found_degree });
        }
        let sh_row = sh_coefficients(expected_degree) * 3;
        let (geometry, sh) = stored.buffers_mut();
        let isa = Isa::in_use();
        let is_good = geometry
            .par_chunks_mut(CHUNK * ROW)
            .zip(sh.par_chunks_mut(CHUNK * sh_row))
            .enumerate()
            .map(|(chunk, (geometry, sh))| self.store_chunk(isa, chunk * CHUNK, geometry, sh))
            .reduce(|| true, |a, b| a & b);
        if is_good { Ok(()) } else { self.check_numbers() }
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
        for (at, geometry) in geometry.chunks_exact_mut(ROW).enumerate() {
            geometry[MEAN].copy_from_slice(&self.means[3 * at..][..3]);
            geometry[QUATERNION].copy_from_slice(&self.quats[4 * at..][..4]);
            geometry[LOG_SCALE].copy_from_slice(&logs[3 * at..][..3]);
            geometry[OPACITY_LOGIT] = logits[at];
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
        let of = self.part(gaussian, 1);
        let arrays = [
            ("means", of.means),
            ("quats", of.quats),
            ("scales", of.scales),
            ("opacities", of.opacities),
            ("colors", &of.colors[..used]),
        ];
        for (what, numbers) in arrays {
            if let Some(&found) = numbers.iter().find(|number| !number.is_finite()) {
                return Some(Error::NotFinite { what, gaussian, found });
            }
        }
        if let Some(&found) = of.scales.iter().find(|scale| **scale <= 0.0) {
            return Some(Error::Scale { gaussian, found });
        }
        let found = of.opacities[0];
        if !(0.0..=1.0).contains(&found) {
            return Some(Error::Opacity { gaussian, found });
        }
        of.quats.iter().all(|q| *q == 0.0).then_some(Error::Quaternion { gaussian })
    }
}

/// Whether no number is NaN or infinite, by the largest of the bits that hold exponent and fraction.
#[inline(always)]
fn all_finite(numbers: &[f32]) -> bool {
    const INFINITE: i32 = f32::INFINITY.to_bits() as i32;
    let magnitude = |number: &f32| number.abs().to_bits() as i32;
    numbers.iter().fold(0, |largest, number| largest.max(magnitude(number))) < INFINITE
}

impl Gradients {
    /// The chain rule: gradients by the arrays that were stored as `stored`.
    ///
    /// # Panics
    /// If these are not gradients of `stored`, or `kind` has another SH degree.
    #[must_use]
    pub fn activated(self, stored: &Gaussians, kind: Colors) -> ActivatedGradients {
        let (n, used) = (stored.len(), sh_coefficients(kind.degree()) * 3);
        assert_eq!(stored.sh_degree(), kind.degree(), "the SH degree of what was stored");
        assert_eq!((self.geometry.len(), self.sh.len()), (n * ROW, n * used), "gradients of what was stored");
        // Every number is written once, and none is read before.
        let (mut means, mut quats) = (vec![0.0; n * 3], vec![0.0; n * 4]);
        let (mut scales, mut opacities) = (vec![0.0; n * 3], vec![0.0; n]);
        let isa = Isa::in_use();
        means
            .par_chunks_mut(CHUNK * 3)
            .zip(quats.par_chunks_mut(CHUNK * 4))
            .zip(scales.par_chunks_mut(CHUNK * 3))
            .zip(opacities.par_chunks_mut(CHUNK))
            .zip(stored.geometry().par_chunks(CHUNK * ROW))
            .zip(self.geometry.par_chunks(CHUNK * ROW))
            .for_each(|(((((means, quats), scales), opacities), stored), gradients)| {
                compiled_for!(isa, {
                    let rows = stored.chunks(BLOCK * ROW).zip(gradients.chunks(BLOCK * ROW));
                    let found = means
                        .chunks_mut(BLOCK * 3)
                        .zip(quats.chunks_mut(BLOCK * 4))
                        .zip(scales.chunks_mut(BLOCK * 3).zip(opacities.chunks_mut(BLOCK)));
                    for ((stored, gradients), ((means, quats), (scales, opacities))) in rows.zip(found) {
                        chain(stored, gradients, [means, quats, scales, opacities]);
                    }
                });
            });
        let colors = match kind {
            Colors::Rgb => {
                let mut by_rgb = self.sh;
                by_rgb.par_chunks_mut(CHUNK * 3).for_each(|chunk| chunk.iter_mut().for_each(|g| *g /= SH_C0));
                by_rgb
            }
            Colors::Sh { per_gaussian, .. } if per_gaussian * 3 == used => self.sh,
            Colors::Sh { per_gaussian, .. } => {
                let mut all = vec![0.0; n * per_gaussian * 3];
                let rows = all.par_chunks_mut(per_gaussian * 3).zip(self.sh.par_chunks(used));
                rows.for_each(|(all, found)| all[..used].copy_from_slice(found));
                all
            }
        };
        ActivatedGradients { means, quats, scales, opacities, colors }
    }
}

/// The chain rule for at most [`BLOCK`] rows of geometry: by means, quaternions, scales and opacities.
#[inline(always)]
fn chain(stored: &[f32], gradients: &[f32], [means, quats, scales, opacities]: [&mut [f32]; 4]) {
    let (mut inverse_scales, mut slopes) = ([0.0f64; 3 * BLOCK], [0.0f64; BLOCK]);
    for (at, row) in stored.chunks_exact(ROW).enumerate() {
        for (inverse, log) in inverse_scales[3 * at..][..3].iter_mut().zip(&row[LOG_SCALE]) {
            *inverse = f64::from(-log);
        }
        slopes[at] = f64::from(row[OPACITY_LOGIT]);
    }
    for inverse in &mut inverse_scales {
        *inverse = math::exp(*inverse);
    }
    for slope in &mut slopes {
        // 1 / (o (1 - o)) = 2 + e^x + e^-x for the logit x: nothing cancels at either end.
        let odds = math::exp(*slope);
        *slope = 2.0 + odds + odds.recip();
    }
    for (at, row) in gradients.chunks_exact(ROW).enumerate() {
        means[3 * at..][..3].copy_from_slice(&row[MEAN]);
        quats[4 * at..][..4].copy_from_slice(&row[QUATERNION]);
        for ((scale, gradient), inverse) in
            scales[3 * at..][..3].iter_mut().zip(&row[LOG_SCALE]).zip(&inverse_scales[3 * at..])
        {
            *scale = (f64::from(*gradient) * inverse) as f32;
        }
        opacities[at] = (f64::from(row[OPACITY_LOGIT]) * slopes[at]) as f32;
    }
}

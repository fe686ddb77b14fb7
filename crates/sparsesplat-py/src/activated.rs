//! Gaussians as gsplat takes them, and the way to and from the stored parametrisation that the renderer differentiates.
//!
//! stored = (mean, quaternion, ln scale, logit of the opacity, SH). The chain rule for a loss L:
//! ∂L/∂scale = ∂L/∂(ln scale) / scale, ∂L/∂opacity = ∂L/∂logit / (o (1 - o)), ∂L/∂rgb = ∂L/∂dc / Y₀.

use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, SH_C0, logit, sh_coefficients};
use rayon::prelude::*;

/// Gaussians per task.
const CHUNK: usize = 1 << 12;
/// Numbers per Gaussian in the geometry buffer.
const ROW: usize = Gaussians::GEOMETRY;

/// Opacities are brought into this range before their logit is taken. Nothing is drawn below `alpha_min`, which is at least 1e-6,
/// and the renderer's `alpha_max` is at most the largest number below 1: the picture is that of the limits 0 and 1.
const OPACITIES: (f32, f32) = (f32::MIN_POSITIVE, 1.0 - f32::EPSILON / 2.0);

/// Arrays of N Gaussians, row-major.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Activated<'a> {
    /// `[N, 3]`, scene units.
    pub(crate) means: &'a [f32],
    /// `[N, 4]`, (w, x, y, z) of any norm above 0.
    pub(crate) quats: &'a [f32],
    /// `[N, 3]`, standard deviations, scene units.
    pub(crate) scales: &'a [f32],
    /// `[N]`, 0 to 1.
    pub(crate) opacities: &'a [f32],
    /// What they look like.
    pub(crate) colors: &'a [f32],
    /// How `colors` are meant.
    pub(crate) kind: Colors,
}

/// What the numbers of a colour are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Colors {
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

/// A number that no Gaussian has.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub(crate) enum Fault {
    /// NaN or an infinity.
    #[error("{what}: Gaussian {gaussian} holds {found}, expected finite numbers")]
    NotFinite {
        /// The array.
        what: &'static str,
        /// Which Gaussian.
        gaussian: usize,
        /// The number.
        found: f32,
    },
    /// A standard deviation of 0 or below.
    #[error(
        "scales: Gaussian {gaussian} has {found}, expected numbers above 0: scales are standard deviations, not their logarithms"
    )]
    Scale {
        /// Which Gaussian.
        gaussian: usize,
        /// The number.
        found: f32,
    },
    /// An opacity outside 0 to 1.
    #[error(
        "opacities: Gaussian {gaussian} has {found}, expected 0 to 1: opacities are no logits, apply the sigmoid first"
    )]
    Opacity {
        /// Which Gaussian.
        gaussian: usize,
        /// The number.
        found: f32,
    },
    /// A quaternion without a direction.
    #[error("quats: Gaussian {gaussian} has a quaternion of norm 0, which is no rotation")]
    Quaternion {
        /// Which Gaussian.
        gaussian: usize,
    },
}

impl Fault {
    fn gaussian(&self) -> usize {
        match *self {
            Self::NotFinite { gaussian, .. }
            | Self::Scale { gaussian, .. }
            | Self::Opacity { gaussian, .. }
            | Self::Quaternion { gaussian } => gaussian,
        }
    }
}

/// Gradients in the shapes of the arrays that they belong to.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ActivatedGradients {
    pub(crate) means: Vec<f32>,
    pub(crate) quats: Vec<f32>,
    pub(crate) scales: Vec<f32>,
    pub(crate) opacities: Vec<f32>,
    pub(crate) colors: Vec<f32>,
}

impl Colors {
    /// SH degree of the stored Gaussians.
    pub(crate) fn degree(self) -> usize {
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

impl Activated<'_> {
    /// Number of Gaussians.
    pub(crate) fn len(&self) -> usize {
        self.opacities.len()
    }

    /// Writes the stored Gaussians into `stored`, which has this length and degree.
    ///
    /// # Errors
    /// If a number is not finite, a scale not above 0, an opacity outside 0 to 1, or a quaternion 0; the first such Gaussian is
    /// named.
    pub(crate) fn store(&self, stored: &mut Gaussians) -> Result<(), Fault> {
        assert_eq!((stored.len(), stored.sh_degree()), (self.len(), self.kind.degree()));
        let sh_row = sh_coefficients(self.kind.degree()) * 3;
        let (geometry, sh) = stored.buffers_mut();
        let found = geometry
            .par_chunks_mut(CHUNK * ROW)
            .zip(sh.par_chunks_mut(CHUNK * sh_row))
            .enumerate()
            .filter_map(|(chunk, (geometry, sh))| self.store_chunk(chunk * CHUNK, geometry, sh).err())
            .min_by_key(Fault::gaussian);
        found.map_or(Ok(()), Err)
    }

    fn store_chunk(&self, first: usize, geometry: &mut [f32], sh: &mut [f32]) -> Result<(), Fault> {
        let n = geometry.len() / ROW;
        let sh_row = sh_coefficients(self.kind.degree()) * 3;
        let row = self.kind.row();
        let colors = &self.colors[row * first..][..row * n];
        let means = &self.means[3 * first..][..3 * n];
        let quats = &self.quats[4 * first..][..4 * n];
        let scales = &self.scales[3 * first..][..3 * n];
        let opacities = &self.opacities[first..][..n];
        // Loops without branches, which the compiler vectorises. Only if something is wrong is it looked for.
        let good = all_finite(means)
            & all_finite(quats)
            & all_finite(scales)
            & all_finite(colors)
            & scales.iter().fold(true, |good, scale| good & (*scale > 0.0))
            & opacities.iter().fold(true, |good, o| good & (0.0..=1.0).contains(o))
            & quats.chunks_exact(4).fold(true, |good, q| good & q.iter().any(|q| *q != 0.0));
        if !good {
            // Coefficients that are not used may hold anything.
            (first..first + n).try_for_each(|gaussian| self.check(gaussian))?;
        }
        for (at, geometry) in geometry.chunks_exact_mut(ROW).enumerate() {
            geometry[MEAN].copy_from_slice(&means[3 * at..][..3]);
            geometry[QUATERNION].copy_from_slice(&quats[4 * at..][..4]);
            for (log, scale) in geometry[LOG_SCALE].iter_mut().zip(&scales[3 * at..][..3]) {
                *log = scale.ln();
            }
            let opacity = opacities[at].clamp(OPACITIES.0, OPACITIES.1);
            geometry[OPACITY_LOGIT] = logit(opacity);
        }
        match self.kind {
            Colors::Rgb => sh.iter_mut().zip(colors).for_each(|(dc, rgb)| *dc = (rgb - 0.5) / SH_C0),
            Colors::Sh { .. } if row == sh_row => sh.copy_from_slice(colors),
            Colors::Sh { .. } => {
                let rows = sh.chunks_exact_mut(sh_row).zip(colors.chunks_exact(row));
                rows.for_each(|(sh, colors)| sh.copy_from_slice(&colors[..sh_row]));
            }
        }
        Ok(())
    }

    /// What is wrong with a Gaussian, if anything is.
    #[cold]
    fn check(&self, gaussian: usize) -> Result<(), Fault> {
        let row = self.kind.row();
        let used = sh_coefficients(self.kind.degree()) * 3;
        let arrays = [
            ("means", &self.means[3 * gaussian..][..3]),
            ("quats", &self.quats[4 * gaussian..][..4]),
            ("scales", &self.scales[3 * gaussian..][..3]),
            ("opacities", &self.opacities[gaussian..][..1]),
            ("colors", &self.colors[row * gaussian..][..used]),
        ];
        for (what, numbers) in arrays {
            if let Some(&found) = numbers.iter().find(|number| !number.is_finite()) {
                return Err(Fault::NotFinite { what, gaussian, found });
            }
        }
        if let Some(&found) = self.scales[3 * gaussian..][..3].iter().find(|scale| **scale <= 0.0) {
            return Err(Fault::Scale { gaussian, found });
        }
        let found = self.opacities[gaussian];
        if !(0.0..=1.0).contains(&found) {
            return Err(Fault::Opacity { gaussian, found });
        }
        if self.quats[4 * gaussian..][..4].iter().all(|q| *q == 0.0) {
            return Err(Fault::Quaternion { gaussian });
        }
        Ok(())
    }
}

/// Whether no number is NaN or infinite, by the largest of the bits that hold exponent and fraction.
fn all_finite(numbers: &[f32]) -> bool {
    const INFINITE: i32 = f32::INFINITY.to_bits() as i32;
    let magnitude = |number: &f32| number.abs().to_bits() as i32;
    numbers.iter().fold(0, |largest, number| largest.max(magnitude(number))) < INFINITE
}

/// The chain rule: gradients by what is stored, of `stored`, to gradients by the arrays that were given.
pub(crate) fn chain(
    stored: &Gaussians,
    by_geometry: &[f32],
    by_sh: Vec<f32>,
    kind: Colors,
) -> ActivatedGradients {
    let n = stored.len();
    let mut means = vec![0.0; n * 3];
    let mut quats = vec![0.0; n * 4];
    let mut scales = vec![0.0; n * 3];
    let mut opacities = vec![0.0; n];
    means
        .par_chunks_mut(CHUNK * 3)
        .zip(quats.par_chunks_mut(CHUNK * 4))
        .zip(scales.par_chunks_mut(CHUNK * 3))
        .zip(opacities.par_chunks_mut(CHUNK))
        .zip(stored.geometry().par_chunks(CHUNK * ROW))
        .zip(by_geometry.par_chunks(CHUNK * ROW))
        .for_each(|(((((means, quats), scales), opacities), stored), gradients)| {
            let rows = stored.chunks_exact(ROW).zip(gradients.chunks_exact(ROW));
            for (place, (stored, gradient)) in rows.enumerate() {
                means[3 * place..][..3].copy_from_slice(&gradient[MEAN]);
                quats[4 * place..][..4].copy_from_slice(&gradient[QUATERNION]);
                // Most Gaussians of a view have no gradient, and need no exponential.
                if gradient[LOG_SCALE].iter().any(|g| *g != 0.0) {
                    for (axis, column) in LOG_SCALE.enumerate() {
                        scales[3 * place + axis] = gradient[column] / stored[column].exp();
                    }
                }
                let by_logit = gradient[OPACITY_LOGIT];
                if by_logit != 0.0 {
                    // 1 / (o (1 - o)) = 2 + e^x + e^-x for the logit x: nothing cancels at either end.
                    let odds = stored[OPACITY_LOGIT].exp();
                    opacities[place] = by_logit * (2.0 + odds + 1.0 / odds);
                }
            }
        });
    let colors = match kind {
        Colors::Rgb => {
            let mut by_rgb = by_sh;
            by_rgb.par_chunks_mut(CHUNK * 3).for_each(|chunk| chunk.iter_mut().for_each(|g| *g /= SH_C0));
            by_rgb
        }
        Colors::Sh { degree, per_gaussian } if sh_coefficients(degree) == per_gaussian => by_sh,
        Colors::Sh { degree, per_gaussian } => {
            let used = sh_coefficients(degree) * 3;
            let mut all = vec![0.0; n * per_gaussian * 3];
            let rows = all.par_chunks_mut(per_gaussian * 3).zip(by_sh.par_chunks(used));
            rows.for_each(|(all, used)| all[..used.len()].copy_from_slice(used));
            all
        }
    };
    ActivatedGradients { means, quats, scales, opacities, colors }
}

/// Standard deviations, opacities: what is stored, activated, for whoever goes on with the arrays.
pub(crate) fn activate(stored: &Gaussians) -> (Vec<f32>, Vec<f32>) {
    let rows = || stored.geometry().chunks_exact(ROW);
    let scales = rows().flat_map(|row| row[LOG_SCALE].iter().map(|log| log.exp())).collect();
    let opacities = rows().map(|row| gs_scene::sigmoid(row[OPACITY_LOGIT])).collect();
    (scales, opacities)
}

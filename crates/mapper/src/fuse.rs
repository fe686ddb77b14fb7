//! What a keyframe says of the Gaussians that it sees.
//!
//! The renderer is the model of the measurement. With w the share of a Gaussian in a pixel, one backward pass gives for every Gaussian Σ w,
//! Σ w v and Σ w e: v is the inverse depth of the keyframe at the pixel, e photograph less rendering. Their quotients are the first moments of
//! what the keyframe shows where the Gaussian is visible, and these are joined to those of the Gaussian with the weights of both.
//!
//! | the keyframe's surface, at the Gaussian's centre and on the mean | |
//! |---|---|
//! | at its depth | it is confirmed: its depth and its colour become the weighted means |
//! | behind it | the keyframe sees through it: it loses opacity, the more the fewer keyframes have confirmed it |
//! | before it | it is hidden, or something new stands before it: it stays |

use crate::compare::Pixel;
use crate::map::{Evidence, Map, mean};
use depth_backbone::ViewGeometry;
use glam::DVec3;
use gs_scene::{Camera, Gaussians, MEAN, OPACITY_LOGIT, SH_C0, sigmoid};
use rayon::prelude::*;

/// No Gaussian weighs more than this many confirmations: what has changed is learned again in as many.
pub(crate) const HEAVIEST: f32 = 30.0;
/// A Gaussian is visible in a keyframe from this screen mass on, pixels.
const VISIBLE: f32 = 0.05;
/// Least share of the new colour in the mean.
const LEAST_RATE: f32 = 0.1;
/// Differences of colour, 0..1, beyond this are of other things: highlights, moving things, edges that are a little off.
const SAME_COLOUR: f32 = 0.25;
/// A Gaussian that has become less opaque than this goes.
const FAINT: f32 = 0.02;
/// Gaussians per parallel task.
const CHUNK: usize = 1 << 10;

/// What a keyframe and the rendering of the map from its place say, pixel by pixel.
pub(crate) struct Observation<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) geometry: &'a ViewGeometry,
    pub(crate) pixels: &'a [Pixel],
    /// Relative difference up to which depths agree.
    pub(crate) tolerance: f32,
    /// Σ w and Σ w v of every Gaussian.
    pub(crate) shares: &'a [[f32; 2]],
    /// SH_C0 · Σ w e of every Gaussian, `[n, 3]`.
    pub(crate) by_colour: &'a [f32],
}

/// How many Gaussians a keyframe confirmed, saw through, and removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Fused {
    pub(crate) confirmed: usize,
    pub(crate) faded: usize,
    pub(crate) removed: usize,
}

/// Photograph less rendering where it counts: where the depths agree or the keyframe has none, and the colours are not of two things.
pub(crate) fn error(photograph: &[f32], rendered: &[f32], pixels: &[Pixel]) -> Vec<f32> {
    let mut error = vec![0.0; photograph.len()];
    let rows = error.par_chunks_mut(3).zip(photograph.par_chunks(3)).zip(rendered.par_chunks(3)).zip(pixels);
    rows.with_min_len(1 << 12).for_each(|(((error, photograph), rendered), pixel)| {
        if matches!(pixel, Pixel::Agrees | Pixel::Unknown) {
            let e: [f32; 3] = std::array::from_fn(|c| photograph[c] - rendered[c]);
            if e.iter().all(|e| e.abs() <= SAME_COLOUR) {
                error.copy_from_slice(&e);
            }
        }
    });
    error
}

/// Inverse depth of the keyframe at every pixel; that of the map where the keyframe does not know.
pub(crate) fn inverse_depths(geometry: &ViewGeometry, rendered: &[f32]) -> Vec<f32> {
    let inverse_depth =
        |(i, (&depth, &rendered)): (usize, (&f32, &f32))| match (geometry.is_confirmed(i), rendered) {
            (true, _) if depth > 0.0 => 1.0 / depth,
            (_, rendered) if rendered > 0.0 => 1.0 / rendered,
            _ => 0.0,
        };
    geometry.depth.data().iter().zip(rendered).enumerate().map(inverse_depth).collect()
}

/// Joins a keyframe's observation to the map, and removes what has become faint.
pub(crate) fn fuse(map: &mut Map, observation: &Observation<'_>) -> Fused {
    const ROW: usize = Gaussians::GEOMETRY;
    let (geometry, sh) = map.gaussians.buffers_mut();
    let parts = geometry
        .par_chunks_mut(CHUNK * ROW)
        .zip(sh.par_chunks_mut(CHUNK * 3))
        .zip(map.evidence.par_chunks_mut(CHUNK))
        .zip(observation.shares.par_chunks(CHUNK))
        .zip(observation.by_colour.par_chunks(CHUNK * 3));
    let of_part = |((((rows, sh), evidence), shares), by_colour): (_, &[f32])| {
        let rows: &mut [f32] = rows;
        let sh: &mut [f32] = sh;
        let evidence: &mut [Evidence] = evidence;
        let shares: &[[f32; 2]] = shares;
        let mut found = Fused::default();
        for (i, evidence) in evidence.iter_mut().enumerate() {
            let [mass, moment] = shares[i];
            if mass < VISIBLE {
                continue;
            }
            evidence.mass += mass;
            evidence.looks += 1.0;
            let (row, sh) = (&mut rows[i * ROW..][..ROW], &mut sh[i * 3..][..3]);
            let observed = f64::from(moment / mass);
            match observation.verdict(mean(row), observed) {
                Verdict::Confirmed(z) => {
                    found.confirmed += 1;
                    let weight = f64::from(evidence.weight);
                    let fused = (weight / z + observed) / (weight + 1.0);
                    let eye = observation.camera.position();
                    let moved = eye + (mean(row) - eye) / (z * fused);
                    row[MEAN].copy_from_slice(&moved.as_vec3().to_array());
                    let rate = (1.0 / (evidence.weight + 1.0)).max(LEAST_RATE);
                    for (sh, by) in sh.iter_mut().zip(&by_colour[i * 3..]) {
                        // by / SH_C0 is Σ w e, which over Σ w is a step of the colour, which over SH_C0 is a step of the coefficient.
                        *sh += rate * by / (SH_C0 * SH_C0 * mass);
                    }
                    evidence.weight = (evidence.weight + 1.0).min(HEAVIEST);
                }
                Verdict::SeenThrough => {
                    found.faded += 1;
                    let left = f64::from(evidence.weight / (evidence.weight + 2.0));
                    let opacity = f64::from(sigmoid(row[OPACITY_LOGIT])).min(1.0 - 1e-6);
                    let depth = -(-opacity).ln_1p() * left;
                    let opacity = -(-depth).exp_m1();
                    row[OPACITY_LOGIT] = (opacity / (1.0 - opacity)).ln() as f32;
                    evidence.weight = (evidence.weight - 1.0).max(0.5);
                }
                Verdict::Hidden => {}
            }
        }
        found
    };
    let parts: Vec<Fused> = parts.map(of_part).collect();
    let mut fused = parts.into_iter().fold(Fused::default(), |a, b| Fused {
        confirmed: a.confirmed + b.confirmed,
        faded: a.faded + b.faded,
        removed: 0,
    });
    if fused.faded > 0 {
        let rows = map.gaussians.geometry().chunks_exact(ROW);
        let keep: Vec<bool> = rows.map(|row| sigmoid(row[OPACITY_LOGIT]) >= FAINT).collect();
        fused.removed = keep.iter().filter(|keep| !**keep).count();
        map.retain(&keep);
    }
    fused
}

/// Adds the mean colour error of the keyframe, where they are visible, to the colours of the newest `count` Gaussians. `shares` and
/// `by_colour` are those of an [`Observation`].
pub(crate) fn recolour(map: &mut Map, count: usize, shares: &[[f32; 2]], by_colour: &[f32]) {
    let first = map.len() - count;
    let sh = &mut map.gaussians.buffers_mut().1[first * 3..];
    for ((sh, by), [mass, _]) in
        sh.chunks_exact_mut(3).zip(by_colour[first * 3..].chunks_exact(3)).zip(&shares[first..])
    {
        if *mass >= VISIBLE {
            for (sh, by) in sh.iter_mut().zip(by) {
                let step = by / (SH_C0 * mass);
                *sh += step.clamp(-SAME_COLOUR, SAME_COLOUR) / SH_C0;
            }
        }
    }
}

/// What a keyframe says of a Gaussian that is visible.
enum Verdict {
    /// There is a surface; the Gaussian's z-depth.
    Confirmed(f64),
    SeenThrough,
    Hidden,
}

impl Observation<'_> {
    /// `observed` is the mean inverse depth of the keyframe where the Gaussian is visible.
    fn verdict(&self, mean: DVec3, observed: f64) -> Verdict {
        let z = self.camera.to_camera(mean).z;
        let pixel = self.camera.project(mean).filter(|&pixel| self.camera.contains(pixel));
        let Some(pixel) = pixel else { return Verdict::Hidden };
        let i = pixel.y as usize * self.camera.width() + pixel.x as usize;
        let tolerance = f64::from(self.tolerance);
        // Its depth over that of the surface: above 1 the Gaussian lies behind.
        let on_mean = z * observed;
        let sure = self.geometry.is_confirmed(i) && self.geometry.depth.data()[i] > 0.0;
        if !sure {
            return Verdict::Hidden;
        }
        let at_centre = z / f64::from(self.geometry.depth.data()[i]);
        let agrees = |ratio: f64, by: f64| (ratio - 1.0).abs() <= by;
        if agrees(on_mean, tolerance) && agrees(at_centre, 2.0 * tolerance) {
            return Verdict::Confirmed(z);
        }
        let through = 1.0 - 2.0 * tolerance;
        if self.pixels[i] == Pixel::Through && on_mean < through && at_centre < through {
            return Verdict::SeenThrough;
        }
        Verdict::Hidden
    }
}

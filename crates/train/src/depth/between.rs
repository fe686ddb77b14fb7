//! What photographs say of depth that nobody measured: how well it predicts each photograph from the others, held-out ones too, and whether
//! the views' surfaces agree.

use super::loss::KNEE;
use depth_backbone::{Pair, Tolerance};
use gs_scene::View;
use image_metrics::{SsimScratch, SsimTarget};
use rayon::prelude::*;

/// Share of 1 - SSIM in the photometric error; the rest is the mean absolute difference.
const DSSIM: f32 = 0.85;
/// Smallest and largest change of another photograph's exposure.
const GAINS: [f32; 2] = [0.75, 1.0 / 0.75];
/// A pair of photographs with less than this share of its pixels in common is not compared.
const LEAST_SEEN: f32 = 0.02;

/// Weights of the two errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BetweenWeights {
    pub(crate) photometric: f32,
    pub(crate) agreement: f32,
}

/// A context view with its surface.
pub(crate) struct Surface<'a> {
    pub(crate) view: &'a View,
    /// Inverse depth by the network, `[height, width]`.
    pub(crate) predicted: Vec<f32>,
    /// Inverse depth by stereo, filled in where it confirms nothing.
    pub(crate) stereo: Vec<f32>,
    /// Stereo's where it confirms something or the network is unsure, the network's elsewhere.
    pub(crate) joined: Vec<f32>,
    /// Confidence in that, ½ and more where stereo confirms it.
    pub(crate) confidence: Vec<f32>,
}

impl Surface<'_> {
    fn is_confirmed(&self, pixel: usize) -> bool {
        self.confidence[pixel] >= 0.5
    }

    /// Whether the joined surface is the network's at a pixel: stereo's cannot learn.
    fn learns(&self, pixel: usize) -> bool {
        self.joined[pixel] == self.predicted[pixel]
    }

    /// Inverse depths that hide what is behind them: those that are confirmed; 0 elsewhere.
    fn hiding(&self) -> Vec<f32> {
        let hides = |(pixel, w): (usize, &f32)| if self.is_confirmed(pixel) { *w } else { 0.0 };
        self.joined.iter().enumerate().map(hides).collect()
    }
}

/// Where a pixel at some inverse depth falls in another photograph.
struct Landing {
    x: f32,
    y: f32,
    /// Inverse depth seen from there.
    inverse_depth: f32,
    /// Derivatives of the three by the inverse depth.
    by: [f32; 3],
}

impl Landing {
    fn new(pair: &Pair, (u, v): (f32, f32), w: f32, (width, height): (usize, usize)) -> Option<Self> {
        let h = pair.project(u, v, w);
        let (x, y) = (h.x / h.z, h.y / h.z);
        let inside = h.z > 0.0 && x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
        let e = pair.epipole().as_vec3();
        let by = [(e.x - x * e.z) / h.z, (e.y - y * e.z) / h.z, (1.0 - w * e.z / h.z) / h.z];
        inside.then_some(Self { x, y, inverse_depth: w / h.z, by })
    }

    fn pixel(&self, width: usize) -> usize {
        self.y as usize * width + self.x as usize
    }
}

/// Middle of a pixel.
fn middle(pixel: usize, width: usize) -> (f32, f32) {
    ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5)
}

fn size(view: &View) -> (usize, usize) {
    (view.image().width(), view.image().height())
}

/// Mean error of the context views, and its gradient by their predicted inverse depths. `held_out` are further photographs; `step` is a plane
/// step of inverse depth.
pub(crate) fn loss(
    surfaces: &[Surface],
    held_out: &[View],
    step: f32,
    weights: BetweenWeights,
) -> (f64, Vec<Vec<f32>>) {
    let share = 1.0 / surfaces.len().max(1) as f32;
    let hiding: Vec<Vec<f32>> = surfaces.par_iter().map(Surface::hiding).collect();
    let fronts: Vec<Vec<f32>> = held_out.par_iter().map(|view| front(view, surfaces, &hiding)).collect();
    let of_view = |i: usize| {
        let mut gradients: Vec<Vec<f32>> = surfaces.iter().map(|s| vec![0.0; s.predicted.len()]).collect();
        let context = surfaces.iter().enumerate().filter(|(j, _)| *j != i);
        let others: Vec<(&View, &[f32])> = context
            .map(|(j, surface)| (surface.view, &hiding[j][..]))
            .chain(held_out.iter().zip(fronts.iter().map(Vec::as_slice)))
            .collect();
        let of_colours = share * weights.photometric;
        let mut value =
            f64::from(of_colours) * photometric(&surfaces[i], &others, step, of_colours, &mut gradients[i]);
        value += f64::from(share * weights.agreement)
            * agreement(surfaces, i, step, share * weights.agreement, &mut gradients);
        (value, gradients)
    };
    let all: Vec<(f64, Vec<Vec<f32>>)> = (0..surfaces.len()).into_par_iter().map(of_view).collect();
    let mut sum = (0.0, surfaces.iter().map(|s| vec![0.0; s.predicted.len()]).collect::<Vec<_>>());
    for (value, gradients) in all {
        sum.0 += value;
        for (sum, gradient) in sum.1.iter_mut().zip(gradients) {
            sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
        }
    }
    sum
}

/// Inverse depth of the nearest of the hiding surfaces on each pixel of a view that has none of its own; 0 where none falls.
fn front(view: &View, surfaces: &[Surface], hiding: &[Vec<f32>]) -> Vec<f32> {
    let (width, height) = size(view);
    let mut front = vec![0.0_f32; width * height];
    for (surface, hiding) in surfaces.iter().zip(hiding) {
        let pair = Pair::new(surface.view.camera(), view.camera());
        let columns = size(surface.view).0;
        for (pixel, &w) in hiding.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let Some(landing) = Landing::new(&pair, middle(pixel, columns), w, (width, height)) else {
                continue;
            };
            // The four pixels about it, so that a surface seen from nearer has no gaps.
            for (dx, dy) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)] {
                let (x, y) = (landing.x + dx, landing.y + dy);
                if x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32 {
                    let to = &mut front[y as usize * width + x as usize];
                    *to = to.max(landing.inverse_depth);
                }
            }
        }
    }
    front
}

/// Another photograph, seen from a view by its depth.
struct Warped {
    /// `[height, width, 3]`; meaningless where the other photograph does not see the surface.
    colours: Vec<[f32; 3]>,
    /// Derivative by inverse depth.
    by_inverse_depth: Vec<[f32; 3]>,
    seen: Vec<bool>,
}

/// `front` is the inverse depth of what hides points from `other`.
fn warped(surface: &Surface, other: &View, front: &[f32], step: f32) -> Warped {
    let (width, height) = size(other);
    let columns = size(surface.view).0;
    let pair = Pair::new(surface.view.camera(), other.camera());
    let (n, tolerance) = (surface.predicted.len(), Tolerance::of_step(step));
    let mut out =
        Warped { colours: vec![[0.0; 3]; n], by_inverse_depth: vec![[0.0; 3]; n], seen: vec![false; n] };
    // What stereo's surface hides stays hidden: as the network's moves, points would be hidden in one step and seen in the next, and such
    // jumps change the error more than its gradient says.
    let is_hidden = |pixel: usize| {
        let place = Landing::new(&pair, middle(pixel, columns), surface.stereo[pixel], (width, height));
        place.is_some_and(|place| {
            place.inverse_depth < front[place.pixel(width)] - tolerance.at(place.inverse_depth)
        })
    };
    for (pixel, &w) in surface.predicted.iter().enumerate() {
        let Some(landing) = Landing::new(&pair, middle(pixel, columns), w, (width, height)) else { continue };
        let (x, y) = (landing.x - 0.5, landing.y - 0.5);
        if is_hidden(pixel) || x < 0.0 || y < 0.0 || x >= (width - 1) as f32 || y >= (height - 1) as f32 {
            continue;
        }
        let (a, b) = (x.fract(), y.fract());
        let at = |dx: usize, dy: usize| other.image().pixel(x as usize + dx, y as usize + dy);
        let [[p, q], [r, s]] = [[at(0, 0), at(1, 0)], [at(0, 1), at(1, 1)]];
        for c in 0..3 {
            let (top, bottom) = (p[c] + a * (q[c] - p[c]), r[c] + a * (s[c] - r[c]));
            out.colours[pixel][c] = top + b * (bottom - top);
            let by_x = (1.0 - b) * (q[c] - p[c]) + b * (s[c] - r[c]);
            out.by_inverse_depth[pixel][c] = by_x * landing.by[0] + (bottom - top) * landing.by[1];
        }
        out.seen[pixel] = true;
    }
    out
}

/// Mean over the other photographs of the difference of a view and what they show of its surface; `weight` times its derivative by inverse depth is added
/// to `gradient`.
fn photometric(
    surface: &Surface,
    others: &[(&View, &[f32])],
    step: f32,
    weight: f32,
    gradient: &mut [f32],
) -> f64 {
    let own = surface.view.image().data();
    let (width, height) = size(surface.view);
    // There is none of a picture smaller than the window of SSIM.
    let target = SsimTarget::new(own, width, height).ok();
    let (mut scratch, mut sum) = (SsimScratch::default(), 0.0);
    let share = weight / others.len().max(1) as f32;
    for &(other, front) in others {
        let warped = warped(surface, other, front, step);
        let gains = gains(own, &warped);
        sum += compare(own, &warped, gains, target.as_ref(), &mut scratch, share, gradient);
    }
    sum / others.len().max(1) as f64
}

/// The exposure of the view over that of the other photograph, by channel.
fn gains(own: &[f32], warped: &Warped) -> [f32; 3] {
    let (mut ours, mut theirs) = ([0.0_f64; 3], [0.0_f64; 3]);
    let pixels = own.as_chunks::<3>().0.iter().zip(&warped.colours).zip(&warped.seen);
    for ((own, other), _) in pixels.filter(|(_, seen)| **seen) {
        for c in 0..3 {
            ours[c] += f64::from(own[c]);
            theirs[c] += f64::from(other[c]);
        }
    }
    std::array::from_fn(|c| {
        let gain = (ours[c] / theirs[c]) as f32;
        if gain.is_finite() { gain.clamp(GAINS[0], GAINS[1]) } else { 1.0 }
    })
}

/// The difference over the pixels that are seen; `weight` times its derivative is added to `gradient`.
fn compare(
    own: &[f32],
    warped: &Warped,
    gains: [f32; 3],
    target: Option<&SsimTarget>,
    scratch: &mut SsimScratch,
    weight: f32,
    gradient: &mut [f32],
) -> f64 {
    let n = warped.seen.len();
    let seen = warped.seen.iter().filter(|seen| **seen).count();
    if (seen as f32) < LEAST_SEEN * n as f32 || seen == 0 {
        return 0.0;
    }
    // What is not seen equals the view, and adds nothing.
    let mut shown = own.to_vec();
    for ((shown, colour), _) in
        shown.as_chunks_mut::<3>().0.iter_mut().zip(&warped.colours).zip(&warped.seen).filter(|(_, s)| **s)
    {
        *shown = std::array::from_fn(|c| gains[c] * colour[c]);
    }
    let per_number = (1.0 - DSSIM) / (3 * seen) as f32;
    let mut value = 0.0;
    let mut by_shown: Vec<f32> = shown
        .iter()
        .zip(own)
        .map(|(shown, own)| {
            let difference = shown - own;
            value += f64::from(per_number * difference.abs());
            if difference == 0.0 { 0.0 } else { per_number * difference.signum() }
        })
        .collect();
    let structure = DSSIM * n as f32 / seen as f32;
    // Photographs hold finite numbers, so there is always an answer.
    let of_structure =
        target.and_then(|target| target.loss_with_gradient(&shown, structure, &mut by_shown, scratch).ok());
    value += f64::from(structure) * of_structure.unwrap_or(0.0);
    for (pixel, by_shown) in by_shown.as_chunks::<3>().0.iter().enumerate().filter(|(i, _)| warped.seen[*i]) {
        let by = &warped.by_inverse_depth[pixel];
        gradient[pixel] += weight * (0..3).map(|c| by_shown[c] * gains[c] * by[c]).sum::<f32>();
    }
    value
}

/// Mean disagreement of a view's surface with those of the other context views; `weight` times its derivatives are added to `gradients`. A point
/// that another surface hides disagrees with nobody. Each of the two learns as far as the other is confident.
fn agreement(surfaces: &[Surface], index: usize, step: f32, weight: f32, gradients: &mut [Vec<f32>]) -> f64 {
    let own = &surfaces[index];
    let columns = size(own.view).0;
    let pairs = own.predicted.len() * surfaces.len().saturating_sub(1).max(1);
    let (share, tolerance) = (weight / pairs as f32, Tolerance::of_step(step));
    let mut sum = 0.0;
    for (j, other) in surfaces.iter().enumerate().filter(|(j, _)| *j != index) {
        let pair = Pair::new(own.view.camera(), other.view.camera());
        let to = size(other.view);
        for (pixel, &w) in own.predicted.iter().enumerate() {
            let Some(landing) = Landing::new(&pair, middle(pixel, columns), w, to) else { continue };
            let theirs = landing.pixel(to.0);
            let nearer = landing.inverse_depth - other.joined[theirs];
            if nearer < -tolerance.at(landing.inverse_depth) {
                continue;
            }
            let steps = nearer / step;
            let size = steps.abs();
            let of_own = other.confidence[theirs];
            sum += f64::from(of_own * (1.0 + size / KNEE).ln());
            let slope = share * steps.signum() / (KNEE + size) / step;
            gradients[index][pixel] += of_own * slope * landing.by[2];
            if other.learns(theirs) {
                gradients[j][theirs] -= own.confidence[pixel] * slope;
            }
        }
    }
    sum / pairs as f64
}

#[cfg(test)]
#[path = "between_tests.rs"]
mod tests;

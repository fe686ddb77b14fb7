//! What the network sees of a view: everything that stereo knows, in plane steps, at half the picture's size.

use super::decode::Decoded;
use super::grid::Grid;
use crate::consistency::Witness;
use crate::pair::Pair;
use crate::plane_sweep::{Matched, costs_of, has_parallax};
use crate::range::Planes;
use gs_scene::View;
use rayon::prelude::*;

/// Channels of each of the four pixels of a block, for [`FULL`] times four channels …
const FULL: usize = 5;
/// … and channels of a block.
const BLOCK: usize = 20;
/// Channels in all.
pub(crate) const INPUTS: usize = 4 * FULL + BLOCK;

/// Confidence of depth that no view confirms stays below ½.
const MOST_UNCONFIRMED: f32 = 0.49;
/// With less confidence than this the network is worse than interpolation: it was trained on generated scenes, and is unsure in photographs
/// that are unlike them (docs/bench/learned-depth.md).
const LEAST_CONFIDENCE: f32 = 0.2;

/// What stereo knows of one view, each `[height, width]`.
pub(crate) struct Evidence {
    /// Inverse depth by semi-global matching.
    pub(crate) matched: Vec<f32>,
    /// How far the best plane stands out among those about it, 0..1.
    pub(crate) distinct: Vec<f32>,
    /// Inverse depth that the views agree on, filled where they do not.
    pub(crate) inverse_depth: Vec<f32>,
    /// Confidence in that.
    pub(crate) confidence: Vec<f32>,
}

/// What the network sees of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// Size of the picture.
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Channels of the blocks of 2×2 pixels.
    pub(crate) grid: Grid,
    /// Inverse depth of each block, that of one of its pixels; plane steps from the far end.
    pub(crate) base: Vec<f32>,
    /// Inverse depth by stereo, `[height, width]`, plane steps from the far end.
    pub(crate) own: Vec<f32>,
    /// Inverse depth of the far end, and of a plane step.
    pub(crate) unit: [f32; 2],
}

/// The numbers of [`Inputs`], to be stored.
#[derive(Debug, Clone, PartialEq)]
pub struct InputParts {
    /// Size of the picture.
    pub size: (usize, usize),
    /// Channels of the blocks of 2×2 pixels, `[ceil(height / 2), ceil(width / 2), CHANNELS]`.
    pub blocks: Vec<f32>,
    /// Inverse depth of each block, plane steps from the far end.
    pub base: Vec<f32>,
    /// Inverse depth by stereo, `[height, width]`, plane steps from the far end.
    pub own: Vec<f32>,
    /// Inverse depth of the far end, and of a plane step.
    pub unit: [f32; 2],
}

/// Inverse depth of other views' surfaces where they fall in a block.
#[derive(Clone, Copy, Default)]
struct Fallen {
    nearest: f32,
    sum: f32,
    count: f32,
}

impl Inputs {
    /// Of view `index`, beside all others.
    pub(crate) fn new(index: usize, matched: &[Matched], evidence: &[Evidence], planes: &Planes) -> Self {
        let (view, own_evidence) = (&matched[index], &evidence[index]);
        let (width, height) = (view.texture.width, view.texture.height);
        let half = (width.div_ceil(2), height.div_ceil(2));
        let (farthest, step) = (planes.ends().0, planes.step());
        let in_steps = |w: f32| (w - farthest) / step;
        let steps: Vec<f32> = own_evidence.inverse_depth.iter().map(|&w| in_steps(w)).collect();
        let others: Vec<usize> = (0..matched.len())
            .filter(|&other| other != index && has_parallax(index, other, matched, planes))
            .collect();
        let witnesses: Vec<Witness> = others
            .iter()
            .map(|&other| Witness::new(view.view, matched[other].view, &evidence[other].inverse_depth))
            .collect();
        let fallen = fallen(view.view, &others, matched, evidence);
        let cost = costs_of(view, matched, &own_evidence.inverse_depth, planes);
        let pixels_per_step = pixels_per_step(view, matched, planes);
        let count = planes.count() as f32;
        let mut grid = Grid::new(half.0, half.1, INPUTS);
        let mut base = vec![0.0; half.0 * half.1];
        for y in 0..half.1 {
            for x in 0..half.0 {
                let cell = y * half.0 + x;
                let pixels: [usize; 4] = std::array::from_fn(|part| {
                    let (u, v) = ((2 * x + part % 2).min(width - 1), (2 * y + part / 2).min(height - 1));
                    v * width + u
                });
                let mean = pixels.iter().map(|&pixel| steps[pixel]).sum::<f32>() / 4.0;
                // A depth that one of the pixels has, not one between a near and a far surface.
                let off = |pixel: usize| (steps[pixel] - mean).abs();
                let chosen =
                    pixels.into_iter().min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(pixels[0]);
                let w = steps[chosen];
                base[cell] = w;
                let channels = grid.pixel_mut(x, y);
                let (full, block) = channels.split_at_mut(4 * FULL);
                for (full, &pixel) in full.chunks_exact_mut(FULL).zip(&pixels) {
                    let colour = &view.view.image().data()[3 * pixel..][..3];
                    full.copy_from_slice(&[
                        colour[0] - 0.5,
                        colour[1] - 0.5,
                        colour[2] - 0.5,
                        (steps[pixel] - w).asinh(),
                        own_evidence.confidence[pixel],
                    ]);
                }
                let said = Said::new(
                    &witnesses,
                    &others,
                    evidence,
                    view.view,
                    chosen,
                    own_evidence.inverse_depth[chosen],
                    step,
                );
                let fallen = fallen[cell];
                let has = f32::from(u8::from(fallen.count > 0.0));
                let off = |other: f32| has * (in_steps(other) - w).asinh();
                block.copy_from_slice(&[
                    2.0 * w / count - 1.0,
                    (in_steps(own_evidence.matched[chosen]) - w).asinh(),
                    cost[chosen],
                    own_evidence.distinct[chosen],
                    (1.0 + view.statistics.deviation(chosen)).ln() / 4.0,
                    said.agree,
                    said.floats,
                    said.hidden,
                    (said.seen as f32).ln_1p() / 2.0,
                    said.least.asinh(),
                    said.most.asinh(),
                    said.middle.asinh(),
                    4.0 * said.colour,
                    4.0 * said.least_colour,
                    has,
                    off(fallen.nearest),
                    off(fallen.sum / fallen.count.max(1.0)),
                    fallen.count.ln_1p() / 2.0,
                    (2 * y + 1) as f32 / half.1 as f32 - 1.0,
                    pixels_per_step.ln(),
                ]);
            }
        }
        Self { width, height, grid, base, own: steps, unit: [farthest, step] }
    }

    /// Number of channels of a block.
    pub const CHANNELS: usize = INPUTS;

    /// The channels of a block whose left and right are swapped.
    pub fn mirror_block(channels: &mut [f32]) {
        for row in channels[..4 * FULL].chunks_exact_mut(2 * FULL) {
            let (left, right) = row.split_at_mut(FULL);
            left.swap_with_slice(right);
        }
    }

    /// Their numbers.
    #[must_use]
    pub fn to_parts(&self) -> InputParts {
        let blocks = (0..self.grid.height).flat_map(|y| self.grid.row(y).iter().copied()).collect();
        let (base, steps) = (self.base.clone(), self.own.clone());
        InputParts { size: (self.width, self.height), blocks, base, own: steps, unit: self.unit }
    }

    /// Inputs of such numbers.
    ///
    /// # Panics
    /// If there are not as many as the size asks for.
    #[must_use]
    pub fn of_parts(parts: InputParts) -> Self {
        let InputParts { size: (width, height), blocks, base, own: steps, unit } = parts;
        let mut grid = Grid::new(width.div_ceil(2), height.div_ceil(2), INPUTS);
        assert_eq!(blocks.len(), grid.width * grid.height * INPUTS, "channels of the blocks");
        assert_eq!((base.len(), steps.len()), (grid.width * grid.height, width * height), "inverse depths");
        for (y, row) in blocks.chunks_exact(grid.width * INPUTS).enumerate() {
            grid.row_mut(y).copy_from_slice(row);
        }
        Self { width, height, grid, base, own: steps, unit }
    }

    /// Width and height of the picture.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// z-depth of an inverse depth in plane steps from the far end; 0 of a NaN.
    #[must_use]
    pub fn depth_of(&self, steps: f32) -> f32 {
        if steps.is_nan() { 0.0 } else { 1.0 / (self.unit[0] + self.unit[1] * steps.max(0.0)) }
    }

    /// Inverse depth and confidence of every pixel: `stereo`'s, given as such pairs, where the views confirm it and where the network is unsure, the
    /// network's elsewhere. What no view confirms and the network takes for sky has a confidence of 0. Confirmed surfaces are as good as they need to
    /// be: with the exact depth there, closed-form scenes are no better (docs/bench/learned-depth.md).
    #[must_use]
    pub fn join(&self, decoded: &Decoded, stereo: impl Iterator<Item = (f32, f32)>) -> (Vec<f32>, Vec<f32>) {
        let [far, step] = self.unit;
        let confidence = decoded.confidence(self.width);
        let choose = |(pixel, stereo): (usize, (f32, f32))| {
            let (filled, confirmed) = stereo;
            if confirmed >= 0.5 {
                stereo
            } else if decoded.is_sky(pixel, self.width) {
                (filled, 0.0)
            } else if confidence[pixel] < LEAST_CONFIDENCE {
                stereo
            } else {
                let steps = self.own[pixel] + decoded.correction[pixel];
                (far + step * steps.max(0.0), confidence[pixel].min(MOST_UNCONFIRMED))
            }
        };
        stereo.enumerate().map(choose).unzip()
    }

    /// Confidence of stereo, `[height, width]`.
    #[must_use]
    pub fn stereo_confidence(&self) -> Vec<f32> {
        let confidence = |i: usize| {
            let (x, y) = (i % self.width, i / self.width);
            self.grid.pixel(x / 2, y / 2)[(y % 2 * 2 + x % 2) * FULL + FULL - 1]
        };
        (0..self.own.len()).map(confidence).collect()
    }

    /// Inverse depth by stereo, `[height, width]`, plane steps from the far end.
    #[must_use]
    pub fn stereo(&self) -> &[f32] {
        &self.own
    }
}

/// What the other views say of a point: shares 0..1, and differences of their surface and the point, plane steps, positive where
/// their surface is nearer.
#[derive(Default)]
struct Said {
    agree: f32,
    floats: f32,
    hidden: f32,
    seen: usize,
    least: f32,
    most: f32,
    middle: f32,
    colour: f32,
    least_colour: f32,
}

impl Said {
    fn new(
        witnesses: &[Witness],
        others: &[usize],
        evidence: &[Evidence],
        view: &View,
        pixel: usize,
        w: f32,
        step: f32,
    ) -> Self {
        /// Within this many steps surfaces are the same.
        const SAME: f32 = 1.5;
        let width = view.image().width();
        let (u, v) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
        let colour = &view.image().data()[3 * pixel..][..3];
        let mut said = Self { least: f32::MAX, most: f32::MIN, least_colour: f32::MAX, ..Self::default() };
        let mut all = Vec::with_capacity(witnesses.len());
        for (witness, &other) in witnesses.iter().zip(others) {
            let Some((pixel, nearer)) = witness.nearer(u, v, w) else { continue };
            let nearer = nearer / step;
            let weight = evidence[other].confidence[pixel];
            if nearer.abs() <= SAME {
                said.agree += weight;
            } else if nearer < 0.0 {
                said.floats += weight;
            } else {
                said.hidden += weight;
            }
            all.push(nearer);
            said.seen += 1;
            (said.least, said.most) = (said.least.min(nearer), said.most.max(nearer));
            let theirs = witness.colour(pixel);
            let difference = colour.iter().zip(theirs).map(|(a, b)| (a - b).abs()).sum::<f32>() / 3.0;
            said.colour += difference;
            said.least_colour = said.least_colour.min(difference);
        }
        if said.seen == 0 {
            return Self::default();
        }
        let share = 1.0 / said.seen as f32;
        for value in [&mut said.agree, &mut said.floats, &mut said.hidden, &mut said.colour] {
            *value *= share;
        }
        let middle = all.len() / 2;
        said.middle = *all.select_nth_unstable_by(middle, f32::total_cmp).1;
        said
    }
}

/// Where the confirmed surfaces of other views fall in the blocks of a view: inverse depths seen from it.
fn fallen(view: &View, others: &[usize], matched: &[Matched], evidence: &[Evidence]) -> Vec<Fallen> {
    let (width, height) = (view.image().width(), view.image().height());
    let half = width.div_ceil(2);
    let mut all = vec![Fallen::default(); half * height.div_ceil(2)];
    for &other in others {
        let (from, known) = (&matched[other], &evidence[other]);
        let pair = Pair::new(from.view.camera(), view.camera());
        let their_width = from.texture.width;
        for (i, (&w, &confidence)) in known.inverse_depth.iter().zip(&known.confidence).enumerate() {
            if confidence < 0.5 {
                continue;
            }
            let h = pair.project((i % their_width) as f32 + 0.5, (i / their_width) as f32 + 0.5, w);
            let (x, y) = (h.x / h.z, h.y / h.z);
            if h.z > 0.0 && x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32 {
                let seen = w / h.z;
                let to = &mut all[y as usize / 2 * half + x as usize / 2];
                to.nearest = to.nearest.max(seen);
                to.sum += seen;
                to.count += 1.0;
            }
        }
    }
    all
}

/// By how many pixels a point in the middle of the picture moves in the nearest source for one plane step.
fn pixels_per_step(view: &Matched, matched: &[Matched], planes: &Planes) -> f32 {
    let (u, v) = (0.5 * view.texture.width as f32, 0.5 * view.texture.height as f32);
    let w = planes.inverse_depth_at(0.5) as f32;
    let moved = |source: &usize| {
        let pair = Pair::new(view.view.camera(), matched[*source].view.camera());
        let place = |w: f32| {
            let h = pair.project(u, v, w);
            (h.x / h.z, h.y / h.z)
        };
        let (a, b) = (place(w - 0.5 * planes.step()), place(w + 0.5 * planes.step()));
        (a.0 - b.0).hypot(a.1 - b.1)
    };
    view.sources.first().map_or(1.0, moved).clamp(1e-2, 1e2)
}

/// The inputs of all views.
pub(crate) fn of_all(matched: &[Matched], evidence: &[Evidence], planes: &Planes) -> Vec<Inputs> {
    (0..matched.len()).into_par_iter().map(|index| Inputs::new(index, matched, evidence, planes)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> InputParts {
        let (width, height) = (7, 5);
        let noise = |i: usize| ((i as f32 * 12.9898).sin() * 43_758.547).fract();
        InputParts {
            size: (width, height),
            blocks: (0..12 * INPUTS).map(noise).collect(),
            base: (0..12).map(noise).collect(),
            own: (0..35).map(noise).collect(),
            unit: [0.1, 0.02],
        }
    }

    #[test]
    fn parts_make_the_same_inputs_again() {
        let inputs = Inputs::of_parts(example());
        assert_eq!(inputs.to_parts(), example());
        assert_eq!(inputs.size(), (7, 5));
        assert_eq!(inputs.depth_of(f32::NAN), 0.0);
        assert_eq!(inputs.depth_of(-3.0), 10.0);
        assert!((inputs.depth_of(20.0) - 2.0).abs() < 1e-6);
    }

    #[test]
    fn a_block_mirrored_twice_is_itself_and_once_has_its_pixels_swapped() {
        let before: Vec<f32> = (0..INPUTS).map(|i| i as f32).collect();
        let mut block = before.clone();
        Inputs::mirror_block(&mut block);
        assert_eq!((block[0], block[FULL], block[2 * FULL]), (FULL as f32, 0.0, 3.0 * FULL as f32));
        assert_eq!(block[4 * FULL..], before[4 * FULL..]);
        Inputs::mirror_block(&mut block);
        assert_eq!(block, before);
    }

    #[test]
    fn the_network_fills_what_stereo_does_not_confirm_and_itself_is_sure_of() {
        let inputs = Inputs::of_parts(example());
        let n = inputs.own.len();
        let decoded = |log_error: f32| Decoded {
            correction: vec![1.0; n],
            log_error: vec![log_error; n],
            sky: vec![-1.0; 12],
        };
        let join = |log_error: f32, confidence: f32| {
            inputs.join(&decoded(log_error), std::iter::repeat_n((0.3, confidence), n))
        };
        let (sure, unsure) = (-2.0, 2.5);
        assert_eq!(join(sure, 0.5), (vec![0.3; n], vec![0.5; n]));
        assert_eq!(join(unsure, 0.25), (vec![0.3; n], vec![0.25; n]));
        let (filled, confidence) = join(sure, 0.25);
        let expected = |own: &f32| 0.1 + 0.02 * (own + 1.0).max(0.0);
        assert!(filled.iter().zip(&inputs.own).all(|(w, own)| (w - expected(own)).abs() < 1e-6));
        assert_eq!(confidence, vec![MOST_UNCONFIRMED; n]);
        // Sky has no confidence, unless other views confirm that there is something.
        let sky = Decoded { sky: vec![1.0; 12], ..decoded(unsure) };
        for (stereo, expected) in [(0.25, 0.0), (0.5, 0.5)] {
            let joined = inputs.join(&sky, std::iter::repeat_n((0.3, stereo), n));
            assert_eq!(joined, (vec![0.3; n], vec![expected; n]));
        }
    }

    #[test]
    fn confidence_is_read_from_the_pixels_of_the_blocks() {
        let mut parts = example();
        for (index, block) in parts.blocks.chunks_exact_mut(INPUTS).enumerate() {
            for part in 0..4 {
                block[part * FULL + FULL - 1] = (10 * index + part) as f32;
            }
        }
        let confidence = Inputs::of_parts(parts).stereo_confidence();
        // Row 3, column 6: block (3, 1), its lower left pixel.
        assert_eq!(confidence[3 * 7 + 6], (10 * 7 + 2) as f32);
    }
}

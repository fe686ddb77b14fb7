//! What the views say of each other's depth.

use crate::pair::Pair;
use crate::range::Planes;
use gs_scene::View;
use rayon::prelude::*;
use std::cmp::Ordering;

/// Two inverse depths agree within this relative difference …
const RELATIVE_TOLERANCE: f32 = 0.015;
/// … or within this many plane steps, whichever is more.
const STEP_TOLERANCE: f32 = 1.5;
/// Mean colour difference (0..1) above which a point that floats before another view's surface is dropped.
const FLOATING_DIFFERENCE: f32 = 0.1;
/// Mean colour difference above which any point is dropped.
const WRONG_DIFFERENCE: f32 = 0.2;

/// How far two inverse depths of one surface may be apart: 1.5 %, which is the default, or more where planes are farther apart.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tolerance {
    least: f32,
}

impl Tolerance {
    /// Of stereo whose planes are this far apart in inverse depth: one and a half steps, if that is more.
    #[must_use]
    pub fn of_step(step: f32) -> Self {
        Self { least: STEP_TOLERANCE * step }
    }

    /// At an inverse depth, in its unit.
    #[must_use]
    pub fn at(self, inverse_depth: f32) -> f32 {
        (RELATIVE_TOLERANCE * inverse_depth).max(self.least)
    }
}

/// What one view says of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Opinion {
    /// Not in its picture.
    Unseen,
    /// Behind its surface: hidden from it.
    Hidden,
    /// On its surface, at a pixel of it; the inverse depth that the other view gives the point, seen from this one.
    Agrees { pixel: usize, inverse_depth: f32 },
    /// Before its surface: the other view looks through it.
    Floats,
}

/// Relation of one view to another, with the other's inverse depths.
pub(crate) struct Witness<'a> {
    to: Pair,
    from: Pair,
    width: usize,
    height: usize,
    inverse_depth: &'a [f32],
    view: &'a View,
}

impl<'a> Witness<'a> {
    pub(crate) fn new(reference: &View, other: &'a View, inverse_depth: &'a [f32]) -> Self {
        Self {
            to: Pair::new(reference.camera(), other.camera()),
            from: Pair::new(other.camera(), reference.camera()),
            width: other.camera().width(),
            height: other.camera().height(),
            inverse_depth,
            view: other,
        }
    }

    /// The other view's pixel that sees the reference position (u, v) at inverse depth `w`, and the inverse depth of
    /// the point there.
    fn pixel(&self, u: f32, v: f32, w: f32) -> Option<(usize, usize, f32)> {
        let h = self.to.project(u, v, w);
        let (x, y) = (h.x / h.z, h.y / h.z);
        let inside = h.z > 0.0 && x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| (x as usize, y as usize, w / h.z))
    }

    /// The pixel of the other view that sees the point at (u, v) with inverse depth `w`, and by how much inverse depth its surface is
    /// nearer than the point; none if it does not see it.
    pub(crate) fn nearer(&self, u: f32, v: f32, w: f32) -> Option<(usize, f32)> {
        let (x, y, seen) = self.pixel(u, v, w)?;
        let pixel = y * self.width + x;
        Some((pixel, self.inverse_depth[pixel] - seen))
    }

    /// The pixel of the other view that sees the point at (u, v) with inverse depth `w`, and whether the point is nearer than the surface
    /// there (`Greater`), farther, or on it; none if it is not in the picture.
    pub(crate) fn order(&self, u: f32, v: f32, w: f32, tolerance: Tolerance) -> Option<(usize, Ordering)> {
        let (x, y, seen) = self.pixel(u, v, w)?;
        let pixel = y * self.width + x;
        Some((pixel, self.compare(pixel, seen, tolerance)))
    }

    /// Colour of a pixel of the other view.
    pub(crate) fn colour(&self, pixel: usize) -> &[f32] {
        &self.view.image().data()[3 * pixel..][..3]
    }

    /// What the other view says of the point at (u, v) with inverse depth `w`.
    pub(crate) fn opinion(&self, u: f32, v: f32, w: f32, tolerance: Tolerance) -> Opinion {
        let Some((x, y, seen)) = self.pixel(u, v, w) else {
            return Opinion::Unseen;
        };
        let pixel = y * self.width + x;
        match self.compare(pixel, seen, tolerance) {
            Ordering::Greater => Opinion::Floats,
            Ordering::Less => Opinion::Hidden,
            Ordering::Equal => {
                // The other surface at this pixel is locally parallel to the point's: shift the point, not the pixel.
                let inverse_depth = self.inverse_depth[pixel];
                let h = self.from.project(x as f32 + 0.5, y as f32 + 0.5, inverse_depth);
                let back = inverse_depth / h.z;
                Opinion::Agrees {
                    pixel,
                    inverse_depth: if back.is_finite() && back > 0.0 { back } else { w },
                }
            }
        }
    }

    /// Whether a point that a pixel of the other view sees at inverse depth `seen` is nearer than the surface there, farther, or on it.
    fn compare(&self, pixel: usize, seen: f32, tolerance: Tolerance) -> Ordering {
        let inverse_depth = self.inverse_depth[pixel];
        let tolerance = tolerance.at(seen);
        if seen > inverse_depth + tolerance {
            Ordering::Greater
        } else if seen < inverse_depth - tolerance {
            Ordering::Less
        } else {
            Ordering::Equal
        }
    }
}

/// Number of views that agree with each pixel, and the mean inverse depth of all that do, the pixel's own included.
pub(crate) fn agree(
    view: &View,
    inverse_depth: &[f32],
    witnesses: &[Witness],
    planes: &Planes,
) -> Vec<(u8, f32)> {
    let (width, tolerance) = (view.camera().width(), Tolerance::of_step(planes.step()));
    let judge = |(i, &w): (usize, &f32)| {
        let (u, v) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        let (mut count, mut sum) = (0_u8, w);
        for witness in witnesses {
            if let Opinion::Agrees { inverse_depth, .. } = witness.opinion(u, v, w, tolerance) {
                count = count.saturating_add(1);
                sum += inverse_depth;
            }
        }
        (count, sum / (1.0 + f32::from(count)))
    };
    inverse_depth.par_iter().enumerate().with_min_len(1 << 12).map(judge).collect()
}

/// Whether the photographs contradict a pixel's point: its colour is far from what the views see there that should
/// see it, and it floats before a surface of one of them, or the colours differ grossly.
pub(crate) fn contradicted(
    view: &View,
    inverse_depth: &[f32],
    witnesses: &[Witness],
    planes: &Planes,
) -> Vec<bool> {
    let (width, tolerance) = (view.camera().width(), Tolerance::of_step(planes.step()));
    let judge = |differences: &mut Vec<f32>, (i, &w): (usize, &f32)| {
        let (x, y) = (i % width, i / width);
        let (u, v) = (x as f32 + 0.5, y as f32 + 0.5);
        let colour = view.image().pixel(x, y);
        let mut floats = false;
        differences.clear();
        for witness in witnesses {
            let Some((pixel, order)) = witness.order(u, v, w, tolerance) else { continue };
            if order == Ordering::Less {
                continue;
            }
            floats |= order == Ordering::Greater;
            let other = witness.colour(pixel);
            let sum: f32 = colour.iter().zip(other).map(|(value, other)| (value - other).abs()).sum();
            differences.push(sum / 3.0);
        }
        if differences.is_empty() {
            return false;
        }
        let middle = differences.len() / 2;
        let median = *differences.select_nth_unstable_by(middle, f32::total_cmp).1;
        median > WRONG_DIFFERENCE || (floats && median > FLOATING_DIFFERENCE)
    };
    inverse_depth.par_iter().enumerate().with_min_len(1 << 12).map_init(Vec::new, judge).collect()
}

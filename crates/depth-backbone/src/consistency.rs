//! What the views say of each other's depth.

use crate::cost::LANES;
use crate::pair::Pair;
use crate::range::Planes;
use crate::texture::{TO_INTEGER, splat};
use cpu_kernels::pulp::{Simd, WithSimd, cast};
use cpu_kernels::{Isa, dispatch};
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
            Ordering::Equal => Opinion::Agrees { pixel, inverse_depth: self.back(pixel).unwrap_or(w) },
        }
    }

    /// The inverse depth that the surface at a pixel of the other view has in this one. That surface is locally parallel to the point's: shift the
    /// point, not the pixel.
    fn back(&self, pixel: usize) -> Option<f32> {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let inverse_depth = self.inverse_depth[pixel];
        let back = inverse_depth / self.from.project(x as f32 + 0.5, y as f32 + 0.5, inverse_depth).z;
        (back.is_finite() && back > 0.0).then_some(back)
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

/// Which pixels of the other views see the points of a row of pixels, and at which inverse depth.
struct Seen {
    /// Per witness and pixel; [`UNSEEN`] where the point is not in the picture.
    pixels: Vec<u32>,
    inverse_depths: Vec<f32>,
    width: usize,
    /// The row's own inverse depths, filled up to whole vectors, and the centres of its pixels.
    row: Vec<f32>,
    centres: Vec<f32>,
}

/// No pixel's number.
const UNSEEN: u32 = u32::MAX;

impl Seen {
    /// For rows of `width` pixels and as many witnesses.
    fn new(width: usize, witnesses: usize) -> Self {
        let stride = width.next_multiple_of(LANES);
        Self {
            pixels: vec![UNSEEN; witnesses * stride],
            inverse_depths: vec![0.0; witnesses * stride],
            width,
            row: vec![0.0; stride],
            centres: (0..stride).map(|x| x as f32 + 0.5).collect(),
        }
    }

    /// Looks from row `y` with these inverse depths.
    fn look(&mut self, isa: Isa, witnesses: &[Witness], y: usize, inverse_depths: &[f32]) {
        self.row[..self.width].copy_from_slice(inverse_depths);
        dispatch(isa, Look { seen: self, witnesses, v: y as f32 + 0.5 });
    }

    /// The pixel of witness number `witness` that sees the point of pixel `x`, and the inverse depth of the point there.
    fn at(&self, witness: usize, x: usize) -> Option<(usize, f32)> {
        let place = witness * self.row.len() + x;
        let pixel = self.pixels[place];
        (pixel != UNSEEN).then(|| (pixel as usize, self.inverse_depths[place]))
    }
}

struct Look<'a, 'w> {
    seen: &'a mut Seen,
    witnesses: &'a [Witness<'w>],
    v: f32,
}

impl WithSimd for Look<'_, '_> {
    type Output = ();

    /// The numbers of [`Witness::pixel`], bit for bit: products and sums are rounded one by one.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { seen, witnesses, v } = self;
        let stride = seen.row.len();
        let rows = seen.pixels.chunks_exact_mut(stride).zip(seen.inverse_depths.chunks_exact_mut(stride));
        for (witness, (pixels, inverse_depths)) in witnesses.iter().zip(rows) {
            let start = splat(simd, witness.to.row(v).as_vec3().to_array());
            let step = splat(simd, witness.to.step().as_vec3().to_array());
            let epipole = splat(simd, witness.to.epipole().as_vec3().to_array());
            let size = splat(simd, [witness.width as f32, witness.height as f32]);
            let [zero] = splat(simd, [0.0]);
            let row_length = simd.splat_u32s(witness.width as u32);
            let own = S::as_simd_f32s(&seen.row).0.iter().zip(S::as_simd_f32s(&seen.centres).0);
            let pixels = S::as_mut_simd_u32s(pixels).0.iter_mut();
            let found = pixels.zip(S::as_mut_simd_f32s(inverse_depths).0);
            for ((&w, &u), (pixel, inverse_depth)) in own.zip(found) {
                let mut h = start;
                for axis in 0..3 {
                    h[axis] = simd.add_f32s(h[axis], simd.mul_f32s(step[axis], u));
                    h[axis] = simd.add_f32s(h[axis], simd.mul_f32s(epipole[axis], w));
                }
                let (x, y) = (simd.div_f32s(h[0], h[2]), simd.div_f32s(h[1], h[2]));
                let in_width = within(simd, x, size[0]);
                let in_height = within(simd, y, size[1]);
                let before = simd.greater_than_f32s(h[2], zero);
                let inside = simd.and_m32s(before, simd.and_m32s(in_width, in_height));
                let index = simd.add_u32s(simd.mul_u32s(floor(simd, y), row_length), floor(simd, x));
                *pixel = simd.select_u32s(inside, index, simd.splat_u32s(UNSEEN));
                *inverse_depth = simd.div_f32s(w, h[2]);
            }
        }
    }
}

/// Whether a number is at least 0 and below `end`.
#[inline(always)]
fn within<S: Simd>(simd: S, x: S::f32s, end: S::f32s) -> S::m32s {
    let from = simd.greater_than_or_equal_f32s(x, simd.splat_f32s(0.0));
    simd.and_m32s(from, simd.less_than_f32s(x, end))
}

/// The whole part of a number from 0 to 2²²; of any other, some number.
#[inline(always)]
fn floor<S: Simd>(simd: S, x: S::f32s) -> S::u32s {
    let to_integer = simd.splat_f32s(TO_INTEGER);
    let nearest = simd.add_f32s(x, to_integer);
    let is_above = simd.greater_than_f32s(simd.sub_f32s(nearest, to_integer), x);
    let one = simd.select_u32s(is_above, simd.splat_u32s(1), simd.splat_u32s(0));
    simd.sub_u32s(simd.sub_u32s(cast(nearest), simd.splat_u32s(TO_INTEGER.to_bits())), one)
}

/// What `judge` makes of each pixel (x, y) of a view, with what the witnesses see of its row and room for numbers.
fn judged<T: Copy + Default + Send>(
    view: &View,
    inverse_depth: &[f32],
    witnesses: &[Witness],
    judge: impl Fn(&Seen, &mut Vec<f32>, usize, usize) -> T + Sync,
) -> Vec<T> {
    let (isa, width) = (Isa::in_use(), view.camera().width());
    let mut found = vec![T::default(); inverse_depth.len()];
    let rows = found.par_chunks_mut(width).zip(inverse_depth.par_chunks(width)).enumerate().with_min_len(8);
    rows.for_each_init(
        || (Seen::new(width, witnesses.len()), Vec::new()),
        |(seen, numbers), (y, (found, inverse_depth))| {
            seen.look(isa, witnesses, y, inverse_depth);
            found.iter_mut().enumerate().for_each(|(x, found)| *found = judge(seen, numbers, x, y));
        },
    );
    found
}

/// Number of views that agree with each pixel, and the mean inverse depth of all that do, the pixel's own included.
pub(crate) fn agree(
    view: &View,
    inverse_depth: &[f32],
    witnesses: &[Witness],
    planes: &Planes,
) -> Vec<(u8, f32)> {
    let (width, tolerance) = (view.camera().width(), Tolerance::of_step(planes.step()));
    judged(view, inverse_depth, witnesses, |seen, _, x, y| {
        let w = inverse_depth[y * width + x];
        let (mut count, mut sum) = (0_u8, w);
        for (number, witness) in witnesses.iter().enumerate() {
            let Some((pixel, seen)) = seen.at(number, x) else { continue };
            if witness.compare(pixel, seen, tolerance) == Ordering::Equal {
                count = count.saturating_add(1);
                sum += witness.back(pixel).unwrap_or(w);
            }
        }
        (count, sum / (1.0 + f32::from(count)))
    })
}

/// Whether the photographs contradict a pixel's point: its colour is far from what the views see there that should
/// see it, and it floats before a surface of one of them, or the colours differ grossly.
pub(crate) fn contradicted(
    view: &View,
    inverse_depth: &[f32],
    witnesses: &[Witness],
    planes: &Planes,
) -> Vec<bool> {
    let tolerance = Tolerance::of_step(planes.step());
    judged(view, inverse_depth, witnesses, |seen, differences, x, y| {
        let colour = view.image().pixel(x, y);
        let mut floats = false;
        differences.clear();
        for (number, witness) in witnesses.iter().enumerate() {
            let Some((pixel, seen)) = seen.at(number, x) else { continue };
            let order = witness.compare(pixel, seen, tolerance);
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
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_scene::{Camera, Image, Intrinsics};

    #[test]
    fn a_row_sees_what_its_pixels_see_one_by_one() {
        let (width, height) = (37, 23);
        let lens = Intrinsics { fx: 30.0, fy: 31.0, cx: 18.0, cy: 11.0, width, height };
        let view = |from: DVec3, to: DVec3| {
            let image = Image::filled(width, height, [0.5; 3]).unwrap();
            let camera = Camera::looking_at(lens, from, to, DVec3::NEG_Y).unwrap();
            View::new("view", image, camera, None).unwrap()
        };
        let ahead = DVec3::new(0.0, 0.0, 4.0);
        let reference = view(DVec3::ZERO, ahead);
        // Beside it, behind it, seen by it from behind, and in the same place.
        let others =
            [DVec3::new(0.6, -0.2, 0.1), DVec3::new(0.1, 0.0, -1.0), DVec3::new(0.3, 0.1, 3.0), DVec3::ZERO]
                .map(|from| view(from, ahead + DVec3::new(0.2, 0.1, 0.0)));
        let surface = vec![0.25; width * height];
        let witnesses: Vec<Witness> =
            others.iter().map(|other| Witness::new(&reference, other, &surface)).collect();
        let special = [0.0, -0.5, 1e-30, 1e30, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        let row = |y: usize| -> Vec<f32> {
            (0..width)
                .map(|x| {
                    if (x + y).is_multiple_of(5) { special[(x / 5 + y) % 7] } else { 0.02 + 0.03 * x as f32 }
                })
                .collect()
        };
        let (mut in_picture, mut not) = (0, 0);
        for isa in Isa::available() {
            let mut seen = Seen::new(width, witnesses.len());
            for y in 0..height {
                let row = row(y);
                seen.look(isa, &witnesses, y, &row);
                for (number, witness) in witnesses.iter().enumerate() {
                    for (x, &w) in row.iter().enumerate() {
                        let expected = witness.pixel(x as f32 + 0.5, y as f32 + 0.5, w);
                        let expected =
                            expected.map(|(x, y, inverse_depth)| (y * width + x, inverse_depth.to_bits()));
                        let found = seen.at(number, x).map(|(pixel, w)| (pixel, w.to_bits()));
                        assert_eq!(found, expected, "{isa}, witness {number}, ({x}, {y}) at {w}");
                        *(if found.is_some() { &mut in_picture } else { &mut not }) += 1;
                    }
                }
            }
        }
        assert!(in_picture > 500 && not > 500, "{in_picture} {not}");
    }
}

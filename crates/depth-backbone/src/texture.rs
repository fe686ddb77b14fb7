//! The luma of a view, made for bilinear look-ups: one 32-bit load brings the four pixels.

use crate::pair::Pair;
use cpu_kernels::pulp::{Simd, cast};
use cpu_kernels::vector::{abs, keep};
use glam::DVec3;
use gs_scene::Image;
use std::ops::Range;

/// 8-bit luma whose every entry packs the 2×2 block (x, y), (x+1, y), (x, y+1), (x+1, y+1), clamped at the border.
#[derive(Debug)]
pub(crate) struct Texture {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Luma minus [`MID_GREY`], so that sums of squares lose little to rounding.
    pub(crate) values: Vec<f32>,
    packed: Vec<u32>,
}

/// Subtracted from 8-bit values.
pub(crate) const MID_GREY: f32 = 127.5;

impl Texture {
    pub(crate) fn new(image: &Image) -> Self {
        let (width, height) = (image.width(), image.height());
        let luma = image.luma8();
        let packed = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let (right, below) = (usize::from(x + 1 < width), if y + 1 < height { width } else { 0 });
                u32::from_le_bytes([luma[i], luma[i + right], luma[i + below], luma[i + right + below]])
            })
            .collect();
        let values = luma.iter().map(|&v| f32::from(v) - MID_GREY).collect();
        Self { width, height, values, packed }
    }
}

/// Where the pixels of a reference row fall in a source, and what lies there: one row at a time, in vectors.
#[derive(Debug)]
pub(crate) struct Sampler {
    /// Half the width of the reference, pixels.
    middle: f64,
    /// Centres of the pixels of a row, from there.
    centres: Vec<f32>,
    index: Vec<u32>,
    texels: Vec<u32>,
    fraction_x: Vec<f32>,
    fraction_y: Vec<f32>,
}

/// Inverse depths of the pixels of a row.
#[derive(Clone, Copy)]
pub(crate) enum Depths<'a> {
    /// One for all.
    Plane(f64),
    /// One for each.
    Surface(&'a [f32]),
}

/// 2²³ + 2²²: added to a number of at least -½ and below 2²² it leaves the nearest integer in the low mantissa bits; -½ becomes 0.
pub(crate) const TO_INTEGER: f32 = 12_582_912.0;
/// 2¹⁵ with 8 bits behind the point: a byte in the second lowest place of its mantissa is added to it.
const WITH_BYTE: f32 = 32_768.0;
/// Texels that are looked up together, which takes fewer instructions for each than one at a time.
pub(crate) const TOGETHER: usize = 8;

impl Sampler {
    /// For a reference that is so wide; its rows are filled up to `stride` pixels, a multiple of the lanes of a vector.
    pub(crate) fn new(width: usize, stride: usize) -> Self {
        let middle = 0.5 * width as f64;
        Self {
            middle,
            centres: (0..stride).map(|x| (x as f64 + 0.5 - middle) as f32).collect(),
            index: vec![0; stride],
            texels: vec![0; stride],
            fraction_x: vec![0.0; stride],
            fraction_y: vec![0.0; stride],
        }
    }

    /// Finds where the pixels of reference row `y` that are in `columns` fall. `inside` becomes 1 where that is in the picture and before the camera,
    /// else 0 (the sample is then the nearest border pixel's).
    #[inline(always)]
    pub(crate) fn locate<S: Simd>(
        &mut self,
        simd: S,
        (pair, texture): (&Pair, &Texture),
        (y, columns): (usize, Range<usize>),
        depths: Depths,
        inside: &mut [f32],
    ) {
        // Both pictures are measured from their middles: numbers are small there, and f32 rounds them little.
        let [right, down] = [texture.width, texture.height].map(|size| 0.5 * size as f64);
        let middle = DVec3::new(right, down, 0.0);
        let from_middle = |h: DVec3| splat(simd, (h - middle * h.z).as_vec3().to_array());
        let (step, v) = (pair.step(), y as f32 + 0.5);
        let to_middle = step * self.middle;
        let step = from_middle(step);
        match depths {
            Depths::Plane(w) => {
                let start = from_middle(pair.row_of_plane(v, w) + to_middle);
                self.place(
                    simd,
                    texture,
                    columns,
                    inside,
                    #[inline(always)]
                    |_, x| multiply_add(simd, step, x, start),
                );
            }
            Depths::Surface(depths) => {
                let start = from_middle(pair.row(v) + to_middle);
                let epipole = from_middle(pair.epipole());
                let depths = S::as_simd_f32s(&depths[columns.clone()]).0;
                self.place(
                    simd,
                    texture,
                    columns,
                    inside,
                    #[inline(always)]
                    |i, x| multiply_add(simd, epipole, depths[i], multiply_add(simd, step, x, start)),
                );
            }
        }
    }

    /// [`Self::locate`] with `place`: the homogeneous place of vector number `i` of pixels. It and they are measured from the middles of the pictures.
    #[inline(always)]
    fn place<S: Simd>(
        &mut self,
        simd: S,
        texture: &Texture,
        columns: Range<usize>,
        inside: &mut [f32],
        place: impl Fn(usize, S::f32s) -> [S::f32s; 3],
    ) {
        let n = columns.len() / S::F32_LANES;
        let centres = &S::as_simd_f32s(&self.centres[columns.clone()]).0[..n];
        let inside = &mut S::as_mut_simd_f32s(&mut inside[columns.clone()]).0[..n];
        let index = &mut S::as_mut_simd_u32s(&mut self.index[columns.clone()]).0[..n];
        let fraction_x = &mut S::as_mut_simd_f32s(&mut self.fraction_x[columns.clone()]).0[..n];
        let fraction_y = &mut S::as_mut_simd_f32s(&mut self.fraction_y[columns]).0[..n];
        let axes = [texture.width, texture.height].map(|size| Axis::new(simd, size));
        let [zero, one] = splat(simd, [0.0, 1.0]);
        let row_length = simd.splat_u32s(texture.width as u32);
        // Both numbers below carry the bits of TO_INTEGER.
        let bits = TO_INTEGER.to_bits();
        let excess = simd.splat_u32s(bits.wrapping_mul(texture.width as u32).wrapping_add(bits));
        for i in 0..n {
            let [u, v, z] = place(i, centres[i]);
            let inverse = simd.div_f32s(one, z);
            let u = simd.mul_add_e_f32s(u, inverse, axes[0].middle);
            let v = simd.mul_add_e_f32s(v, inverse, axes[1].middle);
            let before = keep(simd, simd.greater_than_f32s(z, zero), one);
            let before = keep(simd, axes[0].holds(simd, u), before);
            inside[i] = keep(simd, axes[1].holds(simd, v), before);
            let (column, right) = axes[0].texel(simd, u);
            let (row, down) = axes[1].texel(simd, v);
            fraction_x[i] = right;
            fraction_y[i] = down;
            index[i] = simd.sub_u32s(simd.add_u32s(simd.mul_u32s(row, row_length), column), excess);
        }
    }

    /// Calls `visit` with the number of each vector of pixels in `columns`, and with what the texture has at the places that were found,
    /// between its pixels by bilinear interpolation.
    #[inline(always)]
    pub(crate) fn sample<S: Simd>(
        &mut self,
        simd: S,
        texture: &Texture,
        columns: Range<usize>,
        mut visit: impl FnMut(usize, S::f32s),
    ) {
        let indices = self.index[columns.clone()].as_chunks::<TOGETHER>().0;
        for (texels, indices) in
            self.texels[columns.clone()].as_chunks_mut::<TOGETHER>().0.iter_mut().zip(indices)
        {
            for (texel, &index) in texels.iter_mut().zip(indices) {
                *texel = texture.packed[index as usize];
            }
        }
        let n = columns.len() / S::F32_LANES;
        let texels = &S::as_simd_u32s(&self.texels[columns.clone()]).0[..n];
        let fraction_x = &S::as_simd_f32s(&self.fraction_x[columns.clone()]).0[..n];
        let fraction_y = &S::as_simd_f32s(&self.fraction_y[columns]).0[..n];
        let (byte, carrier) = (simd.splat_u32s(0xff00), simd.splat_u32s(WITH_BYTE.to_bits()));
        let (eight, sixteen) = (simd.splat_u32s(8), simd.splat_u32s(16));
        let [grey] = splat(simd, [WITH_BYTE + MID_GREY]);
        for i in 0..n {
            let t = texels[i];
            let mut block = [
                simd.wrapping_dyn_shl_u32s(t, eight),
                t,
                simd.wrapping_dyn_shr_u32s(t, eight),
                simd.wrapping_dyn_shr_u32s(t, sixteen),
            ];
            for bits in &mut block {
                *bits = simd.or_u32s(simd.and_u32s(*bits, byte), carrier);
            }
            let [a, b, c, d] = block;
            let (a, b) = (cast(a), cast(b));
            let (c, d) = (cast(c), cast(d));
            let upper = simd.mul_add_e_f32s(simd.sub_f32s(b, a), fraction_x[i], simd.sub_f32s(a, grey));
            let lower = simd.mul_add_e_f32s(simd.sub_f32s(d, c), fraction_x[i], simd.sub_f32s(c, grey));
            visit(i, simd.mul_add_e_f32s(simd.sub_f32s(lower, upper), fraction_y[i], upper));
        }
    }
}

/// a b + c of homogeneous places.
#[inline(always)]
fn multiply_add<S: Simd>(simd: S, a: [S::f32s; 3], b: S::f32s, c: [S::f32s; 3]) -> [S::f32s; 3] {
    let [[u, v, z], [c_u, c_v, c_z]] = [a, c];
    [simd.mul_add_e_f32s(u, b, c_u), simd.mul_add_e_f32s(v, b, c_v), simd.mul_add_e_f32s(z, b, c_z)]
}

#[inline(always)]
pub(crate) fn splat<S: Simd, const N: usize>(simd: S, values: [f32; N]) -> [S::f32s; N] {
    let mut out = [simd.splat_f32s(0.0); N];
    for (out, value) in out.iter_mut().zip(values) {
        *out = simd.splat_f32s(value);
    }
    out
}

/// Columns or rows of a picture. Places on it are measured from the centre of the first pixel.
struct Axis<S: Simd> {
    /// The middle of the picture, the centre of the last pixel, and half the size.
    middle: S::f32s,
    last: S::f32s,
    half: S::f32s,
}

impl<S: Simd> Axis<S> {
    #[inline(always)]
    fn new(simd: S, size: usize) -> Self {
        let last = (size - 1) as f32;
        let [middle, last, half] = splat(simd, [0.5 * last, last, 0.5 * size as f32]);
        Self { middle, last, half }
    }

    /// Whether a place is in the picture. What is not a number is not.
    #[inline(always)]
    fn holds(&self, simd: S, u: S::f32s) -> S::m32s {
        simd.less_than_or_equal_f32s(abs(simd, simd.sub_f32s(u, self.middle)), self.half)
    }

    /// The pixel to the left of (above) a place, or one more where that makes no difference, with the bits of [`TO_INTEGER`] around it; and how far
    /// the place is behind its centre. What is not a number becomes 0.
    #[inline(always)]
    fn texel(&self, simd: S, u: S::f32s) -> (S::u32s, S::f32s) {
        let [zero, half, to_integer] = splat(simd, [0.0, 0.5, TO_INTEGER]);
        let place = keep(simd, simd.greater_than_f32s(u, zero), simd.min_f32s(u, self.last));
        let rounded = simd.add_f32s(simd.sub_f32s(place, half), to_integer);
        (cast(rounded), simd.sub_f32s(place, simd.sub_f32s(rounded, to_integer)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cpu_kernels::pulp::WithSimd;
    use cpu_kernels::{Isa, dispatch};
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Intrinsics};

    /// The samples of one reference row at these inverse depths, and where they are inside, under an instruction set.
    fn row(isa: Isa, texture: &Texture, pair: &Pair, y: usize, w: &[f32]) -> (Vec<f32>, Vec<f32>) {
        struct Row<'a>(&'a Texture, &'a Pair, usize, &'a [f32], [Vec<f32>; 2]);
        impl WithSimd for Row<'_> {
            type Output = [Vec<f32>; 2];

            fn with_simd<S: Simd>(self, simd: S) -> [Vec<f32>; 2] {
                let Self(texture, pair, y, w, [mut out, mut inside]) = self;
                let mut sampler = Sampler::new(w.len(), w.len());
                let (columns, depths) = (0..w.len(), Depths::Surface(w));
                sampler.locate(simd, (pair, texture), (y, columns.clone()), depths, &mut inside);
                let (vectors, _) = S::as_mut_simd_f32s(&mut out);
                sampler.sample(simd, texture, columns, |i, value| vectors[i] = value);
                [out, inside]
            }
        }
        let mut padded = w.to_vec();
        padded.resize(w.len().next_multiple_of(16), 1.0);
        let buffers = [vec![0.0; padded.len()], vec![7.0; padded.len()]];
        let [mut out, mut inside] = dispatch(isa, Row(texture, pair, y, &padded, buffers));
        out.truncate(w.len());
        inside.truncate(w.len());
        (out, inside)
    }

    #[test]
    fn a_shifted_camera_sees_the_shifted_picture() {
        let (width, height) = (40, 20);
        let lens = Intrinsics { fx: 10.0, fy: 10.0, cx: 20.0, cy: 10.0, width, height };
        let bytes: Vec<u8> = (0..width * height).flat_map(|i| [((i * 7919) % 251) as u8; 3]).collect();
        let texture = Texture::new(&Image::from_rgb8(width, height, &bytes).unwrap());
        let reference = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let source = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-0.5, 0.0, 0.0)).unwrap();
        let pair = Pair::new(&reference, &source);
        for isa in Isa::available() {
            // Disparity = f t w = 10 · 0.5 · w: 2 pixels at w = 0.4, 2.25 at w = 0.45.
            for (w, part) in [(0.4, 0.0), (0.45, 0.25)] {
                let (out, inside) = row(isa, &texture, &pair, 3, &vec![w; width]);
                for x in 0..width {
                    assert_eq!(inside[x] == 1.0, x >= 2, "column {x}");
                    let value = |x: usize| texture.values[3 * width + x];
                    let expected =
                        (1.0 - part) * value(x.saturating_sub(2)) + part * value(x.saturating_sub(3));
                    assert!((out[x] - expected).abs() < 0.05, "{isa}, column {x}: {} {expected}", out[x]);
                }
            }
        }
    }

    #[test]
    fn a_single_pixel_and_points_behind_the_camera_are_defined() {
        let lens = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5, width: 1, height: 1 };
        let texture = Texture::new(&Image::filled(1, 1, [1.0; 3]).unwrap());
        let front = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let back = Camera::new(lens, DMat3::from_rotation_y(std::f64::consts::PI), DVec3::ZERO).unwrap();
        let pair = Pair::new(&front, &back);
        for isa in Isa::available() {
            for w in [0.5, f32::NAN, f32::INFINITY] {
                assert_eq!(row(isa, &texture, &pair, 0, &[w]), (vec![127.5], vec![0.0]), "{isa} {w}");
            }
        }
    }
}

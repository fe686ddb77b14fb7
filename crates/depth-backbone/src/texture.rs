//! The luma of a view, made for bilinear look-ups: one 32-bit load brings the four pixels.

use crate::pair::Pair;
use gs_scene::Image;
use multiversion::multiversion;

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

/// Scratch of one warped row.
#[derive(Debug, Default, Clone)]
pub(crate) struct RowScratch {
    index: Vec<u32>,
    texels: Vec<u32>,
    fraction_x: Vec<f32>,
    fraction_y: Vec<f32>,
}

impl RowScratch {
    pub(crate) fn new(width: usize) -> Self {
        Self {
            index: vec![0; width],
            texels: vec![0; width],
            fraction_x: vec![0.0; width],
            fraction_y: vec![0.0; width],
        }
    }
}

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

    /// Samples this texture at where the pixels of reference row `y` fall at the inverse depths `w` (one per pixel).
    /// `inside` becomes 1 where the sample lies in the picture and before the camera, else 0 (the sample is then
    /// the nearest border pixel's).
    pub(crate) fn warp_row(
        &self,
        pair: &Pair,
        y: usize,
        w: &[f32],
        out: &mut [f32],
        inside: &mut [f32],
        scratch: &mut RowScratch,
    ) {
        let n = w.len();
        let size = [self.width as f32, self.height as f32];
        // u = x + 0.5: the centre of the first pixel.
        let start = pair.row(y as f32 + 0.5) + pair.step() * 0.5;
        locate(
            [start.to_array(), pair.step().to_array(), pair.epipole().to_array()],
            size,
            w,
            &mut scratch.index[..n],
            &mut scratch.fraction_x[..n],
            &mut scratch.fraction_y[..n],
            inside,
        );
        for (texel, &index) in scratch.texels[..n].iter_mut().zip(&scratch.index[..n]) {
            *texel = self.packed[index as usize];
        }
        blend(&scratch.texels[..n], &scratch.fraction_x[..n], &scratch.fraction_y[..n], out);
    }
}

/// 2²³: adding it to a whole number in 0..2²³ puts the number into the low mantissa bits. This vectorises, where a
/// saturating cast does not.
const TO_INTEGER: f32 = 8_388_608.0;

#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
fn locate(
    [start, step, epipole]: [[f32; 3]; 3],
    [width, height]: [f32; 2],
    w: &[f32],
    index: &mut [u32],
    fraction_x: &mut [f32],
    fraction_y: &mut [f32],
    inside: &mut [f32],
) {
    let n = w.len();
    let (index, fraction_x, fraction_y) = (&mut index[..n], &mut fraction_x[..n], &mut fraction_y[..n]);
    let inside = &mut inside[..n];
    let stride = (width + TO_INTEGER).to_bits() & 0x7f_ffff;
    for i in 0..n {
        let x = i as i32 as f32;
        let hx = start[0] + step[0] * x + epipole[0] * w[i];
        let hy = start[1] + step[1] * x + epipole[1] * w[i];
        let hz = start[2] + step[2] * x + epipole[2] * w[i];
        let inverse = 1.0 / hz;
        let (u, v) = (hx * inverse, hy * inverse);
        let within = (hz > 0.0) & (u >= 0.0) & (u <= width) & (v >= 0.0) & (v <= height);
        inside[i] = if within { 1.0 } else { 0.0 };
        // max before min: NaN becomes 0.
        let u = (u - 0.5).max(0.0).min(width - 1.0);
        let v = (v - 0.5).max(0.0).min(height - 1.0);
        let (floor_u, floor_v) = (u.floor(), v.floor());
        fraction_x[i] = u - floor_u;
        fraction_y[i] = v - floor_v;
        let column = (floor_u + TO_INTEGER).to_bits() & 0x7f_ffff;
        let row = (floor_v + TO_INTEGER).to_bits() & 0x7f_ffff;
        index[i] = row.wrapping_mul(stride).wrapping_add(column);
    }
}

#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
fn blend(texels: &[u32], fraction_x: &[f32], fraction_y: &[f32], out: &mut [f32]) {
    let n = texels.len();
    let (fraction_x, fraction_y, out) = (&fraction_x[..n], &fraction_y[..n], &mut out[..n]);
    let byte = |texel: u32, shift: u32| ((texel >> shift) & 0xff) as i32 as f32;
    for i in 0..n {
        let t = texels[i];
        let (a, b, c, d) = (byte(t, 0), byte(t, 8), byte(t, 16), byte(t, 24));
        let upper = a + (b - a) * fraction_x[i];
        let lower = c + (d - c) * fraction_x[i];
        out[i] = upper + (lower - upper) * fraction_y[i] - MID_GREY;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Intrinsics};

    #[test]
    fn a_shifted_camera_sees_the_shifted_picture() {
        let (width, height) = (40, 20);
        let lens = Intrinsics { fx: 10.0, fy: 10.0, cx: 20.0, cy: 10.0, width, height };
        let bytes: Vec<u8> = (0..width * height).flat_map(|i| [((i * 7919) % 251) as u8; 3]).collect();
        let texture = Texture::new(&Image::from_rgb8(width, height, &bytes).unwrap());
        let reference = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let source = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-0.5, 0.0, 0.0)).unwrap();
        let pair = Pair::new(&reference, &source);
        let (mut out, mut inside) = (vec![0.0; width], vec![0.0; width]);
        let mut scratch = RowScratch::new(width);
        // Disparity = f t w = 10 · 0.5 · w: 2 pixels at w = 0.4.
        texture.warp_row(&pair, 3, &vec![0.4; width], &mut out, &mut inside, &mut scratch);
        for x in 0..width {
            let expected = x >= 2;
            assert_eq!(inside[x] == 1.0, expected, "column {x}");
            let value = texture.values[3 * width + x.saturating_sub(2)];
            assert!((out[x] - value).abs() < 0.05, "column {x}: {} {value}", out[x]);
        }
    }

    #[test]
    fn a_single_pixel_and_points_behind_the_camera_are_defined() {
        let lens = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5, width: 1, height: 1 };
        let texture = Texture::new(&Image::filled(1, 1, [1.0; 3]).unwrap());
        let front = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let back = Camera::new(lens, DMat3::from_rotation_y(std::f64::consts::PI), DVec3::ZERO).unwrap();
        let (mut out, mut inside) = ([0.0], [7.0]);
        for w in [0.5, f32::NAN, f32::INFINITY] {
            texture.warp_row(
                &Pair::new(&front, &back),
                0,
                &[w],
                &mut out,
                &mut inside,
                &mut RowScratch::new(1),
            );
            assert_eq!((out[0], inside[0]), (127.5, 0.0));
        }
    }
}

//! Features by bilinear look-up.
//!
//! The map covers the picture: its pixel i lies at (i + ½) · picture size / map size in the picture. A pixel centre at c
//! (c = column + ½) therefore looks up c · map size / picture size - ½, clamped to the centres of the border.

use crate::lift::{CHUNK, Place};
use cpu_kernels::{Isa, compiled_for};
use gs_scene::FeatureMap;

/// A feature map, and where the columns and rows of a picture look it up.
pub(crate) struct LookUp<'a> {
    map: &'a FeatureMap,
    columns: Vec<Along>,
    rows: Vec<Along>,
}

/// Two neighbours in a plane along an axis, in elements of the plane.
#[derive(Clone, Copy)]
struct Along {
    first: u32,
    /// Step to the second; 0 where that has no weight or does not exist.
    step: u32,
    /// Weight of the second.
    weight: f32,
}

/// The four neighbours of a place in a plane.
#[derive(Clone, Copy, Default)]
struct Taps {
    upper_left: u32,
    right: u32,
    down: u32,
    wx: f32,
    wy: f32,
}

/// Where `pixels` of the picture fall among `size` of the map, `stride` elements apart.
fn along(pixels: usize, size: usize, stride: usize) -> Vec<Along> {
    let (scale, last) = (size as f64 / pixels as f64, (size - 1) as f64);
    let sample = |pixel: usize| {
        let position = ((pixel as f64 + 0.5) * scale - 0.5).clamp(0.0, last);
        let first = position as usize;
        let weight = (position - first as f64) as f32;
        let step = if weight > 0.0 && first + 1 < size { stride } else { 0 };
        Along { first: (first * stride) as u32, step: step as u32, weight }
    };
    (0..pixels).map(sample).collect()
}

/// Channels taken together: as many streams of memory, and one vector.
const TOGETHER: usize = 4;

impl<'a> LookUp<'a> {
    /// For a picture of `width`×`height`.
    pub(crate) fn new(map: &'a FeatureMap, width: usize, height: usize) -> Self {
        Self { map, columns: along(width, map.width(), 1), rows: along(height, map.height(), map.width()) }
    }

    /// Features of at most [`CHUNK`] places, `[n, channels]`.
    pub(crate) fn features(&self, isa: Isa, places: &[Place], out: &mut [f32]) {
        let channels = self.map.channels();
        let mut taps = [Taps::default(); CHUNK];
        let taps = &mut taps[..places.len()];
        for (taps, place) in taps.iter_mut().zip(places) {
            let (column, row) = (self.columns[place.x as usize], self.rows[place.y as usize]);
            *taps = Taps {
                upper_left: row.first + column.first,
                right: column.step,
                down: row.step,
                wx: column.weight,
                wy: row.weight,
            };
        }
        let rest = channels - channels % TOGETHER;
        for channel in (0..rest).step_by(TOGETHER) {
            compiled_for!(isa, blend::<TOGETHER>(self.map, channel, taps, out));
        }
        for channel in rest..channels {
            blend::<1>(self.map, channel, taps, out);
        }
    }
}

/// Channels `channel..channel + N` of all places.
#[inline(always)]
fn blend<const N: usize>(map: &FeatureMap, channel: usize, taps: &[Taps], out: &mut [f32]) {
    let planes: [&[f32]; N] = std::array::from_fn(|i| map.channel(channel + i));
    for (taps, out) in taps.iter().zip(out.chunks_exact_mut(map.channels())) {
        let (first, right, down) = (taps.upper_left as usize, taps.right as usize, taps.down as usize);
        let mut corners = [[0f32; N]; 4];
        for (i, plane) in planes.iter().enumerate() {
            // One check of the bounds for the four.
            let around = &plane[first..first + down + right + 1];
            corners[0][i] = around[0];
            corners[1][i] = around[right];
            corners[2][i] = around[down];
            corners[3][i] = around[down + right];
        }
        let [upper_left, upper_right, lower_left, lower_right] = corners;
        let out = &mut out[channel..channel + N];
        for i in 0..N {
            let upper = upper_left[i] + taps.wx * (upper_right[i] - upper_left[i]);
            let lower = lower_left[i] + taps.wx * (lower_right[i] - lower_left[i]);
            out[i] = upper + taps.wy * (lower - upper);
        }
    }
}

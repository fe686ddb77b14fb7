//! Scenes as bytes of a page: blocks of rows, which a header describes to the page.

use crate::{Error, Result};
use gs_scene::{Gaussians, MEAN, sh_coefficients};
use half::f16;
use serde::Serialize;

/// How many bits of a scene a page keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// Positions in 32 bits; quaternions, log-scales, opacity logits and the colour of degree 0 in 16; SH coefficients of higher
    /// degree in 8, scaled by the largest of each Gaussian.
    #[default]
    Compact,
    /// Every stored bit.
    Full,
}

/// How a block stores its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    F32,
    F16,
    /// Before each row its step as f16, then whole steps from -127 to 127.
    ScaledI8,
}

/// Rows of some columns, little endian.
#[derive(Debug, Clone, Copy, Serialize)]
struct Block {
    into: &'static str,
    from: usize,
    columns: usize,
    #[serde(rename = "type")]
    kind: Kind,
}

/// What a page is told of its scene.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Header {
    n: usize,
    degree: usize,
    geometry_columns: usize,
    /// First column of the log-scales.
    log_scale: usize,
    blocks: Vec<Block>,
}

/// Largest step count of a [`Kind::ScaledI8`] number.
const STEPS: f32 = 127.0;

impl Header {
    pub(crate) fn new(gaussians: &Gaussians, precision: Precision) -> Self {
        let sh = 3 * sh_coefficients(gaussians.sh_degree());
        let block = |into, from, to, kind| Block { into, from, columns: to - from, kind };
        let blocks = match precision {
            Precision::Full => {
                vec![block("geometry", 0, Gaussians::GEOMETRY, Kind::F32), block("sh", 0, sh, Kind::F32)]
            }
            Precision::Compact => vec![
                block("geometry", MEAN.start, MEAN.end, Kind::F32),
                block("geometry", MEAN.end, Gaussians::GEOMETRY, Kind::F16),
                block("sh", 0, 3, Kind::F16),
                block("sh", 3, sh, Kind::ScaledI8),
            ],
        };
        Self {
            n: gaussians.len(),
            degree: gaussians.sh_degree(),
            geometry_columns: Gaussians::GEOMETRY,
            log_scale: gs_scene::LOG_SCALE.start,
            blocks: blocks.into_iter().filter(|block| block.columns > 0).collect(),
        }
    }

    fn row(&self, into: &str) -> usize {
        if into == "geometry" { self.geometry_columns } else { 3 * sh_coefficients(self.degree) }
    }

    fn bytes(&self) -> usize {
        let bytes = |block: &Block| match block.kind {
            Kind::F32 => 4 * block.columns,
            Kind::F16 => 2 * block.columns,
            Kind::ScaledI8 => 2 + block.columns,
        };
        self.n * self.blocks.iter().map(bytes).sum::<usize>()
    }
}

/// The bytes of a scene in a page.
#[must_use]
pub fn packed(gaussians: &Gaussians, precision: Precision) -> Vec<u8> {
    let header = Header::new(gaussians, precision);
    let mut out = Vec::with_capacity(header.bytes());
    for block in &header.blocks {
        let rows = if block.into == "geometry" { gaussians.geometry() } else { gaussians.sh() };
        for row in rows.chunks_exact(header.row(block.into)) {
            let row = &row[block.from..block.from + block.columns];
            match block.kind {
                Kind::F32 => row.iter().for_each(|value| out.extend(value.to_le_bytes())),
                Kind::F16 => row.iter().for_each(|&value| out.extend(half(value).to_le_bytes())),
                Kind::ScaledI8 => {
                    let largest = row.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
                    // A row with a number that is not finite has a step that is none: its Gaussian is not drawn, as before.
                    let finite = row.iter().all(|value| value.is_finite());
                    let step = if finite { half(largest / STEPS) } else { f16::NAN };
                    out.extend(step.to_le_bytes());
                    let step = step.to_f32();
                    out.extend(row.iter().map(|value| {
                        let steps =
                            if step > 0.0 { (value / step).round().clamp(-STEPS, STEPS) } else { 0.0 };
                        (steps as i8).cast_unsigned()
                    }));
                }
            }
        }
    }
    out
}

/// The scene that a page makes of such bytes; the same arithmetic in `page/scene.js`.
///
/// # Errors
/// If there are more bytes or fewer than a scene of the same size and precision has.
pub fn unpacked(like: &Gaussians, precision: Precision, bytes: &[u8]) -> Result<Gaussians> {
    let header = Header::new(like, precision);
    if bytes.len() != header.bytes() {
        return Err(Error::Packed { expected: header.bytes(), found: bytes.len() });
    }
    let mut geometry = vec![0.0; header.n * header.row("geometry")];
    let mut sh = vec![0.0; header.n * header.row("sh")];
    let mut rest = bytes;
    for block in &header.blocks {
        let width = header.row(block.into);
        let rows = if block.into == "geometry" { &mut geometry } else { &mut sh };
        for row in rows.chunks_exact_mut(width) {
            let step =
                if block.kind == Kind::ScaledI8 { f16::from_le_bytes(take(&mut rest)).to_f32() } else { 1.0 };
            for value in &mut row[block.from..block.from + block.columns] {
                *value = match block.kind {
                    Kind::F32 => f32::from_le_bytes(take(&mut rest)),
                    Kind::F16 => f16::from_le_bytes(take(&mut rest)).to_f32(),
                    Kind::ScaledI8 => f32::from(i8::from_le_bytes(take(&mut rest))) * step,
                };
            }
        }
    }
    Ok(Gaussians::new(header.degree, geometry, sh)?)
}

fn take<const N: usize>(rest: &mut &[u8]) -> [u8; N] {
    let (head, tail) = rest.split_first_chunk().expect("the length was checked");
    *rest = tail;
    *head
}

/// The nearest number of 16 bits; finite numbers stay finite.
fn half(value: f32) -> f16 {
    let near = f16::from_f32(value);
    if near.is_infinite() && value.is_finite() { f16::MAX.copysign(f16::from_f32(value)) } else { near }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(degree: usize, n: usize) -> Gaussians {
        let number = |i: usize| ((i * 7919 % 1000) as f32 / 500.0 - 1.0) * 3.0;
        let geometry = (0..n * Gaussians::GEOMETRY).map(number).collect();
        Gaussians::new(degree, geometry, (0..n * 3 * sh_coefficients(degree)).map(number).collect()).unwrap()
    }

    #[test]
    fn full_keeps_every_bit() {
        for degree in 0..4 {
            let mut scene = scene(degree, 9);
            scene.buffers_mut().0[5] = f32::NAN;
            scene.buffers_mut().1[1] = f32::INFINITY;
            let back = unpacked(&scene, Precision::Full, &packed(&scene, Precision::Full)).unwrap();
            let bits =
                |g: &Gaussians| g.geometry().iter().chain(g.sh()).map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&back), bits(&scene));
        }
    }

    #[test]
    fn compact_keeps_positions_and_stays_near_in_the_rest() {
        for degree in 0..4 {
            let scene = scene(degree, 50);
            let bytes = packed(&scene, Precision::Compact);
            let rest = 3 * (sh_coefficients(degree) - 1);
            assert_eq!(bytes.len(), 50 * (12 + 16 + 6 + if rest > 0 { 2 + rest } else { 0 }));
            let back = unpacked(&scene, Precision::Compact, &bytes).unwrap();
            for (a, b) in scene.geometry().chunks_exact(11).zip(back.geometry().chunks_exact(11)) {
                assert_eq!(a[..3], b[..3]);
                assert!(a[3..].iter().zip(&b[3..]).all(|(a, b)| (a - b).abs() <= a.abs() / 1024.0));
            }
            // Half a step of 3 / 127, and what f16 adds to the step.
            assert!(scene.sh().iter().zip(back.sh()).all(|(a, b)| (a - b).abs() < 0.6 * 3.0 / 127.0));
            assert!(unpacked(&scene, Precision::Compact, &bytes[1..]).is_err());
        }
    }

    #[test]
    fn what_cannot_be_drawn_cannot_be_drawn_afterwards_and_large_numbers_stay_finite() {
        let mut scene = scene(1, 3);
        scene.buffers_mut().0[10] = 1e30;
        scene.buffers_mut().0[11 + 10] = f32::NAN;
        scene.buffers_mut().1[2 * 12 + 7] = f32::INFINITY;
        let back = unpacked(&scene, Precision::Compact, &packed(&scene, Precision::Compact)).unwrap();
        assert_eq!(back.geometry()[10], 65504.0);
        assert!(back.geometry()[21].is_nan());
        assert!(back.sh()[2 * 12 + 3..].iter().all(|value| value.is_nan()));
        let empty = Gaussians::empty(2).unwrap();
        assert!(packed(&empty, Precision::Compact).is_empty());
    }
}

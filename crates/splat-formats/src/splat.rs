//! `.splat` of antimatter15: 32 bytes a Gaussian, without a header.
//!
//! Position 3 f32, size 3 f32 (standard deviations, scene units), colour and opacity 4 bytes, quaternion (w, x, y, z) 4 bytes:
//! 128 q + 128. PLY's axes. No spherical harmonics.

use crate::file::Decoded;
use crate::loss::Clipping;
use crate::numbers::{byte, colour, dc, gaussians, log_size, rows, step_logit};
use crate::{Loss, Quantity, Rule};
use gs_scene::Gaussians;
use std::io::{BufRead, Read, Write};

/// Bytes of a Gaussian.
const RECORD: usize = 32;

pub(crate) fn losses(gaussians: &Gaussians) -> Vec<Loss> {
    let mut clipping = Clipping::new(Quantity::Colour, [0.0, 1.0]);
    rows(gaussians).for_each(|row| clipping.count(row.sh[..3].iter().map(|&value| colour(value))));
    let rounded = |quantity, error, unit| Loss::Rounded { quantity, bits: 8, error, unit };
    let mut losses = vec![
        rounded(Quantity::Colour, 0.5 / 255.0, "of full brightness"),
        rounded(Quantity::Opacity, 0.5 / 255.0, "of opaque"),
        rounded(Quantity::Rotation, 0.5 / 128.0, "in a component of the quaternion"),
    ];
    losses.extend(clipping.loss(gaussians.len()));
    if gaussians.sh_degree() > 0 {
        losses.push(Loss::ShDropped { degree: gaussians.sh_degree() });
    }
    losses
}

pub(crate) fn encode(gaussians: &Gaussians, out: &mut dyn Write) -> std::io::Result<()> {
    for row in rows(gaussians) {
        let mut record = [0; RECORD];
        let floats = row.mean.into_iter().chain(row.log_scale.map(f32::exp));
        for (bytes, value) in record.chunks_exact_mut(4).zip(floats) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        for (slot, &value) in record[24..27].iter_mut().zip(row.sh) {
            *slot = byte(colour(value));
        }
        record[27] = byte(row.opacity.into());
        for (slot, value) in record[28..].iter_mut().zip(row.quaternion) {
            *slot = (value * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8;
        }
        out.write_all(&record)?;
    }
    Ok(())
}

pub(crate) fn decode(reader: &mut impl BufRead) -> Decoded {
    let (mut geometry, mut sh) = (Vec::new(), Vec::new());
    let mut record = Vec::with_capacity(RECORD);
    loop {
        record.clear();
        reader.by_ref().take(RECORD as u64).read_to_end(&mut record)?;
        if record.is_empty() {
            break;
        }
        let gaussian = geometry.len() / Gaussians::GEOMETRY;
        if record.len() < RECORD {
            return Err(Rule::Record { gaussian }.into());
        }
        let float = |i: usize| f32::from_le_bytes(std::array::from_fn(|k| record[4 * i + k]));
        geometry.extend((0..3).map(float));
        geometry.extend((28..32).map(|i| (f32::from(record[i]) - 128.0) / 128.0));
        for size in (3..6).map(float) {
            if !(size >= 0.0 && size.is_finite()) {
                let expected = "a finite number of at least 0";
                return Err(
                    Rule::Value { gaussian, quantity: Quantity::Size, found: size.into(), expected }.into()
                );
            }
            geometry.push(log_size(size));
        }
        geometry.push(step_logit(record[27].into(), 255));
        sh.extend((24..27).map(|i| dc(f64::from(record[i]) / 255.0)));
    }
    Ok((gaussians(0, geometry, sh), Vec::new()))
}

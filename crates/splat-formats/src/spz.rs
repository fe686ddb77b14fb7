//! SPZ of Niantic, versions 1 to 3: a gzip stream of a header and one table for each quantity.
//!
//! | table | bytes a Gaussian | meaning |
//! |---|---|---|
//! | position | 9 | 3 signed integers of 24 bits, divided by 2 to the power of the header's fractional bits (version 1: 3 half floats) |
//! | opacity | 1 | share of 255 |
//! | colour | 3 | dc = (byte / 255 - 0.5) / 0.15 |
//! | size | 3 | log-scale = byte / 16 - 10 |
//! | rotation | 4 | index of the largest of (x, y, z, w) in the top 2 bits, then sign and 9 bits of each other (before version 3: 3 bytes for x, y, z) |
//! | SH | 3 ((degree+1)² - 1) | (byte - 128) / 128, colour channel innermost |
//!
//! Axes: x right, y up, z backward ("RUB"), unless an extension of Adobe says otherwise.

use crate::error::Fault;
use crate::file::{Decoded, Remark};
use crate::loss::Clipping;
use crate::numbers::{byte, from_smallest_three, gaussians, rows, smallest_three, step_logit};
use crate::turn::Flip;
use crate::{Loss, Quantity, Rule};
use flate2::Compression;
use flate2::bufread::GzDecoder;
use flate2::write::GzEncoder;
use gs_scene::{Gaussians, sh_coefficients};
use half::f16;
use std::io::{BufRead, BufWriter, ErrorKind, IntoInnerError, Read, Write};

const MAGIC: [u8; 4] = *b"NGSP";
const WRITTEN_VERSION: u32 = 3;
const READ_VERSIONS: &str = "1 to 3 (splat-transform writes version 3 with --spz-version 3)";
const HEADER: usize = 16;
const FLAG_ANTIALIASED: u8 = 1;
const FLAG_EXTENSIONS: u8 = 2;
/// Adobe's extension that states the axes.
const COORDINATE_SYSTEM: u32 = 0xADBE_0003;

/// The largest position as an integer of 24 bits.
const MOST_FIXED: f64 = 8_388_607.0;
/// Most fractional bits that are written: steps of 6e-8 scene units.
const MOST_FRACTIONAL_BITS: u8 = 24;
/// A colour byte changes the constant SH coefficient by 1 / (0.15 · 255).
const COLOUR_SCALE: f64 = 0.15;
/// Range of log-scales, and steps in a unit.
const LOG_SCALE_RANGE: [f64; 2] = [-10.0, 255.0 / 16.0 - 10.0];
/// Range of the other SH coefficients.
const SH_RANGE: [f64; 2] = [-1.0, 127.0 / 128.0];

/// As many fractional bits as leave room for the farthest Gaussian.
fn fractional_bits(gaussians: &Gaussians) -> Result<u8, Rule> {
    let mut farthest = (0, 0.0_f32);
    for (index, row) in rows(gaussians).enumerate() {
        let distance = row.mean.into_iter().map(f32::abs).fold(0.0, f32::max);
        if distance > farthest.1 {
            farthest = (index, distance);
        }
    }
    let (gaussian, found) = (farthest.0, f64::from(farthest.1));
    let fits = |bits: &u8| (found * 2_f64.powi((*bits).into())).round() <= MOST_FIXED;
    (0..=MOST_FRACTIONAL_BITS).rev().find(fits).ok_or(Rule::Value {
        gaussian,
        quantity: Quantity::Position,
        found,
        expected: "at most 8388607 in magnitude",
    })
}

pub(crate) fn losses(gaussians: &Gaussians) -> Result<Vec<Loss>, Rule> {
    let step = 0.5 / 2_f64.powi(fractional_bits(gaussians)?.into());
    let dc_range = 0.5 / COLOUR_SCALE;
    let mut size = Clipping::new(Quantity::Size, LOG_SCALE_RANGE.map(f64::exp));
    let mut colour = Clipping::new(
        Quantity::Colour,
        [-dc_range, dc_range].map(|dc| 0.5 + dc * f64::from(gs_scene::SH_C0)),
    );
    let mut sh = Clipping::new(Quantity::Sh, SH_RANGE);
    for row in rows(gaussians) {
        size.count(row.log_scale.map(|value| f64::from(value).exp()));
        colour.count(row.sh[..3].iter().map(|&value| crate::numbers::colour(value)));
        sh.count(row.sh[3..].iter().map(|&value| value.into()));
    }
    let rounded = |quantity, bits, error, unit| Loss::Rounded { quantity, bits, error, unit };
    let colour_step = 0.5 / (COLOUR_SCALE * 255.0) * f64::from(gs_scene::SH_C0);
    let mut losses = vec![
        rounded(Quantity::Position, 24, step, "scene units"),
        rounded(Quantity::Size, 8, (0.5_f64 / 16.0).exp_m1(), "of itself"),
        rounded(Quantity::Rotation, 10, 0.5 * HALF_ROOT / 511.0, "in a component of the quaternion"),
        rounded(Quantity::Colour, 8, colour_step, "of full brightness"),
        rounded(Quantity::Opacity, 8, 0.5 / 255.0, "of opaque"),
    ];
    if gaussians.sh_degree() > 0 {
        losses.push(rounded(Quantity::Sh, 8, 0.5 / 128.0, "in a coefficient"));
    }
    losses.extend([size, colour, sh].iter().filter_map(|clipping| clipping.loss(gaussians.len())));
    Ok(losses)
}

pub(crate) fn encode(gaussians: &Gaussians, out: &mut dyn Write) -> std::io::Result<()> {
    let count = u32::try_from(gaussians.len()).map_err(std::io::Error::other)?;
    let bits = fractional_bits(gaussians).map_err(std::io::Error::other)?;
    let scale = 2_f64.powi(bits.into());
    let flip = Flip::spz();
    // Every call of the encoder costs a microsecond or two: it gets blocks, not triples of bytes.
    let mut out = BufWriter::with_capacity(1 << 16, GzEncoder::new(out, Compression::default()));
    out.write_all(&MAGIC)?;
    out.write_all(&WRITTEN_VERSION.to_le_bytes())?;
    out.write_all(&count.to_le_bytes())?;
    out.write_all(&[gaussians.sh_degree() as u8, bits, 0, 0])?;
    let rows = || rows(gaussians);
    for value in rows().flat_map(|row| flip.mean(row.mean)) {
        let fixed = (f64::from(value) * scale).round() as i32;
        out.write_all(&fixed.to_le_bytes()[..3])?;
    }
    rows().try_for_each(|row| out.write_all(&[byte(row.opacity.into())]))?;
    for row in rows() {
        let rgb: [u8; 3] = std::array::from_fn(|i| byte(f64::from(row.sh[i]) * COLOUR_SCALE + 0.5));
        out.write_all(&rgb)?;
    }
    for row in rows() {
        out.write_all(&row.log_scale.map(|value| byte((f64::from(value) + 10.0) * 16.0 / 255.0)))?;
    }
    for row in rows() {
        out.write_all(&rotation(flip.quaternion(row.quaternion)).to_le_bytes())?;
    }
    for row in rows() {
        for (coefficient, rgb) in row.sh.chunks_exact(3).enumerate().skip(1) {
            let sign = flip.sh(coefficient);
            let step = |value: f32| (f64::from(sign * value) * 128.0).round().clamp(-128.0, 127.0) + 128.0;
            out.write_all(&[step(rgb[0]) as u8, step(rgb[1]) as u8, step(rgb[2]) as u8])?;
        }
    }
    out.into_inner().map_err(IntoInnerError::into_error)?.finish().map(|_| ())
}

/// Half the square root of 2: no component but the largest has a greater magnitude.
const HALF_ROOT: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Packs (w, x, y, z); the file has (x, y, z, w).
fn rotation([w, x, y, z]: [f64; 4]) -> u32 {
    let (largest, others) = smallest_three([x, y, z, w]);
    others.iter().fold(largest as u32, |word, &q| {
        let magnitude = (q.abs() / HALF_ROOT * 511.0).round().min(511.0) as u32;
        word << 10 | u32::from(q < 0.0) << 9 | magnitude
    })
}

fn unpack_rotation(word: u32) -> [f32; 4] {
    let others = [20, 10, 0].map(|shift| {
        let magnitude = f64::from(word >> shift & 511) / 511.0 * HALF_ROOT;
        if word >> shift & 512 == 0 { magnitude } else { -magnitude }
    });
    let [x, y, z, w] = from_smallest_three((word >> 30) as usize, others);
    [w, x, y, z]
}

/// Before version 3: x, y and z from -1 to 1, and w of either sign as the positive one.
fn unpack_first_three(bytes: &[u8]) -> [f32; 4] {
    let [x, y, z] = std::array::from_fn(|i| f64::from(bytes[i]) / 127.5 - 1.0);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    [w, x, y, z].map(|value| value as f32)
}

/// Counts what is taken from a reader.
struct Counted<R> {
    inner: R,
    bytes: u64,
}

impl<R: BufRead> Read for Counted<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(out)?;
        self.bytes += read as u64;
        Ok(read)
    }
}

impl<R: BufRead> BufRead for Counted<R> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        self.inner.fill_buf()
    }

    fn consume(&mut self, amount: usize) {
        self.bytes += amount as u64;
        self.inner.consume(amount);
    }
}

/// The decompressed stream, which must not grow beyond what scenes do.
struct Stream<R> {
    gzip: GzDecoder<Counted<R>>,
    bytes: u64,
}

/// Packed scenes are compressed to a third; equal Gaussians to some hundredth.
const MOST_EXPANSION: u64 = 200;
/// Up to here the ratio is not looked at, bytes.
const FREE: u64 = 64 << 20;

impl<R: BufRead> Stream<R> {
    /// The next `wanted` bytes, or fewer at the end.
    fn bytes(&mut self, wanted: u64) -> Result<Vec<u8>, Fault> {
        const PIECE: u64 = 1 << 20;
        let mut bytes = Vec::new();
        while (bytes.len() as u64) < wanted {
            let piece = (wanted - bytes.len() as u64).min(PIECE);
            let read = self.gzip.by_ref().take(piece).read_to_end(&mut bytes);
            let read = read.map_err(|error| match error.kind() {
                ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::UnexpectedEof => {
                    Fault::Rule(Rule::Compression { reason: error.to_string() })
                }
                _ => Fault::Io(error),
            })?;
            self.bytes += read as u64;
            if self.bytes > FREE && self.bytes / MOST_EXPANSION > self.gzip.get_ref().bytes {
                return Err(Rule::Expansion { most: MOST_EXPANSION }.into());
            }
            if (read as u64) < piece {
                break;
            }
        }
        Ok(bytes)
    }
}

pub(crate) fn decode(reader: &mut impl BufRead) -> Decoded {
    if reader.fill_buf()?.starts_with(&MAGIC) {
        // From version 4 on the header is not compressed.
        let mut header = Vec::new();
        reader.take(8).read_to_end(&mut header)?;
        let found = header.get(4..8).and_then(|bytes| bytes.try_into().ok()).map(u32::from_le_bytes);
        let version = |found| Rule::Version { found, expected: READ_VERSIONS };
        return Err(found.map_or(Rule::Header, version).into());
    }
    let counted = Counted { inner: reader, bytes: 0 };
    let mut stream = Stream { gzip: GzDecoder::new(counted), bytes: 0 };
    let header = stream.bytes(HEADER as u64)?;
    let Ok(header) = <[u8; HEADER]>::try_from(header) else { return Err(Rule::Header.into()) };
    let word = |start: usize| u32::from_le_bytes(std::array::from_fn(|i| header[start + i]));
    if header[..4] != MAGIC {
        return Err(Rule::Magic.into());
    }
    let (version, count, [degree, bits, flags]) = (word(4), word(8), [header[12], header[13], header[14]]);
    if !(1..=3).contains(&version) {
        return Err(Rule::Version { found: version, expected: READ_VERSIONS }.into());
    }
    let field =
        |what, found: u8, expected| Err(Fault::from(Rule::Field { what, found: found.into(), expected }));
    if degree > 4 {
        return field("SH degree", degree, "0 to 4");
    }
    if bits > 30 {
        return field("number of fractional bits", bits, "0 to 30");
    }
    let sh_width = 3 * (sh_coefficients(degree.into()) - 1);
    let widths = [if version == 1 { 6 } else { 9 }, 1, 3, 3, if version < 3 { 3 } else { 4 }, sh_width];
    let promised = u64::from(count) * widths.iter().sum::<usize>() as u64;
    let body = stream.bytes(promised)?;
    if (body.len() as u64) < promised {
        return Err(Rule::Truncated { what: "bytes", promised, found: body.len() as u64 }.into());
    }
    let mut remarks = Vec::new();
    let mut flip = Flip::spz();
    if flags & FLAG_ANTIALIASED != 0 {
        remarks.push(Remark::Antialiased);
    }
    if degree > 3 {
        remarks.push(Remark::ShDegree4);
    }
    if flags & FLAG_EXTENSIONS != 0 {
        flip = extensions(&mut stream, &mut remarks)?;
    } else if !stream.bytes(1)?.is_empty() {
        // At the true end the checksum has been verified.
        return Err(Rule::Trailing.into());
    }

    let mut rest = body.as_slice();
    let [positions, opacities, colours, sizes, rotations, sh] = widths.map(|width| {
        let (table, behind) = rest.split_at(width * count as usize);
        rest = behind;
        move |index: usize| &table[index * width..][..width]
    });
    let kept = degree.min(3);
    let coefficients = sh_coefficients(kept.into());
    let (mut geometry, mut all_sh) = (Vec::new(), Vec::new());
    for index in 0..count as usize {
        let position = positions(index);
        let mean = std::array::from_fn(|axis| match version {
            1 => f16::from_le_bytes([position[2 * axis], position[2 * axis + 1]]).to_f32(),
            _ => {
                let [a, b, c] = std::array::from_fn(|i| position[3 * axis + i]);
                // Shifted up and down again for the sign.
                let fixed = i32::from_le_bytes([0, a, b, c]) >> 8;
                (f64::from(fixed) / 2_f64.powi(bits.into())) as f32
            }
        });
        geometry.extend(flip.mean(mean));
        let rotation = rotations(index);
        let quaternion = match <[u8; 4]>::try_from(rotation) {
            Ok(word) => unpack_rotation(u32::from_le_bytes(word)),
            Err(_) => unpack_first_three(rotation),
        };
        geometry.extend(flip.quaternion(quaternion));
        geometry.extend(sizes(index).iter().map(|&value| f32::from(value) / 16.0 - 10.0));
        geometry.push(step_logit(opacities(index)[0].into(), 255));
        let dc = |&value: &u8| ((f64::from(value) / 255.0 - 0.5) / COLOUR_SCALE) as f32;
        all_sh.extend(colours(index).iter().map(dc));
        for (i, &value) in sh(index)[..3 * (coefficients - 1)].iter().enumerate() {
            all_sh.push(flip.sh(1 + i / 3) * (f32::from(value) - 128.0) / 128.0);
        }
    }
    Ok((gaussians(kept.into(), geometry, all_sh), remarks))
}

/// Reads the extensions behind the tables: records of kind, length and content. Returns the change of axes.
fn extensions<R: BufRead>(stream: &mut Stream<R>, remarks: &mut Vec<Remark>) -> Result<Flip, Fault> {
    /// Most bytes of all extensions.
    const MOST: u64 = 1 << 20;
    let bytes = stream.bytes(MOST + 1)?;
    if bytes.len() as u64 > MOST {
        return Err(Rule::Trailing.into());
    }
    let mut flip = Flip::spz();
    let mut rest = bytes.as_slice();
    while let Some((head, content)) = rest.split_first_chunk::<8>() {
        let [kind, length] = [0, 4].map(|start| u32::from_le_bytes(std::array::from_fn(|i| head[start + i])));
        let Some((content, behind)) = content.split_at_checked(length as usize) else {
            return Err(Rule::Truncated {
                what: "bytes of an extension",
                promised: length.into(),
                found: content.len() as u64,
            }
            .into());
        };
        match (kind, content) {
            (COORDINATE_SYSTEM, &[a, b, c, d]) => match u32::from_le_bytes([a, b, c, d]) {
                0 => {}
                // Bits say right, up, forward. PLY's axes are right, down, forward.
                system @ 1..=8 => {
                    let sign =
                        |bit: u32, ply: bool| if ((system - 1) >> bit & 1 == 1) == ply { 1.0 } else { -1.0 };
                    flip = Flip::new([sign(0, true), sign(1, false), sign(2, true)]);
                }
                system => {
                    let found = system.to_string();
                    return Err(Rule::Unsupported { what: "coordinate system", found }.into());
                }
            },
            _ => remarks.push(Remark::SpzExtension { kind }),
        }
        rest = behind;
    }
    if rest.is_empty() { Ok(flip) } else { Err(Rule::Trailing.into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_survive_packing() {
        for seed in 0..200_u32 {
            let number = |k: u32| f64::from((seed * 7919 + k * 104_729) % 2001) / 1000.0 - 1.0;
            let q = [number(1), number(2), number(3), number(4)];
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            let q = q.map(|v| v / norm);
            let back = unpack_rotation(rotation(q)).map(f64::from);
            let dot: f64 = q.iter().zip(back).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 4e-6, "{q:?} {back:?}");
        }
        assert_eq!(unpack_first_three(&[255, 255, 255])[0], 0.0);
    }

    /// A file with this header and body.
    fn packed(version: u32, count: u32, degree: u8, flags: u8, body: &[u8]) -> Vec<u8> {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
        gzip.write_all(&MAGIC).unwrap();
        gzip.write_all(&version.to_le_bytes()).unwrap();
        gzip.write_all(&count.to_le_bytes()).unwrap();
        gzip.write_all(&[degree, 12, flags, 0]).unwrap();
        gzip.write_all(body).unwrap();
        gzip.finish().unwrap()
    }

    fn read(bytes: &[u8]) -> Decoded {
        decode(&mut &bytes[..])
    }

    fn refused(bytes: &[u8]) -> Rule {
        match read(bytes) {
            Err(Fault::Rule(rule)) => rule,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn versions_1_and_2_are_read() {
        // Position 1.5, -2, 0.25; opaque; grey; log-scale -2; x = 1.
        let tail = [255, 128, 128, 128, 128, 128, 128, 255, 127, 128];
        let fixed = [1.5_f64, -2.0, 0.25].map(|v| ((v * 4096.0) as i32).to_le_bytes());
        let fixed: Vec<u8> = fixed.iter().flat_map(|bytes| bytes[..3].to_vec()).collect();
        let halves: Vec<u8> =
            [1.5, -2.0, 0.25].into_iter().flat_map(|v| f16::from_f32(v).to_le_bytes()).collect();
        for (version, position) in [(1, halves), (2, fixed)] {
            let (scene, _) = read(&packed(version, 1, 0, 0, &[position, tail.to_vec()].concat())).unwrap();
            let geometry = scene.geometry();
            // y and z point the other way.
            assert_eq!(geometry[..3], [1.5, 2.0, -0.25]);
            assert!((geometry[4] - 1.0).abs() < 1e-6 && geometry[3] < 0.1, "{geometry:?}");
            assert_eq!(geometry[7..10], [-2.0; 3]);
            assert!(geometry[10] > 5.0 && scene.sh()[0].abs() < 0.02);
        }
    }

    #[test]
    fn degree_4_is_cut_and_an_extension_states_the_axes() {
        let mut body = vec![1, 0, 0, 1, 0, 0, 1, 0, 0, 128, 128, 128, 128, 0, 0, 0];
        body.extend(0xC000_0000_u32.to_le_bytes());
        body.extend([255; 72]);
        let (scene, remarks) = read(&packed(3, 1, 4, FLAG_ANTIALIASED, &body)).unwrap();
        assert_eq!((scene.sh_degree(), remarks.len()), (3, 2));
        let axes = |system: u32| {
            let record =
                [COORDINATE_SYSTEM.to_le_bytes(), 4_u32.to_le_bytes(), system.to_le_bytes()].concat();
            let bytes = packed(3, 1, 4, FLAG_EXTENSIONS, &[body.clone(), record].concat());
            read(&bytes).map(|(scene, _)| [0, 1, 2].map(|i| scene.geometry()[i].signum()))
        };
        assert_eq!(axes(0).unwrap(), [1.0, -1.0, -1.0]);
        assert_eq!(axes(4).unwrap(), [1.0, -1.0, -1.0], "right, up, backward");
        assert_eq!(axes(6).unwrap(), [1.0, 1.0, 1.0], "right, down, forward: PLY's");
        assert_eq!(axes(7).unwrap(), [-1.0, -1.0, 1.0], "left, up, forward: glTF's");
        assert!(axes(9).is_err());
        let other = [9_u32.to_le_bytes(), 1_u32.to_le_bytes()].concat();
        let bytes = packed(3, 1, 4, FLAG_EXTENSIONS, &[body.clone(), other.clone(), vec![7]].concat());
        assert!(read(&bytes).unwrap().1.contains(&Remark::SpzExtension { kind: 9 }));
        assert!(matches!(refused(&packed(3, 1, 4, 2, &[body, other].concat())), Rule::Truncated { .. }));
    }

    #[test]
    fn broken_files_name_their_rule() {
        let body = [0_u8; 20];
        assert!(read(&packed(3, 1, 0, 0, &body)).is_ok());
        assert_eq!(refused(&packed(3, 1, 0, 0, &[0; 21])), Rule::Trailing);
        assert!(matches!(refused(&packed(3, u32::MAX, 3, 0, &body)), Rule::Truncated { found: 20, .. }));
        assert!(matches!(refused(&packed(0, 1, 0, 0, &body)), Rule::Version { found: 0, .. }));
        assert!(matches!(refused(&packed(4, 1, 0, 0, &body)), Rule::Version { found: 4, .. }));
        assert!(matches!(refused(b"NGSP\x04\0\0\0"), Rule::Version { found: 4, .. }));
        assert_eq!(refused(b"NGSP"), Rule::Header);
        assert!(matches!(refused(&packed(3, 1, 5, 0, &body)), Rule::Field { .. }));
        let whole = packed(3, 1, 0, 0, &body);
        for cut in 0..whole.len() {
            refused(&whole[..cut]);
        }
        let mut damaged = whole.clone();
        damaged[whole.len() - 6] ^= 1;
        assert!(matches!(refused(&damaged), Rule::Compression { .. }), "the checksum is verified");
    }

    #[test]
    fn a_gzip_bomb_is_stopped() {
        let count = 20_000_000_u32;
        let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
        gzip.write_all(&MAGIC).unwrap();
        gzip.write_all(&3_u32.to_le_bytes()).unwrap();
        gzip.write_all(&count.to_le_bytes()).unwrap();
        gzip.write_all(&[0, 12, 0, 0]).unwrap();
        let zeros = vec![0; 1 << 20];
        (0..160).for_each(|_| gzip.write_all(&zeros).unwrap());
        assert!(matches!(refused(&gzip.finish().unwrap()), Rule::Expansion { .. }));
    }
}

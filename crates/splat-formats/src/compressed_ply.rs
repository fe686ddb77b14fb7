//! Compressed PLY of PlayCanvas and SuperSplat: Gaussians in chunks of 256, each number packed between the smallest and the
//! largest of its chunk.
//!
//! Elements: `chunk` (18 floats: smallest and largest position, log-scale and colour; older files lack the colours),
//! `vertex` (4 words: position and log-scale 11, 10 and 11 bits, quaternion (w, x, y, z) 2 bits for the largest component and 10
//! for each other, colour and opacity 8 bits each), `sh` (a byte for each coefficient from -4 to 4). PLY's axes.

use crate::error::Fault;
use crate::loss::Clipping;
use crate::numbers::{
    colour, dc, from_smallest_three, gaussians, read_rows, row, rows, smallest_three, step_logit, unorm,
};
use crate::{Loss, Quantity, Rule};
use gs_scene::{Gaussians, PlyElement, PlyEncoding, PlyHeader, PlyKind, PlyRule, PlyScalar, sh_coefficients};
use std::io::{Read, Write};

/// Gaussians of a chunk.
const CHUNK: usize = 256;
/// Columns of a chunk; the last six are absent in older files.
const CHUNK_COLUMNS: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
const VERTEX_COLUMNS: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// Bits of the three packed numbers of a position or log-scale.
const BITS: [u32; 3] = [11, 10, 11];
/// Log-scales are clipped to this magnitude, as the original does.
const LOG_SCALE_RANGE: f64 = 20.0;
/// SH coefficients are clipped to this magnitude.
const SH_RANGE: f64 = 4.0;

/// Whether the file is of this kind rather than a plain PLY.
pub(crate) fn is_compressed(header: &PlyHeader) -> bool {
    header.element("vertex").is_some_and(|vertex| vertex.column(VERTEX_COLUMNS[0]).is_some())
}

/// Smallest and largest numbers of a chunk: position, log-scale, colour.
struct Bounds([[[f64; 2]; 3]; 3]);

impl Bounds {
    fn of(rows: &[[[f64; 3]; 3]]) -> Self {
        let mut bounds = [[[f64::INFINITY, f64::NEG_INFINITY]; 3]; 3];
        for row in rows {
            for (bound, &value) in bounds.iter_mut().flatten().zip(row.iter().flatten()) {
                // As they will be stored, so that packing and unpacking see the same.
                let value = f64::from(value as f32);
                *bound = [bound[0].min(value), bound[1].max(value)];
            }
        }
        Self(bounds)
    }

    /// In the order of [`CHUNK_COLUMNS`].
    fn floats(&self) -> [f32; 18] {
        std::array::from_fn(|i| self.0[i / 6][i % 3][i % 6 / 3] as f32)
    }

    fn from_floats(floats: [f32; 18]) -> Self {
        Self(std::array::from_fn(|what| {
            std::array::from_fn(|axis| std::array::from_fn(|end| floats[6 * what + 3 * end + axis].into()))
        }))
    }

    fn pack(&self, what: usize, values: [f64; 3], bits: [u32; 3]) -> u32 {
        let mut word = 0;
        for ((&[low, high], value), bits) in self.0[what].iter().zip(values).zip(bits) {
            let share = if high > low { (value - low) / (high - low) } else { 0.0 };
            word = word << bits | unorm(share, (1 << bits) - 1);
        }
        word
    }

    fn unpack(&self, what: usize, mut word: u32, bits: [u32; 3]) -> [f64; 3] {
        let mut values = [0.0; 3];
        for axis in (0..3).rev() {
            let most = (1 << bits[axis]) - 1;
            let share = f64::from(word & most) / f64::from(most);
            let [low, high] = self.0[what][axis];
            values[axis] = low * (1.0 - share) + high * share;
            word >>= bits[axis];
        }
        values
    }
}

/// The numbers of a Gaussian that are packed between bounds.
fn bounded(gaussians: &Gaussians, index: usize) -> [[f64; 3]; 3] {
    let row = row(gaussians, index);
    let log_scale = row.log_scale.map(|value| f64::from(value).clamp(-LOG_SCALE_RANGE, LOG_SCALE_RANGE));
    [row.mean.map(f64::from), log_scale, std::array::from_fn(|i| colour(row.sh[i]))]
}

/// Gaussians along a Z-order curve through the box of the scene: neighbours in space share a chunk.
fn morton_order(gaussians: &Gaussians) -> Vec<usize> {
    const STEPS: u32 = (1 << 21) - 1;
    let means: Vec<_> = (0..gaussians.len()).map(|i| bounded(gaussians, i)).collect();
    let Bounds([bounds, ..]) = Bounds::of(&means);
    let code = |mean: [f64; 3]| {
        let mut code = 0_u64;
        for (axis, (&[low, high], value)) in bounds.iter().zip(mean).enumerate() {
            let share = if high > low { (value - low) / (high - low) } else { 0.0 };
            let step = u64::from(unorm(share, STEPS));
            code |= (0..21).map(|bit| (step >> bit & 1) << (3 * bit + axis)).sum::<u64>();
        }
        code
    };
    let mut order: Vec<(u64, usize)> = means.iter().enumerate().map(|(i, row)| (code(row[0]), i)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, index)| index).collect()
}

pub(crate) fn losses(gaussians: &Gaussians) -> Vec<Loss> {
    let mut size = Clipping::new(Quantity::Size, [-LOG_SCALE_RANGE, LOG_SCALE_RANGE].map(f64::exp));
    let mut sh = Clipping::new(Quantity::Sh, [-SH_RANGE, SH_RANGE]);
    for row in rows(gaussians) {
        size.count(row.log_scale.map(|value| f64::from(value).exp()));
        sh.count(row.sh[3..].iter().map(|&value| value.into()));
    }
    // The largest spread of a quantity within a chunk.
    let order = morton_order(gaussians);
    let mut spread = [[0.0_f64; 3]; 3];
    for chunk in order.chunks(CHUNK) {
        let rows: Vec<_> = chunk.iter().map(|&i| bounded(gaussians, i)).collect();
        for (spread, [low, high]) in
            spread.iter_mut().flatten().zip(Bounds::of(&rows).0.into_iter().flatten())
        {
            *spread = spread.max(high - low);
        }
    }
    let step = |what: usize, bits: [u32; 3]| {
        let halves = (0..3).map(|axis| 0.5 * spread[what][axis] / f64::from((1_u32 << bits[axis]) - 1));
        halves.fold(0.0, f64::max)
    };
    let rounded = |quantity, bits, error, unit| Loss::Rounded { quantity, bits, error, unit };
    let mut losses = vec![
        Loss::Order,
        rounded(Quantity::Position, BITS[1], step(0, BITS), "scene units"),
        rounded(Quantity::Size, BITS[1], step(1, BITS).exp_m1(), "of itself"),
        rounded(
            Quantity::Rotation,
            10,
            0.5 * std::f64::consts::SQRT_2 / 1023.0,
            "in a component of the quaternion",
        ),
        rounded(Quantity::Colour, 8, step(2, [8; 3]), "of full brightness"),
        rounded(Quantity::Opacity, 8, 0.5 / 255.0, "of opaque"),
    ];
    if gaussians.sh_degree() > 0 {
        losses.push(rounded(Quantity::Sh, 8, SH_RANGE / 128.0, "in a coefficient"));
    }
    losses.extend([size.loss(gaussians.len()), sh.loss(gaussians.len())].into_iter().flatten());
    losses
}

pub(crate) fn encode(gaussians: &Gaussians, out: &mut dyn Write) -> std::io::Result<()> {
    let order = morton_order(gaussians);
    let rest = sh_coefficients(gaussians.sh_degree()) - 1;
    let chunks = order.len().div_ceil(CHUNK);
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement chunk {chunks}")?;
    CHUNK_COLUMNS.iter().try_for_each(|name| writeln!(out, "property float {name}"))?;
    writeln!(out, "element vertex {}", order.len())?;
    VERTEX_COLUMNS.iter().try_for_each(|name| writeln!(out, "property uint {name}"))?;
    if rest > 0 {
        writeln!(out, "element sh {}", order.len())?;
        (0..3 * rest).try_for_each(|i| writeln!(out, "property uchar f_rest_{i}"))?;
    }
    writeln!(out, "end_header")?;
    let mut words = Vec::with_capacity(order.len() * 4);
    for chunk in order.chunks(CHUNK) {
        let rows: Vec<_> = chunk.iter().map(|&i| bounded(gaussians, i)).collect();
        let bounds = Bounds::of(&rows);
        for value in bounds.floats() {
            out.write_all(&value.to_le_bytes())?;
        }
        for (&index, [mean, log_scale, rgb]) in chunk.iter().zip(rows) {
            let row = row(gaussians, index);
            let colours = bounds.pack(2, rgb, [8; 3]) << 8 | unorm(row.opacity.into(), 255);
            words.extend([
                bounds.pack(0, mean, BITS),
                rotation(row.quaternion),
                bounds.pack(1, log_scale, BITS),
                colours,
            ]);
        }
    }
    words.iter().try_for_each(|word: &u32| out.write_all(&word.to_le_bytes()))?;
    let mut bytes = vec![0; 3 * rest];
    for &index in order.iter().filter(|_| rest > 0) {
        for (coefficient, rgb) in row(gaussians, index).sh.chunks_exact(3).skip(1).enumerate() {
            for (channel, &value) in rgb.iter().enumerate() {
                let step = ((f64::from(value) / (2.0 * SH_RANGE) + 0.5) * 256.0).floor();
                bytes[channel * rest + coefficient] = step.clamp(0.0, 255.0) as u8;
            }
        }
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// Half the square root of 2: no component but the largest has a greater magnitude.
const HALF_ROOT: f64 = std::f64::consts::FRAC_1_SQRT_2;

fn rotation(quaternion: [f64; 4]) -> u32 {
    let (largest, others) = smallest_three(quaternion);
    others.iter().fold(largest as u32, |word, q| word << 10 | unorm(q * HALF_ROOT + 0.5, 1023))
}

fn unpack_rotation(word: u32) -> [f32; 4] {
    let others = [20, 10, 0].map(|shift| (f64::from(word >> shift & 1023) / 1023.0 - 0.5) / HALF_ROOT);
    from_smallest_three((word >> 30) as usize, others)
}

/// An element whose columns are these, in any order, with the position of each.
fn columns<'a>(
    header: &'a PlyHeader,
    element: &'static str,
    names: &[impl AsRef<str>],
    scalar: PlyScalar,
    columns: &'static str,
) -> Result<(&'a PlyElement, Vec<usize>), Rule> {
    let wrong = || Rule::Columns { element, columns };
    let found = header.element(element).ok_or_else(wrong)?;
    let of_kind = found.properties.iter().all(|property| property.kind == PlyKind::Scalar(scalar));
    let places: Option<Vec<usize>> = names.iter().map(|name| found.column(name.as_ref())).collect();
    let places = places.filter(|places| of_kind && places.len() == found.properties.len());
    Ok((found, places.ok_or_else(wrong)?))
}

pub(crate) fn decode(header: &PlyHeader, reader: &mut impl Read) -> Result<Gaussians, Fault> {
    if header.encoding != PlyEncoding::LittleEndian {
        let found = PlyRule::Format { found: format!("{:?}", header.encoding) };
        return Err(Rule::Unsupported { what: "format", found: found.to_string() }.into());
    }
    let names: Vec<&str> = header.elements.iter().map(|element| element.name.as_str()).collect();
    if !["chunk", "vertex", "sh"].starts_with(&names) || names.len() < 2 {
        let columns = "chunk, vertex and perhaps sh, in this order";
        return Err(Rule::Columns { element: "chunk", columns }.into());
    }
    let coloured = header.element("chunk").is_some_and(|chunk| chunk.properties.len() > 12);
    let chunk_names = &CHUNK_COLUMNS[..if coloured { 18 } else { 12 }];
    let (chunk, chunk_places) =
        columns(header, "chunk", chunk_names, PlyScalar::F32, "min_x .. max_scale_z, max_b (float)")?;
    let (vertex, places) =
        columns(header, "vertex", &VERTEX_COLUMNS, PlyScalar::U32, "packed_position .. packed_color (uint)")?;
    let count = vertex.count;
    let expected = count.div_ceil(CHUNK as u64);
    if chunk.count != expected {
        return Err(Rule::Length { what: "number of chunks", found: chunk.count, expected }.into());
    }
    let sh_width = header.element("sh").map_or(0, |sh| sh.properties.len());
    let degree = (0..=3).find(|&degree| 3 * (sh_coefficients(degree) - 1) == sh_width);
    let sh_columns = "0, 9, 24 or 45 f_rest (uchar)";
    let degree = degree.ok_or(Rule::Columns { element: "sh", columns: sh_columns })?;
    let mut sh_places = Vec::new();
    if let Some(sh) = header.element("sh") {
        let names: Vec<String> = (0..sh_width).map(|i| format!("f_rest_{i}")).collect();
        sh_places = columns(header, "sh", &names, PlyScalar::U8, sh_columns)?.1;
        if sh.count != count {
            return Err(Rule::Length { what: "rows of sh", found: sh.count, expected: count }.into());
        }
    }

    let word = |bytes: &[u8], place: usize| <[u8; 4]>::try_from(&bytes[4 * place..][..4]).unwrap_or_default();
    let chunks = read_rows(reader, "chunks", expected, 4 * chunk_names.len())?;
    let bounds: Vec<Bounds> = chunks
        .chunks_exact(4 * chunk_names.len())
        .map(|row| {
            // Without bounds of its own a colour lies between 0 and 1.
            let mut floats = [0.0; 18];
            floats[15..].fill(1.0);
            for (value, &place) in floats.iter_mut().zip(&chunk_places) {
                *value = f32::from_le_bytes(word(row, place));
            }
            Bounds::from_floats(floats)
        })
        .collect();
    let vertices = read_rows(reader, "Gaussians", count, 16)?;
    let sh_rows = read_rows(reader, "rows of sh", if sh_width > 0 { count } else { 0 }, sh_width.max(1))?;

    let (mut geometry, mut sh) = (Vec::new(), Vec::new());
    for (index, vertex) in vertices.chunks_exact(16).enumerate() {
        let bounds = &bounds[index / CHUNK];
        let [position, rotation, scale, colours] =
            std::array::from_fn(|i| u32::from_le_bytes(word(vertex, places[i])));
        geometry.extend(bounds.unpack(0, position, BITS).map(|value| value as f32));
        geometry.extend(unpack_rotation(rotation));
        geometry.extend(bounds.unpack(1, scale, BITS).map(|value| value as f32));
        geometry.push(step_logit(colours & 255, 255));
        sh.extend(bounds.unpack(2, colours >> 8, [8; 3]).map(dc));
        let rest = sh_width / 3;
        for i in 0..sh_width {
            let (coefficient, channel) = (i / 3, i % 3);
            let byte = sh_rows[index * sh_width + sh_places[channel * rest + coefficient]];
            // The first and the last step stand for the ends of the range.
            let share = match byte {
                0 => 0.0,
                255 => 1.0,
                _ => (f64::from(byte) + 0.5) / 256.0,
            };
            sh.push(((share - 0.5) * 2.0 * SH_RANGE) as f32);
        }
    }
    Ok(gaussians(degree, geometry, sh))
}

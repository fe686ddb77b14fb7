//! Procedural textures: a pattern's colour at a point, and its mean over the footprint of a sample.

use crate::noise::{cell, hash, octaves, unit, value};
use crate::shape::{Canvas, SurfacePoint};
use crate::{Finish, Material, Pattern, Rgb};
use glam::{DVec2, DVec3, Vec3};

/// The part of a surface that one sample stands for: a parallelogram around a point, by its two edges,
/// metres.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    pub(crate) across: DVec3,
    pub(crate) down: DVec3,
}

/// At most so many texture samples along each edge of a footprint.
const MOST_SAMPLES: f64 = 8.0;

/// Linear light from an sRGB-encoded colour (IEC 61966-2-1).
pub(crate) fn linear(colour: Rgb) -> Vec3 {
    Vec3::from(colour.map(|v| if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }))
}

/// sRGB encoding of linear light, clipped to 0..1.
pub(crate) fn encode(light: Vec3) -> Rgb {
    light
        .clamp(Vec3::ZERO, Vec3::ONE)
        .to_array()
        .map(|v| if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 })
}

/// A material with its colours made linear.
#[derive(Debug, Clone)]
pub(crate) struct Texture(Material);

impl Texture {
    pub(crate) fn new(material: &Material) -> Self {
        let linear = |colour| linear(colour).to_array();
        let pattern = match material.pattern {
            Pattern::Plain { colour } => Pattern::Plain { colour: linear(colour) },
            Pattern::Checker { colours, cell } => Pattern::Checker { colours: colours.map(linear), cell },
            Pattern::Brick { brick, mortar, length, height, joint } => {
                Pattern::Brick { brick: linear(brick), mortar: linear(mortar), length, height, joint }
            }
            Pattern::Wood { light, dark, plank } => {
                Pattern::Wood { light: linear(light), dark: linear(dark), plank }
            }
            Pattern::Noise { dark, light, scale, octaves } => {
                Pattern::Noise { dark: linear(dark), light: linear(light), scale, octaves }
            }
            Pattern::Foliage { dark, light, leaf, cover } => {
                Pattern::Foliage { dark: linear(dark), light: linear(light), leaf, cover }
            }
            Pattern::VertexColours => Pattern::VertexColours,
            Pattern::Print { paper, ink, accent, line } => {
                Pattern::Print { paper: linear(paper), ink: linear(ink), accent: linear(accent), line }
            }
        };
        Self(Material { pattern, ..material.clone() })
    }

    /// What the surface does with light.
    pub(crate) fn finish(&self) -> Finish {
        self.0.finish
    }

    /// Whether [`Texture::is_hole`] may be true anywhere.
    pub(crate) fn has_holes(&self) -> bool {
        matches!(self.0.pattern, Pattern::Foliage { .. })
    }

    /// Whether rays pass at this point.
    // Shading owns this rule, tracing only asks; until leaves have shapes nothing is a hole.
    pub(crate) fn is_hole(&self, _canvas: &Canvas, _point: &SurfacePoint) -> bool {
        false
    }

    /// Mean reflectance over a footprint, linear RGB.
    ///
    /// The footprint is sampled on a regular grid, two samples for every finest detail of the pattern.
    pub(crate) fn reflectance(&self, canvas: &Canvas, point: &SurfacePoint, footprint: &Footprint) -> Vec3 {
        let Material { pattern, mottle, seed, .. } = &self.0;
        let (across, down) = (footprint.across.length(), footprint.down.length());
        let count = |edge: f64| (2.0 * edge / finest(pattern)).ceil().clamp(1.0, MOST_SAMPLES);
        let (columns, rows) = (count(across), count(down));
        let width = (across / columns).max(down / rows);
        let mut sum = Vec3::ZERO;
        for row in 0..rows as u32 {
            for column in 0..columns as u32 {
                let offset = footprint.across * ((f64::from(column) + 0.5) / columns - 0.5)
                    + footprint.down * ((f64::from(row) + 0.5) / rows - 0.5);
                let position = point.position + offset;
                sum += colour(pattern, canvas, &SurfacePoint { position, ..*point }, width, *seed);
            }
        }
        let mut mean = sum / (columns * rows) as f32;
        if *mottle > 0.0 {
            // Stains of 40 cm down to 5 cm.
            let stain = octaves(point.position / 0.4, 4, width / 0.4, seed.wrapping_add(77));
            mean *= 1.0 - mottle * (1.6 * stain as f32 - 0.3).clamp(0.0, 1.0);
        }
        mean
    }
}

/// The size of the finest detail that a pattern shows with an edge, metres; noise band-limits itself.
fn finest(pattern: &Pattern) -> f64 {
    match *pattern {
        Pattern::Plain { .. } | Pattern::Noise { .. } | Pattern::VertexColours => f64::INFINITY,
        Pattern::Foliage { leaf, .. } => 0.25 * leaf,
        Pattern::Checker { cell, .. } => 0.25 * cell,
        Pattern::Brick { joint, height, .. } => joint.max(0.05 * height),
        Pattern::Wood { plank, .. } => 0.1 * plank,
        Pattern::Print { line, .. } => line / 9.0,
    }
}

fn mix(a: Rgb, b: Rgb, t: f64) -> Vec3 {
    Vec3::from(a).lerp(Vec3::from(b), t as f32)
}

/// The colour at a point. `width` is the distance to the next sample, metres.
fn colour(pattern: &Pattern, canvas: &Canvas, point: &SurfacePoint, width: f64, seed: u32) -> Vec3 {
    let page = || canvas.texture_coordinates(point.face, point.position);
    match *pattern {
        Pattern::Plain { colour } => colour.into(),
        Pattern::Foliage { light, .. } => light.into(),
        Pattern::VertexColours => point.colour,
        Pattern::Checker { colours, cell: edge } => {
            let uv = page().0 / edge;
            colours[(cell(uv.x).wrapping_add(cell(uv.y)) & 1) as usize].into()
        }
        Pattern::Brick { brick, mortar, length, height, joint } => {
            let uv = page().0;
            let course = (uv.y / height).floor();
            let along = uv.x / length + 0.5 * course.rem_euclid(2.0);
            let (in_brick, in_course) = ((along - along.floor()) * length, uv.y - course * height);
            let grain = octaves(uv.extend(0.0) * 60.0, 3, width * 60.0, seed);
            if in_brick < joint || in_course < joint {
                return Vec3::from(mortar) * (0.8 + 0.4 * grain as f32);
            }
            let tone = unit(hash(cell(along), cell(course), 1, seed));
            Vec3::from(brick) * (0.45 + 0.7 * tone as f32 + 0.4 * grain as f32)
        }
        Pattern::Wood { light, dark, plank } => wood(point.position, light, dark, plank, width, seed),
        Pattern::Noise { dark, light, scale, octaves: count } => {
            let v = octaves(point.position / scale, count, width / scale, seed);
            // Value noise crowds around its mean; this spreads it over the two colours.
            mix(dark, light, (2.2 * v - 0.6).clamp(0.0, 1.0))
        }
        Pattern::Print { paper, ink, accent, line } => {
            let (uv, extent) = page();
            match print(uv, extent, line, seed) {
                Stroke::Paper => paper.into(),
                Stroke::Ink => ink.into(),
                Stroke::Accent(strength) => mix(paper, accent, strength),
            }
        }
    }
}

/// Planks along x, 1.5 % of their width apart; grain stretched along them.
fn wood(p: DVec3, light: Rgb, dark: Rgb, plank: f64, width: f64, seed: u32) -> Vec3 {
    // Both the faces along xy and those along xz show planks.
    let across = (p.y + p.z) / plank + 0.5;
    let index = cell(across);
    let in_plank = across - across.floor();
    if !(0.015..=0.985).contains(&in_plank) {
        return Vec3::from(dark) * 0.35;
    }
    let own = hash(index, 0, 2, seed);
    let q = DVec3::new(p.x * 0.7, p.y * 6.0, p.z * 6.0) / plank + DVec3::X * (unit(own) * 100.0);
    let bend = value(q * DVec3::new(0.5, 0.25, 0.25), own);
    let fine = octaves(q * DVec3::new(2.0, 4.0, 4.0), 2, width * 24.0 / plank, own);
    let rings = 0.5 - 0.5 * (std::f64::consts::TAU * (in_plank * 2.0 + 5.0 * bend)).cos();
    let tone = 0.9 + 0.2 * unit(hash(index, 1, 2, seed));
    mix(light, dark, (0.65 * rings * rings + 0.6 * (fine - 0.5) + 0.1).clamp(0.0, 1.0)) * tone as f32
}

enum Stroke {
    Paper,
    Ink,
    /// How much of the accent colour covers the paper, 0..1.
    Accent(f64),
}

/// What is printed at a point of a page: a margin of one line, a heading three lines high with a bar below
/// it, text with paragraphs, and a picture in the lower right.
fn print(uv: DVec2, extent: DVec2, line: f64, seed: u32) -> Stroke {
    // From here on in lines, from the top left corner of the text area.
    let size = extent / line - DVec2::splat(2.0);
    let p = DVec2::new(uv.x / line - 1.0, extent.y / line - uv.y / line - 1.0);
    if p.min_element() < 0.0 || p.x > size.x || p.y > size.y {
        return Stroke::Paper;
    }
    if p.y < 3.0 {
        return letter(p / 3.0, size.x / 3.0, 0, seed).map_or(Stroke::Paper, |()| Stroke::Accent(1.0));
    }
    if p.y < 4.0 {
        return if p.y < 3.3 { Stroke::Accent(1.0) } else { Stroke::Paper };
    }
    let picture = (p - size * DVec2::new(0.5, 0.55)) / (size * DVec2::new(0.5, 0.45));
    if picture.min_element() >= 0.0 {
        return image(picture, seed);
    }
    let row = p.y.floor() - 3.0;
    // Every sixth line is empty, the last one is whole, and no line but those beside the picture has the same
    // length.
    let beside = size.y * 0.55 - 1.0 < p.y;
    let room = if beside { size.x * 0.47 } else { size.x };
    let length = room * (0.75 + 0.25 * unit(hash(cell(row), 5, 3, seed)));
    if row % 6.0 == 5.0 || p.y.floor() + 1.0 > size.y {
        return Stroke::Paper;
    }
    letter(DVec2::new(p.x, p.y - p.y.floor() + row), length, 1, seed).map_or(Stroke::Paper, |()| Stroke::Ink)
}

/// A framed picture of soft hills under a disc, in 0..1 of its frame.
fn image(p: DVec2, seed: u32) -> Stroke {
    if p.min_element() < 0.04 || p.max_element() > 0.96 {
        return Stroke::Ink;
    }
    let place = |k| 0.25 + 0.5 * unit(hash(k, 6, 4, seed));
    if p.distance(DVec2::new(place(0), 0.6 * place(1))) < 0.14 {
        return Stroke::Accent(0.15);
    }
    let hills = (0..3).filter(|k| {
        let height = value(DVec3::new(p.x * 3.0, f64::from(*k) * 7.7, 0.5), seed);
        p.y > 0.25 + 0.22 * f64::from(*k) + 0.3 * height
    });
    Stroke::Accent(0.3 + 0.23 * hills.count() as f64)
}

/// Whether a point of a line of text, in line heights, lies on a letter. Words are of 1 to 8 letters.
fn letter(p: DVec2, length: f64, kind: u32, seed: u32) -> Option<()> {
    /// Width of a letter with its gap, as a share of the line height.
    const ADVANCE: f64 = 0.6;
    let column = (p.x / ADVANCE).floor();
    let row = p.y.floor();
    if (column + 1.0) * ADVANCE > length {
        return None;
    }
    let bits = hash(cell(column), cell(row), 8 + kind, seed);
    if bits.is_multiple_of(6) {
        return None;
    }
    // A glyph has 5 x 7 dots in a cell of 6 x 9.
    let dot = DVec2::new((p.x / ADVANCE - column) * 6.0, (p.y - row) * 9.0 - 1.0);
    if !(0.0..5.0).contains(&dot.x) || !(0.0..7.0).contains(&dot.y) {
        return None;
    }
    let glyph = GLYPHS[(bits >> 8) as usize % GLYPHS.len()];
    (glyph[dot.y as usize] >> (4 - dot.x as u32) & 1 == 1).then_some(())
}

/// The letters E T A O I N S H R D L U C M F P, seven rows of five dots each.
const GLYPHS: [[u8; 7]; 16] = [
    [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111],
    [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100],
    [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
    [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110],
    [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
    [0b10001, 0b11001, 0b11001, 0b10101, 0b10011, 0b10011, 0b10001],
    [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110],
    [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
    [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001],
    [0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110],
    [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111],
    [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110],
    [0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110],
    [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001],
    [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000],
    [0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000],
];

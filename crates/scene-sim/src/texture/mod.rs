//! Procedural textures: a pattern's colour at a point, and its mean over the footprint of a sample.

mod foliage;
mod print;

use crate::noise::{cell, hash, octaves, unit, value};
use crate::shape::{Canvas, SurfacePoint};
use crate::{Finish, Material, Pattern, Rgb};
use foliage::Leaves;
use glam::{DVec3, Vec3};
use print::{Stroke, print};

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
pub(crate) struct Texture {
    material: Material,
    /// Of a pattern of foliage.
    leaves: Option<Leaves>,
}

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
        let leaves = match pattern {
            Pattern::Foliage { leaf, cover, .. } => Some(Leaves::new(leaf, cover, material.seed)),
            _ => None,
        };
        Self { material: Material { pattern, ..material.clone() }, leaves }
    }

    /// What the surface does with light.
    pub(crate) fn finish(&self) -> Finish {
        self.material.finish
    }

    /// Whether the surface has holes.
    pub(crate) fn has_holes(&self) -> bool {
        self.leaves.as_ref().is_some_and(Leaves::are_open)
    }

    /// Whether a ray passes through a hole at a point of the surface.
    pub(crate) fn is_hole(&self, canvas: &Canvas, point: &SurfacePoint) -> bool {
        self.leaves.as_ref().is_some_and(|leaves| leaves.is_hole(canvas, point))
    }

    /// Mean reflectance over a footprint, linear RGB.
    ///
    /// The footprint is sampled on a regular grid, two samples for every finest detail of the pattern.
    pub(crate) fn reflectance(&self, canvas: &Canvas, point: &SurfacePoint, footprint: &Footprint) -> Vec3 {
        let Material { pattern, mottle, seed, .. } = &self.material;
        let (across, down) = (footprint.across.length(), footprint.down.length());
        let count = |edge: f64| (2.0 * edge / finest(pattern)).ceil().clamp(1.0, MOST_SAMPLES);
        let (columns, rows) = (count(across), count(down));
        let width = (across / columns).max(down / rows);
        let (mut sum, mut shown) = (Vec3::ZERO, 0.0);
        for row in 0..rows as u32 {
            for column in 0..columns as u32 {
                let offset = footprint.across * ((f64::from(column) + 0.5) / columns - 0.5)
                    + footprint.down * ((f64::from(row) + 0.5) / rows - 0.5);
                let position = point.position + offset;
                let point = SurfacePoint { position, ..*point };
                if let Some(colour) = self.colour(canvas, &point, width) {
                    sum += colour;
                    shown += 1.0;
                }
            }
        }
        // Where every sample fell into a hole, the ray's own point is not in one.
        let mut mean =
            if shown > 0.0 { sum / shown } else { self.colour(canvas, point, width).unwrap_or(Vec3::ZERO) };
        if *mottle > 0.0 {
            // Stains of 40 cm down to 5 cm.
            let stain = octaves(point.position / 0.4, 4, width / 0.4, seed.wrapping_add(77));
            mean *= 1.0 - mottle * (1.6 * stain as f32 - 0.3).clamp(0.0, 1.0);
        }
        mean
    }

    /// The colour at a point, `None` in a hole. `width` is the distance to the next sample, metres.
    fn colour(&self, canvas: &Canvas, point: &SurfacePoint, width: f64) -> Option<Vec3> {
        let Material { ref pattern, seed, .. } = self.material;
        let page = || canvas.texture_coordinates(point.face, point.position);
        Some(match *pattern {
            Pattern::Plain { colour } => colour.into(),
            Pattern::Foliage { dark, light, .. } => {
                let leaves = self.leaves.as_ref()?;
                match leaves.tone(canvas, point) {
                    Some(tone) => mix(dark, light, tone),
                    None if leaves.are_open() => return None,
                    None => Vec3::from(dark) * 0.5,
                }
            }
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
                    return Some(Vec3::from(mortar) * (0.8 + 0.4 * grain as f32));
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
        })
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

/// Planks along x, 1.5 % of their width apart; grain stretched along them.
fn wood(p: DVec3, light: Rgb, dark: Rgb, plank: f64, width: f64, seed: u32) -> Vec3 {
    // Both the faces along xy and those along xz show planks.
    let across = (p.y + p.z) / plank + 0.5;
    let index = cell(across);
    let in_plank = across - across.floor();
    if !(0.015..=0.985).contains(&in_plank) {
        return Vec3::from(dark) * 0.35;
    }
    let plank_seed = hash(index, 0, 2, seed);
    let q = DVec3::new(p.x * 0.7, p.y * 6.0, p.z * 6.0) / plank + DVec3::X * (unit(plank_seed) * 100.0);
    let bend = value(q * DVec3::new(0.5, 0.25, 0.25), plank_seed);
    let fine = octaves(q * DVec3::new(2.0, 4.0, 4.0), 2, width * 24.0 / plank, plank_seed);
    let rings = 0.5 - 0.5 * (std::f64::consts::TAU * (in_plank * 2.0 + 5.0 * bend)).cos();
    let tone = 0.9 + 0.2 * unit(hash(index, 1, 2, seed));
    mix(light, dark, (0.65 * rings * rings + 0.6 * (fine - 0.5) + 0.1).clamp(0.0, 1.0)) * tone as f32
}

//! Leaves with holes between them. One pattern decides both where a hole is and which colour a leaf has.
//!
//! Leaves lie in layers. Each layer has a square grid of its own, turned and shifted against the others, and at most
//! one leaf in each of its cells, so a point asks one cell per layer. The grids have nothing in common, so the layers
//! cover independently: with a share `a` of a cell under its leaf and a leaf in a share `q` of the cells, `n` layers
//! cover `1 - (1 - a q)^n`. That is solved for `n` and `q`.

use crate::Shape;
use crate::noise::{cell, hash, unit};
use crate::shape::{Canvas, Face, SurfacePoint};
use glam::DVec2;

/// Edge of a cell, in lengths of a leaf. A leaf fits into its cell however it is turned.
const CELL: f64 = 1.1;
/// Greatest half width of a leaf, in its lengths, were it of one form on both sides of its middle.
const HALF_WIDTH: f64 = 0.26;
/// How much wider it is towards its stem.
const TAPER: f64 = 0.7;
/// Area of a leaf as a share of its cell: the integral of twice the half width.
const AREA: f64 = HALF_WIDTH * 4.0 / 3.0 / (CELL * CELL);
/// Fourteen full layers cover 99 %; where more is asked for, what lies below them is no hole but shade.
const MOST_LAYERS: f64 = 14.0;

/// The arrangement of the leaves of one material.
#[derive(Debug, Clone)]
pub(super) struct Leaves {
    layers: Vec<Layer>,
    /// Share of the cells that have a leaf.
    presence: f64,
    /// Whether there is nothing behind the leaves but holes.
    open: bool,
    length: f64,
}

/// The grid of a layer: turned, then shifted, in cells.
#[derive(Debug, Clone)]
struct Layer {
    turn: DVec2,
    shift: DVec2,
    seed: u32,
}

impl Leaves {
    /// `length` of a leaf in metres; `cover` is the share of the surface under leaves, 0 to 1.
    pub(super) fn new(length: f64, cover: f32, seed: u32) -> Self {
        let free = 1.0 - f64::from(cover);
        let full = free.ln() / (1.0 - AREA).ln();
        let count = if free < 1.0 { full.ceil().clamp(1.0, MOST_LAYERS) } else { 0.0 };
        let presence = ((1.0 - free.powf(1.0 / count)) / AREA).min(1.0);
        let layer = |index: u32| {
            let bits = hash(index, 0, 21, seed);
            // The golden angle and a random start: no two grids are parallel.
            let angle = 2.399_963 * f64::from(index) + unit(bits);
            let shift = DVec2::new(unit(hash(bits, 1, 21, seed)), unit(hash(bits, 2, 21, seed)));
            Layer { turn: DVec2::from_angle(angle), shift, seed: bits }
        };
        Self { layers: (0..count as u32).map(layer).collect(), presence, open: full <= MOST_LAYERS, length }
    }

    /// Whether the surface has holes at all.
    pub(super) fn are_open(&self) -> bool {
        self.open
    }

    /// Whether there is a hole at a point of a surface.
    pub(super) fn is_hole(&self, canvas: &Canvas, point: &SurfacePoint) -> bool {
        self.open && self.tone(canvas, point).is_none()
    }

    /// From 0, a leaf in the shade, to 1, a lit one; `None` where there is no leaf.
    pub(super) fn tone(&self, canvas: &Canvas, point: &SurfacePoint) -> Option<f64> {
        let (place, sheet) = sheet(canvas, point);
        let place = place / (self.length * CELL);
        self.layers.iter().enumerate().find_map(|(depth, layer)| {
            let tone = layer.tone(place, sheet, self.presence)?;
            // Leaves farther back get less light.
            Some(tone * (1.0 - 0.6 * depth as f64 / self.layers.len() as f64))
        })
    }
}

impl Layer {
    fn tone(&self, place: DVec2, sheet: u32, presence: f64) -> Option<f64> {
        let p = self.turn.rotate(place) + self.shift;
        let bits = hash(cell(p.x), cell(p.y), sheet, self.seed);
        if unit(bits) >= presence {
            return None;
        }
        let leaf_seed = hash(bits, 3, 22, self.seed);
        // A direction by the half-angle formula: no sine is needed.
        let t = 2.0 * unit(leaf_seed) - 1.0;
        let side = if bits & 1 == 0 { 1.0 } else { -1.0 };
        let along = DVec2::new(1.0 - t * t, 2.0 * t) * (side / (1.0 + t * t));
        let room = 0.5 * (CELL - 1.0);
        let jitter =
            DVec2::new(unit(hash(leaf_seed, 1, 22, 0)), unit(hash(leaf_seed, 2, 22, 0))) * 2.0 - DVec2::ONE;
        let q = (p - p.floor() - DVec2::splat(0.5)) * CELL - jitter * room;
        // Along the leaf from stem to tip, -1/2 to 1/2, and across it.
        let (x, y) = (q.dot(along), q.perp_dot(along));
        let half_width = HALF_WIDTH * (1.0 - 4.0 * x * x) * (1.0 - TAPER * x);
        if y.abs() >= half_width {
            return None;
        }
        let own_tone = 0.3 + 0.5 * unit(hash(leaf_seed, 4, 22, 0));
        let rib = y.abs() < 0.025 * (0.6 - x);
        let bent = if y > 0.0 { 0.07 } else { -0.07 };
        Some((own_tone + bent + if rib { 0.2 } else { 0.0 }).clamp(0.0, 1.0))
    }
}

/// Where a point lies on the sheet of leaves, metres, and on which sheet. Both sides of a plate have the same holes.
fn sheet(canvas: &Canvas, point: &SurfacePoint) -> (DVec2, u32) {
    let p = point.position;
    match (canvas, point.face) {
        (Canvas::Shape(Shape::Sphere { radius }), Face::Round) => {
            // A cube around it, by equal angles: leaves keep their size, but are cut at twelve edges.
            let axis = p.abs().max_position();
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let angles = DVec2::new((p[u] / p[axis]).atan(), (p[v] / p[axis]).atan());
            (angles * *radius, 2 * axis as u32 + u32::from(p[axis] > 0.0))
        }
        (Canvas::Shape(shape), Face::Flat { axis, positive }) => {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let sheet = if shape.half()[axis] == 0.0 { 0 } else { u32::from(positive) };
            (DVec2::new(p[u], p[v]), 6 + 2 * axis as u32 + sheet)
        }
        (_, face) => (canvas.texture_coordinates(face, p).0, 12),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};

    fn point(position: DVec3, face: Face) -> SurfacePoint {
        SurfacePoint { position, normal: DVec3::Z, face, colour: Vec3::ONE }
    }

    /// Share of the points without a hole, over 200 x 200 leaves or the whole of a ball.
    fn share(leaves: &Leaves, shape: Shape) -> f64 {
        let points = 40_000;
        let open = (0..points).filter(|&index| {
            let (u, v) = (unit(hash(index, 0, 5, 5)), unit(hash(index, 1, 5, 5)));
            let point = match shape {
                Shape::Sphere { radius } => {
                    let (z, turn) = (2.0 * u - 1.0, std::f64::consts::TAU * v);
                    let flat = DVec2::from_angle(turn) * (1.0 - z * z).sqrt();
                    point(flat.extend(z) * radius, Face::Round)
                }
                _ => point(DVec3::new(u, v, 0.0) * 16.0, Face::Flat { axis: 2, positive: true }),
            };
            leaves.is_hole(&Canvas::Shape(shape), &point)
        });
        1.0 - open.count() as f64 / f64::from(points)
    }

    #[test]
    fn leaves_cover_the_share_that_was_asked_for() {
        let plate = Shape::Rectangle { width: 40.0, height: 40.0 };
        for cover in [0.0, 0.01, 0.2, 0.35, 0.5, 0.75, 0.9, 0.97, 0.985, 0.995, 1.0] {
            for seed in 0..3 {
                let leaves = Leaves::new(0.08, cover, seed);
                for shape in [plate, Shape::Sphere { radius: 5.0 }] {
                    let found = share(&leaves, shape);
                    assert!((found - f64::from(cover)).abs() < 0.015, "{found:.3} of {cover}, seed {seed}");
                }
                assert_eq!(leaves.are_open(), cover < 0.99);
            }
        }
    }

    #[test]
    fn a_hole_seen_from_the_front_is_one_from_behind() {
        let leaves = Leaves::new(0.1, 0.6, 3);
        let canvas = Canvas::Shape(Shape::Rectangle { width: 4.0, height: 4.0 });
        let mut holes = 0;
        for index in 0..2000u32 {
            let position = DVec3::new(unit(hash(index, 1, 1, 1)), unit(hash(index, 2, 1, 1)), 0.0);
            let [front, back] = [true, false]
                .map(|positive| leaves.is_hole(&canvas, &point(position, Face::Flat { axis: 2, positive })));
            assert_eq!(front, back);
            holes += usize::from(front);
        }
        assert!((600..1000).contains(&holes), "{holes} of 2000");
    }
}

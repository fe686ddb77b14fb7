//! Shapes other than boxes, as polygons around the origin of their own axes.

use crate::Rgb;
use crate::noise::octaves;
use crate::random::Random;
use crate::stage::v;
use glam::{DQuat, DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Polygons of a mesh to be.
#[derive(Debug, Clone, Default)]
pub(crate) struct Form {
    pub(crate) vertices: Vec<DVec3>,
    pub(crate) faces: Vec<Vec<u32>>,
    pub(crate) colours: Vec<Rgb>,
}

/// A hole in a wall: its lower left corner and its size, metres.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Opening {
    pub(crate) corner: DVec2,
    pub(crate) size: DVec2,
}

impl Opening {
    fn holds(&self, p: DVec2) -> bool {
        let q = p - self.corner;
        q.min_element() > 0.0 && q.x < self.size.x && q.y < self.size.y
    }
}

impl Form {
    fn face(&mut self, corners: &[DVec3]) {
        let first = self.vertices.len() as u32;
        self.vertices.extend_from_slice(corners);
        self.faces.push((first..first + corners.len() as u32).collect());
    }

    fn coloured(&mut self, corners: &[DVec3], colour: Rgb) {
        self.face(corners);
        self.colours.extend(corners.iter().map(|_| colour));
    }

    /// Joins rows of `columns` vertices each into quads; a closed grid joins its last column to its first.
    fn grid(vertices: Vec<DVec3>, columns: usize, closed: bool) -> Self {
        let rows = vertices.len() / columns;
        let last = if closed { columns } else { columns - 1 };
        let cells = (0..rows - 1).flat_map(|row| (0..last).map(move |column| (row, column)));
        let faces = cells
            .map(|(row, column)| {
                let next = (column + 1) % columns;
                let index = |row: usize, column: usize| (row * columns + column) as u32;
                vec![index(row, column), index(row, next), index(row + 1, next), index(row + 1, column)]
            })
            .collect();
        Self { vertices, faces, colours: Vec::new() }
    }

    /// What a lathe makes of a profile of (radius, height), from the outside bottom to the inside bottom.
    pub(crate) fn lathe(profile: &[(f64, f64)], segments: usize) -> Self {
        let ring = |(radius, z): (f64, f64)| {
            (0..segments).map(move |k| {
                let turn = DVec2::from_angle(TAU * k as f64 / segments as f64) * radius;
                turn.extend(z)
            })
        };
        Self::grid(profile.iter().copied().flat_map(ring).collect(), segments, true)
    }

    /// A cushion: a box whose corners and edges are round, standing on z = 0.
    pub(crate) fn cushion(size: DVec3, roundness: f64) -> Self {
        let (rows, columns) = (13u32, 24u32);
        let bent = |x: f64| x.signum() * x.abs().powf(roundness);
        let vertices = (0..rows).flat_map(|row| {
            let up = PI * (f64::from(row) / f64::from(rows - 1) - 0.5);
            (0..columns).map(move |column| {
                let (sine, cosine) = (TAU * f64::from(column) / f64::from(columns)).sin_cos();
                let level = up.cos().max(1e-3).powf(roundness);
                let p = v(level * bent(cosine), level * bent(sine), bent(up.sin()));
                (0.5 * p) * size + v(0.0, 0.0, 0.5 * size.z)
            })
        });
        let mut form = Self::grid(vertices.collect(), columns as usize, true);
        // The round of the first and of the last row is closed by a polygon.
        form.faces.push((0..columns).rev().collect());
        form.faces.push(((rows - 1) * columns..rows * columns).collect());
        form
    }

    /// A cloth that hangs in folds: `size` along x and z, its folds along y, its lower edge on z = 0.
    pub(crate) fn curtain(size: DVec2, folds: f64, deep: f64) -> Self {
        let columns = (folds * 8.0) as usize + 1;
        let vertices = [0.0, 1.0].into_iter().flat_map(|row| {
            (0..columns).map(move |column| {
                let u = column as f64 / (columns - 1) as f64;
                v((u - 0.5) * size.x, 0.5 * deep * (TAU * folds * u).sin(), row * size.y)
            })
        });
        Self::grid(vertices.collect(), columns, false)
    }

    /// Uneven ground over `size`, with `cells` along each side and heights up to ±`bump`; level at the border.
    pub(crate) fn terrain(size: DVec2, cells: usize, bump: f64, wave: f64, seed: u32) -> Self {
        let count = cells + 1;
        let vertices = (0..count * count).map(|index| {
            let share = DVec2::new((index % count) as f64, (index / count) as f64) / cells as f64;
            let p = (share - DVec2::splat(0.5)) * size;
            let edge = (8.0 * share * (DVec2::ONE - share)).min(DVec2::ONE);
            let height = octaves((p / wave).extend(0.5), 4, 1e-3, seed) - 0.5;
            p.extend(2.0 * bump * height * edge.x * edge.y)
        });
        Self::grid(vertices.collect(), count, false)
    }

    /// A roof with its ridge along x: `size` at the eaves and up to the ridge, z = 0 at the eaves, `thick` boards.
    pub(crate) fn roof(size: DVec3, thick: f64) -> Self {
        let mut form = Self::default();
        let (x, y, z) = (0.5 * size.x, 0.5 * size.y, size.z);
        for side in [-1.0, 1.0] {
            let section =
                [v(0.0, side * y, 0.0), v(0.0, 0.0, z), v(0.0, 0.0, z + thick), v(0.0, side * y, thick)];
            for k in 0..4 {
                // The two slopes meet at the ridge: there is no face between them.
                if k == 1 {
                    continue;
                }
                let (a, b) = (section[k], section[(k + 1) % 4]);
                let along = v(side * x, 0.0, 0.0);
                form.face(&[a - along, b - along, b + along, a + along]);
            }
            for end in [-x, x] {
                let mut gable: Vec<DVec3> = section.iter().map(|p| *p + v(end, 0.0, 0.0)).collect();
                if side * end > 0.0 {
                    gable.reverse();
                }
                form.face(&gable);
            }
        }
        form
    }

    /// The triangle of wall under a roof with its ridge along x, in the plane x = 0, facing +x.
    pub(crate) fn gable(width: f64, height: f64) -> Self {
        let mut form = Self::default();
        form.face(&[v(0.0, -0.5 * width, 0.0), v(0.0, 0.5 * width, 0.0), v(0.0, 0.0, height)]);
        form
    }

    /// A wall with openings, `size` along x, y and z, from x = 0 and z = 0 on; its front at y = 0, its back at y > 0.
    pub(crate) fn wall(size: DVec3, openings: &[Opening]) -> Self {
        let mut form = Self::default();
        let cuts = |extent: f64, edges: &dyn Fn(&Opening) -> [f64; 2]| {
            let mut cuts: Vec<f64> = openings.iter().flat_map(edges).chain([0.0, extent]).collect();
            cuts.sort_by(f64::total_cmp);
            cuts.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
            cuts
        };
        let across = cuts(size.x, &|o| [o.corner.x, o.corner.x + o.size.x]);
        let upwards = cuts(size.z, &|o| [o.corner.y, o.corner.y + o.size.y]);
        for x in across.windows(2) {
            for z in upwards.windows(2) {
                let middle = DVec2::new(x[0] + x[1], z[0] + z[1]) * 0.5;
                if openings.iter().any(|opening| opening.holds(middle)) {
                    continue;
                }
                form.face(&[v(x[0], 0.0, z[0]), v(x[1], 0.0, z[0]), v(x[1], 0.0, z[1]), v(x[0], 0.0, z[1])]);
                let y = size.y;
                form.face(&[v(x[1], y, z[0]), v(x[0], y, z[0]), v(x[0], y, z[1]), v(x[1], y, z[1])]);
            }
        }
        let whole = Opening { corner: DVec2::ZERO, size: DVec2::new(size.x, size.z) };
        for (opening, outside) in openings.iter().map(|o| (o, false)).chain([(&whole, true)]) {
            let (a, b) = (opening.corner, opening.corner + opening.size);
            let round = [a, DVec2::new(b.x, a.y), b, DVec2::new(a.x, b.y), a];
            for (index, edge) in round.windows(2).enumerate() {
                // A door reaches the floor: there is nothing below it.
                if !outside && index == 0 && a.y <= 0.0 {
                    continue;
                }
                let [p, q] = [edge[0], edge[1]];
                let mut side = [v(p.x, 0.0, p.y), v(p.x, size.y, p.y), v(q.x, size.y, q.y), v(q.x, 0.0, q.y)];
                if !outside {
                    side.reverse();
                }
                form.face(&side);
            }
        }
        form
    }

    /// Long leaves that arch outwards from the origin, `length` metres, each in its own green.
    pub(crate) fn fronds(random: &mut Random, count: u32, length: f64, breadth: f64, green: Rgb) -> Self {
        let mut form = Self::default();
        for leaf in 0..count {
            let turn = TAU * (f64::from(leaf) * 0.618 + random.within(-0.05, 0.05));
            let out = DVec2::from_angle(turn).extend(0.0);
            let side = v(-out.y, out.x, 0.0);
            let (lean, long) = (random.within(0.25, 1.1), length * random.within(0.6, 1.0));
            let colour = random.near(green, 0.08);
            // Along an arc that begins `lean` from the vertical and bends over.
            let spine: Vec<DVec3> = (0..6)
                .scan(DVec3::ZERO, |point, k| {
                    let here = *point;
                    let bend = lean + f64::from(k) * 0.16;
                    *point += (out * bend.sin() + DVec3::Z * bend.cos()) * (long / 5.0);
                    Some(here)
                })
                .collect();
            let wide = [0.15, 0.75, 1.0, 0.85, 0.5, 0.04].map(|share| 0.5 * share * breadth);
            for k in 0..5 {
                let lift = [wide[k], wide[k + 1]].map(|w| DVec3::Z * (0.5 * w));
                let (a, b) = (spine[k], spine[k + 1]);
                let (a_side, b_side) = (side * wide[k], side * wide[k + 1]);
                form.coloured(&[a, a + a_side + lift[0], b + b_side + lift[1], b], colour);
                form.coloured(&[a, b, b - b_side + lift[1], a - a_side + lift[0]], colour.map(|c| c * 0.86));
            }
        }
        form
    }

    /// Sheets of leaves that fill an ellipsoid around the origin, denser towards its surface.
    pub(crate) fn crown(random: &mut Random, half: DVec3, sheets: u32, sheet: f64) -> Self {
        let mut form = Self::default();
        for _ in 0..sheets {
            let up: f64 = random.within(-1.0, 1.0);
            let level = DVec2::from_angle(random.within(0.0, TAU)) * (1.0 - up * up).sqrt();
            let outward = level.extend(up);
            let place = outward * half * random.within(0.35, 1.0f64).sqrt();
            let tilt = DQuat::from_axis_angle(outward, random.within(0.0, TAU))
                * DQuat::from_rotation_arc(DVec3::Z, outward)
                * DQuat::from_rotation_x(random.within(-0.9, 0.9))
                * DQuat::from_rotation_y(random.within(-0.9, 0.9));
            let edge = 0.5 * sheet * random.within(0.7, 1.2);
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| place + tilt * v(x * edge, y * edge, 0.0));
            form.face(&corners);
        }
        form
    }

    /// Tufts of grass blades or flowers over a rectangle, from z = 0 up.
    pub(crate) fn tufts(random: &mut Random, size: DVec2, count: u32, height: f64, colours: &[Rgb]) -> Self {
        let mut form = Self::default();
        for _ in 0..count {
            let base = v(random.within(-0.5, 0.5) * size.x, random.within(-0.5, 0.5) * size.y, 0.0);
            let colour = random.pick(colours);
            for _ in 0..5 {
                let out = DVec2::from_angle(random.within(0.0, TAU)).extend(0.0);
                let tall = height * random.within(0.5, 1.0);
                let tip = base + out * (tall * random.within(0.15, 0.6)) + DVec3::Z * tall;
                let side = v(-out.y, out.x, 0.0) * (0.07 * height);
                form.coloured(&[base - side, base + side, tip], random.near(colour, 0.06));
            }
        }
        form
    }

    /// A tube through points, with `segments` around it.
    pub(crate) fn tube(points: &[DVec3], radius: f64, segments: usize) -> Self {
        let last = points.len() - 1;
        let rings = points.iter().enumerate().flat_map(|(index, point)| {
            let along = (points[(index + 1).min(last)] - points[index.saturating_sub(1)]).normalize();
            let (a, b) = along.any_orthonormal_pair();
            (0..segments).map(move |k| {
                let (sine, cosine) = (TAU * k as f64 / segments as f64).sin_cos();
                *point + (a * cosine + b * sine) * radius
            })
        });
        Self::grid(rings.collect(), segments, true)
    }
}

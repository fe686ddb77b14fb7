//! Checks over many seeds that generated scenes are physically plausible.

use super::*;
use crate::trace::{PathRay, Traced};
use crate::{Mesh, MeshSource, Primitive, Shape, lens};

mod views;

use glam::{DMat3, DQuat, DVec2, DVec3, EulerRot};
use gs_scene::Camera;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_8;

/// A convex solid or a mesh, by what the tests need of it.
struct Thing {
    name: String,
    centre: DVec3,
    /// Columns are its axes.
    axes: DMat3,
    /// Half extents of the box around it.
    half: DVec3,
    /// The corners of its box along the world's axes.
    low: DVec3,
    high: DVec3,
    faces: Vec<Vec<DVec3>>,
}

fn turned(rotation: DVec3) -> DMat3 {
    let [x, y, z] = rotation.to_array().map(f64::to_radians);
    DMat3::from_quat(DQuat::from_euler(EulerRot::ZYX, z, y, x))
}

/// The six sides of a box, or the one of a rectangle.
fn sides(axes: &DMat3, centre: DVec3, half: DVec3) -> Vec<Vec<DVec3>> {
    let side = |axis: usize, sign: f64| {
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |u: f64, w: f64| {
            let mut p = DVec3::ZERO;
            (p[axis], p[a], p[b]) = (sign * half[axis], u * half[a], w * half[b]);
            centre + *axes * p
        };
        // Counter-clockwise from outside.
        let round = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        if sign > 0.0 { round.to_vec() } else { round.into_iter().rev().collect() }
    };
    (0..3).flat_map(|axis| [side(axis, 1.0), side(axis, -1.0)]).collect()
}

fn solid(primitive: &Primitive) -> Thing {
    let (axes, centre) = (turned(primitive.rotation), primitive.centre);
    let (half, faces) = match primitive.shape {
        Shape::Rectangle { width, height } => {
            let half = 0.5 * DVec3::new(width, height, 0.0);
            (half, sides(&axes, centre, half).into_iter().skip(4).collect())
        }
        Shape::Box { size } => (0.5 * size, sides(&axes, centre, 0.5 * size)),
        Shape::Sphere { radius } => (DVec3::splat(radius), Vec::new()),
        Shape::Cylinder { radius, height } => {
            let cap = |z: f64| {
                let ring = (0..16).map(|k| DVec2::from_angle(f64::from(k) * FRAC_PI_8 * z.signum()) * radius);
                ring.map(|p| centre + axes * p.extend(z)).collect()
            };
            (DVec3::new(radius, radius, 0.5 * height), vec![cap(0.5 * height), cap(-0.5 * height)])
        }
    };
    let reach = reach(&axes, half);
    Thing {
        name: primitive.name.clone(),
        centre,
        axes,
        half,
        low: centre - reach,
        high: centre + reach,
        faces,
    }
}

fn surface(mesh: &Mesh) -> Thing {
    let MeshSource::Inline { vertices, faces, .. } = &mesh.source else {
        panic!("generated meshes are inline")
    };
    let axes = turned(mesh.rotation);
    let low = vertices.iter().copied().reduce(DVec3::min).unwrap();
    let high = vertices.iter().copied().reduce(DVec3::max).unwrap();
    let world = |index: &u32| mesh.centre + axes * vertices[*index as usize];
    // Only walls and roofs have faces that could share a plane with others.
    let flat = ["wall", "front", "roof", "gable"].iter().any(|part| mesh.name.contains(part));
    let faces = faces.iter().filter(|_| flat).map(|face| face.iter().map(world).collect()).collect();
    let middle = mesh.centre + axes * (0.5 * (low + high));
    let half = 0.5 * (high - low);
    let placed = || vertices.iter().map(|p| mesh.centre + axes * *p);
    let (low, high) = (placed().reduce(DVec3::min).unwrap(), placed().reduce(DVec3::max).unwrap());
    Thing { name: mesh.name.clone(), centre: middle, axes, half, low, high, faces }
}

fn things(scene: &Scene) -> Vec<Thing> {
    scene.primitives.iter().map(solid).chain(scene.meshes.iter().map(surface)).collect()
}

/// Half the extents of a box along the world's axes.
fn reach(axes: &DMat3, half: DVec3) -> DVec3 {
    axes.x_axis.abs() * half.x + axes.y_axis.abs() * half.y + axes.z_axis.abs() * half.z
}

impl Thing {
    /// Whether the boxes around two things are nearer than `gap` (separating axes; a rectangle has one of no extent).
    fn touches(&self, other: &Self, gap: f64) -> bool {
        let apart = other.centre - self.centre;
        if (self.low - other.high).max(other.low - self.high).max_element() > gap {
            return false;
        }
        let axes = [self.axes.x_axis, self.axes.y_axis, self.axes.z_axis];
        let others = [other.axes.x_axis, other.axes.y_axis, other.axes.z_axis];
        let edges = axes.iter().flat_map(|a| others.iter().map(|b| a.cross(*b)));
        axes.iter().copied().chain(others).chain(edges).filter(|axis| axis.length() > 1e-6).all(|axis| {
            let axis = axis.normalize();
            let extent = |thing: &Self| (thing.axes.transpose() * axis).abs().dot(thing.half);
            axis.dot(apart).abs() <= extent(self) + extent(other) + gap
        })
    }
}

/// Seeds per kind; more by the variable SCENES.
fn seeds(usual: u64) -> u64 {
    std::env::var("SCENES").ok().map_or(usual, |number| number.parse().expect("SCENES is a number"))
}

/// Checks scenes of all kinds in parallel and lists what is wrong with which.
fn over(count: u64, check: impl Fn(Kind, u64) -> Vec<String> + Sync) {
    let all: Vec<(Kind, u64)> =
        Kind::ALL.iter().flat_map(|kind| (0..count).map(|seed| (*kind, seed))).collect();
    let faults = |&(kind, seed): &(Kind, u64)| -> Vec<String> {
        check(kind, seed).into_iter().map(|fault| format!("{kind:?} {seed}: {fault}")).collect()
    };
    let wrong: Vec<String> = all.par_iter().flat_map(faults).collect();
    // Of each sort of fault the first, and how many there are.
    let mut sorts: BTreeMap<&str, (usize, &str)> = BTreeMap::new();
    for fault in &wrong {
        let (_, sort) = fault.split_once(": ").unwrap();
        sorts.entry(sort.split(" at ").next().unwrap()).or_insert((0, fault)).0 += 1;
    }
    let list: Vec<String> = sorts.values().map(|(count, first)| format!("{count} x {first}")).collect();
    assert!(wrong.is_empty(), "{} faults: {list:#?}", wrong.len());
}

/// All numbers are valid, nothing is dropped, and the scene is of a moderate size.
fn unsound(scene: &Scene) -> Vec<String> {
    let mut faults = Vec::new();
    if !(120..4000).contains(&scene.primitives.len()) {
        faults.push(format!("{} primitives", scene.primitives.len()));
    }
    let corners = scene.meshes.iter().map(|mesh| match &mesh.source {
        MeshSource::Inline { faces, .. } => faces.iter().map(|face| face.len() - 2).sum(),
        MeshSource::File(_) => 0,
    });
    let triangles: usize = corners.sum();
    if triangles > 200_000 {
        faults.push(format!("{triangles} triangles"));
    }
    match Traced::new(scene) {
        Ok(traced) if !traced.dropped().is_empty() => faults.push(format!("dropped {:?}", traced.dropped())),
        Ok(_) => {}
        Err(error) => faults.push(error.to_string()),
    }
    faults
}

/// What is not held by something that stands on the ground.
fn floating(things: &[Thing]) -> Vec<String> {
    let ground = ["floor", "lawn", "street", "outside ground"];
    let mut held: Vec<bool> = things.iter().map(|thing| ground.contains(&thing.name.as_str())).collect();
    let mut open: Vec<usize> = (0..things.len()).filter(|index| held[*index]).collect();
    while let Some(index) = open.pop() {
        for other in 0..things.len() {
            if !held[other] && things[index].touches(&things[other], 0.002) {
                held[other] = true;
                open.push(other);
            }
        }
    }
    let loose = (0..things.len()).filter(|index| !held[*index]);
    loose.map(|index| format!("{} floats at {}", things[index].name, things[index].centre)).collect()
}

/// The area that two convex polygons in one plane share, in the axes u and w of that plane, and its middle there.
fn shared(a: &[DVec3], b: &[DVec3], u: DVec3, w: DVec3) -> (f64, DVec2) {
    let flat = |polygon: &[DVec3]| -> Vec<DVec2> {
        let mut points: Vec<DVec2> = polygon.iter().map(|p| DVec2::new(p.dot(u), p.dot(w))).collect();
        if area(&points) < 0.0 {
            points.reverse();
        }
        points
    };
    fn area(points: &[DVec2]) -> f64 {
        (0..points.len()).map(|k| 0.5 * points[k].perp_dot(points[(k + 1) % points.len()])).sum()
    }
    let (mut left, knife) = (flat(a), flat(b));
    for k in 0..knife.len() {
        let (from, to) = (knife[k], knife[(k + 1) % knife.len()]);
        let side = |p: DVec2| (to - from).perp_dot(p - from);
        let mut kept = Vec::new();
        for i in 0..left.len() {
            let (p, q) = (left[i], left[(i + 1) % left.len()]);
            let (sp, sq) = (side(p), side(q));
            if sp >= 0.0 {
                kept.push(p);
            }
            if sp * sq < 0.0 {
                kept.push(p + (q - p) * (sp / (sp - sq)));
            }
        }
        left = kept;
    }
    let middle = left.iter().sum::<DVec2>() / left.len().max(1) as f64;
    (area(&left), middle)
}

/// Faces of two things that look the same way, share a part of a plane, and are not covered there by a third that they
/// stand on or lean on: which of the two is seen would be chance.
fn coplanar(things: &[Thing]) -> Vec<String> {
    // Faces by plane, rounded to more than what rounding does; a plane next to a boundary is looked up twice.
    let key = |normal: DVec3, offset: f64, shift: f64| {
        let [x, y, z] = normal.to_array().map(|c| (c * 1e5).round() as i64);
        [x, y, z, (offset / 2e-6 + shift).floor() as i64]
    };
    let keys = |normal, offset| BTreeSet::from([key(normal, offset, -0.5), key(normal, offset, 0.5)]);
    let mut planes: BTreeMap<[i64; 4], Vec<(usize, &[DVec3])>> = BTreeMap::new();
    let plane = |face: &[DVec3]| {
        let normal = (face[1] - face[0]).cross(face[2] - face[1]).normalize();
        (normal, normal.dot(face[0]))
    };
    for (index, thing) in things.iter().enumerate() {
        for face in &thing.faces {
            let (normal, offset) = plane(face);
            planes.entry(key(normal, offset, 0.0)).or_default().push((index, face));
        }
    }
    let on = |normal: DVec3, offset: f64| {
        let near = keys(normal, offset).into_iter().filter_map(|key| planes.get(&key)).flatten();
        near.filter(move |(_, face)| (normal.dot(face[0]) - offset).abs() < 1e-6)
    };
    let mut faults = Vec::new();
    for (index, thing) in things.iter().enumerate() {
        for face in &thing.faces {
            let (normal, offset) = plane(face);
            let (u, w) = normal.any_orthonormal_pair();
            for (other, polygon) in on(normal, offset).filter(|(other, _)| *other < index) {
                let (area, middle) = shared(face, polygon, u, w);
                if area < 1e-7 {
                    continue;
                }
                let place = u * middle.x + w * middle.y + normal * offset;
                let dot = [-1e-5, 1e-5].map(|d| place + u * d);
                let spot = [dot[0] - w * 1e-5, dot[1] - w * 1e-5, dot[1] + w * 1e-5, dot[0] + w * 1e-5];
                let covered = on(-normal, -offset).any(|(_, cover)| shared(&spot, cover, u, w).0 > 0.0);
                if !covered {
                    faults
                        .push(format!("{} and {} share a plane at {place}", thing.name, things[*other].name));
                }
            }
        }
    }
    faults
}

/// What is in a room and reaches into its walls.
fn poking(things: &[Thing]) -> Vec<String> {
    let shell =
        |name: &str| name.ends_with("wall") && name != "garden wall" || ["floor", "ceiling"].contains(&name);
    let find = |name: &str| things.iter().find(|thing| thing.name == name).unwrap();
    let (left, right) = (find("left wall"), find("right wall"));
    let (back, front) = (find("back wall"), find("front wall"));
    let low = DVec3::new(left.high.x, front.high.y, 0.0);
    let high = DVec3::new(right.low.x, back.low.y, find("ceiling").low.z);
    let outside = ["outside", "window frame", "window bar"];
    let inside =
        things.iter().filter(|t| !shell(&t.name) && !outside.iter().any(|name| t.name.starts_with(name)));
    let poking = inside.filter(|thing| (low - thing.low).max(thing.high - high).max_element() > 0.002);
    poking.map(|thing| format!("{} pokes through a wall at {}", thing.name, thing.centre)).collect()
}

#[test]
fn scenes_are_ones_that_could_stand_there() {
    over(seeds(12), |kind, seed| {
        let (scene, ..) = build(kind, seed, 0);
        let things = things(&scene);
        let mut faults = [unsound(&scene), floating(&things), coplanar(&things)].concat();
        if !matches!(kind, Kind::Facade | Kind::Garden | Kind::Wood) {
            faults.extend(poking(&things));
        }
        faults
    });
}

/// The cameras of a scene with a small picture.
fn cameras(scene: &Scene, width: usize, height: usize) -> Vec<Camera> {
    let photographs = scene.photographs.as_ref().unwrap();
    assert!((10..=12).contains(&photographs.count) && (50.0..=75.0).contains(&photographs.field_of_view));
    photographs.path.cameras(lens(width, height, photographs.field_of_view), photographs.count).unwrap()
}

/// Things nearer to a camera than 30 cm.
fn too_near(scene: &Scene) -> Vec<String> {
    let traced = Traced::new(scene).unwrap();
    let mut faults = Vec::new();
    for camera in cameras(scene, 8, 6) {
        let origin = traced.relative(camera.position());
        for k in 0..200 {
            // A spiral of directions all around.
            let up = 1.0 - (2.0 * f64::from(k) + 1.0) / 200.0;
            let level = DVec2::from_angle(f64::from(k) * 2.39996) * (1.0 - up * up).sqrt();
            let hit = traced.nearest(&PathRay { origin, direction: level.extend(up) });
            if let Some(hit) = hit.filter(|hit| hit.t < 0.3) {
                faults.push(format!("something {} m from {}", hit.t, camera.position()));
            }
        }
    }
    faults
}

#[test]
fn no_thing_is_nearer_to_a_camera_than_thirty_centimetres() {
    over(seeds(4), |kind, seed| too_near(&generate(kind, seed)));
}

#[test]
fn in_the_wild_the_scene_is_the_same_and_its_pictures_are_not() {
    let effects = |kind, seed| {
        let (tame, wild) = (generate(kind, seed), generate_in_the_wild(kind, seed));
        assert_eq!(wild, generate_in_the_wild(kind, seed));
        assert_eq!((&tame.primitives, &tame.meshes, tame.sun), (&wild.primitives, &wild.meshes, wild.sun));
        let (steady, photographs) = (tame.photographs.unwrap(), wild.photographs.clone().unwrap());
        let from_the_air = photographs.path != steady.path;
        if from_the_air {
            assert_eq!(kind, Kind::Garden);
            assert_eq!(too_near(&wild), Vec::<String>::new());
            assert!(cameras(&wild, 8, 6).iter().all(|camera| camera.position().z > 7.0));
        }
        if let Some(noise) = photographs.noise {
            assert!((500.0..=10_000.0).contains(&noise.full_well), "{noise:?}");
        }
        [
            photographs.exposure.is_some(),
            photographs.noise.is_some(),
            photographs.motion_blur.is_some(),
            photographs.pose_error.is_some(),
            from_the_air,
        ]
    };
    let found: Vec<[bool; 5]> = (0..24).into_par_iter().map(|seed| effects(Kind::Garden, seed)).collect();
    for (effect, usual) in [0.5, 0.6, 0.2, 0.4, 0.5].into_iter().enumerate() {
        let share = found.iter().filter(|effects| effects[effect]).count() as f64 / found.len() as f64;
        assert!((share - usual).abs() < 0.25 && share > 0.0, "effect {effect}: {share}, expected {usual}");
    }
    assert!(!effects(Kind::Desk, 3)[4]);
}

#[test]
fn in_the_wild_all_kinds_come_up_and_woods_nowhere_else() {
    let share = |sampler: fn(u64) -> Kind, kind| {
        (0..1000).filter(|&seed| sampler(seed) == kind).count() as f64 / 1000.0
    };
    for (kind, wild) in Kind::ALL.into_iter().zip([0.1, 0.1, 0.1, 0.2, 0.2, 0.3]) {
        assert!((share(Kind::of_seed_in_the_wild, kind) - wild).abs() < 0.05, "{kind:?}");
        let tame = if kind == Kind::Wood { 0.0 } else { 0.2 };
        assert!((share(Kind::of_seed, kind) - tame).abs() < 0.05, "{kind:?}");
    }
}

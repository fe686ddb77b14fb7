//! Triangles: against an oracle, without gaps, far from the origin.

use super::*;
use crate::{Finish, Material, Mesh, MeshSource, Pattern, Scene, Sky};
use proptest::prelude::*;

fn material() -> Material {
    Material { pattern: Pattern::Plain { colour: [0.5; 3] }, mottle: 0.0, seed: 0, finish: Finish::Matte }
}

pub(super) fn scene(vertices: Vec<DVec3>, faces: Vec<Vec<u32>>, centre: DVec3, rotation: DVec3) -> Scene {
    let source = MeshSource::Inline { vertices, faces, colours: Vec::new() };
    let mesh = Mesh { name: "mesh".into(), source, centre, rotation, scale: 1.0, material: material() };
    let sky = Sky { zenith: [0.5; 3], horizon: [0.5; 3], ground: [0.5; 3], light: 1.0, occlusion: None };
    Scene { meshes: vec![mesh], ..Scene::under(sky) }
}

/// An octahedron whose faces are cut into `cuts`² triangles, each vertex at `radius` of its direction.
pub(super) fn star(cuts: u32, radius: impl Fn(DVec3) -> f64) -> (Vec<DVec3>, Vec<Vec<u32>>) {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    let mut numbers = std::collections::HashMap::new();
    for signs in 0..8 {
        let sign = [0, 1, 2].map(|k| if signs >> k & 1 == 0 { 1.0 } else { -1.0 });
        let mut corner = |i: u32, j: u32| {
            let p = [f64::from(i) * sign[0], f64::from(j) * sign[1], f64::from(cuts - i - j) * sign[2]];
            // The planes of the axes belong to two octants, with either sign of zero.
            let p = DVec3::from(p) + DVec3::ZERO;
            *numbers.entry(p.to_array().map(f64::to_bits)).or_insert_with(|| {
                let direction = p.normalize();
                vertices.push(direction * radius(direction));
                vertices.len() as u32 - 1
            })
        };
        let mirrored = sign[0] * sign[1] * sign[2] < 0.0;
        let mut push = |mut face: Vec<u32>| {
            if mirrored {
                face.reverse();
            }
            faces.push(face);
        };
        for i in 0..cuts {
            for j in 0..cuts - i {
                push(vec![corner(i, j), corner(i + 1, j), corner(i, j + 1)]);
                if i + j + 2 <= cuts {
                    push(vec![corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)]);
                }
            }
        }
    }
    (vertices, faces)
}

/// Where a ray crosses a triangle, as the solution of three linear equations (Cramer), with the weights.
fn solve(o: DVec3, d: DVec3, [a, b, c]: [DVec3; 3]) -> Option<(f64, [f64; 3])> {
    let (e, f, s) = (b - a, c - a, o - a);
    let determinant = e.dot(d.cross(f));
    if determinant.abs() < 1e-6 {
        return None;
    }
    let (v, w) = (s.dot(d.cross(f)) / determinant, d.dot(s.cross(e)) / determinant);
    Some((f.dot(s.cross(e)) / determinant, [1.0 - v - w, v, w]))
}

fn vector(range: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-range..range).prop_map(DVec3::from)
}

proptest! {
    #[test]
    fn a_crossing_is_the_solution_of_the_linear_equations(
        corners in prop::array::uniform3(vector(2.0)), origin in vector(3.0), direction in vector(1.0),
    ) {
        let Some((t, weights)) = solve(origin, direction, corners) else { return Ok(()) };
        let least = weights.into_iter().fold(f64::INFINITY, f64::min);
        let found = Aim::new(&PathRay { origin, direction }).crossing([&corners[0], &corners[1], &corners[2]]);
        if let Some(crossing) = found {
            prop_assert!(least > -1e-7, "{least}");
            prop_assert!((crossing.t - t).abs() < 1e-6 * (1.0 + t.abs()));
            prop_assert!(crossing.weights.iter().zip(weights).all(|(a, b)| (a - b).abs() < 1e-6));
        } else {
            prop_assert!(least < 1e-7, "{least}");
        }
    }

    #[test]
    fn rays_from_inside_a_closed_mesh_never_slip_through_edges_and_corners(
        cuts in 1..6u32,
        bumps in prop::array::uniform3(1.0..7.0f64),
        centre in prop_oneof![Just(DVec3::ZERO), Just(DVec3::new(1e4, -1e4, 3e3))],
        rotation in prop_oneof![Just(DVec3::ZERO), vector(180.0)],
        start in prop_oneof![Just(DVec3::ZERO), vector(0.05)],
        shares in prop::collection::vec(0.0..1.0f64, 4),
    ) {
        let radius = |d: DVec3| 1.0 + 0.4 * (bumps[0] * d.x).sin() * (bumps[1] * d.y + bumps[2] * d.z).cos();
        let (vertices, faces) = star(cuts, radius);
        let traced = Traced::new(&scene(vertices, faces, centre, rotation)).unwrap();
        prop_assert!(traced.dropped().is_empty());
        let origin = start - traced.centre + centre;
        for slot in &traced.slots {
            let corners = slot.corners.map(|index| traced.vertices[index as usize]);
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                for aim in [a, 0.5 * (a + b)].into_iter().chain(shares.iter().map(|s| a.lerp(b, *s))) {
                    let ray = PathRay { origin, direction: aim - origin };
                    let hit = traced.nearest(&ray).expect("the mesh is closed");
                    prop_assert!((hit.t - 1.0).abs() < 1e-9, "{}", hit.t);
                    prop_assert!(traced.is_blocked(&ray, f64::INFINITY));
                    prop_assert!(!traced.is_blocked(&ray, 1.0 - 1e-9));
                }
            }
        }
    }

    /// From outside, every crossing on the way in has one on the way out: an odd number from inside, at any point.
    #[test]
    fn a_ray_that_enters_leaves(
        cuts in 1..5u32,
        bumps in prop::array::uniform3(1.0..7.0f64),
        places in prop::collection::vec((vector(3.0), vector(0.7)), 40),
    ) {
        let radius = |d: DVec3| 1.0 + 0.4 * (bumps[0] * d.x).sin() * (bumps[1] * d.y + bumps[2] * d.z).cos();
        let (vertices, faces) = star(cuts, radius);
        let traced = Traced::new(&scene(vertices, faces, DVec3::ZERO, DVec3::ZERO)).unwrap();
        for (from, to) in places {
            let ray = PathRay { origin: from - traced.centre, direction: to - from };
            let aim = Aim::new(&ray);
            let crossed = traced.slots.iter().filter(|slot| {
                let corners = slot.corners.map(|index| traced.vertices[index as usize]);
                aim.crossing([&corners[0], &corners[1], &corners[2]]).is_some()
            });
            prop_assert_eq!(crossed.count() % 2, 0);
        }
    }
}

#[test]
fn light_from_low_does_not_make_a_mesh_shadow_itself() {
    // A floor cut into triangles of all sizes, level and tilted, and a convex ball.
    let grid = |k: u32| f64::from(k) + 0.37 * f64::from(k * k % 7);
    let floor: Vec<DVec3> = (0..400).map(|k| DVec3::new(grid(k % 20), grid(k / 20), 0.0)).collect();
    let cell = |k: u32| vec![k, k + 1, k + 21, k + 20];
    let cells: Vec<Vec<u32>> = (0..380).filter(|k| k % 20 != 19).map(cell).collect();
    let (ball, sides) = star(12, |_| 3.0);
    for centre in [DVec3::ZERO, DVec3::new(1e4, -1e4, 1e4)] {
        for rotation in [DVec3::ZERO, DVec3::new(13.0, -41.0, 77.0)] {
            for (vertices, faces) in [(&floor, &cells), (&ball, &sides)] {
                let scene = scene(vertices.clone(), faces.clone(), centre, rotation);
                let traced = Traced::new(&scene).unwrap();
                let to_world = traced.meshes[0].to_local().transpose();
                let mut lit = 0;
                for (i, slot) in traced.slots.iter().enumerate() {
                    let corners = slot.corners.map(|index| traced.vertices[index as usize]);
                    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
                    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
                    for place in
                        [middle, middle.lerp(corners[i % 3], 0.999_999), middle.lerp(corners[1], 0.5)]
                    {
                        let eye = PathRay { origin: place + 5.0 * normal, direction: -normal };
                        let Met::Surface(surface) = traced.met(&eye, traced.nearest(&eye).unwrap()) else {
                            panic!("no lamp here");
                        };
                        for k in 0..12 {
                            let (sine, cosine) = f64::from(k).sin_cos();
                            let along = to_world * DVec3::new(cosine, sine, 0.0);
                            let along = (along - normal * along.dot(normal)).normalize();
                            for rise in [1e-9, 1e-6, 1e-3, 0.1] {
                                let sun = along + normal * rise;
                                let ray = PathRay { origin: surface.departure(sun), direction: sun };
                                assert!(!traced.is_blocked(&ray, f64::INFINITY), "{place} {sun} at {centre}");
                                lit += 1;
                            }
                        }
                    }
                }
                assert!(lit > 10_000);
            }
        }
    }
}

#[test]
fn no_light_leaks_into_a_closed_box() {
    let corner = |k: u32| DVec3::from([0, 1, 2].map(|axis| if k >> axis & 1 == 0 { -1.0 } else { 1.0 }));
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    for centre in [DVec3::ZERO, DVec3::new(1e4, -1e4, 1e4)] {
        let faces = sides.iter().map(|side| side.to_vec()).collect();
        let scene = scene((0..8).map(corner).collect(), faces, centre, DVec3::new(20.0, 30.0, 40.0));
        let traced = Traced::new(&scene).unwrap();
        let to_world = traced.meshes[0].to_local().transpose();
        // Points of the inside as close to the edges and corners as a camera ray can hit them.
        for k in 0..8 {
            for axis in 0..3 {
                for share in [0.0, 1e-15, 1e-12, 1e-6, 0.3, 1.0] {
                    let mut aim = corner(k);
                    aim[axis] *= 1.0 - share;
                    let eye =
                        PathRay { origin: to_world * DVec3::splat(0.1), direction: to_world * (aim - 0.1) };
                    let hit = traced.nearest(&eye).expect("the box is closed");
                    let Met::Surface(surface) = traced.met(&eye, hit) else { panic!("no lamp here") };
                    for i in 0..60 {
                        let sun =
                            DVec3::new(f64::from(i).sin(), f64::from(2 * i).cos(), f64::from(3 * i).sin());
                        if surface.normal.dot(sun) > 0.0 {
                            let ray = PathRay { origin: surface.departure(sun), direction: sun };
                            assert!(traced.is_blocked(&ray, f64::INFINITY), "{aim} {sun} at {centre}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn triangles_without_extent_are_dropped_and_counted() {
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X];
    let faces = vec![vec![0, 1, 2], vec![0, 1, 3], vec![1, 1, 2], vec![0, 1, 3, 2]];
    let traced = Traced::new(&scene(vertices, faces, DVec3::ZERO, DVec3::ZERO)).unwrap();
    let dropped: Vec<String> = traced.dropped().iter().map(ToString::to_string).collect();
    assert_eq!(dropped, ["mesh 0 (mesh): 3 triangles have two corners in one place"]);
    assert_eq!(traced.slots.len(), 2);
    let empty = Traced::new(&scene(vec![DVec3::ZERO], Vec::new(), DVec3::ZERO, DVec3::ZERO)).unwrap();
    assert_eq!(empty.dropped()[0].to_string(), "mesh 0 (mesh) has no triangles and is not seen");
}

//! Tests of a mesh's inputs to shading: colours, texture coordinates, holes.

use super::mesh_tests::{scene, star};
use super::*;
use crate::{MeshSource, Pattern};

#[test]
fn leaves_of_a_mesh_let_rays_through_their_holes() {
    let (vertices, faces) = star(6, |_| 1.0);
    let mut foliage = scene(vertices, faces, DVec3::ZERO, DVec3::ZERO);
    let (dark, light) = ([0.1; 3], [0.2; 3]);
    foliage.meshes[0].material.pattern = Pattern::Foliage { dark, light, leaf: 0.1, cover: 0.5 };
    let traced = Traced::new(&foliage).unwrap();
    let mut met = 0;
    for k in 0..2000 {
        let k = f64::from(k);
        let direction = DVec3::new((2.4 * k).cos(), (2.4 * k).sin(), (0.7 * k).sin());
        let ray = PathRay { origin: DVec3::splat(0.01), direction };
        let hit = traced.nearest(&ray);
        assert_eq!(traced.is_blocked(&ray, f64::INFINITY), hit.is_some());
        if let Some(hit) = hit {
            let Met::Surface(surface) = traced.met(&ray, hit) else { panic!("no lamp here") };
            assert!(!surface.texture.is_hole(&surface.canvas, &surface.point));
            met += 1;
        }
    }
    assert!((600..1400).contains(&met), "half of the rays meet leaves: {met} of 2000");
}

#[test]
fn colours_and_coordinates_are_linear_between_the_vertices() {
    let vertices = vec![DVec3::new(-1.0, 2.0, 0.0), DVec3::new(3.0, 2.0, 0.5), DVec3::new(-1.0, 4.0, 3.0)];
    let mut plate = scene(vertices.clone(), vec![vec![0, 1, 2]], DVec3::X, DVec3::new(0.0, 0.0, 90.0));
    plate.meshes[0].scale = 2.0;
    let MeshSource::Inline { colours, .. } = &mut plate.meshes[0].source else { panic!("made inline") };
    *colours = vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let traced = Traced::new(&plate).unwrap();
    // Turned by 90 degrees about z: x becomes y, y becomes -x.
    let world = |v: DVec3| DVec3::new(1.0 - 2.0 * v.y, 2.0 * v.x, 2.0 * v.z);
    for shares in [[0.2, 0.3, 0.5], [0.9, 0.05, 0.05], [0.4, 0.6, 0.0]] {
        let point = vertices.iter().zip(shares).map(|(v, s)| *v * s).sum::<DVec3>();
        let ray = PathRay { origin: traced.relative(world(point) + DVec3::Z * 5.0), direction: -DVec3::Z };
        let hit = traced.nearest(&ray).expect("the ray aims at the triangle");
        assert!((hit.t - 5.0).abs() < 1e-9);
        let Met::Surface(surface) = traced.met(&ray, hit) else { panic!("no lamp here") };
        let colour = surface.point.colour.to_array();
        assert!(colour.iter().zip(shares).all(|(c, s)| (f64::from(*c) - s).abs() < 1e-6), "{colour:?}");
        assert!((surface.point.position - 2.0 * point).length() < 1e-9, "in the mesh's axes, metres");
        // The triangle looks along -y most, as the side of a box that is seen from there: x to the right, z up.
        let (uv, extent) = surface.canvas.texture_coordinates(surface.point.face, surface.point.position);
        assert!((uv - glam::DVec2::new(2.0 * (point.x + 1.0), 2.0 * point.z)).length() < 1e-9, "{uv}");
        assert!((extent - glam::DVec2::new(8.0, 6.0)).length() < 1e-9);
    }
}

#[test]
fn texture_coordinates_of_a_file_are_those_of_the_corners() {
    let folder = tempfile::tempdir().unwrap();
    let text = "v 0 0 0\nv 2 0 0\nv 2 2 1\nvt 3 1\nvt 5 1.5\nvt 4 2\nf 1/1 2/2 3/3\n";
    std::fs::write(folder.path().join("a.obj"), text).unwrap();
    let mut plate = scene(Vec::new(), Vec::new(), DVec3::ZERO, DVec3::ZERO);
    plate.meshes[0].source = MeshSource::File("a.obj".into());
    let traced = Traced::load(&plate, folder.path()).unwrap();
    let ray = PathRay { origin: traced.relative(DVec3::new(1.5, 0.5, 9.0)), direction: -DVec3::Z };
    let Met::Surface(surface) = traced.met(&ray, traced.nearest(&ray).unwrap()) else {
        panic!("no lamp here")
    };
    let corners = [
        (DVec3::ZERO, [0.0, 0.0]),
        (DVec3::new(2.0, 0.0, 0.0), [2.0, 0.5]),
        (DVec3::new(2.0, 2.0, 1.0), [1.0, 1.0]),
    ];
    for (corner, expected) in corners {
        let (uv, extent) = surface.canvas.texture_coordinates(surface.point.face, corner);
        assert!((uv - glam::DVec2::from(expected)).length() < 1e-9, "{uv} at {corner}");
        assert_eq!(extent.to_array(), [2.0, 1.0]);
    }
}

#[test]
fn a_triangle_takes_less_than_forty_five_bytes() {
    let (vertices, faces) = star(50, |d| 1.0 + 0.1 * (9.0 * d.x).sin());
    let traced = Traced::new(&scene(vertices, faces, DVec3::ZERO, DVec3::ZERO)).unwrap();
    let triangles = traced.slots.len();
    let nodes = traced.hierarchy.as_ref().map_or(0, |hierarchy| hierarchy.nodes.len());
    let bytes = triangles * size_of::<Slot>() + traced.vertices.len() * size_of::<DVec3>() + nodes * 80;
    let each = bytes as f64 / triangles as f64;
    assert!(triangles == 20_000 && (28.0..45.0).contains(&each), "{each} bytes");
}

//! Compares the hierarchy with testing every body.

use super::*;
use crate::{Finish, Material, Pattern, Primitive, Scene, Shape, Sky};
use proptest::prelude::*;

/// Shapes in cells of a grid, so that many touch and share planes, some far smaller than others.
fn shapes(scale: f64, offset: DVec3) -> impl Strategy<Value = Scene> {
    let size = prop_oneof![Just(1.0), Just(2.0), Just(4.0), Just(1e-5), Just(0.0)];
    let shape = (prop::array::uniform3(size), 0..4u8).prop_map(move |(size, kind)| {
        let [x, y, z] = size.map(|v| v * scale);
        match kind {
            0 => Shape::Sphere { radius: x },
            1 => Shape::Cylinder { radius: x, height: y },
            2 => Shape::Rectangle { width: x, height: y },
            _ => Shape::Box { size: DVec3::new(x, y, z) },
        }
    });
    let turn = prop::array::uniform3(prop_oneof![Just(0.0), Just(90.0), -180.0..180.0f64]);
    let cell = prop::array::uniform3(-2..3i32);
    let primitive = (shape, turn, cell).prop_map(move |(shape, turn, cell)| Primitive {
        name: String::new(),
        shape,
        centre: offset + DVec3::from(cell.map(f64::from)) * scale,
        rotation: turn.into(),
        material: Material {
            pattern: Pattern::Plain { colour: [0.5; 3] },
            mottle: 0.0,
            seed: 0,
            finish: Finish::Matte,
        },
    });
    let sky = Sky { zenith: [0.5; 3], horizon: [0.5; 3], ground: [0.5; 3], light: 1.0, occlusion: None };
    prop::collection::vec(primitive, 0..30)
        .prop_map(move |primitives| Scene { primitives, ..Scene::under(sky) })
}

fn brute_force(scene: &Traced, ray: &PathRay) -> Option<f64> {
    (0..scene.slots.len())
        .filter_map(|slot| scene.first_hit(slot, ray, &Aim::new(ray), f64::INFINITY))
        .reduce(f64::min)
}

/// Rays from and to places on, beside and far from the grid, and along its axes (with both signs of zero).
fn check(scene: &Scene, scale: f64, offset: DVec3, places: &[[f64; 3]], directions: &[[f64; 3]]) {
    let traced = Traced::new(scene).unwrap();
    let places: Vec<DVec3> = places.iter().map(|p| DVec3::from(*p) * scale).collect();
    for &start in &places {
        let aimed = places.iter().map(|place| *place - start);
        for direction in directions.iter().map(|d| DVec3::from(*d)).chain(aimed) {
            if direction.length() < 1e-9 {
                continue;
            }
            let ray = PathRay { origin: traced.relative(start + offset), direction };
            let expected = brute_force(&traced, &ray);
            assert_eq!(traced.nearest(&ray).map(|hit| hit.t), expected, "{ray:?}");
            assert_eq!(traced.is_blocked(&ray, f64::INFINITY), expected.is_some(), "{ray:?}");
        }
    }
}

fn coordinate() -> impl Strategy<Value = f64> {
    let half_cells = (-6..7i32).prop_map(|k| f64::from(k) * 0.5);
    let beside = (half_cells.clone(), -6..0i32).prop_map(|(x, e)| x + 10f64.powi(e));
    prop_oneof![half_cells, beside, -4.0..4.0f64, Just(1e3)]
}

fn component() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-1.0), Just(1e-7), Just(-1e-8), -1.0..1.0f64]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]
    #[test]
    fn the_hierarchy_finds_what_testing_every_shape_finds(
        ((scene, offset), scale) in prop_oneof![Just(1.0), Just(1e-4), Just(1e5)].prop_flat_map(|scale| {
            let offset = prop_oneof![Just(DVec3::ZERO), Just(DVec3::new(1e4, -1e4, 3e3))];
            let scene = offset.prop_flat_map(move |offset| (shapes(scale, offset), Just(offset)));
            (scene, Just(scale))
        }),
        places in prop::collection::vec(prop::array::uniform3(coordinate()), 12),
        directions in prop::collection::vec(prop::array::uniform3(component()), 6),
    ) {
        check(&scene, scale, offset, &places, &directions);
    }
}

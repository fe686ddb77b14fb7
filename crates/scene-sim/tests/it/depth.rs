use super::{GREY, SUN, body, camera, depth, scene, view};
use glam::{DVec2, DVec3};
use gs_scene::Camera;
use scene_sim::{Pattern, Primitive, Shape, Traced, render_counted};

/// Compares every pixel's depth with that of the nearest positive `t` that `expected` gives for a world ray
/// whose parameter is the z-depth.
fn check(primitive: Primitive, camera: &Camera, expected: impl Fn(DVec3, DVec3) -> Option<f64>) {
    let found = view(&scene(vec![primitive], None), camera);
    let mut hits = 0;
    for (i, &depth) in depth(&found).data().iter().enumerate() {
        let pixel = DVec2::new((i % camera.width()) as f64 + 0.5, (i / camera.width()) as f64 + 0.5);
        let direction = camera.to_world(camera.intrinsics().ray(pixel)) - camera.position();
        let expected = expected(camera.position(), direction).unwrap_or(0.0);
        let error = (f64::from(depth) - expected).abs();
        assert!(error <= 1e-6 * expected, "pixel {pixel}: depth {depth}, expected {expected}");
        hits += usize::from(depth > 0.0);
    }
    assert!(hits > 100, "only {hits} pixels show the shape");
}

fn sphere_hit(o: DVec3, d: DVec3, centre: DVec3, radius: f64) -> Option<f64> {
    let (a, b, c) = (d.dot(d), 2.0 * d.dot(o - centre), (o - centre).length_squared() - radius * radius);
    let root = (b * b - 4.0 * a * c).sqrt();
    [(-b - root) / (2.0 * a), (-b + root) / (2.0 * a)].into_iter().find(|t| *t > 0.0)
}

/// The nearest of the six faces, each as a plane with bounds.
fn box_hit(o: DVec3, d: DVec3, centre: DVec3, size: DVec3) -> Option<f64> {
    let mut nearest: Option<f64> = None;
    for axis in 0..3 {
        for side in [-0.5, 0.5] {
            let t = (centre[axis] + side * size[axis] - o[axis]) / d[axis];
            let p = o + d * t - centre;
            let inside = (0..3).all(|k| k == axis || p[k].abs() <= 0.5 * size[k]);
            if t > 0.0 && inside {
                nearest = Some(nearest.map_or(t, |n| n.min(t)));
            }
        }
    }
    nearest
}

#[test]
fn a_plane_has_the_depth_of_its_equation() {
    let floor = body("floor", Shape::Rectangle { width: 1e3, height: 1e3 }, DVec3::ZERO, GREY);
    let camera = camera(DVec3::new(0.3, -4.0, 1.7), DVec3::new(0.0, 0.0, 0.5));
    check(floor, &camera, |o, d| {
        Some(-o.z / d.z).filter(|t| *t > 0.0 && (o + d * t).abs().max_element() <= 500.0)
    });
}

#[test]
fn a_turned_rectangle_has_the_depth_of_its_equation() {
    let mut wall =
        body("wall", Shape::Rectangle { width: 40.0, height: 40.0 }, DVec3::new(0.0, 3.0, 0.0), GREY);
    wall.rotation = DVec3::new(90.0, 0.0, 30.0);
    // Turned about x, +z looks along -y; then 30 degrees about z.
    let (sine, cosine) = 30f64.to_radians().sin_cos();
    let normal = DVec3::new(sine, -cosine, 0.0);
    let camera = camera(DVec3::new(1.0, -4.0, 1.0), DVec3::new(0.0, 3.0, 0.0));
    check(wall, &camera, |o, d| Some((DVec3::new(0.0, 3.0, 0.0) - o).dot(normal) / d.dot(normal)));
}

#[test]
fn boxes_and_spheres_have_their_analytic_depth_from_outside_and_inside() {
    let (centre, size) = (DVec3::new(0.2, 0.4, 0.5), DVec3::new(1.0, 2.0, 1.5));
    for position in [DVec3::new(2.0, -3.0, 2.0), DVec3::new(0.1, 0.3, 0.6)] {
        let camera = camera(position, DVec3::new(0.3, 0.9, 0.4));
        check(body("box", Shape::Box { size }, centre, GREY), &camera, |o, d| box_hit(o, d, centre, size));
        let ball = body("ball", Shape::Sphere { radius: 0.9 }, centre, GREY);
        check(ball, &camera, |o, d| sphere_hit(o, d, centre, 0.9));
    }
}

#[test]
fn depth_is_exact_at_every_scale_and_distance() {
    for scale in [1e-5, 1.0, 1e6] {
        for distance in [2.0, 3e3] {
            let radius = scale * distance / 4.0;
            let camera = camera(DVec3::new(0.0, -distance, 0.1 * distance) * scale, DVec3::ZERO);
            let ball = body("ball", Shape::Sphere { radius }, DVec3::ZERO, GREY);
            check(ball, &camera, |o, d| sphere_hit(o, d, DVec3::ZERO, radius));
        }
    }
    // Far outside a small scene: a few pixels, each exact.
    let camera =
        Camera::looking_at(scene_sim::lens(61, 41, 0.5), DVec3::new(0.0, -1e4, 10.0), DVec3::ZERO, DVec3::Z);
    let ball = body("ball", Shape::Sphere { radius: 20.0 }, DVec3::ZERO, GREY);
    check(ball, &camera.unwrap(), |o, d| sphere_hit(o, d, DVec3::ZERO, 20.0));
}

/// A little of everything, with shadows.
fn mixture(offset: DVec3) -> scene_sim::Scene {
    let checker = Pattern::Checker { colours: [[0.9; 3], [0.2, 0.3, 0.4]], cell: 0.31 };
    let noise = Pattern::Noise { dark: [0.1; 3], light: [0.9, 0.8, 0.5], scale: 0.4, octaves: 4 };
    let mut tilted = body(
        "tilted",
        Shape::Box { size: DVec3::new(0.6, 0.4, 0.9) },
        offset + DVec3::new(0.7, 0.4, 0.6),
        noise,
    );
    tilted.rotation = DVec3::new(20.0, -35.0, 50.0);
    let primitives = vec![
        body("floor", Shape::Rectangle { width: 7.13, height: 7.13 }, offset, checker),
        tilted,
        body("ball", Shape::Sphere { radius: 0.4 }, offset + DVec3::new(-0.6, 0.1, 0.5), noise),
        body(
            "tube",
            Shape::Cylinder { radius: 0.2, height: 1.1 },
            offset + DVec3::new(0.0, -0.7, 0.61),
            checker,
        ),
    ];
    scene(primitives, Some(SUN))
}

#[test]
fn a_scene_far_from_the_origin_looks_the_same() {
    let (position, target) = (DVec3::new(1.3, -3.1, 1.9), DVec3::new(0.1, 0.0, 0.5));
    let near = view(&mixture(DVec3::ZERO), &camera(position, target));
    for offset in [DVec3::new(1e4, -1e4, 1e4), DVec3::new(0.0, 1e7, 0.0)] {
        let far = view(&mixture(offset), &camera(position + offset, target + offset));
        let rounding = offset.length() * 1e-15;
        for (a, b) in depth(&near).data().iter().zip(depth(&far).data()) {
            assert!((a - b).abs() <= a * 3e-7 + 10.0 * rounding as f32, "depth {a} became {b}");
        }
        let pairs = near.image().data().iter().zip(far.image().data());
        let changed = pairs.filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
        // A sample on an edge may fall to its other side.
        assert!(changed <= 3, "{changed} values of the picture changed at {offset}");
    }
}

#[test]
fn an_empty_scene_is_all_sky() {
    let camera = camera(DVec3::ZERO, DVec3::new(0.0, 1.0, 0.6));
    let empty = Traced::new(&scene(Vec::new(), Some(SUN))).unwrap();
    let (view, rays) = render_counted(&empty, &camera, 4, "sky", 0).unwrap();
    assert_eq!(depth(&view).coverage(), 0.0);
    assert_eq!(rays.shadow, 0);
    let (top, bottom) = (view.image().pixel(30, 0), view.image().pixel(30, 40));
    assert!(top[0] < bottom[0], "the zenith is of a deeper blue than the horizon");
}

#[test]
fn what_has_no_area_is_dropped_and_counted() {
    let at = DVec3::new(0.0, 3.0, 0.0);
    let shapes = [
        Shape::Sphere { radius: 0.0 },
        Shape::Box { size: DVec3::new(0.0, 0.0, 1.0) },
        Shape::Rectangle { width: 1.0, height: 0.0 },
        Shape::Cylinder { radius: 0.0, height: 1.0 },
    ];
    let nothing: Vec<_> =
        shapes.into_iter().enumerate().map(|(i, s)| body(&i.to_string(), s, at, GREY)).collect();
    let camera = camera(DVec3::ZERO, at);
    let traced = Traced::new(&scene(nothing.clone(), None)).unwrap();
    let dropped: Vec<String> = traced.dropped().iter().map(ToString::to_string).collect();
    let expected =
        ["0", "1", "2", "3"].map(|name| format!("primitive {name} ({name}) has no area and is not seen"));
    assert_eq!(dropped, expected);
    assert_eq!(depth(&view(&scene(nothing.clone(), None), &camera)).coverage(), 0.0);
    // A plate and a disc without thickness are seen, beside what is not.
    for shape in
        [Shape::Box { size: DVec3::new(1.0, 0.0, 1.0) }, Shape::Cylinder { radius: 1.0, height: 0.0 }]
    {
        let mut all = nothing.clone();
        all.push(body("flat", shape, at - DVec3::Z * 0.3, GREY));
        let view = view(&scene(all, Some(SUN)), &camera);
        assert!(depth(&view).coverage() > 0.01, "{shape:?}");
    }
}

#[test]
fn no_ray_slips_between_touching_boxes() {
    let mut wall = Vec::new();
    for x in -6..6 {
        for z in -6..6 {
            let centre = DVec3::new(f64::from(x) + 0.5, 4.0, f64::from(z) + 0.5);
            wall.push(body("brick", Shape::Box { size: DVec3::ONE }, centre, GREY));
        }
    }
    // Rays through the middle column and row of this camera run exactly along the joints.
    for position in [DVec3::ZERO, DVec3::new(0.3, 0.1, 0.7)] {
        let view = view(&scene(wall.clone(), None), &camera(position, position + DVec3::Y));
        assert_eq!(depth(&view).coverage(), 1.0);
    }
}

use super::{GREY, SKY, SUN, body, camera, depth, luma, scene};
use glam::{DVec2, DVec3};
use gs_scene::{Camera, View};
use scene_sim::{
    Finish, Lamp, Occlusion, Pattern, Primitive, RayCounts, Scene, Shape, Sky, Sun, Traced, render_counted,
};
use std::f64::consts::PI;

const WHITE: Pattern = Pattern::Plain { colour: [1.0; 3] };

fn plate(width: f64, height: f64, centre: DVec3, pattern: Pattern) -> Primitive {
    body("plate", Shape::Rectangle { width, height }, centre, pattern)
}

fn with_finish(mut primitive: Primitive, finish: Finish) -> Primitive {
    primitive.material.finish = finish;
    primitive
}

/// A sky of one linear brightness, which sheds no light of its own.
fn even_sky(linear: f64) -> Sky {
    let encoded = [encode(linear) as f32; 3];
    Sky { zenith: encoded, horizon: encoded, ground: encoded, light: 0.0, occlusion: None }
}

fn encode(v: f64) -> f64 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

fn decode(v: f32) -> f64 {
    let v = f64::from(v);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn take(scene: &Scene, camera: &Camera, samples: u32) -> (View, RayCounts) {
    render_counted(&Traced::new(scene).unwrap(), camera, samples, "view", 0).unwrap()
}

/// Linear brightness where a point of the world is seen.
fn at(view: &View, world: DVec3) -> f64 {
    near(view, world).0
}

/// Linear brightness of the pixel where a point of the world is seen, and the point of the world in its middle.
fn near(view: &View, world: DVec3) -> (f64, DVec3) {
    let pixel = view.camera().project(world).unwrap();
    let (x, y) = (pixel.x as usize, pixel.y as usize);
    let centre = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
    let seen = view.camera().unproject(centre, f64::from(depth(view).data()[y * 61 + x]));
    (decode(luma(view.image().pixel(x, y))), seen)
}

fn lamp(size: DVec2, height: f64, strength: f32) -> Lamp {
    let centre = DVec3::Z * height;
    Lamp { name: "lamp".into(), centre, rotation: DVec3::X * 180.0, size, colour: [1.0; 3], strength }
}

/// A white floor under one lamp, and nothing else that shines.
fn under(lamp: Lamp) -> Scene {
    let floor = plate(40.0, 40.0, DVec3::ZERO, WHITE);
    Scene { lamps: vec![lamp], primitives: vec![floor], ..Scene::under(even_sky(0.0)) }
}

/// The mean of strength x cosine x cosine / distance^2 over a lamp that looks down, for a point of the floor.
fn lamp_formula(size: DVec2, height: f64, strength: f64, floor: DVec3) -> f64 {
    let steps = 400;
    let offset = |k: i32, size: f64| ((f64::from(k) + 0.5) / f64::from(steps) - 0.5) * size;
    let mut sum = 0.0;
    for i in 0..steps {
        for j in 0..steps {
            let across = floor.truncate() - DVec2::new(offset(i, size.x), offset(j, size.y));
            let squared = across.length_squared() + height * height;
            sum += height * height / (squared * squared);
        }
    }
    strength * sum / f64::from(steps * steps)
}

#[test]
fn lamps_light_a_floor_as_the_formula_says() {
    let camera = camera(DVec3::new(0.0, -4.0, 1.5), DVec3::new(0.0, 0.0, 0.0));
    for (size, samples, tolerance) in [
        (DVec2::ZERO, 4, 0.01),
        (DVec2::new(1.2, 0.0), 64, 0.03),
        (DVec2::new(0.0, 0.7), 64, 0.03),
        (DVec2::new(1.4, 0.8), 64, 0.03),
    ] {
        let (view, rays) = take(&under(lamp(size, 2.0, 2.0)), &camera, samples);
        for x in [0.0, 0.5, -1.1] {
            let (found, place) = near(&view, DVec3::X * x);
            let expected = lamp_formula(size, 2.0, 2.0, place);
            assert!(
                (found / expected - 1.0).abs() < tolerance,
                "{found}, expected {expected}: {size} at {x}"
            );
        }
        assert!(rays.lamp_shadow > 0 && rays.shadow == 0);
    }
}

#[test]
fn a_lamp_is_as_bright_as_the_light_it_sheds() {
    let size = DVec2::new(2.0, 1.0);
    let lit = under(lamp(size, 3.0, 0.4));
    let from_below = camera(DVec3::new(0.1, 0.0, 0.5), DVec3::Z * 3.0);
    let (view, _) = take(&lit, &from_below, 1);
    let expected = 0.4 * PI / 2.0;
    assert!((at(&view, DVec3::Z * 3.0) / expected - 1.0).abs() < 1e-3);
    assert!((depth(&view).data()[20 * 61 + 30] - 2.5).abs() < 0.01, "a lamp has depth");
    // From behind it is not there, and without area it is not seen.
    let from_above = camera(DVec3::new(0.1, 0.0, 5.5), DVec3::Z * 3.0);
    let (view, _) = take(&lit, &from_above, 1);
    assert!((depth(&view).data()[20 * 61 + 30] - 5.5).abs() < 0.01);
    for size in [DVec2::ZERO, DVec2::new(2.0, 0.0)] {
        let (view, _) = take(&under(lamp(size, 3.0, 0.4)), &from_below, 1);
        assert_eq!(depth(&view).data()[20 * 61 + 30], 0.0);
    }
}

#[test]
fn lamps_shine_to_their_front_alone_and_strength_0_costs_nothing() {
    let camera = camera(DVec3::new(0.0, -4.0, 1.5), DVec3::ZERO);
    let turned = Lamp { rotation: DVec3::ZERO, ..lamp(DVec2::ONE, 2.0, 2.0) };
    let (view, rays) = take(&under(turned), &camera, 4);
    assert!(at(&view, DVec3::ZERO) == 0.0 && rays.lamp_shadow == 0);
    let (_, rays) = take(&under(lamp(DVec2::ONE, 2.0, 0.0)), &camera, 4);
    assert_eq!(rays.lamp_shadow, 0);
    // What lies between keeps the light off, what lies behind the lamp does not.
    let mut shaded = under(lamp(DVec2::ZERO, 2.0, 2.0));
    shaded.primitives.push(plate(1.0, 1.0, DVec3::Z, WHITE));
    shaded.primitives.push(plate(1.0, 1.0, DVec3::Z * 2.0, WHITE));
    let (view, _) = take(&shaded, &camera, 4);
    assert!(at(&view, DVec3::X * 0.5) < 1e-6 && at(&view, DVec3::X * 1.5) > 0.1);
}

#[test]
fn a_sun_with_a_diameter_has_shadows_with_soft_edges() {
    // A roof 2 m above the floor ends at x = 0; the sun stands in the zenith and is 10 degrees wide.
    let floor = plate(40.0, 40.0, DVec3::ZERO, WHITE);
    let roof = plate(20.0, 40.0, DVec3::new(-10.0, 0.0, 2.0), WHITE);
    let sun = Sun { towards: DVec3::Z, colour: [1.0; 3], strength: 0.6, diameter: 10.0 };
    let lit = Scene { primitives: vec![floor, roof], sun: Some(sun), ..Scene::under(even_sky(0.0)) };
    let camera = camera(DVec3::new(0.0, -3.0, 1.0), DVec3::ZERO);
    let (view, _) = take(&lit, &camera, 144);
    let half_width = 2.0 * 5f64.to_radians().tan();
    for x in [-0.5, 0.0, 0.4] {
        let (found, place) = near(&view, DVec3::X * x * half_width);
        // Share of a disc beyond a line.
        let line = (-place.x / half_width).clamp(-1.0, 1.0);
        let expected = 0.6 * (line.acos() - line * (1.0 - line * line).sqrt()) / PI;
        assert!((found - expected).abs() < 0.03, "{found} at {place}, expected {expected}");
    }
    assert!(at(&view, DVec3::X * -1.5 * half_width) < 1e-6);
    assert!((at(&view, DVec3::X * 1.5 * half_width) / 0.6 - 1.0).abs() < 0.01);
    let hard = Scene { sun: Some(Sun { diameter: 0.0, ..sun }), ..lit };
    let (hard_view, _) = take(&hard, &camera, 9);
    assert!(at(&hard_view, DVec3::X * -0.5 * half_width) < 1e-6);
}

#[test]
fn a_wall_keeps_off_its_share_of_the_sky() {
    let sky = Sky { light: 1.0, occlusion: Some(Occlusion { reach: 500.0, rays: 16 }), ..even_sky(0.5) };
    let floor = plate(400.0, 400.0, DVec3::ZERO, WHITE);
    let wall = body("wall", Shape::Box { size: DVec3::new(400.0, 2.0, 4.0) }, DVec3::Y, WHITE);
    let open = |reach, y: f64| {
        let sky = Sky { occlusion: Some(Occlusion { reach, rays: 16 }), ..sky };
        let scene = Scene { primitives: vec![floor.clone(), wall.clone()], ..Scene::under(sky) };
        let place = DVec3::Y * y;
        let (view, rays) = take(&scene, &camera(place + DVec3::new(0.0, -2.0, 2.0), place), 16);
        assert_eq!(rays.occlusion > 0, reach > 0.0);
        let (found, place) = near(&view, place);
        (found / 0.5, -place.y)
    };
    for y in [0.5f64, 1.0, 4.0] {
        let (found, distance) = open(500.0, -y);
        // Form factor of an endless strip that stands on the plane. The box stands from z = -2 to 2.
        let kept_off = 0.5 * (1.0 - distance / distance.hypot(2.0));
        assert!(
            (found - (1.0 - kept_off)).abs() < 0.03,
            "{found} at {distance} m, expected {}",
            1.0 - kept_off
        );
    }
    assert!((open(0.9, -1.2).0 - 1.0).abs() < 1e-3, "what is out of reach keeps nothing off");
    assert!((open(0.0, -1.0).0 - 1.0).abs() < 1e-3);
}

#[test]
fn a_mirror_shows_the_mirrored_world_and_has_its_own_depth() {
    let floor = with_finish(plate(40.0, 40.0, DVec3::ZERO, WHITE), Finish::Mirror);
    let red = Pattern::Plain { colour: [1.0, 0.0, 0.0] };
    let centre = DVec3::new(0.6, 2.0, 1.5);
    let ball = with_finish(body("ball", Shape::Sphere { radius: 0.3 }, centre, red), Finish::Baked);
    let scene = Scene { primitives: vec![floor, ball], ..Scene::under(even_sky(0.3)) };
    let camera = camera(DVec3::new(0.0, -2.0, 1.5), DVec3::new(0.3, 1.0, 0.0));
    let (view, rays) = take(&scene, &camera, 4);
    assert!(rays.mirror > 0 && rays.reflection == 0);
    let image = centre * DVec3::new(1.0, 1.0, -1.0);
    let pixel = camera.project(image).unwrap();
    let (x, y) = (pixel.x as usize, pixel.y as usize);
    let [r, g, b] = view.image().pixel(x, y);
    assert!(r > 0.9999 && g == 0.0 && b == 0.0);
    let seen = camera
        .unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), f64::from(depth(&view).data()[y * 61 + x]));
    assert!(seen.z.abs() < 1e-5, "the depth is that of the mirror: {seen}");
    // A sky of 0.3 in a mirror of 0.5 (both linear).
    let grey = Pattern::Plain { colour: [encode(0.5) as f32; 3] };
    let dim = with_finish(plate(40.0, 40.0, DVec3::ZERO, grey), Finish::Mirror);
    let (view, _) = take(&Scene { primitives: vec![dim], ..scene }, &camera, 1);
    assert!((at(&view, DVec3::ZERO) - 0.15).abs() < 1e-4);
}

#[test]
fn mirrors_that_face_each_other_come_to_an_end() {
    let wall = |y: f64| {
        let mut wall = plate(40.0, 40.0, DVec3::Y * y, WHITE);
        wall.rotation.x = 90.0;
        with_finish(wall, Finish::Mirror)
    };
    let scene = Scene { primitives: vec![wall(2.0), wall(-2.0)], ..Scene::under(even_sky(0.3)) };
    let (view, rays) = take(&scene, &camera(DVec3::ZERO, DVec3::new(0.1, 1.0, 0.1)), 1);
    assert!(rays.mirror > 0 && rays.mirror <= 8 * rays.primary);
    assert!(view.image().data().iter().all(|v| (0.0..=1.0).contains(v)));
}

/// In a world of one brightness nothing clear can be seen: what glass does not let through it throws back.
#[test]
fn glass_neither_makes_nor_loses_light() {
    let glass = Finish::Glass { index: 1.5 };
    let shapes = [
        Shape::Rectangle { width: 2.0, height: 2.0 },
        Shape::Sphere { radius: 1.0 },
        Shape::Box { size: DVec3::splat(1.5) },
        Shape::Cylinder { radius: 0.8, height: 1.5 },
    ];
    for shape in shapes {
        for eye in [DVec3::new(1.0, -3.0, 1.4), DVec3::new(0.1, -0.1, 0.2)] {
            let mut clear = with_finish(body("glass", shape, DVec3::ZERO, WHITE), glass);
            clear.rotation = DVec3::new(12.0, 30.0, 7.0);
            let scene = Scene { primitives: vec![clear], ..Scene::under(even_sky(0.4)) };
            let (view, rays) = take(&scene, &camera(eye, DVec3::new(0.0, 0.1, 0.1)), 1);
            assert!(rays.reflection > 0 && rays.refraction > 0);
            let values: Vec<f64> = view.image().data().iter().map(|v| decode(*v)).collect();
            let (low, high) = values.iter().fold((1.0f64, 0.0f64), |(l, h), v| (l.min(*v), h.max(*v)));
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            assert!(high <= 0.4 * 1.0001, "{shape:?} shows {high}");
            // A box and a cylinder hold some rays for ever by total reflection: those are dark.
            let trapped = matches!(shape, Shape::Box { .. } | Shape::Cylinder { .. });
            assert!(trapped || low > 0.4 * 0.9, "{shape:?} shows {low}");
            assert!(mean > 0.4 * if trapped { 0.5 } else { 0.98 }, "{shape:?} shows {mean} in the mean");
        }
    }
}

#[test]
fn glass_bends_light_by_its_index() {
    let red = Pattern::Plain { colour: [1.0, 0.0, 0.0] };
    let behind = with_finish(
        body("ball", Shape::Sphere { radius: 0.5 }, DVec3::new(0.8, 6.0, 0.0), red),
        Finish::Baked,
    );
    let camera = camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO);
    let picture = |index| {
        let lens = body("glass", Shape::Sphere { radius: 1.2 }, DVec3::ZERO, WHITE);
        let lens = with_finish(lens, Finish::Glass { index });
        let scene = Scene { primitives: vec![lens, behind.clone()], ..Scene::under(even_sky(0.3)) };
        take(&scene, &camera, 4).0
    };
    let red_share = |view: &View, right: bool| {
        let side = |i: usize| (i % 61 > 30) == right;
        let values = view.image().data().chunks_exact(3).enumerate().filter(|(i, _)| side(*i));
        values.filter(|(_, v)| v[0] > 0.8 && v[1] < 0.4).count()
    };
    // With the index of air it is not there; a ball of glass turns the picture around.
    assert!(red_share(&picture(1.0), true) > 20 && red_share(&picture(1.0), false) == 0);
    assert!(red_share(&picture(1.5), false) > 20 && red_share(&picture(1.5), true) == 0);
}

#[test]
fn panes_have_their_colour_and_cast_no_shadow() {
    let green = Pattern::Plain { colour: [0.0, 1.0, 0.0] };
    let mut pane = with_finish(plate(3.0, 3.0, DVec3::ZERO, green), Finish::Glass { index: 1.5 });
    pane.rotation.x = 90.0;
    let scene_of = |pane| Scene { primitives: vec![pane], ..Scene::under(even_sky(0.4)) };
    let (view, _) = take(&scene_of(pane), &camera(-DVec3::Y * 3.0, DVec3::ZERO), 4);
    let [r, g, _] = view.image().pixel(30, 20).map(decode);
    let back = 0.08 / 1.04;
    assert!((g - 0.4).abs() < 1e-3 && (r - 0.4 * back).abs() < 1e-3, "red {r}, green {g}");

    let floor = plate(20.0, 20.0, DVec3::ZERO, GREY);
    let roof = with_finish(plate(20.0, 20.0, DVec3::Z * 4.0, green), Finish::Glass { index: 1.5 });
    let eye = camera(DVec3::new(0.0, -2.0, 1.5), DVec3::ZERO);
    let (open, _) = take(&scene(vec![floor.clone()], Some(SUN)), &eye, 4);
    let (under_glass, _) = take(&scene(vec![floor, roof], Some(SUN)), &eye, 4);
    assert_eq!(at(&open, DVec3::ZERO), at(&under_glass, DVec3::ZERO));
}

#[test]
fn baked_surfaces_are_shown_as_they_are() {
    let floor = with_finish(plate(40.0, 40.0, DVec3::ZERO, GREY), Finish::Baked);
    let lit = Scene { lamps: vec![lamp(DVec2::ONE, 2.0, 1.0)], ..scene(vec![floor], Some(SUN)) };
    let lit = Scene { sky: Sky { occlusion: Some(Occlusion { reach: 1.0, rays: 4 }), ..SKY }, ..lit };
    let (view, rays) = take(&lit, &camera(DVec3::new(0.0, -2.0, 1.5), DVec3::ZERO), 4);
    assert!((luma(view.image().pixel(30, 25)) - 0.5).abs() < 1e-5);
    assert_eq!((rays.shadow, rays.lamp_shadow, rays.occlusion), (0, 0, 0));
}

use super::{GREY, SKY, SUN, body, camera, depth, luma, scene, view};
use glam::DVec3;
use scene_sim::{
    Pattern, RayCounts, Scene, Shape, Sun, Traced, demo_cameras, demo_scene, render_counted, render_view,
};

fn white_floor() -> scene_sim::Primitive {
    body(
        "floor",
        Shape::Rectangle { width: 200.0, height: 200.0 },
        DVec3::ZERO,
        Pattern::Plain { colour: [1.0; 3] },
    )
}

fn rays(scene: &Scene) -> RayCounts {
    let camera = camera(DVec3::new(0.0, -4.0, 2.0), DVec3::ZERO);
    render_counted(&Traced::new(scene).unwrap(), &camera, 9, "view", 0).unwrap().1
}

#[test]
fn shadow_rays_are_cast_only_where_there_is_a_sun() {
    let (depth, primary) = (61 * 41, 61 * 41 * 9);
    let dark = scene(vec![white_floor()], None);
    let found = rays(&dark);
    assert_eq!((found.primary, found.depth, found.rays()), (primary, depth, primary + depth));
    let black_sun = Sun { strength: 0.0, ..SUN };
    assert_eq!(rays(&scene(vec![white_floor()], Some(black_sun))).shadow, 0);
    let below = Sun { towards: -DVec3::Z, ..SUN };
    assert_eq!(rays(&scene(vec![white_floor()], Some(below))).shadow, 0);
    let lit = rays(&scene(vec![white_floor()], Some(SUN)));
    assert!(lit.primary == primary && lit.shadow > primary / 2 && lit.shadow <= primary);
}

#[test]
fn a_lit_plane_has_no_dark_speckles_at_grazing_light_or_view() {
    for offset in [DVec3::ZERO, DVec3::new(1e4, -1e4, 1e4)] {
        for height in [1e-3, 0.1, 1.0] {
            let sun = Sun { towards: DVec3::new(1.0, 0.3, height), ..SUN };
            let mut floor = white_floor();
            floor.centre = offset;
            let mut tilted = floor.clone();
            tilted.rotation = DVec3::new(3.7, -1.3, 11.0);
            for (plane, low) in [(floor, 0.01), (tilted, 30.0)] {
                let normal = {
                    let [x, y, z] = plane.rotation.to_array().map(f64::to_radians);
                    glam::DQuat::from_euler(glam::EulerRot::ZYX, z, y, x) * DVec3::Z
                };
                if normal.dot(sun.towards) <= 0.0 {
                    continue;
                }
                let eye = offset + DVec3::new(0.0, -5.0, low);
                let view = view(&scene(vec![plane], Some(sun)), &camera(eye, offset));
                let shown = depth(&view).data().iter().enumerate().filter(|(_, d)| **d > 0.0);
                // The rows beside the horizon mix with the sky.
                let values: Vec<f32> = shown
                    .filter(|(i, _)| depth(&view).data().get(i.saturating_sub(61)).is_some_and(|d| *d > 0.0))
                    .map(|(i, _)| luma(view.image().pixel(i % 61, i / 61)))
                    .collect();
                let (low, high) = values.iter().fold((f32::MAX, 0f32), |(l, h), v| (l.min(*v), h.max(*v)));
                assert!(values.len() > 500 && high - low < 1e-3, "{low} to {high} at {offset}, sun {height}");
            }
        }
    }
}

#[test]
fn round_and_flat_surfaces_never_shadow_themselves() {
    let shapes = [
        Shape::Sphere { radius: 1.0 },
        Shape::Sphere { radius: 1e-3 },
        Shape::Box { size: DVec3::new(1.0, 2.0, 1.5) },
        Shape::Cylinder { radius: 0.8, height: 1.5 },
    ];
    for offset in [DVec3::ZERO, DVec3::new(1e4, -1e4, 1e4)] {
        for shape in shapes {
            let size = match shape {
                Shape::Sphere { radius } => 2.0 * radius,
                _ => 2.0,
            };
            let mut thing = body("thing", shape, offset, Pattern::Plain { colour: [1.0; 3] });
            thing.rotation = DVec3::new(33.0, -21.0, 57.0);
            // From the sun, with no light from the sky: what is seen is lit, so black is acne.
            let dark = Scene { sky: scene_sim::Sky { light: 0.0, ..SKY }, ..scene(vec![thing], Some(SUN)) };
            let view = view(&dark, &camera(offset + SUN.towards * 2.0 * size, offset));
            for (i, d) in depth(&view).data().iter().enumerate() {
                let (x, y) = (i % 61, i / 61);
                let inside = (x > 0 && y > 0 && x < 60 && y < 40)
                    && [i - 1, i + 1, i - 61, i + 61].iter().all(|j| depth(&view).data()[*j] > 0.0);
                if *d > 0.0 && inside {
                    assert!(luma(view.image().pixel(x, y)) > 0.05, "black at ({x}, {y}) of {shape:?}");
                }
            }
        }
    }
}

#[test]
fn a_thing_under_the_sun_casts_a_shadow_where_it_belongs() {
    let mut things = vec![white_floor()];
    things.push(body("ball", Shape::Sphere { radius: 0.5 }, DVec3::new(0.0, 0.0, 2.0), GREY));
    let sun = Sun { towards: DVec3::new(1.0, 0.0, 2.0), ..SUN };
    let camera = camera(DVec3::new(-1.0, -6.0, 6.0), DVec3::new(-1.0, 0.0, 0.0));
    let view = view(&scene(things, Some(sun)), &camera);
    let at = |x: f64, y: f64| {
        let pixel = camera.project(DVec3::new(x, y, 0.0)).unwrap();
        luma(view.image().pixel(pixel.x as usize, pixel.y as usize))
    };
    // The ray from the sun through the ball's centre meets the floor at x = -1.
    assert!(at(-1.0, 0.0) < 0.8 * at(-2.5, 0.0));
    assert!((at(-2.5, 0.0) - at(0.8, 0.0)).abs() < 1e-3);
}

#[test]
fn a_flat_white_surface_has_the_brightness_of_the_formula() {
    // Straight above a level floor: sun x cosine + sky light x mean of zenith and horizon, all in linear
    // light.
    let sky =
        scene_sim::Sky { zenith: [0.5; 3], horizon: [0.5; 3], ground: [0.0; 3], light: 0.4, occlusion: None };
    let sun = Sun { towards: DVec3::new(1.0, 0.0, 1.0), colour: [1.0; 3], strength: 0.6, diameter: 0.0 };
    let lit = Scene { primitives: vec![white_floor()], sun: Some(sun), ..Scene::under(sky) };
    let camera = camera(DVec3::new(0.0, -0.1, 3.0), DVec3::ZERO);
    let found = view(&lit, &camera).image().pixel(30, 20)[1];
    let linear = 0.6 * 0.5f64.sqrt() + 0.4 * ((0.5 + 0.055) / 1.055f64).powf(2.4);
    let expected = 1.055 * linear.powf(1.0 / 2.4) - 0.055;
    assert!((f64::from(found) - expected).abs() < 1e-5, "{found}, expected {expected}");
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let traced = Traced::new(&demo_scene()).unwrap();
    let (context, _) = demo_cameras(96, 64).unwrap();
    let render = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render_counted(&traced, &context[2], 4, "view", seed).unwrap())
    };
    let bits = |v: &gs_scene::View| {
        v.image().data().iter().chain(depth(v).data()).map(|x| x.to_bits()).collect::<Vec<_>>()
    };
    let (one, rays) = render(1, 5);
    for threads in [2, 3, 7] {
        let (many, same) = render(threads, 5);
        assert!(bits(&many) == bits(&one) && same == rays, "{threads} threads differ");
    }
    let (other, _) = render(2, 5 + (1 << 32));
    assert_ne!(other.image(), one.image());
    assert_eq!(other.depth(), one.depth(), "depth has no randomness");
}

#[test]
fn four_samples_are_close_to_many() {
    let traced = Traced::new(&demo_scene()).unwrap();
    let (context, _) = demo_cameras(90, 60).unwrap();
    let picture = |samples| render_view(&traced, &context[0], samples, "view", 3).unwrap();
    let (four, many) = (picture(4), picture(144));
    let pairs = four.image().data().iter().zip(many.image().data());
    let error = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / four.image().data().len() as f64;
    let psnr = -10.0 * error.log10();
    assert!(psnr > 30.0, "4 samples differ from 144 by {psnr:.1} dB");
    // Numbers of samples that are no squares are used in full too.
    for samples in [1, 2, 6, 7] {
        assert_eq!(picture(samples).image().width(), 90);
    }
}

use crate::{LENS, PIXELS, any_camera, camera, centre, depth_map, every_pixel, view};
use backproject::{Dropped, Settings, ViewPixels, anchors};
use glam::{DMat3, DVec3, Vec3};
use gs_scene::{Camera, FeatureMap, Image, Intrinsics};
use proptest::prelude::*;

/// Any lens, pose and slight error of the rotation that gs-scene admits, up to 1e4 units from the origin on every axis.
fn any_lens_and_pose() -> impl Strategy<Value = Camera> {
    let lens = (20.0..2e3f64, 0.5..2.0f64, -300.0..900.0f64, -300.0..900.0f64, 1..900usize, 1..900usize);
    let pose = (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-1e4..1e4f64), -4e-5..4e-5f64);
    (lens, pose).prop_map(|((fx, ratio, cx, cy, width, height), (angles, translation, error))| {
        let lens = Intrinsics { fx, fy: fx * ratio, cx, cy, width, height };
        let rotation = DMat3::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
        let shear = DMat3::from_cols(DVec3::X, DVec3::new(error, 1.0, 0.0), DVec3::Z);
        Camera::new(lens, rotation * shear, DVec3::from(translation)).expect("a valid camera")
    })
}

proptest! {
    #[test]
    fn positions_project_to_their_pixel_centres(
        camera in any_lens_and_pose(), seed in any::<u64>(), near in -2.0..3.0f32,
    ) {
        let (width, height) = (camera.width(), camera.height());
        let random = |i: u64| (seed ^ i).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let pixels: Vec<u32> = (0..300).map(|i| (random(i) % (width * height) as u64) as u32).collect();
        // From 0.01 to 1e4 units.
        let depth: Vec<f32> =
            (0..(width * height) as u64).map(|i| 10f32.powf(near + (random(i) >> 40) as f32 * 0.5f32.powi(24))).collect();
        let without_normals = Settings { normals: None, ..Settings::default() };
        let found = anchors(&[view(&camera, &depth, &pixels)], &without_normals).unwrap().anchors;
        prop_assert_eq!(&found.pixels, &pixels);
        let relative = found.positions_from(camera.to_world(DVec3::ZERO));
        for i in 0..found.len() {
            let (pixel, z) = (pixels[i] as usize, f64::from(depth[pixels[i] as usize]));
            let centre = glam::DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            let world = DVec3::from(found.positions[i]);
            let back = camera.project(world).unwrap();
            prop_assert!((back - centre).length() < 1e-3, "{back} for {centre} at {z}");
            prop_assert!((camera.to_camera(world).z / z - 1.0).abs() < 1e-6);
            let ray = Vec3::from(found.rays[i]).as_dvec3();
            prop_assert!((ray.length() - 1.0).abs() < 1e-6);
            let along = camera.rotation() * ray;
            prop_assert!((along / along.z - camera.intrinsics().ray(centre)).length() < 1e-5 * along.z.powi(-2));
            prop_assert!((f64::from(found.footprints[i]) * (camera.intrinsics().fx * camera.intrinsics().fy).sqrt() / z - 1.0).abs() < 1e-6);
            prop_assert_eq!(f64::from(found.depths[i]), z);
            let from = Vec3::from(relative[i]).as_dvec3();
            prop_assert!((camera.to_world(DVec3::ZERO) + from - world).length() < 2e-7 * from.length() + 1e-11);
        }
    }

    #[test]
    fn each_pixel_is_kept_or_counted(
        depths in prop::collection::vec(
            prop_oneof![Just(0.0f32), Just(-0.0), Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY),
                        Just(-1.0), Just(1e-42), Just(f32::MAX), 0.5..20.0f32],
            PIXELS,
        ),
        pixels in prop::collection::vec(0..PIXELS as u32, 0..700), far in 1.0..20.0f32, camera in any_camera(),
    ) {
        let settings = Settings { far, ..Settings::default() };
        let found = anchors(&[view(&camera, &depths, &pixels)], &settings).unwrap();
        let at = |&p: &u32| depths[p as usize];
        let kept: Vec<u32> = pixels.iter().copied().filter(|p| at(p) > 0.0 && at(p) <= far).collect();
        prop_assert_eq!(&found.anchors.pixels, &kept);
        let count = |rule: &dyn Fn(f32) -> bool| pixels.iter().filter(|&p| rule(at(p))).count();
        prop_assert_eq!(found.dropped[0], Dropped {
            no_depth: count(&|z| z == 0.0),
            not_finite: count(&|z| !z.is_finite()),
            negative: count(&|z| z.is_finite() && z < 0.0),
            beyond_far: count(&|z| z.is_finite() && z > far),
        });
        prop_assert_eq!(found.dropped[0].total() + found.anchors.len(), pixels.len());
        prop_assert_eq!(found.anchors.normals.len(), kept.len());
        prop_assert!(found.anchors.positions.iter().flatten().all(|x| x.is_finite()));
        prop_assert!(found.anchors.normals.iter().all(|&n| (Vec3::from(n).length() - 1.0).abs() < 1e-6));
    }
}

#[test]
fn views_follow_each_other_and_what_is_dropped_leaves_no_gap() {
    let image = |shade: f32| {
        Image::new(40, 30, (0..PIXELS * 3).map(|i| shade + i as f32).collect()).expect("sizes fit")
    };
    let images = [image(0.0), image(0.25), image(0.5)];
    let map = FeatureMap::new(2, 40, 30, (0..2 * PIXELS).map(|i| i as f32).collect()).unwrap();
    let camera = camera();
    let mut depths = vec![2.0; PIXELS];
    (0..PIXELS).step_by(3).for_each(|i| depths[i] = -1.0);
    let all = every_pixel();
    let pixels: [&[u32]; 3] = [&all, &[], &[7, 3, 7, 8, 9]];
    let views: Vec<ViewPixels> = (0..3)
        .map(|i| ViewPixels {
            camera: &camera,
            depth: &depths,
            pixels: pixels[i],
            image: Some(&images[i]),
            features: Some(&map),
        })
        .collect();
    let found = anchors(&views, &Settings::default()).unwrap();
    assert_eq!(found.ranges, [0..800, 800..800, 800..803]);
    assert_eq!(found.dropped.iter().map(|d| d.negative).collect::<Vec<_>>(), [400, 0, 2]);
    let found = found.anchors;
    assert_eq!(&found.pixels[800..], [7, 7, 8]);
    assert_eq!((&found.views[799..], found.len(), found.channels), (&[0, 2, 2, 2][..], 803, 2));
    for i in 0..found.len() {
        let pixel = found.pixels[i] as f32;
        let shade = 0.25 * found.views[i] as f32;
        assert_eq!(found.colours[i], [0.0, 1.0, 2.0].map(|c| shade + (3.0 * pixel + c)));
        assert_eq!(found.features[2 * i..2 * i + 2], [pixel, pixel + 1200.0]);
        assert_eq!((found.depths[i], found.normals[i]), (2.0, [0.0, 0.0, -1.0]));
    }
}

#[test]
fn nothing_is_computed_that_is_not_asked_for() {
    let (camera, depths) = (camera(), vec![1.0; PIXELS]);
    let settings = Settings { normals: None, ..Settings::default() };
    let found = anchors(&[view(&camera, &depths, &[5, 6])], &settings).unwrap().anchors;
    assert_eq!((found.len(), found.is_empty()), (2, false));
    assert!(found.normals.is_empty() && found.colours.is_empty() && found.features.is_empty());
    assert_eq!((found.channels, found.footprints[0]), (0, (1.0 / (90.0f64 * 75.0).sqrt()) as f32));
}

#[test]
fn threads_change_no_bit() {
    let camera = camera();
    let depth = depth_map(|ray| 2.0 + (9.0 * ray.x).sin() * (7.0 * ray.y).cos());
    let map = FeatureMap::new(5, 17, 11, (0..5 * 17 * 11).map(|i| (i as f32).sin()).collect()).unwrap();
    let image = Image::new(40, 30, (0..PIXELS * 3).map(|i| i as f32).collect()).unwrap();
    let pixels = every_pixel();
    let view = ViewPixels { image: Some(&image), features: Some(&map), ..view(&camera, &depth, &pixels) };
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| anchors(&[view; 4], &Settings::default()).unwrap())
    };
    let found = with(1);
    assert_eq!(found.anchors.len(), 4 * PIXELS);
    assert_eq!(with(3), found);
}

#[test]
fn what_the_lens_sees_is_where_it_should_be() {
    let lens = Intrinsics { fx: 2.0, fy: 2.0, cx: 0.5, cy: 0.5, width: 1, height: 1 };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0)).unwrap();
    let found = crate::anchors_of(view(&camera, &[4.0], &[0])).anchors;
    assert_eq!(found.positions, [[-1.0, -2.0, 1.0]]);
    assert_eq!(found.positions_from(DVec3::new(-1.0, -2.0, 0.5)), [[0.0, 0.0, 0.5]]);
    assert_eq!((found.normals[0], found.rays[0]), ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]));
    assert_eq!(found.footprints, [2.0]);
    assert_eq!(centre(LENS.width), glam::DVec2::new(0.5, 1.5));
}

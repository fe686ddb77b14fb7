use super::{GREY, SKY, body, depth, scene};
use glam::{DVec2, DVec3};
use gs_scene::Distortion;
use scene_sim::{
    Aperture, Exposure, Finish, Pattern, Photograph, Photographs, Primitive, Scene, SensorNoise, Shape, Sky,
    Traced, Trajectory, photograph, photograph_with_light, render_view,
};

pub(super) const BARREL: Distortion = Distortion { k1: -0.2, k2: 0.04, k3: 0.0, p1: 0.003, p2: -0.002 };

/// A sideways walk of 1 m past things to the north.
pub(super) fn plain() -> Photographs {
    Photographs {
        width: 81,
        height: 61,
        field_of_view: 60.0,
        path: Trajectory::Through {
            places: vec![DVec3::new(-0.5, 0.0, 0.0), DVec3::new(0.5, 0.0, 0.0)],
            targets: vec![DVec3::new(-0.5, 4.0, 0.0), DVec3::new(0.5, 4.0, 0.0)],
        },
        count: 5,
        samples: 4,
        distortion: None,
        aperture: None,
        motion_blur: None,
        rolling_shutter: None,
        exposure: None,
        noise: None,
        pose_error: None,
    }
}

/// A wall at y metres, shown as it is, white to the right of x.
pub(super) fn wall(x: f64, y: f64, colour: f32) -> Primitive {
    let shape = Shape::Rectangle { width: 20.0, height: 40.0 };
    let pattern = Pattern::Plain { colour: [colour; 3] };
    let mut wall = body("wall", shape, DVec3::new(x + 10.0, y, 0.0), pattern);
    wall.rotation.x = 90.0;
    wall.material.finish = Finish::Baked;
    wall
}

/// White from x on, black before, at 4 m.
fn edge(x: f64) -> Traced {
    let black = Sky { zenith: [0.0; 3], horizon: [0.0; 3], ground: [0.0; 3], ..SKY };
    Traced::new(&Scene {
        primitives: vec![wall(x, 4.0, 1.0), wall(x - 20.0, 4.0, 0.0)],
        ..Scene::under(black)
    })
    .unwrap()
}

pub(super) fn take(scene: &Traced, photographs: &Photographs, index: usize) -> Photograph {
    photograph(scene, photographs, index, 7).unwrap()
}

fn decode(v: f32) -> f64 {
    let v = f64::from(v);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn linear(photograph: &Photograph, x: usize, y: usize) -> f64 {
    decode(photograph.view.image().pixel(x, y)[1])
}

/// Where the edge is in a row, pixels: as many pixels are white as are to its right.
fn edge_in_row(photograph: &Photograph, y: usize) -> f64 {
    81.0 - (0..81).map(|x| linear(photograph, x, y)).sum::<f64>()
}

/// Pixels of a row that are neither black nor white.
fn grey_in_row(photograph: &Photograph, y: usize) -> usize {
    (0..81).filter(|x| (0.02..0.98).contains(&linear(photograph, *x, y))).count()
}

#[test]
fn a_plain_photograph_has_the_poses_and_depths_of_plain_views() {
    let traced = edge(0.3);
    let photographs = plain();
    let cameras = photographs.path.cameras(photographs.lens().intrinsics, 5).unwrap();
    for (index, camera) in cameras.iter().enumerate() {
        let taken = take(&traced, &photographs, index);
        assert_eq!(taken.view.camera(), camera);
        let view = render_view(&traced, camera, 1, "view", 0).unwrap();
        assert_eq!(taken.view.depth(), view.depth());
        assert_eq!((taken.gains, taken.light.is_none()), ([1.0; 3], true));
        assert!(taken.lens.model.is_pinhole());
    }
    let one = Photographs { count: 1, ..plain() };
    assert!((take(&traced, &one, 0).view.camera().position()).length() < 1e-9);
}

#[test]
fn a_distorted_picture_shows_each_direction_where_the_lens_puts_it() {
    let photographs = Photographs { distortion: Some(BARREL), ..plain() };
    let plate = Shape::Rectangle { width: 30.0, height: 30.0 };
    let mut slanted = body("slanted", plate, DVec3::Y * 5.0, GREY);
    slanted.rotation = DVec3::new(80.0, 0.0, 20.0);
    let traced = Traced::new(&scene(vec![slanted.clone()], None)).unwrap();
    let taken = take(&traced, &photographs, 1);
    let camera = taken.view.camera();
    let normal = {
        let [x, y, z] = slanted.rotation.to_array().map(f64::to_radians);
        glam::DQuat::from_euler(glam::EulerRot::ZYX, z, y, x) * DVec3::Z
    };
    for (i, &found) in depth(&taken.view).data().iter().enumerate() {
        let pixel = DVec2::new((i % 81) as f64 + 0.5, (i / 81) as f64 + 0.5);
        let direction = taken.lens.undistort(pixel).unwrap();
        let ray = camera.to_world(direction.extend(1.0)) - camera.position();
        let expected = (DVec3::Y * 5.0 - camera.position()).dot(normal) / ray.dot(normal);
        assert!((f64::from(found) / expected - 1.0).abs() < 1e-6, "{found} at {pixel}, expected {expected}");
    }
    // Colours follow the same lens: the edge, seen off the axis, row by row.
    let taken = take(&edge(1.2), &Photographs { samples: 16, ..photographs }, 1);
    let camera = taken.view.camera();
    for y in [5, 30, 55] {
        let on_edge = |height: f64| {
            let p = camera.to_camera(DVec3::new(1.2, 4.0, height));
            taken.lens.distort(DVec2::new(p.x / p.z, p.y / p.z))
        };
        // The height at which the edge is seen in the middle of the row, by bisection.
        let (mut low, mut high) = (-4.0, 4.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if on_edge(middle).y > y as f64 + 0.5 { low = middle } else { high = middle }
        }
        let (found, expected) = (edge_in_row(&taken, y), on_edge(low).x);
        assert!((found - expected).abs() < 0.15, "row {y}: edge at {found}, expected {expected}");
    }
}

#[test]
fn a_distortion_that_folds_the_picture_is_an_error() {
    let folded = |k1, k2| {
        let distortion = Some(Distortion { k1, k2, ..Distortion::default() });
        photograph(&edge(0.0), &Photographs { distortion, ..plain() }, 0, 0).unwrap_err().to_string()
    };
    assert_eq!(folded(-2.0, 0.0), "photographs: the distortion has no inverse at pixel (0, 0)");
    // Folds on the way and unfolds again before the border.
    assert!(folded(-6.0, 12.0).contains("no inverse"), "{}", folded(-6.0, 12.0));
}

#[test]
fn an_aperture_blurs_what_is_not_in_focus() {
    let blurred = |focus| {
        let aperture = Some(Aperture { diameter: 0.2, focus });
        take(&edge(0.0), &Photographs { aperture, samples: 64, ..plain() }, 2)
    };
    let sharp = take(&edge(0.0), &plain(), 2);
    assert!(grey_in_row(&blurred(4.0), 30) <= grey_in_row(&sharp, 30) + 1);
    // Circle of confusion: diameter x |depth / focus - 1| x focal length / depth.
    let focal = plain().lens().intrinsics.fx;
    for focus in [1.0f64, 2.0, 40.0] {
        let expected = 0.2 * (4.0 / focus - 1.0).abs() * focal / 4.0;
        let found = grey_in_row(&blurred(focus), 30) as f64;
        assert!(found > 0.75 * expected - 1.0 && found < expected + 2.0, "{found}, expected {expected}");
        assert!((edge_in_row(&blurred(focus), 30) - edge_in_row(&sharp, 30)).abs() < 0.6);
        assert_eq!(depth(&blurred(focus).view), depth(&sharp.view), "depth is that of a pinhole");
    }
}

#[test]
fn what_moves_past_while_the_shutter_is_open_is_blurred() {
    let photographs = Photographs { motion_blur: Some(0.8), samples: 64, ..plain() };
    let sharp = take(&edge(0.0), &plain(), 2);
    let blurred = take(&edge(0.0), &photographs, 2);
    // 0.25 m from picture to picture, 4 m away.
    let expected = 0.8 * 0.25 * photographs.lens().intrinsics.fx / 4.0;
    let found = grey_in_row(&blurred, 30) as f64;
    assert!((found - expected).abs() < 2.0, "{found} grey pixels, expected {expected}");
    assert!(
        (edge_in_row(&blurred, 30) - edge_in_row(&sharp, 30)).abs() < 0.5,
        "the pose is that of the middle"
    );
    assert_eq!(blurred.view.camera(), sharp.view.camera());
    assert_eq!(depth(&blurred.view), depth(&sharp.view));
    // At the start of the path the camera stood still before.
    let first = take(&edge(-0.5), &photographs, 0);
    assert!(grey_in_row(&first, 30) as f64 <= 0.5 * expected + 2.0);
}

#[test]
fn a_wrong_pose_is_stated_of_the_same_picture() {
    let photographs = Photographs { pose_error: Some(0.5), width: 8, height: 6, count: 200, ..plain() };
    let right = Photographs { pose_error: None, ..photographs.clone() };
    let mut squares = 0.0;
    for index in 0..200 {
        let (wrong, right) = (take(&edge(0.0), &photographs, index), take(&edge(0.0), &right, index));
        assert_eq!(wrong.view.image(), right.view.image());
        assert_eq!(depth(&wrong.view), depth(&right.view));
        let (stated, taken) = (wrong.view.camera(), right.view.camera());
        assert_eq!(take(&edge(0.0), &photographs, index).view.camera(), stated);
        assert!((stated.position() - taken.position()).length() < 1e-12);
        let turn = stated.rotation() * taken.rotation().transpose();
        let axis = DVec3::new(turn.y_axis.z, turn.z_axis.x, turn.x_axis.y);
        squares += axis.to_array().map(|sine| sine.asin().to_degrees().powi(2)).iter().sum::<f64>();
    }
    // 600 draws: the root of their mean square is known to 3 %.
    let deviation = (squares / 600.0).sqrt();
    assert!((deviation - 0.5).abs() < 0.05, "{deviation}");
}

#[test]
fn a_rolling_shutter_gives_each_row_its_own_pose() {
    let photographs = Photographs { rolling_shutter: Some(0.9), samples: 16, ..plain() };
    let taken = take(&edge(0.0), &photographs, 2);
    let still = take(&edge(0.0), &plain(), 2);
    assert_eq!(taken.view.camera(), still.view.camera());
    for y in [0, 13, 30, 60] {
        let moved = 0.9 * 0.25 * ((y as f64 + 0.5) / 61.0 - 0.5);
        let expected = 40.5 - moved * photographs.lens().intrinsics.fx / 4.0;
        let found = edge_in_row(&taken, y);
        assert!((found - expected).abs() < 0.15, "row {y}: edge at {found}, expected {expected}");
    }
    // The depth of a slanted wall, in the camera of each row.
    let plate = Shape::Rectangle { width: 30.0, height: 30.0 };
    let mut slanted = body("slanted", plate, DVec3::Y * 4.0, GREY);
    slanted.rotation = DVec3::new(90.0, 0.0, 45.0);
    let traced = Traced::new(&scene(vec![slanted], None)).unwrap();
    let taken = take(&traced, &photographs, 2);
    for y in [0, 30, 60] {
        let x = 0.9 * 0.25 * ((y as f64 + 0.5) / 61.0 - 0.5);
        let found = f64::from(depth(&taken.view).data()[y * 81 + 40]);
        assert!((found - (4.0 + x)).abs() < 1e-5, "row {y}: {found}");
    }
    // With an open time besides, the edge is where it was, and wider.
    let both = Photographs { motion_blur: Some(0.5), samples: 64, ..photographs };
    let both = take(&edge(0.0), &both, 2);
    for y in [2, 30, 58] {
        let moved = 0.9 * 0.25 * ((y as f64 + 0.5) / 61.0 - 0.5);
        let expected = 40.5 - moved * plain().lens().intrinsics.fx / 4.0;
        assert!((edge_in_row(&both, y) - expected).abs() < 0.3, "row {y}");
        assert!(grey_in_row(&both, y) >= 2);
    }
}

/// All the picture a wall of one grey.
pub(super) fn grey_wall(grey: f32) -> Traced {
    Traced::new(&Scene { primitives: vec![wall(-10.0, 4.0, grey)], ..Scene::under(SKY) }).unwrap()
}

#[test]
fn exposure_and_white_balance_multiply_linear_light() {
    let exposure = Some(Exposure { stops: 0.3, white_balance: 0.1 });
    let photographs = Photographs { exposure, count: 200, ..plain() };
    let traced = grey_wall(0.4);
    let small = Photographs { width: 3, height: 2, ..photographs };
    let light = decode(0.4);
    let mut greens = Vec::new();
    for index in 0..200 {
        let taken = photograph_with_light(&traced, &small, index, 3).unwrap();
        let pixel = taken.view.image().pixel(1, 1).map(decode);
        for (c, (value, gain)) in pixel.iter().zip(taken.gains).enumerate() {
            let expected = light * f64::from(gain);
            assert!((value / expected.min(1.0) - 1.0).abs() < 1e-4, "{value}, expected {expected} in {c}");
        }
        let kept = taken.light.unwrap();
        assert!(kept.data().iter().all(|v| (f64::from(*v) / light - 1.0).abs() < 1e-4));
        greens.push(f64::from(taken.gains[1]).log2());
    }
    let deviation = (greens.iter().map(|g| g * g).sum::<f64>() / 200.0).sqrt();
    // The standard error is 5 %.
    assert!((deviation / 0.3 - 1.0).abs() < 0.25, "standard deviation {deviation}");
}

#[test]
fn sensor_noise_has_the_deviation_of_its_photons_and_differs_from_picture_to_picture() {
    let noise = Some(SensorNoise { full_well: 1000.0, read: 20.0 });
    let photographs = Photographs { noise, samples: 1, ..plain() };
    let traced = grey_wall(0.6);
    let values = |index, seed| {
        let taken = photograph(&traced, &photographs, index, seed).unwrap();
        taken.view.image().data().iter().map(|v| decode(*v)).collect::<Vec<f64>>()
    };
    let (one, other) = (values(0, 1), values(1, 1));
    let light = decode(0.6);
    let n = one.len() as f64;
    let mean = one.iter().sum::<f64>() / n;
    let deviation = (one.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    let expected = (light * 1000.0 + 400.0).sqrt() / 1000.0;
    // Standard errors: 0.0003 and 0.6 %.
    assert!((mean - light).abs() < 0.0015, "mean {mean} of {light}");
    assert!((deviation / expected - 1.0).abs() < 0.03, "deviation {deviation}, expected {expected}");
    let together = one.iter().zip(&other).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>() / n;
    assert!((together / deviation.powi(2)).abs() < 0.04, "pictures share noise: {together}");
    assert!(one == values(0, 1) && one != values(0, 2));
}

//! Single ellipsoids, and pairs, of which one knows how they look.

use super::{Accuracy, GOOD, LENS, bits, difference, draw, lens, one, solid};
use glam::{DMat3, DVec3};
use gs_raster::{ELLIPSOID_OPACITY_MIN, Error, Rasterizer, RenderSettings, Rendering};
use gs_reference::Profile;
use gs_reference::tolerance::F32_ELLIPSOID;
use gs_scene::{Camera, Gaussians, Intrinsics, dc_from_rgb};

/// All of them that need no accuracy.
pub(super) const CASES: [fn(&mut Rasterizer); 7] = [
    a_ball_is_a_disc,
    the_nearest_front_is_seen_not_the_nearest_centre,
    of_equal_ones_the_first_is_seen,
    what_is_fainter_than_the_limit_is_not_drawn,
    what_is_no_gaussian_is_left_out_and_counted,
    there_are_no_gradients,
    what_is_not_asked_for_is_not_there,
];

fn is_background(view: &Rendering) -> bool {
    view.alpha.iter().all(|&alpha| alpha == 0.0)
}

/// On the camera's axis the projection of a ball is a disc, and its front a hemisphere as wide as the low-pass filter makes it.
fn a_ball_is_a_disc(rasterizer: &mut Rasterizer) {
    let (z, radius) = (2.5, 0.75f64);
    let mut row = GOOD;
    row[..3].copy_from_slice(&[0.0, 0.0, z as f32]);
    row[7..10].fill(radius.ln() as f32);
    let profile = Profile::default();
    let view = draw(rasterizer, &one(row), &lens(), &profile);
    let depth = view.depth.as_ref().expect("asked for");
    let square = (LENS.fx * radius / z).powi(2) + profile.eps2d;
    let mut dimmest = 1.0f32;
    for (at, depth) in depth.iter().enumerate() {
        let (dx, dy) = ((at % LENS.width) as f64 - 20.0, (at / LENS.width) as f64 - 15.0);
        let place = (dx * dx + dy * dy) / square;
        assert_eq!(view.alpha[at] == 1.0, place < 1.0, "{dx} {dy}");
        if place < 1.0 {
            let expected = z - radius * (1.0 - place).sqrt();
            assert!((f64::from(*depth) - expected).abs() < F32_ELLIPSOID * z, "{dx} {dy}: {depth}");
            // Light changes how bright a colour is, not which.
            let [red, green, blue] = [0, 1, 2].map(|channel| view.image.data()[3 * at + channel]);
            assert!((red - 2.0 * green).abs() < 1e-6 && (green - 2.0 * blue).abs() < 1e-6);
            dimmest = dimmest.min(red);
        }
    }
    // The lamp is at the camera: full brightness where the front faces it, the least at the rim.
    assert!((view.image.data()[3 * (15 * LENS.width + 20)] - 1.0).abs() < 1e-6);
    assert!((0.3..0.5).contains(&dimmest), "{dimmest}");
    assert_eq!((view.stats.visible, view.stats.rejected), (1, 0));
}

fn the_nearest_front_is_seen_not_the_nearest_centre(rasterizer: &mut Rasterizer) {
    let ball = |z: f32, radius: f32| {
        let mut row = GOOD;
        row[..3].copy_from_slice(&[0.0, 0.0, z]);
        row[7..10].fill(radius.ln());
        row
    };
    for rows in [[ball(3.0, 1.5), ball(2.0, 0.1)], [ball(2.0, 0.1), ball(3.0, 1.5)]] {
        let scene = Gaussians::new(0, rows.concat(), vec![0.5; 6]).expect("valid");
        let depth = draw(rasterizer, &scene, &lens(), &Profile::default()).depth.expect("asked for");
        assert!((depth[15 * LENS.width + 20] - 1.5).abs() < 1e-5);
    }
}

fn of_equal_ones_the_first_is_seen(rasterizer: &mut Rasterizer) {
    let colours = [dc_from_rgb([0.9, 0.1, 0.1]), dc_from_rgb([0.1, 0.9, 0.1])];
    for [first, second] in [colours, [colours[1], colours[0]]] {
        let both = Gaussians::new(0, GOOD.repeat(2), [first, second].concat()).expect("valid");
        let alone = Gaussians::new(0, GOOD.to_vec(), first.to_vec()).expect("valid");
        let [both, alone] = [both, alone].map(|scene| draw(rasterizer, &scene, &lens(), &Profile::default()));
        assert_eq!(bits(&both), bits(&alone));
    }
}

/// Where a ball and a disc before its centre have the same depth, to the last bit. Not of a GPU, which may round otherwise.
pub(super) fn of_equal_fronts_that_of_the_nearer_centre_is_seen(cpu: &mut Rasterizer) {
    let row = |z: f32, scale: [f32; 3]| -> [f32; 11] {
        [0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0, scale[0], scale[1], scale[2], 1.0]
    };
    let ball = (row(3.0, [0.0; 3]), dc_from_rgb([0.9, 0.1, 0.1]));
    let disc = (row(2.0, [-1.0, -1.0, -200.0]), dc_from_rgb([0.1, 0.9, 0.1]));
    for [first, second] in [[ball, disc], [disc, ball]] {
        let scene = Gaussians::new(0, [first.0, second.0].concat(), [first.1, second.1].concat());
        let view = draw(cpu, &scene.expect("valid"), &lens(), &Profile::default());
        let at = 15 * LENS.width + 20;
        assert_eq!(view.depth.expect("asked for")[at], 2.0);
        assert!(
            (view.image.data()[3 * at + 1] - 0.9).abs() < 1e-6,
            "{:?}",
            &view.image.data()[3 * at..][..3]
        );
    }
}

fn what_is_fainter_than_the_limit_is_not_drawn(rasterizer: &mut Rasterizer) {
    let limit = f64::from(ELLIPSOID_OPACITY_MIN);
    let logit = (limit / (1.0 - limit)).ln() as f32;
    for (by, expected) in [(-1e-3, true), (1e-3, false)] {
        let mut row = GOOD;
        row[10] = logit + by;
        let view = draw(rasterizer, &one(row), &lens(), &Profile::default());
        assert_eq!(is_background(&view), expected, "{by}");
    }
    // How opaque it is beyond that changes nothing.
    let with = |logit: f32| [&GOOD[..10], &[logit]].concat().try_into().expect("11 numbers");
    let [a, b] = [0.0, 9.0].map(|logit| draw(rasterizer, &one(with(logit)), &lens(), &Profile::default()));
    assert_eq!(bits(&a), bits(&b));
    // One that is smaller than a pixel counts with the opacity that antialiasing leaves it.
    let mut small = GOOD;
    small[7..10].fill(-5.0);
    for (antialias, expected) in [(false, false), (true, true)] {
        let view = draw(rasterizer, &one(small), &lens(), &Profile { antialias, ..Profile::default() });
        assert_eq!(is_background(&view), expected, "antialias {antialias}");
    }
}

fn what_is_no_gaussian_is_left_out_and_counted(rasterizer: &mut Rasterizer) {
    let not_finite = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let mut rejected = Vec::new();
    for (column, bad) in
        (0..11).flat_map(|column| not_finite.map(|bad| (column, bad))).chain([(7, 88.8), (8, f32::MAX)])
    {
        let mut row = GOOD;
        row[column] = bad;
        rejected.push(row);
    }
    let mut zero = GOOD;
    zero[3..7].fill(0.0);
    rejected.push(zero);
    for row in rejected {
        let view = draw(rasterizer, &one(row), &lens(), &Profile::default());
        assert!(is_background(&view), "{row:?}");
        assert_eq!((view.stats.visible, view.stats.rejected), (0, 1), "{row:?}");
    }
    for bad in not_finite {
        let scene = Gaussians::new(0, GOOD.to_vec(), vec![0.5, bad, 0.5]).expect("valid");
        let view = draw(rasterizer, &scene, &lens(), &Profile::default());
        assert!(is_background(&view) && view.stats.rejected == 1, "{bad}");
    }
    let view = draw(rasterizer, &Gaussians::empty(3).expect("valid"), &lens(), &Profile::default());
    assert!(is_background(&view) && view.stats.visible == 0);
}

/// Rows that are Gaussians, but barely; how many of the pixels they must at least fill.
fn extreme() -> Vec<(&'static str, [f32; 11], usize)> {
    let with = |columns: &[(usize, f32)]| {
        let mut row = GOOD;
        columns.iter().for_each(|&(column, value)| row[column] = value);
        row
    };
    let ball = |z: f32, log_scale: f32| with(&[(2, z), (7, log_scale), (8, log_scale), (9, log_scale)]);
    let straight =
        |scale: [f32; 3]| with(&[(4, 0.0), (5, 0.0), (6, 0.0), (7, scale[0]), (8, scale[1]), (9, scale[2])]);
    vec![
        ("flat and turned", with(&[(9, -200.0)]), 40),
        ("flat and facing", straight([-1.0, -1.0, -200.0]), 100),
        ("flat and edge-on", straight([-200.0, -1.0, -1.0]), 10),
        ("a line", with(&[(8, -200.0), (9, -200.0)]), 3),
        ("a point", ball(2.0, -200.0), 0),
        ("a needle", with(&[(7, 3.0), (8, -9.0), (9, -9.0)]), 20),
        ("a needle along the ray", straight([-9.0, -9.0, -0.5]), 0),
        ("a floor", with(&[(7, 4.0), (8, 4.0), (9, -8.0)]), 400),
        ("around the camera", ball(2.0, 1.5), 0),
        ("as large as f32 allows", ball(2.0, 88.7), 0),
        ("flat and as large as f32 allows", straight([88.7, 88.7, -3.0]), LENS.width * LENS.height),
        ("before the near plane", ball(0.21, -5.0), 0),
        ("behind the camera", ball(-2.0, 0.5), 0),
        ("beyond the border", with(&[(0, 4.0), (7, 0.5)]), 0),
        ("a small quaternion", with(&[(3, 1e-20), (4, 0.0), (5, 2e-20), (6, 0.0)]), 40),
    ]
}

pub(super) fn what_is_barely_a_gaussian_is_where_it_should_be(
    rasterizer: &mut Rasterizer,
    accuracy: &Accuracy,
) {
    let pixel = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5, width: 1, height: 1 };
    let pixel = Camera::new(pixel, DMat3::IDENTITY, DVec3::ZERO).expect("valid");
    let profile = Profile::default();
    for (name, row, least) in extreme() {
        let found = difference(rasterizer, &one(row), &lens(), &profile, accuracy)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(found > LENS.width * LENS.height / 2, "{name}: {found} pixels to compare");
        let view = draw(rasterizer, &one(row), &lens(), &profile);
        let drawn = view.alpha.iter().filter(|&&alpha| alpha == 1.0).count();
        assert!(drawn >= least, "{name}: {drawn} pixels");
        if let Err(error) = difference(rasterizer, &one(row), &pixel, &profile, accuracy) {
            panic!("{name} in a single pixel: {error}");
        }
    }
}

fn there_are_no_gradients(rasterizer: &mut Rasterizer) {
    let error = rasterizer.record(&one(GOOD), &[lens()], &solid(&Profile::default()));
    assert!(matches!(error, Err(Error::NotBlended)), "{error:?}");
}

fn what_is_not_asked_for_is_not_there(rasterizer: &mut Rasterizer) {
    let with = solid(&Profile::default());
    let a = rasterizer.render(&one(GOOD), &lens(), &with).expect("valid");
    let b = rasterizer.render(&one(GOOD), &lens(), &RenderSettings { depth: false, ..with }).expect("valid");
    assert!(b.depth.is_none());
    assert_eq!((a.image, a.alpha), (b.image, b.alpha));
}

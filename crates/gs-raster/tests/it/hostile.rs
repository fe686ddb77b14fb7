//! Input that breaks renderers: every result is finite and defined.

use crate::check::settings;
use crate::scenes::render;
use glam::{DMat3, DVec3};
use gs_raster::{Error, PixelGradients, Rasterizer, RenderSettings, Rendering};
use gs_reference::tolerance::{AMBIGUOUS, f32_bound};
use gs_reference::{Profile, compare};
use gs_scene::{Camera, Gaussians, Intrinsics};
use proptest::prelude::*;

const LENS: Intrinsics = Intrinsics { fx: 30.0, fy: 28.0, cx: 13.0, cy: 9.0, width: 27, height: 18 };

fn camera() -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("valid")
}

fn draw(scene: &Gaussians) -> Rendering {
    let view = render(scene, &camera(), &settings(&Profile::default(), [0.1, 0.2, 0.3])).expect("valid");
    let all = view.image.data().iter().chain(&view.alpha).chain(view.depth.iter().flatten());
    assert!(all.into_iter().all(|value| value.is_finite()), "not finite");
    view
}

fn is_background(view: &Rendering) -> bool {
    view.image.data().chunks_exact(3).all(|pixel| pixel == [0.1, 0.2, 0.3])
        && view.alpha.iter().all(|&a| a == 0.0)
}

/// A row of geometry that is drawn: mean, quaternion, log scale, logit.
const GOOD: [f32; 11] = [0.1, 0.1, 2.0, 1.0, 0.2, 0.1, 0.3, -1.5, -1.0, -2.0, 1.0];

fn one(row: [f32; 11]) -> Gaussians {
    Gaussians::new(0, row.to_vec(), vec![0.5, 0.1, -0.2]).expect("valid")
}

fn with(column: usize, value: f32) -> [f32; 11] {
    let mut row = GOOD;
    row[column] = value;
    row
}

#[test]
fn no_gaussians_are_the_background() {
    for degree in 0..4 {
        let view = draw(&Gaussians::empty(degree).unwrap());
        assert!(is_background(&view));
        assert_eq!((view.stats.visible, view.stats.rejected, view.stats.intersections), (0, 0, 0));
    }
    assert!(!is_background(&draw(&one(GOOD))));
}

#[test]
fn what_is_not_finite_is_left_out_and_counted() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for column in 0..11 {
            let view = draw(&one(with(column, bad)));
            assert!(is_background(&view), "column {column} = {bad}");
            assert_eq!((view.stats.visible, view.stats.rejected), (0, 1), "column {column} = {bad}");
        }
        let colour = Gaussians::new(0, GOOD.to_vec(), vec![0.5, bad, 0.5]).unwrap();
        let view = draw(&colour);
        assert!(is_background(&view) && view.stats.rejected == 1);
    }
}

#[test]
fn zero_quaternions_and_overflowing_scales_are_left_out_and_counted() {
    let mut zero = GOOD;
    zero[3..7].fill(0.0);
    let view = draw(&one(zero));
    assert!(is_background(&view) && view.stats.rejected == 1);
    for huge in [88.8, 800.0, 1e4, f32::MAX] {
        let view = draw(&one(with(7, huge)));
        assert!(is_background(&view) && view.stats.rejected == 1, "log scale {huge}");
    }
    // Denormal and enormous quaternions are directions like any other.
    for norm in [1e-40f32, 1e-20, 1e18, 1e38] {
        let mut row = GOOD;
        row[3..7].copy_from_slice(&[norm, 0.0, 0.0, 0.0]);
        let mut unit = GOOD;
        unit[3..7].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        assert_eq!(draw(&one(row)).image, draw(&one(unit)).image, "norm {norm}");
    }
}

#[test]
fn logits_saturate() {
    assert!(is_background(&draw(&one(with(10, -1e4)))));
    let opaque = draw(&one(with(10, 1e4)));
    let peak = opaque.alpha.iter().copied().fold(0.0, f32::max);
    assert!(peak > 0.98 && peak <= 0.99, "{peak}");
}

#[test]
fn huge_gaussians_cover_the_image() {
    for log_scale in [10.0, 69.0, 88.0] {
        let mut row = GOOD;
        row[7..10].fill(log_scale);
        let view = draw(&one(row));
        let opacity = 1.0 / (1.0 + (-1.0f32).exp());
        let deviation = compare(vec![opacity; 27 * 18], view.alpha, &[]).unwrap();
        assert!(deviation.max_abs <= f32_bound(&deviation, None), "{log_scale}: {deviation:?}");
    }
}

#[test]
fn gaussians_at_behind_and_around_the_camera_are_near_culled() {
    for z in [0.0, -0.0, 1e-40, 0.1, 0.2, -1.0, -1e30] {
        let mut row = with(2, z);
        row[7..10].fill(1.0);
        let view = draw(&one(row));
        assert!(is_background(&view), "z = {z}");
        assert_eq!(view.stats.rejected, 0);
    }
    assert!(!is_background(&draw(&one(with(2, 0.21)))));
    let at_far = RenderSettings { far: 2.0, ..RenderSettings::default() };
    assert_eq!(render(&one(GOOD), &camera(), &at_far).unwrap().stats.visible, 0);
    // With a near plane of 0 a Gaussian may all but touch the camera.
    for z in [1e-40f32, 1e-20, 1e-3] {
        let view =
            render(&one(with(2, z)), &camera(), &RenderSettings { near: 0.0, ..RenderSettings::default() });
        assert!(view.expect("valid").image.data().iter().all(|value| value.is_finite()), "z = {z}");
    }
}

#[test]
fn an_impossible_number_of_intersections_is_an_error() {
    let lens = Intrinsics { width: 16_000, height: 16_000, ..LENS };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
    let mut row = GOOD;
    row[7..10].fill(20.0);
    let scene = Gaussians::new(0, row.repeat(300), vec![0.0; 900]).unwrap();
    match render(&scene, &camera, &RenderSettings::default()) {
        Err(Error::TooManyIntersections { found: 300_000_000, .. }) => {}
        other => panic!("{:?}", other.map(|view| view.stats)),
    }
}

#[test]
fn a_setting_out_of_range_is_an_error() {
    let settings = RenderSettings { near: f32::NAN, ..RenderSettings::default() };
    assert!(matches!(render(&one(GOOD), &camera(), &settings), Err(Error::Setting { name: "near", .. })));
}

/// Numbers that break things, and ordinary ones.
pub(crate) fn hostile() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -3.0..3.0f32,
        1 => prop::sample::select(vec![
            0.0, -0.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40, -1e-40, f32::MIN_POSITIVE, 1e30, -1e30, 3e38,
            -3e38, 1e4, -1e4, 88.7, -88.7,
        ]),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]
    #[test]
    fn any_bits_give_a_finite_picture_and_do_not_disturb_their_neighbours(
        rows in prop::collection::vec((prop::array::uniform11(hostile()), prop::array::uniform3(hostile())), 1..6),
    ) {
        let geometry = rows.iter().flat_map(|row| row.0).collect();
        let sh = rows.iter().flat_map(|row| row.1).collect();
        let scene = Gaussians::new(0, geometry, sh).expect("valid");
        let view = draw(&scene);
        let total = view.stats.visible + view.stats.rejected;
        prop_assert!(total <= scene.len());

        // The reference draws the same, unless a centre lies farther off than any footprint here reaches.
        let near = |row: &[f32; 11]| row[..2].iter().all(|value| !value.is_finite() || value.abs() < 1e6);
        let truth = gs_reference::render(&scene, &camera(), [0.1, 0.2, 0.3].map(f64::from), &Profile::default());
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        if rows.iter().all(|row| near(&row.0)) && ambiguous.contains(&false) {
            let alpha = compare(truth.alpha, view.alpha, &ambiguous).expect("valid");
            prop_assert!(alpha.max_abs <= f32_bound(&alpha, None), "{:?}", alpha);
        }
    }

    #[test]
    fn any_bits_give_finite_gradients(
        rows in hostile_rows(),
        pixels in prop::collection::vec(hostile(), 16),
        antialias: bool,
        near in prop::sample::select(vec![0.0f32, 0.2]),
    ) {
        finite_gradients(&mut Rasterizer::cpu(), &rows, &pixels, antialias, near)?;
    }
}

#[test]
fn extreme_pixel_gradients_scale_the_result_and_no_more() {
    let gradients = |value: f32| {
        let mut rasterizer = Rasterizer::cpu();
        let (_, tape) =
            rasterizer.record(&one(GOOD), &[camera()], &RenderSettings::default()).expect("valid");
        let pixels = PixelGradients { image: vec![value; 27 * 18 * 3].into(), alpha: None, depth: None };
        rasterizer.backward(&one(GOOD), &tape, &[pixels]).expect("valid").geometry
    };
    let unit = gradients(1.0);
    assert!(unit.iter().any(|&value| value != 0.0));
    for exponent in [-100, 90] {
        let factor = f64::from(exponent).exp2() as f32;
        assert_eq!(gradients(factor), unit.iter().map(|value| value * factor).collect::<Vec<f32>>());
    }
    assert!(gradients(f32::MAX).iter().all(|value| value.is_finite()));
    assert!(gradients(0.0).iter().all(|&value| value == 0.0));
}

/// A Gaussian of SH degree 1: geometry and coefficients.
pub(crate) type HostileRow = ([f32; 11], [f32; 12]);

pub(crate) fn hostile_rows() -> impl Strategy<Value = Vec<HostileRow>> {
    prop::collection::vec((prop::array::uniform11(hostile()), prop::array::uniform12(hostile())), 1..6)
}

/// Whether picture and gradients of a scene are finite, given some of the pixels' gradients.
pub(crate) fn finite_gradients(
    rasterizer: &mut Rasterizer,
    rows: &[HostileRow],
    pixels: &[f32],
    antialias: bool,
    near: f32,
) -> Result<(), TestCaseError> {
    let geometry: Vec<f32> = rows.iter().flat_map(|row| row.0).collect();
    let sh: Vec<f32> = rows.iter().flat_map(|row| row.1).collect();
    let scene = Gaussians::new(1, geometry, sh).expect("valid");
    let settings = RenderSettings { depth: true, antialias, near, ..RenderSettings::default() };
    let (views, tape) = rasterizer.record(&scene, &[camera()], &settings).expect("valid");
    prop_assert!(views[0].depth.iter().flatten().chain(views[0].image.data()).all(|value| value.is_finite()));
    let plane = |length: usize| -> Vec<f32> {
        (0..length)
            .map(|i| pixels[(i * 7) % 16])
            .map(|value| if value.is_finite() { value } else { 1.0 })
            .collect()
    };
    let size = 27 * 18;
    let pixels =
        PixelGradients { image: plane(size * 3).into(), alpha: Some(plane(size)), depth: Some(plane(size)) };
    let found = rasterizer.backward(&scene, &tape, &[pixels]).expect("valid");
    prop_assert!(found.geometry.iter().chain(&found.sh).all(|value| value.is_finite()));
    let pose = found.cameras[0];
    prop_assert!(pose.rotation.is_finite() && pose.translation.is_finite() && pose.focal.is_finite());
    prop_assert!(found.background.iter().all(|value| value.is_finite()));
    for (row, by) in rows.iter().zip(found.geometry.chunks_exact(11)) {
        if row.0.iter().chain(&row.1).any(|value| !value.is_finite()) || row.0[2] <= 0.0 {
            prop_assert!(by.iter().all(|&value| value == 0.0));
        }
    }
    Ok(())
}

//! Ellipsoid views against their definition in f64, and what must hold of them, on the CPU and on a GPU.

mod cases;

use crate::check::settings;
use crate::scenes::{camera, gaussians};
use cases::{
    CASES, of_equal_fronts_that_of_the_nearer_centre_is_seen, what_is_barely_a_gaussian_is_where_it_should_be,
};
use glam::{DMat3, DVec3};
use gs_raster::{
    ELLIPSOID_OPACITY_MIN, ELLIPSOID_SIGMA, Error, Rasterizer, RenderSettings, Rendering, Style,
};
use gs_reference::tolerance::{AMBIGUOUS, f32_bound};
use gs_reference::{Deviation, Profile, Solid, compare, render_ellipsoids};
use gs_scene::{Camera, Gaussians, Intrinsics, dc_from_rgb};
use proptest::prelude::*;

const BACKGROUND: [f32; 3] = [0.2, 0.5, 0.9];
const LENS: Intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 20.5, cy: 15.5, width: 41, height: 31 };
/// Drawn: mean, quaternion, log scale, logit.
const GOOD: [f32; 11] = [0.1, 0.1, 2.0, 1.0, 0.2, 0.1, 0.3, -1.5, -1.0, -2.0, 1.0];

/// What a device may deviate by.
struct Accuracy {
    /// Pixels with less of a margin are left out.
    margin: f64,
    bound: fn(&Deviation) -> f64,
}

/// f64 until a pixel is written.
const CPU: Accuracy = Accuracy { margin: AMBIGUOUS, bound: |deviation| f32_bound(deviation, None) };

fn solid(profile: &Profile) -> RenderSettings {
    RenderSettings { style: Style::Ellipsoids, ..settings(profile, BACKGROUND) }
}

fn lens() -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("valid")
}

fn one(row: [f32; 11]) -> Gaussians {
    Gaussians::new(0, row.to_vec(), dc_from_rgb([1.0, 0.5, 0.25]).to_vec()).expect("valid")
}

/// A view whose numbers are all finite, and whose three planes agree on where something is drawn.
fn draw(rasterizer: &mut Rasterizer, scene: &Gaussians, camera: &Camera, profile: &Profile) -> Rendering {
    let view = rasterizer.render(scene, camera, &solid(profile)).expect("valid");
    let depth = view.depth.as_ref().expect("asked for");
    assert!(view.image.data().iter().all(|value| value.is_finite()));
    for ((&alpha, &depth), pixel) in view.alpha.iter().zip(depth).zip(view.image.data().chunks_exact(3)) {
        if alpha == 0.0 {
            assert!(depth == 0.0 && pixel == BACKGROUND, "{depth} {pixel:?}");
        } else {
            assert!(alpha == 1.0 && f64::from(depth) > profile.near && f64::from(depth) < profile.far);
        }
    }
    view
}

fn bits(view: &Rendering) -> Vec<u32> {
    let depth = view.depth.iter().flatten();
    view.image.data().iter().chain(&view.alpha).chain(depth).map(|value| value.to_bits()).collect()
}

/// What is wrong with a view, if the definition leaves pixels to compare; how many there are.
fn difference(
    rasterizer: &mut Rasterizer,
    scene: &Gaussians,
    camera: &Camera,
    profile: &Profile,
    accuracy: &Accuracy,
) -> Result<usize, String> {
    let drawn = Solid { sigma: ELLIPSOID_SIGMA.into(), opacity_min: ELLIPSOID_OPACITY_MIN.into() };
    let truth = render_ellipsoids(scene, camera, BACKGROUND.map(f64::from), profile, drawn);
    let view = draw(rasterizer, scene, camera, profile);
    let masked: Vec<bool> = truth.margin.iter().map(|&margin| margin < accuracy.margin).collect();
    let compared = masked.iter().filter(|&&masked| !masked).count();
    let depth = view.depth.expect("asked for");
    let planes = [
        ("image", truth.image, view.image.data()),
        ("alpha", truth.alpha, &view.alpha),
        ("depth", truth.depth, &depth),
    ];
    for (output, expected, found) in planes.into_iter().filter(|_| compared > 0) {
        let deviation =
            compare(expected, found.iter().copied(), &masked).map_err(|error| error.to_string())?;
        if deviation.max_abs > (accuracy.bound)(&deviation) {
            return Err(format!("{output}: {deviation:?}"));
        }
    }
    Ok(compared)
}

/// Numbers that break things, and ordinary ones.
fn hostile() -> impl Strategy<Value = f32> {
    let special = vec![
        0.0,
        -0.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e-40,
        -1e-40,
        f32::MIN_POSITIVE,
        1e30,
        -1e30,
        3e38,
        -3e38,
        1e4,
        -1e4,
        88.7,
        -88.7,
    ];
    prop_oneof![4 => -3.0..3.0f32, 1 => prop::sample::select(special)]
}

fn hostile_scenes() -> impl Strategy<Value = Gaussians> {
    let row = (prop::array::uniform11(hostile()), prop::array::uniform3(hostile()));
    prop::collection::vec(row, 1..6).prop_map(|rows| {
        let geometry = rows.iter().flat_map(|row| row.0).collect();
        Gaussians::new(0, geometry, rows.iter().flat_map(|row| row.1).collect()).expect("valid")
    })
}

mod on_the_cpu {
    use super::*;

    #[test]
    fn cases() {
        CASES.iter().for_each(|case| case(&mut Rasterizer::cpu()));
        of_equal_fronts_that_of_the_nearer_centre_is_seen(&mut Rasterizer::cpu());
    }

    #[test]
    fn extreme_cases() {
        what_is_barely_a_gaussian_is_where_it_should_be(&mut Rasterizer::cpu(), &CPU);
    }

    #[test]
    fn an_impossible_number_of_intersections_is_an_error() {
        let lens = Intrinsics { width: 16_000, height: 16_000, ..LENS };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid");
        let mut row = GOOD;
        row[7..10].fill(20.0);
        let scene = Gaussians::new(0, row.repeat(300), vec![0.0; 900]).expect("valid");
        match Rasterizer::cpu().render(&scene, &camera, &solid(&Profile::default())) {
            Err(Error::TooManyIntersections { found: 300_000_000, .. }) => {}
            other => panic!("{:?}", other.map(|view| view.stats)),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(512))]

        #[test]
        fn views_equal_the_definition(scene in gaussians(40), camera in camera(), antialias: bool) {
            let profile = Profile { antialias, ..Profile::default() };
            let found = difference(&mut Rasterizer::cpu(), &scene, &camera, &profile, &CPU);
            prop_assert!(found.is_ok(), "{found:?}");
        }

        #[test]
        fn any_bits_are_drawn_by_the_definition(scene in hostile_scenes()) {
            let (cpu, profile) = (&mut Rasterizer::cpu(), Profile::default());
            draw(cpu, &scene, &lens(), &profile);
            // Of axes of 1e38 units nothing is left in f64 of what is as thin as a pixel, not in the definition either.
            let mut log_scales = scene.geometry().chunks_exact(11).flat_map(|row| &row[7..10]);
            if !log_scales.any(|&log_scale| log_scale > 10.0) {
                let found = difference(cpu, &scene, &lens(), &profile, &CPU);
                prop_assert!(found.is_ok(), "{found:?}");
            }
        }

        #[test]
        fn neither_threads_nor_the_order_of_the_scene_change_a_bit(
            scene in gaussians(60), camera in camera(), seed in 0usize..1000,
        ) {
            let mut order: Vec<usize> = (0..scene.len()).collect();
            order.sort_by_key(|i| (i * 7727 + seed * 31) % 1009);
            let other = crate::properties::permuted(&scene, &order);
            let on = |threads, scene: &Gaussians| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("valid");
                pool.install(|| bits(&draw(&mut Rasterizer::cpu(), scene, &camera, &Profile::default())))
            };
            let expected = on(1, &scene);
            prop_assert_eq!(&expected, &on(2, &scene));
            prop_assert_eq!(&expected, &on(2, &other));
        }
    }
}

#[cfg(feature = "gpu")]
mod on_a_gpu {
    use super::*;
    use crate::gpu::OPTIONS;
    use gs_reference::tolerance::{AMBIGUOUS_ELLIPSOID, F32_ELLIPSOID};
    use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

    /// f32, which loses what is near a rim.
    const GPU: Accuracy = Accuracy {
        margin: AMBIGUOUS_ELLIPSOID,
        bound: |deviation| F32_ELLIPSOID * deviation.largest.max(1.0),
    };

    fn gpu() -> MutexGuard<'static, Rasterizer> {
        static GPU: LazyLock<Mutex<Rasterizer>> =
            LazyLock::new(|| Mutex::new(Rasterizer::gpu(&OPTIONS).expect("an adapter")));
        GPU.lock().unwrap_or_else(PoisonError::into_inner)
    }

    #[test]
    #[ignore = "gpu"]
    fn cases() {
        CASES.iter().for_each(|case| case(&mut gpu()));
    }

    #[test]
    #[ignore = "gpu"]
    fn extreme_cases() {
        what_is_barely_a_gaussian_is_where_it_should_be(&mut gpu(), &GPU);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        #[ignore = "gpu"]
        fn views_equal_the_definition(scene in gaussians(40), camera in camera(), antialias: bool) {
            let profile = Profile { antialias, ..Profile::default() };
            let found = difference(&mut gpu(), &scene, &camera, &profile, &GPU);
            prop_assert!(found.is_ok(), "{found:?}");
        }

        #[test]
        #[ignore = "gpu"]
        fn any_bits_give_a_finite_picture(scene in hostile_scenes()) {
            draw(&mut gpu(), &scene, &lens(), &Profile::default());
        }

        #[test]
        #[ignore = "gpu"]
        fn neither_runs_nor_the_order_of_the_scene_change_a_bit(
            scene in gaussians(60), camera in camera(), seed in 0usize..1000,
        ) {
            let mut order: Vec<usize> = (0..scene.len()).collect();
            order.sort_by_key(|i| (i * 7727 + seed * 31) % 1009);
            let other = crate::properties::permuted(&scene, &order);
            let bits = |scene: &Gaussians| bits(&draw(&mut gpu(), scene, &camera, &Profile::default()));
            let expected = bits(&scene);
            prop_assert_eq!(&expected, &bits(&scene));
            prop_assert_eq!(&expected, &bits(&other));
        }
    }
}

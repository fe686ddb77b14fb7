//! What must hold of any gradient, whatever its value.

use crate::check::{by, settings};
use crate::losses::{noise, pixels};
use crate::scenes::backward;
use gs_raster::{Error, Gradients, PixelGradients, Rasterizer, RenderSettings};
use gs_reference::tolerance::F32_RANDOM_GRADIENT;
use gs_reference::{Profile, Variable, compare};
use gs_scene::{Camera, Gaussians, SH_C0};

const BACKGROUND: [f32; 3] = [0.2, 0.5, 0.9];

/// A scene of random discs before the camera, all of them visible, over several tiles.
fn discs(n: usize) -> (Gaussians, Camera) {
    let mut scene = Gaussians::empty(2).expect("valid");
    for i in 0..n {
        let random = |k: usize| noise(k as u64, i);
        let sh: Vec<f32> = (0..27).map(|k| 0.3 * random(20 + k)).collect();
        scene.push(
            [random(0), 0.6 * random(1), 3.0 + random(2)],
            [random(3), random(4), random(5), 1.5],
            [random(6) - 3.0, random(7) - 3.0, random(8) - 4.0],
            2.0 * random(9),
            &sh,
        );
    }
    let lens = gs_scene::Intrinsics { fx: 90.0, fy: 85.0, cx: 41.0, cy: 23.0, width: 83, height: 50 };
    let camera = Camera::new(lens, glam::DMat3::from_rotation_y(0.05), glam::DVec3::new(0.1, 0.0, 0.2));
    (scene, camera.expect("valid"))
}

fn some_pixels(camera: &Camera) -> PixelGradients<'static> {
    let size = camera.width() * camera.height();
    pixels(3, &vec![false; size], &vec![1.0; size])
}

fn with_depth() -> RenderSettings {
    RenderSettings { depth: true, background: BACKGROUND, ..RenderSettings::default() }
}

fn norm(values: &[f32]) -> f64 {
    values.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>().sqrt()
}

/// All bits of gradients.
fn bits(gradients: &Gradients) -> Vec<u64> {
    let single = gradients.geometry.iter().chain(&gradients.sh).map(|value| u64::from(value.to_bits()));
    let poses = gradients.cameras.iter().flat_map(|pose| {
        let numbers = pose.rotation.to_cols_array().into_iter().chain(pose.translation.to_array());
        numbers.chain([pose.focal]).collect::<Vec<f64>>()
    });
    single.chain(gradients.background.into_iter().chain(poses).map(f64::to_bits)).collect()
}

#[test]
fn what_a_rasterizer_drew_before_changes_nothing() {
    let (many, large) = discs(400);
    let (few, _) = discs(3);
    let lens = |width, height| gs_scene::Intrinsics { fx: 60.0, fy: 60.0, cx: 0.5, cy: 0.5, width, height };
    let [small, pixel] = [lens(20, 33), lens(1, 1)]
        .map(|lens| Camera::new(lens, glam::DMat3::IDENTITY, glam::DVec3::ZERO).expect("valid"));
    let none = Gaussians::empty(1).expect("valid");
    let mut used = Rasterizer::cpu();
    let mut memory = Gradients::default();
    let views =
        [(&many, &large), (&few, &small), (&many, &pixel), (&none, &small), (&many, &large), (&few, &large)];
    for (number, (scene, camera)) in views.into_iter().cycle().take(12).enumerate() {
        let settings =
            RenderSettings { depth: number % 3 != 1, background: BACKGROUND, ..RenderSettings::default() };
        let pixels = some_pixels(camera);
        let depth = pixels.depth.clone().filter(|_| settings.depth);
        let pixels = [PixelGradients { depth, ..pixels }];
        let values = [vec![0.5; camera.width() * camera.height()]];
        let draw = |rasterizer: &mut Rasterizer, memory: &mut Gradients| {
            let seen = rasterizer.render(scene, camera, &settings).expect("valid");
            let (recorded, tape) = rasterizer.record(scene, &[*camera], &settings).expect("valid");
            rasterizer.backward_into(scene, &tape, &pixels, memory).expect("valid");
            let (_, shares) = rasterizer.backward_with_shares(scene, &tape, &pixels, &values).expect("valid");
            let pictures = [&seen, &recorded[0]]
                .map(|drawn| (drawn.image.clone(), drawn.alpha.clone(), drawn.depth.clone()));
            (pictures, bits(memory), shares)
        };
        let fresh = draw(&mut Rasterizer::cpu(), &mut Gradients::default());
        assert!(draw(&mut used, &mut memory) == fresh, "view {number}");
    }
}

#[test]
fn the_focal_length_has_the_derivative_of_finite_differences() {
    let (mut scene, camera) = discs(60);
    // One beside the picture, which its rim reaches: the Jacobian is that at the limit.
    scene.push([4.0, 0.0, 3.0], [1.0, 0.1, 0.0, 0.2], [0.5, 0.0, 0.2], 1.0, &[0.2; 27]);
    for antialias in [false, true] {
        let profile = Profile { antialias, ..Profile::default() };
        let settings = settings(&profile, BACKGROUND);
        let pixels = some_pixels(&camera);
        let pixels = PixelGradients { depth: None, ..pixels };
        let loss = |factor: f64| {
            let lens = camera.intrinsics();
            let lens = gs_scene::Intrinsics { fx: lens.fx * factor, fy: lens.fy * factor, ..*lens };
            let moved = Camera::new(lens, camera.rotation(), camera.translation()).expect("valid");
            let seen = gs_reference::render(&scene, &moved, BACKGROUND.map(f64::from), &profile);
            let sum = |weights: &[f32], values: &[f64]| -> f64 {
                weights.iter().zip(values).map(|(weight, value)| f64::from(*weight) * value).sum()
            };
            sum(&pixels.image, &seen.image) + sum(pixels.alpha.as_ref().expect("given"), &seen.alpha)
        };
        // Small enough that no pixel changes sides at a threshold.
        const STEP: f64 = 1e-7;
        let expected = (loss(1.0 + STEP) - loss(1.0 - STEP)) / (2.0 * STEP);
        let found = backward(&scene, &camera, &settings, &pixels).cameras[0].focal;
        assert!(expected.abs() > 1.0, "{expected}");
        assert!(
            (found - expected).abs() < 1e-5 * expected.abs(),
            "{antialias}: {found}, expected {expected}"
        );
    }
}

#[test]
fn shares_are_the_weights_of_the_colours() {
    let (scene, camera) = discs(400);
    let settings = RenderSettings { background: BACKGROUND, ..RenderSettings::default() };
    let size = camera.width() * camera.height();
    let values: Vec<f32> = (0..size).map(|i| noise(5, i)).collect();
    let mut rasterizer = Rasterizer::cpu();
    let (rendered, tape) = rasterizer.record(&scene, &[camera], &settings).expect("valid");
    let pixels = some_pixels(&camera);
    let pixels = [PixelGradients { depth: None, ..pixels }];
    let (gradients, shares) = rasterizer
        .backward_with_shares(&scene, &tape, &pixels, std::slice::from_ref(&values))
        .expect("valid");
    // The derivatives are what they are without.
    assert_eq!(bits(&gradients), bits(&rasterizer.backward(&scene, &tape, &pixels).expect("valid")));

    // By a colour that is not cut at 0, which is multiplied by its share.
    let image = values.iter().flat_map(|value| [1.0, *value, 0.0]).collect();
    let by_shares = [PixelGradients { image, alpha: None, depth: None }];
    let by_colour = rasterizer.backward(&scene, &tape, &by_shares).expect("valid").sh;
    let mut uncut = 0;
    for (of_gaussian, shares) in by_colour.chunks_exact(27).zip(&shares) {
        for (by_colour, share) in of_gaussian.iter().zip(shares) {
            let expected = by_colour / SH_C0;
            uncut += usize::from(expected != 0.0);
            assert!(expected == 0.0 || (expected - share).abs() < 1e-4, "{share} {expected}");
        }
    }
    assert!(uncut > 600, "{uncut}");

    // Together they are the opacity of every pixel.
    let alpha = || rendered[0].alpha.iter().map(|&alpha| f64::from(alpha));
    let expected: [f64; 2] = [alpha().sum(), alpha().zip(&values).map(|(a, &v)| a * f64::from(v)).sum()];
    for (k, expected) in expected.into_iter().enumerate() {
        let found: f64 = shares.iter().map(|shares| f64::from(shares[k])).sum();
        assert!((found - expected).abs() < 1e-5 * size as f64, "{found} {expected}");
    }

    let short = rasterizer.backward_with_shares(&scene, &tape, &pixels, &[values[1..].to_vec()]);
    assert!(matches!(short, Err(Error::PixelGradientLength { what: "values", .. })), "{short:?}");
    let none = rasterizer.backward_with_shares(&scene, &tape, &pixels, &[]);
    assert!(matches!(none, Err(Error::Views { expected: 1, found: 0 })), "{none:?}");
}

#[test]
fn no_number_of_threads_changes_a_bit() {
    // More than one chunk of Gaussians.
    let (scene, camera) = discs(9000);
    let pixels = some_pixels(&camera);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("valid");
        pool.install(|| bits(&backward(&scene, &camera, &with_depth(), &pixels)))
    };
    let one = on(1);
    assert!(one.iter().any(|&bits| bits != 0));
    for threads in [2, 3, 7] {
        assert!(on(threads) == one, "{threads} threads");
    }
}

#[test]
fn quaternions_have_no_gradient_along_themselves() {
    let (scene, camera) = discs(300);
    let found = backward(&scene, &camera, &with_depth(), &some_pixels(&camera));
    let mut turned = 0;
    for (row, by) in scene.geometry().chunks_exact(11).zip(found.geometry.chunks_exact(11)) {
        let (row, by) = (&row[gs_scene::QUATERNION], &by[gs_scene::QUATERNION]);
        let dot: f64 = row.iter().zip(by).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        assert!(dot.abs() <= f64::from(f32::EPSILON) * 2.0 * norm(row) * norm(by), "{row:?} {by:?}");
        turned += usize::from(norm(by) > 0.0);
    }
    assert!(turned > 200, "{turned} Gaussians of 300 have a gradient");
}

#[test]
fn every_kind_of_gradient_is_there() {
    let (scene, camera) = discs(300);
    let found = backward(&scene, &camera, &with_depth(), &some_pixels(&camera));
    for variable in Variable::ALL {
        let Some(found) = by(&found, variable, &camera) else { continue };
        let norm = found.iter().map(|value| value * value).sum::<f64>().sqrt();
        assert!(norm > 0.1, "{}: {norm}", variable.name());
    }
}

#[test]
fn what_is_not_drawn_has_no_gradient() {
    let (mut scene, camera) = discs(60);
    for (i, row) in scene.buffers_mut().0.chunks_exact_mut(11).enumerate().skip(30) {
        match i % 5 {
            0 => row[2] = -3.0,
            1 => row[10] = -7.0,
            2 => row[0] = 50.0,
            3 => row[4] = f32::NAN,
            _ => row[3..7].fill(0.0),
        }
    }
    let found = backward(&scene, &camera, &with_depth(), &some_pixels(&camera));
    assert!(found.geometry[30 * 11..].iter().chain(&found.sh[30 * 27..]).all(|&value| value == 0.0));
    let drawn = found.geometry[..30 * 11].chunks_exact(11).filter(|row| norm(row) > 0.0).count();
    assert!(drawn >= 25, "{drawn}");
}

#[test]
fn views_of_a_batch_add_up() {
    let (scene, camera) = discs(300);
    let other = Camera::new(*camera.intrinsics(), camera.rotation(), glam::DVec3::new(-0.2, 0.1, 0.4));
    let cameras = [camera, other.expect("valid")];
    let pixels = cameras.map(|camera| some_pixels(&camera));
    let mut rasterizer = Rasterizer::cpu();
    let (_, tape) = rasterizer.record(&scene, &cameras, &with_depth()).expect("valid");
    let both = rasterizer.backward(&scene, &tape, &pixels).expect("valid");
    // In memory that holds the gradients of other pictures.
    let mut again = rasterizer.backward(&scene, &tape, &pixels).expect("valid");
    again.geometry.fill(f32::NAN);
    again.sh.pop();
    rasterizer.backward_into(&scene, &tape, &pixels, &mut again).expect("valid");
    assert_eq!(again, both);
    let each = [0, 1].map(|view| backward(&scene, &cameras[view], &with_depth(), &pixels[view]));
    assert_eq!(both.cameras, [each[0].cameras[0], each[1].cameras[0]]);
    for (buffer, [a, b]) in
        [(&both.geometry, [&each[0].geometry, &each[1].geometry]), (&both.sh, [&each[0].sh, &each[1].sh])]
    {
        let sum = a.iter().zip(b).map(|(a, b)| f64::from(*a) + f64::from(*b));
        let deviation = compare(sum, buffer.iter().copied(), &[]).expect("comparable");
        assert!(deviation.max_abs <= f64::from(f32::EPSILON) * deviation.largest, "{deviation:?}");
    }
}

#[test]
fn three_views_side_by_side_are_those_one_by_one_on_any_number_of_threads() {
    let (scene, camera) = discs(3000);
    let lens = gs_scene::Intrinsics { fx: 60.0, fy: 60.0, cx: 11.0, cy: 15.5, width: 20, height: 33 };
    let other = |lens, shift| Camera::new(lens, camera.rotation(), shift).expect("valid");
    let cameras = [
        camera,
        other(*camera.intrinsics(), glam::DVec3::new(-0.2, 0.1, 0.4)),
        other(lens, glam::DVec3::new(0.1, 0.0, 0.2)),
    ];
    let pixels = cameras.map(|camera| some_pixels(&camera));
    let values = cameras
        .map(|camera| (0..camera.width() * camera.height()).map(|i| (i % 7) as f32).collect::<Vec<f32>>());
    let draw = |views: std::ops::Range<usize>| {
        let mut rasterizer = Rasterizer::cpu();
        let (seen, tape) = rasterizer.record(&scene, &cameras[views.clone()], &with_depth()).expect("valid");
        let (by, shares) = rasterizer
            .backward_with_shares(&scene, &tape, &pixels[views.clone()], &values[views])
            .expect("valid");
        let seen: Vec<_> = seen.into_iter().map(|view| (view.image, view.alpha, view.depth)).collect();
        (seen, by, shares)
    };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("valid");
        pool.install(|| draw(0..3))
    };
    let all = on(1);
    for threads in [2, 3, 7] {
        assert!(on(threads) == all, "{threads} threads");
    }
    let (seen, by, shares) = all;
    let [mut sum, second, third] = [0, 1, 2].map(|view| draw(view..view + 1));
    for (more, by_more, more_shares) in [second, third] {
        sum.0.extend(more);
        sum.1.cameras.extend(by_more.cameras);
        let numbers = sum.1.geometry.iter_mut().zip(&by_more.geometry);
        numbers.chain(sum.1.sh.iter_mut().zip(&by_more.sh)).for_each(|(sum, more)| *sum += more);
        sum.1.background.iter_mut().zip(by_more.background).for_each(|(sum, more)| *sum += more);
        let shares = sum.2.as_flattened_mut().iter_mut().zip(more_shares.as_flattened());
        shares.for_each(|(sum, more)| *sum += more);
    }
    assert!(shares.iter().filter(|share| share[0] > 0.0).count() > 100);
    assert!(sum.0 == seen, "pictures");
    assert!(sum.1 == by, "gradients");
    assert!(sum.2 == shares, "shares");
}

#[test]
fn the_scale_of_the_world_scales_what_is_in_its_units() {
    let (scene, camera) = discs(300);
    let factor = 64.0f64;
    let mut scaled = scene.clone();
    for row in scaled.buffers_mut().0.chunks_exact_mut(11) {
        row[..3].iter_mut().for_each(|value| *value *= factor as f32);
        row[7..10].iter_mut().for_each(|value| *value += factor.ln() as f32);
    }
    let moved = Camera::new(*camera.intrinsics(), camera.rotation(), camera.translation() * factor);
    let mut pixels = some_pixels(&camera);
    let found = backward(&scene, &camera, &with_depth(), &pixels);
    // Depth is in units of the world, its gradient in their inverse.
    pixels.depth.iter_mut().flatten().for_each(|value| *value /= factor as f32);
    let settings = RenderSettings { near: with_depth().near * factor as f32, ..with_depth() };
    let moved = moved.expect("valid");
    let scaled = backward(&scaled, &moved, &settings, &pixels);
    for variable in Variable::ALL {
        let Some(found) = by(&found, variable, &camera) else { continue };
        let scaled = by(&scaled, variable, &moved).expect("as before").into_iter().enumerate();
        let scaled = scaled.map(|(i, value)| match variable {
            Variable::Means => value * factor,
            Variable::WorldToCamera if i % 4 == 3 => value * factor,
            Variable::Twist if i < 3 => value * factor,
            _ => value,
        });
        let deviation = compare(found, scaled, &[]).expect("comparable");
        // The logarithms of the scales are rounded: by 5e-7, which is what it changes.
        assert!(
            deviation.max_abs <= F32_RANDOM_GRADIENT * deviation.largest,
            "{}: {deviation:?}",
            variable.name()
        );
    }
}

#[test]
fn what_does_not_fit_is_an_error() {
    let (scene, camera) = discs(3);
    let mut rasterizer = Rasterizer::cpu();
    let (_, tape) = rasterizer.record(&scene, &[camera], &RenderSettings::default()).expect("valid");
    let size = camera.width() * camera.height();
    let good = PixelGradients { image: vec![1.0; size * 3].into(), alpha: None, depth: None };
    let mut backward =
        |scene: &Gaussians, pixels: &[PixelGradients]| rasterizer.backward(scene, &tape, pixels);
    assert!(backward(&scene, std::slice::from_ref(&good)).is_ok());
    let found = backward(&discs(4).0, std::slice::from_ref(&good));
    assert!(matches!(found, Err(Error::OtherScene { expected: 3, found: 4, .. })), "{found:?}");
    let found = backward(&scene, &[good.clone(), good.clone()]);
    assert!(matches!(found, Err(Error::Views { expected: 1, found: 2 })), "{found:?}");
    let found = backward(&scene, &[PixelGradients { alpha: Some(vec![0.0]), ..good.clone() }]);
    assert!(matches!(found, Err(Error::PixelGradientLength { what: "alpha", found: 1, .. })), "{found:?}");
    let found = backward(&scene, &[PixelGradients { depth: Some(vec![0.0; size]), ..good.clone() }]);
    assert!(matches!(found, Err(Error::DepthNotRendered)), "{found:?}");
    let mut bad = good;
    bad.image.to_mut()[7] = f32::NAN;
    let found = backward(&scene, &[bad]);
    assert!(matches!(found, Err(Error::PixelGradientNotFinite { what: "image", index: 7 })), "{found:?}");
}

use crate::{COURTYARD, given_depth, plane_sweep, positions, predict, psnr, run};
use gs_scene::{Image, View};
use sparsesplat::{Allocation, Backbone, Config, Error, Exposure, Head, Stage};

#[test]
fn each_look_brings_held_out_views_nearer() {
    for (name, config) in [
        ("stereo", plane_sweep(8_000)),
        ("exact depth", given_depth(8_000)),
        ("closed form", Config { head: Head::ClosedForm, ..plane_sweep(8_000) }),
    ] {
        let of = |looks| {
            let prediction = run(&COURTYARD.0, &Config { looks, ..config.clone() });
            (psnr(&prediction, &COURTYARD.1), prediction)
        };
        let found = [1, 2, 3].map(of);
        let [one, two, three] = found.each_ref().map(|(psnr, _)| *psnr);
        println!("{name}: {one:.2}, {two:.2}, {three:.2} dB");
        assert!(two > one + LEAST && three > two, "{name}: {one:.2}, {two:.2}, {three:.2} dB");
        // The budget is exact after any number of looks, and what the head alone makes takes no time for them.
        assert!(found.iter().all(|(_, prediction)| prediction.counts == found[0].1.counts), "{name}");
        assert!(found[0].1.seconds[Stage::Looks] < 1e-3 && found[1].1.seconds[Stage::Looks] > 1e-3);
    }
}

/// What the second look gains at least, decibels: about half of what was measured.
const LEAST: f64 = 0.3;

#[test]
fn the_default_looks_more_than_once_and_no_look_is_refused() {
    assert!(Config::default().looks > 1);
    let refused = predict(&COURTYARD.0, &Config { looks: 0, ..given_depth(100) });
    assert!(matches!(refused, Err(Error::NoLook)));
}

#[test]
fn bytes_are_the_same_on_any_number_of_threads_and_with_any_seed_that_draws_nothing() {
    let config = Config { looks: 2, allocation: Allocation::PixelAligned, ..given_depth(1) };
    let on = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&COURTYARD.0, &Config { seed, ..config.clone() }).gaussians)
    };
    let expected = on(1, 0);
    for (threads, seed) in [(2, 0), (3, 7)] {
        let found = on(threads, seed);
        assert_eq!(found.geometry(), expected.geometry(), "{threads} threads, seed {seed}");
        assert_eq!(found.sh(), expected.sh(), "{threads} threads, seed {seed}");
    }
}

#[test]
fn hard_views_and_budgets_give_what_can_be_drawn() {
    // `run` checks what every prediction promises.
    for count in [1, 2, 3] {
        let found = run(&COURTYARD.0, &Config { looks: 3, ..given_depth(count) });
        assert_eq!(found.counts.total, count);
    }
    let flat = |value: f32| -> Vec<View> {
        let mut views = COURTYARD.0.clone();
        views.iter_mut().for_each(|view| view.image_mut().data_mut().fill(value));
        views
    };
    for value in [0.0, 0.5, 1.0] {
        run(&flat(value), &Config { looks: 3, ..given_depth(500) });
    }
    // One view, and views of different exposure in both exposures of the scene.
    run(&COURTYARD.0[..1], &Config { looks: 2, ..given_depth(500) });
    let mut views = COURTYARD.0.clone();
    views[1].image_mut().data_mut().iter_mut().for_each(|value| *value *= 0.6);
    for exposure in [Exposure::AsPhotographed, Exposure::Common] {
        run(&views, &Config { looks: 2, exposure, ..given_depth(500) });
    }
}

#[test]
fn pictures_smaller_than_the_window_of_ssim_are_looked_at_too() {
    let views: Vec<View> = COURTYARD.0.iter().map(tiny).collect();
    let config = Config { backbone: Backbone::GivenDepth, looks: 2, ..given_depth(20) };
    let (one, two) = (run(&views, &Config { looks: 1, ..config.clone() }), run(&views, &config));
    assert_ne!(positions(&one.gaussians), positions(&two.gaussians));
}

/// The view at 9 x 6 pixels.
fn tiny(view: &View) -> View {
    let (width, height) = (9, 6);
    let lens = *view.camera().intrinsics();
    let scale = width as f64 / lens.width as f64;
    let lens = gs_scene::Intrinsics {
        fx: lens.fx * scale,
        fy: lens.fy * scale,
        cx: lens.cx * scale,
        cy: 3.0,
        width,
        height,
    };
    let camera = gs_scene::Camera::new(lens, view.camera().rotation(), view.camera().translation()).unwrap();
    let at = |x: usize, y: usize| (x * view.image().width() / width, y * view.image().height() / height);
    let (mut colours, mut depths) = (Vec::new(), Vec::new());
    for y in 0..height {
        for x in 0..width {
            let (x, y) = at(x, y);
            colours.extend(view.image().pixel(x, y));
            depths.push(view.depth().unwrap().data()[y * view.image().width() + x]);
        }
    }
    let depth = gs_scene::DepthMap::new(width, height, depths).unwrap();
    View::new(view.name(), Image::new(width, height, colours).unwrap(), camera, Some(depth)).unwrap()
}

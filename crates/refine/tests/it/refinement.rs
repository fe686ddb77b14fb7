//! What refinement is for.

use crate::scenes::{Random, cameras, disturbed, photographs, wall};
use glam::{DMat3, DVec3};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Gaussians, Image, Intrinsics, OPACITY_LOGIT, View, logit};
use image_metrics::psnr;
use refine::{Config, Loss, Rates, Refined, Stop, Stopped, refine};

fn run(scene: &Gaussians, views: &[View], config: &Config) -> Refined {
    refine(scene.clone(), views, config, &mut Rasterizer::cpu(), &mut |_| {}).unwrap()
}

/// Mean PSNR of the views of a scene.
fn quality(scene: &Gaussians, views: &[View]) -> f64 {
    let cameras: Vec<_> = views.iter().map(|view| *view.camera()).collect();
    let seen = photographs(scene, &cameras);
    let each = views.iter().zip(&seen).map(|(a, b)| psnr(a.image(), b.image()).unwrap());
    each.sum::<f64>() / views.len() as f64
}

#[test]
fn a_disturbed_scene_comes_back_in_views_it_was_not_shown() {
    let truth = wall(16, 1.0);
    let all = photographs(&truth, &cameras(5, (64, 48), 1.0));
    let (context, held_out) =
        ([all[0].clone(), all[2].clone(), all[4].clone()], [all[1].clone(), all[3].clone()]);
    let off = disturbed(&truth, 1.0);
    for loss in [Loss::default(), Loss { dssim: 0.2, ..Loss::default() }] {
        let config = Config { stop: Stop::Steps(100), loss, smallest_gain: 0.0, ..Config::default() };
        let refined = run(&off, &context, &config);
        let (before, after) = (quality(&off, &held_out), quality(&refined.gaussians, &held_out));
        assert!(after > before + 4.0, "{before} dB before, {after} dB after, {loss:?}");
        let report = &refined.report;
        assert!((report.psnr_start - quality(&off, &context)).abs() < 0.01);
        assert_eq!((report.steps.len(), report.undone, report.stopped), (100, 0, Some(Stopped::Done)));
        assert!(report.steps.windows(2).all(|pair| pair[0].seconds <= pair[1].seconds));
        assert!(report.exposure.is_empty(), "the views agree");
    }
}

/// A user may ask for any number of steps after a head, whose scene is good already.
#[test]
fn a_few_steps_lose_nothing_of_a_good_scene() {
    let all = photographs(&wall(20, 1.0), &cameras(11, (64, 48), 1.0));
    let (context, held_out): (Vec<_>, Vec<_>) = all.into_iter().enumerate().partition(|(i, _)| i % 2 == 0);
    let views = |numbered: Vec<(usize, View)>| numbered.into_iter().map(|(_, view)| view).collect::<Vec<_>>();
    let (context, held_out) = (views(context), views(held_out));
    // Fewer Gaussians than the truth has: some error always remains.
    let good = run(&disturbed(&wall(14, 1.0), 1.0), &context, &Config::rounds(4, context.len())).gaussians;
    let before = quality(&good, &held_out);
    let after = |steps, warm_up| {
        let config = Config { stop: Stop::Steps(steps), warm_up, ..Config::default() };
        quality(&run(&good, &context, &config).gaussians, &held_out)
    };
    for steps in 1..=5 {
        let now = after(steps, Config::default().warm_up);
        assert!(now > before, "{steps} steps: {now} dB, {before} dB before");
    }
    assert!(after(1, 0) < before, "at full size the first step is too large");
}

#[test]
fn a_scene_that_is_right_stays_and_stops_early() {
    let truth = wall(10, 1.0);
    let views = photographs(&truth, &cameras(3, (48, 32), 1.0));
    let refined = run(&truth, &views, &Config { stop: Stop::Steps(500), ..Config::default() });
    assert_eq!(refined.report.stopped, Some(Stopped::NothingGained));
    let halves = 60 + 120;
    assert_eq!(refined.report.steps.len(), halves, "forty rounds of three views, then of six, two a step");
    assert!(quality(&refined.gaussians, &views) > 60.0);
    let never = Config { stop: Stop::Steps(80), smallest_gain: 0.0, ..Config::default() };
    assert_eq!(run(&truth, &views, &never).report.steps.len(), 80);
}

/// Photographs with noise, which many steps explain by geometry.
#[test]
fn a_long_refinement_keeps_what_it_knew_between_the_photographs() {
    let truth = wall(16, 1.0);
    let all = photographs(&truth, &cameras(7, (64, 48), 1.0));
    let mut context = [all[0].clone(), all[3].clone(), all[6].clone()];
    let mut random = Random(5);
    for view in &mut context {
        view.image_mut().data_mut().iter_mut().for_each(|v| *v += random.between(-0.15, 0.15));
    }
    let held_out = [all[1].clone(), all[2].clone(), all[4].clone(), all[5].clone()];
    let off = disturbed(&truth, 1.0);
    let after = |steps: usize, between: bool| {
        let stop = Stop::Steps(steps);
        let refined = run(&off, &context, &Config { stop, between, smallest_gain: 0.0, ..Config::default() });
        let second_half = (between && steps >= 120).then_some(steps / 2 + 1);
        assert_eq!((refined.report.steps.len(), refined.report.between_from), (steps, second_half));
        refined.gaussians
    };
    assert_eq!(after(119, true), after(119, false), "short ones are by photographs alone");
    let [with, without] = [true, false].map(|between| quality(&after(240, between), &held_out));
    assert!(with > without + 1.0, "{with} dB, {without} dB by photographs alone");
}

#[test]
fn cameras_that_are_off_come_back_where_they_may_move() {
    let truth = wall(16, 1.0);
    let right = cameras(4, (64, 48), 1.0);
    // Every camera turned by a pixel and a half, another way each.
    let wrong = |(i, camera): (usize, &Camera)| {
        let by = 1.5 / 64.0 * [1.0, -1.0, 1.0, -1.0][i];
        let turn = DMat3::from_rotation_y(by) * DMat3::from_rotation_x(if i < 2 { by } else { -by });
        let (rotation, translation) = (turn * camera.rotation(), turn * camera.translation());
        Camera::new(*camera.intrinsics(), rotation, translation).unwrap()
    };
    let views: Vec<View> = photographs(&truth, &right)
        .iter()
        .zip(right.iter().enumerate().map(wrong))
        .map(|(view, camera)| View::new(view.name(), view.image().clone(), camera, None).unwrap())
        .collect();
    let held_out = photographs(&truth, &cameras(7, (64, 48), 1.0));
    let run_with = |pose| {
        let rates = Rates { pose, ..Rates::default() };
        let stop = Stop::Steps(200);
        run(&disturbed(&truth, 0.3), &views, &Config { stop, rates, smallest_gain: 0.0, ..Config::default() })
    };
    let [fixed, moved] = [0.0, 0.1].map(run_with);
    assert!(fixed.report.poses.is_empty() && fixed.cameras.iter().zip(&views).all(|(a, b)| a == b.camera()));
    let angle = |found: &Camera, given: &Camera| {
        let turn = found.rotation() * given.rotation().transpose();
        turn.x_axis.angle_between(DVec3::X).max(turn.y_axis.angle_between(DVec3::Y)).to_degrees()
    };
    let worst = |found: &[Camera]| found.iter().zip(&right).map(|(a, b)| angle(a, b)).fold(0.0, f64::max);
    let [before, after] = [&fixed, &moved].map(|refined| worst(&refined.cameras));
    assert!(after < 0.6 * before, "{before} degrees before, {after} after");
    assert_eq!(moved.report.poses.len(), 4);
    let [fixed, moved] = [fixed, moved].map(|refined| quality(&refined.gaussians, &held_out));
    assert!(moved > fixed + 1.0, "{fixed} dB where cameras stay, {moved} dB where they move");
}

#[test]
fn a_focal_length_that_is_off_comes_back_and_is_that_of_all_views() {
    let truth = wall(16, 1.0);
    let right = cameras(4, (64, 48), 1.0);
    for off in [0.96, 1.04] {
        let wrong = |camera: &Camera| {
            let lens = *camera.intrinsics();
            let lens = Intrinsics { fx: lens.fx * off, fy: lens.fy * off, ..lens };
            Camera::new(lens, camera.rotation(), camera.translation()).unwrap()
        };
        let views: Vec<View> = photographs(&truth, &right)
            .iter()
            .zip(right.iter().map(wrong))
            .map(|(view, camera)| View::new(view.name(), view.image().clone(), camera, None).unwrap())
            .collect();
        // The scene stays: a wall could follow a wrong focal length.
        let rates =
            Rates { mean: 0.0, rotation: 0.0, scale: 0.0, opacity: 0.0, colour: 0.0, sh: 0.0, pose: 0.1 };
        let config = Config { stop: Stop::Steps(100), rates, smallest_gain: 0.0, ..Config::default() };
        let refined = run(&truth, &views, &config);
        let found = refined.cameras[0].intrinsics().fx / right[0].intrinsics().fx;
        assert!((found - 1.0).abs() < 0.2 * (off - 1.0f64).abs(), "{off} before, {found} after");
        for (camera, change) in refined.cameras.iter().zip(&refined.report.poses) {
            assert_eq!(camera.intrinsics(), refined.cameras[0].intrinsics());
            assert!((change.focal * off - found).abs() < 1e-12, "{change:?}");
        }
    }
}

#[test]
fn no_steps_and_no_time_change_nothing() {
    let scene = wall(5, 1.0);
    let views = photographs(&scene, &cameras(2, (32, 24), 1.0));
    for stop in [Stop::Steps(0), Stop::Seconds(0.0)] {
        let refined = run(&scene, &views, &Config { stop, ..Config::default() });
        assert_eq!(refined.gaussians, scene);
        assert_eq!((refined.report.steps.len(), refined.report.stopped), (0, Some(Stopped::Done)));
    }
}

#[test]
fn time_limits_hold() {
    let truth = wall(8, 1.0);
    let views = photographs(&truth, &cameras(3, (48, 32), 1.0));
    let off = disturbed(&truth, 1.0);
    let refined =
        run(&off, &views, &Config { stop: Stop::Seconds(0.2), smallest_gain: 0.0, ..Config::default() });
    let last = refined.report.steps.last().unwrap();
    assert!(last.seconds >= 0.2, "{last:?}");
    if let [.., before_last, _] = refined.report.steps.as_slice() {
        assert!(before_last.seconds < 0.2, "{before_last:?}");
    }
}

#[test]
fn scale_and_place_do_not_matter() {
    let quality_at = |scale: f32| {
        let truth = wall(10, scale);
        let views = photographs(&truth, &cameras(3, (48, 32), f64::from(scale)));
        let config = Config { stop: Stop::Steps(30), ..Config::default() };
        quality(&run(&disturbed(&truth, scale), &views, &config).gaussians, &views)
    };
    let (small, middle, large) = (quality_at(1e-3), quality_at(1.0), quality_at(1e3));
    assert!((small - middle).abs() < 0.3 && (large - middle).abs() < 0.3, "{small} {middle} {large}");
}

#[test]
fn views_that_disagree_get_exposures_and_others_none() {
    let truth = wall(12, 1.0);
    let mut views = photographs(&truth, &cameras(3, (48, 32), 1.0));
    let [gain, bias] = [0.75f32, 0.1];
    views[1].image_mut().data_mut().iter_mut().for_each(|v| *v = gain * *v + bias);
    let config = Config { stop: Stop::Steps(100), smallest_gain: 0.0, ..Config::default() };
    let refined = run(&truth, &views, &config);
    let found = &refined.report.exposure;
    assert_eq!(found.len(), 3);
    let ratio = found[1].gain / (0.5 * (found[0].gain + found[2].gain));
    assert!((ratio - gain).abs() < 0.05, "{found:?}");
    let off = run(&truth, &views, &Config { exposure: false, ..config });
    assert!(off.report.exposure.is_empty());
    // The views are measured at the start all the same, unless that is not wanted.
    assert_eq!(off.report.psnr_start, refined.report.psnr_start);
    let unmeasured = Config { exposure: false, measure_start: false, stop: Stop::Steps(1), ..config };
    assert!(run(&truth, &views, &unmeasured).report.psnr_start.is_nan());
    let last = |refined: &Refined| refined.report.steps.last().unwrap().psnr_context;
    assert!(last(&refined) > last(&off) + 1.0, "{} {}", last(&refined), last(&off));
}

#[test]
fn a_perfect_view_does_not_hide_the_others() {
    let truth = wall(8, 1.0);
    let mut views = photographs(&truth, &cameras(2, (40, 32), 1.0));
    // One view sees nothing, and nothing is what its photograph shows.
    let away = views[0].camera();
    let turned = glam::DMat3::from_rotation_y(std::f64::consts::PI) * away.rotation();
    let camera = gs_scene::Camera::new(*away.intrinsics(), turned, away.translation()).unwrap();
    views.push(View::new("away", Image::filled(40, 32, [0.0; 3]).unwrap(), camera, None).unwrap());
    let off = disturbed(&truth, 1.0);
    let refined = run(&off, &views, &Config { stop: Stop::Steps(120), ..Config::default() });
    // Where nothing is gained, an end comes after 60.
    assert!(refined.report.steps.len() > 80, "{:?}", refined.report.stopped);
    assert!(quality(&refined.gaussians, &views[..2]) > quality(&off, &views[..2]) + 4.0);
}

#[test]
fn settings_and_reports_go_through_json() {
    let config = Config { stop: Stop::Seconds(2.5), ..Config::default() };
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
    assert_eq!(serde_json::from_str::<Config>("{}").unwrap(), Config::default());
    assert!(serde_json::from_str::<Config>(r#"{"steps": 3}"#).is_err(), "no such setting");
    let scene = wall(3, 1.0);
    let views = photographs(&scene, &cameras(1, (16, 12), 1.0));
    let refined = run(&scene, &views, &Config { stop: Stop::Steps(2), ..Config::default() });
    let report = serde_json::to_value(&refined.report).unwrap();
    assert_eq!((report["stopped"].as_str(), report["pruned"].as_u64()), (Some("done"), Some(0)));
    assert_eq!(report["steps"].as_array().unwrap().len(), 2);
}

#[test]
fn what_is_too_faint_to_be_compared_stays_as_it_is() {
    let truth = wall(12, 1.0);
    let views = photographs(&truth, &cameras(2, (48, 32), 1.0));
    let mut faint = disturbed(&truth, 1.0);
    let rows = faint.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY);
    rows.step_by(2).for_each(|row| row[OPACITY_LOGIT] = logit(0.01) as f32);
    let moved = |alpha_min: f32| {
        let config = Config { stop: Stop::Steps(4), prune: false, alpha_min, ..Config::default() };
        let refined = run(&faint, &views, &config).gaussians;
        let rows = faint.geometry().chunks_exact(Gaussians::GEOMETRY);
        let moved: Vec<bool> = rows
            .zip(refined.geometry().chunks_exact(Gaussians::GEOMETRY))
            .map(|(before, after)| before != after)
            .collect();
        [0, 1].map(|first| moved.iter().skip(first).step_by(2).filter(|moved| **moved).count())
    };
    let (all, [faint_ones, others]) = (moved(Config::default().alpha_min), moved(0.02));
    assert!(all[0] > 0 && all[1] > 0, "{all:?}");
    assert_eq!(faint_ones, 0);
    assert!(others > 0);
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let truth = wall(12, 1.0);
    let views = photographs(&truth, &cameras(3, (48, 32), 1.0));
    let off = disturbed(&truth, 1.0);
    // The second is long: it has views between the photographs.
    for steps in [8, 120] {
        let config = Config {
            stop: Stop::Steps(steps),
            loss: Loss { dssim: 0.2, ..Loss::default() },
            sh_degree: 1,
            ..Config::default()
        };
        let on = |threads: usize, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&off, &views, &Config { seed, ..config }).gaussians)
        };
        let one = on(1, 0);
        assert_eq!(one.sh_degree(), 1);
        assert!(one == on(2, 0) && one == on(7, 0), "{steps} steps");
        assert!(one != on(2, 1), "another seed, another order of the views");
    }
}

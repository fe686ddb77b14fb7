//! Scenes and views that break optimisers.

use crate::scenes::{cameras, photographs, wall};
use glam::DVec3;
use gs_raster::Rasterizer;
use gs_scene::{
    Camera, Gaussians, Image, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, View, dc_from_rgb, logit,
};
use refine::{Config, Error, Loss, Rates, Refined, Stop, refine};

fn run(scene: Gaussians, views: &[View], config: &Config) -> refine::Result<Refined> {
    refine(scene, views, config, &mut Rasterizer::cpu(), &mut |_| {})
}

/// Rates far beyond reason: everything runs into its limits.
fn wild() -> Config {
    let rates =
        Rates { mean: 30.0, rotation: 3.0, scale: 3.0, opacity: 5.0, colour: 2.0, sh: 2.0, pose: 2.0 };
    Config { stop: Stop::Steps(25), rates, smallest_gain: 0.0, prune: false, ..Config::default() }
}

#[test]
fn splats_that_grow_shrink_and_vanish_stay_finite_and_bounded() {
    let truth = wall(8, 1.0);
    let views = photographs(&truth, &cameras(3, (48, 32), 1.0));
    let mut scene = wall(8, 1.0);
    for (i, row) in scene.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY).enumerate() {
        match i % 8 {
            0 => row[LOG_SCALE].fill(3.0),             // fills the image
            1 => row[LOG_SCALE].fill(-60.0),           // scale 0
            2 => row[OPACITY_LOGIT] = -40.0,           // opacity 0
            3 => row[OPACITY_LOGIT] = 40.0,            // opacity 1
            4 => row[MEAN].copy_from_slice(&[0.0; 3]), // in the camera
            5 => row[LOG_SCALE].copy_from_slice(&[2.0, -9.0, -9.0]),
            6 => row[QUATERNION].copy_from_slice(&[1e-18, 0.0, 0.0, 0.0]),
            _ => {}
        }
    }
    let refined = run(scene.clone(), &views, &wild()).unwrap();
    let all = refined.gaussians.geometry().iter().chain(refined.gaussians.sh());
    assert!(all.clone().all(|v| v.is_finite()));
    for (before, after) in
        scene.geometry().chunks_exact(11).zip(refined.gaussians.geometry().chunks_exact(11))
    {
        // No wider than 90 degrees from where it stands, unless it was so.
        let widest = before[LOG_SCALE].iter().copied().fold(6f32.ln(), f32::max);
        assert!(after[LOG_SCALE].iter().all(|s| *s <= widest), "{after:?}");
        assert!(after[OPACITY_LOGIT].abs() <= before[OPACITY_LOGIT].abs().max(9.2));
    }
}

#[test]
fn gaussians_that_are_none_are_kept_as_they_are_or_pruned() {
    let truth = wall(6, 1.0);
    let views = photographs(&truth, &cameras(2, (40, 24), 1.0));
    let mut scene = wall(6, 1.0);
    let geometry = scene.buffers_mut().0;
    geometry[3 * 11] = f32::NAN;
    geometry[5 * 11 + 8] = f32::INFINITY;
    geometry[7 * 11 + 3..7 * 11 + 7].fill(0.0);
    geometry[9 * 11 + OPACITY_LOGIT] = logit(0.001);
    scene.buffers_mut().1[11 * 3 + 1] = f32::NAN;
    let config = Config { stop: Stop::Steps(3), smallest_gain: 0.0, ..Config::default() };
    let kept = run(scene.clone(), &views, &Config { prune: false, ..config }).unwrap();
    assert_eq!(kept.gaussians.len(), 36);
    assert!(kept.gaussians.geometry()[33].is_nan());
    assert_eq!(kept.gaussians.geometry()[7 * 11..][..11], scene.geometry()[7 * 11..][..11]);
    let pruned = run(scene, &views, &config).unwrap();
    assert_eq!(pruned.report.pruned, [3, 5, 9, 11]);
    assert_eq!(pruned.gaussians.len(), 32);
    // What is left is what it would have been, and looks the same.
    let kept_rows: Vec<&[f32]> = kept.gaussians.geometry().chunks_exact(11).collect();
    let expected =
        [&kept_rows[..3], &kept_rows[4..5], &kept_rows[6..9], &kept_rows[10..11], &kept_rows[12..]]
            .concat()
            .concat();
    assert_eq!(pruned.gaussians.geometry(), expected);
    let cameras: Vec<_> = views.iter().map(|view| *view.camera()).collect();
    let (a, b) = (photographs(&kept.gaussians, &cameras), photographs(&pruned.gaussians, &cameras));
    assert!(a.iter().zip(&b).all(|(a, b)| a.image() == b.image()));
}

#[test]
fn a_step_that_is_not_finite_is_undone_and_counted() {
    let scene = wall(5, 1.0);
    let views = photographs(&scene, &cameras(2, (32, 24), 1.0));
    let mut bright = scene.clone();
    bright.buffers_mut().1[0] = 1e30;
    // The second is long: what the scene shows between the photographs is as bright.
    for steps in [6, 120] {
        let stop = Stop::Steps(steps);
        let config = Config { stop, prune: false, smallest_gain: 0.0, ..Config::default() };
        let refined = run(bright.clone(), &views, &config).unwrap();
        assert_eq!((refined.report.undone, refined.report.steps.len()), (steps, steps));
        assert!(refined.report.steps.iter().all(|step| step.loss.is_none()));
        assert_eq!(refined.gaussians, bright);
    }
}

#[test]
fn long_refinements_of_hard_scenes_and_cameras_end_with_finite_scenes() {
    let ahead = cameras(1, (40, 24), 1.0)[0];
    let lens = *ahead.intrinsics();
    // At one place, back to back, and 1e4 away.
    let turned = |angle: f64, x: f64| {
        let axes = glam::DMat3::from_rotation_y(angle);
        Camera::from_camera_to_world(lens, axes, ahead.position() + DVec3::X * x).unwrap()
    };
    let stations = [ahead, ahead, turned(std::f64::consts::PI, 0.0), turned(0.1, 1e4)];
    let truth = wall(6, 1.0);
    let mut scene = truth.clone();
    scene.buffers_mut().0[3 * 11] = f32::NAN;
    scene.buffers_mut().1[7] = f32::INFINITY;
    for count in 1..=stations.len() {
        let views = photographs(&truth, &stations[..count]);
        let config = Config { stop: Stop::Steps(120), smallest_gain: 0.0, ..Config::default() };
        let refined = run(scene.clone(), &views, &config).unwrap();
        assert_eq!((refined.report.steps.len(), refined.report.undone), (120, 0), "{count} views");
        let Refined { gaussians, .. } = refined;
        assert!(gaussians.geometry().iter().chain(gaussians.sh()).all(|value| value.is_finite()));
        assert!(gaussians.len() >= 30, "{} are left of 36", gaussians.len());
    }
    let nothing = run(
        Gaussians::empty(0).unwrap(),
        &photographs(&truth, &stations),
        &Config { stop: Stop::Steps(120), ..Config::default() },
    );
    assert!(nothing.unwrap().gaussians.is_empty());
}

#[test]
fn a_step_is_undone_if_only_one_of_its_views_is_wild() {
    // Cameras behind each other: the bright Gaussian stands between them.
    let front = cameras(1, (32, 24), 1.0)[0];
    let back =
        Camera::new(*front.intrinsics(), front.rotation(), front.translation() + DVec3::NEG_Z * 2.0).unwrap();
    let scene = wall(5, 1.0);
    let views = photographs(&scene, &[front, back]);
    let mut bright = scene;
    let white = dc_from_rgb([1e30; 3]);
    bright.push([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [-2.0; 3], 2.0, &white);
    bright.buffers_mut().1[4] += 0.5;
    let config = Config { stop: Stop::Steps(6), prune: false, smallest_gain: 0.0, ..Config::default() };
    let both = run(bright.clone(), &views, &config).unwrap();
    assert_eq!((both.report.undone, both.gaussians == bright), (6, true));
    let alone = run(bright.clone(), &views, &Config { views_per_step: 1, ..config }).unwrap();
    assert_eq!(alone.report.undone, 3, "every second step sees it");
    assert!(alone.gaussians != bright);
    let all = alone.gaussians.geometry().iter().chain(alone.gaussians.sh());
    assert!(all.clone().all(|v| v.is_finite()));
}

#[test]
fn empty_and_one_element_scenes_are_refined_too() {
    let truth = wall(5, 1.0);
    let views = photographs(&truth, &cameras(1, (16, 12), 1.0));
    let config =
        Config { stop: Stop::Steps(4), loss: Loss { dssim: 0.5, ..Loss::default() }, ..Config::default() };
    for degree in [0, 2] {
        let empty = Gaussians::empty(degree).unwrap();
        assert!(run(empty, &views, &config).unwrap().gaussians.is_empty());
    }
    let mut one = Gaussians::empty(0).unwrap();
    one.push([0.0, 0.0, 4.0], [1.0, 0.0, 0.0, 0.0], [-1.0; 3], 0.0, &dc_from_rgb([0.9, 0.1, 0.1]));
    let refined = run(one.clone(), &views, &config).unwrap().gaussians;
    assert!(refined.len() == 1 && refined != one);
    // Seen by nobody: nothing to learn.
    let mut behind = one;
    behind.buffers_mut().0[2] = -50.0;
    assert_eq!(run(behind.clone(), &views, &config).unwrap().gaussians, behind);
}

#[test]
fn far_from_the_origin_it_works_as_near() {
    let truth = wall(8, 1.0);
    let offset = [1e4f32, -1e4, 1e4];
    let mut moved = truth.clone();
    for row in moved.buffers_mut().0.chunks_exact_mut(11) {
        (0..3).for_each(|i| row[i] += offset[i]);
    }
    let shift = DVec3::from(offset.map(f64::from));
    let far: Vec<_> = cameras(3, (48, 32), 1.0)
        .iter()
        .map(|camera| {
            let rotation = camera.rotation();
            Camera::new(*camera.intrinsics(), rotation, camera.translation() - rotation * shift).unwrap()
        })
        .collect();
    let views = photographs(&moved, &far);
    let mut off = moved.clone();
    off.buffers_mut().1.iter_mut().for_each(|v| *v += 0.3);
    let config = Config { stop: Stop::Steps(60), ..Config::default() };
    let report = run(off, &views, &config).unwrap().report;
    let gain = report.steps.last().unwrap().psnr_context - report.psnr_start;
    assert!(gain > 5.0, "{gain} dB");
}

#[test]
fn what_cannot_be_done_is_said() {
    let scene = wall(3, 1.0);
    let views = photographs(&scene, &cameras(1, (16, 9), 1.0));
    let said = |views: &[View], config: &Config| run(scene.clone(), views, config).unwrap_err().to_string();
    assert_eq!(said(&[], &Config::default()), "no context views: refinement needs at least one photograph");
    let setting = said(&views, &Config { views_per_step: 0, ..Config::default() });
    assert_eq!(setting, "refinement setting views_per_step is 0, expected at least 1");
    for least in [0.0, 0.2, f32::NAN] {
        let setting = said(&views, &Config { alpha_min: least, ..Config::default() });
        assert!(setting.starts_with("refinement setting alpha_min is "), "{setting}");
        let setting = said(&views, &Config { transmittance_min: least, ..Config::default() });
        assert!(setting.starts_with("refinement setting transmittance_min is "), "{setting}");
    }
    assert!(matches!(run(scene.clone(), &[], &Config::default()), Err(Error::NoViews)));
}

#[test]
fn views_smaller_than_the_window_of_ssim_are_compared_by_colours_alone() {
    let truth = wall(3, 1.0);
    let views = photographs(&truth, &cameras(1, (16, 9), 1.0));
    let mut off = truth.clone();
    off.buffers_mut().1.iter_mut().for_each(|v| *v += 0.3);
    let with = |dssim: f32| {
        let config =
            Config { stop: Stop::Steps(5), loss: Loss { dssim, ..Loss::default() }, ..Config::default() };
        run(off.clone(), &views, &config).unwrap().gaussians
    };
    assert!(with(0.5) == with(0.0));
}

#[test]
fn flat_photographs_are_met() {
    let scene = wall(6, 1.0);
    let mut views = photographs(&scene, &cameras(2, (32, 24), 1.0));
    for view in &mut views {
        *view.image_mut() = Image::filled(32, 24, [0.5; 3]).unwrap();
    }
    let config =
        Config { stop: Stop::Steps(40), loss: Loss { dssim: 0.2, ..Loss::default() }, ..Config::default() };
    let refined = run(scene, &views, &config).unwrap();
    let report = &refined.report;
    assert!(report.steps.last().unwrap().psnr_context > report.psnr_start + 3.0);
    assert!(refined.gaussians.geometry().iter().all(|v| v.is_finite()));
}

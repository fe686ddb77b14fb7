use crate::{WALK, config, is_keyframe, mean, psnr, push_all, stereo};
use gs_scene::{DepthMap, View};
use mapper::{Config, Mapper, Outcome};

/// PSNR of the map in frames that were keyframes, and in others.
fn figures(config: Config, views: &[View]) -> (f64, f64, usize) {
    let mut mapper = Mapper::new(config).unwrap();
    let updates = push_all(&mut mapper, views);
    let of = |keyframes: bool| {
        let chosen = views.iter().zip(&updates).filter(|(_, update)| is_keyframe(update) == keyframes);
        mean(chosen.map(|(view, _)| psnr(mapper.map(), view)))
    };
    (of(true), of(false), mapper.map().len())
}

#[test]
fn frames_between_keyframes_look_as_they_should() {
    let (mapped, between, count) = figures(config(), &WALK[..24]);
    assert!(mapped > 22.0 && between > 21.0, "{mapped} {between} {count}");
}

#[test]
fn stereo_makes_a_map() {
    let (mapped, _, count) = figures(stereo(), &WALK[..24]);
    assert!(mapped > 15.0 && count > 1_000, "{mapped} {count}");
}

#[test]
fn a_smaller_cap_costs_quality_slowly() {
    let (_, full, count) = figures(config(), &WALK[..24]);
    let (_, half, _) = figures(Config { cap: count / 2, ..config() }, &WALK[..24]);
    assert!(half < full + 0.3 && half > full - 3.0, "{full} with {count}, {half} with half");
}

#[test]
fn gradient_steps_close_the_gaps() {
    let (plain, plain_between, _) = figures(Config { refine: 0, ..config() }, &WALK[..12]);
    let (refined, between, _) = figures(config(), &WALK[..12]);
    assert!(
        refined > plain + 1.5 && between > plain_between + 1.0,
        "{plain} {refined}, {plain_between} {between}"
    );
}

/// The view with something else for its depth.
fn with_depth(view: &View, depth: impl Fn(usize, f32) -> f32) -> View {
    let (width, height) = (view.image().width(), view.image().height());
    let data = view.depth().unwrap().data().iter().enumerate().map(|(i, &z)| depth(i, z)).collect();
    let depth = DepthMap::new(width, height, data).unwrap();
    View::new(view.name(), view.image().clone(), *view.camera(), Some(depth)).unwrap()
}

#[test]
fn what_later_frames_see_through_goes() {
    // In the first frame half of the picture is at half its depth: a screen in the air that no other frame sees.
    let width = WALK[0].image().width();
    let wrong = with_depth(&WALK[0], |i, z| if i % width < width / 2 { 0.5 * z } else { z });
    let mut views = WALK[..10].to_vec();
    views[0] = wrong;
    let mut mapper = Mapper::new(config()).unwrap();
    let updates = push_all(&mut mapper, &views);
    let removed: usize = updates
        .iter()
        .map(|update| match update.outcome {
            Outcome::Keyframe(keyframe) => keyframe.removed,
            _ => 0,
        })
        .sum();
    assert!(removed > 100, "{removed}");
    let mut clean = Mapper::new(config()).unwrap();
    push_all(&mut clean, &WALK[..10]);
    let (with, without) = (psnr(mapper.map(), &WALK[6]), psnr(clean.map(), &WALK[6]));
    assert!(with > without - 1.5, "{with} {without}");
}

#[test]
fn noise_of_depth_is_averaged_away() {
    // Every frame is off by 1 % of the depth, one way or the other.
    let noisy: Vec<View> = (0_u32..)
        .zip(&WALK[..24])
        .map(|(frame, view)| {
            let sign = if frame.wrapping_mul(2_654_435_761) >> 31 == 0 { 1.0 } else { -1.0 };
            with_depth(view, |_, z| z * (1.0 + 0.01 * sign))
        })
        .collect();
    // How far the map's surface lies from the true one, relative, on the mean of all frames.
    let off = |mapper: &Mapper| {
        let errors = WALK[..24].iter().step_by(4).map(|view| {
            let near = gs_raster::near_plane(mapper.map(), view.camera());
            let settings =
                gs_raster::RenderSettings { near, depth: true, ..gs_raster::RenderSettings::default() };
            let rendered =
                gs_raster::Rasterizer::cpu().render(mapper.map(), view.camera(), &settings).unwrap();
            let depth = rendered.depth.unwrap();
            let mut errors: Vec<f32> = depth
                .iter()
                .zip(view.depth().unwrap().data())
                .filter(|(a, b)| **a > 0.0 && **b > 0.0)
                .map(|(a, b)| (a / b - 1.0).abs())
                .collect();
            errors.sort_by(f32::total_cmp);
            f64::from(errors[errors.len() / 2])
        });
        mean(errors)
    };
    // Fusion alone; gradient steps on the pictures give a part of it back.
    for (refine, bound) in [(0, 0.008), (config().refine, 0.0095)] {
        let mut mapper = Mapper::new(Config { refine, ..config() }).unwrap();
        push_all(&mut mapper, &noisy);
        assert!(off(&mapper) < bound, "{refine} steps: {}", off(&mapper));
    }
}

use crate::{COURTYARD, camera_at, depths, flat, known, sweep};
use depth_backbone::{DepthNetwork, DepthRange, DepthWeights, PlaneSweep};
use gs_scene::View;
use scene_sim::{Traced, demo_scene, lens};
use std::sync::Arc;

/// The sweep with a network whose weights are those that training begins with, or, with `disorder`, any.
fn with_network(sweep: &PlaneSweep, disorder: f32) -> PlaneSweep {
    let mut weights = DepthWeights::initial(1);
    let numbers = weights.values.iter_mut().enumerate();
    numbers.for_each(|(i, value)| *value += disorder * (i as f32 * 0.7).sin());
    PlaneSweep { network: Some(Arc::new(DepthNetwork::new(&weights).unwrap())), ..sweep.clone() }
}

#[test]
fn what_the_views_confirm_stays_and_the_rest_is_the_networks() {
    let views = &COURTYARD[..3];
    let stereo = depths(&known(views), views);
    let learned = depths(&with_network(&known(views), 0.0), views);
    let (mut confirmed, mut rest, mut changed) = (0, 0, 0);
    for (stereo, learned) in stereo.iter().zip(&learned) {
        // The photographs may contradict a point in one of the two alone, as they judge by the surfaces of the others.
        for pixel in 0..stereo.confidence.len() {
            let depths = (stereo.depth.data()[pixel], learned.depth.data()[pixel]);
            if stereo.confidence[pixel] >= 0.5 {
                confirmed += 1;
                assert_eq!(depths.0, depths.1, "pixel {pixel}");
            } else {
                rest += 1;
                changed += usize::from(depths.0 != depths.1);
                assert!(learned.confidence[pixel] < 0.5 || stereo.confidence[pixel] == 0.0, "pixel {pixel}");
            }
        }
    }
    assert!(confirmed > 1000 && changed * 2 > rest, "{confirmed} confirmed, {changed} of {rest} changed");
}

#[test]
fn any_number_of_threads_gives_the_same_depth() {
    let views = &COURTYARD[..3];
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| depths(&with_network(&known(views), 0.02), views))
    };
    for (a, b) in on(1).iter().zip(&on(3)) {
        assert_eq!((&a.depth, &a.confidence), (&b.depth, &b.confidence));
    }
}

#[test]
fn weights_that_mean_nothing_give_defined_depth() {
    let views = &COURTYARD[..2];
    for disorder in [0.1, 3.0] {
        depths(&with_network(&known(views), disorder), views);
    }
}

#[test]
fn pictures_without_texture_and_of_single_pixels_are_defined() {
    let range = DepthRange::Known { near: 1.0, far: 8.0 };
    let views: Vec<View> = (0..3).map(|i| flat(&i.to_string(), camera_at(0.2 * f64::from(i)), 0.4)).collect();
    depths(&with_network(&sweep(range), 0.0), &views);
    let small: Vec<View> = (0..2)
        .map(|i| {
            let camera = camera_at(0.2 * f64::from(i));
            let intrinsics = camera.intrinsics().resized(1, 1);
            flat(&i.to_string(), camera.with_intrinsics(intrinsics).unwrap(), 0.4)
        })
        .collect();
    depths(&with_network(&sweep(range), 0.1), &small);
}

#[test]
fn views_of_different_odd_sizes() {
    let scene = Traced::new(&demo_scene()).unwrap();
    let cameras: Vec<_> = COURTYARD
        .iter()
        .zip([(61, 41), (75, 50), (40, 67)])
        .map(|(view, (width, height))| view.camera().with_intrinsics(lens(width, height, 62.0)).unwrap())
        .collect();
    let views = crate::photograph(&scene, &cameras);
    depths(&with_network(&known(&views), 0.02), &views);
}

use crate::{COURTYARD, given_depth, plane_sweep, psnr, run};
use gs_scene::View;
use sparsesplat::{Allocation, Backbone, Config, DepthRange, Head, Predictor, SweepDepth};

/// Mean PSNR, decibels, of showing the context view whose camera is nearest to each target's.
fn nearest_view_psnr() -> f64 {
    let (views, targets) = &*COURTYARD;
    let of = |target: &View| {
        let distance = |view: &&View| view.camera().position().distance(target.camera().position());
        let nearest = views.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        image_metrics::psnr(nearest.image(), target.image()).unwrap()
    };
    targets.iter().map(of).sum::<f64>() / targets.len() as f64
}

/// Held-out views must be closer to the photographs than the nearest view shown as it is, by `least` decibels.
fn check(name: &str, config: &Config, least: f64) {
    let found = psnr(&run(&COURTYARD.0, config), &COURTYARD.1) - nearest_view_psnr();
    assert!(found >= least, "{name}: {found:.2} dB above the nearest view, expected {least}");
}

// The limits are what was measured, less about half a decibel.

#[test]
fn held_out_views_from_exact_depth() {
    check("2k", &given_depth(2_000), 2.3);
    check("8k", &given_depth(8_000), 4.1);
    check("32k", &given_depth(32_000), 4.0);
    for allocation in [Allocation::Laplacian, Allocation::Random] {
        check(&format!("{allocation:?}, 8k"), &Config { allocation, ..given_depth(8_000) }, 4.0);
    }
    for allocation in [Allocation::Merged, Allocation::VoxelAligned] {
        check(&format!("{allocation:?}, 8k"), &Config { allocation, ..given_depth(8_000) }, 2.0);
    }
    check("pixel-aligned", &Config { allocation: Allocation::PixelAligned, ..given_depth(1) }, 3.7);
}

#[test]
fn held_out_views_from_stereo() {
    check("stereo, 8k", &plane_sweep(8_000), 5.5);
    let estimate = Config { depth_range: DepthRange::Estimate, ..plane_sweep(8_000) };
    check("stereo in an estimated range, 8k", &estimate, 5.5);
}

#[test]
fn the_learned_heads_are_better_than_the_closed_form() {
    let of = |head: Head| {
        let prediction = run(&COURTYARD.0, &Config { head, ..plane_sweep(8_000) });
        (psnr(&prediction, &COURTYARD.1), prediction.head)
    };
    let (closed_form, other) = of(Head::ClosedForm);
    let names = [Head::Default, Head::Attention].map(|head| {
        let (learned, name) = of(head);
        assert!(learned >= closed_form + 1.0, "{name}: {learned:.2} dB, {other}: {closed_form:.2} dB");
        name
    });
    assert!(names[0] != names[1] && !names.contains(&other), "{names:?}, {other}: three heads");
}

#[test]
fn a_head_that_is_asked_for_is_never_another() {
    let config = Config { head: Head::Attention, ..given_depth(2_000) };
    let error = Predictor::new(config).unwrap_err();
    assert!(matches!(error, sparsesplat::Error::AttentionBackbone), "{error}");
}

#[test]
fn the_far_shell_fills_what_no_view_covers() {
    let of = |far_shell| psnr(&run(&COURTYARD.0, &Config { far_shell, ..given_depth(8_000) }), &COURTYARD.1);
    let (with, without) = (of(true), of(false));
    assert!(with > without + 3.0, "{with:.2} dB with, {without:.2} dB without");
}

/// The scene of the demonstration was not trained on.
#[test]
fn learned_depth_fills_better_than_interpolation_does() {
    let views = &COURTYARD.0;
    let of = |depth| {
        let config = Config { backbone: Backbone::PlaneSweep { planes: 128, depth }, ..plane_sweep(1) };
        Predictor::new(config).unwrap().geometry(views).unwrap().views
    };
    let (mut unconfirmed, mut filled, mut sums) = (0, 0, [0.0; 2]);
    for ((view, stereo), learned) in views.iter().zip(of(SweepDepth::Stereo)).zip(of(SweepDepth::Learned)) {
        for (pixel, &exact) in view.depth().unwrap().data().iter().enumerate() {
            let [by_stereo, by_network] = [&stereo, &learned].map(|found| found.depth.data()[pixel]);
            if stereo.is_confirmed(pixel) {
                assert_eq!(by_stereo, by_network);
            } else if exact > 0.0 {
                unconfirmed += 1;
                filled += usize::from(by_stereo != by_network);
                for (sum, found) in sums.iter_mut().zip([by_stereo, by_network]) {
                    // Where the network is unsure both are the same.
                    *sum += f64::from(u8::from(by_stereo != by_network))
                        * f64::from((found - exact).abs() / exact);
                }
            }
        }
    }
    assert!(unconfirmed > 1000 && 3 * filled > unconfirmed, "{filled} of {unconfirmed}");
    let [stereo, learned] = sums;
    assert!(learned < 0.93 * stereo, "{learned} {stereo}");
}

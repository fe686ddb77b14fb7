use crate::{COURTYARD, given_depth, plane_sweep, positions, psnr, run};
use glam::DVec3;
use gs_scene::{Camera, DepthMap, View};
use sparsesplat::{Allocation, Config, DepthRange, Prediction, Sampler};

fn bits(prediction: &Prediction) -> Vec<u32> {
    let gaussians = &prediction.gaussians;
    gaussians.geometry().iter().chain(gaussians.sh()).map(|v| v.to_bits()).collect()
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let views = &COURTYARD.0[..3];
    for config in [
        plane_sweep(3_000),
        Config { sampler: Sampler::Bernoulli, ..given_depth(3_000) },
        Config { allocation: Allocation::Merged, ..given_depth(3_000) },
        Config { allocation: Allocation::VoxelAligned, ..given_depth(3_000) },
    ] {
        let run_on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(views, &config))
        };
        let (one, two) = (run_on(1), run_on(2));
        assert!(bits(&one) == bits(&two), "{config:?}");
        assert_eq!((one.counts, one.tau, one.exposure), (two.counts, two.tau, two.exposure));
    }
}

#[test]
fn the_seed_changes_which_pixels_are_chosen() {
    for sampler in [Sampler::Fixed, Sampler::Bernoulli] {
        let of = |seed| bits(&run(&COURTYARD.0, &Config { seed, sampler, ..given_depth(3_000) }));
        assert!(of(0) == of(0) && of(0) != of(1), "{sampler:?}");
    }
}

#[test]
fn every_allocation_chooses_other_pixels() {
    use Allocation::{Entropy, Laplacian, Merged, Random, VoxelAligned};
    let of =
        |allocation| positions(&run(&COURTYARD.0, &Config { allocation, ..given_depth(3_000) }).gaussians);
    let found = [Entropy, Laplacian, Random, Merged, VoxelAligned].map(of);
    for (i, one) in found.iter().enumerate() {
        assert!(found[..i].iter().all(|other| other != one), "{i}");
    }
}

/// The scene scaled about the origin, then moved.
fn moved(views: &[View], scale: f64, offset: DVec3) -> Vec<View> {
    let move_one = |view: &View| {
        let camera = view.camera();
        let position = camera.position() * scale + offset;
        let camera =
            Camera::new(*camera.intrinsics(), camera.rotation(), -(camera.rotation() * position)).unwrap();
        let depth = view.depth().unwrap().data().iter().map(|&d| d * scale as f32).collect();
        let depth = DepthMap::new(camera.width(), camera.height(), depth).unwrap();
        View::new(view.name(), view.image().clone(), camera, Some(depth)).unwrap()
    };
    views.iter().map(move_one).collect()
}

/// Held-out PSNR of the moved scene must be the original's within half a decibel.
fn check_moved(config: impl Fn(f64) -> Config, scale: f64, offset: f64) {
    let (views, targets) = &*COURTYARD;
    let offset = DVec3::new(offset, -offset, offset);
    let before = psnr(&run(views, &config(1.0)), targets);
    let after = psnr(&run(&moved(views, scale, offset), &config(scale)), &moved(targets, scale, offset));
    assert!((after - before).abs() < 0.5, "scale {scale}, offset {offset}: {before:.2} became {after:.2} dB");
}

#[test]
fn scale_and_offset_do_not_matter() {
    check_moved(|_| given_depth(6_000), 1.0, 1e4);
    check_moved(|_| given_depth(6_000), 100.0, 1e4);
    check_moved(|_| given_depth(6_000), 0.01, 0.0);
    for allocation in [Allocation::Merged, Allocation::VoxelAligned] {
        check_moved(|_| Config { allocation, ..given_depth(6_000) }, 100.0, 1e4);
        check_moved(|_| Config { allocation, ..given_depth(6_000) }, 0.01, 0.0);
    }
    let stereo = |scale: f64| {
        let depth_range = DepthRange::Known { near: 3.0 * scale, far: 10.0 * scale };
        Config { depth_range, ..plane_sweep(6_000) }
    };
    check_moved(stereo, 100.0, 1e4);
}

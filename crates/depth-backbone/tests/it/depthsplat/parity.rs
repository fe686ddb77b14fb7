use super::golden::Golden;
use depth_backbone::{DepthSplat, Scales};

fn read(name: &str) -> Golden {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/depth-backbone");
    Golden::read(&std::fs::read(format!("{folder}/{name}.safetensors")).unwrap()).unwrap()
}

/// Every map of the file is computed and lies within the rounding of f32 of the other implementation's.
fn check(golden: &Golden, network: &DepthSplat) {
    let compared = golden.compare(network).unwrap();
    assert!(compared.len() >= 10);
    for (name, deviation) in compared {
        let d = deviation.unwrap_or_else(|| panic!("{name} is not computed"));
        assert!(d.rms < 2e-5 && d.largest < 5e-4, "{name}: {:.1e} rms, {:.1e} at most", d.rms, d.largest);
        if name == "depth.final" {
            assert!(d.relative < 1e-4, "depth is off by {:.1e} of itself", d.relative);
        }
    }
}

#[test]
fn one_scale_three_views() {
    let golden = read("eighth_three_views");
    let network = DepthSplat::untrained(golden.variant, &golden.salt).unwrap();
    check(&golden, &network);
    // Other weights are noticed.
    let other = DepthSplat::untrained(golden.variant, "other").unwrap();
    let compared = golden.compare(&other).unwrap();
    assert!(compared.iter().any(|(_, d)| d.as_ref().is_some_and(|d| d.rms > 1e-2)));
}

#[test]
fn one_scale_five_views_of_which_two_are_neighbours() {
    let golden = read("eighth_five_views");
    check(&golden, &DepthSplat::untrained(golden.variant, &golden.salt).unwrap());
}

#[test]
fn two_scales_two_views() {
    let golden = read("eighth_quarter_two_views");
    assert_eq!(golden.variant.scales, Scales::EighthQuarter);
    check(&golden, &DepthSplat::untrained(golden.variant, &golden.salt).unwrap());
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let golden = read("eighth_three_views");
    let network = DepthSplat::untrained(golden.variant, &golden.salt).unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (geometry, _) = pool.install(|| network.trace(&golden.views, &golden.ranges, false)).unwrap();
        geometry.into_iter().map(|g| (g.depth, g.confidence, g.features)).collect::<Vec<_>>()
    };
    assert!(run(1) == run(3));
}

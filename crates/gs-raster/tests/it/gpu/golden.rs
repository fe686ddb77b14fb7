//! Cases computed by an independent f64 program.

use super::gpu;
use crate::check::check_rasterizer;
use crate::fixtures::cases;

#[test]
#[ignore = "gpu"]
fn every_case_is_within_tolerance() {
    for (name, case) in cases() {
        for row in check_rasterizer(&case, &mut gpu()).expect("valid") {
            assert!(row.holds(), "{name} {}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound);
        }
    }
}

#[test]
#[ignore = "gpu"]
fn a_wrong_scene_is_noticed() {
    for (name, mut case) in cases().into_iter().take(6) {
        case.gaussians.buffers_mut().0.chunks_exact_mut(11).for_each(|row| row[0] += 1e-4);
        assert!(check_rasterizer(&case, &mut gpu()).expect("valid").iter().any(|row| !row.holds()), "{name}");
    }
}

//! Cases computed by an independent f64 program. Two of its cases
//! are left to the example `check_case`, to keep the repository small: `d_rand2000_sh2` and `i_e3nn_sh`.

use crate::check::{check_rasterizer, check_reference};
use crate::fixtures::cases;
use gs_raster::Rasterizer;

#[test]
fn every_case_is_within_tolerance() {
    for (name, case) in cases() {
        for row in check_rasterizer(&case, &mut Rasterizer::cpu())
            .expect("valid")
            .into_iter()
            .chain(check_reference(&case))
        {
            assert!(row.holds(), "{name} {}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound);
        }
    }
}

#[test]
fn a_wrong_scene_is_noticed() {
    for (name, mut case) in cases().into_iter().take(6) {
        case.gaussians.buffers_mut().0.chunks_exact_mut(11).for_each(|row| row[0] += 1e-4);
        assert!(
            check_rasterizer(&case, &mut Rasterizer::cpu()).expect("valid").iter().any(|row| !row.holds()),
            "{name}"
        );
    }
}

//! The distortion model against OpenCV's figures, and against itself.

use glam::DVec2;
use gs_scene::Intrinsics;
use proptest::prelude::*;
use view_data::{Distortion, Lens, LensModel};

/// A phone's lens at 540×960.
const PHONE: Lens = Lens {
    intrinsics: Intrinsics { fx: 687.76, fy: 687.245, cx: 277.279, cy: 482.634, width: 540, height: 960 },
    model: LensModel::RadialTangential(Distortion {
        k1: 0.0578421,
        k2: -0.0805099,
        k3: 0.0,
        p1: -0.000980296,
        p2: 0.00015575,
    }),
};

/// Pixel and undistorted direction, from OpenCV's `undistortPoints` iterated until its round trip was below 1e-9 px.
const OPENCV: [([f64; 2], [f64; 2]); 20] = [
    ([0.5, 0.5], [-0.40054528398735423, -0.697445259730638]),
    ([539.5, 0.5], [0.37889174439103096, -0.6967395780082548]),
    ([0.5, 959.5], [-0.40152898247559465, 0.692772923061433]),
    ([539.5, 959.5], [0.3798261929819371, 0.692041111931248]),
    ([270.0, 480.0], [-0.010583531377436476, -0.00383252586087239]),
    ([343.9593111535853, 258.9952452133155], [0.09633750340136445, -0.32329623862789597]),
    ([22.12570292554513, 15.86653010738793], [-0.36838542749155223, -0.6736743062368076]),
    ([439.1659291681471, 876.2453541866129], [0.23315037147473824, 0.567813262111892]),
    ([327.58331891427713, 700.3166985446385], [0.07279247297205665, 0.31540469746437755]),
    ([293.55749539132836, 897.6695268362575], [0.02339715921778706, 0.5987420907708946]),
    ([440.56091922562734, 2.628960163342171], [0.23512354485059547, -0.6914422274386844]),
    ([462.99830935728744, 32.24215229324578], [0.26719732303957605, -0.6481784718444786]),
    ([394.0139410721698, 168.62939577845665], [0.1680093456766485, -0.4521367425732318]),
    ([466.11661806893875, 519.802771439128], [0.2734665357402594, 0.053944790366968275]),
    ([161.8444208901878, 405.7797323497521], [-0.1674498323002003, -0.1115248554955766]),
    ([15.292622418550001, 119.3119454395814], [-0.376829318078942, -0.5224864735755343]),
    ([362.13718393456037, 621.30193111128], [0.12305309970062896, 0.20130202249732354]),
    ([332.3079601998771, 368.3304520914081], [0.07982947427719152, -0.1659200503373448]),
    ([538.493365326174, 941.6019252251808], [0.37778673303193855, 0.6650193045615606]),
    ([370.19267161957515, 624.4409052171036], [0.13470362250493143, 0.2058152127426665]),
];

#[test]
fn directions_are_opencvs() {
    for (pixel, direction) in OPENCV {
        let (pixel, direction) = (DVec2::from(pixel), DVec2::from(direction));
        let found = PHONE.undistort(pixel).unwrap();
        assert!((found - direction).length() < 1e-11, "{pixel}: {found}, OpenCV has {direction}");
        assert!((PHONE.distort(direction) - pixel).length() < 1e-9, "{direction}");
        assert!((PHONE.distort(found) - pixel).length() < 1e-10, "{pixel}");
    }
}

#[test]
fn a_folding_lens_has_no_inverse_beyond_its_fold() {
    // x (1 - x²) turns back at x = 1/√3, where it is 0.385.
    let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 0.0, cy: 0.0, width: 100, height: 100 };
    let lens = Lens { intrinsics, model: Distortion { k1: -1.0, ..Distortion::default() }.into() };
    let inside = lens.undistort(DVec2::new(38.0, 0.0)).unwrap();
    assert!((lens.distort(inside).x - 38.0).abs() < 1e-9 && inside.x < 0.5774);
    assert_eq!(lens.undistort(DVec2::new(39.0, 0.0)), None);
    for v in [f64::NAN, f64::INFINITY, 1e300] {
        assert_eq!(lens.undistort(DVec2::new(v, 0.0)), None, "{v}");
    }
}

proptest! {
    #[test]
    fn undistort_inverts_distort(
        k in prop::array::uniform3(-0.1..0.1f64), p in prop::array::uniform2(-0.01..0.01f64),
        x in -0.8..0.8f64, y in -0.8..0.8f64,
    ) {
        let distortion = Distortion { k1: k[0], k2: k[1] * 0.5, k3: k[2] * 0.2, p1: p[0], p2: p[1] };
        let lens = Lens { model: distortion.into(), ..PHONE };
        let direction = DVec2::new(x, y);
        let pixel = lens.distort(direction);
        let back = lens.undistort(pixel);
        prop_assert!(back.is_some_and(|back| (back - direction).length() < 1e-11), "{pixel} {back:?} {direction}");
        prop_assert!((lens.distort(back.unwrap()) - pixel).length() < 1e-9);
    }
}

//! Gradients against the f64 reference on random scenes. Golden ones are in `golden`, what must hold of any gradient in `backward`.

use crate::check::settings;
use crate::losses::{compare_gradients, pixels};
use crate::scenes::{backward, camera, gaussians};
use gs_reference::Profile;
use gs_reference::tolerance::AMBIGUOUS;
use proptest::prelude::*;

const BACKGROUND: [f32; 3] = [0.2, 0.5, 0.9];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn equal_those_of_the_reference(scene in gaussians(40), camera in camera(), antialias: bool, seed: u64) {
        let profile = Profile { antialias, ..Profile::default() };
        let background = BACKGROUND.map(f64::from);
        let truth = gs_reference::render(&scene, &camera, background, &profile);
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        prop_assume!(ambiguous.contains(&false));
        let pixels = pixels(seed, &ambiguous, &truth.alpha);
        let found = backward(&scene, &camera, &settings(&profile, BACKGROUND), &pixels);
        for compared in compare_gradients(&scene, &camera, BACKGROUND, &profile, &truth, &pixels, &found) {
            let row = compared.row();
            prop_assert!(row.holds(), "{}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound);
        }
    }
}

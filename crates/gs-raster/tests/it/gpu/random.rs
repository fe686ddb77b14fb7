//! Random scenes, against the f64 reference and against the CPU.

use super::gpu;
use crate::check::settings;
use crate::losses::{compare_gradients, pixels};
use crate::scenes::{camera, gaussians};
use gs_raster::Rasterizer;
use gs_reference::tolerance::{AMBIGUOUS, f32_bound};
use gs_reference::{Profile, compare};
use proptest::prelude::*;

const BACKGROUND: [f32; 3] = [0.2, 0.5, 0.9];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    #[ignore = "gpu"]
    fn equal_the_reference_and_the_cpu(scene in gaussians(40), camera in camera(), antialias: bool, seed: u64) {
        let profile = Profile { antialias, ..Profile::default() };
        let truth = gs_reference::render(&scene, &camera, BACKGROUND.map(f64::from), &profile);
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        prop_assume!(ambiguous.contains(&false));
        let settings = settings(&profile, BACKGROUND);
        let pixels = pixels(seed, &ambiguous, &truth.alpha);
        let mut gpu = gpu();
        let (views, tape) = gpu.record(&scene, &[camera], &settings).expect("valid");
        let found = gpu.backward(&scene, &tape, std::slice::from_ref(&pixels)).expect("valid");
        let view = &views[0];
        let on_cpu = Rasterizer::cpu().render(&scene, &camera, &settings).expect("valid");

        let depth = view.depth.as_ref().expect("asked for");
        let single = |values: &[f32]| values.iter().map(|&value| f64::from(value)).collect();
        let cpu_depth = on_cpu.depth.as_ref().expect("asked for");
        let outputs = [
            ("image", view.image.data(), [truth.image.clone(), single(on_cpu.image.data())]),
            ("alpha", &view.alpha, [truth.alpha.clone(), single(&on_cpu.alpha)]),
            ("depth", depth, [truth.depth.clone(), single(cpu_depth)]),
        ];
        for (output, found, expected) in outputs {
            for (other, expected) in ["reference", "cpu"].into_iter().zip(expected) {
                let deviation = compare(expected, found.iter().copied(), &ambiguous).expect("comparable");
                let bound = f32_bound(&deviation, None);
                prop_assert!(deviation.max_abs <= bound, "{}, {}: {:?}", output, other, deviation);
            }
        }
        for compared in compare_gradients(&scene, &camera, BACKGROUND, &profile, &truth, &pixels, &found) {
            let row = compared.row();
            prop_assert!(row.holds(), "{}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound);
        }
    }
}

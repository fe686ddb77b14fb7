//! Outputs equal those of the formulas.

use super::cases::{Single, alike, random, repeated};
use crate::oracle::Case;
use attn_head::{Kind, OUTPUTS, fused};
use proptest::prelude::*;
use proptest::sample;

/// Largest error, relative to the root mean square of all outputs.
fn error(case: &Case) -> f64 {
    let expected = case.run().out;
    let single = Single::new(case);
    let found = fused::forward(&single.config, &single.weights, &single.inputs());
    assert_eq!(found.len(), expected.len());
    let size = (expected.iter().map(|v| v * v).sum::<f64>() / expected.len() as f64).sqrt();
    found.iter().zip(&expected).map(|(f, e)| (f64::from(*f) - e).abs() / size).fold(0.0, |worst, e| {
        assert!(e.is_finite(), "an output that is no number");
        f64::max(worst, e)
    })
}

#[test]
fn outputs_are_those_of_the_formulas() {
    for (n, k, image) in
        [(1, 0, 5), (1, 3, 64), (2, 1, 1), (47, 20, 64), (48, 4, 32), (49, 0, 64), (131, 7, 21)]
    {
        for kind in Kind::ALL {
            let error = error(&random(kind, n, k, image, 1));
            assert!(error < 1e-5, "{kind:?}, n = {n}, k = {k}: {error:e}");
        }
    }
}

/// Queries `by` times as large: logits grow with their square.
fn with_larger_queries(mut case: Case, by: f64) -> Case {
    for layer in 0..case.config.kind.layers() {
        for part in ["weight", "bias"] {
            let range = case.at(&format!("blocks.{layer}.attn.q.{part}"));
            case.weights[range].iter_mut().for_each(|w| *w = f64::from((*w * by) as f32));
        }
    }
    case
}

/// Weights of neighbours are exponentials of logits: a logit's rounding is their relative error.
#[test]
fn large_logits_cost_no_more_than_their_rounding() {
    for (by, least, most, bound) in [(1.9, 30.0, 50.0, 1e-5), (40.0, 9e3, 2e4, 1e-3)] {
        let case = with_larger_queries(random(Kind::Attention, 60, 8, 16, 4), by);
        let largest = case.run().largest_logit;
        assert!((least..most).contains(&largest), "logits up to {largest}");
        let error = error(&case);
        assert!(error < bound, "logits up to {largest}: {error:e}");
    }
}

/// Neighbours far away, at distances that f32 holds exactly: the logits are as large, and cost their rounding.
#[test]
fn huge_offsets_cost_no_more_than_the_rounding_of_their_logits() {
    for by in [64.0, 4096.0, 65536.0] {
        let mut case = random(Kind::Attention, 40, 6, 8, 5);
        case.relative.iter_mut().flatten().for_each(|v| *v *= by);
        let largest = case.run().largest_logit;
        let error = error(&case);
        assert!(
            error < 32.0 * f64::from(f32::EPSILON) * largest.max(10.0),
            "{by}: {error:e} with logits up to {largest}"
        );
    }
}

/// Beyond what a logit can be without infinity the result is still a number, and so is a large maximum.
#[test]
fn distances_beyond_all_measure_give_numbers() {
    for kind in Kind::ALL {
        let mut case = random(kind, 20, 5, 4, 6);
        case.relative.iter_mut().flatten().for_each(|v| *v *= 1e12);
        let single = Single::new(&case);
        let found = fused::forward(&single.config, &single.weights, &single.inputs());
        assert!(found.iter().all(|v| v.is_finite()), "{kind:?}");
    }
}

/// A maximum does not pass over what is not a number, wherever among the pairs it is.
#[test]
fn pairs_that_overflow_are_noticed() {
    for (kind, layer) in [(Kind::EdgeConv, "edge.0"), (Kind::MaxPool, "pool.0"), (Kind::Mlp, "message")] {
        for pair in 0..4 {
            let mut case = random(kind, 3, 4, 4, 6);
            let weight = case.at(&format!("blocks.0.{layer}.weight"));
            case.weights[weight].iter_mut().for_each(|w| *w *= 128.0);
            case.relative[4 + pair] = [3e38, -3e38, 3e38];
            let single = Single::new(&case);
            let found = fused::forward(&single.config, &single.weights, &single.inputs());
            assert!(found[OUTPUTS..2 * OUTPUTS].iter().any(|v| !v.is_finite()), "{kind:?}, pair {pair}");
        }
    }
}

#[test]
fn no_anchors_have_no_outputs() {
    for kind in Kind::ALL {
        let single = Single::new(&random(kind, 0, 20, 64, 1));
        assert!(fused::forward(&single.config, &single.weights, &single.inputs()).is_empty());
    }
}

#[test]
fn neighbours_may_be_repeated_or_the_anchor_itself() {
    for kind in Kind::ALL {
        let case = repeated(random(kind, 30, 6, 8, 2));
        assert!(error(&case) < 1e-5, "{kind:?} {:e}", error(&case));
        let case = alike(case);
        assert!(error(&case) < 1e-5, "{kind:?} {:e}", error(&case));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn outputs_are_those_of_the_formulas_for_any_shape(
        kind in sample::select(&Kind::ALL), n in 1_usize..55, k in 0_usize..9, image in 1_usize..20, seed: u64,
    ) {
        let error = error(&random(kind, n, k, image, seed));
        prop_assert!(error < 1e-5, "{error:e}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    for kind in Kind::ALL {
        let single = Single::new(&random(kind, 400, 5, 16, 3));
        let (config, weights, inputs) = (&single.config, &single.weights, &single.inputs());
        let grad: Vec<f32> = (0..400 * OUTPUTS).map(|i| ((i % 17) as f32 - 8.0) / 8.0).collect();
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let (out, tape) = fused::forward_recorded(config, weights, inputs);
                assert_eq!(out, fused::forward(config, weights, inputs));
                let g = fused::backward(config, weights, inputs, &tape, &grad);
                [out, g.weights, g.geometry, g.image]
                    .map(|v| v.into_iter().map(f32::to_bits).collect::<Vec<_>>())
            })
        };
        let one = on(1);
        assert!(one == on(2) && one == on(5), "{kind:?}");
    }
}

use crate::case::{Case, difference};
use attn_head::{Head, Kind, Weights};
use proptest::prelude::*;

fn kinds() -> impl Strategy<Value = Kind> {
    proptest::sample::select(&Kind::ALL)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Outputs have a size of about one; f64 leaves 1e-12, f32 1e-5 at most.
    #[test]
    fn outputs_are_those_of_the_formulas(kind in kinds(), n in 1..6_usize, k in 0..5_usize, seed: u32) {
        let case = Case::new(kind, n, k, u64::from(seed));
        let expected = case.exact().run().out;
        #[cfg(feature = "candle")]
        {
            let plain = difference(&case.plain(), &expected);
            prop_assert!(plain < 1e-9, "plain {plain:e}");
        }
        let out = Head::new(case.weights()).unwrap().run(&case.inputs()).unwrap();
        let head = difference(&out.iter().map(|v| f64::from(*v)).collect::<Vec<_>>(), &expected);
        prop_assert!(head < 1e-4, "head {head:e}");
    }

    #[cfg(feature = "candle")]
    #[test]
    fn only_the_mlp_knows_an_order_of_neighbours(kind in kinds(), n in 2..6_usize, seed: u32) {
        let k = 4;
        let case = Case::new(kind, n, k, u64::from(seed));
        let mut turned = case.clone();
        turned.neighbours.chunks_mut(k).for_each(|row| row.rotate_left(1));
        turned.relative.chunks_mut(k).for_each(|row| row.rotate_left(1));
        let difference = difference(&case.plain(), &turned.plain());
        prop_assert_eq!(difference < 1e-9, kind != Kind::Mlp, "{:e}", difference);
    }
}

#[test]
fn an_untrained_head_changes_nothing() {
    for kind in Kind::ALL {
        let case = Case::new(kind, 7, 3, 5);
        let out = Head::new(Weights::initial(case.config, 1).unwrap()).unwrap().run(&case.inputs()).unwrap();
        assert_eq!(out.len(), 7 * 38);
        assert!(out.iter().all(|v| v.to_bits() == 0), "{kind:?}");
    }
}

#[test]
fn no_anchors_have_no_outputs() {
    for kind in Kind::ALL {
        let mut case = Case::new(kind, 1, 3, 5);
        case.n = 0;
        case.geometry.clear();
        case.image.clear();
        case.neighbours.clear();
        case.relative.clear();
        case.cells.clear();
        assert!(Head::new(case.weights()).unwrap().run(&case.inputs()).unwrap().is_empty());
        #[cfg(feature = "candle")]
        assert!(case.plain().is_empty());
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    for kind in Kind::ALL {
        // More anchors than are computed at a time.
        let case = Case::new(kind, 2500, 2, 6);
        let head = Head::new(case.weights()).unwrap();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let out = pool.install(|| head.run(&case.inputs())).unwrap();
            out.into_iter().map(f32::to_bits).collect::<Vec<_>>()
        };
        let one = run(1);
        assert!(one == run(2) && one == run(3), "{kind:?}");
    }
}

#[cfg(feature = "candle")]
#[test]
fn more_anchors_than_are_computed_at_a_time() {
    for kind in Kind::ALL {
        let case = Case::new(kind, 2100, 1, 8);
        let out = Head::new(case.weights()).unwrap().run(&case.inputs()).unwrap();
        let out: Vec<f64> = out.into_iter().map(f64::from).collect();
        let difference = difference(&out, &case.plain());
        assert!(difference < 1e-4, "{kind:?} {difference:e}");
    }
}

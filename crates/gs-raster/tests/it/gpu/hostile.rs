//! Input that breaks renderers: every result is finite and defined.

use super::gpu;
use crate::hard_cases::hard_cases;
use crate::hostile::{finite_gradients, hostile, hostile_rows};
use proptest::prelude::*;

#[test]
#[ignore = "gpu"]
fn each_hard_case_does_what_it_should() {
    for case in hard_cases() {
        let complaints = case.complaints(&case.measure(&mut gpu()));
        assert!(complaints.is_empty(), "{}, {}: {complaints:?}", case.name, case.happens);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    #[ignore = "gpu"]
    fn any_bits_give_finite_gradients(
        rows in hostile_rows(),
        pixels in prop::collection::vec(hostile(), 16),
        antialias: bool,
        near in prop::sample::select(vec![0.0f32, 0.2]),
    ) {
        finite_gradients(&mut gpu(), &rows, &pixels, antialias, near)?;
    }
}

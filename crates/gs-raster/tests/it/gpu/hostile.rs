//! Input that breaks renderers: every result is finite and defined.

use super::gpu;
use crate::hard_cases::hard_cases;

#[test]
#[ignore = "gpu"]
fn each_hard_case_does_what_it_should() {
    for case in hard_cases() {
        let complaints = case.complaints(&case.measure(&mut gpu()));
        assert!(complaints.is_empty(), "{}, {}: {complaints:?}", case.name, case.happens);
    }
}

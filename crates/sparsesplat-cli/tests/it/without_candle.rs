//! What a binary without candle says where it is asked for what computes with candle.

use crate::tiny::{Called, call};

#[test]
fn what_needs_candle_is_refused_with_how_to_get_it() {
    for arguments in [
        &["train", "-o", "run"][..],
        &["train-depth", "-o", "run"],
        &["ablate", "head", "-o", "run"],
        &["bench", "knn"],
        &["eval", "--dataset", "simulated", "--backbone", "depthsplat"],
    ] {
        let Called { code, stderr, .. } = call(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {stderr}");
        assert!(stderr.contains("needs candle") && stderr.contains("cargo build"), "{arguments:?}: {stderr}");
        assert_eq!(stderr.lines().count(), 2, "{arguments:?}: {stderr}");
    }
    let doctor = call(&["doctor", "--device", "cpu"]);
    assert!(doctor.stdout.contains("without candle"), "{}", doctor.stdout);
}

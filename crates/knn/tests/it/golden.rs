mod layout;

const FILE: &[u8] =
    include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/knn/knn.safetensors"));

#[test]
fn neighbours_equal_those_found_in_f64() {
    let sets = layout::read(FILE).unwrap();
    assert_eq!(sets.len(), 5);
    for set in sets {
        let report = set.check(&knn::knn(&set.points, layout::K).unwrap());
        assert!(report.passed(), "{}: {report}", set.name);
    }
}

#[test]
fn a_wrong_neighbour_is_noticed() {
    let sets = layout::read(FILE).unwrap();
    let uniform = sets.iter().find(|set| set.name == "uniform").unwrap();
    let right = knn::knn(&uniform.points, layout::K).unwrap();
    let mut wrong = right.clone();
    wrong.indices.swap(5, 6);
    assert!(!uniform.check(&wrong).passed());
    let mut wrong = right;
    wrong.sq_distances[7] *= 1.0 + 1e-5;
    assert!(!uniform.check(&wrong).passed());
}

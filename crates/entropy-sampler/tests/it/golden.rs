mod layout;

const FILE: &[u8] = include_bytes!(concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../fixtures/entropy-sampler/entropy.safetensors"
));

#[test]
fn entropies_equal_brute_force_histograms() {
    let pictures = layout::read(FILE).unwrap();
    assert_eq!(pictures.len(), 6);
    for picture in pictures {
        for (border, expected) in &picture.expected {
            let worst = picture.worst_deviation(*border, expected).unwrap();
            assert!(worst < layout::TOLERANCE, "{} {border:?}: {worst} bits", picture.name);
        }
    }
}

#[test]
fn the_other_border_rule_is_noticed() {
    let pictures = layout::read(FILE).unwrap();
    let noise = pictures.iter().find(|picture| picture.name.starts_with("noise")).unwrap();
    let [(reflect, _), (_, clip)] = &noise.expected;
    assert!(noise.worst_deviation(*reflect, clip).unwrap() > 0.1);
}

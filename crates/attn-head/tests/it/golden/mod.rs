mod layout;

use layout::Golden;

macro_rules! fixture {
    ($name:literal) => {
        include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/attn-head/", $name)).as_slice()
    };
}

#[test]
fn all_maps_and_gradients_are_those_found_in_f64() {
    for (name, bytes) in [
        ("k20", fixture!("k20.safetensors")),
        ("k5_c32", fixture!("k5_c32.safetensors")),
        ("k0", fixture!("k0.safetensors")),
    ] {
        let deviations = Golden::read(bytes).unwrap().compare().unwrap();
        // Eleven maps and gradients of the plain form, four of the others.
        assert_eq!(deviations.len(), if cfg!(feature = "candle") { 15 } else { 4 }, "{name}");
        for d in deviations {
            assert!(d.within(), "{name}, {} {}: rms {:e}, largest {:e}", d.by, d.name, d.rms, d.largest);
        }
    }
}

#[test]
fn another_weight_is_noticed() {
    let mut golden = Golden::read(fixture!("k5_c32.safetensors")).unwrap();
    let layout = attn_head::Layout::new(&golden.weights.config);
    // Each of these has a part in the outputs.
    for name in ["phi_v.2.bias", "blocks.0.attn.delta.0.weight", "blocks.2.ffn.0.weight"] {
        let parameter = layout.parameters.iter().find(|p| p.name == name).unwrap();
        let value = golden.weights.values[parameter.offset];
        golden.weights.values[parameter.offset] += 0.05;
        let deviations = golden.compare().unwrap();
        let outside: Vec<_> = deviations.iter().filter(|d| !d.within()).map(|d| d.name.as_str()).collect();
        assert!(outside.contains(&"out"), "{name}: {outside:?}");
        golden.weights.values[parameter.offset] = value;
    }
}

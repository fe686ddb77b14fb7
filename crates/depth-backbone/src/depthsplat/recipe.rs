//! Weights by a rule instead of training: reproducible in any language, spread so that every part of the network
//! matters to its result. Parity with other implementations is checked with them; depth from them means nothing.

/// Hash of a text (Fowler, Noll, Vo; 64 bits, variant 1a).
fn fnv(parts: [&str; 2]) -> u64 {
    parts
        .iter()
        .flat_map(|part| part.bytes())
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Draw number `i` in [-1, 1), of 24 bits (splitmix64).
fn draw(hash: u64, i: u64) -> f32 {
    let mut z = hash.wrapping_add(i).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    ((z >> 40) as f32 - 8_388_608.0) / 8_388_608.0
}

/// Transposed convolutions have their inputs first.
const TRANSPOSED: [&str; 3] =
    ["resize_layers.0.weight", "resize_layers.1.weight", "_pyramid.stages.1.0.weight"];
/// Layers with a spread of their own: after these the maps keep a size of about one.
const FACTORS: [(&str, f64); 5] = [
    ("backbone.conv2.weight", 0.5),
    ("upsampler.scratch.output_conv.4.weight", 0.0625),
    ("depth_head.0.2.weight", 3.0),
    ("depth_head.1.2.weight", 3.0),
    ("gaussian_head.2.weight", 0.5),
];

/// Offset and largest deviation of a parameter.
fn spread(name: &str, shape: &[usize]) -> (f32, f32) {
    if name.ends_with(".gamma") {
        return (0.5, 0.25);
    }
    if name.ends_with("cls_token") || name.ends_with("pos_embed") {
        return (0.0, 0.5);
    }
    if let [_] = shape {
        let message_norm = name.contains("transformer.layers.") && name.contains("attn");
        let offset = match (name.ends_with(".weight"), message_norm) {
            (true, true) => 0.25,
            (true, false) => 1.0,
            (false, _) => 0.0,
        };
        return (offset, 0.1);
    }
    let transposed = TRANSPOSED.iter().any(|end| name.ends_with(end));
    let inputs: usize = if transposed { shape[0] } else { shape[1..].iter().product() };
    let factor = FACTORS.iter().find(|(end, _)| name.ends_with(end)).map_or(1.0, |(_, factor)| *factor);
    (0.0, (factor * (3.0 / inputs as f64).sqrt()) as f32)
}

/// Inputs of a layer that come from a cost volume, and are weighted less.
fn cost_channels(name: &str) -> usize {
    (0..2)
        .find(|s| {
            name == format!("depth_predictor.regressor.{s}.0.weight")
                || name == format!("depth_predictor.regressor_residual.{s}.weight")
        })
        .map_or(0, |s| 128 >> (2 * s))
}

/// The values of a parameter, row-major. Another salt gives other values.
pub(super) fn values(salt: &str, name: &str, shape: &[usize]) -> Vec<f32> {
    let hash = fnv([salt, name]);
    let (offset, largest) = spread(name, shape);
    let cost = cost_channels(name);
    let window: usize = shape.iter().skip(2).product();
    let value = |i: usize| {
        let value = offset + largest * draw(hash, i as u64);
        if cost > 0 && i / window % shape[1] < cost { value * 0.125 } else { value }
    };
    (0..shape.iter().product()).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bit patterns that two other implementations of the rule (Python, Rust) agree on.
    #[test]
    fn values_are_those_of_the_rule() {
        for (name, shape, i, bits) in [
            ("depth_predictor.backbone.conv1.weight", &[64, 3, 7, 7][..], 0, 0x3c39_506e_u32),
            ("depth_predictor.backbone.conv1.weight", &[64, 3, 7, 7], 9407, 0x3dbe_e971),
            ("depth_predictor.transformer.layers.3.cross_attn_ffn.norm2.weight", &[128], 5, 0x3e98_3f6a),
            ("depth_predictor.pretrained.blocks.0.ls1.gamma", &[384], 383, 0x3e9f_6bb4),
            ("depth_predictor.pretrained.pos_embed", &[1, 1370, 384], 526_079, 0xbe63_71c0),
            ("depth_predictor.regressor.0.0.weight", &[128, 768, 3, 3], 1152, 0x3b96_b046),
            ("depth_predictor.upsampler.resize_layers.0.weight", &[48, 48, 4, 4], 77, 0x3d90_93b8),
            ("depth_predictor.depth_head.0.2.bias", &[128], 7, 0x3d92_197f),
        ] {
            assert_eq!(values("", name, shape)[i].to_bits(), bits, "{name} {i}");
        }
        // The last channel of the cost volume, an eighth of what the draw says.
        let regressor = values("", "depth_predictor.regressor.0.0.weight", &[128, 768, 3, 3]);
        assert_eq!(regressor[1151].to_bits(), 0xba24_ff20);
        assert_ne!(values("a", "x.weight", &[3])[0], values("b", "x.weight", &[3])[0]);
    }
}

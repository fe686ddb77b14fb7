//! Reproducible numbers by name and place.

/// Hash of a text in two parts (Fowler, Noll, Vo; 64 bits, variant 1a).
fn fnv(parts: [&str; 2]) -> u64 {
    parts
        .iter()
        .flat_map(|part| part.bytes())
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// `n` numbers in [-1, 1) of 24 bits each that depend on `salt` and `name` alone (splitmix64).
pub(crate) fn uniform(salt: &str, name: &str, n: usize) -> impl Iterator<Item = f64> {
    let hash = fnv([salt, name]);
    (0..n as u64).map(move |i| {
        let mut z = hash.wrapping_add(i).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 40) as f64 / 8_388_608.0 - 1.0
    })
}

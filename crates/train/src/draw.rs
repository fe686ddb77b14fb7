//! Random numbers as hashes of seed and place: nothing to be saved, and no draw depends on another.

/// What is drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Stream {
    Case = 1,
    Density = 2,
    Sampling = 3,
    Target = 4,
    Context = 5,
    Disturbance = 6,
    Colours = 7,
    Crop = 8,
    Mirror = 9,
    Source = 10,
    Window = 11,
    Refined = 12,
}

/// SplitMix64 (Steele, Lea & Flood 2014).
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// 64 random bits.
pub(crate) fn bits(seed: u64, stream: Stream, index: usize) -> u64 {
    mix(mix(mix(seed) ^ stream as u64) ^ index as u64)
}

/// A number in 0..1.
pub(crate) fn unit(seed: u64, stream: Stream, index: usize) -> f64 {
    (bits(seed, stream, index) >> 11) as f64 / (1u64 << 53) as f64
}

/// Up to `count` different numbers below `n`.
pub(crate) fn some(seed: u64, stream: Stream, index: usize, n: usize, count: usize) -> Vec<usize> {
    let mut all: Vec<usize> = (0..n).collect();
    let count = count.min(n);
    for i in 0..count {
        let other = i + (bits(seed, stream, index * 64 + i) % (n - i) as u64) as usize;
        all.swap(i, other);
    }
    all.truncate(count);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_even_and_different() {
        let mean = (0..4000).map(|i| unit(3, Stream::Density, i)).sum::<f64>() / 4000.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        let mut seen = [0; 5];
        for i in 0..1000 {
            let chosen = some(7, Stream::Target, i, 5, 2);
            assert!(chosen.len() == 2 && chosen[0] != chosen[1]);
            chosen.iter().for_each(|&c| seen[c] += 1);
        }
        assert!(seen.iter().all(|&n| (320..480).contains(&n)), "{seen:?}");
        assert_eq!(some(7, Stream::Target, 0, 1, 2), [0]);
        assert!(some(7, Stream::Target, 0, 0, 2).is_empty());
    }
}

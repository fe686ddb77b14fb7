//! Near-to-far order by a stable radix sort: equal depths keep the order of the scene.

use super::project::Splat;

/// Bits per pass; three passes cover the 32 bits of a depth.
const BITS: u32 = 11;
const BUCKETS: usize = 1 << BITS;

/// Indices of `splats`, near to far. Depths are positive, so their bits order as the numbers do.
pub(super) fn near_to_far(splats: &[Splat]) -> Vec<u32> {
    let mut pairs: Vec<(u32, u32)> =
        splats.iter().zip(0..).map(|(splat, index)| (splat.depth.to_bits(), index)).collect();
    sort_pairs(&mut pairs);
    pairs.into_iter().map(|(_, index)| index).collect()
}

/// Stable sort by the first number of each pair.
fn sort_pairs(pairs: &mut Vec<(u32, u32)>) {
    let digit = |key: u32, pass: u32| (key >> (pass * BITS)) as usize % BUCKETS;
    let mut counts = vec![[0u32; BUCKETS]; 3];
    for &(key, _) in pairs.iter() {
        for (pass, count) in (0..).zip(&mut counts) {
            count[digit(key, pass)] += 1;
        }
    }
    let mut other = vec![(0, 0); pairs.len()];
    for (pass, count) in (0..).zip(&mut counts) {
        let mut offset = 0;
        for slot in count.iter_mut() {
            (*slot, offset) = (offset, offset + *slot);
        }
        for &pair in pairs.iter() {
            let slot = &mut count[digit(pair.0, pass)];
            other[*slot as usize] = pair;
            *slot += 1;
        }
        std::mem::swap(pairs, &mut other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_the_stable_sort_of_the_standard_library(
            keys in prop::collection::vec(prop_oneof![any::<u32>(), 0u32..4, Just(u32::MAX)], 0..600),
        ) {
            let mut pairs: Vec<(u32, u32)> = keys.into_iter().zip(0..).collect();
            let mut expected = pairs.clone();
            expected.sort_by_key(|&(key, _)| key);
            sort_pairs(&mut pairs);
            prop_assert_eq!(pairs, expected);
        }
    }

    #[test]
    fn sizes_around_powers_of_two_are_sorted() {
        for n in [0u32, 1, 255, 256, 257, 2047, 2048, 2049, 65537] {
            // A multiplier coprime to n shuffles 0..n without repetition.
            let mut pairs: Vec<_> =
                (0..n).map(|i| ((u64::from(i) * 7_368_787 % u64::from(n)) as u32, i)).collect();
            sort_pairs(&mut pairs);
            assert!(pairs.iter().map(|pair| pair.0).eq(0..n), "{n}");
        }
    }
}

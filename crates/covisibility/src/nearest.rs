//! The k nearest of the candidates of one anchor.

/// Candidates up to this number are sorted at once: sorting so few is not slower than choosing among them first.
const SORTED_AT_ONCE: usize = 32;

/// A candidate as one number that orders as distance and index do.
pub(crate) fn key(sq_distance: f32, index: u32) -> u64 {
    (u64::from(sq_distance.to_bits()) << 32) | u64::from(index)
}

/// The index that a key was made of.
pub(crate) fn index(key: u64) -> u32 {
    key as u32
}

/// The squared distance that a key was made of.
pub(crate) fn sq_distance(key: u64) -> f32 {
    f32::from_bits((key >> 32) as u32)
}

/// The candidates of one anchor, in memory that is used again.
#[derive(Default)]
pub(crate) struct Candidates {
    /// The first `found` are candidates.
    keys: Vec<u64>,
    found: usize,
}

impl Candidates {
    pub(crate) fn clear(&mut self) {
        self.found = 0;
    }

    pub(crate) fn found(&self) -> usize {
        self.found
    }

    /// Adds the keys of those entries for which it is true. Without branches: which entries are candidates is not predictable.
    #[inline(always)]
    pub(crate) fn extend<E>(&mut self, entries: &[E], key: impl Fn(&E) -> (u64, bool)) {
        let needed = self.found + entries.len();
        if self.keys.len() < needed {
            self.keys.resize(needed.next_power_of_two(), 0);
        }
        let free = &mut self.keys[self.found..needed];
        let mut taken = 0;
        for entry in entries {
            let (key, is_candidate) = key(entry);
            free[taken] = key;
            taken += usize::from(is_candidate);
        }
        self.found += taken;
    }

    /// The nearest k in order.
    pub(crate) fn nearest(&mut self, k: usize) -> &[u64] {
        let found = &mut self.keys[..self.found];
        if self.found > k.max(SORTED_AT_ONCE) {
            found.select_nth_unstable(k);
            self.found = k;
        }
        let found = &mut self.keys[..self.found];
        found.sort_unstable();
        &found[..k.min(found.len())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_order_by_distance_then_index() {
        let distances = [0.0, 1e-45, f32::MIN_POSITIVE, 1.0, 1.0 + f32::EPSILON, f32::MAX, f32::INFINITY];
        let keys: Vec<u64> = distances.iter().flat_map(|&d| [0, 1, u32::MAX].map(|i| key(d, i))).collect();
        assert!(keys.is_sorted_by(|a, b| a < b));
        assert_eq!((index(keys[5]), sq_distance(keys[5])), (u32::MAX, 1e-45));
    }

    #[test]
    fn the_nearest_are_the_first_of_all_sorted() {
        let mut candidates = Candidates::default();
        for n in [0, 1, 31, 32, 33, 100] {
            for k in [1, 20, 32, 33, 200, usize::MAX] {
                candidates.clear();
                let numbers: Vec<u64> = (0..n).map(|i| i * 37 % 101).collect();
                // In two parts, every other one.
                candidates.extend(&numbers[..n as usize / 3], |&number| (number, number % 2 == 0));
                candidates.extend(&numbers[n as usize / 3..], |&number| (number, number % 2 == 0));
                let mut expected: Vec<u64> = numbers.into_iter().filter(|number| number % 2 == 0).collect();
                expected.sort_unstable();
                assert_eq!(candidates.found(), expected.len());
                expected.truncate(k);
                assert_eq!(candidates.nearest(k), expected);
            }
        }
    }
}

//! The maxima of a block of anchors, and which pair has each.

use crate::WIDTH;

/// What the gradient needs of a block's forward pass. Kinds without a maximum leave it empty.
#[derive(Debug, Clone, Default)]
pub(in crate::fused) struct Maxima {
    /// `[rows, 128]`.
    pub(in crate::fused) values: Vec<f32>,
    /// Of each anchor the channels in order of the pairs that have them: a byte for each, as there are 128.
    channels: Vec<[u8; WIDTH]>,
    /// Where the channels of each pair end, `[rows, k + 1]`.
    ends: Vec<u8>,
}

impl Maxima {
    pub(super) fn clear(&mut self) {
        self.values.clear();
        self.channels.clear();
        self.ends.clear();
    }

    /// The next anchor, of whose `pairs` pairs `picks` has one for each channel.
    pub(super) fn push(&mut self, pairs: usize, picks: &[u32; WIDTH]) {
        let before = self.ends.len();
        self.ends.resize(before + pairs, 0);
        let ends = &mut self.ends[before..];
        for &pick in picks {
            ends[pick as usize] += 1;
        }
        // Counts to beginnings, which move on to the ends as channels are placed.
        let mut begin = 0;
        for end in &mut *ends {
            begin += std::mem::replace(end, begin);
        }
        let mut channels = [0; WIDTH];
        for (channel, &pick) in (0..).zip(picks) {
            let end = &mut ends[pick as usize];
            channels[usize::from(*end)] = channel;
            *end += 1;
        }
        self.channels.push(channels);
    }

    /// The channels of each pair of an anchor.
    #[inline(always)]
    pub(super) fn of(&self, row: usize, pairs: usize) -> impl Iterator<Item = &[u8]> {
        let mut begin = 0;
        self.ends[row * pairs..][..pairs].iter().map(move |&end| {
            let channels = &self.channels[row][begin..usize::from(end)];
            begin = usize::from(end);
            channels
        })
    }

    /// The channels of one pair.
    #[inline(always)]
    pub(super) fn of_pair(&self, row: usize, pairs: usize, pair: usize) -> &[u8] {
        let ends = &self.ends[row * pairs..][..pairs];
        let begin = if pair == 0 { 0 } else { ends[pair - 1] };
        &self.channels[row][usize::from(begin)..usize::from(ends[pair])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_found_by_their_pair() {
        let mut maxima = Maxima::default();
        let all_last = [4; WIDTH];
        let in_turn = std::array::from_fn(|c| [3, 0, 3, 1][c % 4]);
        for picks in [&all_last, &in_turn] {
            maxima.push(5, picks);
        }
        for (row, picks) in [all_last, in_turn].iter().enumerate() {
            for (pair, found) in maxima.of(row, 5).enumerate() {
                let expected: Vec<u8> = (0..128).filter(|&c| picks[usize::from(c)] == pair as u32).collect();
                assert_eq!(found, expected);
                assert_eq!(maxima.of_pair(row, 5, pair), expected);
            }
        }
    }
}

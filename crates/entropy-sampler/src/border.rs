/// What a window sees beyond the edge of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Border {
    /// The picture mirrored at its edge pixels, which are not repeated: `d c b | a b c d | c b a`, back and forth
    /// where the window is larger than the picture (numpy's `reflect`). Every window has the same number of pixels.
    #[default]
    Reflect,
    /// Nothing: the window is cut, down to a quarter in a corner.
    Clip,
}

impl Border {
    /// The position inside `0..n` that is seen at `i`.
    pub(crate) fn source(self, i: isize, n: usize) -> Option<usize> {
        let inside = (0..n as isize).contains(&i);
        match self {
            Self::Clip => inside.then_some(i as usize),
            Self::Reflect if n == 1 => Some(0),
            Self::Reflect => {
                let last = n as isize - 1;
                let phase = i.rem_euclid(2 * last);
                Some(phase.min(2 * last - phase) as usize)
            }
        }
    }

    /// What windows of `size` around `0..n` see, from `size / 2` before the first to as far after the last.
    pub(crate) fn sources(self, n: usize, size: usize) -> Vec<Option<usize>> {
        let radius = (size / 2) as isize;
        (-radius..n as isize + radius).map(|i| self.source(i, n)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflect_wraps_back_and_forth() {
        let seen: Vec<usize> = (-5..8).filter_map(|i| Border::Reflect.source(i, 3)).collect();
        assert_eq!(seen, [1, 0, 1, 2, 1, 0, 1, 2, 1, 0, 1, 2, 1]);
        assert_eq!(Border::Reflect.source(-7, 1), Some(0));
    }

    #[test]
    fn clip_sees_nothing_outside() {
        let seen: Vec<_> = (-1..4).map(|i| Border::Clip.source(i, 3)).collect();
        assert_eq!(seen, [None, Some(0), Some(1), Some(2), None]);
    }
}

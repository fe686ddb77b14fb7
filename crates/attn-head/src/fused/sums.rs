//! The place of a tensor among the weights, and sums of gradients over a range of anchors.

use crate::Layout;
use std::ops::Range;

/// A tensor's place among the weights.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    start: usize,
    len: usize,
}

impl Place {
    /// Places of `name.weight` and `name.bias`.
    pub(super) fn pair(layout: &Layout, name: &str) -> (Self, Self) {
        let find = |suffix: &str| {
            let parameter = layout.parameters.iter().find(|p| p.name.strip_prefix(name) == Some(suffix));
            let parameter = parameter.unwrap_or_else(|| panic!("the layout has {name}{suffix}"));
            Self { start: parameter.offset, len: parameter.len() }
        };
        (find(".weight"), find(".bias"))
    }

    /// The tensor's numbers among all.
    pub(super) fn of(self, values: &[f32]) -> &[f32] {
        &values[self.start..][..self.len]
    }
}

/// The range of weights whose names begin with `prefix`, which lie together.
pub(super) fn span(layout: &Layout, prefix: &str) -> Range<usize> {
    let mut named = layout.parameters.iter().filter(|p| p.name.starts_with(prefix));
    let first = named.next().unwrap_or_else(|| panic!("the layout has {prefix}"));
    let end = named.next_back().unwrap_or(first);
    first.offset..end.offset + end.len()
}

/// Gradients of a range of weights, summed over some anchors.
#[derive(Debug)]
pub(super) struct Sums<'a> {
    /// Where the range begins among all weights.
    base: usize,
    values: &'a mut [f32],
}

impl<'a> Sums<'a> {
    pub(super) fn new(base: usize, values: &'a mut [f32]) -> Self {
        Self { base, values }
    }

    /// One tensor's gradient.
    pub(super) fn at(&mut self, place: Place) -> &mut [f32] {
        &mut self.values[place.start - self.base..][..place.len]
    }

    pub(super) fn add(&mut self, place: Place, values: &[f32]) {
        self.at(place).iter_mut().zip(values).for_each(|(sum, v)| *sum += v);
    }
}

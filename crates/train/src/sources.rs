//! Where passes draw what they train on: sources by their shares, their scenes alike.

use crate::draw::{Stream, bits, unit};
use std::ops::Range;

/// Numbered items of one or more sources.
#[derive(Debug, Clone)]
pub(crate) struct Sources(Vec<Source>);

/// Items that a share of the passes draws from.
#[derive(Debug, Clone)]
struct Source {
    /// Above 0.
    share: f64,
    /// The items of each scene. A scene is drawn, then one of its items: what was photographed often does not count for more.
    scenes: Vec<Range<usize>>,
}

impl Sources {
    /// One source with the items of each scene.
    pub(crate) fn one(scenes: Vec<Range<usize>>) -> Self {
        Self(vec![Source { share: 1.0, scenes }])
    }

    /// These, of which there are `before`, and `others` behind them, of which passes draw a `share`.
    ///
    /// # Panics
    /// If the share is not above 0 and below 1.
    pub(crate) fn mix(&mut self, before: usize, others: Self, share: f64) {
        assert!(share > 0.0 && share < 1.0, "a share of two");
        self.0.iter_mut().for_each(|source| source.share *= 1.0 - share);
        for Source { share: weight, scenes } in others.0 {
            let scenes = scenes.into_iter().map(|items| items.start + before..items.end + before);
            self.0.push(Source { share: weight * share, scenes: scenes.collect() });
        }
    }

    /// The item of the `pass`-th pass of a run.
    pub(crate) fn drawn(&self, seed: u64, pass: usize) -> usize {
        let mut left = unit(seed, Stream::Source, pass);
        let beyond = |source: &&Source| {
            left -= source.share;
            left < 0.0
        };
        let source = self.0.iter().find(beyond).or(self.0.last()).expect("one at least");
        let below = |stream, n: usize| (bits(seed, stream, pass) % n as u64) as usize;
        let items = &source.scenes[below(Stream::Case, source.scenes.len())];
        items.start + below(Stream::Window, items.len())
    }
}

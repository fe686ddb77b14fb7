//! What can be seen of a pass: maps between the stages, and the time of each.

use candle_core::{Result, Tensor};
use std::time::Instant;

/// Layout of a tensor that is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// `[n, h, w, c]`; recorded as `[n, c, h, w]`.
    Map,
    /// As it is.
    Plain,
}

/// Seconds and floating-point operations of a stage.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTime {
    /// What the stage does.
    pub stage: &'static str,
    /// Wall time.
    pub seconds: f64,
    /// Operations of its convolutions and matrix products, two per multiplication with addition, counted by their
    /// definition: fast algorithms need fewer.
    pub operations: u64,
}

/// Records maps, if wanted, and times.
#[derive(Default)]
pub(super) struct Taps {
    maps: Option<Vec<(String, Tensor)>>,
    times: Vec<StageTime>,
}

impl Taps {
    /// Records maps as well.
    pub(super) fn with_maps() -> Self {
        Self { maps: Some(Vec::new()), times: Vec::new() }
    }

    /// Whether maps are wanted.
    pub(super) fn wanted(&self) -> bool {
        self.maps.is_some()
    }

    /// Notes a map; what is noted several times under one name is joined along the first axis.
    pub(super) fn note(&mut self, name: impl Into<String>, layout: Layout, tensor: &Tensor) -> Result<()> {
        if let Some(maps) = &mut self.maps {
            let tensor = match layout {
                Layout::Map => tensor.permute((0, 3, 1, 2))?.contiguous()?,
                Layout::Plain => tensor.clone(),
            };
            maps.push((name.into(), tensor));
        }
        Ok(())
    }

    pub(super) fn map(&mut self, name: impl Into<String>, tensor: &Tensor) -> Result<()> {
        self.note(name, Layout::Map, tensor)
    }

    pub(super) fn plain(&mut self, name: impl Into<String>, tensor: &Tensor) -> Result<()> {
        self.note(name, Layout::Plain, tensor)
    }

    /// Adds the time since `start` to a stage.
    pub(super) fn time(&mut self, stage: &'static str, start: Instant, operations: u64) {
        let seconds = start.elapsed().as_secs_f64();
        match self.times.iter_mut().find(|time| time.stage == stage) {
            Some(time) => {
                time.seconds += seconds;
                time.operations += operations;
            }
            None => self.times.push(StageTime { stage, seconds, operations }),
        }
    }

    /// Times in the order of the stages.
    pub(super) fn times(&self) -> &[StageTime] {
        &self.times
    }

    /// The maps, each name once.
    pub(super) fn into_maps(self) -> Result<Vec<(String, Tensor)>> {
        let mut joined: Vec<(String, Vec<Tensor>)> = Vec::new();
        for (name, tensor) in self.maps.unwrap_or_default() {
            match joined.iter_mut().find(|(other, _)| *other == name) {
                Some((_, parts)) => parts.push(tensor),
                None => joined.push((name, vec![tensor])),
            }
        }
        joined.into_iter().map(|(name, parts)| Ok((name, Tensor::cat(&parts, 0)?))).collect()
    }
}

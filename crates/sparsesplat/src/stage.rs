//! The stages of the pass, as data: their names, their times, and who is told of them.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::ops::{Index, IndexMut};
use std::time::Instant;

/// A stage of the pass. Its name is the key of its time in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Depth and features.
    Backbone,
    /// Exposure of the views to each other.
    Exposure,
    /// The far shell.
    Shell,
    /// Probability maps and chosen pixels.
    Sampling,
    /// Pixels to anchors, by voxels where that is the allocation.
    Backproject,
    /// Neighbours of anchors.
    Knn,
    /// Rendering the closed form into the views, where the head is told of it.
    Feedback,
    /// Attributes of anchors: of the closed form, then of a learned head.
    Head,
    /// Attributes to one set of Gaussians, merged where that is the allocation.
    Decode,
    /// Further looks at the views: gradient steps.
    Looks,
    /// Correction of the scene by a second head.
    Correction,
}

impl Stage {
    /// All of them, in the order in which they end.
    pub const ALL: [Self; 11] = [
        Self::Backbone,
        Self::Exposure,
        Self::Shell,
        Self::Sampling,
        Self::Backproject,
        Self::Knn,
        Self::Feedback,
        Self::Head,
        Self::Decode,
        Self::Looks,
        Self::Correction,
    ];

    /// As in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Backbone => "backbone",
            Self::Exposure => "exposure",
            Self::Shell => "shell",
            Self::Sampling => "sampling",
            Self::Backproject => "backproject",
            Self::Knn => "knn",
            Self::Feedback => "feedback",
            Self::Head => "head",
            Self::Decode => "decode",
            Self::Looks => "looks",
            Self::Correction => "correction",
        }
    }
}

/// Wall time of each stage, seconds; 0 of a stage that did not run. In JSON one key per stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageSeconds([f64; Stage::ALL.len()]);

impl Index<Stage> for StageSeconds {
    type Output = f64;

    fn index(&self, stage: Stage) -> &f64 {
        &self.0[stage as usize]
    }
}

impl IndexMut<Stage> for StageSeconds {
    fn index_mut(&mut self, stage: Stage) -> &mut f64 {
        &mut self.0[stage as usize]
    }
}

impl StageSeconds {
    /// The time of each stage, computed one by one.
    pub fn of_each(seconds: impl FnMut(Stage) -> f64) -> Self {
        Self(Stage::ALL.map(seconds))
    }
}

impl Serialize for StageSeconds {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(Stage::ALL.map(|stage| (stage, self[stage])))
    }
}

impl<'de> Deserialize<'de> for StageSeconds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let read = BTreeMap::<Stage, f64>::deserialize(deserializer)?;
        if let Some(stage) = Stage::ALL.into_iter().find(|stage| !read.contains_key(stage)) {
            return Err(D::Error::missing_field(stage.name()));
        }
        Ok(Self::of_each(|stage| read[&stage]))
    }
}

/// Runs stages: tells an observer when each begins, and takes its wall time.
pub struct Stages<'a> {
    on_stage: &'a mut dyn FnMut(Stage),
    seconds: StageSeconds,
}

impl<'a> Stages<'a> {
    /// `on_stage` is called as a stage begins. A stage that is done in two parts begins twice.
    pub fn new(on_stage: &'a mut dyn FnMut(Stage)) -> Self {
        Self { on_stage, seconds: StageSeconds::default() }
    }

    /// Does the work as a part of this stage.
    pub fn run<T>(&mut self, stage: Stage, work: impl FnOnce() -> T) -> T {
        (self.on_stage)(stage);
        let begin = Instant::now();
        let result = work();
        self.seconds[stage] += begin.elapsed().as_secs_f64();
        result
    }

    /// The times so far.
    #[must_use]
    pub fn seconds(&self) -> StageSeconds {
        self.seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_parts_add_up_and_every_stage_has_its_own_key() {
        let mut told = Vec::new();
        let mut on_stage = |stage| told.push(stage);
        let mut stages = Stages::new(&mut on_stage);
        let pause = || std::thread::sleep(std::time::Duration::from_millis(2));
        stages.run(Stage::Head, pause);
        stages.run(Stage::Feedback, pause);
        stages.run(Stage::Head, pause);
        let seconds = stages.seconds();
        assert!(seconds[Stage::Head] >= 0.004 && seconds[Stage::Feedback] >= 0.002);
        assert_eq!(seconds[Stage::Knn], 0.0);
        assert_eq!(told, [Stage::Head, Stage::Feedback, Stage::Head]);

        let json = serde_json::to_value(seconds).unwrap();
        let keys = json.as_object().unwrap().keys();
        assert_eq!(keys.len(), Stage::ALL.len());
        for stage in Stage::ALL {
            assert_eq!(json[stage.name()], seconds[stage]);
        }
        assert_eq!(serde_json::from_value::<StageSeconds>(json).unwrap(), seconds);
        let missing = serde_json::from_str::<StageSeconds>(r#"{"backbone": 1.0}"#).unwrap_err();
        assert!(missing.to_string().contains("exposure"), "{missing}");
    }
}

use crate::StageSeconds;
use crate::learned::Corrector;
use depth_backbone::ViewGeometry;
use gs_scene::{Gaussians, View};
use serde::Serialize;

/// What one pass over a set of views gives.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// The scene, world frame; the far shell comes last.
    pub gaussians: Gaussians,
    /// What made the Gaussians' attributes: `closed-form`, or the weights.
    pub head: String,
    /// Where the Gaussians come from.
    pub counts: Counts,
    /// The paper's tau that the budget was solved to; `None` where no pixels are drawn.
    pub tau: Option<f64>,
    /// Depth and confidence per view, without features.
    pub geometry: Vec<ViewGeometry>,
    /// Gain and bias that brought each view into the common exposure.
    pub exposure: Vec<ExposureGain>,
    /// What corrected the scene, as reports call it.
    pub corrected_by: Option<String>,
    /// What corrects the scene after the refinement, where [`Config::refined_later`](crate::Config::refined_later) leaves that to it.
    pub corrector: Option<Corrector>,
    /// Near and far plane that were used, scene units; for the renderer's near plane and for depth pictures.
    pub depth_range: (f64, f64),
    /// Wall time per stage.
    pub seconds: StageSeconds,
}

/// Gaussians by origin.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// All of them.
    pub total: usize,
    /// Of each view: sampled from it; of merged ones and voxels, those that have most from it.
    pub per_view: Vec<usize>,
    /// The far shell's.
    pub shell: usize,
}

/// common exposure = gain · photograph + bias, the same for the three channels; 1 and 0 where the views agree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ExposureGain {
    /// Factor.
    pub gain: f32,
    /// Offset, display-referred, 0..1.
    pub bias: f32,
}

impl ExposureGain {
    /// No change.
    pub const NONE: Self = Self { gain: 1.0, bias: 0.0 };

    /// Brings a view's picture into the common exposure.
    pub fn apply(self, view: &mut View) {
        if self != Self::NONE {
            for value in view.image_mut().data_mut() {
                *value = self.gain * *value + self.bias;
            }
        }
    }
}

impl Counts {
    /// The counts when Gaussians at these places, ascending, are dropped.
    #[must_use]
    pub fn without(&self, dropped: &[u32]) -> Self {
        let mut end = 0;
        let mut left = |count: usize| {
            let begin = dropped.partition_point(|&i| (i as usize) < end);
            end += count;
            count - (dropped.partition_point(|&i| (i as usize) < end) - begin)
        };
        let per_view: Vec<usize> = self.per_view.iter().map(|&count| left(count)).collect();
        let shell = left(self.shell);
        Self { total: per_view.iter().sum::<usize>() + shell, per_view, shell }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_gaussians_are_taken_off_where_they_come_from() {
        let counts = Counts { total: 10, per_view: vec![3, 0, 4], shell: 3 };
        assert_eq!(counts.without(&[]), counts);
        let left = counts.without(&[0, 2, 3, 9]);
        assert_eq!(left, Counts { total: 6, per_view: vec![1, 0, 3], shell: 2 });
        let all: Vec<u32> = (0..10).collect();
        assert_eq!(counts.without(&all), Counts { total: 0, per_view: vec![0, 0, 0], shell: 0 });
    }
}

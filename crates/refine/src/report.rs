use crate::{Exposure, PoseChange};
use gs_raster::Rasterizer;
use gs_scene::Gaussians;
use serde::Serialize;

/// What happened during a refinement.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Report {
    /// Every step.
    pub steps: Vec<StepRecord>,
    /// Mean PSNR over the context views before the first step, dB; NaN without [`Config::measure_start`](crate::Config::measure_start) and
    /// [`Config::exposure`](crate::Config::exposure), which render them then.
    pub psnr_start: f64,
    /// Steps with a loss or a derivative that was not finite: they changed nothing.
    pub undone: usize,
    /// First step that may compare views between the photographs as well ([`Config::between`](crate::Config::between)), counted from 1; none in
    /// a short refinement.
    pub between_from: Option<usize>,
    /// Why it ended.
    pub stopped: Option<Stopped>,
    /// Gain and bias of each view; empty if they were not fitted.
    pub exposure: Vec<Exposure>,
    /// How the camera of each view was changed; empty if cameras stayed.
    pub poses: Vec<PoseChange>,
    /// Positions in the input of the Gaussians that were dropped, ascending.
    #[serde(serialize_with = "as_count")]
    pub pruned: Vec<u32>,
    /// Wall time, seconds; without what `on_step` took.
    pub seconds: f64,
}

fn as_count<S: serde::Serializer>(pruned: &[u32], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u64(pruned.len() as u64)
}

/// One step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepRecord {
    /// Counted from 1.
    pub step: usize,
    /// Wall time from the beginning to the end of this step, seconds.
    pub seconds: f64,
    /// Mean loss of the views of this step, before it; none if the step was undone.
    pub loss: Option<f64>,
    /// Whether views were compared at half their size, where a PSNR is higher.
    pub half_size: bool,
    /// Mean over the context views of the newest PSNR of each at that size, dB; exact matches count as 100.
    pub psnr_context: f64,
}

/// Why a refinement ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stopped {
    /// All steps are done, or the time is over.
    Done,
    /// Further steps gained nothing.
    NothingGained,
}

/// What a caller sees after each step.
#[derive(Debug)]
pub struct Step<'a> {
    /// Its figures.
    pub record: &'a StepRecord,
    /// How much of the way was behind when the step began, 0 to 1.
    pub progress: f64,
    /// The scene as it now is, not yet pruned.
    pub gaussians: &'a Gaussians,
    /// The rasterizer, to look at the scene with.
    pub rasterizer: &'a mut Rasterizer,
}

use crate::{Config, Prediction, Result, Stage};
use gs_scene::View;

/// One pass: views to Gaussians. `on_stage` is called as each stage begins (for progress bars).
///
/// # Errors
/// If the views do not suffice or a setting is out of range (see [`crate::Error`]).
pub fn predict(views: &[View], config: &Config, on_stage: &mut dyn FnMut(Stage)) -> Result<Prediction> {
    let _ = (views, config, on_stage);
    Err(crate::Error::EmptyBudget)
}

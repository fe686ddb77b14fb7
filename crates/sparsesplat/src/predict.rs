use crate::anchored::{Anchored, anchor, timed};
use crate::as_photographed::exposed_as;
use crate::learned::LearnedHead;
use crate::merge::merge;
use crate::prediction::{Prediction, Stage, StageSeconds};
use crate::{Allocation, Budget, Config, Error, Head, Result, backbone, own_head};
use depth_backbone::{ViewGeometry, Wanted};
use gs_scene::View;

/// One pass: views to Gaussians. `on_stage` is called as each stage begins (for progress bars).
///
/// # Errors
/// If the views do not suffice or a setting is out of range (see [`crate::Error`]).
pub fn predict(views: &[View], config: &Config, on_stage: &mut dyn FnMut(Stage)) -> Result<Prediction> {
    if config.budget == Budget::Gaussians(0) {
        return Err(Error::EmptyBudget);
    }
    let (mut reading, mut asking) = (0.0, 0.0);
    let head = timed(&mut reading, || LearnedHead::chosen(config))?;
    on_stage(Stage::Backbone);
    let (mut geometry, depth_range) =
        timed(&mut asking, || backbone::geometry(views, config, wanted_by(config, head.as_ref())))?;
    let mut prediction = finish(views, &geometry, depth_range, config, head.as_ref(), on_stage)?;
    prediction.seconds.backbone = asking;
    prediction.seconds.head += reading;
    // They are large, and nobody needs them any more.
    geometry.iter_mut().for_each(|view| (view.features, view.gaussians) = (None, None));
    prediction.geometry = geometry;
    Ok(prediction)
}

/// The pass from a known [`geometry`](crate::geometry) on, for configurations that differ in what comes after the backbone; its stage took 0 s.
/// `geometry` must hold what [`wanted`] says, `depth_range` is what it came with.
///
/// # Errors
/// As [`predict`].
pub fn predict_from(
    views: &[View],
    geometry: &[ViewGeometry],
    depth_range: (f64, f64),
    config: &Config,
    on_stage: &mut dyn FnMut(Stage),
) -> Result<Prediction> {
    let mut reading = 0.0;
    let head = timed(&mut reading, || LearnedHead::chosen(config))?;
    let mut prediction = finish(views, geometry, depth_range, config, head.as_ref(), on_stage)?;
    prediction.seconds.head += reading;
    let plain = |view: &ViewGeometry| ViewGeometry {
        depth: view.depth.clone(),
        confidence: view.confidence.clone(),
        features: None,
        gaussians: None,
    };
    prediction.geometry = geometry.iter().map(plain).collect();
    Ok(prediction)
}

/// What the configured head needs of a backbone.
///
/// # Errors
/// If weights are asked for that cannot be read.
pub fn wanted(config: &Config) -> Result<Wanted> {
    Ok(wanted_by(config, LearnedHead::chosen(config)?.as_ref()))
}

fn wanted_by(config: &Config, head: Option<&LearnedHead>) -> Wanted {
    match (&config.head, head) {
        (Head::DepthSplat, _) => Wanted::DepthAndGaussians,
        (_, Some(_)) => Wanted::DepthAndFeatures,
        (_, None) => Wanted::Depth,
    }
}

/// All stages after the backbone; the prediction's geometry is left empty.
fn finish(
    views: &[View],
    geometry: &[ViewGeometry],
    depth_range: (f64, f64),
    config: &Config,
    head: Option<&LearnedHead>,
    on_stage: &mut dyn FnMut(Stage),
) -> Result<Prediction> {
    if config.head == Head::DepthSplat {
        return own_head::finish(views, geometry, depth_range, config, on_stage);
    }
    let mut seconds = StageSeconds::default();
    let anchored = anchor(views, geometry, depth_range.1, config, &mut seconds, on_stage)?;
    let made = head.map(|head| head.gaussians(&anchored, geometry, &mut seconds)).transpose()?;
    on_stage(Stage::Decode);
    let Anchored { base, shell, mut counts, tau, exposure, spacing, .. } = anchored;
    let gaussians = timed(&mut seconds.decode, || {
        let mut gaussians = made.unwrap_or(base);
        if let (Allocation::Merged, Budget::Gaussians(total)) = (config.allocation, config.budget) {
            let merged = merge(gaussians, &spacing, total - shell.len())?;
            counts = counts.without(&merged.absorbed);
            gaussians = merged.gaussians;
        }
        gaussians.append(&shell.with_sh_degree(gaussians.sh_degree())?);
        exposed_as(config.exposure, gaussians, views, &exposure)
    })?;
    let head = head.map_or_else(|| CLOSED_FORM.to_owned(), |head| head.name().to_owned());
    Ok(Prediction { gaussians, head, counts, tau, geometry: Vec::new(), exposure, depth_range, seconds })
}

/// The closed-form head, as reports call it.
const CLOSED_FORM: &str = "closed-form";

//! The engine openMVG-rs: the crate openmvg-sfm, linked in.

use crate::engine::{Engine, Pose, Solution, Step, Task};
use crate::{Error, Result};
use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Distortion, Intrinsics, Lens};
use openmvg_core::camera::{RadialDistortion, TangentialDistortion};
use openmvg_sfm::model::{ImageMeta, IntrinsicPrior};
use openmvg_sfm::progress::{SfmProgressSink, SfmProgressStage};
use openmvg_sfm::reports::ViewVerdictStatus;
use openmvg_sfm::{Camera, Dataset, Frontend, Incremental, IntrinsicId, SfmError};
use std::collections::HashMap;
use view_data::{Observation, ScenePoint};

/// openMVG-rs, incremental; a lens has a focal length and k1. The same photographs and seed give the same bytes.
#[derive(Debug, Clone, Copy, Default)]
pub struct OpenMvg;

/// openMVG-rs counts pixels from the centre of the first one, we from its corner.
const HALF_A_PIXEL: f64 = 0.5;

impl Engine for OpenMvg {
    fn name(&self) -> &'static str {
        "openmvg"
    }

    fn estimate(&self, task: &Task<'_>, on_step: &(dyn Fn(Step) + Sync)) -> Result<Solution> {
        let images = task.photographs.iter().map(|photograph| {
            let path = task.images.join(&photograph.name);
            ImageMeta::path(path, photograph.width as u32, photograph.height as u32)
        });
        let camera = |group: &crate::CameraGroup| {
            let centre = |side: usize| side as f64 / 2.0 - HALF_A_PIXEL;
            let focal = task.focal(group);
            // A k1 of 0 counts as unknown and is estimated.
            let (none, straight) = (RadialDistortion::K1(0.0), TangentialDistortion::None);
            Camera::try_brown_conrady(focal, focal, centre(group.width), centre(group.height), none, straight)
        };
        let cameras: Vec<Camera> =
            task.cameras.iter().map(camera).collect::<std::result::Result<_, _>>().map_err(SfmError::from)?;
        let prior = |known: bool| if known { IntrinsicPrior::Trusted } else { IntrinsicPrior::Guess };
        let dataset = Dataset::builder()
            .root_seed(Dataset::DEFAULT_SEED.wrapping_add(task.seed))
            .image_meta(images)
            .camera_models(cameras)
            .intrinsic_priors(task.cameras.iter().map(|group| prior(group.focal_pixels.is_some())))
            .view_intrinsics(task.photographs.iter().map(|photograph| IntrinsicId::new(photograph.camera)))
            .build()?;
        let progress = Progress(on_step);
        let nothing = |error: SfmError| match error {
            SfmError::InvalidInput(said) => {
                Error::NothingMatches { photographs: task.photographs.len(), engine: self.name(), said }
            }
            error @ SfmError::NoInitialPairCandidate => Error::NothingMatches {
                photographs: task.photographs.len(),
                engine: self.name(),
                said: error.to_string(),
            },
            error => Error::OpenMvg(error),
        };
        let (graph, _) = Frontend::default().build_with_report(&dataset, &progress).map_err(nothing)?;
        let runner = Incremental::default();
        let output = runner.runner().progress(&progress).run_prepared_owned(graph).map_err(nothing)?;
        let (reconstruction, report) = output.into_parts();

        // Parts that do not hang together have no common scale: the largest is kept.
        let mut sizes: HashMap<_, usize> = HashMap::new();
        for (_, record) in reconstruction.registered_views() {
            *sizes.entry(record.component).or_default() += 1;
        }
        let largest = sizes.iter().max_by_key(|(part, size)| (**size, std::cmp::Reverse(**part)));
        let largest = largest.map(|(part, _)| *part);
        let mut poses = vec![None; task.photographs.len()];
        let mut reasons: Vec<Option<String>> = vec![None; task.photographs.len()];
        for (view, record) in reconstruction.registered_views() {
            if Some(record.component) != largest {
                reasons[view.index()] =
                    Some("belongs to a part of the scene without connection to the largest".to_owned());
                continue;
            }
            let (matrix, t) = (record.pose.rotation_matrix(), record.pose.translation());
            let row = |i: usize| DVec3::new(matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]);
            // Rows of world-to-camera are the camera's axes.
            let axes = DMat3::from_cols(row(0), row(1), row(2));
            poses[view.index()] = Some(Pose { axes, position: -(axes * DVec3::new(t.x, t.y, t.z)) });
        }
        for verdict in report.view_verdicts() {
            if let ViewVerdictStatus::Unregistered { reason } = verdict.status() {
                reasons[verdict.view().index()] =
                    Some(format!("not registered ({reason})").replace('_', " "));
            }
        }
        let mut points: HashMap<_, ScenePoint> = HashMap::new();
        let mut order = Vec::new();
        for seen in reconstruction.observations() {
            let frame = seen.view.index();
            if poses[frame].is_none() {
                continue;
            }
            let point = points.entry(seen.landmark).or_insert_with(|| {
                order.push(seen.landmark);
                let found = reconstruction.landmarks().get(seen.landmark);
                let nan = f64::NAN;
                let (position, error) = found.map_or((DVec3::splat(nan), nan), |landmark| {
                    let p = landmark.point;
                    (DVec3::new(p.x, p.y, p.z), landmark.reprojection_error.value())
                });
                ScenePoint { position, colour: None, error: Some(error), observations: Vec::new() }
            });
            let pixel = DVec2::new(seen.pixel.x + HALF_A_PIXEL, seen.pixel.y + HALF_A_PIXEL);
            point.colour.get_or_insert_with(|| task.photographs[frame].colour(pixel));
            point.observations.push(Observation { frame, pixel });
        }
        let points = order.iter().filter_map(|landmark| points.remove(landmark)).collect();
        let models = task.cameras.iter().zip(reconstruction.camera_models());
        let lenses = models.map(|(group, camera)| lens(camera, group.width, group.height)).collect();
        Ok(Solution { lenses, poses, reasons, points })
    }
}

fn lens(camera: &Camera, width: usize, height: usize) -> Lens {
    let (fx, fy) = camera.focal_lengths().unwrap_or((f64::NAN, f64::NAN));
    let (cx, cy, k1) = match camera {
        Camera::BrownConrady(camera) => {
            (camera.principal_x(), camera.principal_y(), camera.radial_distortion().k1())
        }
        Camera::Pinhole(camera) => (camera.principal_x(), camera.principal_y(), 0.0),
        // Never given to the engine; a lens of NaN is left out as nonsense.
        _ => (f64::NAN, f64::NAN, 0.0),
    };
    let intrinsics = Intrinsics { fx, fy, cx: cx + HALF_A_PIXEL, cy: cy + HALF_A_PIXEL, width, height };
    Lens { intrinsics, model: Distortion { k1, ..Distortion::default() }.into() }
}

/// Tells what the engine does.
struct Progress<'a>(&'a (dyn Fn(Step) + Sync));

impl SfmProgressSink for Progress<'_> {
    fn begin(&self, stage: SfmProgressStage, _: usize) {
        (self.0)(match stage {
            SfmProgressStage::FeatureExtraction => Step::Features,
            SfmProgressStage::MatcherPreparation
            | SfmProgressStage::Matching
            | SfmProgressStage::Verification
            | SfmProgressStage::RadialCalibration
            | SfmProgressStage::TrackBuilding => Step::Match,
            _ => Step::Poses,
        });
    }
}

use crate::cells::cells;
use crate::closed_form::{self, Surface};
use crate::prediction::{Counts, Prediction, Stage, StageSeconds};
use crate::{Allocation, Backbone, Budget, Config, Error, Result, exposure, shell};
use backproject::{Anchors, Backprojected, ViewPixels};
use depth_backbone::{DepthBackbone, GivenDepth, PlaneSweep, ViewGeometry, Wanted};
use entropy_sampler::{EntropyWindow, ImportanceMap};
use glam::{DVec2, DVec3};
use gs_scene::{Gaussians, View};
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

/// Runs one stage and takes its wall time.
fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *seconds += start.elapsed().as_secs_f64();
    result
}

/// One pass: views to Gaussians. `on_stage` is called as each stage begins (for progress bars).
///
/// # Errors
/// If the views do not suffice or a setting is out of range (see [`crate::Error`]).
pub fn predict(views: &[View], config: &Config, on_stage: &mut dyn FnMut(Stage)) -> Result<Prediction> {
    if config.budget == Budget::Gaussians(0) {
        return Err(Error::EmptyBudget);
    }
    let mut seconds = StageSeconds::default();

    on_stage(Stage::Backbone);
    let (geometry, depth_range) = timed(&mut seconds.backbone, || geometry(views, config))?;

    on_stage(Stage::Exposure);
    let (exposed, exposure) = timed(&mut seconds.exposure, || {
        let exposure = exposure::equalise(views, &geometry);
        let mut exposed = views.to_vec();
        exposed.iter_mut().zip(&exposure).for_each(|(view, exposure)| exposure.apply(view));
        (exposed, exposure)
    });

    on_stage(Stage::Shell);
    let shell = timed(&mut seconds.shell, || match (config.far_shell, config.budget, config.allocation) {
        (false, _, _) => Gaussians::empty(0),
        (true, Budget::Gaussians(n), Allocation::Entropy | Allocation::Laplacian | Allocation::Random) => {
            shell::shell(&exposed, depth_range.1, n)
        }
        // Without a total to keep within, the shell has its finest cells.
        (true, _, _) => shell::shell(&exposed, depth_range.1, usize::MAX),
    })?;

    on_stage(Stage::Sampling);
    let (pixels, tau) = timed(&mut seconds.sampling, || sample(views, &geometry, config, shell.len()))?;

    on_stage(Stage::Backproject);
    let Backprojected { anchors, ranges, .. } = timed(&mut seconds.backproject, || {
        let of = |i: usize| ViewPixels {
            camera: views[i].camera(),
            depth: geometry[i].depth.data(),
            pixels: &pixels[i],
            image: None,
            features: None,
        };
        let chosen: Vec<ViewPixels> = (0..views.len()).map(of).collect();
        backproject::anchors(&chosen, &backproject::Settings::default())
    })?;

    on_stage(Stage::Knn);
    let areas = timed(&mut seconds.knn, || area_per_anchor(&anchors, config.neighbours))?;

    on_stage(Stage::Head);
    let per_view: Vec<Gaussians> = timed(&mut seconds.head, || {
        let of = |i: usize| head(&exposed[i], &geometry[i], &anchors, ranges[i].clone(), &areas);
        (0..views.len()).into_par_iter().map(of).collect::<Result<_>>()
    })?;

    on_stage(Stage::Decode);
    let mut gaussians = Gaussians::empty(0)?;
    timed(&mut seconds.decode, || {
        per_view.iter().for_each(|part| gaussians.append(part));
        gaussians.append(&shell);
    });
    let counts = Counts {
        total: gaussians.len(),
        per_view: per_view.iter().map(Gaussians::len).collect(),
        shell: shell.len(),
    };
    Ok(Prediction { gaussians, counts, tau, geometry, exposure, depth_range, seconds })
}

/// Depth of all views by the configured backbone, and the range it lies in.
fn geometry(views: &[View], config: &Config) -> Result<(Vec<ViewGeometry>, (f64, f64))> {
    Ok(match config.backbone {
        Backbone::GivenDepth => {
            let range = GivenDepth::depth_range(views)?;
            (GivenDepth.estimate(views, Wanted::Depth)?, range)
        }
        Backbone::PlaneSweep => {
            let mut sweep = PlaneSweep { range: config.depth_range, ..PlaneSweep::default() };
            let (near, far) = sweep.depth_range(views)?;
            sweep.range = depth_backbone::DepthRange::Known { near, far };
            (sweep.estimate(views, Wanted::Depth)?, (near, far))
        }
    })
}

/// Whether a pixel may become a Gaussian: it has a depth that the photographs do not contradict.
fn usable(geometry: &ViewGeometry) -> impl Iterator<Item = bool> {
    geometry
        .depth
        .data()
        .iter()
        .zip(&geometry.confidence)
        .map(|(&depth, &confidence)| depth > 0.0 && confidence > 0.0)
}

/// The chosen pixels of every view, and tau; `shell` Gaussians of the budget are spent already.
fn sample(
    views: &[View],
    geometry: &[ViewGeometry],
    config: &Config,
    shell: usize,
) -> Result<(Vec<Vec<u32>>, Option<f64>)> {
    let map = |view: &View| -> Result<ImportanceMap> {
        let (width, height) = (view.image().width(), view.image().height());
        let grey = view.image().luma8();
        Ok(match config.allocation {
            Allocation::Entropy => ImportanceMap::entropy(&grey, width, height, EntropyWindow::default())?,
            Allocation::Laplacian => ImportanceMap::laplacian(&grey, width, height)?,
            Allocation::Random | Allocation::PixelAligned => ImportanceMap::uniform(width, height)?,
        })
    };
    if config.allocation == Allocation::PixelAligned {
        let all =
            |geometry| (0..).zip(usable(geometry)).filter(|&(_, usable)| usable).map(|(i, _)| i).collect();
        return Ok((geometry.iter().map(all).collect(), None));
    }
    let weigh = |(view, geometry): (&View, &ViewGeometry)| -> Result<ImportanceMap> {
        let weights = usable(geometry).map(|usable| f32::from(u8::from(usable))).collect();
        Ok(map(view)?.with_weights(weights)?)
    };
    let maps: Vec<ImportanceMap> = views.par_iter().zip(geometry).map(weigh).collect::<Result<_>>()?;
    let budget = match config.budget {
        Budget::Gaussians(total) => entropy_sampler::Budget::Count(total - shell),
        Budget::Tau(tau) => entropy_sampler::Budget::Tau(tau),
    };
    let samples = entropy_sampler::sample(&maps, budget, config.sampler, config.seed)?;
    Ok((samples.pixels, Some(samples.probability.tau)))
}

/// Surface per anchor, scene units²: the disc that reaches to the K-th neighbour, shared among K.
fn area_per_anchor(anchors: &Anchors, neighbours: usize) -> Result<Vec<Option<f64>>> {
    if neighbours == 0 || anchors.is_empty() {
        return Ok(vec![None; anchors.len()]);
    }
    // Seen from one of them: differences far from the world's origin keep their digits.
    let origin = DVec3::from(anchors.positions[0]);
    let found = knn::knn(&anchors.positions_from(origin), neighbours)?;
    let area = |row: usize| {
        let &farthest = found.row(row).1.last()?;
        Some(std::f64::consts::PI * f64::from(farthest) / found.k as f64)
    };
    Ok((0..anchors.len()).map(area).collect())
}

/// The closed-form head on the anchors `range` of one view.
fn head(
    view: &View,
    geometry: &ViewGeometry,
    anchors: &Anchors,
    range: Range<usize>,
    areas: &[Option<f64>],
) -> Result<Gaussians> {
    let inverse = |(usable, &depth): (bool, &f32)| if usable { 1.0 / depth } else { 0.0 };
    let inverse_depth: Vec<f32> = usable(geometry).zip(geometry.depth.data()).map(inverse).collect();
    let width = view.image().width();
    let mut gaussians = Gaussians::empty(0)?;
    let cells = cells(view.image(), &inverse_depth, &anchors.pixels[range.clone()]);
    for (i, cell) in range.zip(&cells) {
        let pixel = anchors.pixels[i] as usize;
        let surface = Surface {
            pixel: DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5),
            depth: f64::from(anchors.depths[i]),
            normal: DVec3::from(anchors.normals[i].map(f64::from)),
            area_per_anchor: areas[i],
            confirmed: geometry.is_confirmed(pixel),
        };
        closed_form::push(&mut gaussians, view.camera(), &surface, cell);
    }
    Ok(gaussians)
}

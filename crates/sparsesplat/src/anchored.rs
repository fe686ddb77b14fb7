//! Everything up to the head: chosen pixels as anchors in space, with their cells, neighbours and closed-form
//! Gaussians.

use crate::cells::{Cell, cells};
use crate::closed_form::{self, Surface};
use crate::exposure;
use crate::learned::History;
use crate::voxels::{self, Voxels};
use crate::{
    Allocation, Backbone, Budget, Config, Counts, Error, ExposureGain, Geometry, Result, Stage, Stages, shell,
};
use backproject::{Anchors, Backprojected, ViewPixels};
use depth_backbone::{FEATURE_NAMES, Features, ViewGeometry};
use entropy_sampler::{EntropyWindow, ImportanceMap};
use glam::{DVec2, DVec3};
use gs_scene::{Camera, Gaussians, View};
use knn::Neighbors;
use rayon::prelude::*;
use std::ops::Range;

/// Anchors, ready for a head.
#[derive(Debug, Clone)]
pub struct Anchored {
    /// The views in the common exposure.
    pub views: Vec<View>,
    /// Gain and bias that brought each view there.
    pub exposure: Vec<ExposureGain>,
    /// What a head starts from: the closed form of every anchor, SH degree 0; in a [refined](Self::refined) scene its Gaussians, degree 2.
    pub base: Gaussians,
    /// The far shell, of the same degree.
    pub shell: Gaussians,
    /// Where the Gaussians come from.
    pub counts: Counts,
    /// The paper's tau; `None` where no pixels are drawn.
    pub tau: Option<f64>,
    /// Width of the patch that each anchor stands for, scene units.
    pub(crate) spacing: Vec<f32>,
    pub(crate) anchors: Anchors,
    pub(crate) cells: Vec<Cell>,
    /// The nearest in space. None for K = 0 and for a single anchor.
    pub(crate) neighbours: Option<Neighbors>,
    /// What the head gathers instead, `[n, K]`, if some of it is chosen by co-visibility.
    pub(crate) gathered: Option<Vec<u32>>,
    /// How `base` came about, unless it is the closed form.
    pub(crate) history: Option<History>,
}

/// Chooses pixels of `views` with known `geometry` and lifts them into space. Anchors have features where the views' geometry has. Of the
/// configuration, backbone, head and fusion are not used: `geometry` is fused already, or not at all. Of the neighbours that a head gathers, the first `covisible`, as far as there are so many, are
/// what other views see where they see the anchor (crate covisibility), nearest in the picture first; the rest are the nearest in space.
///
/// # Errors
/// If settings contradict each other, or the views do not suffice for the budget.
pub fn anchor(
    views: &[View],
    geometry: &Geometry,
    config: &Config,
    covisible: usize,
    stages: &mut Stages<'_>,
) -> Result<Anchored> {
    config.check()?;
    let allocation = config.allocation;
    let Geometry { views: geometry, depth_range: (_, far), shared_by } = geometry;
    let (exposed, exposure) = stages.run(Stage::Exposure, || exposure::equalised(views, geometry));

    let shell = stages.run(Stage::Shell, || match (config.far_shell, config.budget, allocation) {
        (false, _, _) => Gaussians::empty(0),
        // Without a total to keep within, the shell has its finest cells.
        (true, Budget::Tau(_), _) | (true, _, Allocation::PixelAligned) => {
            shell::shell(&exposed, geometry, *far, usize::MAX)
        }
        (true, Budget::Gaussians(n), _) => shell::shell(&exposed, geometry, *far, n),
    })?;

    let (pixels, tau) =
        stages.run(Stage::Sampling, || sample(views, (geometry, shared_by), config, shell.len()))?;

    let (anchors, ranges, voxel_cells) = stages.run(Stage::Backproject, || {
        let view_anchors = |i: usize| {
            let chosen = ViewPixels {
                camera: views[i].camera(),
                depth: geometry[i].depth.data(),
                pixels: &pixels[i],
                image: None,
                features: match &geometry[i].features {
                    Some(Features::Map(map)) => Some(map),
                    Some(Features::Bank { .. }) | None => None,
                },
            };
            let mut part = backproject::anchors(&[chosen], &backproject::Settings::default())?;
            if let Some(bank) = geometry[i].bank_at(&views[i], &part.anchors.pixels)? {
                (part.anchors.features, part.anchors.channels) = (bank, FEATURE_NAMES.len());
            }
            Ok::<_, Error>(part)
        };
        let parts: Vec<Backprojected> =
            (0..views.len()).into_par_iter().map(view_anchors).collect::<Result<_>>()?;
        let mut all = Backprojected::default();
        parts.into_iter().for_each(|part| all.append(part));
        let Backprojected { anchors, ranges, .. } = all;
        Ok::<_, Error>(match (allocation, config.budget) {
            (Allocation::VoxelAligned, Budget::Gaussians(n)) => {
                let Voxels { anchors, ranges, cells } =
                    voxels::voxels(&anchors, &exposed, geometry, n - shell.len());
                (anchors, ranges, Some(cells))
            }
            _ => (anchors, ranges, None),
        })
    })?;

    let (neighbours, gathered) = stages.run(Stage::Knn, || {
        let nearest = neighbours(&anchors, config.neighbours)?;
        let by_views = nearest.as_ref().filter(|_| covisible > 0);
        let gathered = by_views.map(|nearest| gathered(&anchors, views, nearest, covisible));
        Ok::<_, Error>((nearest, gathered.transpose()?))
    })?;

    let (cells, base) = stages.run(Stage::Head, || {
        let view_gaussians = |i: usize| {
            let range = ranges[i].clone();
            let cells = voxel_cells.as_ref().map(|cells| cells[range.clone()].to_vec());
            closed_form(&exposed[i], &geometry[i], &anchors, range, neighbours.as_ref(), cells)
        };
        let per_view: Vec<(Vec<Cell>, Gaussians)> =
            (0..views.len()).into_par_iter().map(view_gaussians).collect::<Result<_>>()?;
        let mut base = Gaussians::empty(0)?;
        per_view.iter().for_each(|(_, part)| base.append(part));
        Ok::<_, Error>((per_view.into_iter().flat_map(|(cells, _)| cells).collect::<Vec<Cell>>(), base))
    })?;
    let spacing =
        cells.iter().zip(&anchors.footprints).map(|(cell, width)| width * cell.area.sqrt()).collect();
    let counts = Counts {
        total: base.len() + shell.len(),
        per_view: ranges.iter().map(ExactSizeIterator::len).collect(),
        shell: shell.len(),
    };
    Ok(Anchored {
        views: exposed,
        exposure,
        base,
        shell,
        counts,
        tau,
        spacing,
        anchors,
        cells,
        neighbours,
        gathered,
        history: None,
    })
}

impl Anchored {
    /// Surface per anchor, scene units²: the disc that reaches to the K-th neighbour, shared among K.
    pub(crate) fn area_per_anchor(&self, anchor: usize) -> Option<f64> {
        area_per_anchor(self.neighbours.as_ref(), anchor)
    }
}

fn area_per_anchor(neighbours: Option<&Neighbors>, anchor: usize) -> Option<f64> {
    let found = neighbours?;
    let &farthest = found.row(anchor).1.last()?;
    Some(std::f64::consts::PI * f64::from(farthest) / found.k as f64)
}

/// Whether a pixel may become a Gaussian.
fn usable(geometry: &ViewGeometry) -> impl Iterator<Item = bool> {
    (0..geometry.confidence.len()).map(|pixel| shell::surface(geometry, pixel).is_some())
}

/// |Laplacian|, in grey levels, from which a pixel counts as detailed. Twice and four times as much lose 0.02 and 0.05 dB
/// (docs/journal/2026-11-sampling.md).
const DETAILED: f32 = 64.0;

/// Entropy over its maximum, times `smooth_weight` where the picture is smooth; the factor rises to 1 with the Laplacian.
fn entropy(grey: &[u8], (width, height): (usize, usize), smooth_weight: f32) -> Result<ImportanceMap> {
    let entropy = ImportanceMap::entropy(grey, width, height, EntropyWindow::default())?;
    if smooth_weight == 1.0 {
        return Ok(entropy);
    }
    let laplacian = ImportanceMap::laplacian(grey, width, height)?;
    // `laplacian` is divided by its maximum, 4 · 255.
    let per_level = 4.0 * 255.0 / DETAILED;
    let importance = |(entropy, laplacian): (&f32, &f32)| {
        let detail = (per_level * laplacian).min(1.0);
        entropy * (smooth_weight + (1.0 - smooth_weight) * detail).min(1.0)
    };
    let values = entropy.values().iter().zip(laplacian.values()).map(importance).collect();
    Ok(ImportanceMap::new(width, height, values)?)
}

/// The chosen pixels of every view, and tau; `shell` Gaussians of the budget are spent already. Where surfaces were fused, a surface has the
/// same number of anchors however many views see it.
fn sample(
    views: &[View],
    (geometry, shared_by): (&[ViewGeometry], &[Vec<u8>]),
    config: &Config,
    shell: usize,
) -> Result<(Vec<Vec<u32>>, Option<f64>)> {
    let map = |view: &View| -> Result<ImportanceMap> {
        let (width, height) = (view.image().width(), view.image().height());
        let grey = view.image().luma8();
        Ok(match config.allocation {
            Allocation::Entropy => entropy(&grey, (width, height), config.smooth_weight)?,
            Allocation::Laplacian => ImportanceMap::laplacian(&grey, width, height)?,
            _ => ImportanceMap::uniform(width, height)?,
        })
    };
    if config.allocation.takes_all() {
        let all =
            |geometry| (0..).zip(usable(geometry)).filter(|&(_, usable)| usable).map(|(i, _)| i).collect();
        return Ok((geometry.iter().map(all).collect(), None));
    }
    let filled = match config.backbone {
        Backbone::PlaneSweep { .. } => config.filled_weight,
        // Measured depth is not filled in, and the confidence of DepthSplat is not a verdict of other views.
        Backbone::GivenDepth | Backbone::DepthSplat(_) => 1.0,
    };
    let weigh = |index: usize| -> Result<ImportanceMap> {
        let geometry = &geometry[index];
        let share = |pixel: usize| shared_by.get(index).map_or(1.0, |by| 1.0 / (1.0 + f32::from(by[pixel])));
        let weight = |(pixel, usable)| match (usable, geometry.is_confirmed(pixel)) {
            (false, _) => 0.0,
            (true, true) => share(pixel),
            (true, false) => filled * share(pixel),
        };
        Ok(map(&views[index])?.with_weights(usable(geometry).enumerate().map(weight).collect())?)
    };
    let maps: Vec<ImportanceMap> = (0..views.len()).into_par_iter().map(weigh).collect::<Result<_>>()?;
    let budget = match config.budget {
        Budget::Gaussians(total) => entropy_sampler::Budget::Count(total - shell),
        Budget::Tau(tau) => entropy_sampler::Budget::Tau(tau),
    };
    let samples = entropy_sampler::sample(&maps, budget, config.sampler, config.seed)?;
    Ok((samples.pixels, Some(samples.probability.tau)))
}

/// The K nearest anchors of every anchor.
fn neighbours(anchors: &Anchors, k: usize) -> Result<Option<Neighbors>> {
    if k == 0 || anchors.len() < 2 {
        return Ok(None);
    }
    // Seen from one of them: differences far from the world's origin keep their digits.
    let origin = DVec3::from(anchors.positions[0]);
    Ok(Some(knn::knn(&anchors.positions_from(origin), k)?))
}

/// How far from where a view sees an anchor its co-visible neighbours may lie, in mean distances of the anchors of a view.
const COVISIBLE_RADIUS: f64 = 4.0;
/// Relative difference of depths up to which one anchor does not hide another: that of good stereo.
const HIDES: f64 = 0.05;

/// As many neighbours as there are `nearest` ones: up to `covisible` by co-visibility, then the nearest that are not among them.
fn gathered(anchors: &Anchors, views: &[View], nearest: &Neighbors, covisible: usize) -> Result<Vec<u32>> {
    let cameras: Vec<Camera> = views.iter().map(|view| *view.camera()).collect();
    let pixels: usize = cameras.iter().map(|camera| camera.width() * camera.height()).sum();
    let spacing = (pixels as f64 / anchors.len() as f64).sqrt();
    let settings = covisibility::Settings {
        k: covisible.min(nearest.k),
        radius: COVISIBLE_RADIUS * spacing,
        tolerance: HIDES,
    };
    let seen = covisibility::Anchors {
        positions: &anchors.positions,
        views: &anchors.views,
        pixels: &anchors.pixels,
        depths: &anchors.depths,
    };
    let found = covisibility::neighbors(&seen, &cameras, &settings)?;
    let mut all = Vec::with_capacity(nearest.indices.len());
    for anchor in 0..nearest.rows {
        let (seen, near) = (found.row(anchor).0, nearest.row(anchor).0);
        let others = near.iter().filter(|other| !seen.contains(other)).take(nearest.k - seen.len());
        all.extend(seen.iter().chain(others));
    }
    Ok(all)
}

/// Cells and closed-form Gaussians of the anchors `range` of one view; `voxels` are the cells if these are voxels, which
/// lie where the centres of their cells are, not at their pixels'.
fn closed_form(
    view: &View,
    geometry: &ViewGeometry,
    anchors: &Anchors,
    range: Range<usize>,
    neighbours: Option<&Neighbors>,
    voxels: Option<Vec<Cell>>,
) -> Result<(Vec<Cell>, Gaussians)> {
    let inverse = |(usable, &depth): (bool, &f32)| if usable { 1.0 / depth } else { 0.0 };
    let inverse_depth: Vec<f32> = usable(geometry).zip(geometry.depth.data()).map(inverse).collect();
    let width = view.image().width();
    let mut gaussians = Gaussians::empty(0)?;
    let is_voxel = voxels.is_some();
    let cells = voxels.unwrap_or_else(|| cells(view.image(), &inverse_depth, &anchors.pixels[range.clone()]));
    for (i, cell) in range.zip(&cells) {
        let pixel = anchors.pixels[i] as usize;
        let middle = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
        let surface = Surface {
            pixel: if is_voxel { DVec2::from(cell.centre.map(f64::from)) } else { middle },
            depth: f64::from(anchors.depths[i]),
            normal: DVec3::from(anchors.normals[i].map(f64::from)),
            area_per_anchor: area_per_anchor(neighbours, i),
            confirmed: geometry.is_confirmed(pixel),
            voxel: is_voxel,
        };
        closed_form::push(&mut gaussians, view.camera(), &surface, cell);
    }
    Ok((cells, gaussians))
}

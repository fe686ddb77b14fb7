//! Multi-view stereo over inverse-depth planes.

use crate::backbone::{DepthBackbone, ViewGeometry, Wanted, check_pixels};
use crate::confirm::confirmed;
use crate::consistency::{Witness, contradicted};
use crate::cost::{Hypotheses, Reference, Source, WindowStatistics, surface_costs, volume};
use crate::learned::{DepthNetwork, Evidence, Inputs, of_all};
use crate::pair::Pair;
use crate::range::{DepthRange, Planes};
use crate::resolution::{enlarged, reduced};
use crate::texture::Texture;
use crate::{Error, Features, Result, fill, sgm, sources};
use cpu_kernels::Isa;
use gs_scene::{Camera, DepthMap, View};
use rayon::prelude::*;
use std::sync::Arc;

/// Plane-sweep stereo: ZNCC of 7×7 windows over several sources, semi-global matching of all planes at half the resolution and of a
/// few about what was found at the full one, a check between the views, and filling of what failed it.
#[derive(Debug, Clone)]
pub struct PlaneSweep {
    /// Near and far end of the scene.
    pub range: DepthRange,
    /// Number of planes.
    pub planes: usize,
    /// Views that each view is matched with at most.
    pub sources: usize,
    /// The network that fills what the views do not confirm, if there is one; otherwise confirmed neighbours do.
    pub network: Option<Arc<DepthNetwork>>,
}

impl Default for PlaneSweep {
    fn default() -> Self {
        Self { range: DepthRange::Estimate, planes: 128, sources: 4, network: None }
    }
}

/// The resolution and the number of planes are reduced by this for the first sweep …
const COARSE: usize = 2;
/// … of pictures of which one has a side of at least this, pixels: smaller ones have none to spare.
const LARGE: usize = 240;
/// The second sweep tries this many planes before and behind the surface of the first.
const REACH: i32 = 3;
/// Cost volumes of all views in work take no more than this, bytes, unless that of a single one does.
const VOLUMES: usize = 1 << 29;

/// Baseline over depth below which two views are taken to stand in the same place.
const LEAST_PARALLAX: f64 = 0.005;
/// Confidence of depth that was filled in from confirmed neighbours …
const FILLED_CONFIDENCE: f32 = 0.25;
/// … and of depth that nothing supports: a view without a single confirmed pixel.
const UNSUPPORTED_CONFIDENCE: f32 = 0.1;

/// One view on its way through the stages.
pub(crate) struct Matched<'a> {
    pub(crate) view: &'a View,
    pub(crate) texture: Texture,
    pub(crate) statistics: WindowStatistics,
    pub(crate) sources: Vec<usize>,
}

impl<'v> Matched<'v> {
    pub(crate) fn new(view: &'v View, sources: Vec<usize>) -> Self {
        let texture = Texture::new(view.image());
        let statistics = WindowStatistics::new(&texture);
        Self { view, texture, statistics, sources }
    }

    pub(crate) fn reference(&self) -> Reference<'_> {
        Reference { texture: &self.texture, statistics: &self.statistics }
    }

    /// The views, each with its sources.
    pub(crate) fn all(views: &'v [View], sources: &[Vec<usize>]) -> Vec<Self> {
        views.par_iter().zip(sources).map(|(view, sources)| Self::new(view, sources.clone())).collect()
    }

    /// The views that it is matched with.
    pub(crate) fn sources<'a>(&self, all: &'a [Matched]) -> Vec<Source<'a>> {
        let source = |&index: &usize| Source {
            texture: &all[index].texture,
            pair: Pair::new(self.view.camera(), all[index].view.camera()),
        };
        self.sources.iter().map(source).collect()
    }
}

impl PlaneSweep {
    /// Name of its features; another number where they change their meaning.
    pub const SCHEMA: &str = "plane-sweep-1";

    /// The range that the sweep covers, z-depths in scene units: `range` as given, or estimated from the views.
    ///
    /// # Errors
    /// If it cannot be estimated, or is no range.
    pub fn depth_range(&self, views: &[View]) -> Result<(f64, f64)> {
        check(views)?;
        match self.range {
            DepthRange::Known { near, far } => Ok((near, far)),
            DepthRange::Estimate => crate::estimate::depth_range(views),
        }
    }
}

/// What stereo found of all views, before anything is joined to a result.
struct Survey<'v> {
    planes: Planes,
    matched: Vec<Matched<'v>>,
    evidence: Vec<Evidence>,
}

impl PlaneSweep {
    /// What the network behind the sweep sees of each view, for its training.
    ///
    /// # Errors
    /// If the views do not suffice for stereo.
    pub fn inputs(&self, views: &[View]) -> Result<Vec<Inputs>> {
        let Survey { planes, matched, evidence } = self.survey(views, true)?;
        Ok(of_all(&matched, &evidence, &planes))
    }

    /// Sweep, check between the views, and filling. `for_network` finds how far the best planes stand out, too.
    fn survey<'v>(&self, views: &'v [View], for_network: bool) -> Result<Survey<'v>> {
        if self.sources == 0 {
            return Err(Error::Setting { setting: "sources", found: 0.0, expected: "1 or more" });
        }
        let (near, far) = self.depth_range(views)?;
        let planes = Planes::new(near, far, self.planes)?;
        let cameras: Vec<Camera> = views.iter().map(|view| *view.camera()).collect();
        let chosen = sources::choose(&cameras, &planes, self.sources);
        let side = |view: &View| view.camera().width().max(view.camera().height());
        let factor = if views.iter().any(|view| side(view) >= LARGE) { COARSE } else { 1 };
        let surfaces = coarse_surfaces(views, &chosen, &planes, factor)?;
        let matched = Matched::all(views, &chosen);
        let found = within_volumes(&matched, 2 * REACH as usize + 1, |i, view| {
            let (coarse, surface) = &surfaces[i];
            let surface = enlarged(surface, coarse, &view.texture, factor);
            sweep_about(view, &matched, &planes, &surface, for_network)
        });
        drop(surfaces);
        let (inverse_depths, distinct): (Vec<_>, Vec<_>) = found.into_iter().unzip();
        let filled: Vec<(Vec<f32>, Vec<f32>)> = confirmed(&matched, &inverse_depths, &planes)
            .par_iter()
            .zip(&matched)
            .map(|(agreed, view)| fuse_and_fill(&view.texture, agreed))
            .collect();
        let found = inverse_depths.into_iter().zip(distinct).zip(filled);
        let evidence = found.map(|((matched, distinct), (inverse_depth, confidence))| Evidence {
            matched,
            distinct,
            inverse_depth,
            confidence,
        });
        let evidence = evidence.collect();
        Ok(Survey { planes, matched, evidence })
    }
}

/// Matching costs of a view's surface, 0..1.
pub(crate) fn costs_of(view: &Matched, all: &[Matched], surface: &[f32], planes: &Planes) -> Vec<f32> {
    surface_costs(Isa::in_use(), view.reference(), &view.sources(all), surface, planes.ends())
}

impl DepthBackbone for PlaneSweep {
    fn estimate(&self, views: &[View], wanted: Wanted) -> Result<Vec<ViewGeometry>> {
        wanted.without_own_head("plane-sweep stereo")?;
        let Survey { planes, matched, evidence } = self.survey(views, self.network.is_some())?;
        let surfaces: Vec<(Vec<f32>, Vec<f32>)> = match &self.network {
            None => evidence.into_iter().map(|found| (found.inverse_depth, found.confidence)).collect(),
            Some(network) => {
                let inputs = of_all(&matched, &evidence, &planes);
                let joined = inputs.into_par_iter().zip(evidence).map(|(inputs, found)| {
                    let stereo = found.inverse_depth.into_iter().zip(found.confidence);
                    inputs.join(&network.run(&inputs), stereo)
                });
                joined.collect()
            }
        };
        let (inverse_depths, mut confidences): (Vec<_>, Vec<_>) = surfaces.into_iter().unzip();
        confidences.par_iter_mut().enumerate().for_each(|(i, confidence)| {
            let witnesses = witnesses(i, &matched, &inverse_depths, &planes);
            let wrong = contradicted(matched[i].view, &inverse_depths[i], &witnesses, &planes);
            for (confidence, _) in confidence.iter_mut().zip(wrong).filter(|(_, wrong)| *wrong) {
                *confidence = 0.0;
            }
        });
        (0..views.len())
            .into_par_iter()
            .zip(confidences)
            .map(|(i, confidence)| {
                let view = &matched[i];
                let inverse_depth = &inverse_depths[i];
                let (width, height) = (view.texture.width, view.texture.height);
                let depth = DepthMap::new(width, height, inverse_depth.iter().map(|w| 1.0 / w).collect())?;
                let features = match wanted {
                    Wanted::Depth | Wanted::DepthAndGaussians => None,
                    Wanted::DepthAndFeatures => Some(Features::Bank {
                        schema: Self::SCHEMA.to_owned(),
                        cost: costs_of(view, &matched, inverse_depth, &planes),
                    }),
                };
                Ok(ViewGeometry { depth, confidence, features, gaussians: None })
            })
            .collect()
    }
}

/// What stereo cannot work with.
fn check(views: &[View]) -> Result<()> {
    check_pixels(views)?;
    if views.len() == 1 { Err(Error::OneView) } else { Ok(()) }
}

/// Whether a view sees the middle of the range from elsewhere than another one. What is seen from the same place agrees at any depth.
pub(crate) fn has_parallax(index: usize, other: usize, matched: &[Matched], planes: &Planes) -> bool {
    let position = |view: usize| matched[view].view.camera().position();
    position(index).distance(position(other)) * planes.inverse_depth_at(0.5) > LEAST_PARALLAX
}

/// Numbers of the other views that can judge a view's depth …
pub(crate) fn witness_views(
    index: usize,
    matched: &[Matched],
    planes: &Planes,
) -> impl Iterator<Item = usize> {
    (0..matched.len()).filter(move |&other| other != index && has_parallax(index, other, matched, planes))
}

/// … and what they saw.
pub(crate) fn witnesses<'a>(
    index: usize,
    matched: &'a [Matched],
    inverse_depths: &'a [Vec<f32>],
    planes: &Planes,
) -> Vec<Witness<'a>> {
    witness_views(index, matched, planes)
        .map(|other| Witness::new(matched[index].view, matched[other].view, &inverse_depths[other]))
        .collect()
}

/// Inverse depths at 1/`factor` of the resolution, each with the picture that it was found on.
fn coarse_surfaces(
    views: &[View],
    sources: &[Vec<usize>],
    planes: &Planes,
    factor: usize,
) -> Result<Vec<(Texture, Vec<f32>)>> {
    let small: Vec<View> = views.par_iter().map(|view| reduced(view, factor)).collect::<Result<_>>()?;
    let matched = Matched::all(&small, sources);
    let planes = planes.thinned(factor);
    let found = within_volumes(&matched, planes.count(), |_, view| sweep(view, &matched, &planes));
    Ok(matched.into_iter().map(|view| view.texture).zip(found).collect())
}

/// What `find` makes of each view, of as many at once as have room for their volumes of `planes`.
fn within_volumes<'v, T: Send>(
    views: &[Matched<'v>],
    planes: usize,
    find: impl Fn(usize, &Matched<'v>) -> T + Sync,
) -> Vec<T> {
    let pixels = |view: &Matched| view.texture.width * view.texture.height;
    let largest = views.iter().map(pixels).max().unwrap_or(0);
    // Costs and their sums.
    let bytes = 2 * size_of::<u16>() * largest * planes.next_multiple_of(sgm::LANES);
    let at_once = (VOLUMES / bytes.max(1)).max(1);
    let batch = |(first, views): (usize, &[Matched<'v>])| {
        views.par_iter().enumerate().map(|(i, view)| find(first + i, view)).collect::<Vec<_>>()
    };
    views.chunks(at_once).enumerate().map(|(i, views)| (i * at_once, views)).flat_map(batch).collect()
}

/// A view's inverse depth by semi-global matching of all planes.
pub(crate) fn sweep(view: &Matched, all: &[Matched], planes: &Planes) -> Vec<f32> {
    let sums = sums(view, all, Hypotheses::Planes(&planes.inverse_depths()), None);
    let winners = sgm::winners(&sums, planes.count().next_multiple_of(sgm::LANES), planes.count());
    winners.into_iter().map(|plane| planes.inverse_depth(plane)).collect()
}

/// A view's inverse depth by semi-global matching of the planes within [`REACH`] of a surface, which windows follow; and how far the
/// best plane stands out, if that is wanted.
fn sweep_about(
    view: &Matched,
    all: &[Matched],
    planes: &Planes,
    surface: &[f32],
    with_distinctness: bool,
) -> (Vec<f32>, Vec<f32>) {
    let ((farthest, nearest), step) = (planes.ends(), planes.step());
    let offsets: Vec<f32> = (-REACH..=REACH).map(|plane| plane as f32 * step).collect();
    let hypotheses = Hypotheses::About { surface, offsets: &offsets, ends: planes.ends() };
    let first: Vec<i32> = surface.iter().map(|&w| planes.next_to(w)).collect();
    let sums = sums(view, all, hypotheses, Some(&first));
    let padded = offsets.len().next_multiple_of(sgm::LANES);
    let winners = sgm::winners(&sums, padded, offsets.len());
    let place = |(winner, w): (f32, &f32)| (w + (winner - REACH as f32) * step).clamp(farthest, nearest);
    let found = winners.into_iter().zip(surface).map(place).collect();
    let distinct =
        if with_distinctness { sgm::distinctness(&sums, padded, offsets.len()) } else { Vec::new() };
    (found, distinct)
}

/// Sums of the matching costs of a view's hypotheses at each pixel, filled up to whole vectors. `first` is the number of each pixel's
/// first plane, where they differ.
fn sums(view: &Matched, all: &[Matched], hypotheses: Hypotheses, first: Option<&[i32]>) -> Vec<u16> {
    let isa = Isa::in_use();
    let costs = volume(isa, view.reference(), &view.sources(all), hypotheses);
    let planes = hypotheses.len().next_multiple_of(sgm::LANES);
    let volume = sgm::Volume { costs: &costs, width: view.texture.width, planes, first };
    sgm::aggregate(isa, volume, &view.texture.values)
}

/// Joins what the views agree on, and fills the rest from confirmed neighbours. Returns inverse depth and confidence.
fn fuse_and_fill(texture: &Texture, agreed: &[(u8, f32)]) -> (Vec<f32>, Vec<f32>) {
    let (weights, values): (Vec<f32>, Vec<f32>) =
        agreed.iter().map(|&(count, mean)| (f32::from(count), mean)).unzip();
    let filled = fill::interpolate(&values, &weights, &texture.values, texture.width);
    agreed
        .iter()
        .zip(filled)
        .map(|(&(count, mean), filled)| match (count, filled) {
            (0, Some(filled)) => (filled, FILLED_CONFIDENCE),
            (0, None) => (mean, UNSUPPORTED_CONFIDENCE),
            _ => (mean, 1.0 - 0.5_f32.powi(i32::from(count))),
        })
        .unzip()
}

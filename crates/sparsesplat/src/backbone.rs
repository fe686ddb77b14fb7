//! The configured backbone: depth, and what else is wanted of it.

use crate::{Backbone, Config, Error, Result, SweepDepth};
use depth_backbone::{
    DepthBackbone, DepthNetwork, DepthRange, DepthWeights, GivenDepth, NetworkDevice, PlaneSweep,
    ViewGeometry, Wanted,
};
use gs_scene::View;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What the backbone says of all views.
#[derive(Debug, Clone)]
pub struct Geometry {
    /// Of each view: depth, confidence, and what else was wanted.
    pub views: Vec<ViewGeometry>,
    /// The range that depth lies in, near and far, scene units.
    pub depth_range: (f64, f64),
    /// Of each view, how many others share the surface of each of its pixels, if surfaces were [fused](Self::fused); empty otherwise.
    pub shared_by: Vec<Vec<u8>>,
}

impl Geometry {
    /// With surfaces that several views see joined ([`depth_backbone::fuse`]).
    ///
    /// # Errors
    /// If `views` are not those of this geometry.
    pub fn fused(&self, views: &[View]) -> Result<Self> {
        let (mut fused, mut shared_by) = (self.clone(), Vec::with_capacity(views.len()));
        for (view, joined) in fused.views.iter_mut().zip(depth_backbone::fuse(views, &self.views)?) {
            view.depth = joined.depth;
            shared_by.push(joined.shared_by);
        }
        Ok(Self { shared_by, ..fused })
    }
}

/// Depth of all views by the configured backbone, and what else is wanted.
pub(crate) fn geometry(
    views: &[View],
    config: &Config,
    networks: &Networks,
    wanted: Wanted,
) -> Result<Geometry> {
    let stereo = PlaneSweep { range: config.depth_range, ..PlaneSweep::default() };
    let (views, depth_range) = match &config.backbone {
        Backbone::GivenDepth => {
            let range = GivenDepth::depth_range(views)?;
            (GivenDepth.estimate(views, wanted)?, range)
        }
        Backbone::PlaneSweep { planes, .. } => {
            check_parallax(views, config.depth_range)?;
            let (near, far) = stereo.depth_range(views)?;
            let sweep = PlaneSweep {
                range: DepthRange::Known { near, far },
                planes: *planes,
                network: networks.sweep.as_ref().map(|(_, network)| Arc::clone(network)),
                ..stereo
            };
            (sweep.estimate(views, wanted)?, (near, far))
        }
        Backbone::DepthSplat(weights) => {
            check_parallax(views, config.depth_range)?;
            let network = networks.depthsplat.as_ref().ok_or_else(|| no_network(weights))?;
            let range = stereo.depth_range(views)?;
            (network.model.estimate_within(views, range, wanted)?, range)
        }
    };
    Ok(Geometry { views, depth_range, shared_by: Vec::new() })
}

/// What the nearest content moves by between the cameras farthest apart, pixels, below which there is nothing to match.
const LEAST_PARALLAX: f64 = 0.1;
/// Cameras nearer to each other than this part of their distance from the origin stand in one place: poses that turn in one place differ by
/// the rounding of rotation and translation.
const SAME_PLACE: f64 = 1e-9;

/// Refuses views that differ by rotation alone, of which a stated range would make a scene without meaning. One view is refused elsewhere.
fn check_parallax(views: &[View], range: DepthRange) -> Result<()> {
    let position = |view: &View| view.camera().position();
    let distances = views.iter().flat_map(|a| views.iter().map(move |b| position(a).distance(position(b))));
    let distance = distances.fold(0.0, f64::max);
    let parallax = |near: f64| {
        let focal = views.iter().map(|view| view.camera().intrinsics().fx).fold(0.0, f64::max);
        focal * distance / near
    };
    let is_one_place = match range {
        DepthRange::Known { near, .. } => parallax(near) < LEAST_PARALLAX,
        DepthRange::Estimate => {
            distance <= SAME_PLACE * views.iter().map(|view| position(view).length()).fold(0.0, f64::max)
        }
    };
    if views.len() > 1 && is_one_place {
        return Err(Error::NoParallax { views: views.len(), distance });
    }
    Ok(())
}

/// What tells results of one backbone from those of another: its name, and which weights it has, whatever their file is called.
pub(crate) fn identity(backbone: &Backbone, networks: &Networks) -> String {
    match (backbone, &networks.depthsplat, &networks.sweep) {
        (Backbone::DepthSplat(_), Some(network), _) => network.model.schema().to_owned(),
        (Backbone::PlaneSweep { planes, .. }, _, Some((_, network))) => {
            format!("PlaneSweep {{ planes: {planes}, network: {} }}", network.name())
        }
        (backbone, _, _) => format!("{backbone:?}"),
    }
}

/// The networks that a configuration needs, in memory.
#[derive(Debug, Clone, Default)]
pub(crate) struct Networks {
    /// Of the backbone DepthSplat, or the one that was read last.
    pub(crate) depthsplat: Option<Network>,
    /// Behind the plane sweep.
    pub(crate) sweep: Option<(SweepDepth, Arc<DepthNetwork>)>,
}

impl Networks {
    /// Those of a configuration; what is there already is not read again.
    pub(crate) fn of(&self, backbone: &Backbone, device: NetworkDevice) -> Result<Self> {
        let mut new = self.clone();
        match backbone {
            Backbone::DepthSplat(weights) => {
                if !new.depthsplat.as_ref().is_some_and(|network| network.is_of(weights)) {
                    new.depthsplat = Some(Network::read(weights, device)?);
                }
            }
            Backbone::PlaneSweep { depth, .. } => {
                if new.sweep.as_ref().is_none_or(|(kind, _)| kind != depth) {
                    new.sweep = match depth {
                        SweepDepth::Stereo => None,
                        SweepDepth::Learned => Some(DepthWeights::from_bytes(LEARNED_DEPTH)?),
                        SweepDepth::Weights(path) => Some(DepthWeights::read(path)?),
                    }
                    .map(|weights| DepthNetwork::new(&weights))
                    .transpose()?
                    .map(|network| (depth.clone(), Arc::new(network)));
                }
            }
            Backbone::GivenDepth => {}
        }
        Ok(new)
    }
}

/// This crate's weights of the network behind the plane sweep.
const LEARNED_DEPTH: &[u8] = include_bytes!("../weights/learned-depth-1.safetensors");

/// A network in memory, and the file that its weights are from.
#[derive(Clone)]
pub(crate) struct Network {
    weights: PathBuf,
    model: Arc<Model>,
}

impl Network {
    /// Whether its weights are from this file.
    pub(crate) fn is_of(&self, weights: &Path) -> bool {
        self.weights == weights
    }

    #[cfg(feature = "depthsplat")]
    pub(crate) fn read(weights: &Path, device: NetworkDevice) -> Result<Self> {
        let model = Arc::new(Model::open_on(weights, device)?);
        Ok(Self { weights: weights.to_owned(), model })
    }

    #[cfg(not(feature = "depthsplat"))]
    pub(crate) fn read(weights: &Path, _: NetworkDevice) -> Result<Self> {
        Err(no_network(weights))
    }
}

impl std::fmt::Debug for Network {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_tuple("Network").field(&self.weights).finish()
    }
}

fn no_network(weights: &Path) -> Error {
    Error::NoNetwork { weights: weights.display().to_string() }
}

#[cfg(feature = "depthsplat")]
type Model = depth_backbone::DepthSplat;

/// Without the feature `depthsplat` there is no network: a type that has no values.
#[cfg(not(feature = "depthsplat"))]
enum Model {}

#[cfg(not(feature = "depthsplat"))]
impl Model {
    fn schema(&self) -> &str {
        match *self {}
    }

    fn estimate_within(
        &self,
        _: &[View],
        _: (f64, f64),
        _: Wanted,
    ) -> depth_backbone::Result<Vec<ViewGeometry>> {
        match *self {}
    }
}

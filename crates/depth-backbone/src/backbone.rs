use crate::features::Features;
use crate::{Error, Result};
use gs_scene::{DepthMap, Gaussians, View};
use rayon::prelude::*;

/// What a backbone knows of one view (paper, section 3.1): geometry and features at the view's own size.
#[derive(Debug, Clone)]
pub struct ViewGeometry {
    /// z-depth, scene units; 0 where there is none.
    pub depth: DepthMap,
    /// How far the depth can be trusted, `[height, width]`, 0..1. Below ½ it was filled in from neighbours or by the learned stage; at 0
    /// there is none, the photographs contradict it, or the learned stage takes the pixel for sky.
    pub confidence: Vec<f32>,
    /// Image features F, if they were wanted. [`ViewGeometry::feature_map`] gives them as a map, [`ViewGeometry::bank_at`] at some pixels.
    pub features: Option<Features>,
    /// One Gaussian per pixel, row by row, in the world, by the backbone's own head, if they were wanted.
    pub gaussians: Option<Gaussians>,
}

impl ViewGeometry {
    /// Whether the depth of a pixel (row-major index) was measured or confirmed by another view, not filled in.
    #[must_use]
    pub fn is_confirmed(&self, pixel: usize) -> bool {
        self.confidence[pixel] >= 0.5
    }
}

/// What a head needs of a backbone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// Depth and confidence.
    Depth,
    /// Features as well.
    DepthAndFeatures,
    /// Depth, and Gaussians by the backbone's own head: an error where it has none.
    DepthAndGaussians,
}

/// Where a network is computed. Each but the CPU needs the Cargo feature of its name, and its first device is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NetworkDevice {
    /// The processor.
    Cpu,
    /// A graphics card of NVIDIA's.
    Cuda,
    /// A GPU of Apple's.
    Metal,
}

impl Wanted {
    /// That no Gaussians are wanted of a backbone that makes none.
    pub(crate) fn without_own_head(self, backbone: &'static str) -> Result<()> {
        if self == Self::DepthAndGaussians { Err(Error::NoOwnHead { backbone }) } else { Ok(()) }
    }
}

/// Frozen network or hand-made stereo: anything that gives depth and features for a set of views.
pub trait DepthBackbone {
    /// Depth, confidence and what else is wanted of every view, in the order of the views.
    ///
    /// # Errors
    /// If the views do not suffice (see [`crate::Error`]).
    fn estimate(&self, views: &[View], wanted: Wanted) -> Result<Vec<ViewGeometry>>;
}

/// Every backbone wants views, and pixels that are numbers.
pub(crate) fn check_pixels(views: &[View]) -> Result<()> {
    if views.is_empty() {
        return Err(Error::NoViews);
    }
    let check = |view: &View| match view.image().data().iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(i) => {
            let (pixel, width) = (i / 3, view.image().width());
            Err(Error::PixelNotFinite { view: view.name().to_owned(), x: pixel % width, y: pixel / width })
        }
    };
    // The error of the first view that has one, whichever is found first.
    views.par_iter().map(check).collect::<Vec<_>>().into_iter().collect()
}

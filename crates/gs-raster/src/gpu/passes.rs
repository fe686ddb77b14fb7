//! How each pass of gs-shaders is dispatched: one module per pass, named as its file.

mod bin;
mod project;
mod project_backward;
mod rasterize_backward;
mod rasterize_ellipsoids;
mod rasterize_forward;
mod scan;
mod sort;
mod tile_ranges;

pub(super) use project_backward::StoredSums;
pub(super) use sort::Keyed;

use gs_shaders::Features;

/// For passes that depend on no feature.
const NO_FEATURES: Features = Features { sh_degree: 0, antialias: false, depth: false };

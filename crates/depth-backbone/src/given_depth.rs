//! Measured depth that comes with the data.

use crate::backbone::check_pixels;
use crate::{DepthBackbone, Error, Features, Result, ViewGeometry, Wanted};
use gs_scene::View;

/// Depth as measured: confidence 1 where there is a measurement, 0 where there is none. The features are those of the
/// plane sweep, with a matching cost of 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GivenDepth;

impl GivenDepth {
    /// Name of its features; another number where they change their meaning.
    pub const SCHEMA: &str = "given-depth-1";

    /// Smallest and largest measured z-depth but half a percent at either end, scene units.
    ///
    /// # Errors
    /// If a view has no measured depth, or nothing was measured in any.
    pub fn depth_range(views: &[View]) -> Result<(f64, f64)> {
        let mut all = Vec::new();
        for view in views {
            let depth = view.depth().ok_or_else(|| Error::NoDepth { view: view.name().to_owned() })?;
            all.extend(depth.data().iter().copied().filter(|&d| d > 0.0));
        }
        if all.is_empty() {
            return Err(Error::NothingMeasured);
        }
        all.sort_unstable_by(f32::total_cmp);
        let quantile = |part: f64| f64::from(all[((all.len() - 1) as f64 * part).round() as usize]);
        Ok((quantile(0.005), quantile(0.995)))
    }
}

impl DepthBackbone for GivenDepth {
    fn estimate(&self, views: &[View], wanted: Wanted) -> Result<Vec<ViewGeometry>> {
        wanted.without_own_head("measured depth")?;
        check_pixels(views)?;
        views
            .iter()
            .map(|view| {
                let depth =
                    view.depth().ok_or_else(|| Error::NoDepth { view: view.name().to_owned() })?.clone();
                let confidence: Vec<f32> =
                    depth.data().iter().map(|&d| if d > 0.0 { 1.0 } else { 0.0 }).collect();
                let features = match wanted {
                    Wanted::Depth | Wanted::DepthAndGaussians => None,
                    Wanted::DepthAndFeatures => {
                        let cost = vec![0.0; confidence.len()];
                        Some(Features::Bank { schema: Self::SCHEMA.to_owned(), cost })
                    }
                };
                Ok(ViewGeometry { depth, confidence, features, gaussians: None })
            })
            .collect()
    }
}

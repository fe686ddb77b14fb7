use crate::lift::Lift;
use crate::{Error, Result};
use gs_scene::{Camera, FeatureMap, Image};
use std::ops::AddAssign;

/// The chosen pixels of one view, and what is known at them.
#[derive(Debug, Clone, Copy)]
pub struct ViewPixels<'a> {
    /// Where the view was taken from.
    pub camera: &'a Camera,
    /// z-depth of the whole view, `[height, width]`, scene units, as it comes from a sensor or a network: holes may be 0, NaN,
    /// infinite or negative.
    pub depth: &'a [f32],
    /// Row-major indices of the chosen pixels. Any order, repetitions allowed; ascending is fastest.
    pub pixels: &'a [u32],
    /// The photograph, if colours are wanted; the camera's size.
    pub image: Option<&'a Image>,
    /// Feature map, if features are wanted; any size.
    pub features: Option<&'a FeatureMap>,
}

/// Pixels that gave no anchor, by what was wrong with their depth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Depth 0.
    pub no_depth: usize,
    /// NaN or infinite.
    pub not_finite: usize,
    /// Below 0.
    pub negative: usize,
    /// Farther than [`crate::Settings::far`].
    pub beyond_far: usize,
}

impl Dropped {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> usize {
        self.no_depth + self.not_finite + self.negative + self.beyond_far
    }
}

impl AddAssign for Dropped {
    fn add_assign(&mut self, other: Self) {
        self.no_depth += other.no_depth;
        self.not_finite += other.not_finite;
        self.negative += other.negative;
        self.beyond_far += other.beyond_far;
    }
}

/// Whether a depth gives an anchor; the one rule, which [`count_dropped`] puts into words.
pub(crate) fn is_kept(depth: f32, far: f32) -> bool {
    depth > 0.0 && depth < f32::INFINITY && depth <= far
}

/// Counts what [`is_kept`] drops among `pixels`; the error is the first pixel outside the depth map.
pub(crate) fn count_dropped(pixels: &[u32], depth: &[f32], far: f32) -> std::result::Result<Dropped, u32> {
    let mut dropped = Dropped::default();
    for &pixel in pixels {
        let &depth = depth.get(pixel as usize).ok_or(pixel)?;
        if is_kept(depth, far) {
            continue;
        }
        let reason = match depth {
            _ if !depth.is_finite() => &mut dropped.not_finite,
            0.0 => &mut dropped.no_depth,
            _ if depth < 0.0 => &mut dropped.negative,
            _ => &mut dropped.beyond_far,
        };
        *reason += 1;
    }
    Ok(dropped)
}

/// Depth that fits the camera, and a camera that keeps every point finite.
pub(crate) fn check_geometry(view: usize, camera: &Camera, depth: &[f32]) -> Result<()> {
    let (width, height) = (camera.width(), camera.height());
    if depth.len() != width * height {
        return Err(Error::DepthCount { view, width, height, found: depth.len() });
    }
    if !Lift::new(camera).is_finite() {
        return Err(Error::CameraRange { view });
    }
    Ok(())
}

/// Sizes that fit within every view, and views that give the same arrays.
pub(crate) fn check(views: &[ViewPixels]) -> Result<()> {
    for (view, pixels) in views.iter().enumerate() {
        let &ViewPixels { camera, depth, image, features, .. } = pixels;
        check_geometry(view, camera, depth)?;
        let (width, height) = (camera.width(), camera.height());
        if let Some(image) = image
            && (image.width(), image.height()) != (width, height)
        {
            let (found_width, found_height) = (image.width(), image.height());
            return Err(Error::ImageSize { view, width, height, found_width, found_height });
        }
        if image.is_some() != views[0].image.is_some() {
            return Err(Error::Missing { view, what: "an image" });
        }
        match (features, views[0].features) {
            (None, None) => {}
            (Some(own_features), Some(first)) if own_features.channels() == first.channels() => {}
            (Some(own_features), Some(first)) => {
                return Err(Error::Channels {
                    view,
                    expected: first.channels(),
                    found: own_features.channels(),
                });
            }
            _ => return Err(Error::Missing { view, what: "features" }),
        }
    }
    Ok(())
}

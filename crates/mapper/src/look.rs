//! A first look at a frame: whether the map shows it already. It takes milliseconds, as most frames get no other.

use crate::compare::THIN;
use crate::covisibility::Footprint;
use crate::keyframes::Keyframes;
use crate::map::Map;
use crate::{Depth, Result, Seen};
use gs_raster::{Rasterizer, RenderSettings, near_plane};
use gs_scene::View;

/// The map is rendered so many pixels wide, and as the frame is if that is narrower.
const WIDTH: usize = 120;
/// Depths of the small rendering and of the frame differ by more than this, relative, where something else stands.
const OTHER_DEPTH: f32 = 0.15;
/// Frames that have more in common than this with a keyframe show nothing new.
const SIMILAR: f64 = 0.92;
/// Share of the picture where the map is thin, from which on a frame becomes a keyframe …
const NEW: f64 = 0.06;
/// … and from which on it does, however similar it is to another, if its depth is measured: something has moved.
const CHANGED: f64 = 0.2;
/// Share of the content that was seen from nearby, below which a frame becomes a keyframe.
const COVERED: f64 = 0.8;

/// How far a map shows a frame.
#[derive(Debug, Clone)]
pub(crate) struct Look {
    pub(crate) seen: Seen,
    /// What the frame shows by the map, and by its own depth if it is measured.
    pub(crate) footprint: Footprint,
    /// z-depths of the map that lie in the frame, ascending, scene units.
    pub(crate) depths: Vec<f32>,
}

impl Look {
    /// Looks at a frame. `measured` is its depth, where it is to be used.
    pub(crate) fn new(
        map: &Map,
        keyframes: &Keyframes,
        view: &View,
        measured: Option<&[f32]>,
        rasterizer: &mut Rasterizer,
    ) -> Result<Self> {
        let camera = view.camera();
        let (full_width, full_height) = (camera.width(), camera.height());
        let width = full_width.min(WIDTH);
        let height = (full_height * width).div_ceil(full_width);
        let small = camera.with_intrinsics(camera.intrinsics().resized(width, height))?;
        let near = near_plane(&map.gaussians, camera);
        let settings = RenderSettings { near, depth: true, antialias: true, ..RenderSettings::default() };
        let rendering = rasterizer.render(&map.gaussians, &small, &settings)?;
        let rendered = rendering.depth.unwrap_or_default();
        let known = |i: usize| rendering.alpha[i] >= THIN && rendered[i] > 0.0;
        let (mut thin, mut all) = (0_usize, 0_usize);
        let mut depths = Vec::new();
        for (i, &rendered) in rendered.iter().enumerate() {
            let is_known = known(i);
            if is_known {
                depths.push(rendered);
            }
            let is_thin = match measured {
                None => !is_known,
                Some(measured) => {
                    let x = ((2 * (i % width) + 1) * full_width / (2 * width)).min(full_width - 1);
                    let y = ((2 * (i / width) + 1) * full_height / (2 * height)).min(full_height - 1);
                    let z = measured[y * full_width + x];
                    if z <= 0.0 {
                        continue;
                    }
                    !is_known || (rendered / z - 1.0).abs() > OTHER_DEPTH
                }
            };
            all += 1;
            thin += usize::from(is_thin);
        }
        depths.sort_unstable_by(f32::total_cmp);
        let masked: Vec<f32> =
            (0..width * height).map(|i| if known(i) { rendered[i] } else { 0.0 }).collect();
        let footprint = match measured {
            Some(measured) => Footprint::new(camera, measured),
            None => Footprint { camera: *camera, ..Footprint::new(&small, &masked) },
        };
        let typical = footprint.median().or_else(|| keyframes.footprints.last()?.median());
        let whole = footprint.clone().filled(typical.unwrap_or(1.0));
        let similar = keyframes.footprints.iter().map(|other| whole.similarity(other)).fold(0.0, f64::max);
        let covered = footprint.covered(&keyframes.footprints);
        let seen = Seen { thin: thin as f64 / all.max(1) as f64, covered, similar };
        Ok(Self { seen, footprint, depths })
    }

    /// Whether the frame tells enough that is new.
    pub(crate) fn is_keyframe(&self, depth: Depth) -> bool {
        let Seen { thin, covered, similar } = self.seen;
        let changed = depth == Depth::Measured && thin > CHANGED;
        changed || similar < SIMILAR && (thin > NEW || covered < COVERED)
    }
}

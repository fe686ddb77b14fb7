//! The CPU path: project, list per tile, order and blend each tile.

mod bin;
mod blend;
mod project;
mod sh;

use crate::{
    Gradients, PixelGradients, PoseGradient, RenderSettings, RenderStats, Rendering, Result, StageSeconds,
};
use gs_scene::{Camera, Gaussians, Image};
use std::time::Instant;

/// Side of a tile, pixels.
const TILE: usize = 16;

/// An image cut into tiles, row-major; the last column and row may reach over the edge.
#[derive(Debug, Clone, Copy)]
struct Grid {
    /// Image width, pixels.
    width: usize,
    /// Image height, pixels.
    height: usize,
    /// Tiles per row.
    columns: usize,
    /// Rows of tiles.
    rows: usize,
}

impl Grid {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }
}

/// Buffers that are kept from one frame to the next.
#[derive(Debug, Default)]
pub(crate) struct Scratch {}

/// What the backward pass needs of one view's forward pass.
#[derive(Debug)]
pub(crate) struct Tape {}

/// [`render`], and what [`backward`] needs of it.
pub(crate) fn record(
    _gaussians: &Gaussians,
    _camera: &Camera,
    _settings: &RenderSettings,
    _scratch: &mut Scratch,
) -> Result<(Rendering, Tape)> {
    todo!("next")
}

/// Adds this view's derivatives to `gradients` and returns those by its pose.
pub(crate) fn backward(
    _gaussians: &Gaussians,
    _camera: &Camera,
    _settings: &RenderSettings,
    _tape: &Tape,
    _pixels: &PixelGradients,
    _gradients: &mut Gradients,
    _scratch: &mut Scratch,
) -> Result<PoseGradient> {
    todo!("next")
}

pub(crate) fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    _scratch: &mut Scratch,
) -> Result<Rendering> {
    let (width, height) = (camera.width(), camera.height());
    let grid = Grid::new(width, height);
    let mut seconds = StageSeconds::default();

    let start = Instant::now();
    let projection = project::project(gaussians, camera, settings);
    seconds.project = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let bins = bin::Bins::new(&projection.splats, grid)?;
    seconds.bin = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let mut image = Image::filled(width, height, settings.background)?;
    let mut alpha = vec![0.0; width * height];
    let mut depth = vec![0.0; if settings.depth { width * height } else { 0 }];
    blend::blend(&projection.splats, &bins, grid, settings, image.data_mut(), &mut alpha, &mut depth);
    seconds.blend = start.elapsed().as_secs_f64();

    Ok(Rendering {
        image,
        alpha,
        depth: settings.depth.then_some(depth),
        stats: RenderStats {
            visible: projection.splats.len(),
            rejected: projection.rejected,
            intersections: bins.intersections(),
            seconds,
        },
    })
}

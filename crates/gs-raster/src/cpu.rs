//! The CPU path. Forward: project, order by depth, list per tile, blend each tile. Backward: blend each tile back to front,
//! sum over tiles, project back.

mod bin;
mod blend;
mod blend_backward;
mod ellipsoids;
mod footprint;
mod math;
mod order;
mod project;
mod project_backward;
mod sh;
mod shape;
mod span;

use crate::settings::{INTERSECTIONS_MAX, INTERSECTIONS_MAX_RECORDED};
use crate::{
    Error, Gradients, PixelGradients, PoseGradient, RenderSettings, RenderStats, Rendering, Result,
    StageSeconds, Style, TILE,
};
use gs_scene::{Camera, Gaussians, Image};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

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

    fn tiles(self) -> usize {
        self.columns * self.rows
    }
}

/// Buffers that are kept from one frame to the next, those of dropped tapes among them.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    free: Arc<Mutex<Vec<Frame>>>,
}

impl Scratch {
    fn take(&self) -> Frame {
        self.free.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }
}

/// Frames that are kept at most.
const FREE_MAX: usize = 8;

/// A scene in one view before it is blended.
#[derive(Debug, Default)]
struct Frame {
    splats: project::Splats,
    order: order::Order,
    bins: bin::Bins,
}

/// What the backward pass needs of one view's forward pass.
#[derive(Debug)]
pub(crate) struct Tape {
    frame: Frame,
    traces: Vec<blend::Trace>,
    home: Arc<Mutex<Vec<Frame>>>,
}

impl Drop for Tape {
    fn drop(&mut self) {
        let mut free = self.home.lock().unwrap_or_else(PoisonError::into_inner);
        if free.len() < FREE_MAX {
            free.push(std::mem::take(&mut self.frame));
        }
    }
}

/// Renders a view.
pub(crate) fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    scratch: &Scratch,
) -> Result<Rendering> {
    match settings.style {
        // A frame that is not recorded goes back as a tape does.
        Style::Blended => {
            let mut tape =
                Tape { frame: scratch.take(), traces: Vec::new(), home: Arc::clone(&scratch.free) };
            Ok(draw(gaussians, camera, settings, &mut tape.frame, false)?.0)
        }
        Style::Ellipsoids => ellipsoids::render(gaussians, camera, settings),
    }
}

/// [`render`], and what [`backward`] needs of it.
pub(crate) fn record(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    scratch: &Scratch,
) -> Result<(Rendering, Tape)> {
    let mut tape = Tape { frame: scratch.take(), traces: Vec::new(), home: Arc::clone(&scratch.free) };
    let (rendering, traces) = draw(gaussians, camera, settings, &mut tape.frame, true)?;
    tape.traces = traces;
    Ok((rendering, tape))
}

fn draw(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    frame: &mut Frame,
    record: bool,
) -> Result<(Rendering, Vec<blend::Trace>)> {
    let (width, height) = (camera.width(), camera.height());
    let grid = Grid::new(width, height);
    let mut seconds = StageSeconds::default();

    let start = Instant::now();
    frame.splats.project(gaussians, camera, settings, grid);
    seconds.project = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let (found, limit) =
        (frame.splats.intersections(), if record { INTERSECTIONS_MAX_RECORDED } else { INTERSECTIONS_MAX });
    if found > limit {
        return Err(Error::TooManyIntersections { found, limit });
    }
    frame.order.sort(&frame.splats);
    frame.bins.list(&frame.splats, frame.order.indices(), grid);
    seconds.bin = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let mut image = Image::filled(width, height, settings.background)?;
    let mut alpha = vec![0.0; width * height];
    let mut depth = vec![0.0; if settings.depth { width * height } else { 0 }];
    let lists = blend::Lists { splats: &frame.splats, bins: &frame.bins, grid };
    let traces = blend::blend(lists, settings, record, image.data_mut(), &mut alpha, &mut depth);
    seconds.blend = start.elapsed().as_secs_f64();

    let stats = RenderStats {
        visible: frame.splats.visible(),
        rejected: frame.splats.rejected(),
        intersections: frame.splats.intersections(),
        seconds,
    };
    Ok((Rendering { image, alpha, depth: settings.depth.then_some(depth), stats }, traces))
}

/// Adds this view's derivatives to `gradients`, which are of the scene that was recorded, and returns those by its pose.
pub(crate) fn backward(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    tape: &Tape,
    pixels: &PixelGradients,
    gradients: &mut Gradients,
) -> PoseGradient {
    let grid = Grid::new(camera.width(), camera.height());
    let lists = blend::Lists { splats: &tape.frame.splats, bins: &tape.frame.bins, grid };
    let order = tape.frame.order.indices();
    let summed = blend_backward::sum(lists, settings, &tape.traces, pixels, &mut gradients.background);
    project_backward::project_backward(gaussians, camera, settings, lists.splats, order, &summed, gradients)
}

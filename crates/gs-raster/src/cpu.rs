//! The CPU path. Forward: project, order by depth, list per tile, blend each tile. Backward: blend each tile back to front,
//! sum over tiles, project back.

mod bin;
mod blend;
mod blend_backward;
mod ellipsoids;
mod footprint;
mod local;
pub(crate) mod math;
mod order;
mod project;
mod project_backward;
mod sh;
mod shape;
mod span;
mod sums;
mod tile;
mod vector3;

use crate::settings::{INTERSECTIONS_MAX, INTERSECTIONS_MAX_RECORDED};
use crate::{
    Activated, CameraGradient, Error, PixelGradients, RenderSettings, RenderStats, Rendering, Result,
    StageSeconds, Style, TILE,
};
use cpu_kernels::Isa;
use gs_scene::{Camera, Gaussians, Image};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
pub(crate) use sums::Sums;

/// Where Gaussians are read.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a> {
    /// As they are stored.
    Stored(&'a Gaussians),
    /// Activated.
    Activated(&'a Activated<'a>),
}

impl<'a> Source<'a> {
    /// Number of Gaussians.
    pub(crate) fn len(self) -> usize {
        match self {
            Self::Stored(gaussians) => gaussians.len(),
            Self::Activated(gaussians) => gaussians.len(),
        }
    }

    pub(crate) fn is_activated(self) -> bool {
        matches!(self, Self::Activated(_))
    }

    /// SH degree of what is stored.
    pub(crate) fn sh_degree(self) -> usize {
        match self {
            Self::Stored(gaussians) => gaussians.sh_degree(),
            Self::Activated(gaussians) => gaussians.kind.degree(),
        }
    }

    /// What is stored, for passes that read nothing else.
    ///
    /// # Errors
    /// As [`Activated::store`].
    pub(crate) fn stored(self) -> Result<Cow<'a, Gaussians>> {
        match self {
            Self::Stored(gaussians) => Ok(Cow::Borrowed(gaussians)),
            Self::Activated(gaussians) => gaussians.store().map(Cow::Owned),
        }
    }
}

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

/// Buffers that are kept from one frame to the next, those of dropped tapes among them: fresh memory costs as much time as filling it.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    free: Arc<Mutex<Vec<Frame>>>,
    backward: [blend_backward::Buffers; AT_ONCE],
}

impl Scratch {
    fn take(&self) -> Frame {
        self.free.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }
}

/// Frames that are kept at most.
const FREE_MAX: usize = 8;
/// Views whose pixels are walked back at once: while threads wait for each other in one, they work in the other. More would take more memory.
const AT_ONCE: usize = 2;

/// A scene in one view.
#[derive(Debug, Default)]
struct Frame {
    splats: project::Splats,
    order: order::Order,
    bins: bin::Bins,
    /// Of every tile, if the view is recorded.
    traces: Vec<blend::Trace>,
}

/// What the backward pass needs of one view's forward pass.
#[derive(Debug)]
pub(crate) struct Tape {
    frame: Frame,
    home: Arc<Mutex<Vec<Frame>>>,
}

impl Drop for Tape {
    fn drop(&mut self) {
        // Not waited for: in the child of a fork nobody would unlock it.
        if let Ok(mut free) = self.home.try_lock()
            && free.len() < FREE_MAX
        {
            free.push(std::mem::take(&mut self.frame));
        }
    }
}

/// Renders a view.
pub(crate) fn render(
    source: Source<'_>,
    camera: &Camera,
    settings: &RenderSettings,
    scratch: &Scratch,
) -> Result<Rendering> {
    match settings.style {
        // A frame that is not recorded goes back as a tape does.
        Style::Blended => {
            let mut tape = Tape { frame: scratch.take(), home: Arc::clone(&scratch.free) };
            draw(source, camera, settings, &mut tape.frame, false, Isa::in_use())
        }
        Style::Ellipsoids => ellipsoids::render(source.stored()?.as_ref(), camera, settings, Isa::in_use()),
    }
}

/// [`render`], and what [`backward`] needs of it.
pub(crate) fn record(
    source: Source<'_>,
    camera: &Camera,
    settings: &RenderSettings,
    scratch: &Scratch,
) -> Result<(Rendering, Tape)> {
    let mut tape = Tape { frame: scratch.take(), home: Arc::clone(&scratch.free) };
    let rendering = draw(source, camera, settings, &mut tape.frame, true, Isa::in_use())?;
    Ok((rendering, tape))
}

fn draw(
    source: Source<'_>,
    camera: &Camera,
    settings: &RenderSettings,
    frame: &mut Frame,
    record: bool,
    isa: Isa,
) -> Result<Rendering> {
    let (width, height) = (camera.width(), camera.height());
    let grid = Grid::new(width, height);
    let mut seconds = StageSeconds::default();

    let start = Instant::now();
    frame.splats.project(source, camera, settings, grid, isa)?;
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
    // Every pixel is written, by all threads: the pages of fresh memory are not made by one alone.
    let mut image = Image::new(width, height, vec![0.0; width * height * 3])?;
    let mut alpha = vec![0.0; width * height];
    let mut depth = vec![0.0; if settings.depth { width * height } else { 0 }];
    let lists = blend::Lists { splats: &frame.splats, bins: &frame.bins, grid, isa };
    let planes = (image.data_mut(), &mut alpha[..], &mut depth[..]);
    blend::blend(lists, settings, record, planes, &mut frame.traces);
    seconds.blend = start.elapsed().as_secs_f64();

    let stats = RenderStats {
        visible: frame.splats.visible(),
        rejected: frame.splats.rejected(),
        intersections: frame.splats.intersections(),
        seconds,
    };
    Ok(Rendering { image, alpha, depth: settings.depth.then_some(depth), stats })
}

/// [`record`] of several views, side by side.
pub(crate) fn record_views(
    source: Source<'_>,
    cameras: &[Camera],
    settings: &RenderSettings,
    scratch: &Scratch,
) -> Result<(Vec<Rendering>, Vec<Tape>)> {
    let views: Vec<_> = cameras.par_iter().map(|camera| record(source, camera, settings, scratch)).collect();
    views.into_iter().collect()
}

/// What was recorded of a view, and the gradients by its pixels.
#[derive(Clone, Copy)]
pub(crate) struct Recorded<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) tape: &'a Tape,
    pub(crate) pixels: &'a PixelGradients<'a>,
    /// One number v per pixel, if shares of Gaussians are asked for.
    pub(crate) values: Option<&'a [f32]>,
}

impl Recorded<'_> {
    fn lists(&self, isa: Isa) -> blend::Lists<'_> {
        let Frame { splats, bins, .. } = &self.tape.frame;
        blend::Lists { splats, bins, grid: Grid::new(self.camera.width(), self.camera.height()), isa }
    }
}

/// Adds the derivatives of views by the Gaussians to `sums`, and (Σ w, Σ w v) of each Gaussian, w its share in a pixel, to `shares`, if
/// there are any; returns those by the background and by the cameras. `source` is the scene that was recorded.
pub(crate) fn backward(
    source: Source<'_>,
    settings: &RenderSettings,
    views: &[Recorded<'_>],
    sums: &mut Sums<'_>,
    mut shares: Option<&mut [[f32; 2]]>,
    (isa, scratch): (Isa, &mut Scratch),
) -> ([f64; 3], Vec<CameraGradient>) {
    let mut background = [0.0; 3];
    let mut cameras = Vec::with_capacity(views.len());
    for views in views.chunks(AT_ONCE) {
        let sum = |(view, buffers): (&Recorded<'_>, _)| {
            let pixels = (view.pixels, view.values);
            blend_backward::sum(view.lists(isa), settings, &view.tape.frame.traces, pixels, buffers)
        };
        let summed: Vec<_> = views.par_iter().zip(scratch.backward.par_iter_mut()).map(sum).collect();
        // Views in their order, whoever has summed them first.
        for (view, summed) in views.iter().zip(&summed) {
            let lists = (view.lists(isa), view.tape.frame.order.indices());
            let shares = shares.as_deref_mut();
            let by_camera = project_backward::project_backward(
                source,
                view.camera,
                settings,
                lists,
                summed,
                sums,
                shares,
            );
            cameras.push(by_camera);
            background.iter_mut().zip(summed.background).for_each(|(sum, value)| *sum += value);
        }
    }
    (background, cameras)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Intrinsics, sh_coefficients};

    /// Small, large, thin, transparent and opaque Gaussians around the view, and a camera whose picture ends within tiles.
    fn scene() -> (Gaussians, Camera) {
        let mut scene = Gaussians::empty(3).unwrap();
        for i in 0..400 {
            let number = |k: usize| ((i * 89 + k * 131 + i * i * k) % 997) as f32 / 997.0 - 0.5;
            let mean = [5.0 * number(1), 4.0 * number(2), 1.5 + i as f32 * 0.01];
            let quaternion = [0.3 + number(3), number(4), number(5), number(6)];
            let log_scale = [7, 8, 9].map(|k| 3.5 * number(k) - 3.0);
            let sh: Vec<f32> = (0..sh_coefficients(3) * 3).map(|k| number(11 + k)).collect();
            scene.push(mean, quaternion, log_scale, 8.0 * number(10), &sh);
        }
        let lens = Intrinsics { fx: 55.0, fy: 50.0, cx: 36.0, cy: 22.0, width: 70, height: 45 };
        (scene, Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap())
    }

    /// Everything that is computed of a view, by name.
    fn everything(isa: Isa, depth: bool) -> Vec<(&'static str, Vec<f32>)> {
        let (scene, camera) = scene();
        let settings = RenderSettings { depth, ..RenderSettings::default() };
        let mut scratch = Scratch::default();
        let mut tape = Tape { frame: scratch.take(), home: Arc::clone(&scratch.free) };
        let source = Source::Stored(&scene);
        let rendering = draw(source, &camera, &settings, &mut tape.frame, true, isa).unwrap();
        let unrecorded = draw(source, &camera, &settings, &mut scratch.take(), false, isa).unwrap();
        assert_eq!(rendering.image.data(), unrecorded.image.data(), "{isa}");
        assert_eq!(rendering.alpha, unrecorded.alpha, "{isa}");
        assert!(rendering.stats.visible > 200, "{}", rendering.stats.visible);
        let n = camera.width() * camera.height();
        let plane = |n: usize, k: usize| -> Vec<f32> {
            (0..n).map(|i| ((i * 7 + k) % 13) as f32 / 13.0 - 0.4).collect()
        };
        let pixels = PixelGradients {
            image: plane(3 * n, 1).into(),
            alpha: Some(plane(n, 2)),
            depth: depth.then(|| plane(n, 3)),
        };
        let (mut geometry, mut sh) = (vec![0.0; scene.geometry().len()], vec![0.0; scene.sh().len()]);
        let mut sums = Sums::Stored { geometry: &mut geometry, sh: &mut sh };
        let (values, mut shares): (Vec<f32>, _) = (plane(n, 4), vec![[0.0; 2]; scene.len()]);
        let view = Recorded { camera: &camera, tape: &tape, pixels: &pixels, values: Some(&values) };
        let with = (isa, &mut scratch);
        let (_, poses) = backward(source, &settings, &[view], &mut sums, Some(&mut shares), with);
        let pose = [poses[0].rotation.to_cols_array().as_slice(), &poses[0].translation.to_array()].concat();
        vec![
            ("image", rendering.image.data().to_vec()),
            ("alpha", rendering.alpha),
            ("depth", rendering.depth.unwrap_or_default()),
            ("gradients by geometry", geometry),
            ("gradients by colours", sh),
            ("shares", shares.into_flattened()),
            ("gradients by the pose", pose.into_iter().map(|value| value as f32).collect()),
        ]
    }

    #[test]
    fn instruction_sets_agree_within_rounding() {
        for depth in [false, true] {
            let expected = everything(Isa::Scalar, depth);
            for isa in Isa::available() {
                for ((what, expected), (_, found)) in expected.iter().zip(everything(isa, depth)) {
                    let size = expected.iter().fold(0f32, |size, value| size.max(value.abs()));
                    assert!(size > 0.0 || (*what == "depth" && !depth), "{what}");
                    for (i, (expected, found)) in expected.iter().zip(&found).enumerate() {
                        let error = (found - expected).abs();
                        assert!(
                            error <= 2e-5 * size,
                            "{isa}, {what} {i}: {found} {expected}, largest {size}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn ellipsoids_are_the_same_on_every_instruction_set_within_rounding() {
        let (scene, camera) = scene();
        let settings = RenderSettings { style: Style::Ellipsoids, ..RenderSettings::default() };
        let rendering = |isa| ellipsoids::render(&scene, &camera, &settings, isa).unwrap();
        let expected = rendering(Isa::Scalar);
        assert!(expected.image.data().iter().any(|value| *value > 0.1));
        for isa in Isa::available() {
            for (found, expected) in rendering(isa).image.data().iter().zip(expected.image.data()) {
                assert!((found - expected).abs() < 1e-5, "{isa}: {found} {expected}");
            }
        }
    }
}

//! One view on the GPU: project, sort by depth, list by tile, composite.

use super::context::{GRID_MAX, Gpu};
use super::frame::frame;
use super::passes::Keyed;
use super::pool::{Pooled, Use};
use super::upload::Upload;
use crate::{Error, RenderSettings, RenderStats, Rendering, Result, StageSeconds, Style};
use gs_scene::{Camera, Gaussians, Image};
use gs_shaders::{
    Features, Frame, N_COUNTERS, N_PAIRS, NOWHERE, PAIR_GRADS, PIXEL_GRADS, REJECTED, Splat, Surface, TILE,
    VISIBLE, WORKGROUP,
};
use std::time::Instant;

/// Bits of a depth key: the sign is never set, but by what is culled.
const DEPTH_BITS: u32 = 32;

/// What the backward pass needs of views on the GPU.
#[derive(Debug)]
pub(crate) struct Tape {
    pub(super) upload: Upload,
    pub(super) views: Vec<ViewTape>,
}

/// What the backward pass needs of one view.
#[derive(Debug)]
pub(super) struct ViewTape {
    pub(super) buffers: Buffers,
    pub(super) n_pairs: u32,
    /// Transmittance `[h, w]`.
    pub(super) transmittance: Vec<f32>,
    /// Expected depth and Σ w `[h, w]`, if depth was rendered.
    pub(super) depth: Option<[Vec<f32>; 2]>,
}

/// What the passes of one view read and write.
#[derive(Debug)]
pub(super) struct Buffers {
    pub(super) frame: Frame,
    pub(super) features: Features,
    /// Whether ellipsoids are drawn.
    pub(super) solid: bool,
    pub(super) uniform: Pooled,
    pub(super) splats: Pooled,
    pub(super) surfaces: Pooled,
    pub(super) counters: Pooled,
    /// Gaussians by depth; once sorted, the visible ones first.
    pub(super) depths: Keyed,
    pub(super) offsets: Pooled,
    pub(super) pair_splats: Pooled,
    /// Pairs of Gaussian and tile by tile.
    pub(super) pairs: Keyed,
    pub(super) ranges: Pooled,
    pub(super) pixels: Pooled,
    pub(super) ends: Pooled,
}

impl Gpu {
    pub(crate) fn render(
        &mut self,
        gaussians: &Gaussians,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<Vec<Rendering>> {
        let upload = self.upload(gaussians)?;
        cameras.iter().map(|camera| Ok(self.view(&upload, camera, settings, false)?.0)).collect()
    }

    pub(crate) fn record(
        &mut self,
        gaussians: &Gaussians,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<(Vec<Rendering>, Tape)> {
        let upload = self.upload(gaussians)?;
        let (mut renderings, mut views) = (Vec::new(), Vec::new());
        for camera in cameras {
            let (rendering, view) = self.view(&upload, camera, settings, true)?;
            renderings.push(rendering);
            views.extend(view);
        }
        Ok((renderings, Tape { upload, views }))
    }

    /// Renders a view, and keeps what its backward pass needs if it is to have one.
    fn view(
        &mut self,
        upload: &Upload,
        camera: &Camera,
        settings: &RenderSettings,
        train: bool,
    ) -> Result<(Rendering, Option<ViewTape>)> {
        let (found, limit) = (camera.width().max(camera.height()), (GRID_MAX * TILE) as usize);
        if found > limit {
            return Err(Error::ImageTooLongForGpu { found, limit });
        }
        let n_pixels = camera.width() * camera.height();
        self.check_size("pixels", (n_pixels * numbers_per_pixel(settings) * size_of::<f32>()) as u64)?;
        if train {
            self.check_size("pixel gradients", (n_pixels * PIXEL_GRADS * size_of::<f32>()) as u64)?;
        }
        let per_pair = if train { PAIR_GRADS } else { 1 } * size_of::<f32>();
        let most =
            (self.about.largest_binding / per_pair as u64).min(crate::settings::INTERSECTIONS_MAX) as u32;
        let mut capacity = self.pair_capacity.max(upload.n.saturating_mul(4)).max(WORKGROUP).min(most);
        loop {
            let (rendering, tape) = self.try_view(upload, camera, settings, train, capacity)?;
            let found = rendering.stats.intersections;
            if found > u64::from(most) {
                return Err(Error::TooManyIntersections { found, limit: u64::from(most) });
            }
            // A quarter more, so that the next view need not be done twice as well.
            self.pair_capacity = (found + found / 4).min(u64::from(most)) as u32;
            if found <= u64::from(capacity) {
                return Ok((rendering, tape));
            }
            capacity = self.pair_capacity;
        }
    }

    /// As [`Gpu::view`], with room for so many pairs; if there are more, the picture lacks some and the statistics say so.
    fn try_view(
        &mut self,
        upload: &Upload,
        camera: &Camera,
        settings: &RenderSettings,
        train: bool,
        capacity: u32,
    ) -> Result<(Rendering, Option<ViewTape>)> {
        let start = Instant::now();
        let mut view = self.buffers(upload, camera, settings, train, capacity);
        let mut recording = self.recording();
        recording.encoder.clear_buffer(&view.counters, 0, None);
        self.project(&mut recording, upload, &view);
        self.sort(&mut recording, &mut view.depths, DEPTH_BITS, &view.counters, NOWHERE);
        self.bin(&mut recording, &view);
        // Tiles are numbered from 0; the number after the last marks a pair that is none.
        let tile_bits = u32::BITS - (view.frame.tiles[0] * view.frame.tiles[1]).leading_zeros();
        self.sort(&mut recording, &mut view.pairs, tile_bits, &view.counters, N_PAIRS);
        self.tile_ranges(&mut recording, &view);
        if view.solid {
            self.rasterize_ellipsoids(&mut recording, &view);
        } else {
            self.rasterize_forward(&mut recording, &view, train);
        }
        let staged = [&view.counters, &view.pixels].map(|buffer| self.stage(&mut recording, buffer));
        self.submit(recording)?;
        let counters: Vec<u32> = self.read(&staged[0])?;
        let pixels: Vec<f32> = self.read(&staged[1])?;

        let (mut rendering, transmittance, weight) = picture(camera, settings, &counters, &pixels)?;
        rendering.stats.seconds.gpu = start.elapsed().as_secs_f64();
        let tape = train.then(|| ViewTape {
            buffers: view,
            n_pairs: counters[N_PAIRS as usize],
            transmittance,
            depth: rendering.depth.clone().zip(weight).map(|(depth, weight)| [depth, weight]),
        });
        Ok((rendering, tape))
    }

    fn buffers(
        &self,
        upload: &Upload,
        camera: &Camera,
        settings: &RenderSettings,
        train: bool,
        capacity: u32,
    ) -> Buffers {
        let frame = frame(camera, settings, upload.n, capacity);
        let n_pixels = camera.width() * camera.height();
        let n_tiles = (frame.tiles[0] * frame.tiles[1]) as usize;
        let solid = settings.style == Style::Ellipsoids;
        // What a pass binds as an array of structs must have room for one, even if the scene is empty.
        let at_least_one = upload.n.max(1) as usize;
        let room = |bytes: usize| self.pool.take(Use::Storage, bytes as u64);
        let numbers = |n: usize| room(n * size_of::<f32>());
        Buffers {
            frame,
            features: upload.features(settings.antialias, settings.depth),
            solid,
            uniform: self.pool.uniform(&frame),
            splats: room(at_least_one * size_of::<Splat>()),
            surfaces: room(if solid { at_least_one * size_of::<Surface>() } else { 0 }),
            counters: numbers(N_COUNTERS),
            depths: self.keyed(upload.n),
            offsets: numbers(upload.n as usize + 1),
            pair_splats: numbers(capacity as usize),
            pairs: self.keyed(capacity),
            ranges: numbers(n_tiles * 2),
            pixels: numbers(n_pixels * numbers_per_pixel(settings)),
            ends: numbers(if train { n_pixels } else { 0 }),
        }
    }
}

/// Numbers per pixel that are read back.
fn numbers_per_pixel(settings: &RenderSettings) -> usize {
    if settings.depth || settings.style == Style::Ellipsoids { 6 } else { 4 }
}

/// What was read back as a rendering, its transmittance, and Σ w if depth was rendered.
fn picture(
    camera: &Camera,
    settings: &RenderSettings,
    counters: &[u32],
    pixels: &[f32],
) -> Result<(Rendering, Vec<f32>, Option<Vec<f32>>)> {
    let (width, height) = (camera.width(), camera.height());
    let n = width * height;
    let (colours, depths) = pixels.split_at(4 * n);
    let rgb = colours.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
    let transmittance: Vec<f32> = colours.chunks_exact(4).map(|pixel| pixel[3]).collect();
    let (depth, weight) = if settings.depth {
        let (weights, sums) = depths.split_at(n);
        let depth = weights.iter().zip(sums).map(|(&w, &sum)| if w > 0.0 { sum / w } else { 0.0 }).collect();
        (Some(depth), Some(weights.to_vec()))
    } else {
        (None, None)
    };
    let rendering = Rendering {
        image: Image::new(width, height, rgb)?,
        alpha: transmittance.iter().map(|t| 1.0 - t).collect(),
        depth,
        stats: RenderStats {
            visible: counters[VISIBLE as usize] as usize,
            rejected: counters[REJECTED as usize] as usize,
            intersections: u64::from(counters[N_PAIRS as usize]),
            seconds: StageSeconds::default(),
        },
    };
    Ok((rendering, transmittance, weight))
}

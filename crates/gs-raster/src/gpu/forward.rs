//! One view on the GPU: project, sort by depth, list by tile, composite.

use super::context::Gpu;
use super::frame::frame;
use super::pool::{Pooled, Use};
use super::upload::Upload;
use crate::{Error, RenderSettings, RenderStats, Rendering, Result, StageSeconds, Style};
use gs_scene::{Camera, Gaussians, Image};
use gs_shaders::{
    Counts, Drawing, Features, Frame, GRID_MAX, N_PAIRS, PAIR_GRADS, PIXEL_GRADS, REJECTED, Source, TILE,
    VISIBLE, View, WORKGROUP,
};
use rayon::prelude::*;
use std::collections::HashMap;
use std::time::Instant;

/// Buffers that the backward pass reads.
const OF_TAPE: [&str; 8] =
    ["frame", "splats", "order", "offsets", "pair_splats", "pair_index", "ranges", "ends"];

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
    /// By the names of the view.
    named: HashMap<&'static str, Pooled>,
}

impl Buffers {
    /// The buffer of that name.
    pub(super) fn get(&self, name: &str) -> &Pooled {
        self.named.get(name).unwrap_or_else(|| panic!("a view lists its buffer {name}"))
    }

    /// The buffers of these names alone.
    fn keeping(mut self, names: &[&str]) -> Self {
        self.named.retain(|name, _| names.contains(name));
        self
    }

    /// Exchanges the names of two buffers.
    pub(super) fn swap(&mut self, a: &'static str, b: &'static str) {
        let (old_a, old_b) = (self.named.remove(a), self.named.remove(b));
        self.named.extend(old_a.map(|buffer| (b, buffer)).into_iter().chain(old_b.map(|buffer| (a, buffer))));
    }
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
        let (view, counts) = plan(upload, camera, settings, train, capacity);
        let mut buffers = self.buffers(upload, camera, settings, &view, &counts);
        let mut recording = self.recording();
        self.carry_out(&mut recording, &view, &counts, upload, &mut buffers);
        let staged = ["counters", "pixels"].map(|name| self.stage(&mut recording, buffers.get(name)));
        self.submit(recording)?;
        let counters: Vec<u32> = self.read(&staged[0])?;
        let found = self.read_with(&staged[1], |pixels| picture(camera, settings, &counters, pixels))?;
        let (mut rendering, transmittance, weight) = found?;
        rendering.stats.seconds.gpu = start.elapsed().as_secs_f64();
        let tape = train.then(|| ViewTape {
            buffers: buffers.keeping(&OF_TAPE),
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
        view: &View,
        counts: &Counts,
    ) -> Buffers {
        let frame = frame(camera, settings, upload.n, counts.pairs);
        let named = view.buffers.iter().filter_map(|buffer| match buffer.source {
            Source::Frame => Some((buffer.name, self.pool.uniform(&frame))),
            Source::Scene => None,
            Source::Passes => Some((buffer.name, self.pool.take(Use::Storage, buffer.bytes(counts)))),
        });
        Buffers { frame, features: view.features, named: named.collect() }
    }
}

/// What a view does, and how much of it.
fn plan(
    upload: &Upload,
    camera: &Camera,
    settings: &RenderSettings,
    train: bool,
    capacity: u32,
) -> (View, Counts) {
    let drawing = match (settings.style, train) {
        (Style::Ellipsoids, _) => Drawing::Ellipsoids,
        (Style::Blended, true) => Drawing::Recorded,
        (Style::Blended, false) => Drawing::Blended,
    };
    let (width, height) = (camera.width() as u32, camera.height() as u32);
    let counts = Counts {
        gaussians: upload.n,
        pairs: capacity,
        pixels: width * height,
        tiles: width.div_ceil(TILE) * height.div_ceil(TILE),
    };
    (View::new(upload.features(settings.antialias, settings.depth), drawing), counts)
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
    pixels: &[u8],
) -> Result<(Rendering, Vec<f32>, Option<Vec<f32>>)> {
    let (width, height) = (camera.width(), camera.height());
    let n = width * height;
    let (colours, depths) = pixels.split_at(n * size_of::<[f32; 4]>());
    let mut rgb = vec![0.0; 3 * n];
    let mut transmittance = vec![0.0; n];
    let rows = rgb.par_chunks_mut(3 * width).zip(transmittance.par_chunks_mut(width));
    rows.zip(colours.par_chunks(width * size_of::<[f32; 4]>())).for_each(|((rgb, transmittance), row)| {
        let pixels = rgb.as_chunks_mut().0.iter_mut().zip(transmittance);
        for ((rgb, transmittance), pixel) in pixels.zip(row.chunks_exact(size_of::<[f32; 4]>())) {
            let [r, g, b, t]: [f32; 4] = bytemuck::pod_read_unaligned(pixel);
            (*rgb, *transmittance) = ([r, g, b], t);
        }
    });
    let depths: Vec<f32> = bytemuck::pod_collect_to_vec(depths);
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

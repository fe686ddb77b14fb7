//! One view on the GPU: project, sort by depth, list by tile, composite.

use super::context::{GRID_MAX, Gpu, Recording, folded};
use super::frame::frame;
use super::pool::{Pooled, Use};
use super::upload::Upload;
use crate::{Error, RenderSettings, RenderStats, Rendering, Result, StageSeconds, Style};
use gs_scene::{Camera, Gaussians, Image};
use gs_shaders::{
    BIN, Frame, N_COUNTERS, N_PAIRS, NOWHERE, PAIR_GRADS, PROJECT, RASTERIZE_ELLIPSOIDS, RASTERIZE_FORWARD,
    REJECTED, Splat, Surface, TILE, TILE_RANGES, VISIBLE, WORKGROUP,
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
    pub(super) frame: Frame,
    pub(super) splats: Pooled,
    pub(super) order: Pooled,
    pub(super) offsets: Pooled,
    pub(super) pair_splats: Pooled,
    pub(super) pair_index: Pooled,
    pub(super) ranges: Pooled,
    pub(super) ends: Pooled,
    pub(super) n_pairs: u32,
    /// Transmittance `[h, w]`.
    pub(super) transmittance: Vec<f32>,
    /// Expected depth and Σ w `[h, w]`, if depth was rendered.
    pub(super) depth: Option<[Vec<f32>; 2]>,
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
        let per_pair = if train { PAIR_GRADS } else { 1 } * size_of::<f32>();
        let most =
            self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size) / per_pair as u64;
        let most = most.min(crate::settings::INTERSECTIONS_MAX) as u32;
        self.pair_capacity = self.pair_capacity.max(4 * upload.n).max(WORKGROUP).min(most);
        loop {
            let capacity = self.pair_capacity;
            let (rendering, tape) = self.try_view(upload, camera, settings, train, capacity)?;
            let found = rendering.stats.intersections;
            if found <= u64::from(capacity) {
                return Ok((rendering, tape));
            }
            if found > u64::from(most) {
                return Err(Error::TooManyIntersections { found, limit: u64::from(most) });
            }
            // A quarter more, so that the next view need not be done twice as well.
            self.pair_capacity = (found + found / 4).min(u64::from(most)) as u32;
        }
    }

    fn try_view(
        &mut self,
        upload: &Upload,
        camera: &Camera,
        settings: &RenderSettings,
        train: bool,
        capacity: u32,
    ) -> Result<(Rendering, Option<ViewTape>)> {
        let start = Instant::now();
        let frame = frame(camera, settings, upload.n, capacity);
        let n_pixels = camera.width() * camera.height();
        let n_tiles = frame.tiles[0] * frame.tiles[1];
        let features = upload.features(settings.antialias, settings.depth);
        let storage = |numbers: usize| self.pool.take(Use::Storage, (numbers * size_of::<f32>()) as u64);

        let uniform = self.pool.uniform(&frame);
        // What a pass binds as an array of structs must have room for one, even if the scene is empty.
        let at_least_one = u64::from(upload.n.max(1));
        let splats = self.pool.take(Use::Storage, at_least_one * size_of::<Splat>() as u64);
        let counters = storage(N_COUNTERS);
        let offsets = storage(upload.n as usize + 1);
        let ranges = storage(n_tiles as usize * 2);
        let pixels = storage(n_pixels * numbers_per_pixel(settings));
        let ends = storage(if train { n_pixels } else { 1 });
        let solid = settings.style == Style::Ellipsoids;
        let surfaces =
            self.pool.take(Use::Storage, at_least_one * size_of::<Surface>() as u64 * u64::from(solid));
        let pair_splats = storage(capacity as usize);
        let mut depths = self.keyed(upload.n);
        let mut pairs = self.keyed(capacity);

        let mut recording = self.recording();
        recording.encoder.clear_buffer(&counters, 0, None);
        recording.encoder.clear_buffer(&ranges, 0, None);
        self.dispatch(
            &mut recording,
            &PROJECT,
            if solid { "project_ellipsoids" } else { "project" },
            features,
            folded(upload.n.div_ceil(WORKGROUP)),
            &[
                Some(&uniform),
                Some(&upload.geometry),
                Some(&upload.sh),
                Some(&splats),
                Some(&depths.keys),
                Some(&depths.values),
                Some(&counters),
                Some(&surfaces),
            ],
        );
        self.sort(&mut recording, &mut depths, DEPTH_BITS, &counters, NOWHERE);
        let (order, spare) = depths.into_values();
        recording.keep.extend(spare);
        self.bin(
            &mut recording,
            &uniform,
            upload.n,
            [&splats, &order, &counters, &offsets, &pair_splats],
            &pairs,
        );
        // Tiles are numbered from 0; the number after the last marks a pair that is none.
        self.sort(&mut recording, &mut pairs, u32::BITS - n_tiles.leading_zeros(), &counters, N_PAIRS);
        self.dispatch(
            &mut recording,
            &TILE_RANGES,
            "tile_ranges",
            features,
            folded(capacity.div_ceil(WORKGROUP)),
            &[Some(&uniform), Some(&counters), Some(&pairs.keys), Some(&ranges)],
        );
        let (pair_index, spare) = pairs.into_values();
        recording.keep.extend(spare);
        if solid {
            self.dispatch(
                &mut recording,
                &RASTERIZE_ELLIPSOIDS,
                "rasterize_ellipsoids",
                features,
                frame.tiles,
                &[
                    Some(&uniform),
                    Some(&splats),
                    Some(&pair_splats),
                    Some(&pair_index),
                    Some(&ranges),
                    Some(&surfaces),
                    Some(&pixels),
                ],
            );
        } else {
            self.dispatch(
                &mut recording,
                &RASTERIZE_FORWARD,
                if train { "rasterize_forward_train" } else { "rasterize_forward" },
                features,
                frame.tiles,
                &[
                    Some(&uniform),
                    Some(&splats),
                    Some(&pair_splats),
                    Some(&pair_index),
                    Some(&ranges),
                    Some(&pixels),
                    Some(&ends),
                ],
            );
        }
        let staged = [&counters, &pixels].map(|buffer| self.stage(&mut recording, buffer));
        self.submit(recording)?;
        let counters: Vec<u32> = self.read(&staged[0])?;
        let pixels: Vec<f32> = self.read(&staged[1])?;

        let n_pairs = counters[N_PAIRS as usize];
        let (mut rendering, transmittance, weight) = picture(camera, settings, &counters, &pixels)?;
        rendering.stats.seconds.gpu = start.elapsed().as_secs_f64();
        let tape = train.then(|| ViewTape {
            frame,
            splats,
            order,
            offsets,
            pair_splats,
            pair_index,
            ranges,
            ends,
            n_pairs,
            transmittance,
            depth: rendering.depth.clone().zip(weight).map(|(depth, weight)| [depth, weight]),
        });
        Ok((rendering, tape))
    }

    /// Lists the tiles that each Gaussian touches, near to far.
    fn bin(
        &mut self,
        recording: &mut Recording,
        uniform: &Pooled,
        n: u32,
        [splats, order, counters, offsets, pair_splats]: [&Pooled; 5],
        pairs: &super::sort::Keyed,
    ) {
        let buffers = [
            Some(uniform),
            Some(splats),
            Some(order),
            Some(counters),
            Some(offsets),
            Some(&pairs.keys),
            Some(&pairs.values),
            Some(pair_splats),
        ];
        let groups = folded((n + 1).div_ceil(WORKGROUP));
        let features = super::sort::NO_FEATURES;
        self.dispatch(recording, &BIN, "bin_count", features, groups, &buffers);
        self.scan(recording, offsets, n + 1, counters, N_PAIRS);
        self.dispatch(recording, &BIN, "bin_emit", features, groups, &buffers);
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

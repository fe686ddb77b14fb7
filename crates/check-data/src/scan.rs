//! One pass over all files of a data set: every picture and every depth file is decoded, a few at a time, and
//! only what later steps need is kept.

use super::features::Features;
use super::grey::Grey;
use super::report::Thumbnail;
use super::{CheckSettings, CheckStage, CheckStep};
use glam::DVec2;
use gs_scene::Intrinsics;
use image::codecs::jpeg::JpegEncoder;
use image::{ImageBuffer, Rgb};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::hash::Hasher;
use std::sync::atomic::{AtomicUsize, Ordering};
use view_data::{Dataset, Error, Frame, Lens, Result};

/// What is kept of a frame.
#[derive(Debug)]
pub(crate) struct Scan {
    /// The lens at the size of the picture.
    pub(crate) lens: Lens,
    /// Mean luma, 0..1.
    pub(crate) brightness: f64,
    /// Variance of the Laplacian.
    pub(crate) sharpness: f64,
    /// Length and hash of the encoded picture.
    pub(crate) digest: (usize, u64),
    /// Corners, of frames that are matched.
    pub(crate) features: Option<Features>,
    /// Picture pixels per pixel that corners are found on.
    pub(crate) step: usize,
    pub(crate) thumbnail: Option<Thumbnail>,
    /// Measured depth.
    pub(crate) depth: Option<Result<DepthScan>>,
}

/// What is kept of a depth file.
#[derive(Debug)]
pub(crate) struct DepthScan {
    /// Share of pixels with a measurement.
    pub(crate) coverage: f64,
    /// Some measured depths, scene units, increasing.
    pub(crate) samples: Vec<f32>,
    /// The depth at fewer pixels, of frames that are matched.
    pub(crate) map: Option<SmallDepth>,
}

/// Measured depth at some pixels of a picture: 0 = none.
#[derive(Debug, Clone)]
pub(crate) struct SmallDepth {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
    /// Picture pixels per pixel of the map, by axis.
    pub(crate) step: DVec2,
}

impl SmallDepth {
    /// The depth nearest to a position in the picture; `None` outside, and where nothing was measured.
    pub(crate) fn at(&self, pixel: DVec2) -> Option<f64> {
        let p = pixel / self.step;
        let inside = p.x >= 0.0 && p.y >= 0.0 && p.x < self.width as f64 && p.y < self.height as f64;
        let depth = inside.then(|| self.data[p.y as usize * self.width + p.x as usize])?;
        (depth > 0.0).then_some(f64::from(depth))
    }
}

/// Sides of pictures up to which corners are found at full size.
const MATCHED_SIDE: usize = 960;
/// Longest side of a depth map that is kept.
const DEPTH_SIDE: usize = 400;
/// Depths that are kept of a map for percentiles.
const DEPTH_SAMPLES: usize = 200;
const THUMBNAIL_SIDE: u32 = 240;
const THUMBNAIL_QUALITY: u8 = 80;
/// What the pictures that are decoded at one time may take together, bytes.
const BUDGET: usize = 1 << 30;
/// What one takes per pixel at its peak: f32 RGB, 8-bit RGB, depth, the decoder's own copy.
const BYTES_PER_PIXEL: usize = 36;

/// Which frames are looked at more closely.
pub(crate) struct Wanted {
    pub(crate) matched: BTreeSet<usize>,
    pub(crate) shown: BTreeSet<usize>,
}

/// Sizes of all pictures, from their headers.
pub(crate) fn read_sizes(
    dataset: &Dataset,
    on_step: &(impl Fn(CheckStep) + Sync),
) -> Vec<Result<(usize, usize)>> {
    let done = Counter::new(CheckStage::Headers, dataset.frames.len(), on_step);
    let read = |frame: &Frame| {
        let read = frame.picture_size();
        done.advance();
        read
    };
    dataset.frames.par_iter().map(read).collect()
}

/// Decodes everything.
pub(crate) fn scan_frames(
    dataset: &Dataset,
    sizes: &[Result<(usize, usize)>],
    wanted: &Wanted,
    settings: &CheckSettings,
    on_step: &(impl Fn(CheckStep) + Sync),
) -> Vec<Result<Scan>> {
    let largest = sizes.iter().flatten().map(|(width, height)| width.saturating_mul(*height)).max();
    let at_once = (BUDGET / largest.unwrap_or(1).saturating_mul(BYTES_PER_PIXEL).max(1)).max(1);
    let done = Counter::new(CheckStage::Pictures, dataset.frames.len(), on_step);
    let positions: Vec<usize> = (0..dataset.frames.len()).collect();
    let mut scans = Vec::with_capacity(positions.len());
    for batch in positions.chunks(at_once) {
        let read = |&position: &usize| {
            let read = scan(&dataset.frames[position], position, wanted, settings);
            done.advance();
            read
        };
        scans.par_extend(batch.par_iter().map(read));
    }
    scans
}

fn scan(frame: &Frame, position: usize, wanted: &Wanted, settings: &CheckSettings) -> Result<Scan> {
    let digest = digest(&frame.picture_bytes()?);
    let image = frame.picture()?;
    let (width, height) = (image.width(), image.height());
    let lens = frame.lens.at_size(width, height).ok_or_else(|| Error::Aspect {
        path: frame.image.path().to_path_buf(),
        width,
        height,
        stated_width: frame.lens.intrinsics.width,
        stated_height: frame.lens.intrinsics.height,
    })?;
    let rgb = image.to_rgb8();
    drop(image);
    let step = width.max(height).div_ceil(MATCHED_SIDE);
    let grey = Grey::of_rgb8(width, height, &rgb, step);
    let is_matched = wanted.matched.contains(&position);
    let depth = scan_depth(frame, (width, height), lens.intrinsics, is_matched).transpose();
    let thumbnail = wanted.shown.contains(&position).then(|| thumbnail(position, width, height, rgb));
    Ok(Scan {
        lens,
        brightness: grey.mean(),
        sharpness: grey.sharpness(),
        digest,
        features: is_matched.then(|| Features::new(grey, settings.corners)),
        step,
        thumbnail: thumbnail.flatten(),
        depth,
    })
}

/// The depth of a frame whose picture has `size` pixels in its file, if there is any.
fn scan_depth(
    frame: &Frame,
    size: (usize, usize),
    picture: Intrinsics,
    keep: bool,
) -> Result<Option<DepthScan>> {
    let scale = (DEPTH_SIDE as f64 / picture.width.max(picture.height) as f64).min(1.0);
    let side = |side: usize| ((side as f64 * scale).round() as usize).max(1);
    let (width, height) = (side(picture.width), side(picture.height));
    let step = DVec2::new(picture.width as f64 / width as f64, picture.height as f64 / height as f64);
    let measured = frame.measured_depth(size, picture.resized(width, height), |position| position * step);
    let Some(map) = measured.transpose()? else { return Ok(None) };
    let data = map.data();
    let mut samples: Vec<f32> = data.iter().copied().filter(|&depth| depth > 0.0).collect();
    let stride = samples.len().div_ceil(DEPTH_SAMPLES).max(1);
    samples = samples.into_iter().step_by(stride).collect();
    samples.sort_unstable_by(f32::total_cmp);
    let map_of = |data: &[f32]| SmallDepth { width, height, data: data.to_vec(), step };
    Ok(Some(DepthScan { coverage: map.coverage(), samples, map: keep.then(|| map_of(data)) }))
}

/// Equal files have equal digests; different ones have, once in 2^64.
fn digest(bytes: &[u8]) -> (usize, u64) {
    let mut hasher = std::hash::DefaultHasher::new();
    hasher.write(bytes);
    (bytes.len(), hasher.finish())
}

fn thumbnail(frame: usize, width: usize, height: usize, rgb: Vec<u8>) -> Option<Thumbnail> {
    let picture = ImageBuffer::<Rgb<u8>, _>::from_raw(width as u32, height as u32, rgb)?;
    let scale = (f64::from(THUMBNAIL_SIDE) / width.max(height) as f64).min(1.0);
    let side = |side: usize| ((side as f64 * scale).round() as u32).max(1);
    let small = image::imageops::thumbnail(&picture, side(width), side(height));
    let mut jpeg = Vec::new();
    // A picture of at most 240 pixels a side is one that every encoder takes.
    JpegEncoder::new_with_quality(&mut jpeg, THUMBNAIL_QUALITY).encode_image(&small).ok()?;
    Some(Thumbnail { frame, jpeg, width: small.width(), height: small.height() })
}

/// Counts what is done, on any thread.
pub(crate) struct Counter<'a, F: Fn(CheckStep) + Sync> {
    stage: CheckStage,
    of: usize,
    done: AtomicUsize,
    on_step: &'a F,
}

impl<'a, F: Fn(CheckStep) + Sync> Counter<'a, F> {
    pub(crate) fn new(stage: CheckStage, total: usize, on_step: &'a F) -> Self {
        Self { stage, of: total, done: AtomicUsize::new(0), on_step }
    }

    pub(crate) fn advance(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        (self.on_step)(CheckStep { stage: self.stage, done, of: self.of });
    }
}

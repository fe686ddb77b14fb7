//! Figures of a map: while it grows, and at the end.

use super::Latency;
use super::source::Source;
use crate::failure::{OrFail, Outcome};
use crate::progress::Progress;
use evaluate::{Lpips, render_view};
use gs_raster::Rasterizer;
use gs_scene::{Gaussians, View};
use mapper::{Depth, Mapper, Outcome as Of, Update};
use report_parts::Picture;
use serde::{Deserialize, Serialize};
use sparsesplat::{Backbone, Budget, Predictor};
use std::path::Path;
use std::time::Instant;

/// A picture of every so many-th frame.
const PICTURES: usize = 15;
/// Opacity from which on a depth of the map counts.
const OPAQUE: f32 = 0.5;

/// What is remembered of a frame.
#[derive(Debug)]
pub(super) struct Row {
    pub(super) frame: usize,
    pub(super) seconds: f64,
    pub(super) gaussians: usize,
    pub(super) bytes: usize,
    pub(super) rss_bytes: Option<u64>,
    pub(super) is_keyframe: bool,
    pub(super) is_waiting: bool,
    pub(super) is_refused: bool,
}

impl Row {
    pub(super) fn new(update: &Update, rss_bytes: Option<u64>) -> Self {
        Self {
            frame: update.frame,
            seconds: update.seconds,
            gaussians: update.gaussians,
            bytes: update.bytes,
            rss_bytes,
            is_keyframe: matches!(update.outcome, Of::Keyframe(_)),
            is_waiting: matches!(update.outcome, Of::Waiting(_)),
            is_refused: matches!(update.outcome, Of::Refused(_)),
        }
    }
}

/// Memory of this process now, where the system says.
pub(super) fn rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok()? * 1024)
}

/// PSNR of the map's rendering in a view, dB.
pub(super) fn psnr(map: &Gaussians, view: &View, rasterizer: &mut Rasterizer) -> Outcome<f64> {
    let rendered = render_view(rasterizer, map, view.camera()).or_work()?;
    image_metrics::psnr(&rendered.image, view.image()).or_work()
}

/// Median and worst latency of keyframes and of the other frames.
pub(super) fn latency(rows: &[Row]) -> Latency {
    let latencies = |keyframes: bool| {
        let chosen = rows.iter().filter(|row| row.is_keyframe == keyframes && !row.is_waiting);
        let mut seconds: Vec<f64> = chosen.map(|row| row.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let value = |i: usize| seconds.get(i).copied().unwrap_or(0.0);
        (value(seconds.len() / 2), value(seconds.len().saturating_sub(1)))
    };
    let ((keyframe_median, keyframe_worst), (other_median, other_worst)) =
        (latencies(true), latencies(false));
    Latency { keyframe_median, keyframe_worst, other_median, other_worst }
}

/// What is to be measured.
pub(super) struct Asked<'a> {
    pub(super) batch: bool,
    pub(super) pictures: Option<&'a Path>,
    pub(super) lpips: Option<&'a Lpips>,
}

/// Figures of the map in the frames.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Measured {
    pub(crate) mapped: Means,
    pub(crate) between: Means,
    batch: Option<Batch>,
    /// The network of LPIPS, if it was measured.
    pub(crate) lpips_network: Option<String>,
}

/// Means over some frames.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Means {
    pub(crate) frames: usize,
    pub(crate) psnr: f64,
    pub(crate) ssim: f64,
    pub(crate) lpips: Option<f64>,
    /// Mean absolute difference of depth where both are known, scene units.
    pub(crate) depth_l1: Option<f64>,
}

/// The reconstruction from all keyframes at once, with as many Gaussians.
#[derive(Debug, Serialize, Deserialize)]
struct Batch {
    head: String,
    gaussians: usize,
    seconds: f64,
    mapped: Means,
    between: Means,
}

/// Sums over frames.
#[derive(Debug, Default)]
struct Sums {
    frames: usize,
    psnr: f64,
    ssim: f64,
    lpips: f64,
    depth: (f64, usize),
}

impl Sums {
    fn add(
        &mut self,
        view: &View,
        map: &Gaussians,
        lpips: Option<&Lpips>,
        rasterizer: &mut Rasterizer,
    ) -> Outcome<gs_scene::Image> {
        let rendered = render_view(rasterizer, map, view.camera()).or_work()?;
        self.frames += 1;
        self.psnr += image_metrics::psnr(&rendered.image, view.image()).or_work()?;
        self.ssim += image_metrics::ssim(&rendered.image, view.image()).or_work()?;
        if let Some(lpips) = lpips {
            self.lpips += lpips.distance(&rendered.image, view.image()).or_work()?;
        }
        if let Some(depth) = view.depth() {
            for ((z, rendered), alpha) in depth.data().iter().zip(&rendered.depth).zip(&rendered.alpha) {
                if *z > 0.0 && *alpha >= OPAQUE {
                    self.depth.0 += f64::from((z - rendered).abs());
                    self.depth.1 += 1;
                }
            }
        }
        Ok(rendered.image)
    }

    fn means(&self, has_lpips: bool) -> Means {
        let n = self.frames.max(1) as f64;
        Means {
            frames: self.frames,
            psnr: self.psnr / n,
            ssim: self.ssim / n,
            lpips: has_lpips.then_some(self.lpips / n),
            depth_l1: (self.depth.1 > 0).then(|| self.depth.0 / self.depth.1 as f64),
        }
    }
}

/// Measures the map in all frames that were not refused, and the batch reconstruction beside if it is asked for.
pub(super) fn measure(
    source: &Source,
    mapper: &Mapper,
    rows: &[Row],
    asked: &Asked<'_>,
    progress: &Progress,
) -> Outcome<Measured> {
    let mut rasterizer = Rasterizer::cpu();
    let batch = asked.batch.then(|| batch(source, mapper, rows, progress)).transpose()?;
    let mut sums: [[Sums; 2]; 2] = Default::default();
    for row in rows.iter().filter(|row| !row.is_refused) {
        progress.say(format!("measuring frame {}", row.frame + 1));
        let Some(view) = source.again(row.frame)? else { continue };
        let [of_map, of_batch] = &mut sums;
        let kind = usize::from(!row.is_keyframe);
        let image = of_map[kind].add(&view, mapper.map(), asked.lpips, &mut rasterizer)?;
        if let Some((gaussians, ..)) = &batch {
            of_batch[kind].add(&view, gaussians, asked.lpips, &mut rasterizer)?;
        }
        if let Some(folder) = asked.pictures.filter(|_| row.frame % PICTURES == 0) {
            for (what, image) in [("frame", view.image()), ("map", &image)] {
                Picture::of_image(image)
                    .save(&folder.join(format!("{:05}-{what}.png", row.frame)))
                    .or_work()?;
            }
        }
    }
    let [[mapped, between], [batch_mapped, batch_between]] =
        sums.map(|pair| pair.map(|sums| sums.means(asked.lpips.is_some())));
    let batch = batch.map(|(gaussians, head, seconds)| Batch {
        head,
        gaussians: gaussians.len(),
        seconds,
        mapped: batch_mapped,
        between: batch_between,
    });
    let lpips_network = asked.lpips.map(|lpips| lpips.network().name().to_owned());
    Ok(Measured { mapped, between, batch, lpips_network })
}

/// The reconstruction from all keyframes at once, its head, and its seconds.
fn batch(
    source: &Source,
    mapper: &Mapper,
    rows: &[Row],
    progress: &Progress,
) -> Outcome<(Gaussians, String, f64)> {
    progress.say("reconstructing the keyframes at once");
    let mut views = Vec::new();
    for row in rows.iter().filter(|row| row.is_keyframe) {
        views.extend(source.again(row.frame)?);
    }
    let backbone = match mapper.config().depth {
        Depth::Measured => Backbone::GivenDepth,
        Depth::Stereo => Backbone::default(),
    };
    let config = sparsesplat::Config {
        backbone,
        budget: Budget::Gaussians(mapper.map().len()),
        seed: mapper.config().seed,
        ..sparsesplat::Config::default()
    };
    let begin = Instant::now();
    let prediction = Predictor::new(config).and_then(|p| p.predict(&views, &mut |_| {})).or_work()?;
    Ok((prediction.gaussians, prediction.head, begin.elapsed().as_secs_f64()))
}

impl Means {
    fn line(&self, what: &str) -> String {
        if self.frames == 0 {
            return format!("{what:<10} no frames");
        }
        let lpips = self.lpips.map_or_else(String::new, |lpips| format!(", LPIPS {lpips:.3}"));
        let depth = self.depth_l1.map_or_else(String::new, |l1| format!(", depth L1 {l1:.4}"));
        format!(
            "{what:<10} {} frames: PSNR {:.2} dB, SSIM {:.3}{lpips}{depth}",
            self.frames, self.psnr, self.ssim
        )
    }
}

impl Measured {
    /// The lines of the summary.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.mapped.line("mapped"), self.between.line("between")];
        if let Some(batch) = &self.batch {
            lines.push(format!(
                "batch      {} Gaussians by {} in {:.1} s",
                report_parts::count(batch.gaussians as f64),
                batch.head,
                batch.seconds
            ));
            lines.push(batch.mapped.line("  mapped"));
            lines.push(batch.between.line("  between"));
        }
        lines
    }
}

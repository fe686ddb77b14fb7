//! Rows of `bench raster`: what was measured, and what follows from it.

use super::job::{Job, Runner};
use crate::bench::measure::{Measured, Spread};
use crate::bench::row::{self, Label};
use gs_raster::{RenderStats, TILE};
use gs_scene::{Camera, Gaussians, sh_coefficients};
use report_parts::{Table, count};
use serde::Serialize;

/// How [`Details::bytes`] and [`Details::pixel_pairs`] are counted, in words.
pub(super) const MODEL: &str = "bytes: the least that must move: stored numbers of every Gaussian read once, 40 bytes written \
and read for each visible one, 4 bytes written and read for each pair of Gaussian and tile, 16 bytes written for each pixel \
(20 with depth); the backward pass reads all this again, reads the pixel gradients and writes a gradient for every stored \
number. Gaussian-pixel pairs: pairs of Gaussian and tile times the pixels of a tile, once for each pass over the pixels; \
pixels that are done early skip some.";

/// Position, shape, opacity, colour and depth of a footprint in f32.
const FOOTPRINT: u64 = 40;
/// A number of 32 bits.
const NUMBER: u64 = 4;

/// A row of this bench.
pub(super) type Row = row::Row<Details>;

/// What it says beyond the rows of other benches.
#[derive(Debug, Serialize)]
pub(super) struct Details {
    /// What the GPU itself took for the forward pass: without bringing the scene there, without gradients.
    gpu_seconds: Option<f64>,
    /// `cpu`, or the name of the adapter.
    device: String,
    sh_degree: usize,
    width: usize,
    height: usize,
    frames_per_second: f64,
    visible: usize,
    intersections: u64,
    bytes: u64,
    bytes_per_second: f64,
    pixel_pairs: u64,
    pixel_pairs_per_second: f64,
    /// Of a feature: median over that of the plain row; else none.
    times_plain: Option<f64>,
}

/// The row of a job; `plain` is the median of the row that its price is compared with.
pub(super) fn row(
    job: &Job<'_>,
    runner: &Runner<'_>,
    camera: &Camera,
    found: &Measured<RenderStats>,
    plain: Option<f64>,
) -> Row {
    // What is drawn is the same in every run.
    let stats = found.found[0];
    let seconds = found.seconds.median;
    let gpu = Spread::of(found.found.iter().map(|stats| stats.seconds.gpu).collect()).median;
    let passes = if job.case.gradients { 2 } else { 1 };
    let pixel_pairs = stats.intersections * (TILE * TILE) as u64 * passes;
    let bytes = bytes(job, camera, &stats);
    let label = Label {
        implementation: "ours",
        case: job.case.name.to_owned(),
        n: job.scene.len(),
        k: None,
        threads: runner.pool.current_num_threads(),
    };
    let details = Details {
        gpu_seconds: Some(gpu).filter(|seconds| *seconds > 0.0),
        device: runner.device.clone(),
        sh_degree: job.case.sh_degree,
        width: camera.width(),
        height: camera.height(),
        frames_per_second: 1.0 / seconds,
        visible: stats.visible,
        intersections: stats.intersections,
        bytes,
        bytes_per_second: bytes as f64 / seconds,
        pixel_pairs,
        pixel_pairs_per_second: pixel_pairs as f64 / seconds,
        times_plain: plain.map(|plain| seconds / plain),
    };
    Row::new("raster", label, found, details)
}

/// Bytes that must move; see [`MODEL`].
fn bytes(job: &Job<'_>, camera: &Camera, stats: &RenderStats) -> u64 {
    let numbers = Gaussians::GEOMETRY + sh_coefficients(job.case.sh_degree) * 3;
    let scene = (job.scene.len() * numbers) as u64 * NUMBER;
    let pixels = (camera.width() * camera.height()) as u64;
    let outputs = pixels * NUMBER * if job.case.settings().depth { 5 } else { 4 };
    let (footprints, pairs) = (stats.visible as u64 * FOOTPRINT, stats.intersections * NUMBER);
    let forward = scene + 2 * (footprints + pairs) + outputs;
    // Pixel gradients are those by the three colours.
    let backward = scene + footprints + pairs + outputs + pixels * 3 * NUMBER + scene;
    if job.case.gradients { forward + backward } else { forward }
}

/// The rows for people.
pub(super) fn table(rows: &[Row]) -> Table {
    let head = [
        "case",
        "device",
        "threads",
        "Gaussians",
        "visible",
        "tile pairs",
        "ms",
        "fastest",
        "slowest",
        "on GPU",
        "frames/s",
        "Gpairs/s at most",
        "GB/s",
        "peak GB",
        "price",
    ];
    let mut table = Table::new(&head, 2);
    for row in rows {
        let [median, fastest, slowest] = row.milliseconds();
        let details = &row.details;
        table.push(vec![
            row.case.clone(),
            details.device.clone(),
            row.threads.to_string(),
            count(row.n as f64),
            count(details.visible as f64),
            count(details.intersections as f64),
            median,
            fastest,
            slowest,
            details.gpu_seconds.map_or(String::new(), |seconds| format!("{:.2}", seconds * 1e3)),
            format!("{:.1}", details.frames_per_second),
            format!("{:.2}", details.pixel_pairs_per_second / 1e9),
            format!("{:.2}", details.bytes_per_second / 1e9),
            row.memory(1e9),
            details.times_plain.map_or(String::new(), |times| format!("{:+.0} %", (times - 1.0) * 100.0)),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::job::Case;
    use super::*;
    use gs_scene::Intrinsics;

    #[test]
    fn bytes_follow_the_model() {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 5.0, cy: 5.0, width: 10, height: 10 };
        let camera = Camera::new(lens, glam::DMat3::IDENTITY, glam::DVec3::ZERO).unwrap();
        let scene = Gaussians::new(0, vec![0.0; 22], vec![0.0; 6]).unwrap();
        let case = Case { name: "forward", sh_degree: 0, change: |_| {}, gradients: false };
        let stats = RenderStats { visible: 1, intersections: 3, ..RenderStats::default() };
        let traffic = |case| bytes(&Job { runner: 0, case, scene: &scene }, &camera, &stats);
        let forward = 2 * 14 * 4 + 2 * (40 + 3 * 4) + 100 * 16;
        assert_eq!(traffic(case), forward);
        assert_eq!(traffic(Case { change: |settings| settings.depth = true, ..case }), forward + 100 * 4);
        let backward = 2 * 14 * 4 + (40 + 3 * 4) + 100 * 16 + 100 * 12 + 2 * 14 * 4;
        assert_eq!(traffic(Case { gradients: true, ..case }), forward + backward);
    }
}

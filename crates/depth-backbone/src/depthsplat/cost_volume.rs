//! Candidates of inverse depth, and how well the views agree on each.

use super::kernels::{Correlation, Maps, Pairing};
use super::layers::{tensor, values};
use super::taps::{Layout, Taps};
use candle_core::{Device, Result, Tensor};
use glam::{DMat3, DVec3};
use gs_scene::Camera;

/// Candidates of the first scale; each further one has a quarter.
const CANDIDATES: usize = 128;
/// Other views that a view is compared with, if there are more than [`ALL_UP_TO`].
const NEIGHBOURS: usize = 2;
/// Up to this many views each is compared with all others.
const ALL_UP_TO: usize = 3;

/// Number of candidates of a scale.
pub(super) fn candidates(scale: usize) -> usize {
    CANDIDATES >> (2 * scale)
}

/// The views that each view is compared with: all others, or the two whose cameras stand nearest, nearest first.
pub(super) fn neighbours(cameras: &[Camera]) -> Vec<Vec<usize>> {
    let neighbourhood = |i: usize| {
        let mut others: Vec<usize> = (0..cameras.len()).filter(|&j| j != i).collect();
        if cameras.len() > ALL_UP_TO {
            let distance = |j: usize| cameras[i].position().distance(cameras[j].position());
            others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
            others.truncate(NEIGHBOURS);
        }
        others
    };
    (0..cameras.len()).map(neighbourhood).collect()
}

/// Inverse depths between which each view's lie: 1 / far and 1 / near.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) low: f32,
    pub(super) high: f32,
}

/// Evenly spaced candidates over the whole range, far to near, `[views, 1, 1, count]`.
pub(super) fn uniform_candidates(bounds: &[Bounds]) -> Result<Tensor> {
    let count = candidates(0);
    let value = |b: &Bounds, k: usize| b.low + k as f32 / (count - 1) as f32 * (b.high - b.low);
    let all = bounds.iter().flat_map(|b| (0..count).map(move |k| value(b, k))).collect();
    tensor(all, (bounds.len(), 1, 1, count))
}

/// Candidates around a coarser estimate `[views, h, w, 1]` (on the CPU), `[views, h, w, count]`: half as far apart as those of
/// the scale before. Each end stays within the bounds, so that they lie closer there.
pub(super) fn refined_candidates(coarse: &Tensor, bounds: &[Bounds], scale: usize) -> Result<Tensor> {
    let (views, height, width, _) = coarse.dims4()?;
    let count = candidates(scale);
    let mut all = Vec::with_capacity(views * height * width * count);
    let coarse = values(coarse)?;
    for (coarse, b) in coarse.chunks_exact(height * width).zip(bounds) {
        let step = (b.high - b.low) / (CANDIDATES - 1) as f32 / (1 << scale) as f32;
        for z in coarse {
            let first = (z - step * (count / 2) as f32).max(b.low);
            let last = (z + step * (count / 2 - 1) as f32).min(b.high);
            all.extend((0..count).map(|k| first + k as f32 / (count - 1) as f32 * (last - first)));
        }
    }
    tensor(all, (views, height, width, count))
}

/// Where the pixels of view `i` lie in view `j`, on maps `factor` times smaller than the images. Both cameras have the
/// lens of view `i`, and pixel (x, y) of a map lies at (x, y), not in the middle of the pixel: so the network was trained.
fn pairing(cameras: &[Camera], i: usize, j: usize, factor: usize) -> Pairing {
    let lens = cameras[i].intrinsics();
    let scale = 1.0 / factor as f64;
    let k = DMat3::from_cols(
        DVec3::new(lens.fx * scale, 0.0, 0.0),
        DVec3::new(0.0, lens.fy * scale, 0.0),
        DVec3::new(lens.cx * scale, lens.cy * scale, 1.0),
    );
    let rotation = cameras[j].rotation() * cameras[i].rotation().transpose();
    let translation = cameras[j].translation() - rotation * cameras[i].translation();
    let turned = (k * rotation * k.inverse()).transpose();
    Pairing { other: j, turned: turned.to_cols_array_2d(), moved: (k * translation).to_array() }
}

/// The cost volume `[views, h, w, candidates]` of features `[views, h, w, channels]`.
pub(super) fn cost_volume(
    features: &Tensor,
    cameras: &[Camera],
    neighbours: &[Vec<usize>],
    candidates: &Tensor,
    (factor, scale): (usize, usize),
    taps: &mut Taps,
) -> Result<Tensor> {
    let (views, height, width, channels) = features.dims4()?;
    let (_, _, _, count) = candidates.dims4()?;
    let pairings: Vec<Vec<Pairing>> = neighbours
        .iter()
        .enumerate()
        .map(|(i, others)| others.iter().map(|&j| pairing(cameras, i, j, factor)).collect())
        .collect();
    // There is little arithmetic in it: on any device it is done here.
    let features = features.to_device(&Device::Cpu)?;
    let (features, candidates) = (values(&features)?, values(candidates)?);
    let maps = Maps { values: &features, height, width, channels };
    let correlation = Correlation { features: maps, pairings: &pairings, candidates: &candidates, count };
    if taps.wanted() {
        note_warp(&correlation, scale, taps)?;
    }
    tensor(correlation.volume(), (views, height, width, count))
}

/// Notes sample positions (in -1..1 over the map) and warped features of the first view and its first neighbour.
fn note_warp(correlation: &Correlation<'_>, scale: usize, taps: &mut Taps) -> Result<()> {
    let Maps { height, width, channels, .. } = correlation.features;
    let pairing = correlation.pairings[0][0];
    let (mut grid, mut features) = (Vec::new(), Vec::new());
    for k in 0..correlation.count {
        for pixel in 0..height * width {
            let candidate = correlation.candidates_of(0, pixel)[k];
            let [u, v] = pairing.position(pixel % width, pixel / width, candidate);
            grid.push((2.0 * u / (width - 1) as f64 - 1.0) as f32);
            grid.push((2.0 * v / (height - 1) as f64 - 1.0) as f32);
            features.extend(correlation.warped(pairing.other, [u, v]));
        }
    }
    let shape = (correlation.count, height, width, 2);
    taps.note(format!("warp.s{scale}.grid0"), Layout::Plain, &tensor(grid, shape)?)?;
    let shape = (correlation.count, height, width, channels);
    taps.map(format!("warp.s{scale}.pair0"), &tensor(features, shape)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;
    use gs_scene::Intrinsics;

    fn cameras(count: usize) -> Vec<Camera> {
        let lens = Intrinsics { fx: 90.0, fy: 95.0, cx: 40.0, cy: 31.0, width: 80, height: 64 };
        let up = DVec3::new(0.0, -1.0, 0.0);
        (0..count)
            .map(|i| {
                let position = DVec3::new(0.7 * i as f64, 0.1 * (i * i) as f64, -0.05 * i as f64);
                Camera::looking_at(lens, position, DVec3::new(0.5, 0.0, 6.0), up).unwrap()
            })
            .collect()
    }

    #[test]
    fn pixels_of_a_pairing_are_where_the_point_is_seen() {
        let cameras = cameras(3);
        let pairing = pairing(&cameras, 2, 0, 1);
        for (x, y, depth) in [(3, 50, 4.0), (70, 2, 9.0), (40, 31, 2.5)] {
            let point = cameras[2].unproject(DVec2::new(x as f64, y as f64), depth);
            let expected = cameras[0].project(point).unwrap();
            let found = DVec2::from_array(pairing.position(x, y, 1.0 / depth as f32));
            assert!((found - expected).length() < 1e-3, "{found} and {expected}");
        }
    }

    #[test]
    fn neighbours_are_the_nearest() {
        assert_eq!(neighbours(&cameras(2)), [vec![1], vec![0]]);
        assert_eq!(neighbours(&cameras(3))[2], [0, 1]);
        assert_eq!(neighbours(&cameras(5))[0], [1, 2]);
        assert_eq!(neighbours(&cameras(5))[4], [3, 2]);
        // Cameras in one place: the first two others.
        assert_eq!(neighbours(&[cameras(1)[0]; 4])[1], [0, 2]);
    }

    #[test]
    fn candidates_stay_within_their_bounds() {
        let bounds = [Bounds { low: 0.005, high: 2.0 }, Bounds { low: 0.5, high: 1.0 }];
        let all: Vec<f32> = uniform_candidates(&bounds).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        assert_eq!((all[0], all[127], all[128], all[255]), (0.005, 2.0, 0.5, 1.0));
        let coarse = tensor(vec![0.01, 1.0, 0.75, 0.999], (2, 1, 2, 1)).unwrap();
        let fine = refined_candidates(&coarse, &bounds, 1).unwrap();
        let fine: Vec<Vec<f32>> = fine.reshape((4, 32)).unwrap().to_vec2().unwrap();
        let step = 1.995 / 127.0 / 2.0;
        assert!(fine[0][0] == 0.005 && (fine[0][31] - (0.01 + 15.0 * step)).abs() < 1e-6);
        assert!((fine[1][0] - (1.0 - 16.0 * step)).abs() < 1e-6 && (fine[1][16] - 1.0).abs() < 1e-6);
        assert!(fine[3][31] == 1.0 && fine[3][0] > 0.9);
    }
}

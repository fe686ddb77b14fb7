//! Normals by fitting planes to inverse depth.
//!
//! A plane m · X = 1 in camera axes, seen along the ray r = ((u - cx) / fx, (v - cy) / fy, 1) at X = z r, has
//! 1 / z = m · r: inverse depth is linear in the pixel position, with slopes m_x / fx and m_y / fy. A least-squares
//! fit of a + b du + c dv to inverse depth around a pixel therefore gives the plane without any bias from perspective:
//! m = (b fx, c fy, value of the fit at the principal point). m · r > 0, so that -m faces the camera.
//!
//! Fitted is z / z' - 1 = (z - z') / z', z being the pixel's own depth: the same plane in units of 1 / z. The
//! difference of two similar depths is exact in f32, so that f32 loses nothing that the depths have.

use crate::lift::Place;
use crate::views::check_geometry;
use crate::{Error, Result};
use cpu_kernels::{Isa, compiled_for};
use glam::DMat3;
use gs_scene::{Camera, Intrinsics};
use rayon::prelude::*;

/// How normals are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalFit {
    /// Width and height of the window, pixels; odd, 3 to 31.
    pub window: usize,
    /// Neighbours whose depth differs by more than this share of the pixel's own depth lie on another surface and take
    /// no part.
    pub max_relative_step: f32,
}

impl Default for NormalFit {
    /// 5×5 pixels, steps of at most 5 %.
    fn default() -> Self {
        Self { window: 5, max_relative_step: 0.05 }
    }
}

impl NormalFit {
    pub(crate) fn check(self) -> Result<()> {
        let Self { window, max_relative_step } = self;
        if window.is_multiple_of(2) || !(3..=WIDEST).contains(&window) {
            return Err(Error::WindowSize { found: window });
        }
        if max_relative_step.is_nan() || max_relative_step <= 0.0 {
            return Err(Error::RelativeStep { found: max_relative_step });
        }
        Ok(())
    }
}

/// Largest window: its moments are exact in f32, their products in f64.
const WIDEST: usize = 31;
/// Fewer pixels than this say too little about a plane.
const MIN_SUPPORT: f64 = 4.0;

/// Unit normals in world axes towards the camera, one per pixel `[height, width]` of a z-depth map of the same size, from
/// the surface around each pixel. Where too little surface is known (no depth, a thin or isolated thing), the normal
/// points back along the viewing ray. Depths as in [`crate::ViewPixels`]; errors call the view 0.
///
/// # Errors
/// If the depth does not fit the camera or a setting is out of range.
pub fn normals(depth: &[f32], camera: &Camera, fit: NormalFit) -> Result<Vec<[f32; 3]>> {
    fit.check()?;
    check_geometry(0, camera, depth)?;
    let (width, isa) = (camera.width(), Isa::in_use());
    let surface = Surface::new(camera, depth, fit);
    let mut out = vec![[0f32; 3]; depth.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let row: Vec<Place> = (0..width).map(|x| Place { x: x as u32, y: y as u32 }).collect();
        surface.normals(isa, &row, out);
    });
    Ok(out)
}

/// Pixels that are fitted together: lanes of a vector.
const LANES: usize = 8;
type Lanes = [f32; LANES];

/// A view's depth, and how planes are fitted to it.
pub(crate) struct Surface<'a> {
    depth: &'a [f32],
    lens: Intrinsics,
    /// Transposed rotation: exact for normals even if the rotation is not quite one.
    to_world: DMat3,
    fit: NormalFit,
}

/// Sums over a window's pixels that lie on the surface of its middle, per lane: their number, offsets (x, y) from the
/// middle, relative inverse depth e, and products. What counts pixels is a whole number, exact in f32.
#[derive(Default)]
struct Moments {
    n: Lanes,
    x: Lanes,
    y: Lanes,
    xx: Lanes,
    xy: Lanes,
    yy: Lanes,
    e: Lanes,
    xe: Lanes,
    ye: Lanes,
}

impl<'a> Surface<'a> {
    pub(crate) fn new(camera: &Camera, depth: &'a [f32], fit: NormalFit) -> Self {
        Self { depth, lens: *camera.intrinsics(), to_world: camera.rotation().transpose(), fit }
    }

    /// Normals at `places`, as [`normals`].
    pub(crate) fn normals(&self, isa: Isa, places: &[Place], out: &mut [[f32; 3]]) {
        compiled_for!(isa, normals_of(self, places, out));
    }

    /// `N` depths of row `y` from column `x` on; 0, no depth, outside the picture, where both may have wrapped to.
    #[inline(always)]
    fn depths<const N: usize>(&self, x: usize, y: usize) -> [f32; N] {
        let (width, height) = (self.lens.width, self.lens.height);
        let row = if y < height { &self.depth[y * width..][..width] } else { &[] };
        std::array::from_fn(|i| row.get(x.wrapping_add(i)).copied().unwrap_or(0.0))
    }

    /// The moments around (x, y) for z-depths `z` there. The window is `N` pixels wide; or any if `N` is 1.
    #[inline(always)]
    fn moments<const N: usize>(&self, x: &[usize; LANES], y: &[usize; LANES], z: &Lanes) -> Moments {
        let window = if N == 1 { self.fit.window } else { N };
        let radius = window / 2;
        // Without depth of its own a pixel has no surface; an infinite depth is on none.
        let largest_step =
            z.map(|z| if z > 0.0 { (self.fit.max_relative_step * z).min(f32::MAX) } else { -1.0 });
        let (width, height) = (self.lens.width, self.lens.height);
        let inside = |position: usize, size: usize| position >= radius && position + radius < size;
        let uncut = (0..LANES).all(|l| inside(x[l], width) && inside(y[l], height));
        let mut sums = Moments::default();
        for (row, column) in
            (0..window).flat_map(|row| (0..window).step_by(N).map(move |column| (row, column)))
        {
            let start = |l: usize| {
                (x[l].wrapping_add(column).wrapping_sub(radius), y[l].wrapping_add(row).wrapping_sub(radius))
            };
            let mut cut = [[0f32; N]; LANES];
            let mut taps = [&[0f32; N]; LANES];
            if uncut {
                for (l, taps) in taps.iter_mut().enumerate() {
                    let (x, y) = start(l);
                    *taps = self.depth[y * width + x..].first_chunk().expect("the window is inside");
                }
            } else {
                for (l, (taps, cut)) in taps.iter_mut().zip(&mut cut).enumerate() {
                    let (x, y) = start(l);
                    *cut = self.depths(x, y);
                    *taps = cut;
                }
            }
            let dy = row as f32 - radius as f32;
            // Sums over the row, without y.
            let [mut n, mut x, mut xx, mut e, mut xe] = [[0f32; LANES]; 5];
            for k in 0..N {
                let tap = taps.map(|taps| taps[k]);
                let dx = (column + k) as f32 - radius as f32;
                for l in 0..LANES {
                    let step = z[l] - tap[l];
                    let same = (tap[l] > 0.0) & (step.abs() <= largest_step[l]);
                    let one = if same { 1.0 } else { 0.0 };
                    let difference = if same { step / tap[l] } else { 0.0 };
                    n[l] += one;
                    x[l] += dx * one;
                    xx[l] += dx * dx * one;
                    e[l] += difference;
                    xe[l] += dx * difference;
                }
            }
            for l in 0..LANES {
                sums.n[l] += n[l];
                sums.x[l] += x[l];
                sums.y[l] += dy * n[l];
                sums.xx[l] += xx[l];
                sums.xy[l] += dy * x[l];
                sums.yy[l] += dy * dy * n[l];
                sums.e[l] += e[l];
                sums.xe[l] += xe[l];
                sums.ye[l] += dy * e[l];
            }
        }
        sums
    }
}

#[inline(always)]
fn normals_of(surface: &Surface, places: &[Place], out: &mut [[f32; 3]]) {
    for (places, out) in places.chunks(LANES).zip(out.chunks_mut(LANES)) {
        // The last group is filled up with its last place.
        let place = std::array::from_fn::<_, LANES, _>(|l| places[l.min(places.len() - 1)]);
        let (x, y) = (place.map(|place| place.x as usize), place.map(|place| place.y as usize));
        let z = std::array::from_fn(|l| surface.depth[y[l] * surface.lens.width + x[l]]);
        let sums = match surface.fit.window {
            5 => surface.moments::<5>(&x, &y, &z),
            _ => surface.moments::<1>(&x, &y, &z),
        };
        let mut normals = [[0f32; LANES]; 3];
        for l in 0..LANES {
            let [nx, ny, nz] = surface.normal(&sums, l, x[l] as f64 + 0.5, y[l] as f64 + 0.5);
            (normals[0][l], normals[1][l], normals[2][l]) = (nx, ny, nz);
        }
        for (l, out) in out.iter_mut().enumerate() {
            *out = normals.map(|component| component[l]);
        }
    }
}

impl Surface<'_> {
    /// The normal of one lane's plane, or back along the ray through (u, v) if its pixels are too few, lie in one line,
    /// or put the surface behind the camera. Without branches, so that all lanes are computed together.
    #[inline(always)]
    fn normal(&self, sums: &Moments, l: usize, u: f64, v: f64) -> [f32; 3] {
        let lens = &self.lens;
        let (rx, ry) = ((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy);
        let [n, x, y, xx, xy, yy] =
            [sums.n[l], sums.x[l], sums.y[l], sums.xx[l], sums.xy[l], sums.yy[l]].map(f64::from);
        let [e, xe, ye] = [sums.e[l], sums.xe[l], sums.ye[l]].map(f64::from);
        // n² times the covariances.
        let (cxx, cxy, cyy) = (n * xx - x * x, n * xy - x * y, n * yy - y * y);
        let (cx, cy) = (n * xe - x * e, n * ye - y * e);
        let determinant = cxx * cyy - cxy * cxy;
        let (dx, dy) = ((cyy * cx - cxy * cy) / determinant, (cxx * cy - cxy * cx) / determinant);
        let centre = 1.0 + (e - dx * x - dy * y) / n;
        let (mx, my) = (dx * lens.fx, dy * lens.fy);
        // The value at the principal point, where the ray is (0, 0, 1).
        let mz = centre - mx * rx - my * ry;
        let square = mx * mx + my * my + mz * mz;
        let fitted = (n >= MIN_SUPPORT)
            & (determinant > 0.0)
            & (centre > 0.0)
            & (square > 0.0)
            & (square < f64::INFINITY);
        let (mx, my, mz) = if fitted { (mx, my, mz) } else { (rx, ry, 1.0) };
        let [a, b, c] = [self.to_world.x_axis, self.to_world.y_axis, self.to_world.z_axis];
        let world =
            [a.x * mx + b.x * my + c.x * mz, a.y * mx + b.y * my + c.y * mz, a.z * mx + b.z * my + c.z * mz];
        let scale = -1.0 / (world[0] * world[0] + world[1] * world[1] + world[2] * world[2]).sqrt();
        world.map(|component| (component * scale) as f32)
    }
}

//! The decoder: the head's 38 outputs are bounded changes of the closed-form Gaussian, those of a corrector of the refined one. An untrained head, whose
//! outputs are 0, gives exactly what it starts from.
//!
//! | outputs | change | bound |
//! |---|---|---|
//! | 0 | opacity: added to the logit | 8 |
//! | 1..4 | scale: added to the logarithms | 3 |
//! | 4..8 | rotation: the Gaussian's own axes are turned by the quaternion (1, 0, 0, 0) + outputs | ½ for w, 1 |
//! | 8..35 | spherical harmonics of degree 2, `[coefficient][rgb]`, in the camera's axes: added | 2 |
//! | 35..38 | the mean is moved, in the camera's axes and in units of the anchor's spacing | 2 |
//!
//! With [`Parametrisation::Paper`](super::Parametrisation::Paper) the changes are those of a grey ball instead, the same for all anchors
//! ([`Decoder::of_grey_balls`]), and no mean is subtracted: the head gives all attributes itself.
//!
//! The paper states 38 outputs, but lists 1 + 3 + 4 + 27 = 35; it does not name the other three. An output x changes its attribute by b·tanh(x / b), with
//! b the bound: the slope is 1 at the start of training, and the change is finite for any output.
//!
//! The mean colour change over each view, weighted by the area that anchors cover there, is subtracted: the closed form already has the right mean
//! brightness of a photograph. Without this the default head made dark photographs darker and light ones lighter
//! (docs/journal/2026-11-training-runs.md).

use super::rotate_sh::RotateSh;
use crate::harmonics::{DEGREE, TERMS, basis};
use attn_head::OUTPUTS;
use cpu_kernels::{Activation, Isa};
use glam::{DQuat, DVec3};
use gs_scene::{Camera, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, sh_coefficients};
use rayon::prelude::*;
use std::ops::Range;

/// Numbers of SH of degree 2 per Gaussian.
const SH: usize = 3 * TERMS;
/// Anchors per parallel task.
const CHUNK: usize = 1024;

/// Outputs that change a colour by the direction from which it is seen: all but the constant harmonic.
pub const BY_DIRECTION: Range<usize> = 11..35;

/// Largest change by each output.
pub const BOUNDS: [f32; OUTPUTS] = {
    let mut bounds = [2.0; OUTPUTS];
    bounds[0] = 8.0;
    bounds[1] = 3.0;
    bounds[2] = 3.0;
    bounds[3] = 3.0;
    bounds[4] = 0.5;
    bounds[5] = 1.0;
    bounds[6] = 1.0;
    bounds[7] = 1.0;
    bounds
};

/// Outputs of the head to Gaussians, and back with derivatives.
#[derive(Debug, Clone)]
pub struct Decoder {
    /// Gaussians of SH degree 0 (the closed form) or 2 (of a refined scene), one per anchor.
    base: Gaussians,
    /// Width of the patch that each anchor stands for, scene units.
    spacing: Vec<f32>,
    /// View of each anchor.
    views: Vec<u32>,
    /// Per anchor what each coefficient of its colour, in the camera's axes, adds to the mean colour of its view, over that of the
    /// constant one: Y(d) / Y₀ times the share of the view's anchors' area that is its own, d the direction in which its view sees it.
    in_mean: Vec<[f32; TERMS]>,
    /// World-to-camera rotation of each view, row-major.
    rotations: Vec<[[f32; 3]; 3]>,
    rotate_sh: Vec<RotateSh>,
}

/// b·tanh(x / b) of the outputs x of all anchors.
fn bounded(outputs: &[f32]) -> Vec<f32> {
    let isa = Isa::in_use();
    let mut changes = vec![0.0; outputs.len()];
    let chunks = changes.par_chunks_mut(CHUNK * OUTPUTS).zip(outputs.par_chunks(CHUNK * OUTPUTS));
    chunks.for_each(|(changes, outputs)| {
        let rows = |changes: &mut [f32], f: fn(f32, f32) -> f32| {
            let rows = changes.chunks_exact_mut(OUTPUTS);
            rows.for_each(|row| row.iter_mut().zip(BOUNDS).for_each(|(x, bound)| *x = f(*x, bound)));
        };
        changes.copy_from_slice(outputs);
        rows(changes, |x, bound| x / bound);
        Activation::Tanh.apply(isa, changes);
        rows(changes, |x, bound| x * bound);
    });
    changes
}

/// Quaternion product, (w, x, y, z).
fn product(p: [f32; 4], q: [f32; 4]) -> [f32; 4] {
    [
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    ]
}

/// [`Decoder::in_mean`] of all anchors.
fn in_mean(base: &Gaussians, spacing: &[f32], views: &[u32], cameras: &[Camera]) -> Vec<[f32; TERMS]> {
    let seen = |i: usize| {
        let geometry = &base.geometry()[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
        let mean = DVec3::from(std::array::from_fn(|axis| f64::from(geometry[MEAN.start + axis])));
        cameras[views[i] as usize].to_camera(mean)
    };
    // From the camera's own place an anchor has no direction and covers nothing that could be told.
    let area = |i: usize| {
        let area = f64::from(spacing[i]).powi(2) / seen(i).length_squared();
        if area.is_finite() { area } else { 0.0 }
    };
    let anchor_areas: Vec<f64> = (0..views.len()).into_par_iter().map(area).collect();
    let mut areas = vec![0.0; cameras.len()];
    views.iter().zip(&anchor_areas).for_each(|(&view, area)| areas[view as usize] += area);
    let weights = |i: usize| {
        let share = anchor_areas[i] / areas[views[i] as usize];
        let basis = basis(seen(i).normalize_or_zero());
        basis.map(|value| if share > 0.0 { (share * value / basis[0]) as f32 } else { 0.0 })
    };
    (0..views.len()).into_par_iter().map(weights).collect()
}

impl Decoder {
    /// A decoder about Gaussians `base`, one per anchor: the closed form (SH degree 0), or those of a refined scene (degree 2). `spacing` and `views`
    /// per anchor, `cameras` per view.
    ///
    /// # Panics
    /// If lengths differ, a view does not exist or the degree is neither.
    #[must_use]
    pub fn new(base: Gaussians, spacing: Vec<f32>, views: Vec<u32>, cameras: &[Camera]) -> Self {
        assert!([0, DEGREE].contains(&base.sh_degree()), "SH degree of the closed form, or of a head");
        assert!(base.len() == spacing.len() && base.len() == views.len(), "one entry per anchor");
        assert!(views.iter().all(|&view| (view as usize) < cameras.len()), "views that exist");
        let rows = |camera: &Camera| {
            let columns = camera.rotation().as_mat3().to_cols_array_2d();
            std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row]))
        };
        let in_mean = in_mean(&base, &spacing, &views, cameras);
        Self {
            base,
            spacing,
            views,
            in_mean,
            rotations: cameras.iter().map(rows).collect(),
            rotate_sh: cameras.iter().map(|camera| RotateSh::new(camera.rotation())).collect(),
        }
    }

    /// A decoder about balls that know of their anchors only the place and the `spacing`: grey, of opacity ½, with the standard deviation of half the
    /// spacing and the axes of their view's camera. `positions`, `spacing` and `views` per anchor, `cameras` per view.
    ///
    /// # Panics
    /// If lengths differ or a view does not exist.
    #[must_use]
    pub fn of_grey_balls(
        positions: &[[f64; 3]],
        spacing: Vec<f32>,
        views: Vec<u32>,
        cameras: &[Camera],
    ) -> Self {
        assert!(positions.len() == spacing.len(), "one spacing per anchor");
        let axes: Vec<[f32; 4]> = cameras
            .iter()
            .map(|camera| {
                let q = DQuat::from_mat3(&camera.rotation().transpose()).normalize();
                [q.w, q.x, q.y, q.z].map(|v| v as f32)
            })
            .collect();
        let mut base = Gaussians::empty(0).expect("a degree that there is");
        for ((position, spacing), &view) in positions.iter().zip(&spacing).zip(&views) {
            // A spacing of 0 has no logarithm.
            let log_scale = (0.5 * spacing).max(f32::MIN_POSITIVE).ln();
            base.push(position.map(|v| v as f32), axes[view as usize], [log_scale; 3], 0.0, &[0.0; 3]);
        }
        let mut decoder = Self::new(base, spacing, views, cameras);
        decoder.in_mean.fill([0.0; TERMS]);
        decoder
    }

    /// Number of anchors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.base.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.base.is_empty()
    }

    /// The Gaussians that the change starts from.
    #[must_use]
    pub fn base(&self) -> &Gaussians {
        &self.base
    }

    /// Gaussians of SH degree 2 from the head's outputs `[n, 38]`, in the order of the anchors.
    ///
    /// # Panics
    /// If there is another number of outputs.
    #[must_use]
    pub fn decode(&self, outputs: &[f32]) -> Gaussians {
        assert_eq!(outputs.len(), self.len() * OUTPUTS, "outputs of the head");
        const WIDTH: usize = Gaussians::GEOMETRY;
        let changes = bounded(outputs);
        let means = self.mean_changes(&changes);
        let mut geometry = self.base.geometry().to_vec();
        let mut sh = vec![0.0; self.len() * SH];
        geometry
            .par_chunks_mut(CHUNK * WIDTH)
            .zip(sh.par_chunks_mut(CHUNK * SH))
            .zip(changes.par_chunks(CHUNK * OUTPUTS))
            .enumerate()
            .for_each(|(chunk, ((geometry, sh), changes))| {
                let rows = geometry.chunks_exact_mut(WIDTH).zip(sh.chunks_exact_mut(SH));
                let rows = rows.zip(changes.chunks_exact(OUTPUTS)).zip(chunk * CHUNK..);
                rows.for_each(|(((geometry, sh), change), anchor)| {
                    self.row(anchor, change, &means, geometry, sh);
                });
            });
        Gaussians::new(DEGREE, geometry, sh).expect("lengths as computed")
    }

    /// Mean change of colour of each view, as a constant coefficient `[rgb]`.
    fn mean_changes(&self, changes: &[f32]) -> Vec<[f32; 3]> {
        // Sums of chunks, added in their order: the same on any number of threads.
        let of_chunk = |(chunk, changes): (usize, &[f32])| {
            let mut sums = vec![[0.0; 3]; self.rotations.len()];
            for (change, anchor) in changes.chunks_exact(OUTPUTS).zip(chunk * CHUNK..) {
                let sum = &mut sums[self.views[anchor] as usize];
                for (rgb, weight) in change[8..35].chunks_exact(3).zip(self.in_mean[anchor]) {
                    (0..3).for_each(|c| sum[c] += f64::from(weight) * f64::from(rgb[c]));
                }
            }
            sums
        };
        let chunks: Vec<Vec<[f64; 3]>> =
            changes.par_chunks(CHUNK * OUTPUTS).enumerate().map(of_chunk).collect();
        let total = |view: usize, c: usize| chunks.iter().map(|sums| sums[view][c]).sum::<f64>() as f32;
        (0..self.rotations.len()).map(|view| std::array::from_fn(|c| total(view, c))).collect()
    }

    /// One anchor; `geometry` holds the closed form and receives the change, but for the `means` of the views.
    fn row(&self, anchor: usize, change: &[f32], means: &[[f32; 3]], geometry: &mut [f32], sh: &mut [f32]) {
        let view = self.views[anchor] as usize;
        geometry[OPACITY_LOGIT] += change[0];
        geometry[LOG_SCALE].iter_mut().zip(&change[1..4]).for_each(|(scale, change)| *scale += change);
        let turn = [1.0 + change[4], change[5], change[6], change[7]];
        let base: [f32; 4] = std::array::from_fn(|i| geometry[QUATERNION.start + i]);
        geometry[QUATERNION].copy_from_slice(&product(base, turn));
        let camera = self.rotations[view];
        for axis in 0..3 {
            let moved: f32 = (0..3).map(|row| camera[row][axis] * change[35 + row]).sum();
            geometry[MEAN.start + axis] += self.spacing[anchor] * moved;
        }
        let (sh, _) = sh.as_chunks_mut::<3>();
        let (change, _) = change[8..35].as_chunks::<3>();
        let (base, _) = self.base.sh().as_chunks::<3>();
        let terms = sh_coefficients(self.base.sh_degree());
        let base = &base[anchor * terms..][..terms];
        sh[0] = std::array::from_fn(|c| base[0][c] + change[0][c] - means[view][c]);
        self.rotate_sh[view].turn(&change[1..], &mut sh[1..]);
        for (sh, base) in sh.iter_mut().zip(base).skip(1) {
            (0..3).for_each(|c| sh[c] += base[c]);
        }
    }

    /// Derivatives of a loss by the head's outputs, `[n, 38]`, from those by the Gaussians that [`Decoder::decode`]
    /// made of them: `geometry` `[n, 11]`, `sh` `[n, 27]`.
    ///
    /// # Panics
    /// If lengths differ from that.
    #[must_use]
    pub fn backward(&self, outputs: &[f32], geometry: &[f32], sh: &[f32]) -> Vec<f32> {
        const WIDTH: usize = Gaussians::GEOMETRY;
        assert_eq!(outputs.len(), self.len() * OUTPUTS, "outputs of the head");
        assert_eq!((geometry.len(), sh.len()), (self.len() * WIDTH, self.len() * SH), "derivatives");
        let mut by_means = vec![[0.0; 3]; self.rotations.len()];
        for (sh, &view) in sh.chunks_exact(SH).zip(&self.views) {
            (0..3).for_each(|c| by_means[view as usize][c] -= f64::from(sh[c]));
        }
        let by_means: Vec<[f32; 3]> = by_means.iter().map(|by: &[f64; 3]| by.map(|by| by as f32)).collect();
        let changes = bounded(outputs);
        let mut by_outputs = vec![0.0; outputs.len()];
        by_outputs
            .par_chunks_mut(CHUNK * OUTPUTS)
            .zip(changes.par_chunks(CHUNK * OUTPUTS))
            .enumerate()
            .for_each(|(chunk, (by_outputs, changes))| {
                let rows = by_outputs.chunks_exact_mut(OUTPUTS).zip(changes.chunks_exact(OUTPUTS));
                for ((by_outputs, change), anchor) in rows.zip(chunk * CHUNK..) {
                    let geometry = &geometry[anchor * WIDTH..][..WIDTH];
                    let sh = &sh[anchor * SH..][..SH];
                    self.row_backward(anchor, change, &by_means, geometry, sh, by_outputs);
                }
            });
        by_outputs
    }

    fn row_backward(
        &self,
        anchor: usize,
        change: &[f32],
        by_means: &[[f32; 3]],
        geometry: &[f32],
        sh: &[f32],
        by: &mut [f32],
    ) {
        let view = self.views[anchor] as usize;
        by[0] = geometry[OPACITY_LOGIT];
        by[1..4].copy_from_slice(&geometry[LOG_SCALE]);
        // The product is linear in its second factor: with the first one's conjugate it is transposed.
        let base = &self.base.geometry()[anchor * Gaussians::GEOMETRY..][QUATERNION];
        let by_turn = product(
            [base[0], -base[1], -base[2], -base[3]],
            std::array::from_fn(|i| geometry[QUATERNION.start + i]),
        );
        by[4..8].copy_from_slice(&by_turn);
        let camera = self.rotations[view];
        for row in 0..3 {
            let moved: f32 = (0..3).map(|axis| camera[row][axis] * geometry[MEAN.start + axis]).sum();
            by[35 + row] = self.spacing[anchor] * moved;
        }
        let (sh, _) = sh.as_chunks::<3>();
        let (by_sh, _) = by[8..35].as_chunks_mut::<3>();
        by_sh[0] = sh[0];
        self.rotate_sh[view].backward(&sh[1..], &mut by_sh[1..]);
        for (by, weight) in by_sh.iter_mut().zip(self.in_mean[anchor]) {
            (0..3).for_each(|c| by[c] += weight * by_means[view][c]);
        }
        for ((by, change), bound) in by.iter_mut().zip(change).zip(BOUNDS) {
            *by *= 1.0 - (change / bound) * (change / bound);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use gs_scene::Intrinsics;
    use proptest::prelude::*;

    /// Anchors of the decoder below.
    const N: usize = 3;

    fn decoder(quaternion: [f32; 4], turn: f64) -> Decoder {
        let mut base = Gaussians::empty(0).unwrap();
        base.push([1.0, -2.0, 3.0], quaternion, [-3.0, -2.0, -4.0], 0.7, &[0.1, 0.2, -0.3]);
        base.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [-1.0; 3], -0.7, &[0.0; 3]);
        base.push([0.5, 0.2, -1.0], [1.0, 0.0, 0.0, 0.0], [-1.5; 3], 0.2, &[0.3; 3]);
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 4.0, cy: 3.0, width: 8, height: 6 };
        let rotations = [DMat3::from_rotation_y(0.3), DMat3::from_rotation_x(turn)];
        let cameras =
            rotations.map(|rotation| Camera::new(lens, rotation, DVec3::new(0.3, -0.2, 4.0)).unwrap());
        Decoder::new(base, vec![0.05, 2.0, 0.7], vec![1, 0, 1], &cameras)
    }

    #[test]
    fn no_outputs_change_nothing() {
        let decoder = decoder([0.5, 0.5, -0.5, 0.5], 1.0);
        let decoded = decoder.decode(&[0.0; N * OUTPUTS]);
        assert_eq!(decoded.geometry(), decoder.base().geometry());
        assert_eq!((&decoded.sh()[..3], &decoded.sh()[27..30]), (&[0.1, 0.2, -0.3][..], &[0.0; 3][..]));
        assert!(decoded.sh()[3..27].iter().all(|&c| c == 0.0));
    }

    /// A decoder about Gaussians of a refined scene, of the same anchors.
    fn about_refined(turn: f64) -> Decoder {
        let mut decoder = decoder([0.8, 0.0, -0.6, 0.0], turn);
        decoder.base = decoder.base.with_sh_degree(DEGREE).unwrap();
        decoder.base.buffers_mut().1.iter_mut().enumerate().for_each(|(i, c)| *c += (i as f32).sin());
        decoder
    }

    #[test]
    fn colours_by_direction_of_a_refined_scene_are_changed_not_replaced() {
        let decoder = about_refined(1.0);
        assert_eq!(decoder.decode(&[0.0; N * OUTPUTS]), *decoder.base());
        let outputs: Vec<f32> = (0..N * OUTPUTS).map(|i| (i as f32 * 0.7).sin()).collect();
        let changed = |decoder: &Decoder| -> Vec<f32> {
            let base = decoder.base.clone().with_sh_degree(DEGREE).unwrap();
            decoder.decode(&outputs).sh().iter().zip(base.sh()).map(|(a, b)| a - b).collect()
        };
        let closed_form = super::tests::decoder([0.8, 0.0, -0.6, 0.0], 1.0);
        for (i, (a, b)) in changed(&decoder).iter().zip(changed(&closed_form)).enumerate() {
            assert!((a - b).abs() < 1e-6, "{i}: {a} {b}");
        }
    }

    /// A decoder about grey balls, of the same anchors.
    fn grey_balls(turn: f64) -> Decoder {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 4.0, cy: 3.0, width: 8, height: 6 };
        let rotations = [DMat3::from_rotation_y(0.3), DMat3::from_rotation_x(turn)];
        let cameras =
            rotations.map(|rotation| Camera::new(lens, rotation, DVec3::new(0.3, -0.2, 4.0)).unwrap());
        let positions = [[1.0, -2.0, 3.0], [0.0; 3], [0.5, 0.2, -1.0]];
        Decoder::of_grey_balls(&positions, vec![0.05, 2.0, 0.0], vec![1, 0, 1], &cameras)
    }

    #[test]
    fn about_grey_balls_all_anchors_are_alike_and_outputs_say_the_rest() {
        let decoder = grey_balls(1.0);
        let decoded = decoder.decode(&[0.0; N * OUTPUTS]);
        assert!(decoded.sh().iter().chain(decoded.geometry()).all(|v| v.is_finite()));
        assert!(decoded.sh().iter().all(|&c| c == 0.0), "grey");
        let row = &decoded.geometry()[Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
        assert_eq!((row[OPACITY_LOGIT], &row[LOG_SCALE], &row[MEAN]), (0.0, &[0.0; 3][..], &[0.0; 3][..]));
        // A colour of an output is the colour, whatever the other anchors' outputs are: no mean is subtracted.
        let mut outputs = [0.0; N * OUTPUTS];
        outputs[OUTPUTS + 8] = 0.5;
        let colour = decoder.decode(&outputs).sh()[SH];
        assert!((colour - 2.0 * 0.25f32.tanh()).abs() < 1e-6, "{colour}");
    }

    #[test]
    fn whatever_is_not_nan_stays_within_bounds() {
        let decoder = decoder([0.5, 0.5, -0.5, 0.5], 1.0);
        for value in [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e20] {
            let decoded = decoder.decode(&[value; N * OUTPUTS]);
            assert!(decoded.geometry().iter().chain(decoded.sh()).all(|v| v.is_finite()), "{value}");
            for row in decoded.geometry().chunks_exact(Gaussians::GEOMETRY) {
                assert!(row[QUATERNION].iter().map(|q| q * q).sum::<f32>() >= 0.24, "{row:?}");
            }
        }
    }

    #[test]
    fn the_mean_colour_of_a_view_stays_that_of_the_closed_form() {
        let decoder = decoder([0.5, 0.5, -0.5, 0.5], 1.0);
        let outputs: Vec<f32> = (0..N * OUTPUTS).map(|i| (i as f32 * 0.7).sin()).collect();
        let decoded = decoder.decode(&outputs);
        let mean_change = |view: u32, c: usize| -> f32 {
            let change = |i: usize| {
                let (sh, weights) = (&decoded.sh()[i * SH..][..SH], decoder.in_mean[i]);
                let mut camera = [[0.0; 3]; TERMS];
                camera[0][c] = sh[c] - decoder.base.sh()[3 * i + c];
                let world: Vec<[f32; 3]> = sh.as_chunks().0.to_vec();
                // A rotation's transposed map is its inverse.
                decoder.rotate_sh[view as usize].backward(&world[1..], &mut camera[1..]);
                weights.iter().zip(camera).map(|(weight, rgb)| weight * rgb[c]).sum::<f32>()
            };
            (0..N).filter(|&i| decoder.views[i] == view).map(change).sum()
        };
        for (view, c) in [(0, 0), (0, 2), (1, 0), (1, 1), (1, 2)] {
            assert!(mean_change(view, c).abs() < 1e-5, "view {view}, channel {c}");
        }
        // The only anchor of its view: its colour, seen from there, is what it was.
        let from_there = decoder.in_mean[1];
        assert!((from_there[0] - 1.0).abs() < 1e-6, "{from_there:?}");
    }

    #[test]
    fn an_anchor_without_area_or_direction_has_no_part_in_the_mean() {
        let mut base = Gaussians::empty(0).unwrap();
        base.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [-1.0; 3], 0.7, &[0.1; 3]);
        base.push([0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0], [-1.0; 3], 0.7, &[0.1; 3]);
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 4.0, cy: 3.0, width: 8, height: 6 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        for (spacing, expected) in [([0.1, 0.1], [0.0, 1.0]), ([0.1, 0.0], [0.0, 0.0])] {
            let decoder = Decoder::new(base.clone(), spacing.to_vec(), vec![0, 0], &[camera]);
            assert_eq!([0, 1].map(|i| decoder.in_mean[i][0]), expected);
            let decoded = decoder.decode(&[1.0; 2 * OUTPUTS]);
            assert!(decoded.sh().iter().all(|v| v.is_finite()));
        }
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_differences(
            outputs in prop::collection::vec(-2.0f32..2.0, N * OUTPUTS),
            weights in prop::collection::vec(-1.0f32..1.0, N * 38),
            turn in -3.0f64..3.0, index in 0usize..N * OUTPUTS, about in 0..3,
        ) {
            let decoder = match about {
                0 => grey_balls(turn),
                1 => about_refined(turn),
                _ => decoder([0.8, 0.0, -0.6, 0.0], turn),
            };
            let loss = |outputs: &[f32]| -> f64 {
                let decoded = decoder.decode(outputs);
                let values = decoded.geometry().iter().chain(decoded.sh());
                values.zip(&weights).map(|(v, w)| f64::from(*v) * f64::from(*w)).sum()
            };
            let found = decoder.backward(&outputs, &weights[..N * 11], &weights[N * 11..])[index];
            let moved = |by: f32| {
                let mut moved = outputs.clone();
                moved[index] += by;
                loss(&moved)
            };
            // Values of order 1 to 10 in f32: differences are good to some 1e-5, a step of 2^-6 keeps 1e-3.
            let slope = (moved(0.015_625) - moved(-0.015_625)) / 0.031_25;
            prop_assert!((slope - f64::from(found)).abs() < 3e-3, "{index}: {slope} {found}");
        }
    }
}

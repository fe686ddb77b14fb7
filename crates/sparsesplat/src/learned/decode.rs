//! What the head's 38 outputs mean: bounded changes of the closed-form Gaussian, so that an untrained head, whose
//! outputs are 0, gives exactly that one.
//!
//! | outputs | change | bound |
//! |---|---|---|
//! | 0 | opacity: added to the logit | 8 |
//! | 1..4 | scale: added to the logarithms | 3 |
//! | 4..8 | rotation: the Gaussian's own axes are turned by the quaternion (1, 0, 0, 0) + outputs | ½ for w, 1 |
//! | 8..35 | spherical harmonics of degree 2, `[coefficient][rgb]`, in the camera's axes: added | 2 |
//! | 35..38 | the mean is moved, in the camera's axes and in units of the anchor's spacing | 2 |
//!
//! The paper's 38 outputs are 1 + 3 + 4 + 27 = 35; it does not say what the other three are. An output x changes by
//! b·tanh(x / b), b the bound: of slope 1 where training begins, and finite whatever the head says.

use super::rotate_sh::RotateSh;
use attn_head::OUTPUTS;
use glam::DMat3;
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION};
use rayon::prelude::*;

/// Numbers of SH of degree 2 per Gaussian.
const SH: usize = 27;
/// Anchors per parallel task.
const CHUNK: usize = 1024;

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
    /// Closed-form Gaussians of SH degree 0, one per anchor.
    base: Gaussians,
    /// Width of the patch that each anchor stands for, scene units.
    spacing: Vec<f32>,
    /// View of each anchor.
    views: Vec<u32>,
    /// World-to-camera rotation of each view, row-major.
    rotations: Vec<[[f32; 3]; 3]>,
    rotate_sh: Vec<RotateSh>,
}

/// b·tanh(x / b) of all outputs of an anchor.
fn bounded(outputs: &[f32]) -> [f32; OUTPUTS] {
    std::array::from_fn(|i| BOUNDS[i] * (outputs[i] / BOUNDS[i]).tanh())
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

impl Decoder {
    /// A decoder about closed-form Gaussians `base` (SH degree 0), one per anchor; `spacing` and `views` per anchor,
    /// `rotations` world to camera per view.
    ///
    /// # Panics
    /// If lengths differ, a view does not exist or the degree is not 0.
    #[must_use]
    pub fn new(base: Gaussians, spacing: Vec<f32>, views: Vec<u32>, rotations: &[DMat3]) -> Self {
        assert_eq!(base.sh_degree(), 0, "SH degree of the closed form");
        assert!(base.len() == spacing.len() && base.len() == views.len(), "one entry per anchor");
        assert!(views.iter().all(|&view| (view as usize) < rotations.len()), "views that exist");
        let rows = |rotation: &DMat3| {
            let columns = rotation.as_mat3().to_cols_array_2d();
            std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row]))
        };
        Self {
            base,
            spacing,
            views,
            rotations: rotations.iter().map(rows).collect(),
            rotate_sh: rotations.iter().map(|&rotation| RotateSh::new(rotation)).collect(),
        }
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
        let mut geometry = self.base.geometry().to_vec();
        let mut sh = vec![0.0; self.len() * SH];
        geometry
            .par_chunks_mut(CHUNK * WIDTH)
            .zip(sh.par_chunks_mut(CHUNK * SH))
            .zip(outputs.par_chunks(CHUNK * OUTPUTS))
            .enumerate()
            .for_each(|(chunk, ((geometry, sh), outputs))| {
                let rows = geometry.chunks_exact_mut(WIDTH).zip(sh.chunks_exact_mut(SH));
                let rows = rows.zip(outputs.chunks_exact(OUTPUTS)).zip(chunk * CHUNK..);
                rows.for_each(|(((geometry, sh), outputs), anchor)| self.row(anchor, outputs, geometry, sh));
            });
        Gaussians::new(2, geometry, sh).expect("lengths as computed")
    }

    /// One anchor; `geometry` holds the closed form and receives the change.
    fn row(&self, anchor: usize, outputs: &[f32], geometry: &mut [f32], sh: &mut [f32]) {
        let change = bounded(outputs);
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
        sh[0] = std::array::from_fn(|c| self.base.sh()[anchor * 3 + c] + change[0][c]);
        self.rotate_sh[view].turn(&change[1..], &mut sh[1..]);
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
        let mut by_outputs = vec![0.0; outputs.len()];
        by_outputs
            .par_chunks_mut(CHUNK * OUTPUTS)
            .zip(outputs.par_chunks(CHUNK * OUTPUTS))
            .enumerate()
            .for_each(|(chunk, (by_outputs, outputs))| {
                let rows = by_outputs.chunks_exact_mut(OUTPUTS).zip(outputs.chunks_exact(OUTPUTS));
                for ((by_outputs, outputs), anchor) in rows.zip(chunk * CHUNK..) {
                    let geometry = &geometry[anchor * WIDTH..][..WIDTH];
                    self.row_backward(anchor, outputs, geometry, &sh[anchor * SH..][..SH], by_outputs);
                }
            });
        by_outputs
    }

    fn row_backward(&self, anchor: usize, outputs: &[f32], geometry: &[f32], sh: &[f32], by: &mut [f32]) {
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
        for ((by, change), bound) in by.iter_mut().zip(bounded(outputs)).zip(BOUNDS) {
            *by *= 1.0 - (change / bound) * (change / bound);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decoder(quaternion: [f32; 4], turn: f64) -> Decoder {
        let mut base = Gaussians::empty(0).unwrap();
        base.push([1.0, -2.0, 3.0], quaternion, [-3.0, -2.0, -4.0], 0.7, &[0.1, 0.2, -0.3]);
        base.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [-1.0; 3], -0.7, &[0.0; 3]);
        let rotations = [DMat3::from_rotation_y(0.3), DMat3::from_rotation_x(turn)];
        Decoder::new(base, vec![0.05, 2.0], vec![1, 0], &rotations)
    }

    #[test]
    fn no_outputs_change_nothing() {
        let decoder = decoder([0.5, 0.5, -0.5, 0.5], 1.0);
        let decoded = decoder.decode(&[0.0; 2 * OUTPUTS]);
        assert_eq!(decoded.geometry(), decoder.base().geometry());
        assert_eq!((&decoded.sh()[..3], &decoded.sh()[27..30]), (&[0.1, 0.2, -0.3][..], &[0.0; 3][..]));
        assert!(decoded.sh()[3..27].iter().all(|&c| c == 0.0));
    }

    #[test]
    fn whatever_is_not_nan_stays_within_bounds() {
        let decoder = decoder([0.5, 0.5, -0.5, 0.5], 1.0);
        for value in [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e20] {
            let decoded = decoder.decode(&[value; 2 * OUTPUTS]);
            assert!(decoded.geometry().iter().chain(decoded.sh()).all(|v| v.is_finite()), "{value}");
            for row in decoded.geometry().chunks_exact(Gaussians::GEOMETRY) {
                assert!(row[QUATERNION].iter().map(|q| q * q).sum::<f32>() >= 0.24, "{row:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_differences(
            outputs in prop::collection::vec(-2.0f32..2.0, 2 * OUTPUTS),
            weights in prop::collection::vec(-1.0f32..1.0, 2 * 38),
            turn in -3.0f64..3.0, at in 0usize..2 * OUTPUTS,
        ) {
            let decoder = decoder([0.8, 0.0, -0.6, 0.0], turn);
            let loss = |outputs: &[f32]| -> f64 {
                let decoded = decoder.decode(outputs);
                let values = decoded.geometry().iter().chain(decoded.sh());
                values.zip(&weights).map(|(v, w)| f64::from(*v) * f64::from(*w)).sum()
            };
            let found = decoder.backward(&outputs, &weights[..22], &weights[22..])[at];
            let moved = |by: f32| {
                let mut moved = outputs.clone();
                moved[at] += by;
                loss(&moved)
            };
            // Values of order 1 to 10 in f32: differences are good to some 1e-5, a step of 2^-6 keeps 1e-3.
            let slope = (moved(0.015_625) - moved(-0.015_625)) / 0.031_25;
            prop_assert!((slope - f64::from(found)).abs() < 3e-3, "{at}: {slope} {found}");
        }
    }
}

//! Covariance of a Gaussian, from its axes and back to them.

use glam::{DMat3, DQuat, DVec3};

/// Rounds of Jacobi's rotations: convergence is quadratic, a 3x3 matrix needs four or five.
const ROUNDS: usize = 12;

/// Covariance of a Gaussian with quaternion (w, x, y, z) of any norm and logarithms of its standard deviations.
pub(super) fn covariance(quaternion: &[f32], log_scale: &[f32]) -> DMat3 {
    let [w, x, y, z] = std::array::from_fn(|i| f64::from(quaternion[i]));
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let variance = DVec3::from_array(std::array::from_fn(|i| (2.0 * f64::from(log_scale[i])).exp()));
    axes * DMat3::from_diagonal(variance) * axes.transpose()
}

/// Axes, a rotation, and variances of a covariance, largest first.
pub(super) fn axes(covariance: DMat3) -> (DQuat, [f64; 3]) {
    let mut a = covariance;
    let mut axes = DMat3::IDENTITY;
    for _ in 0..ROUNDS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (off, difference) = (a.col(q)[p], a.col(q)[q] - a.col(p)[p]);
            if off == 0.0 {
                continue;
            }
            // The rotation by the smaller angle that clears the element.
            let cot = difference / (2.0 * off);
            let tan = cot.signum() / (cot.abs() + cot.hypot(1.0));
            let cos = 1.0 / tan.hypot(1.0);
            let sin = tan * cos;
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = cos;
            turn.col_mut(q)[q] = cos;
            turn.col_mut(p)[q] = -sin;
            turn.col_mut(q)[p] = sin;
            a = turn.transpose() * a * turn;
            axes *= turn;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a.col(j)[j].total_cmp(&a.col(i)[i]));
    let [first, second] = [axes.col(order[0]), axes.col(order[1])];
    let rotation = DQuat::from_mat3(&DMat3::from_cols(first, second, first.cross(second))).normalize();
    (rotation, order.map(|i| a.col(i)[i].max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn axes_are_found_again(
            q in prop::array::uniform4(-1.0f32..1.0), log_scale in prop::array::uniform3(-6.0f32..3.0),
        ) {
            prop_assume!(q.iter().map(|v| v * v).sum::<f32>() > 0.01);
            let given = covariance(&q, &log_scale);
            let (rotation, variances) = axes(given);
            let turned = DMat3::from_quat(rotation);
            let back = turned * DMat3::from_diagonal(DVec3::from_array(variances)) * turned.transpose();
            let largest = variances[0];
            prop_assert!(variances[0] >= variances[1] && variances[1] >= variances[2]);
            prop_assert!((0..3).all(|i| (back.col(i) - given.col(i)).abs().max_element() < 1e-9 * largest));
        }
    }

    #[test]
    fn points_planes_and_balls_have_axes() {
        for diagonal in [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 2.0, 2.0], [0.0, 0.0, 1e-300]] {
            let (rotation, mut variances) = axes(DMat3::from_diagonal(DVec3::from_array(diagonal)));
            assert!(rotation.is_normalized(), "{diagonal:?}");
            variances.reverse();
            assert_eq!(variances, diagonal);
        }
    }
}

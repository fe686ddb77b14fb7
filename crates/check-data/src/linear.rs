//! Small dense linear algebra: what matching and epipolar geometry need, and glam does not have.

/// Solves `M x = b` for a symmetric positive definite `M` by Cholesky's decomposition; `None` if it is not.
pub(crate) fn solve<const N: usize>(matrix: &[[f64; N]; N], right: [f64; N]) -> Option<[f64; N]> {
    Some(Cholesky::new(matrix)?.solve(right))
}

/// Adds the outer product of a vector with itself.
pub(crate) fn add_square<const N: usize>(matrix: &mut [[f64; N]; N], vector: &[f64; N]) {
    for (row, a) in matrix.iter_mut().zip(vector) {
        for (entry, b) in row.iter_mut().zip(vector) {
            *entry += a * b;
        }
    }
}

/// The unit eigenvector of the smallest eigenvalue of a symmetric positive semi-definite matrix, by inverse
/// iteration. Where that eigenvalue is not single, one of its eigenvectors; `None` for a zero or non-finite
/// matrix.
pub(crate) fn smallest_eigenvector<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[f64; N]> {
    let trace: f64 = (0..N).map(|i| matrix[i][i]).sum();
    if !(trace.is_finite() && trace > 0.0) {
        return None;
    }
    // The shift keeps an exactly singular matrix solvable; it moves no eigenvector.
    let mut shifted = *matrix;
    (0..N).for_each(|i| shifted[i][i] += trace * SHIFT);
    let factor = Cholesky::new(&shifted)?;
    // Not orthogonal to anything that occurs by symmetry.
    let mut vector: [f64; N] = std::array::from_fn(|i| 1.0 + 0.37 * i as f64 - 0.11 * (i * i) as f64);
    for _ in 0..INVERSE_STEPS {
        vector = factor.solve(vector);
        let length = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(length.is_finite() && length > 0.0) {
            return None;
        }
        vector = vector.map(|v| v / length);
    }
    Some(vector)
}

/// Relative to the trace; above what rounding does to a matrix that is a sum of squares.
const SHIFT: f64 = 1e-13;
const INVERSE_STEPS: usize = 6;

/// Lower triangle L with M = L Lᵀ.
struct Cholesky<const N: usize>([[f64; N]; N]);

impl<const N: usize> Cholesky<N> {
    fn new(matrix: &[[f64; N]; N]) -> Option<Self> {
        let mut lower = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let done: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                let rest = matrix[i][j] - done;
                lower[i][j] = if i == j {
                    if !(rest > 0.0 && rest.is_finite()) {
                        return None;
                    }
                    rest.sqrt()
                } else {
                    rest / lower[j][j]
                };
            }
        }
        Some(Self(lower))
    }

    fn solve(&self, right: [f64; N]) -> [f64; N] {
        let (lower, mut x) = (&self.0, right);
        for i in 0..N {
            let done: f64 = (0..i).map(|k| lower[i][k] * x[k]).sum();
            x[i] = (x[i] - done) / lower[i][i];
        }
        for i in (0..N).rev() {
            let done: f64 = (i + 1..N).map(|k| lower[k][i] * x[k]).sum();
            x[i] = (x[i] - done) / lower[i][i];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn times<const N: usize>(matrix: &[[f64; N]; N], x: &[f64; N]) -> [f64; N] {
        std::array::from_fn(|i| (0..N).map(|j| matrix[i][j] * x[j]).sum())
    }

    proptest! {
        #[test]
        fn solutions_solve_and_null_vectors_vanish(values in prop::collection::vec(-1.0f64..1.0, 40)) {
            // A sum of squares of 5 rows of 6 numbers: rank 5, so the smallest eigenvalue is 0.
            let row = |r: usize| -> [f64; 6] { std::array::from_fn(|i| values[r * 6 + i]) };
            let mut singular = [[0.0; 6]; 6];
            for r in 0..5 {
                add_square(&mut singular, &row(r));
            }
            let vector = smallest_eigenvector(&singular).unwrap();
            prop_assert!((vector.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-9);
            let residual = times(&singular, &vector);
            prop_assert!(residual.iter().all(|v| v.abs() < 1e-6), "{:?}", residual);

            let mut definite = singular;
            (0..6).for_each(|i| definite[i][i] += 0.5);
            let expected: [f64; 6] = std::array::from_fn(|i| values[34 + i]);
            let found = solve(&definite, times(&definite, &expected)).unwrap();
            prop_assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9));
        }
    }

    #[test]
    fn matrices_that_are_not_definite_are_none() {
        assert_eq!(solve(&[[0.0; 3]; 3], [1.0; 3]), None);
        assert_eq!(solve(&[[1.0, 2.0], [2.0, 1.0]], [1.0; 2]), None);
        assert_eq!(solve(&[[f64::NAN]], [1.0]), None);
        assert_eq!(smallest_eigenvector(&[[0.0; 3]; 3]), None);
        assert_eq!(smallest_eigenvector(&[[f64::INFINITY; 2]; 2]), None);
    }
}

/// Why numbers make no pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PoseRule {
    /// The 3×3 part is no rotation, uniform scale and rounded digits allowed for.
    #[error(
        "holds no rotation: |R Rᵀ - I| is {deviation:.2e} after a uniform scale is taken out, expected at most 1e-2"
    )]
    NotARotation {
        /// Largest absolute entry of `R Rᵀ - I`.
        deviation: f64,
    },
    /// The 3×3 part mirrors.
    #[error("mirrors the scene (its determinant is negative); is an axis flipped?")]
    Mirrored,
    /// A quaternion of length 0, or not finite.
    #[error("has the quaternion {found:?}, expected a finite one that is not 0")]
    Quaternion {
        /// As it stands in the file.
        found: [f64; 4],
    },
}

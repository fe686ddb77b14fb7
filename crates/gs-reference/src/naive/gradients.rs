//! Gradients of the naive renderer, and how they are named.

use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION};

/// Derivatives of a loss by the pixels of a rendering, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelGradients {
    /// By the colour, `[height, width, 3]`.
    pub image: Vec<f64>,
    /// By alpha, `[height, width]`.
    pub alpha: Vec<f64>,
    /// By Σ w z, `[height, width]`, 1 / scene units.
    pub depth_sum: Vec<f64>,
}

/// Derivatives of a loss by all that a rendering depends on. Of Gaussians that are not drawn they are exactly 0.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceGradients {
    /// By the stored geometry, `[N, 11]` in the layout of [`gs_scene::Gaussians`]: by the quaternion as it is stored, not
    /// normalised.
    pub geometry: Vec<f64>,
    /// By the SH coefficients, `[N, (degree+1)², 3]`.
    pub sh: Vec<f64>,
    /// By the background, rgb.
    pub background: [f64; 3],
    /// By the world-to-camera matrix [R | t], `[3, 4]` row-major, its twelve entries taken as independent and the camera
    /// centre as -Rᵀ t.
    pub world_to_camera: [f64; 12],
    /// By the twist (ρ, θ) of T ← exp(ξ^) T at ξ = 0: translation, then rotation, in camera axes.
    pub twist: [f64; 6],
    /// By the centres in the picture, `[N, 2]`, 1 / pixels.
    pub means2d: Vec<f64>,
    /// By the conics, `[N, 3]`: by each of the three numbers (A, B, C), so that B counts for both off-diagonal entries.
    pub conics: Vec<f64>,
    /// By the opacities after compensation, `[N]`.
    pub opacities: Vec<f64>,
    /// By the colours after the clamp, `[N, 3]`.
    pub rgb: Vec<f64>,
}

/// What a derivative is taken by: the buffers of [`ReferenceGradients`], geometry by groups of columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "named as the fields of ReferenceGradients")]
pub enum Variable {
    Means,
    Quaternions,
    LogScales,
    OpacityLogits,
    Sh,
    Background,
    WorldToCamera,
    Twist,
    Means2d,
    Conics,
    Opacities,
    Rgb,
}

impl Variable {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Means,
        Self::Quaternions,
        Self::LogScales,
        Self::OpacityLogits,
        Self::Sh,
        Self::Background,
        Self::WorldToCamera,
        Self::Twist,
        Self::Means2d,
        Self::Conics,
        Self::Opacities,
        Self::Rgb,
    ];

    /// What golden files call it, after `grad_`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Means => "means",
            Self::Quaternions => "quats",
            Self::LogScales => "log_scales",
            Self::OpacityLogits => "opacity_logits",
            Self::Sh => "sh",
            Self::Background => "background",
            Self::WorldToCamera => "viewmat",
            Self::Twist => "viewmat_se3",
            Self::Means2d => "mid_means2d",
            Self::Conics => "mid_conics",
            Self::Opacities => "mid_opacities",
            Self::Rgb => "mid_colors",
        }
    }

    /// Its columns of a geometry buffer `[N, 11]`, or `None` if it is not stored there.
    pub fn of_geometry<T: Copy + Into<f64>>(self, geometry: &[T]) -> Option<Vec<f64>> {
        let columns = match self {
            Self::Means => MEAN,
            Self::Quaternions => QUATERNION,
            Self::LogScales => LOG_SCALE,
            Self::OpacityLogits => OPACITY_LOGIT..OPACITY_LOGIT + 1,
            _ => return None,
        };
        let rows = geometry.chunks_exact(Gaussians::GEOMETRY);
        Some(rows.flat_map(|row| row[columns.clone()].iter().map(|&value| value.into())).collect())
    }
}

impl ReferenceGradients {
    /// The derivatives by one variable, row-major.
    #[must_use]
    pub fn by(&self, variable: Variable) -> Vec<f64> {
        let buffer: &[f64] = match variable {
            Variable::Means | Variable::Quaternions | Variable::LogScales | Variable::OpacityLogits => {
                &self.geometry
            }
            Variable::Sh => &self.sh,
            Variable::Background => &self.background,
            Variable::WorldToCamera => &self.world_to_camera,
            Variable::Twist => &self.twist,
            Variable::Means2d => &self.means2d,
            Variable::Conics => &self.conics,
            Variable::Opacities => &self.opacities,
            Variable::Rgb => &self.rgb,
        };
        variable.of_geometry(buffer).unwrap_or_else(|| buffer.to_vec())
    }
}

//! Opacity of a Gaussian in a pixel, shared by the passes `rasterize_forward` and `rasterize_backward`.

use crate::frame::join;
use glam::DVec2;
use gs_shaders::{Frame, Splat};

pub(crate) struct Alpha {
    pub(crate) value: f64,
    pub(crate) drawn: bool,
    /// Whether it is cut at `alpha_max`.
    pub(crate) saturated: bool,
    /// Offset of the pixel from the centre, (e, dy) with e = dx - shear dy.
    pub(crate) offset: DVec2,
}

pub(crate) fn alpha_at(frame: &Frame, splat: &Splat, centre: DVec2) -> Alpha {
    let offset = centre - DVec2::from(join(splat.mean, splat.mean_low));
    let [shear] = join([splat.shear], [splat.shear_low]);
    let (e, dy) = (offset.x - shear * offset.y, offset.y);
    let [across, along] = splat.falloff.map(f64::from);
    let log2_alpha = f64::from(splat.log2_opacity) + across * e * e + along * dy * dy;
    let unlimited = log2_alpha.exp2();
    let alpha_max = f64::from(frame.alpha_max);
    Alpha {
        value: unlimited.min(alpha_max),
        drawn: log2_alpha >= f64::from(frame.alpha_min).log2(),
        saturated: unlimited > alpha_max,
        offset: DVec2::new(e, dy),
    }
}

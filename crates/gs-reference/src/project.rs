//! Twin of the pass `project`: a Gaussian to its footprint in the image, or to that of its ellipsoid.

use crate::ewa::{activated, footprint_of, from_camera, rotation_row, seen_at};
use crate::frame::split;
use crate::grid::ellipse_of;
use crate::sh::{sh_at, sh_basis};
use glam::{DVec2, DVec3};
use gs_shaders::{
    CULLED, Features, Frame, GEOMETRY, N_COUNTERS, REACH_SLACK, REJECTED, Splat, Surface, VISIBLE,
};
use std::f64::consts::{LN_2, LOG2_E};

/// What the pass writes for N Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprints {
    /// `[N]`; zeros where the Gaussian is not visible.
    pub splats: Vec<Splat>,
    /// `[N]` bits of the z-depth, `CULLED` where the Gaussian is not visible.
    pub depth_keys: Vec<u32>,
    /// `[N]` own index.
    pub order: Vec<u32>,
    /// `VISIBLE` and `REJECTED`; the others are 0.
    pub counters: [u32; N_COUNTERS],
}

/// Projects `geometry` `[N, 11]` and `sh` `[N, (SH_DEGREE + 1)², 3]`. Computed in f64 and rounded once; what does
/// not fit f32 is rejected.
#[must_use]
pub fn project(frame: &Frame, geometry: &[f32], sh: &[f32], features: Features) -> Footprints {
    place(frame, geometry, sh, features, false)
}

/// As [`project`], but to the footprints of ellipsoids, and their fronts `[N]`: zeros where the Gaussian is not visible.
#[must_use]
pub fn project_ellipsoids(
    frame: &Frame,
    geometry: &[f32],
    sh: &[f32],
    features: Features,
) -> (Footprints, Vec<Surface>) {
    let footprints = place(frame, geometry, sh, features, true);
    let mut surfaces = vec![Surface::default(); footprints.splats.len()];
    for (index, surface) in surfaces.iter_mut().enumerate() {
        if footprints.depth_keys[index] != CULLED {
            *surface = surface_of(frame, geometry, index, features);
        }
    }
    (footprints, surfaces)
}

/// The front of a Gaussian, from the covariance of the image coordinates (e, dy) and z, of which e and dy are independent.
fn surface_of(frame: &Frame, geometry: &[f32], index: usize, features: Features) -> Surface {
    let gaussian = activated(geometry, index);
    let f = footprint_of(frame, &gaussian, &seen_at(frame, gaussian.mean), features);
    let along_z = gaussian.axes.transpose() * rotation_row(frame, 2) * f.scale;
    let [a, g] = [f.falloff.x, f.falloff.y].map(|falloff| -2.0 * LN_2 * falloff);
    let w = f.u - f.shear * f.v;
    let (slope_e, slope_y) = (a * w.dot(along_z), g * f.v.dot(along_z));
    // What e and dy leave of z, along the Gaussian's axes and those of the low-pass filter: the difference of the variances
    // would cancel for flat Gaussians.
    let rest = along_z - slope_e * w - slope_y * f.v;
    let filtered = DVec2::new(slope_e, slope_y - f.shear * slope_e);
    let variance = rest.length_squared() + f64::from(frame.eps2d) * filtered.length_squared();
    Surface {
        slope_e: slope_e as f32,
        slope_y: slope_y as f32,
        sigma_z: variance.sqrt() as f32,
        padding: 0.0,
    }
}

fn place(frame: &Frame, geometry: &[f32], sh: &[f32], features: Features, as_ellipsoid: bool) -> Footprints {
    let n = frame.n_gaussians as usize;
    let mut out = Footprints {
        splats: vec![Splat::default(); n],
        depth_keys: vec![CULLED; n],
        order: (0..frame.n_gaussians).collect(),
        counters: [0; N_COUNTERS],
    };
    for index in 0..n {
        match splat_of(frame, geometry, sh, index, features, as_ellipsoid) {
            Fate::Visible(splat) => {
                out.splats[index] = splat;
                out.depth_keys[index] = splat.depth.to_bits();
                out.counters[VISIBLE as usize] += 1;
            }
            Fate::Unseen => {}
            Fate::Rejected => out.counters[REJECTED as usize] += 1,
        }
    }
    out
}

enum Fate {
    Visible(Splat),
    /// Not between near and far, too faint, or beside the image.
    Unseen,
    /// Something is not finite.
    Rejected,
}

fn splat_of(
    frame: &Frame,
    geometry: &[f32],
    sh: &[f32],
    index: usize,
    features: Features,
    as_ellipsoid: bool,
) -> Fate {
    if !geometry[index * GEOMETRY..][..GEOMETRY].iter().all(|value| value.is_finite()) {
        return Fate::Rejected;
    }
    let gaussian = activated(geometry, index);
    let seen = seen_at(frame, gaussian.mean);
    let depth = seen.p.z as f32;
    if !(depth > frame.near && depth < frame.far) {
        return Fate::Unseen;
    }
    if !gaussian.valid {
        return Fate::Rejected;
    }
    let footprint = footprint_of(frame, &gaussian, &seen, features);
    if footprint.opacity < f64::from(frame.alpha_min) {
        return Fate::Unseen;
    }
    let direction = from_camera(frame, gaussian.mean).normalize();
    let coefficients = sh_at(sh, index, features);
    let colour: DVec3 =
        coefficients.iter().zip(sh_basis(direction)).map(|(&c, y)| c * y).sum::<DVec3>() + 0.5;
    let (mean, mean_low) = split(footprint.mean.to_array());
    let ([shear], [shear_low]) = split([footprint.shear]);
    // At `ellipsoid_sigma` an ellipsoid reaches alpha_min: that is where it ends.
    let sigma = f64::from(frame.ellipsoid_sigma);
    let log2_opacity = if as_ellipsoid {
        f64::from(frame.alpha_min).log2() + 0.5 * LOG2_E * sigma * sigma
    } else {
        footprint.opacity.log2()
    };
    let splat = Splat {
        mean,
        mean_low,
        falloff: footprint.falloff.as_vec2().to_array(),
        shear,
        shear_low,
        log2_opacity: log2_opacity as f32,
        rgb: colour.max(DVec3::ZERO).as_vec3().to_array(),
        depth,
        padding: 0.0,
    };
    let ellipse = ellipse_of(&splat, f64::from(frame.alpha_min).log2());
    let shape = [
        splat.mean[0],
        splat.mean[1],
        splat.falloff[0],
        splat.falloff[1],
        splat.shear,
        splat.log2_opacity,
        ellipse.extent[0] as f32,
        ellipse.extent[1] as f32,
    ];
    if !(shape.iter().all(|number| number.is_finite()) && splat.falloff.iter().all(|&falloff| falloff < 0.0))
    {
        return Fate::Rejected;
    }
    let touches = (0..2).all(|axis| {
        let (mean, extent) = (ellipse.mean[axis], ellipse.extent[axis]);
        let extent = extent + f64::from(REACH_SLACK) * (mean.abs() + extent);
        mean + extent >= 0.5 && mean - extent <= f64::from(frame.size[axis]) - 0.5
    });
    if !touches {
        return Fate::Unseen;
    }
    // On the sum itself: the maximum with 0 would hide a NaN.
    if !colour.as_vec3().is_finite() {
        return Fate::Rejected;
    }
    Fate::Visible(splat)
}

//! The twins of the ellipsoid view against its definition, and that against quadrics in the affine view, cut by the ray of a
//! pixel.

use super::{Setup, setups};
use glam::{DMat3, DQuat, DVec2, DVec3};
use gs_reference::chain::{View, ellipsoids};
use gs_reference::tolerance::{AMBIGUOUS, AMBIGUOUS_ELLIPSOID, QUADRIC, TWIN_ELLIPSOID};
use gs_reference::{ReferenceEllipsoids, Solid, compare, project, render_ellipsoids};
use gs_scene::{LOG_SCALE, MEAN, QUATERNION};
use gs_shaders::AMBIENT;
use proptest::prelude::*;

/// As a host could ask for.
const SOLID: Solid = Solid { sigma: 1.0, opacity_min: 0.125 };

/// An ellipsoid in the coordinates (column, row, z-depth).
struct Quadric {
    centre: DVec3,
    /// Of the covariance: dᵀ inverse d = sigma² at d from the centre.
    inverse: DMat3,
    /// From gradients in these coordinates to those in camera axes.
    to_camera: DMat3,
    rgb: DVec3,
}

impl Quadric {
    fn new(setup: &Setup, index: usize) -> Option<Self> {
        let camera = &setup.camera;
        let seen = project(&setup.gaussians, index, camera, &setup.profile)?;
        if seen.opacity < SOLID.opacity_min {
            return None;
        }
        let row = &setup.gaussians.geometry()[index * 11..][..11];
        let number = |i: usize| f64::from(row[i]);
        let p = camera.to_camera(DVec3::from(std::array::from_fn(|i| number(MEAN.start + i))));
        let [w, x, y, z] = std::array::from_fn(|i| number(QUATERNION.start + i));
        let scale = DVec3::from(std::array::from_fn(|i| number(LOG_SCALE.start + i).exp()));
        let shape = camera.rotation()
            * DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
            * DMat3::from_diagonal(scale);
        let lens = camera.intrinsics();
        let focal = DVec2::new(lens.fx, lens.fy);
        let jacobian = |slope: DVec2| {
            let (u, v) = (DVec3::new(1.0, 0.0, -slope.x), DVec3::new(0.0, 1.0, -slope.y));
            DMat3::from_cols(u * focal.x / p.z, v * focal.y / p.z, DVec3::Z).transpose()
        };
        let (size, centre) =
            (DVec2::new(lens.width as f64, lens.height as f64), DVec2::new(lens.cx, lens.cy));
        let slope = p.truncate() / p.z;
        let clamped = slope.clamp((-centre - 0.15 * size) / focal, (1.15 * size - centre) / focal);
        let half = jacobian(clamped) * shape;
        let low_pass = DVec3::new(setup.profile.eps2d, setup.profile.eps2d, 0.0);
        Some(Self {
            centre: seen.mean.extend(seen.depth),
            inverse: (half * half.transpose() + DMat3::from_diagonal(low_pass)).inverse(),
            to_camera: jacobian(slope).transpose(),
            rgb: DVec3::from(seen.rgb),
        })
    }

    /// z-depth of the nearer of the points above a pixel centre, if there are any.
    fn front(&self, pixel: DVec2) -> Option<f64> {
        let d = (pixel - self.centre.truncate()).extend(0.0);
        // c z² + 2 b z + a = sigma²
        let (a, b, c) = (d.dot(self.inverse * d), self.inverse.z_axis.dot(d), self.inverse.z_axis.z);
        let square = b * b - c * (a - SOLID.sigma * SOLID.sigma);
        (square >= 0.0).then(|| self.centre.z - (b + square.sqrt()) / c)
    }

    fn lit(&self, pixel: DVec2, depth: f64, setup: &Setup) -> DVec3 {
        let normal = self.to_camera * (self.inverse * (pixel.extend(depth) - self.centre));
        let cosine = normal.normalize().dot(setup.camera.intrinsics().ray(pixel).normalize()).abs();
        self.rgb * (f64::from(AMBIENT) + (1.0 - f64::from(AMBIENT)) * cosine)
    }
}

fn view(setup: &Setup) -> View {
    let mut view = setup.view();
    view.frame.alpha_min = SOLID.opacity_min as f32;
    view
}

fn definition(setup: &Setup) -> ReferenceEllipsoids {
    let background = setup.background.map(f64::from);
    render_ellipsoids(&setup.gaussians, &setup.camera, background, &setup.profile, SOLID)
}

/// The worst deviation of the ellipsoids of `view`, as a multiple of its bound; `None` if there is nothing to compare.
fn excess(setup: &Setup, view: &View) -> Option<f64> {
    let truth = definition(setup);
    let masked: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS_ELLIPSOID).collect();
    let found = ellipsoids(view).pixels;
    let (colours, planes) = found.split_at(masked.len() * 4);
    let (hits, depths) = planes.split_at(masked.len());
    let image: Vec<f32> = colours.chunks_exact(4).flat_map(|pixel| pixel[..3].to_vec()).collect();
    let misses: Vec<f32> = colours.iter().skip(3).step_by(4).map(|&miss| 1.0 - miss).collect();
    let planes = [
        (&truth.image, image),
        (&truth.alpha, misses),
        (&truth.alpha, hits.to_vec()),
        (&truth.depth, depths.to_vec()),
    ];
    let excess = planes.map(|(expected, found)| {
        let deviation = compare(expected.iter().copied(), found, &masked).ok()?;
        Some(deviation.max_abs / (TWIN_ELLIPSOID * deviation.largest.max(1.0)))
    });
    excess.into_iter().collect::<Option<Vec<f64>>>().map(|excess| excess.into_iter().fold(0.0, f64::max))
}

proptest! {
    #[test]
    fn the_definition_is_a_cut_through_quadrics(setup in setups()) {
        let truth = definition(&setup);
        let quadrics: Vec<Quadric> =
            (0..setup.gaussians.len()).filter_map(|index| Quadric::new(&setup, index)).collect();
        let width = setup.camera.width();
        for at in (0..truth.alpha.len()).filter(|&at| truth.margin[at] > AMBIGUOUS) {
            let pixel = DVec2::new((at % width) as f64, (at / width) as f64) + 0.5;
            let fronts = quadrics.iter().filter_map(|quadric| Some((quadric.front(pixel)?, quadric)));
            let before = fronts.filter(|(depth, _)| *depth > setup.profile.near);
            let (depth, rgb) = before.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(
                (0.0, DVec3::from(setup.background.map(f64::from))),
                |(depth, quadric)| (depth, quadric.lit(pixel, depth, &setup)),
            );
            let found = DVec3::from_slice(&truth.image[3 * at..]);
            prop_assert!((truth.depth[at] - depth).abs() <= QUADRIC * depth.max(1.0), "depth {} not {}", truth.depth[at], depth);
            prop_assert!(found.distance(rgb) <= QUADRIC * rgb.length().max(1.0), "{found} not {rgb}");
        }
    }

    #[test]
    fn the_chain_draws_what_the_definition_does(setup in setups()) {
        if let Some(excess) = excess(&setup, &view(&setup)) {
            prop_assert!(excess <= 1.0, "{excess} times the bound");
        }
    }
}

#[test]
fn a_mutant_is_noticed() {
    let setup = Setup::new(1, 8, 2, [33, 20], true, true);
    let excess = |view: &View| excess(&setup, view).expect("something to compare");
    assert!(excess(&view(&setup)) <= 1.0);
    // An opacity only decides whether there is an ellipsoid.
    for column in 0..10 {
        let mut mutant = view(&setup);
        for row in mutant.geometry.chunks_exact_mut(11) {
            row[column] += 1e-2;
        }
        assert!(excess(&mutant) > 1.0, "column {column}");
    }
    let mut mutant = view(&setup);
    mutant.sh.iter_mut().for_each(|coefficient| *coefficient += 1e-2);
    assert!(excess(&mutant) > 1.0, "sh");
    mutant = view(&setup);
    mutant.frame.ellipsoid_sigma = 1.01;
    assert!(excess(&mutant) > 1.0, "size");
}

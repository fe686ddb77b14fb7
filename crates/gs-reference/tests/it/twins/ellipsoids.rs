//! The twins of the ellipsoid view against ellipsoids by their definition: quadrics in the affine view, cut by the ray of a pixel.

use super::{Setup, setups};
use glam::{DMat3, DQuat, DVec2, DVec3};
use gs_reference::chain::{View, ellipsoids};
use gs_reference::tolerance::{AMBIGUOUS, TWIN_ELLIPSOID};
use gs_reference::{compare, project};
use gs_scene::{LOG_SCALE, MEAN, QUATERNION};
use gs_shaders::AMBIENT;
use proptest::prelude::*;

/// Least opacity of what is drawn, as a host would ask for.
const ALPHA_MIN: f64 = 0.125;

/// An ellipsoid at one standard deviation, in the coordinates (column, row, z-depth).
struct Quadric {
    centre: DVec3,
    /// Of the points at d from the centre with dᵀ inverse d = 1.
    inverse: DMat3,
    /// From gradients in these coordinates to those in camera axes.
    to_camera: DMat3,
    rgb: DVec3,
}

/// One pixel of an ellipsoid view.
struct Hit {
    depth: f64,
    rgb: DVec3,
    /// How much farther it is to the next, and how far inside the rim the pixel lies, relative.
    margin: f64,
}

impl Quadric {
    fn new(setup: &Setup, index: usize) -> Option<Self> {
        let camera = &setup.camera;
        let seen = project(&setup.gaussians, index, camera, &setup.profile)?;
        if seen.opacity < ALPHA_MIN {
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

    /// The nearer of the points above a pixel centre, and how far inside the rim it lies, relative (outside: less than 0).
    fn front(&self, pixel: DVec2) -> (f64, f64) {
        let d = (pixel - self.centre.truncate()).extend(0.0);
        // c z² + 2 b z + a = 1
        let (a, b, c) = (d.dot(self.inverse * d), self.inverse.z_axis.dot(d), self.inverse.z_axis.z);
        let rise = b * b / c + 1.0 - a;
        (self.centre.z + (-b - (c * rise.max(0.0)).sqrt()) / c, rise)
    }

    fn lit(&self, pixel: DVec2, depth: f64, setup: &Setup) -> DVec3 {
        let normal = self.to_camera * (self.inverse * (pixel.extend(depth) - self.centre));
        let cosine = normal.normalize().dot(setup.camera.intrinsics().ray(pixel).normalize()).abs();
        self.rgb * (f64::from(AMBIENT) + (1.0 - f64::from(AMBIENT)) * cosine)
    }
}

/// What is seen in a pixel.
fn look(quadrics: &[Quadric], pixel: DVec2, setup: &Setup) -> Hit {
    let near = setup.profile.near;
    let mut hit =
        Hit { depth: 0.0, rgb: DVec3::from(setup.background.map(f64::from)), margin: f64::INFINITY };
    for quadric in quadrics {
        let (depth, rise) = quadric.front(pixel);
        hit.margin = hit.margin.min(rise.abs());
        if rise < 0.0 {
            continue;
        }
        hit.margin = hit.margin.min((depth / near - 1.0).abs());
        if depth > near {
            if hit.depth > 0.0 {
                hit.margin = hit.margin.min((depth / hit.depth - 1.0).abs());
            }
            if hit.depth == 0.0 || depth < hit.depth {
                (hit.depth, hit.rgb) = (depth, quadric.lit(pixel, depth, setup));
            }
        }
    }
    hit
}

fn view(setup: &Setup) -> View {
    let mut view = setup.view();
    view.frame.alpha_min = ALPHA_MIN as f32;
    view
}

/// The worst deviation of the ellipsoids of `view`, as a multiple of its bound; `None` if there is nothing to compare.
fn excess(setup: &Setup, view: &View) -> Option<f64> {
    let near_threshold = |index| {
        project(&setup.gaussians, index, &setup.camera, &setup.profile)
            .is_some_and(|seen| (seen.opacity / ALPHA_MIN - 1.0).abs() < AMBIGUOUS)
    };
    if (0..setup.gaussians.len()).any(near_threshold) {
        return None;
    }
    let quadrics: Vec<Quadric> =
        (0..setup.gaussians.len()).filter_map(|index| Quadric::new(setup, index)).collect();
    let found = ellipsoids(view).pixels;
    let (width, height) = (setup.camera.width(), setup.camera.height());
    let n_pixels = width * height;
    let mut expected = vec![0.0; n_pixels * 6];
    let mut masked = vec![false; n_pixels];
    for at in 0..n_pixels {
        let hit = look(&quadrics, DVec2::new((at % width) as f64, (at / width) as f64) + 0.5, setup);
        expected[4 * at..][..3].copy_from_slice(&hit.rgb.to_array());
        expected[4 * at + 3] = if hit.depth > 0.0 { 0.0 } else { 1.0 };
        expected[4 * n_pixels + at] = 1.0 - expected[4 * at + 3];
        expected[5 * n_pixels + at] = hit.depth;
        masked[at] = hit.margin < 1e-2;
    }
    let planes = [0..4 * n_pixels, 4 * n_pixels..5 * n_pixels, 5 * n_pixels..6 * n_pixels];
    let excess = planes.map(|plane| {
        let deviation = compare(expected[plane.clone()].to_vec(), found[plane].to_vec(), &masked).ok()?;
        Some(deviation.max_abs / (TWIN_ELLIPSOID * deviation.largest.max(1.0)))
    });
    excess.into_iter().collect::<Option<Vec<f64>>>().map(|excess| excess.into_iter().fold(0.0, f64::max))
}

proptest! {
    #[test]
    fn ellipsoids_are_where_the_definition_puts_them(setup in setups()) {
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

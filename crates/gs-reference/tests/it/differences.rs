//! The gradients of the reference against central differences of its renderings. The scenes are fixed. In most of them
//! the profile takes no decisions, so that the rendering is smooth; where it does, every pixel is far from deciding
//! otherwise, which the margins assert.

use glam::{DMat3, DVec3, EulerRot};
use gs_reference::tolerance::{CENTRAL_DIFFERENCE, ROUNDING_F64};
use gs_reference::{
    PixelGradients, Profile, ReferenceGradients, ShAxes, Variable, backward, compare, project, render,
};
use gs_scene::{Camera, Gaussians, Intrinsics, sh_coefficients};

const LENS: Intrinsics = Intrinsics { fx: 8.0, fy: 6.5, cx: 3.25, cy: 4.5, width: 9, height: 7 };

/// Nothing is skipped, clamped or stopped.
fn undecided() -> Profile {
    Profile { alpha_max: 1.0, alpha_min: 0.0, transmittance_min: 0.0, ..Profile::default() }
}

/// Numbers of -1..1 that look random, multiples of 2⁻¹²: steps of a stored f32 by as much are exact.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 51) as f32 - 4096.0) / 4096.0
    }

    fn several<const N: usize>(&mut self, scale: f32) -> [f32; N] {
        std::array::from_fn(|_| self.next() * scale)
    }
}

/// What a loss depends on.
#[derive(Clone)]
struct Setup {
    gaussians: Gaussians,
    camera: Camera,
    background: [f64; 3],
    profile: Profile,
    weights: PixelGradients,
}

impl Setup {
    fn new(gaussians: Gaussians, profile: Profile, draws: &mut Draws) -> Self {
        let angles = draws.several::<3>(0.25).map(f64::from);
        let rotation = DMat3::from_euler(EulerRot::XYZ, angles[0], angles[1], angles[2]);
        let translation = DVec3::from(draws.several::<3>(0.5).map(f64::from));
        let pixels = LENS.width * LENS.height;
        let mut weights = |numbers: usize| (0..numbers).map(|_| f64::from(draws.next())).collect();
        Self {
            gaussians,
            camera: Camera::new(LENS, rotation, translation).expect("a camera"),
            background: [0.25, 0.5, 0.75],
            profile,
            weights: PixelGradients {
                image: weights(pixels * 3),
                alpha: weights(pixels),
                depth_sum: weights(pixels),
            },
        }
    }

    /// Gaussians at well separated depths, in and around the picture, some of which have dark channels.
    fn random(seed: u64, profile: Profile) -> Self {
        let mut draws = Draws(seed);
        let degree = (seed % 4) as usize;
        let mut gaussians = Gaussians::empty(degree).expect("a degree");
        for i in [3, 0, 4, 1, 2] {
            let [x, y] = draws.several(3.0);
            let sh: Vec<f32> = (0..sh_coefficients(degree) * 3).map(|_| draws.next()).collect();
            gaussians.push(
                [x, y, 2.5 + i as f32],
                draws.several(2.0),
                draws.several::<3>(1.5).map(|log_scale| log_scale - 0.5),
                draws.next() * 3.0,
                &sh,
            );
        }
        Self::new(gaussians, profile, &mut draws)
    }

    fn loss(&self) -> f64 {
        let found = render(&self.gaussians, &self.camera, self.background, &self.profile);
        let dot = |weights: &[f64], found: &[f64]| weights.iter().zip(found).map(|(w, f)| w * f).sum::<f64>();
        dot(&self.weights.image, &found.image)
            + dot(&self.weights.alpha, &found.alpha)
            + dot(&self.weights.depth_sum, &found.depth_sum)
    }

    fn gradients(&self) -> ReferenceGradients {
        backward(&self.gaussians, &self.camera, self.background, &self.profile, &self.weights)
    }

    /// The derivative of the loss by what `change` adds a number to: central differences of two steps, extrapolated to
    /// a step of 0.
    fn difference(&self, step: f64, change: impl Fn(&mut Self, f64)) -> f64 {
        let at = |by: f64| {
            let mut changed = self.clone();
            change(&mut changed, by);
            changed.loss()
        };
        let slope = |step: f64| (at(step) - at(-step)) / (2.0 * step);
        (4.0 * slope(0.5 * step) - slope(step)) / 3.0
    }

    fn with_pose(&mut self, rotation: DMat3, translation: DVec3) {
        self.camera = Camera::new(LENS, rotation, translation).expect("nearly a rotation");
    }

    /// The derivatives by everything that is stored, and by the pose, by differences.
    fn differences(&self) -> Vec<(Variable, Vec<f64>)> {
        let stored = f64::exp2(-11.0);
        let exact = |value: &mut f32, by: f64| {
            let sum = f64::from(*value) + by;
            *value = sum as f32;
            assert_eq!(f64::from(*value), sum, "the step is exact");
        };
        let geometry: Vec<f64> = (0..self.gaussians.geometry().len())
            .map(|i| self.difference(stored, |s, by| exact(&mut s.gaussians.buffers_mut().0[i], by)))
            .collect();
        let sh = (0..self.gaussians.sh().len())
            .map(|i| self.difference(stored, |s, by| exact(&mut s.gaussians.buffers_mut().1[i], by)))
            .collect();
        let background = (0..3).map(|c| self.difference(stored, |s, by| s.background[c] += by)).collect();
        // A camera's matrix must remain a rotation to 1e-4.
        let world_to_camera = (0..12).map(|entry| {
            self.difference(f64::exp2(-15.0), |s, by| {
                let (mut rotation, mut translation) = (s.camera.rotation(), s.camera.translation());
                match (entry / 4, entry % 4) {
                    (row, 3) => translation[row] += by,
                    (row, column) => rotation.col_mut(column)[row] += by,
                }
                s.with_pose(rotation, translation);
            })
        });
        let twist = (0..6).map(|i| {
            self.difference(stored, |s, by| {
                let (rotation, translation) = (s.camera.rotation(), s.camera.translation());
                if i < 3 {
                    s.with_pose(rotation, translation + by * DVec3::AXES[i]);
                } else {
                    let turn = DMat3::from_axis_angle(DVec3::AXES[i - 3], by);
                    s.with_pose(turn * rotation, turn * translation);
                }
            })
        });
        let columns = [Variable::Means, Variable::Quaternions, Variable::LogScales, Variable::OpacityLogits];
        let mut all: Vec<_> = columns.map(|v| (v, v.of_geometry(&geometry).expect("columns"))).into();
        all.push((Variable::Sh, sh));
        all.push((Variable::Background, background));
        all.push((Variable::WorldToCamera, world_to_camera.collect()));
        all.push((Variable::Twist, twist.collect()));
        all
    }

    fn assert_gradients_are_differences(&self, name: &str) {
        let found = self.gradients();
        for (variable, expected) in self.differences() {
            let deviation = compare(expected, found.by(variable), &[]).expect("comparable");
            println!("{name} {}: {:.1e} of {:.1e}", variable.name(), deviation.max_abs, deviation.largest);
            assert!(deviation.largest > 0.0, "{name} by {variable:?}: nothing to see");
            assert!(
                deviation.max_abs <= CENTRAL_DIFFERENCE * deviation.largest,
                "{name} by {variable:?}: {deviation:?}"
            );
        }
    }
}

#[test]
fn gradients_are_differences() {
    for seed in 0..12 {
        let setup = Setup::random(seed, undecided());
        setup.assert_gradients_are_differences(&format!("scene {seed}"));
    }
}

#[test]
fn only_the_direction_of_a_quaternion_matters() {
    for seed in 0..12 {
        let setup = Setup::random(seed, undecided());
        let quaternions = Variable::Quaternions.of_geometry(setup.gaussians.geometry()).unwrap();
        let gradients = setup.gradients().by(Variable::Quaternions);
        for (q, by) in quaternions.chunks_exact(4).zip(gradients.chunks_exact(4)) {
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let lengths = (dot(q, q) * dot(by, by)).sqrt();
            assert!(lengths > 0.0 && dot(q, by).abs() <= 100.0 * ROUNDING_F64 * lengths, "{q:?} {by:?}");
        }
    }
}

#[test]
fn gradients_are_differences_with_compensated_opacity() {
    for seed in 12..20 {
        let profile = Profile { antialias: true, ..undecided() };
        let mut setup = Setup::random(seed, profile);
        // One that is much smaller than a pixel, so that the compensation has its least value.
        setup.gaussians.buffers_mut().0[gs_scene::LOG_SCALE].fill(-5.0);
        setup.assert_gradients_are_differences(&format!("compensated scene {seed}"));
    }
}

#[test]
fn gradients_are_differences_in_other_axes() {
    for seed in [21, 22, 23] {
        let profile = Profile { sh_axes: ShAxes::E3nn, ..undecided() };
        Setup::random(seed, profile).assert_gradients_are_differences(&format!("cycled scene {seed}"));
    }
}

/// Five walls that fill the picture: faint, clamped, too faint to be drawn, clamped, and behind where pixels stop.
#[test]
fn gradients_are_differences_where_pixels_decide() {
    let mut draws = Draws(31);
    let mut gaussians = Gaussians::empty(1).unwrap();
    for (z, log_scale, logit) in
        [(6.0, 5.0, 1.0), (3.0, 5.0, 4.0), (2.0, 1.0, -1.0), (4.0, 5.0, -8.0), (5.0, 5.0, 4.0)]
    {
        let ([x, y], [w, i, j, k]) = (draws.several(0.25), draws.several(0.25));
        let quaternion = [1.0 + w, i, j, k];
        let sh = draws.several::<12>(0.5);
        gaussians.push([x, y, z], quaternion, draws.several::<3>(0.25).map(|d| log_scale + d), logit, &sh);
    }
    let profile = Profile { alpha_max: 0.5, transmittance_min: 0.25, ..Profile::default() };
    let setup = Setup::new(gaussians, profile, &mut draws);
    let found = render(&setup.gaussians, &setup.camera, setup.background, &setup.profile);
    assert!(found.margin.iter().all(|&margin| margin > 0.02), "{:?}", found.margin);
    assert!(found.contributors.iter().all(|&contributors| contributors == 2));
    setup.assert_gradients_are_differences("walls");

    let gradients = setup.gradients();
    let rows: Vec<_> = gradients.geometry.chunks_exact(Gaussians::GEOMETRY).collect();
    for (i, drawn) in [false, true, true, false, false].into_iter().enumerate() {
        assert_eq!(rows[i].iter().any(|&by| by != 0.0), drawn, "wall {i}");
        assert_eq!(gradients.rgb[3 * i..][..3].iter().any(|&by| by != 0.0), drawn, "wall {i}");
    }
    // The clamp lets nothing pass to shape and opacity.
    assert!(rows[1][3..].iter().chain(&gradients.conics[3..6]).all(|&by| by == 0.0));
    assert_eq!(gradients.opacities[1], 0.0);
}

#[test]
fn gradients_are_differences_beyond_the_limit_of_the_slope() {
    // The centres lie outside the picture by more than 15 % of its size; what is seen is their flanks.
    for (seed, [x, y]) in [(41, [-1.5, 0.0]), (42, [1.75, 0.0]), (43, [0.0, 1.5]), (44, [-1.25, -1.5])] {
        let mut setup = Setup::random(seed, Profile { antialias: seed % 2 == 0, ..undecided() });
        for row in setup.gaussians.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY) {
            row[0] = row[0] * 0.125 + x * row[2];
            row[1] = row[1] * 0.125 + y * row[2];
            row[gs_scene::LOG_SCALE].iter_mut().for_each(|log_scale| *log_scale += 1.5);
        }
        for i in 0..setup.gaussians.len() {
            let mean = project(&setup.gaussians, i, &setup.camera, &setup.profile).unwrap().mean;
            for (side, mean, size) in [(x, mean.x, 9.0), (y, mean.y, 7.0)] {
                let outside = (mean / size - 0.5) * f64::from(side.signum());
                assert!(side == 0.0 || outside > 0.66, "{seed} {i}: {mean}");
            }
        }
        setup.assert_gradients_are_differences(&format!("outside {x} {y}"));
    }
}

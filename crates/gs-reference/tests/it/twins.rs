//! The twins of the shader passes, one after another, against the naive renderer; and what each of them promises by itself.

mod ellipsoids;
mod passes;

use crate::golden::cases;
use glam::{DMat3, DVec3, EulerRot};
use gs_reference::chain::{Backward, Forward, View, backward, forward};
use gs_reference::frame::pose_gradient;
use gs_reference::tolerance::{AMBIGUOUS, F32_CANCELLING, TWIN_IMAGE, twin_gradient_bound};
use gs_reference::{PixelGradients, Profile, Reference, Variable, compare, render};
use gs_scene::{Camera, Gaussians, Intrinsics, sh_coefficients};
use proptest::prelude::*;

/// What the passes differentiate by.
const STORED: [Variable; 6] = [
    Variable::Means,
    Variable::Quaternions,
    Variable::LogScales,
    Variable::OpacityLogits,
    Variable::Sh,
    Variable::WorldToCamera,
];

fn gradient(variable: Variable, found: &Backward, camera: &Camera) -> Vec<f64> {
    match variable {
        Variable::Sh => found.stored.sh.iter().map(|&by| by.into()).collect(),
        Variable::WorldToCamera => pose_gradient(&found.stored.pose_sums, camera).to_vec(),
        _ => variable.of_geometry(&found.stored.geometry).expect("a column of the geometry"),
    }
}

/// The worst deviation of the picture, as a multiple of its bound.
fn image_excess(view: &View, found: &Forward, truth: &Reference, masked: &[bool]) -> f64 {
    let n_pixels = truth.alpha.len();
    let (colours, sums) = found.pixels.pixels.split_at(n_pixels * 4);
    let image: Vec<f32> = colours.chunks_exact(4).flat_map(|pixel| pixel[..3].to_vec()).collect();
    let transmittance: Vec<f32> = colours.iter().skip(3).step_by(4).copied().collect();
    let mut planes = vec![(&truth.image, image, 1.0), (&truth.transmittance, transmittance, 1.0)];
    if view.features.depth {
        let (weights, depths) = sums.split_at(n_pixels);
        planes.push((&truth.alpha, weights.to_vec(), 1.0));
        planes.push((&truth.depth_sum, depths.to_vec(), f64::MIN_POSITIVE));
    } else {
        assert!(sums.is_empty(), "depth is paid for only when asked for");
    }
    let excess = planes.into_iter().map(|(expected, found, least)| {
        let deviation = compare(expected.iter().copied(), found, masked).expect("comparable");
        deviation.max_abs / (TWIN_IMAGE * deviation.largest.max(least))
    });
    excess.fold(0.0, f64::max)
}

#[test]
fn the_chain_equals_the_naive_renderer_on_golden_cases() {
    for (name, case) in cases() {
        let view = View::new(&case.gaussians, &case.camera, case.background, &case.profile, true);
        let found = forward(&view);
        let background = case.background.map(f64::from);
        let truth = render(&case.gaussians, &case.camera, background, &case.profile);
        let excess = image_excess(&view, &found, &truth, &case.ambiguous);
        assert!(excess <= 1.0, "{name}: {excess} times the bound");
        for loss in &case.losses {
            let found = backward(&view, &found, &loss.weights);
            let (scene, weights) = (&case.gaussians, &loss.weights);
            let truth = gs_reference::backward(scene, &case.camera, background, &case.profile, weights);
            for golden in loss.gradients.iter().filter(|golden| STORED.contains(&golden.variable)) {
                let found = gradient(golden.variable, &found, &case.camera);
                let deviation = compare(truth.by(golden.variable), found, &[]).unwrap();
                let bound = twin_gradient_bound(&deviation) + F32_CANCELLING * golden.cancelling;
                let of = format!("{name} {}_{}", loss.name, golden.variable.name());
                assert!(deviation.max_abs <= bound, "{of}: {deviation:?}");
            }
        }
    }
}

/// A scene, a camera before it and a loss, as numbers from a seed.
#[derive(Debug, Clone)]
struct Setup {
    gaussians: Gaussians,
    camera: Camera,
    background: [f32; 3],
    profile: Profile,
    depth: bool,
    weights: PixelGradients,
}

impl Setup {
    fn new(
        seed: u64,
        n: usize,
        degree: usize,
        [width, height]: [usize; 2],
        antialias: bool,
        depth: bool,
    ) -> Self {
        let mut state = seed;
        // Numbers of -1..1 that look random.
        let mut draw = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / f32::from_bits(0x4b00_0000) - 1.0
        };
        let focal = 10.0 + 30.0 * f64::from(draw().abs());
        let lens = Intrinsics {
            fx: focal,
            fy: focal * (1.0 + 0.3 * f64::from(draw())),
            cx: width as f64 * (0.5 + 0.3 * f64::from(draw())),
            cy: height as f64 * (0.5 + 0.3 * f64::from(draw())),
            width,
            height,
        };
        let [a, b, c] = [draw(), draw(), draw()].map(|angle| 3.0 * f64::from(angle));
        let rotation = DMat3::from_euler(EulerRot::XYZ, a, b, c);
        let position = DVec3::new(draw().into(), draw().into(), draw().into()) * 20.0;
        let camera = Camera::new(lens, rotation, -(rotation * position)).expect("a camera");
        let mut gaussians = Gaussians::empty(degree).expect("a degree");
        for _ in 0..n {
            // In and around the picture; one in ten behind the camera.
            let z = 4.0 + 4.4 * f64::from(draw());
            let pixel = [width, height].map(|size| size as f64 * (0.5 + 0.8 * f64::from(draw())));
            let mean = camera.unproject(pixel.into(), z).as_vec3().to_array();
            let size = draw() - 1.0;
            let log_scale = std::array::from_fn(|_| size + 2.0 * draw());
            let sh: Vec<f32> = (0..sh_coefficients(degree) * 3).map(|_| draw()).collect();
            let quaternion = std::array::from_fn(|_| 2.0 * draw());
            gaussians.push(mean, quaternion, log_scale, 6.0 * draw(), &sh);
        }
        let mut weights = |numbers: usize| (0..numbers).map(|_| f64::from(draw())).collect::<Vec<_>>();
        let pixels = width * height;
        Self {
            gaussians,
            camera,
            background: [0.25, 0.5, 0.75],
            profile: Profile { antialias, ..Profile::default() },
            depth,
            weights: PixelGradients {
                image: weights(pixels * 3),
                alpha: weights(pixels),
                depth_sum: if depth { weights(pixels) } else { vec![0.0; pixels] },
            },
        }
    }

    fn view(&self) -> View {
        let Self { gaussians, camera, background, profile, depth, .. } = self;
        View::new(gaussians, camera, *background, profile, *depth)
    }

    /// The worst deviation of the chain of `view` from the naive renderer, as a multiple of its bound. Pixels in which f32 may
    /// decide otherwise take no part.
    fn excess(&self, view: &View) -> f64 {
        let (scene, camera, background) = (&self.gaussians, &self.camera, self.background.map(f64::from));
        let truth = render(scene, camera, background, &self.profile);
        let masked: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        if masked.iter().all(|&masked| masked) {
            return 0.0;
        }
        let rendered = forward(view);
        let image = image_excess(view, &rendered, &truth, &masked);
        let mut weights = self.weights.clone();
        for pixel in (0..masked.len()).filter(|&pixel| masked[pixel]) {
            weights.image[3 * pixel..][..3].fill(0.0);
            weights.alpha[pixel] = 0.0;
            weights.depth_sum[pixel] = 0.0;
        }
        let found = backward(view, &rendered, &weights);
        let truth = gs_reference::backward(scene, camera, background, &self.profile, &weights);
        let gradients = STORED.into_iter().map(|variable| {
            let found = gradient(variable, &found, camera);
            let Ok(deviation) = compare(truth.by(variable), found, &[]) else {
                assert!(self.gaussians.is_empty() && variable != Variable::WorldToCamera, "{variable:?}");
                return 0.0;
            };
            deviation.max_abs / twin_gradient_bound(&deviation)
        });
        gradients.fold(image, f64::max)
    }
}

fn setups() -> impl Strategy<Value = Setup> {
    let sizes = prop::array::uniform2(1usize..40);
    (any::<u64>(), 0usize..12, 0usize..4, sizes, any::<bool>(), any::<bool>()).prop_map(
        |(seed, n, degree, size, antialias, depth)| Setup::new(seed, n, degree, size, antialias, depth),
    )
}

proptest! {
    #[test]
    fn the_chain_equals_the_naive_renderer(setup in setups()) {
        let excess = setup.excess(&setup.view());
        prop_assert!(excess <= 1.0, "{excess} times the bound");
    }
}

#[test]
fn a_mutant_is_noticed() {
    let setup = Setup::new(1, 8, 2, [33, 20], true, true);
    assert!(setup.excess(&setup.view()) <= 1.0);
    for column in 0..11 {
        let mut view = setup.view();
        for row in view.geometry.chunks_exact_mut(11) {
            row[column] += 1e-2;
        }
        assert!(setup.excess(&view) > 1.0, "column {column}");
    }
    let mut view = setup.view();
    view.sh.iter_mut().for_each(|coefficient| *coefficient += 1e-2);
    assert!(setup.excess(&view) > 1.0, "sh");
    view = setup.view();
    view.frame.pose[0][3] += 1e-2;
    assert!(setup.excess(&view) > 1.0, "pose");
}

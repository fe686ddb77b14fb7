//! The self-test of an adapter: a tiny scene, far from the world's origin, is compared with the result of gs-reference.

use super::context::Gpu;
use crate::{Error, PixelGradients, RenderSettings, Result};
use glam::{DMat3, DVec3, EulerRot};
use gs_scene::{Camera, Gaussians, Intrinsics};

/// Image `[h, w, 3]`, alpha `[h, w]`, depth `[h, w]`, then the gradients by geometry `[N, 11]`, SH `[N, 4, 3]`, and
/// world-to-camera matrix `[3, 4]`: f32, little endian. Written by the test below.
const EXPECTED: &[u8] = include_bytes!("../../data/self_test.f32");

/// Pictures may be off by this, relative to the largest value. Drivers round functions differently, by 1e-6; without the low
/// parts of the camera, or where a compiler removes the roundings of `two_float.wgsl`, the image is off by 2e-3 to 3e-3.
const PICTURE: f32 = 2e-5;
/// Gradients may be off by this, relative to the largest value of their kind.
const GRADIENT: f32 = 1e-4;

const WIDTH: usize = 37;
const HEIGHT: usize = 21;
const SH_DEGREE: usize = 1;
const N: usize = 12;

impl Gpu {
    /// Renders and differentiates the scene.
    pub(super) fn self_test(&mut self) -> Result<()> {
        let (scene, camera, settings) = scene();
        let (views, tape) = self.record(&scene, &[camera], &settings)?;
        let mut gradients = crate::Gradients::default();
        gradients.clear(scene.len(), scene.sh_degree());
        self.backward(&tape, &[camera], &[loss()], &mut gradients)?;
        let (view, pose) = (&views[0], gradients.cameras[0]);
        // What is not recorded and has no depth goes another way through the shaders.
        let plain = self.render(&scene, &[camera], &RenderSettings { depth: false, ..settings })?;
        let depth = view.depth.as_deref().unwrap_or_default();
        let matrix: Vec<f32> = (0..3)
            .flat_map(|row| {
                let [x, y, z] = pose.rotation.row(row).to_array();
                [x, y, z, pose.translation[row]].map(|value| value as f32)
            })
            .collect();
        let found: [(&str, &[f32], f32); 6] = [
            ("image", view.image.data(), PICTURE),
            ("alpha", &view.alpha, PICTURE),
            ("depth", depth, PICTURE),
            ("the gradient by geometry", &gradients.geometry, GRADIENT),
            ("the gradient by SH coefficients", &gradients.sh, GRADIENT),
            ("the gradient by the pose", &matrix, GRADIENT),
        ];
        let wrong = judged(&found, EXPECTED)
            .or_else(|| judged(&[("the image alone", plain[0].image.data(), PICTURE)], EXPECTED));
        match wrong {
            None => Ok(()),
            Some((output, found, allowed)) => {
                Err(Error::SelfTest { adapter: self.about.name.clone(), output, found, allowed })
            }
        }
    }
}

/// The first output that is off by more than it may be, by how much relative to the largest value, and how much it may be.
fn judged<'a>(found: &[(&'a str, &[f32], f32)], expected: &[u8]) -> Option<(&'a str, f32, f32)> {
    let mut expected = expected.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    found.iter().find_map(|&(output, found, allowed)| {
        let (mut largest, mut worst) = (f32::MIN_POSITIVE, 0.0f32);
        for &found in found {
            let expected = expected.next().unwrap_or(f32::NAN);
            largest = largest.max(expected.abs());
            // What is not a number is as wrong as can be.
            let miss = (found - expected).abs();
            worst = if miss <= f32::MAX { worst.max(miss) } else { f32::INFINITY };
        }
        (worst > allowed * largest).then_some((output, worst / largest, allowed))
    })
}

/// A dozen Gaussians of all shapes before a camera ten thousand units from the world's origin.
fn scene() -> (Gaussians, Camera, RenderSettings) {
    let lens = Intrinsics { fx: 31.0, fy: 29.5, cx: 17.25, cy: 11.5, width: WIDTH, height: HEIGHT };
    let position = DVec3::new(10_000.0, -7_000.0, 4_000.0);
    let rotation = DMat3::from_euler(EulerRot::XYZ, 0.4, -0.7, 0.2);
    let camera = Camera::new(lens, rotation, -(rotation * position)).expect("a rotation and finite numbers");
    let mut state = 3u32;
    let mut uniform = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut scene = Gaussians::empty(SH_DEGREE).expect("degree 1 exists");
    for i in 0..N {
        let z = 3.0 + 0.4 * ((i * 5) % N) as f64;
        let place = DVec3::new(z * f64::from(uniform() - 0.5), 0.6 * z * f64::from(uniform() - 0.5), z);
        let mean = camera.to_world(place).as_vec3().to_array();
        let quaternion = [0; 4].map(|_| uniform() - 0.5);
        let log_scale = [0; 3].map(|_| -3.5 + 3.0 * uniform());
        let sh: Vec<f32> = (0..12).map(|k| (uniform() - 0.4) * if k < 3 { 2.0 } else { 0.5 }).collect();
        scene.push(mean, quaternion, log_scale, 5.0 * uniform() - 1.5, &sh);
    }
    let settings = RenderSettings {
        background: [0.2, 0.4, 0.1],
        near: 0.1,
        depth: true,
        antialias: true,
        ..RenderSettings::default()
    };
    (scene, camera, settings)
}

/// Any loss that looks at every pixel.
fn loss() -> PixelGradients<'static> {
    let weight = |i: usize| ((i * 7919) % 13) as f32 / 6.0 - 1.0;
    PixelGradients {
        image: (0..WIDTH * HEIGHT * 3).map(weight).collect(),
        alpha: Some((0..WIDTH * HEIGHT).map(|i| 0.5 * weight(i + 5)).collect()),
        depth: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_reference::tolerance::AMBIGUOUS;
    use gs_reference::{Profile, Variable};

    /// The embedded result is what gs-reference makes of the scene; with `UPDATE` set in the environment it is written.
    #[test]
    fn the_embedded_result_is_that_of_the_reference() {
        let (scene, camera, settings) = scene();
        let profile = Profile { near: f64::from(settings.near), antialias: true, ..Profile::default() };
        let background = settings.background.map(f64::from);
        let truth = gs_reference::render(&scene, &camera, background, &profile);
        assert!(
            truth.margin.iter().all(|&margin| margin > AMBIGUOUS),
            "a pixel may be decided otherwise in f32"
        );
        let double = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        let loss = loss();
        let pixels = gs_reference::PixelGradients {
            image: double(&loss.image),
            alpha: double(&loss.alpha.unwrap()),
            depth_sum: vec![0.0; WIDTH * HEIGHT],
        };
        let gradients = gs_reference::backward(&scene, &camera, background, &profile, &pixels);
        let numbers = [
            truth.image,
            truth.alpha,
            truth.depth,
            gradients.geometry.clone(),
            gradients.by(Variable::Sh),
            gradients.by(Variable::WorldToCamera),
        ]
        .concat();
        let bytes: Vec<u8> = numbers.iter().flat_map(|&value| (value as f32).to_le_bytes()).collect();
        if std::env::var_os("UPDATE").is_some() {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data/self_test.f32");
            gs_scene::write_atomically(&path, |file| file.write_all(&bytes)).unwrap();
        } else {
            // Not bit for bit: functions of the standard library differ between systems in the last one.
            assert_eq!(bytes.len(), EXPECTED.len(), "run this test with UPDATE=1");
            for (found, expected) in numbers.iter().zip(EXPECTED.chunks_exact(4)) {
                let expected = f64::from(f32::from_le_bytes(expected.try_into().unwrap()));
                assert!(
                    (found - expected).abs() <= 1e-6 * expected.abs().max(1e-3),
                    "run this test with UPDATE=1"
                );
            }
        }
    }

    #[test]
    fn what_is_off_or_not_a_number_is_told() {
        let expected: Vec<u8> = [1.0f32, -2.0, 4.0, 0.5].into_iter().flat_map(f32::to_le_bytes).collect();
        let judge = |first: [f32; 3], second: f32| {
            judged(&[("first", &first, 1e-3), ("second", &[second], 1e-3)], &expected)
        };
        assert_eq!(judge([1.0, -2.003, 4.0], 0.5), None);
        assert_eq!(judge([1.0, -2.0, 4.0], 0.5004), None);
        assert!(matches!(judge([1.0, -2.005, 4.0], 0.5), Some(("first", found, 1e-3)) if found > 1e-3));
        assert!(matches!(judge([1.0, -2.0, 4.0], 0.501), Some(("second", ..))));
        assert_eq!(judge([1.0, f32::NAN, 4.0], 0.5), Some(("first", f32::INFINITY, 1e-3)));
        assert_eq!(judge([1.0, -2.0, f32::NEG_INFINITY], 0.5), Some(("first", f32::INFINITY, 1e-3)));
    }
}

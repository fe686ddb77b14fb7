use crate::Profile;
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Camera, Gaussians, Intrinsics};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;

/// A golden case: inputs of a rendering and its outputs, from a file in the layout of `fixtures/gs-raster`.
#[derive(Debug, Clone)]
pub struct Case {
    /// The scene.
    pub gaussians: Gaussians,
    /// The camera.
    pub camera: Camera,
    /// Colour behind the scene.
    pub background: [f32; 3],
    /// Thresholds.
    pub profile: Profile,
    /// Pixels in which f32 may take another decision than f64, `[height, width]`.
    pub ambiguous: Vec<bool>,
    /// Deviation of plain f32 from the golden image outside ambiguous pixels, if the file tells it.
    pub f32_image_floor: Option<f64>,
    /// The golden outputs.
    pub expected: Expected,
}

/// Golden outputs of a case: `[height, width]`, f32 values unless said otherwise; fields as in
/// [`Reference`](crate::Reference).
#[derive(Debug, Clone)]
#[expect(missing_docs, reason = "named as the fields of Reference and Projected")]
pub struct Expected {
    pub image: Vec<f64>,
    pub alpha: Vec<f64>,
    pub transmittance: Vec<f64>,
    pub depth_sum: Vec<f64>,
    pub depth: Vec<f64>,
    pub contributors: Vec<i32>,
    pub last: Vec<i32>,
    /// Indices of the Gaussians between near and far, near to far.
    pub order: Vec<i32>,
    /// Per Gaussian of the scene, zero where not between near and far: f64.
    pub means: Vec<f64>,
    pub conics: Vec<f64>,
    pub rgb: Vec<f64>,
    pub opacities: Vec<f64>,
}

impl Case {
    /// Reads a case.
    ///
    /// # Panics
    /// If the file cannot be read or is not of that layout; the message names the tensor.
    #[must_use]
    pub fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let tensors = SafeTensors::deserialize(&bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let numbers = |name: &str| -> Vec<f64> { numbers(&tensor(&tensors, name), name) };
        let singles = |name: &str| -> Vec<f32> { numbers(name).into_iter().map(|v| v as f32).collect() };
        let integers = |name: &str| -> Vec<i32> { numbers(name).into_iter().map(|v| v as i32).collect() };

        let (means, quats, scales) = (singles("means"), singles("quats"), singles("log_scales"));
        let mut geometry = Vec::new();
        for (i, logit) in singles("opacity_logits").into_iter().enumerate() {
            geometry.extend_from_slice(&means[3 * i..3 * i + 3]);
            geometry.extend_from_slice(&quats[4 * i..4 * i + 4]);
            geometry.extend_from_slice(&scales[3 * i..3 * i + 3]);
            geometry.push(logit);
        }
        let coefficients = tensor(&tensors, "sh").shape()[1];
        let gaussians = Gaussians::new(coefficients.isqrt() - 1, geometry, singles("sh")).expect("a scene");

        let (view, lens, size) = (numbers("viewmat"), numbers("K"), integers("size_wh"));
        let intrinsics = Intrinsics {
            fx: lens[0],
            fy: lens[4],
            cx: lens[2],
            cy: lens[5],
            width: size[0] as usize,
            height: size[1] as usize,
        };
        let row = |i: usize| DVec3::new(view[4 * i], view[4 * i + 1], view[4 * i + 2]);
        let rotation = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let translation = DVec3::new(view[3], view[7], view[11]);
        let config = numbers("config");
        let (gaussians, rotation) =
            if config[8] == 0.0 { (gaussians, rotation) } else { cycled(gaussians, rotation) };
        Self {
            gaussians,
            camera: Camera::new(intrinsics, rotation, translation).expect("a camera"),
            background: singles("background").try_into().expect("three channels"),
            profile: Profile {
                near: config[0],
                far: config[1],
                eps2d: config[2],
                alpha_max: config[3],
                alpha_min: config[4],
                transmittance_min: config[5],
                antialias: config[6] != 0.0,
                compensation_min: config[7],
            },
            ambiguous: numbers("ambiguous").into_iter().map(|v| v != 0.0).collect(),
            f32_image_floor: image_floor(&bytes),
            expected: Expected {
                image: numbers("out_image"),
                alpha: numbers("out_alpha"),
                transmittance: numbers("out_T_final"),
                depth_sum: numbers("out_depth_acc"),
                depth: numbers("out_depth_exp"),
                contributors: integers("out_n_contrib"),
                last: integers("out_last_id"),
                order: integers("mid_order"),
                means: numbers("mid_means2d"),
                conics: numbers("mid_conics"),
                rgb: numbers("mid_colors"),
                opacities: numbers("mid_opacities"),
            },
        }
    }
}

/// Scene and camera in a world whose (x, y, z) are the old (z, x, y). Coefficients whose basis was evaluated at cycled
/// axes (the e3nn convention) are those of the standard basis there, and the picture is the same.
fn cycled(mut gaussians: Gaussians, rotation: DMat3) -> (Gaussians, DMat3) {
    let turn = DQuat::from_xyzw(0.5, 0.5, 0.5, 0.5);
    for row in gaussians.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY) {
        row[..3].rotate_right(1);
        let [w, x, y, z] = [row[3], row[4], row[5], row[6]].map(f64::from);
        let q = turn * DQuat::from_xyzw(x, y, z, w);
        row[3..7].copy_from_slice(&[q.w, q.x, q.y, q.z].map(|value| value as f32));
    }
    (gaussians, DMat3::from_cols(rotation.z_axis, rotation.x_axis, rotation.y_axis))
}

fn tensor<'a>(tensors: &SafeTensors<'a>, name: &str) -> TensorView<'a> {
    tensors.tensor(name).unwrap_or_else(|error| panic!("tensor {name}: {error}"))
}

/// The values of a tensor of any type that the layout uses.
fn numbers(tensor: &TensorView, name: &str) -> Vec<f64> {
    fn each<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        bytes.chunks_exact(N).map(|b| value(b.try_into().expect("N bytes"))).collect()
    }
    let bytes = tensor.data();
    match tensor.dtype() {
        Dtype::F64 => each(bytes, f64::from_le_bytes),
        Dtype::F32 => each(bytes, |b| f64::from(f32::from_le_bytes(b))),
        Dtype::I32 => each(bytes, |b| f64::from(i32::from_le_bytes(b))),
        Dtype::U8 => each(bytes, |[b]| f64::from(b)),
        other => panic!("tensor {name} has type {other:?}"),
    }
}

/// `image_unambiguous` of the file's `f32_naive` metadata, which is JSON within a string.
fn image_floor(bytes: &[u8]) -> Option<f64> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).expect("the header was read before");
    let floors = metadata.metadata().as_ref()?.get("f32_naive")?;
    let floors: serde_json::Value = serde_json::from_str(floors).expect("f32_naive is JSON");
    floors["image_unambiguous"].as_f64()
}

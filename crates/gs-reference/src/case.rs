//! Golden cases from files.

mod axes;
mod tensors;

use crate::{Error, PixelGradients, Profile, Result, ShAxes, Variable};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Gaussians, Intrinsics};
use std::path::Path;
use tensors::Tensors;

/// A golden case: inputs of a rendering, its outputs and its gradients, from a file in the layout of
/// `fixtures/gs-raster`.
#[derive(Debug, Clone)]
pub struct Case {
    /// The scene.
    pub gaussians: Gaussians,
    /// The camera.
    pub camera: Camera,
    /// Colour behind the scene.
    pub background: [f32; 3],
    /// Thresholds and axes.
    pub profile: Profile,
    /// Pixels in which f32 may take another decision than f64, `[height, width]`. No loss looks at them.
    pub ambiguous: Vec<bool>,
    /// Deviation of plain f32 from the golden image outside ambiguous pixels, if the file tells it.
    pub f32_image_floor: Option<f64>,
    /// The golden outputs.
    pub expected: Expected,
    /// The loss on image and alpha, and the loss on the sum of depths.
    pub losses: [Loss; 2],
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

/// A weighted sum of the pixels of a rendering, and its golden gradients.
#[derive(Debug, Clone)]
pub struct Loss {
    /// What the file calls its gradients before the variable: `grad` or `graddepth`.
    pub name: &'static str,
    /// The weights, which are the derivatives by the pixels.
    pub weights: PixelGradients,
    /// The loss.
    pub value: f64,
    /// Its gradients, f64. Those of no numbers (of a scene without Gaussians) are left out.
    pub gradients: Vec<GoldenGradient>,
}

/// The golden gradient by one variable.
#[derive(Debug, Clone)]
pub struct GoldenGradient {
    /// What the derivative is taken by.
    pub variable: Variable,
    /// The derivatives, row-major.
    pub values: Vec<f64>,
    /// Deviation of plain f32 relative to the largest value (see [`tolerance`](crate::tolerance)), if the file tells it.
    pub f32_floor: Option<f64>,
    /// Largest magnitude of the terms that cancel where the gradient is 0 by symmetry: a round Gaussian looks the same
    /// however it is turned. 0 where there is no such symmetry.
    pub cancelling: f64,
}

impl Case {
    /// Reads a case.
    ///
    /// # Errors
    /// If the file cannot be read or is not of that layout; the message names the file, and the tensor or the rule.
    pub fn read(file: &Path) -> Result<Self> {
        let bytes = std::fs::read(file).map_err(|source| Error::Read { file: file.into(), source })?;
        let tensors = Tensors::new(file, &bytes)?;
        let gaussians = gaussians(&tensors)?;
        let camera = camera(&tensors)?;
        let (n, height, width) = (gaussians.len(), camera.height(), camera.width());
        let (plane, visible) = ([height, width], tensors.dimension("mid_order", 0)?);
        let channels = [height, width, 3];
        let losses = tensors.numbers("loss", &[2])?;
        let zeros = |channels: usize| vec![0.0; height * width * channels];
        let of_image = PixelGradients {
            image: tensors.numbers("W1", &channels)?,
            alpha: tensors.numbers("W2", &plane)?,
            depth_sum: zeros(1),
        };
        let of_depth =
            PixelGradients { image: zeros(3), alpha: zeros(1), depth_sum: tensors.numbers("W3", &plane)? };
        Ok(Self {
            background: array(tensors.singles("background", &[3])?),
            profile: profile(&tensors)?,
            ambiguous: tensors.numbers("ambiguous", &plane)?.into_iter().map(|v| v != 0.0).collect(),
            f32_image_floor: tensors.floor("image_unambiguous"),
            expected: Expected {
                image: tensors.numbers("out_image", &channels)?,
                alpha: tensors.numbers("out_alpha", &plane)?,
                transmittance: tensors.numbers("out_T_final", &plane)?,
                depth_sum: tensors.numbers("out_depth_acc", &plane)?,
                depth: tensors.numbers("out_depth_exp", &plane)?,
                contributors: tensors.integers("out_n_contrib", &plane)?,
                last: tensors.integers("out_last_id", &plane)?,
                order: tensors.integers("mid_order", &[visible])?,
                means: tensors.numbers("mid_means2d", &[n, 2])?,
                conics: tensors.numbers("mid_conics", &[n, 3])?,
                rgb: tensors.numbers("mid_colors", &[n, 3])?,
                opacities: tensors.numbers("mid_opacities", &[n])?,
            },
            losses: [
                loss(&tensors, "grad", &Variable::ALL, &gaussians, of_image, losses[0])?,
                loss(&tensors, "graddepth", &OF_DEPTH, &gaussians, of_depth, losses[1])?,
            ],
            gaussians,
            camera,
        })
    }
}

/// The variables by which the golden data differentiate the loss on depth.
const OF_DEPTH: [Variable; 5] = [
    Variable::Means,
    Variable::Quaternions,
    Variable::LogScales,
    Variable::OpacityLogits,
    Variable::WorldToCamera,
];

fn array<T, const N: usize>(numbers: Vec<T>) -> [T; N] {
    numbers.try_into().unwrap_or_else(|_| unreachable!("the shape was checked"))
}

fn gaussians(tensors: &Tensors) -> Result<Gaussians> {
    let n = tensors.dimension("means", 0)?;
    let columns = [("means", 3), ("quats", 4), ("log_scales", 3)]
        .map(|(tensor, width)| Ok((tensors.singles(tensor, &[n, width])?, width)));
    let [means, quats, scales] = columns;
    let columns = [means?, quats?, scales?, (tensors.singles("opacity_logits", &[n])?, 1)];
    let geometry = (0..n)
        .flat_map(|i| columns.iter().flat_map(move |(values, width)| &values[i * width..][..*width]))
        .copied()
        .collect();
    let coefficients = tensors.dimension("sh", 1)?;
    let degree = (0..4)
        .find(|&degree| gs_scene::sh_coefficients(degree) == coefficients)
        .ok_or_else(|| Error::ShCoefficients { file: tensors.file(), found: coefficients })?;
    let sh = tensors.singles("sh", &[n, coefficients, 3])?;
    Ok(Gaussians::new(degree, geometry, sh).expect("the shapes were checked"))
}

fn camera(tensors: &Tensors) -> Result<Camera> {
    let (view, lens) = (tensors.numbers("viewmat", &[4, 4])?, tensors.numbers("K", &[3, 3])?);
    let fixed = [("viewmat", &view, 12, 0.0), ("viewmat", &view, 13, 0.0), ("viewmat", &view, 14, 0.0)];
    let affine = [("viewmat", &view, 15, 1.0), ("K", &lens, 1, 0.0), ("K", &lens, 3, 0.0)];
    let pinhole = [("K", &lens, 6, 0.0), ("K", &lens, 7, 0.0), ("K", &lens, 8, 1.0)];
    for (tensor, numbers, index, expected) in fixed.into_iter().chain(affine).chain(pinhole) {
        if numbers[index] != expected {
            let expected = if expected == 0.0 { "0" } else { "1" };
            return Err(value(tensors, tensor, index, numbers[index], expected));
        }
    }
    let size = tensors.numbers("size_wh", &[2])?;
    for (index, &found) in size.iter().enumerate() {
        if found < 1.0 {
            return Err(value(tensors, "size_wh", index, found, "at least 1"));
        }
    }
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
    Camera::new(intrinsics, rotation, translation)
        .map_err(|source| Error::Camera { file: tensors.file(), source })
}

fn profile(tensors: &Tensors) -> Result<Profile> {
    let config = tensors.numbers("config", &[9])?;
    let switch = |index: usize| match config[index] {
        0.0 => Ok(false),
        1.0 => Ok(true),
        found => Err(value(tensors, "config", index, found, "0 or 1")),
    };
    if let Some(index) = config.iter().position(|number| !number.is_finite()) {
        return Err(value(tensors, "config", index, config[index], "a finite number"));
    }
    Ok(Profile {
        near: config[0],
        far: config[1],
        eps2d: config[2],
        alpha_max: config[3],
        alpha_min: config[4],
        transmittance_min: config[5],
        antialias: switch(6)?,
        compensation_min: config[7],
        sh_axes: if switch(8)? { ShAxes::E3nn } else { ShAxes::Standard },
    })
}

fn value(tensors: &Tensors, tensor: &str, index: usize, found: f64, expected: &'static str) -> Error {
    Error::Value { file: tensors.file(), tensor: tensor.into(), index, found, expected }
}

fn loss(
    tensors: &Tensors,
    name: &'static str,
    variables: &[Variable],
    gaussians: &Gaussians,
    weights: PixelGradients,
    value: f64,
) -> Result<Loss> {
    let n = gaussians.len();
    let read = |variable: Variable| -> Result<Vec<f64>> {
        let tensor = format!("{name}_{}", variable.name());
        let shape: &[usize] = match variable {
            Variable::Means | Variable::LogScales | Variable::Conics | Variable::Rgb => &[n, 3],
            Variable::Quaternions => &[n, 4],
            Variable::Means2d => &[n, 2],
            Variable::OpacityLogits | Variable::Opacities => &[n],
            Variable::Sh => &[n, gs_scene::sh_coefficients(gaussians.sh_degree()), 3],
            Variable::Background => &[3],
            Variable::Twist => &[6],
            // Its last row is that of no variable.
            Variable::WorldToCamera => &[4, 4],
        };
        let mut values = tensors.numbers(&tensor, shape)?;
        if variable == Variable::WorldToCamera {
            values.truncate(12);
        }
        Ok(values)
    };
    let mut gradients = Vec::new();
    for &variable in variables {
        let values = read(variable)?;
        let cancelling = match variable {
            Variable::Quaternions => turning(gaussians, &read(Variable::LogScales)?),
            _ => 0.0,
        };
        let f32_floor = tensors.floor(&format!("{name}_{}", variable.name()));
        if !values.is_empty() {
            gradients.push(GoldenGradient { variable, values, f32_floor, cancelling });
        }
    }
    Ok(Loss { name, weights, value, gradients })
}

/// The largest gradient by a log scale over the norm of the quaternion: what turning a Gaussian could change if the
/// changes along its axes did not cancel.
fn turning(gaussians: &Gaussians, by_log_scales: &[f64]) -> f64 {
    let rows = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).zip(by_log_scales.chunks_exact(3));
    rows.map(|(row, by)| {
        let norm = row[gs_scene::QUATERNION].iter().map(|&q| f64::from(q).powi(2)).sum::<f64>().sqrt();
        let largest = by.iter().fold(0.0f64, |largest, by| largest.max(by.abs()));
        if norm > 0.0 { largest / norm } else { 0.0 }
    })
    .fold(0.0, f64::max)
}

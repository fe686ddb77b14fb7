//! Random losses on pictures, for the renderer and for the reference; shared with the example `hard_cases`.

use crate::check::{Row, by};
use gs_raster::{Gradients, PixelGradients};
use gs_reference::tolerance::{F32_ABSOLUTE, F32_RANDOM_GRADIENT};
use gs_reference::{Deviation, Mismatch, Profile, Reference, Variable, compare};
use gs_scene::{Camera, Gaussians};

/// A number in -1..1 of a seed and a place.
pub(crate) fn noise(seed: u64, place: usize) -> f32 {
    let mut x = seed ^ (place as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (x >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}

/// Random gradients by the pixels of a view; zero where f32 may take another decision than f64. Those by depth are small
/// where little is drawn: of a faint layer it hangs on the last bits.
pub(crate) fn pixels(seed: u64, ambiguous: &[bool], alpha: &[f64]) -> PixelGradients<'static> {
    let plane = |channel: u64| -> Vec<f32> {
        let values = ambiguous.iter().enumerate();
        values.map(|(i, &skip)| if skip { 0.0 } else { noise(seed ^ channel << 50, i) }).collect()
    };
    let rgb = [plane(0), plane(1), plane(2)];
    PixelGradients {
        image: (0..ambiguous.len()).flat_map(|i| [rgb[0][i], rgb[1][i], rgb[2][i]]).collect(),
        alpha: Some(plane(3)),
        depth: Some(plane(4).iter().zip(alpha).map(|(value, &alpha)| value * alpha as f32).collect()),
    }
}

/// What the reference, which knows of Σ w z but not of Σ w z / alpha, is to be given instead.
fn of_reference(pixels: &PixelGradients, truth: &Reference) -> gs_reference::PixelGradients {
    let double = |values: &[f32]| values.iter().map(|&value| f64::from(value)).collect::<Vec<f64>>();
    let mut found = gs_reference::PixelGradients {
        image: double(&pixels.image),
        alpha: double(pixels.alpha.as_ref().expect("given")),
        depth_sum: double(pixels.depth.as_ref().expect("given")),
    };
    for (i, sum) in found.depth_sum.iter_mut().enumerate() {
        if truth.alpha[i] > 0.0 {
            *sum /= truth.alpha[i];
            found.alpha[i] -= *sum * truth.depth[i];
        } else {
            *sum = 0.0;
        }
    }
    found
}

/// Eight parts of which each has every eighth pixel.
fn parts(pixels: &gs_reference::PixelGradients) -> [gs_reference::PixelGradients; 8] {
    std::array::from_fn(|part| {
        let of = |plane: &[f64], channels: usize| -> Vec<f64> {
            let values = plane.iter().enumerate();
            values.map(|(i, &value)| if i / channels % 8 == part { value } else { 0.0 }).collect()
        };
        gs_reference::PixelGradients {
            image: of(&pixels.image, 3),
            alpha: of(&pixels.alpha, 1),
            depth_sum: of(&pixels.depth_sum, 1),
        }
    })
}

/// The gradients by one variable beside those of the reference.
pub(crate) struct Compared {
    pub(crate) variable: Variable,
    pub(crate) deviation: Result<Deviation, Mismatch>,
    /// Largest sum of the magnitudes that parts of the picture add. Pixels cancel each other by chance, and rounding does not.
    pub(crate) magnitude: f64,
}

/// Gradients beside those of the reference, given its picture of the scene and the gradients by the pixels.
pub(crate) fn compare_gradients(
    scene: &Gaussians,
    camera: &Camera,
    background: [f32; 3],
    profile: &Profile,
    truth: &Reference,
    pixels: &PixelGradients,
    found: &Gradients,
) -> Vec<Compared> {
    let background = background.map(f64::from);
    let parts = parts(&of_reference(pixels, truth))
        .map(|pixels| gs_reference::backward(scene, camera, background, profile, &pixels));
    let variables = Variable::ALL.into_iter().filter_map(|variable| {
        let found = by(found, variable, camera)?;
        (!found.is_empty()).then_some((variable, found))
    });
    variables
        .map(|(variable, found)| {
            let (mut expected, mut magnitude) = (vec![0.0; found.len()], vec![0.0f64; found.len()]);
            for part in &parts {
                for (i, value) in part.by(variable).into_iter().enumerate() {
                    expected[i] += value;
                    magnitude[i] += value.abs();
                }
            }
            let magnitude = magnitude.into_iter().fold(0.0, f64::max);
            Compared { variable, deviation: compare(expected, found, &[]), magnitude }
        })
        .collect()
}

impl Compared {
    pub(crate) fn row(self) -> Row {
        let bound = (F32_RANDOM_GRADIENT * self.magnitude).max(F32_ABSOLUTE);
        Row { output: self.variable.name().to_owned(), deviation: self.deviation, bound }
    }
}

//! Scenes as the pipeline makes them: the demo's photographs, reconstructed with several budgets.

use crate::failure::{Failure, OrFail, Outcome};
use evaluate::{Method, Runner, Step};
use gs_raster::Rasterizer;
use gs_scene::{Gaussians, sh_coefficients};
use scene_windows::Window;
use serde::{Serialize, Serializer};
use sparsesplat::{Allocation, Budget, Config, Head};

/// How many Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Count {
    /// So many, by entropy.
    Gaussians(usize),
    /// One for each pixel of the photographs that has a depth.
    Pixels,
}

/// As on the command line.
impl Serialize for Count {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Gaussians(count) => serializer.serialize_u64(*count as u64),
            Self::Pixels => serializer.serialize_str(PIXELS),
        }
    }
}

const PIXELS: &str = "pixels";

/// A count, or `pixels`.
pub(super) fn count(text: &str) -> Result<Count, String> {
    if text == PIXELS { Ok(Count::Pixels) } else { crate::arguments::gaussians(text).map(Count::Gaussians) }
}

/// The window's scene with a budget, of SH degree 0. One Gaussian per pixel is the paper's baseline, without a far shell.
pub(super) fn reconstruct(
    window: &Window,
    count: Count,
    on_step: &mut dyn FnMut(Step),
) -> Outcome<Gaussians> {
    let closed_form = Config { head: Head::ClosedForm, looks: 1, ..Config::default() };
    let config = match count {
        Count::Gaussians(n) => Config { budget: Budget::Gaussians(n), ..closed_form },
        Count::Pixels => Config { allocation: Allocation::PixelAligned, far_shell: false, ..closed_form },
    };
    let runner = Runner::new(Method::feed_forward(config)).map_err(Failure::sorted)?;
    let outcome = runner.reconstruct(window, &mut Rasterizer::cpu(), on_step).map_err(Failure::sorted)?;
    Ok(outcome.prediction.gaussians)
}

/// The scene with SH of a degree. The head gives degree 0: coefficients above it are filled with small numbers that depend
/// on their place alone, so that colours change with the direction and every coefficient is evaluated.
pub(super) fn with_sh_degree(scene: &Gaussians, degree: usize) -> Outcome<Gaussians> {
    let numbers = sh_coefficients(degree) * 3;
    let mut sh = Vec::with_capacity(scene.len() * numbers);
    for (i, colour) in scene.sh().chunks_exact(sh_coefficients(scene.sh_degree()) * 3).enumerate() {
        sh.extend_from_slice(&colour[..3]);
        sh.extend((3..numbers).map(|j| small(i * numbers + j)));
    }
    Gaussians::new(degree, scene.geometry().to_vec(), sh).or_work()
}

/// A number in ±0.025, by multiplicative hashing.
fn small(place: usize) -> f32 {
    let bits = (place as u32).wrapping_mul(0x9e37_79b9) >> 8;
    (bits as f32 / (1 << 24) as f32 - 0.5) * 0.05
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_numbers_or_pixels() {
        assert_eq!(count("40k"), Ok(Count::Gaussians(40_000)));
        assert_eq!(count("pixels"), Ok(Count::Pixels));
        assert!(count("pixel").is_err() && count("0").is_err());
    }

    #[test]
    fn a_lifted_scene_keeps_its_colour_and_has_no_zero_above_it() {
        let mut scene = Gaussians::empty(0).unwrap();
        for red in [0.25, 0.75] {
            scene.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[red, 0.5, -0.5]);
        }
        for degree in 0..=3 {
            let lifted = with_sh_degree(&scene, degree).unwrap();
            assert_eq!((lifted.len(), lifted.sh_degree()), (2, degree));
            assert_eq!(lifted.geometry(), scene.geometry());
            for (row, red) in lifted.sh().chunks_exact(sh_coefficients(degree) * 3).zip([0.25, 0.75]) {
                assert_eq!(row[..3], [red, 0.5, -0.5]);
                assert!(row[3..].iter().all(|value| *value != 0.0 && value.abs() <= 0.025));
            }
        }
    }
}

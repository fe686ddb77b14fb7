//! `check-data` of a scene of Gaussians.

use crate::arguments::Common;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Outputs};
use crate::summary::{print_line, warn};
use evaluate::Recipe;
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, sigmoid};
use serde::Serialize;
use std::path::Path;

/// What `--json` writes.
#[derive(Serialize)]
struct Record {
    recipe: Recipe<()>,
    format: &'static str,
    gaussians: usize,
    sh_degree: usize,
    /// Gaussians with a number that is NaN or infinite.
    not_finite: usize,
    /// Smallest and largest mean by axis, scene units; none without finite Gaussians.
    extent: Option<[[f32; 3]; 2]>,
    /// Median standard deviation along the longest axis, scene units.
    median_size: Option<f32>,
    median_opacity: Option<f32>,
    remarks: Vec<String>,
}

pub(crate) fn run(input: &Path, common: &Common) -> Outcome {
    Outputs::of(common).spare([input])?;
    let scene = output::read_scene(input)?;
    let gaussians = &scene.gaussians;
    let width = gaussians.sh().len() / gaussians.len().max(1);
    let rows = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY);
    let finite: Vec<&[f32]> = rows
        .zip(gaussians.sh().chunks_exact(width.max(1)))
        .filter(|(geometry, sh)| geometry.iter().chain(*sh).all(|value| value.is_finite()))
        .map(|(geometry, _)| geometry)
        .collect();
    let not_finite = gaussians.len() - finite.len();
    let mut extent: Option<[[f32; 3]; 2]> = None;
    for row in &finite {
        let mean: [f32; 3] = std::array::from_fn(|axis| row[MEAN.start + axis]);
        let [low, high] = extent.get_or_insert([mean; 2]);
        for axis in 0..3 {
            low[axis] = low[axis].min(mean[axis]);
            high[axis] = high[axis].max(mean[axis]);
        }
    }
    let median = |number: fn(&[f32]) -> f32| {
        let mut numbers: Vec<f32> = finite.iter().map(|row| number(row)).collect();
        numbers.sort_unstable_by(f32::total_cmp);
        numbers.get(numbers.len() / 2).copied()
    };
    let median_size = median(|row| row[LOG_SCALE].iter().copied().fold(f32::NEG_INFINITY, f32::max).exp());
    let median_opacity = median(|row| sigmoid(row[OPACITY_LOGIT]));
    print_line(&format!("scene      {}: {}", input.display(), scene.format));
    print_line(&format!("Gaussians  {}, SH degree {}", gaussians.len(), gaussians.sh_degree()));
    if let (Some([low, high]), Some(size), Some(opacity)) = (extent, median_size, median_opacity) {
        print_line(&format!("extent     {low:.3?} to {high:.3?} scene units"));
        print_line(&format!(
            "median     size {size:.3e} scene units along the longest axis, opacity {opacity:.2}"
        ));
    }
    if let Some(path) = &common.json {
        let record = Record {
            recipe: crate::recipe(0, ()),
            format: scene.format.extension(),
            gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree(),
            not_finite,
            extent,
            median_size,
            median_opacity,
            remarks: scene.remarks.iter().map(ToString::to_string).collect(),
        };
        output::write_json(path, &record)?;
    }
    if not_finite > 0 {
        warn(&format!(
            "{}: {not_finite} of {} Gaussians have numbers that are not finite, and cannot be drawn",
            input.display(),
            gaussians.len()
        ));
    }
    if finite.is_empty() {
        return Err(Failure::work(format!("{}: there is no Gaussian that could be drawn", input.display())));
    }
    Ok(())
}

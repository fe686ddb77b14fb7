//! Renders golden cases, differentiates them and measures the deviation; shared with the example `check_case`.

use gs_raster::{Gradients, PixelGradients, Rasterizer, RenderSettings, Style};
use gs_reference::tolerance::{REFERENCE_IMAGE, f32_bound, f32_gradient_bound, reference_gradient_bound};
use gs_reference::{
    Case, Deviation, GoldenGradient, Loss, Mismatch, Profile, Variable, compare, compare_to_size,
};
use gs_scene::Camera;

/// One output of a rendering, or one of its gradients, beside the golden one.
pub(crate) struct Row {
    pub(crate) output: String,
    pub(crate) deviation: Result<Deviation, Mismatch>,
    /// Largest deviation allowed.
    pub(crate) bound: f64,
}

impl Row {
    pub(crate) fn holds(&self) -> bool {
        self.deviation.as_ref().is_ok_and(|deviation| deviation.max_abs <= self.bound)
    }

    /// Whether no number can be compared, because f32 may decide otherwise in every pixel.
    #[allow(dead_code, reason = "for the example: every fixture has something to compare")]
    pub(crate) fn is_empty(&self) -> bool {
        matches!(self.deviation, Err(Mismatch::NothingCompared))
    }
}

/// The settings under which this renderer draws what the reference draws under `profile`; depth included.
pub(crate) fn settings(profile: &Profile, background: [f32; 3]) -> RenderSettings {
    RenderSettings {
        style: Style::Blended,
        background,
        near: profile.near as f32,
        far: profile.far as f32,
        antialias: profile.antialias,
        compensation_min: profile.compensation_min as f32,
        depth: true,
        alpha_max: profile.alpha_max as f32,
        alpha_min: profile.alpha_min as f32,
        transmittance_min: profile.transmittance_min as f32,
        eps2d: profile.eps2d as f32,
    }
}

/// The f32 renderer on a case: outputs outside the pixels in which f32 may take another decision than f64, and gradients by
/// all that it differentiates by.
///
/// # Errors
/// If the case has a setting that this renderer refuses, or the GPU fails.
pub(crate) fn check_rasterizer(case: &Case, rasterizer: &mut Rasterizer) -> gs_raster::Result<Vec<Row>> {
    let case = &case.clone().in_standard_axes();
    let settings = settings(&case.profile, case.background);
    let (views, tape) = rasterizer.record(&case.gaussians, &[case.camera], &settings)?;
    let (view, floor) = (&views[0], case.f32_image_floor);
    let depth = view.depth.as_ref().expect("asked for");
    let transmittance: Vec<f32> = view.alpha.iter().map(|alpha| 1.0 - alpha).collect();
    let depth_sum: Vec<f32> = view.alpha.iter().zip(depth).map(|(alpha, depth)| alpha * depth).collect();
    let mut rows: Vec<Row> = [
        ("image", &case.expected.image, view.image.data(), floor),
        ("alpha", &case.expected.alpha, &view.alpha, None),
        ("depth", &case.expected.depth, depth, None),
        ("T_final", &case.expected.transmittance, &transmittance, None),
        ("depth_acc", &case.expected.depth_sum, &depth_sum, None),
    ]
    .into_iter()
    .map(|(output, expected, found, floor)| {
        let deviation = compare(expected.iter().copied(), found.iter().copied(), &case.ambiguous);
        let bound = deviation.as_ref().map_or(0.0, |deviation| f32_bound(deviation, floor));
        Row { output: output.to_owned(), deviation, bound }
    })
    .collect();

    for loss in &case.losses {
        let pixels = pixel_gradients(loss, &view.alpha, depth);
        let found = rasterizer.backward(&case.gaussians, &tape, &[pixels])?;
        rows.extend(loss.gradients.iter().filter_map(|golden| {
            let found = by(&found, golden.variable, &case.camera)?;
            Some(gradient_row(loss, golden, found, f32_gradient_bound))
        }));
    }
    Ok(rows)
}

/// The f64 reference on a case, in every pixel and by every variable.
pub(crate) fn check_reference(case: &Case) -> Vec<Row> {
    let background = case.background.map(f64::from);
    let found = gs_reference::render(&case.gaussians, &case.camera, background, &case.profile);
    let relative = |output: &str, expected: &[f64], found: &[f64]| Row {
        output: output.to_owned(),
        deviation: compare_to_size(expected, found),
        bound: REFERENCE_IMAGE,
    };
    let whole = |numbers: &[i32]| -> Vec<f64> { numbers.iter().map(|&n| f64::from(n)).collect() };
    let expected = &case.expected;
    let mut rows = vec![
        relative("image", &expected.image, &found.image),
        relative("alpha", &expected.alpha, &found.alpha),
        relative("depth", &expected.depth, &found.depth),
        relative("T_final", &expected.transmittance, &found.transmittance),
        relative("depth_acc", &expected.depth_sum, &found.depth_sum),
        relative("n_contrib", &whole(&expected.contributors), &whole(&found.contributors)),
        relative("last_id", &whole(&expected.last), &whole(&found.last)),
    ];
    for loss in &case.losses {
        let found =
            gs_reference::backward(&case.gaussians, &case.camera, background, &case.profile, &loss.weights);
        rows.extend(loss.gradients.iter().map(|golden| {
            gradient_row(loss, golden, found.by(golden.variable), |deviation, _| {
                reference_gradient_bound(deviation)
            })
        }));
    }
    rows
}

/// The loss by what this renderer puts out. The golden loss on depth is on Σ w z, which is depth times alpha.
fn pixel_gradients(loss: &Loss, alpha: &[f32], depth: &[f32]) -> PixelGradients<'static> {
    let weights = &loss.weights;
    let singles = |numbers: &[f64]| -> Vec<f32> { numbers.iter().map(|&v| v as f32).collect() };
    let sums = weights.depth_sum.iter().zip(alpha).zip(depth);
    let by_depth = sums.clone().map(|((&w, &alpha), _)| w as f32 * alpha).collect();
    let by_alpha = sums.zip(&weights.alpha).map(|(((&w, _), &depth), &v)| w as f32 * depth + v as f32);
    PixelGradients {
        image: singles(&weights.image).into(),
        alpha: Some(by_alpha.collect()),
        depth: Some(by_depth),
    }
}

/// The derivatives by one variable, if this renderer takes them.
pub(crate) fn by(gradients: &Gradients, variable: Variable, camera: &Camera) -> Option<Vec<f64>> {
    let pose = gradients.cameras[0];
    match variable {
        Variable::Sh => Some(gradients.sh.iter().map(|&v| f64::from(v)).collect()),
        Variable::Background => Some(gradients.background.to_vec()),
        Variable::WorldToCamera => {
            let row =
                |r: usize| [pose.rotation.row(r).to_array().as_slice(), &[pose.translation[r]]].concat();
            Some((0..3).flat_map(row).collect())
        }
        Variable::Twist => Some(pose.twist(camera).to_vec()),
        _ => variable.of_geometry(&gradients.geometry),
    }
}

fn gradient_row(
    loss: &Loss,
    golden: &GoldenGradient,
    found: Vec<f64>,
    bound: impl Fn(&Deviation, &GoldenGradient) -> f64,
) -> Row {
    let deviation = compare(golden.values.iter().copied(), found, &[]);
    let bound = deviation.as_ref().map_or(0.0, |deviation| bound(deviation, golden));
    Row { output: format!("{}_{}", loss.name, golden.variable.name()), deviation, bound }
}

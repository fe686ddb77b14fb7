//! Renders golden cases and measures the deviation; shared with the example `check_case`.

use gs_raster::{RenderSettings, render};
use gs_reference::tolerance::{f32_bound, reference_bound};
use gs_reference::{Case, Deviation, Mismatch, Profile, compare};

/// One output of a rendering beside the golden one.
pub(crate) struct Row {
    pub(crate) output: &'static str,
    pub(crate) deviation: Result<Deviation, Mismatch>,
    /// Largest deviation allowed.
    pub(crate) bound: f64,
}

impl Row {
    pub(crate) fn holds(&self) -> bool {
        self.deviation.as_ref().is_ok_and(|deviation| deviation.max_abs <= self.bound)
    }
}

/// The settings under which this renderer draws what the reference draws under `profile`; depth included.
pub(crate) fn settings(profile: &Profile, background: [f32; 3]) -> RenderSettings {
    assert_eq!(profile.compensation_min, f64::from(0.005f32), "this renderer's least compensation is fixed");
    RenderSettings {
        background,
        near: profile.near as f32,
        far: profile.far as f32,
        antialias: profile.antialias,
        depth: true,
        alpha_max: profile.alpha_max as f32,
        alpha_min: profile.alpha_min as f32,
        transmittance_min: profile.transmittance_min as f32,
        eps2d: profile.eps2d as f32,
    }
}

/// The f32 renderer on a case, outside the pixels in which f32 may take another decision than f64.
pub(crate) fn check_cpu(case: &Case) -> Vec<Row> {
    let case = case.clone().in_standard_axes();
    let view = render(&case.gaussians, &case.camera, &settings(&case.profile, case.background))
        .expect("the settings of a golden case are valid");
    let floor = case.f32_image_floor;
    let depth = view.depth.expect("asked for");
    [
        ("image", &case.expected.image, view.image.data(), floor),
        ("alpha", &case.expected.alpha, &view.alpha, None),
        ("depth", &case.expected.depth, &depth, None),
    ]
    .into_iter()
    .map(|(output, expected, found, floor)| {
        let deviation = compare(expected.iter().copied(), found.iter().copied(), &case.ambiguous);
        let bound = deviation.as_ref().map_or(0.0, |deviation| f32_bound(deviation, floor));
        Row { output, deviation, bound }
    })
    .collect()
}

/// The f64 reference on a case, in every pixel.
pub(crate) fn check_reference(case: &Case) -> Vec<Row> {
    let background = case.background.map(f64::from);
    let found = gs_reference::render(&case.gaussians, &case.camera, background, &case.profile);
    [
        ("image", &case.expected.image, found.image),
        ("alpha", &case.expected.alpha, found.alpha),
        ("depth", &case.expected.depth, found.depth),
    ]
    .into_iter()
    .map(|(output, expected, found)| {
        let deviation = compare(expected.iter().copied(), found, &[]);
        let bound = deviation.as_ref().map_or(0.0, reference_bound);
        Row { output, deviation, bound }
    })
    .collect()
}

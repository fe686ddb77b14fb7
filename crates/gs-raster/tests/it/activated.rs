//! Activated arrays: rendered in place like what is stored of them, and the chain rule back.

mod agreement;

use gs_raster::{
    Activated, Colors, Error, Gradients, PixelGradients, Rasterizer, RenderSettings, Rendering, Result,
};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, dc_from_rgb, sigmoid};

/// Arrays of Gaussians.
#[derive(Debug, Clone)]
pub(crate) struct Arrays {
    means: Vec<f32>,
    quats: Vec<f32>,
    scales: Vec<f32>,
    opacities: Vec<f32>,
    colors: Vec<f32>,
    kind: Colors,
}

impl Arrays {
    /// Three Gaussians.
    fn new(kind: Colors) -> Self {
        let per_gaussian = match kind {
            Colors::Rgb => 3,
            Colors::Sh { per_gaussian, .. } => 3 * per_gaussian,
        };
        let numbers = |count: usize| (0..count).map(|i| 0.1 + 0.03 * i as f32).collect::<Vec<_>>();
        Self {
            means: numbers(9),
            quats: numbers(12),
            scales: numbers(9),
            opacities: vec![0.2, 0.5, 0.9],
            colors: numbers(3 * per_gaussian),
            kind,
        }
    }

    pub(crate) fn view(&self) -> Activated<'_> {
        let Self { means, quats, scales, opacities, colors, kind } = self;
        Activated { means, quats, scales, opacities, colors, kind: *kind }
    }

    pub(crate) fn store(&self) -> Result<Gaussians> {
        self.view().store()
    }

    /// What would be stored as these Gaussians, or nearly.
    pub(crate) fn of(stored: &Gaussians, kind: Colors) -> Self {
        let columns = |range: std::ops::Range<usize>| -> Vec<f32> {
            stored.geometry().chunks_exact(11).flat_map(|row| row[range.clone()].to_vec()).collect()
        };
        let sh_row = gs_scene::sh_coefficients(stored.sh_degree()) * 3;
        let rows = stored.sh().chunks_exact(sh_row);
        let colors = match kind {
            Colors::Rgb => rows.flat_map(|sh| gs_scene::rgb_from_dc([sh[0], sh[1], sh[2]])).collect(),
            Colors::Sh { per_gaussian, .. } => {
                // What is not used may hold anything.
                let rest = vec![f32::NAN; per_gaussian * 3 - sh_row];
                rows.flat_map(|sh| sh.iter().chain(&rest).copied()).collect()
            }
        };
        Self {
            means: columns(MEAN),
            quats: columns(QUATERNION),
            scales: columns(LOG_SCALE).into_iter().map(f32::exp).collect(),
            opacities: columns(OPACITY_LOGIT..OPACITY_LOGIT + 1).into_iter().map(sigmoid).collect(),
            colors,
            kind,
        }
    }
}

/// Gradients of what is stored, without those by background and poses.
fn gradients(geometry: Vec<f32>, sh: Vec<f32>) -> Gradients {
    Gradients { geometry, sh, background: [0.0; 3], cameras: Vec::new() }
}

const KINDS: [Colors; 3] =
    [Colors::Rgb, Colors::Sh { degree: 2, per_gaussian: 9 }, Colors::Sh { degree: 1, per_gaussian: 16 }];

#[test]
fn what_is_stored_activates_to_what_was_given() {
    for kind in KINDS {
        let arrays = Arrays::new(kind);
        let stored = arrays.store().unwrap();
        let again = Arrays::of(&stored, kind);
        let pairs = again.scales.iter().zip(&arrays.scales);
        for (found, given) in pairs.chain(again.opacities.iter().zip(&arrays.opacities)) {
            assert!((found / given - 1.0).abs() < 1e-6, "{found} for {given}");
        }
        let row = arrays.colors.len() / 3;
        for (at, sh) in stored.sh().chunks_exact(stored.sh().len() / 3).enumerate() {
            let given = &arrays.colors[at * row..];
            match kind {
                Colors::Rgb => assert_eq!(sh, dc_from_rgb([given[0], given[1], given[2]])),
                Colors::Sh { .. } => assert_eq!(sh, &given[..sh.len()]),
            }
        }
    }
}

/// One of the arrays.
type Field = fn(&mut Arrays) -> &mut Vec<f32>;

/// Asserts that gradients by some of the arrays agree with central differences of a loss, of this step and to this share.
fn agree_with_differences(
    arrays: &Arrays,
    fields: &[(Field, &Vec<f32>)],
    loss: impl Fn(&Arrays) -> f64,
    (step, share): (f32, f64),
) {
    for (field, by_field) in fields {
        for (place, &gradient) in by_field.iter().enumerate() {
            let at = |step: f32| {
                let mut moved = arrays.clone();
                field(&mut moved)[place] += step;
                loss(&moved)
            };
            let expected = (at(step) - at(-step)) / (2.0 * f64::from(step));
            let error = (f64::from(gradient) - expected).abs();
            assert!(
                error < share * expected.abs().max(1.0),
                "{:?} {place}: {gradient}, differences say {expected}",
                arrays.kind
            );
        }
    }
}

#[test]
fn the_chain_rule_agrees_with_central_differences() {
    for kind in KINDS {
        let arrays = Arrays::new(kind);
        let stored = arrays.store().unwrap();
        // A loss that is linear in what is stored: its gradients are these weights.
        let weight = |place: usize| ((place * 7 % 11) as f32 - 5.0) / 5.0;
        let by_geometry: Vec<f32> = (0..stored.geometry().len()).map(weight).collect();
        let by_sh: Vec<f32> = (0..stored.sh().len()).map(weight).collect();
        let loss = |arrays: &Arrays| -> f64 {
            let stored = arrays.store().unwrap();
            let both = stored.geometry().iter().zip(&by_geometry).chain(stored.sh().iter().zip(&by_sh));
            both.map(|(number, weight)| f64::from(*number) * f64::from(*weight)).sum()
        };
        let found = gradients(by_geometry.clone(), by_sh.clone()).activated(&arrays.view());
        let fields: [(Field, &Vec<f32>); 5] = [
            (|arrays| &mut arrays.means, &found.means),
            (|arrays| &mut arrays.quats, &found.quats),
            (|arrays| &mut arrays.scales, &found.scales),
            (|arrays| &mut arrays.opacities, &found.opacities),
            (|arrays| &mut arrays.colors, &found.colors),
        ];
        agree_with_differences(&arrays, &fields, loss, (1e-3, 2e-3));
    }
}

#[test]
fn opacities_of_0_and_1_are_limits_with_finite_gradients() {
    let mut arrays = Arrays::new(Colors::Rgb);
    arrays.opacities = vec![0.0, 1.0, 0.5];
    let stored = arrays.store().unwrap();
    let logits: Vec<f32> =
        stored.geometry().iter().skip(OPACITY_LOGIT).step_by(Gaussians::GEOMETRY).copied().collect();
    assert!(logits.iter().all(|logit| logit.is_finite()), "{logits:?}");
    assert!(sigmoid(logits[0]) < 1e-37 && sigmoid(logits[1]) > 1.0 - 1e-6);
    // By the logit a gradient vanishes as o (1 - o) does; by the opacity it is what it was: here 1.
    let mut by_geometry = vec![0.0; stored.geometry().len()];
    let (up, down) = (f64::from(logits[1]).exp(), f64::from(-logits[1]).exp());
    by_geometry[OPACITY_LOGIT + Gaussians::GEOMETRY] = (1.0 / ((1.0 + up) * (1.0 + down))) as f32;
    let found = gradients(by_geometry, vec![0.0; stored.sh().len()]).activated(&arrays.view());
    assert!((found.opacities[1] - 1.0).abs() < 1e-6, "{}", found.opacities[1]);
    // Gaussians that are not drawn have no gradient.
    assert_eq!(found.opacities[0], 0.0);
}

#[test]
fn numbers_that_no_gaussian_has_are_named() {
    type Spoil = fn(&mut Arrays);
    let cases: [(Spoil, &str); 8] = [
        (|a| a.means[4] = f32::NAN, "means: Gaussian 1 holds NaN"),
        (|a| a.quats[11] = f32::INFINITY, "quats: Gaussian 2 holds inf"),
        (|a| a.quats[4..8].fill(0.0), "quats: Gaussian 1 has a quaternion of norm 0"),
        (|a| a.scales[0] = 0.0, "scales: Gaussian 0 has 0"),
        (|a| a.scales[5] = -3.0, "scales: Gaussian 1 has -3"),
        (|a| a.opacities[2] = 1.5, "opacities: Gaussian 2 has 1.5"),
        (|a| a.opacities[0] = f32::NAN, "opacities: Gaussian 0 holds NaN"),
        (|a| a.colors[7] = f32::NAN, "colors: Gaussian 2 holds NaN"),
    ];
    for (spoil, expected) in cases {
        let mut arrays = Arrays::new(Colors::Rgb);
        spoil(&mut arrays);
        let found = arrays.store().unwrap_err().to_string();
        assert!(found.starts_with(expected), "{found}");
        assert_eq!(render(&arrays.view()).unwrap_err().to_string(), found);
    }
    // Of several the first is named, whatever thread finds which.
    let mut arrays = Arrays::new(Colors::Rgb);
    arrays.means.fill(f32::NAN);
    assert!(arrays.store().unwrap_err().to_string().starts_with("means: Gaussian 0"));
    // Finite numbers whose sum overflows are no fault.
    let mut arrays = Arrays::new(Colors::Rgb);
    arrays.means.fill(f32::MAX);
    assert!(arrays.store().is_ok());
    // The smallest scale has a logarithm.
    let mut arrays = Arrays::new(Colors::Rgb);
    arrays.scales.fill(f32::from_bits(1));
    assert!(arrays.store().unwrap().geometry()[LOG_SCALE].iter().all(|log| log.is_finite()));
}

#[test]
fn no_gaussians_are_no_fault() {
    let none = Arrays {
        means: vec![],
        quats: vec![],
        scales: vec![],
        opacities: vec![],
        colors: vec![],
        kind: Colors::Sh { degree: 3, per_gaussian: 16 },
    };
    let stored = none.store().unwrap();
    assert!(stored.is_empty() && none.view().is_empty());
    let found = gradients(vec![], vec![]).activated(&none.view());
    assert!(found.means.is_empty() && found.colors.is_empty());
}

/// In one view.
fn render(arrays: &Activated<'_>) -> Result<Vec<Rendering>> {
    let lens = gs_scene::Intrinsics { fx: 20.0, fy: 20.0, cx: 8.0, cy: 8.0, width: 16, height: 16 };
    let camera = gs_scene::Camera::new(lens, glam::DMat3::IDENTITY, glam::DVec3::ZERO).expect("valid");
    Rasterizer::cpu().render_activated(arrays, &[camera], &RenderSettings::default())
}

#[test]
fn arrays_of_other_lengths_and_degrees_are_named() {
    type Spoil = fn(&mut Arrays);
    let cases: [(Spoil, &str); 6] = [
        (|a| a.means.truncate(8), "means: 8 numbers for 3 Gaussians, expected 9"),
        (|a| a.quats.push(1.0), "quats: 13 numbers for 3 Gaussians, expected 12"),
        (|a| a.scales.clear(), "scales: 0 numbers for 3 Gaussians, expected 9"),
        (|a| a.opacities.truncate(2), "means: 9 numbers for 2 Gaussians, expected 6"),
        (|a| a.colors.truncate(26), "colors: 26 numbers for 3 Gaussians, expected 81"),
        (
            |a| a.kind = Colors::Sh { degree: 3, per_gaussian: 9 },
            "colors: 9 SH coefficients per Gaussian, degree 3 needs 16",
        ),
    ];
    for (spoil, expected) in cases {
        let mut arrays = Arrays::new(Colors::Sh { degree: 2, per_gaussian: 9 });
        spoil(&mut arrays);
        assert_eq!(arrays.store().unwrap_err().to_string(), expected);
        assert_eq!(render(&arrays.view()).unwrap_err().to_string(), expected);
    }
    let mut arrays = Arrays::new(Colors::Rgb);
    arrays.kind = Colors::Sh { degree: 4, per_gaussian: usize::MAX };
    assert!(matches!(arrays.store(), Err(Error::Scene(gs_scene::Error::ShDegree { found: 4 }))));
}

#[test]
fn gradients_of_other_arrays_than_recorded_are_refused() {
    let lens = gs_scene::Intrinsics { fx: 20.0, fy: 20.0, cx: 8.0, cy: 8.0, width: 16, height: 16 };
    let camera = gs_scene::Camera::new(lens, glam::DMat3::IDENTITY, glam::DVec3::ZERO).unwrap();
    let (mut rasterizer, settings) = (Rasterizer::cpu(), RenderSettings::default());
    let arrays = Arrays::new(Colors::Sh { degree: 1, per_gaussian: 4 });
    let (_, tape) = rasterizer.record_activated(&arrays.view(), &[camera], &settings).unwrap();
    let pixels = PixelGradients { image: vec![1.0; 16 * 16 * 3].into(), alpha: None, depth: None };
    let mut backward = |arrays: &Arrays, pixels: &[PixelGradients]| {
        rasterizer.backward_activated(&arrays.view(), &tape, pixels)
    };
    let other = Arrays { kind: Colors::Sh { degree: 0, per_gaussian: 4 }, ..arrays.clone() };
    let found = backward(&other, std::slice::from_ref(&pixels));
    assert!(
        matches!(found, Err(Error::OtherScene { found: 3, found_degree: 0, expected_degree: 1, .. })),
        "{found:?}"
    );
    let mut short = arrays.clone();
    short.quats.pop();
    let found = backward(&short, std::slice::from_ref(&pixels));
    assert!(matches!(found, Err(Error::ArrayLength { what: "quats", .. })), "{found:?}");
    assert!(matches!(backward(&arrays, &[]), Err(Error::Views { expected: 1, found: 0 })));
    assert!(backward(&arrays, std::slice::from_ref(&pixels)).is_ok());
    let (_, tape) = rasterizer.record(&arrays.store().unwrap(), &[camera], &settings).unwrap();
    let found = rasterizer.backward_activated(&arrays.view(), &tape, &[pixels]);
    assert!(matches!(found, Err(Error::NotActivated)), "{found:?}");
}

#[test]
fn numbers_are_checked_without_a_camera_and_where_no_camera_looks() {
    let mut arrays = Arrays::new(Colors::Rgb);
    arrays.scales[4] = -1.0;
    let none = Rasterizer::cpu().render_activated(&arrays.view(), &[], &RenderSettings::default());
    assert!(matches!(none, Err(Error::Scale { gaussian: 1, .. })), "{none:?}");
    let none = Rasterizer::cpu().record_activated(&arrays.view(), &[], &RenderSettings::default());
    assert!(matches!(none, Err(Error::Scale { gaussian: 1, .. })), "{none:?}");
    // Behind the camera, in the last of several chunks.
    let n = 10_000;
    let mut many = Arrays {
        means: vec![-5.0; 3 * n],
        quats: vec![1.0; 4 * n],
        scales: vec![0.1; 3 * n],
        opacities: vec![0.5; n],
        colors: vec![0.5; 3 * n],
        kind: Colors::Rgb,
    };
    assert!(render(&many.view()).is_ok());
    many.colors[3 * 9_999] = f32::NAN;
    many.quats[4 * 9_998..][..4].fill(0.0);
    let found = render(&many.view());
    assert!(matches!(found, Err(Error::Quaternion { gaussian: 9_998 })), "{found:?}");
}

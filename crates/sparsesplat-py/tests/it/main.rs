//! What needs no interpreter: activated arrays to stored Gaussians, and the chain rule back.

#[path = "../../src/activated.rs"]
mod activated;

use activated::{Activated, Colors, Fault, chain};
use gs_scene::{Gaussians, LOG_SCALE, OPACITY_LOGIT, dc_from_rgb, sigmoid};

/// Three Gaussians, the arrays one after the other.
struct Arrays {
    means: Vec<f32>,
    quats: Vec<f32>,
    scales: Vec<f32>,
    opacities: Vec<f32>,
    colors: Vec<f32>,
    kind: Colors,
}

impl Arrays {
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

    fn view(&self) -> Activated<'_> {
        let Self { means, quats, scales, opacities, colors, kind } = self;
        Activated { means, quats, scales, opacities, colors, kind: *kind }
    }

    fn store(&self) -> Result<Gaussians, Fault> {
        let (n, degree) = (self.opacities.len(), self.kind.degree());
        let sh = vec![0.0; n * gs_scene::sh_coefficients(degree) * 3];
        let mut stored =
            Gaussians::new(degree, vec![0.0; n * Gaussians::GEOMETRY], sh).expect("buffers that fit");
        self.view().store(&mut stored)?;
        Ok(stored)
    }
}

const KINDS: [Colors; 3] =
    [Colors::Rgb, Colors::Sh { degree: 2, per_gaussian: 9 }, Colors::Sh { degree: 1, per_gaussian: 16 }];

#[test]
fn what_is_stored_activates_to_what_was_given() {
    for kind in KINDS {
        let arrays = Arrays::new(kind);
        let stored = arrays.store().unwrap();
        let (scales, opacities) = activated::activate(&stored);
        for (found, given) in scales.iter().zip(&arrays.scales).chain(opacities.iter().zip(&arrays.opacities))
        {
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
        let found = chain(&stored, &by_geometry, by_sh.clone(), kind);
        let fields: [(Field, &Vec<f32>); 5] = [
            (|arrays| &mut arrays.means, &found.means),
            (|arrays| &mut arrays.quats, &found.quats),
            (|arrays| &mut arrays.scales, &found.scales),
            (|arrays| &mut arrays.opacities, &found.opacities),
            (|arrays| &mut arrays.colors, &found.colors),
        ];
        for (field, gradients) in fields {
            for (place, &gradient) in gradients.iter().enumerate() {
                let at = |step: f32| {
                    let mut moved = Arrays::new(kind);
                    field(&mut moved)[place] += step;
                    loss(&moved)
                };
                let step = 1e-3;
                let expected = (at(step) - at(-step)) / (2.0 * f64::from(step));
                let error = (f64::from(gradient) - expected).abs();
                assert!(
                    error < 2e-3 * expected.abs().max(1.0),
                    "{kind:?} {place}: {gradient}, differences say {expected}"
                );
            }
        }
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
    let found = chain(&stored, &by_geometry, vec![0.0; stored.sh().len()], Colors::Rgb);
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
    assert!(stored.is_empty() && none.view().len() == 0);
    let found = chain(&stored, &[], vec![], none.kind);
    assert!(found.means.is_empty() && found.colors.is_empty());
}

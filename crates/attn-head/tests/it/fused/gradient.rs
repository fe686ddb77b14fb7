//! Gradients are those of the formulas.

use super::cases::{Single, random, uniform};
use crate::oracle::Case;
use attn_head::{Kind, Layout, OUTPUTS, fused};

fn loss_weights(case: &Case) -> Vec<f64> {
    let mut u = uniform(77, 7);
    (0..case.n * OUTPUTS).map(|_| u()).collect()
}

fn gradients(case: &Case) -> fused::Gradients {
    let single = Single::new(case);
    let grad: Vec<f32> = loss_weights(case).iter().map(|&v| v as f32).collect();
    let (_, tape) = fused::forward_recorded(&single.config, &single.weights, &single.inputs());
    fused::backward(&single.config, &single.weights, &single.inputs(), &tape, &grad)
}

fn loss(case: &Case) -> f64 {
    case.run().out.iter().zip(loss_weights(case)).map(|(v, w)| v * w).sum()
}

/// Central difference of the loss in f64. Steps are small enough that hardly any ReLU changes sides.
fn difference(case: &Case, change: impl Fn(&mut Case, f64)) -> f64 {
    const STEP: f64 = 1e-6;
    let at = |step: f64| {
        let mut case = case.clone();
        change(&mut case, step);
        loss(&case)
    };
    (at(STEP) - at(-STEP)) / (2.0 * STEP)
}

/// Of each tensor of weights the number with the largest gradient and another, and all of the inputs.
#[test]
fn gradients_are_central_differences() {
    for kind in Kind::ALL {
        assert_central_differences(&random(kind, 3, 2, 4, 11));
    }
}

fn assert_central_differences(case: &Case) {
    let (kind, found) = (case.config.kind, gradients(case));
    for p in Layout::new(&case.config).parameters {
        let grad = &found.weights[p.offset..p.offset + p.len()];
        let size = grad.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
        let largest = grad.iter().position(|g| g.abs() == size).expect("a largest");
        for i in [largest, p.len() / 2 + 1] {
            let expected = difference(case, |case, step| case.weights[p.offset + i] += step);
            let error = (f64::from(grad[i]) - expected).abs();
            assert!(
                error <= 2e-5 * f64::from(size) + 2e-7,
                "{kind:?} {}[{i}]: {} and {expected}",
                p.name,
                grad[i]
            );
        }
    }
    for (name, grad, of) in [
        ("geometry", &found.geometry, (|c| &mut c.geometry) as fn(&mut Case) -> &mut Vec<f64>),
        ("image", &found.image, |c| &mut c.image),
    ] {
        for (i, &grad) in grad.iter().enumerate() {
            let expected = difference(case, |case, step| of(case)[i] += step);
            let error = (f64::from(grad) - expected).abs();
            assert!(error <= 2e-5 * (1.0 + expected.abs()), "{kind:?} {name}[{i}]: {grad} and {expected}");
        }
    }
}

/// All of them at once: along a random direction, where no mistake can hide in numbers that were not looked at.
#[test]
fn gradients_along_a_direction_are_central_differences() {
    for ((n, k, image, seed), kind) in [(70, 4, 8, 21), (1, 0, 3, 22), (50, 0, 12, 23), (3, 9, 1, 25)]
        .into_iter()
        .flat_map(|shape| Kind::ALL.map(|kind| (shape, kind)))
    {
        let case = random(kind, n, k, image, seed);
        let found = gradients(&case);
        let direction = |len: usize, stream: u64| {
            let mut u = uniform(seed, stream);
            (0..len).map(|_| u()).collect::<Vec<f64>>()
        };
        let weights = direction(case.weights.len(), 31);
        let (geometry, image) = (direction(case.geometry.len(), 32), direction(case.image.len(), 33));
        let along = |grad: &[f32], direction: &[f64]| {
            grad.iter()
                .zip(direction)
                .map(|(&g, d)| f64::from(g) * d)
                .fold((0.0, 0.0), |(sum, squares), term| (sum + term, squares + term * term))
        };
        let parts = [
            (
                "weights",
                along(&found.weights, &weights),
                difference(&case, |case, step| {
                    case.weights.iter_mut().zip(&weights).for_each(|(w, d)| *w += 0.01 * step * d);
                }) * 100.0,
            ),
            (
                "geometry",
                along(&found.geometry, &geometry),
                difference(&case, |case, step| {
                    case.geometry.iter_mut().zip(&geometry).for_each(|(w, d)| *w += step * d);
                }),
            ),
            (
                "image",
                along(&found.image, &image),
                difference(&case, |case, step| {
                    case.image.iter_mut().zip(&image).for_each(|(w, d)| *w += step * d);
                }),
            ),
        ];
        for (name, (found, squares), expected) in parts {
            // Rounding of single terms adds up like a random walk.
            let size = f64::sqrt(squares) + f64::abs(expected);
            assert!(
                (found - expected).abs() <= 3e-5 * size,
                "{kind:?} {name}, n = {n}, k = {k}: {found} and {expected}"
            );
        }
    }
}

#[test]
fn no_anchors_have_no_gradients() {
    for kind in Kind::ALL {
        let found = gradients(&random(kind, 0, 4, 8, 1));
        assert!(found.weights.iter().all(|&g| g == 0.0));
        assert!(found.geometry.is_empty() && found.image.is_empty());
    }
}

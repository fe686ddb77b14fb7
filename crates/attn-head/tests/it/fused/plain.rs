//! Outputs and gradients are those of the plain form, with equal maxima among others: both take the first.

use super::cases::{Single, alike, random, repeated};
use crate::oracle::Case;
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Kind, OUTPUTS, fused};
use candle_core::{DType, Device, Result, Tensor, Var};

/// What the plain form finds in f64.
fn plain(case: &Single, factors: &[f32]) -> Result<[Vec<f64>; 4]> {
    let inputs = case.inputs();
    let mut tensors = TensorInputs::new(&case.config, &inputs, DType::F64, &Device::Cpu).expect("inputs");
    let var = |tensor: &Tensor| Var::from_tensor(tensor);
    let weights = Tensor::from_slice(&case.weights, case.weights.len(), &Device::Cpu)?;
    let vars = [var(&weights.to_dtype(DType::F64)?)?, var(&tensors.geometry)?, var(&tensors.image)?];
    tensors.geometry = vars[1].as_tensor().clone();
    tensors.image = vars[2].as_tensor().clone();
    let out = Network::new(case.config, &vars[0]).and_then(|n| n.forward(&tensors)).expect("outputs");
    let factors = Tensor::from_slice(factors, (inputs.n, OUTPUTS), &Device::Cpu)?.to_dtype(DType::F64)?;
    let gradients = (&out * factors)?.sum_all()?.backward()?;
    let numbers = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f64>();
    let gradient = |var: &Var| numbers(gradients.get(var).expect("a gradient"));
    Ok([numbers(&out)?, gradient(&vars[0])?, gradient(&vars[1])?, gradient(&vars[2])?])
}

/// Length of the difference relative to that of what is expected.
fn error(found: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let squares = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    let apart = squares(&mut found.iter().zip(expected).map(|(f, e)| f64::from(*f) - e));
    (apart / squares(&mut expected.iter().copied())).sqrt()
}

/// Rounding. That of some numbers among a million before a ReLU, or of some maxima, changes their sides: where there are so many,
/// single gradients differ by all they are.
const FEW: f64 = 1e-5;
const MANY: f64 = 2e-2;

fn check(name: &str, case: &Case, bound: f64) {
    let case = &Single::new(case);
    let (config, weights, inputs) = (&case.config, &case.weights, &case.inputs());
    let factors: Vec<f32> = (0..inputs.n * OUTPUTS).map(|i| (i % 11) as f32 - 5.0).collect();
    let (out, tape) = fused::forward_recorded(config, weights, inputs);
    let gradients = fused::backward(config, weights, inputs, &tape, &factors);
    let found = [out, gradients.weights, gradients.geometry, gradients.image];
    let expected = plain(case, &factors).expect("gradients");
    for (what, (found, expected)) in
        ["outputs", "weights", "geometry", "image"].iter().zip(found.iter().zip(&expected))
    {
        let error = error(found, expected);
        // Written so that what is not a number is outside.
        let within = error < if *what == "outputs" { FEW } else { bound };
        assert!(within, "{:?}, {name}, {what}: {error:e}", config.kind);
    }
}

#[test]
fn of_any_shape() {
    for kind in Kind::ALL {
        for (n, k) in [(1, 0), (1, 1), (2, 1), (2, 20), (7, 3), (48, 0)] {
            check(&format!("n = {n}, k = {k}"), &random(kind, n, k, 5, 6), FEW);
        }
        for (n, k) in [(47, 3), (49, 20), (131, 7)] {
            check(&format!("n = {n}, k = {k}"), &random(kind, n, k, 5, 6), MANY);
        }
    }
}

#[test]
fn of_equal_pairs() {
    for kind in Kind::ALL {
        let case = repeated(random(kind, 13, 6, 5, 7));
        check("repeated", &case, FEW);
        check("alike", &alike(case), FEW);
    }
}

#[test]
fn of_distant_neighbours() {
    for kind in [Kind::EdgeConv, Kind::MaxPool, Kind::Mlp] {
        let mut case = random(kind, 10, 5, 5, 8);
        case.relative.iter_mut().flatten().for_each(|v| *v *= 4096.0);
        check("distant", &case, FEW);
    }
}

/// An anchor with more pairs than are in memory at a time.
#[test]
fn of_many_neighbours() {
    for kind in Kind::ALL {
        check("many", &random(kind, 3, 230, 5, 9), MANY);
    }
}

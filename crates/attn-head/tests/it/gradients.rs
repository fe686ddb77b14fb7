//! Gradients of the plain form against central differences, in f64.

use crate::case::{Case, flat, uniform};
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Kind, Layout, OUTPUTS};
use candle_core::{DType, Device, Tensor, Var};

/// Step of the differences. They err by its square, 1e-10, and by rounding, 1e-16 over the step.
const STEP: f64 = 1e-5;

fn draws(seed: u64, len: usize) -> Vec<f64> {
    uniform(seed).take(len).map(f64::from).collect()
}

fn loss(case: &Case, values: &Tensor, inputs: &TensorInputs) -> Tensor {
    let out = Network::new(case.config, values).unwrap().forward(inputs).unwrap();
    let weight = Tensor::from_vec(draws(99, case.n * OUTPUTS), (case.n, OUTPUTS), &Device::Cpu).unwrap();
    (out * weight).unwrap().sum_all().unwrap()
}

/// The derivative of the loss by the numbers `range` of the tensor x, along a direction, beside what the gradient says.
/// The direction is the sum of two of length 1, the gradient itself and a random one: short, so that no ReLU and no
/// maximum changes sides within the step.
fn assert_derivative(
    name: &str,
    x: &Tensor,
    gradient: &Tensor,
    range: std::ops::Range<usize>,
    loss: impl Fn(&Tensor) -> Tensor,
) {
    let gradient = &flat(gradient)[range.clone()];
    let length = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let (random, size) = (draws(7, range.len()), length(gradient));
    assert!(size > 1e-6, "{name} has no part in the outputs");
    let scale = length(&random);
    let direction: Vec<f64> = gradient.iter().zip(&random).map(|(g, r)| g / size + r / scale).collect();
    let at = |step: f64| {
        let mut moved = flat(x);
        moved[range.clone()].iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        loss(&Tensor::from_vec(moved, x.dims(), &Device::Cpu).unwrap()).to_scalar::<f64>().unwrap()
    };
    let numeric = (at(STEP) - at(-STEP)) / (2.0 * STEP);
    let analytic: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let error = (numeric - analytic).abs();
    assert!(error < 1e-6 * size, "{name}: {analytic} by the gradient, {numeric} by differences");
}

fn check(kind: Kind) {
    let case = Case::new(kind, 5, 3, 11);
    let mut inputs = case.tensors();
    let values = Var::from_tensor(&case.weights().to_tensor(DType::F64, &Device::Cpu).unwrap()).unwrap();
    for input in [&mut inputs.geometry, &mut inputs.image, &mut inputs.relative] {
        *input = Var::from_tensor(input).unwrap().into_inner();
    }
    let gradients = loss(&case, &values, &inputs).backward().unwrap();

    let gradient = gradients.get(&values).unwrap();
    for parameter in Layout::new(&case.config).parameters {
        // Constants of the keys shift all logits of an anchor alike, and vanish in the softmax.
        if parameter.name.ends_with("attn.k.bias") {
            let of = &flat(gradient)[parameter.offset..][..parameter.len()];
            assert!(of.iter().all(|g| g.abs() < 1e-9), "{}: {of:?}", parameter.name);
            continue;
        }
        let range = parameter.offset..parameter.offset + parameter.len();
        assert_derivative(&parameter.name, &values, gradient, range, |x| loss(&case, x, &inputs));
    }
    let of = |input: &Tensor| gradients.get(input).unwrap().clone();
    let (geometry, image) = (of(&inputs.geometry), of(&inputs.image));
    assert_derivative("geometry", &inputs.geometry, &geometry, 0..15, |x| {
        loss(&case, &values, &TensorInputs { geometry: x.clone(), ..inputs.clone() })
    });
    assert_derivative("image", &inputs.image, &image, 0..10, |x| {
        loss(&case, &values, &TensorInputs { image: x.clone(), ..inputs.clone() })
    });
    if kind == Kind::Grid {
        assert!(gradients.get(&inputs.relative).is_none(), "the grid does not look at neighbours");
        return;
    }
    assert_derivative("relative", &inputs.relative, &of(&inputs.relative), 0..45, |x| {
        loss(&case, &values, &TensorInputs { relative: x.clone(), ..inputs.clone() })
    });
}

#[test]
fn of_the_attention() {
    check(Kind::Attention);
}

#[test]
fn of_the_mlp() {
    check(Kind::Mlp);
}

#[test]
fn of_the_edge_convolution() {
    check(Kind::EdgeConv);
}

#[test]
fn of_the_maximum() {
    check(Kind::MaxPool);
}

#[test]
fn of_the_grid() {
    check(Kind::Grid);
}

/// A neighbour given twice shares its part of a maximum with nobody: the gradient by both together is that by one.
#[test]
fn duplicates_do_not_double_a_gradient() {
    for kind in [Kind::EdgeConv, Kind::MaxPool] {
        let once = Case::new(kind, 5, 1, 12);
        let mut twice = once.clone();
        twice.config.neighbours = 2;
        twice.neighbours = once.neighbours.iter().flat_map(|j| [*j; 2]).collect();
        twice.relative = once.relative.iter().flat_map(|d| [*d; 2]).collect();
        let gradient = |case: &Case| {
            let values =
                Var::from_tensor(&case.weights().to_tensor(DType::F64, &Device::Cpu).unwrap()).unwrap();
            let gradients = loss(case, &values, &case.tensors()).backward().unwrap();
            flat(gradients.get(&values).unwrap())
        };
        let difference = crate::case::difference(&gradient(&once), &gradient(&twice));
        assert!(difference < 1e-9, "{kind:?} {difference:e}");
    }
}

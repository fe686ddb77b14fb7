//! The operation of candle.

use super::cases::{Single, random};
use attn_head::fused::{self, Neighbourhood};
use attn_head::{Config, Kind, OUTPUTS};
use candle_core::{DType, Device, Tensor, Var};

const N: usize = 50;

struct Tensors {
    config: Config,
    weights: Tensor,
    geometry: Tensor,
    image: Tensor,
    neighbourhood: Neighbourhood,
}

impl Tensors {
    fn apply(&self) -> candle_core::Result<Tensor> {
        fused::apply(&self.config, &self.weights, &self.geometry, &self.image, &self.neighbourhood)
    }
}

fn tensors(single: &Single) -> Tensors {
    let inputs = single.inputs();
    let tensor =
        |values: &[f32], shape: &[usize]| Tensor::from_slice(values, shape, &Device::Cpu).expect("a tensor");
    Tensors {
        config: single.config,
        weights: tensor(&single.weights, &[single.weights.len()]),
        geometry: tensor(inputs.geometry, &[N, single.config.geometry]),
        image: tensor(inputs.image, &[N, single.config.image]),
        neighbourhood: Neighbourhood {
            k: inputs.k,
            neighbours: inputs.neighbours.into(),
            relative: inputs.relative.into(),
            cells: inputs.cells.into(),
        },
    }
}

fn numbers(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().and_then(|t| t.to_vec1()).expect("numbers")
}

#[test]
fn outputs_and_gradients_are_those_of_the_functions() -> candle_core::Result<()> {
    Kind::ALL.into_iter().try_for_each(|kind| compare(&Single::new(&random(kind, N, 4, 8, 5))))
}

fn compare(single: &Single) -> candle_core::Result<()> {
    let plain = tensors(single);
    let (expected, tape) = fused::forward_recorded(&single.config, &single.weights, &single.inputs());
    assert_eq!(numbers(&plain.apply()?), expected);
    let vars = [
        Var::from_tensor(&plain.weights)?,
        Var::from_tensor(&plain.geometry)?,
        Var::from_tensor(&plain.image)?,
    ];
    let [weights, geometry, image] = vars.each_ref().map(|v| v.as_tensor().clone());
    let out = Tensors { weights, geometry, image, ..plain }.apply()?;
    assert_eq!(out.dims(), [N, OUTPUTS]);
    assert_eq!(numbers(&out), expected);
    let factors: Vec<f32> = (0..N * OUTPUTS).map(|i| (i % 11) as f32 - 5.0).collect();
    let loss = (&out * Tensor::from_slice(&factors, out.shape(), &Device::Cpu)?)?.sum_all()?;
    let found = loss.backward()?;
    let expected = fused::backward(&single.config, &single.weights, &single.inputs(), &tape, &factors);
    for (var, expected) in vars.iter().zip([expected.weights, expected.geometry, expected.image]) {
        assert_eq!(numbers(found.get(var).expect("a gradient")), expected);
    }
    Ok(())
}

#[test]
fn tensors_that_do_not_fit_are_errors_that_name_them() -> candle_core::Result<()> {
    let make = || tensors(&Single::new(&random(Kind::Attention, N, 4, 8, 5)));
    let fails = |tensors: Tensors, words: &[&str]| {
        let error = tensors.apply().expect_err("what does not fit").to_string();
        assert!(words.iter().all(|w| error.contains(w)), "{error}");
    };
    let t = make();
    fails(Tensors { weights: t.weights.narrow(0, 0, 10)?, ..make() }, &["weights", "[10]"]);
    fails(Tensors { image: t.image.narrow(0, 0, 10)?, ..make() }, &["image", "[10, 8]", "[50, 8]"]);
    fails(Tensors { image: t.image.to_dtype(DType::F64)?, ..make() }, &["image", "F64", "F32"]);
    let strided = Tensor::zeros((8, N), DType::F32, &Device::Cpu)?.t()?;
    fails(Tensors { image: strided, ..make() }, &["image", "contiguous"]);
    // A head of another kind has another number of weights.
    fails(
        Tensors { config: Config { kind: Kind::EdgeConv, ..t.config }, ..make() },
        &["weights", "expected"],
    );
    let mut n = t.neighbourhood;
    n.neighbours = vec![N as u32; 4 * N].into();
    fails(Tensors { neighbourhood: n.clone(), ..make() }, &["anchor 0", "neighbour 50"]);
    n.neighbours = vec![0; 3].into();
    fails(Tensors { neighbourhood: n, ..make() }, &["neighbours", "3", "200"]);
    Ok(())
}

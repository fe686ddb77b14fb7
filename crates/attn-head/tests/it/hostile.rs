use crate::case::Case;
#[cfg(feature = "candle")]
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Error, Head, Inputs, Kind};
#[cfg(feature = "candle")]
use candle_core::{DType, Device, Tensor};

fn refusal(case: &Case, change: impl FnOnce(&mut Case)) -> String {
    let head = Head::new(case.weights()).unwrap();
    let mut changed = case.clone();
    change(&mut changed);
    head.run(&changed.inputs()).unwrap_err().to_string()
}

#[test]
fn what_does_not_fit_is_named() {
    for kind in Kind::ALL {
        let case = Case::new(kind, 4, 2, 1);
        let said = |change: fn(&mut Case)| refusal(&case, change);
        assert_eq!(said(|c| c.geometry.truncate(11)), "geometry: 11 numbers, expected 12");
        assert_eq!(said(|c| c.image.clear()), "image: 0 numbers, expected 8");
        assert_eq!(said(|c| c.neighbours.push(0)), "neighbours: 9 numbers, expected 8");
        assert_eq!(said(|c| c.relative.truncate(7)), "relative: 7 numbers, expected 8");
        assert_eq!(said(|c| c.neighbours[5] = 4), "anchor 2 has neighbour 4, expected an index below 4");
        assert_eq!(said(|c| c.geometry[3] = f32::NAN), "geometry of anchor 1 is not finite");
        assert_eq!(said(|c| c.image[7] = f32::INFINITY), "image of anchor 3 is not finite");
        assert_eq!(said(|c| c.relative[4][2] = f32::NEG_INFINITY), "relative of anchor 2 is not finite");
        assert_eq!(said(|c| c.cells.truncate(3)), "cells: 3 numbers, expected 4");
        assert_eq!(said(|c| c.cells[2][1] = 4), "anchor 2 lies in cell 4, expected an index below 4");
        // Products of sizes that no machine word holds.
        assert!(said(|c| c.n = usize::MAX).starts_with("geometry: 12 numbers, expected"));
    }
}

#[test]
fn an_mlp_takes_the_neighbours_that_it_is_made_for() {
    for kind in Kind::ALL {
        let head = Head::new(Case::new(kind, 4, 2, 1).weights()).unwrap();
        let other = Case::new(kind, 4, 3, 1);
        match head.run(&other.inputs()) {
            Err(Error::NeighboursFixed { expected: 2, found: 3 }) => assert_eq!(kind, Kind::Mlp),
            out => assert!(out.unwrap().len() == 4 * 38 && kind != Kind::Mlp),
        }
    }
}

/// Extreme inputs give finite outputs or an error that names the anchor.
#[test]
fn extreme_inputs_do_not_give_nans() {
    for kind in Kind::ALL {
        for value in [f32::MAX, -f32::MAX, 1e30, 1e19, f32::MIN_POSITIVE, 1e-45] {
            let case = Case::new(kind, 4, 2, 1);
            let head = Head::new(case.weights()).unwrap();
            for input in 0..3 {
                let mut case = case.clone();
                match input {
                    0 => case.geometry[4] = value,
                    1 => case.image[3] = value,
                    _ => case.relative[3][0] = value,
                }
                match head.run(&case.inputs()) {
                    Ok(out) => assert!(out.iter().all(|v| v.is_finite())),
                    Err(error) => {
                        assert!(matches!(error, Error::OutputNotFinite { anchor: 0..4 }), "{error}");
                        assert!(value.abs() >= 1e19, "{kind:?}: {value:e} is not extreme");
                    }
                }
            }
        }
    }
}

#[cfg(feature = "candle")]
#[test]
fn tensors_of_other_shapes_are_named() {
    let case = Case::new(Kind::Attention, 4, 2, 1);
    let values = case.weights().to_tensor(DType::F64, &Device::Cpu).unwrap();
    let network = Network::new(case.config, &values).unwrap();
    let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F64, &Device::Cpu).unwrap();
    let good = case.tensors();
    let said = |inputs: TensorInputs| network.forward(&inputs).unwrap_err().to_string();
    let geometry = TensorInputs { geometry: zeros(&[4, 2]), ..good.clone() };
    assert_eq!(said(geometry), "geometry has shape [4, 2], expected [4, 3]");
    let relative = TensorInputs { relative: zeros(&[4, 2]), ..good.clone() };
    assert_eq!(said(relative), "relative has shape [4, 2], expected [4, 2, 3]");
    let index = Tensor::from_vec(vec![0_u32, 1, 2, 3, 0, 9, 2, 3], (4, 2), &Device::Cpu).unwrap();
    let neighbours = TensorInputs { neighbours: index.clone(), ..good.clone() };
    assert_eq!(said(neighbours), "anchor 2 has neighbour 9, expected an index below 4");
    let neighbours = TensorInputs { neighbours: index.flatten_all().unwrap(), ..good };
    assert_eq!(said(neighbours), "neighbours has shape [8], expected 2 dimensions");
    let short = values.narrow(0, 0, 10).unwrap();
    assert!(matches!(Network::new(case.config, &short), Err(Error::Shape { what: "weights", .. })));
}

#[test]
fn inputs_check_themselves() {
    let case = Case::new(Kind::EdgeConv, 3, 1, 2);
    case.inputs().check(&case.config).unwrap();
    let config = attn_head::Config { geometry: 0, ..case.config };
    let error = Inputs { geometry: &[], ..case.inputs() }.check(&config).unwrap_err();
    assert_eq!(error.to_string(), "geometry is 0, expected 1 to 4096");
}

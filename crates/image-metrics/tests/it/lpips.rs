//! LPIPS against PyTorch, its gradient against differences, and what must be refused.

use crate::recipe::{cases, fixture, lpips, tensors, values, write};
use gs_scene::Image;
use image_metrics::{Error, Lpips, LpipsNetwork, WeightFault, WeightProblem};
use std::path::PathBuf;

#[test]
fn figures_and_gradients_equal_those_of_pytorch() {
    for network in crate::recipe::NETWORKS {
        let cases = cases(&fixture(), &lpips(network));
        assert_eq!(cases.len(), 10);
        for case in cases {
            assert!(case.holds(), "{}: off by {:e}", case.name, case.deviation());
        }
    }
}

/// Smooth, with a grain by `seed`.
fn picture(width: usize, height: usize, seed: usize) -> Image {
    let value =
        |i: usize| 0.5 + 0.3 * ((i / 3) as f32 / 50.0).sin() + ((i * i + seed * i) % 997) as f32 / 9970.0;
    Image::new(width, height, (0..width * height * 3).map(value).collect()).expect("a picture")
}

#[test]
fn the_gradient_is_the_slope_along_a_direction() {
    let lpips = lpips(LpipsNetwork::SqueezeNet);
    let (a, b) = (picture(37, 29, 5), picture(37, 29, 6));
    let target = lpips.target(&b).unwrap();
    let (distance, gradient) = target.distance_and_gradient(a.data()).unwrap();
    assert_eq!(distance, target.distance(a.data()).unwrap());
    // Along the gradient itself: its slope is the square of its length, whose sign and size no chance gives.
    let length = gradient.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
    let moved = |by: f64| {
        let data: Vec<f32> =
            a.data().iter().zip(&gradient).map(|(&a, &g)| a + (by * f64::from(g) / length) as f32).collect();
        target.distance(&data).unwrap()
    };
    let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
    assert!((slope / length - 1.0).abs() < 0.02, "{slope} for {length}");
    let at_rest = lpips.target(&a).unwrap().distance_and_gradient(a.data()).unwrap();
    assert!(at_rest.0 < 1e-12 && at_rest.1.iter().all(|g| g.abs() < 1e-6));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let lpips = lpips(LpipsNetwork::SqueezeNet);
    let (a, b) = (picture(75, 64, 1), picture(75, 64, 2));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (distance, gradient) =
            pool.install(|| lpips.target(&b).unwrap().distance_and_gradient(a.data()).unwrap());
        (distance.to_bits(), gradient.iter().map(|value| value.to_bits()).collect::<Vec<_>>())
    };
    let one = on(1);
    assert!(on(2) == one && on(5) == one);
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let lpips = lpips(LpipsNetwork::SqueezeNet);
    let minimum = lpips.minimum();
    assert_eq!(minimum, 17);
    let small = lpips.target(&picture(minimum - 1, 40, 1)).err().unwrap();
    assert_eq!(small, Error::TooSmall { width: minimum - 1, height: 40, minimum });
    let smallest = picture(minimum, minimum, 1);
    let target = lpips.target(&smallest).unwrap();
    assert!(target.distance(picture(minimum, minimum, 2).data()).unwrap() > 0.0);
    assert!(matches!(target.distance(&[0.0; 3]), Err(Error::Length { picture: "first", .. })));
    assert!(matches!(lpips.distance(&smallest, &picture(20, 20, 1)), Err(Error::SizeMismatch { .. })));
    let mut broken = smallest.data().to_vec();
    broken[(3 * minimum + 5) * 3 + 1] = f32::NAN;
    let expected = Error::NotFinite { picture: "fitted", x: 5, y: 3 };
    assert_eq!(target.distance_and_gradient(&broken).unwrap_err(), expected);
    broken[(3 * minimum + 5) * 3 + 1] = -2e6;
    assert!(matches!(target.distance(&broken), Err(Error::OutOfRange { .. })));
    // Without light every feature may vanish, and none of it is a NaN.
    let (distance, gradient) = target.distance_and_gradient(&vec![-1e6; broken.len()]).unwrap();
    assert!(distance.is_finite() && gradient.iter().all(|value| value.is_finite()));
}

type Tensors = Vec<(String, Vec<usize>, Vec<f32>)>;

fn squeezenet() -> Tensors {
    let all = tensors(LpipsNetwork::SqueezeNet).into_iter();
    all.map(|(name, shape)| (name.clone(), shape.clone(), values(&name, &shape))).collect()
}

fn read(files: &[&Tensors]) -> Result<Lpips, Error> {
    let folder = tempfile::tempdir().expect("a folder");
    let paths: Vec<PathBuf> =
        (0..files.len()).map(|i| folder.path().join(format!("{i}.safetensors"))).collect();
    paths.iter().zip(files).for_each(|(path, tensors)| write(path, tensors));
    Lpips::read(&paths)
}

#[test]
fn weights_may_have_the_names_of_torchvision_and_lie_in_two_files() {
    let (a, b) = (picture(40, 33, 1), picture(40, 33, 2));
    let whole = squeezenet();
    let expected = read(&[&whole]).unwrap().distance(&a, &b).unwrap();
    let (mut linear, mut network) = (Vec::new(), Vec::new());
    for (name, shape, values) in whole {
        match name.strip_prefix("net.slice") {
            Some(rest) => {
                network.push((format!("features.{}", rest.split_once('.').unwrap().1), shape, values));
            }
            None => linear.push((name, shape, values)),
        }
    }
    network.push(("classifier.1.bias".into(), vec![2], vec![0.0; 2]));
    linear.push(("scaling_layer.shift".into(), vec![1, 3, 1, 1], vec![-0.030, -0.088, -0.188]));
    for files in [[&network, &linear], [&linear, &network]] {
        let lpips = read(&files).unwrap();
        assert_eq!((lpips.network(), lpips.distance(&a, &b).unwrap()), (LpipsNetwork::SqueezeNet, expected));
    }
}

#[test]
fn every_tensor_that_does_not_fit_is_named() {
    let mut broken = squeezenet();
    let at = |broken: &Tensors, name: &str| broken.iter().position(|(found, ..)| found == name).unwrap();
    let missing = at(&broken, "net.slice4.9.squeeze.bias");
    broken.remove(missing);
    let misshapen = at(&broken, "lin2.model.1.weight");
    (broken[misshapen].1, broken[misshapen].2) = (vec![1, 3, 1, 1], vec![0.0; 3]);
    let infinite = at(&broken, "net.slice1.0.bias");
    broken[infinite].2[7] = f32::INFINITY;
    broken.push(("net.more".into(), vec![1], vec![0.0]));
    broken.push(("scaling.scale".into(), vec![3], vec![0.5; 3]));
    let Err(Error::Weights { network, mut problems, .. }) = read(&[&broken]) else {
        panic!("they do not fit")
    };
    assert_eq!(network, LpipsNetwork::SqueezeNet);
    problems.sort_by(|a, b| a.name.cmp(&b.name));
    let problem = |name: &str, fault| WeightProblem { name: name.into(), fault };
    let expected = [
        problem("features.0.bias", WeightFault::NotFinite),
        problem("features.9.squeeze.bias", WeightFault::Missing),
        problem("lin2.weight", WeightFault::Shape { expected: vec![256], found: vec![1, 3, 1, 1] }),
        problem("net.more", WeightFault::Unexpected),
        problem("scaling.scale", WeightFault::Constant),
    ];
    assert_eq!(problems, expected);
    let whole = squeezenet();
    let Err(Error::Weights { problems, .. }) = read(&[&whole, &whole]) else { panic!("all is there twice") };
    assert!(problems.len() == whole.len() && problems.iter().all(|p| p.fault == WeightFault::Twice));
    let linear: Tensors = whole.into_iter().filter(|(name, ..)| name.starts_with("lin")).collect();
    assert!(matches!(read(&[&linear]), Err(Error::WeightsUnknown { found: 7, .. })));
}

#[test]
fn files_that_are_none_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.pth");
    assert!(matches!(Lpips::read(std::slice::from_ref(&path)), Err(Error::WeightsUnreadable { .. })));
    for bytes in [&b""[..], b"PK\x03\x04", b"\x80\x02", b"{}", &[0xff; 40]] {
        std::fs::write(&path, bytes).unwrap();
        let error = Lpips::read(std::slice::from_ref(&path)).err().unwrap();
        assert!(matches!(error, Error::WeightsUnreadable { .. }), "{bytes:?}: {error}");
    }
    assert!(matches!(Lpips::read(&[]), Err(Error::WeightsUnknown { found: 0, .. })));
}

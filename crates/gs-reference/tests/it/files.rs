//! Files that are no golden data, and what is done to those that are.

use gs_reference::tolerance::{f32_bound, f32_gradient_bound};
use gs_reference::{Case, Error, ShAxes, backward, compare, render};
use safetensors::tensor::{Dtype, TensorView};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/gs-raster").join(name)
}

type Tensors = HashMap<String, (Dtype, Vec<usize>, Vec<u8>)>;

/// Reads a case after `change` was made to the tensors and metadata of a file.
fn changed(change: impl FnOnce(&mut Tensors, &mut HashMap<String, String>)) -> Result<Case, Error> {
    let bytes = std::fs::read(fixture("a_single.safetensors")).expect("a fixture");
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).expect("a header");
    let mut metadata = header.metadata().clone().expect("metadata");
    let mut tensors: Tensors = safetensors::SafeTensors::deserialize(&bytes)
        .expect("tensors")
        .iter()
        .map(|(name, view)| (name.into(), (view.dtype(), view.shape().to_vec(), view.data().to_vec())))
        .collect();
    change(&mut tensors, &mut metadata);
    let views = tensors.iter().map(|(name, (dtype, shape, bytes))| {
        (name, TensorView::new(*dtype, shape.clone(), bytes).expect("a tensor"))
    });
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("case.safetensors");
    safetensors::serialize_to_file(views, Some(metadata), &file).expect("written");
    Case::read(&file)
}

fn set(tensors: &mut Tensors, name: &str, index: usize, value: f32) {
    let (dtype, _, bytes) = tensors.get_mut(name).expect("a tensor");
    match dtype {
        Dtype::F32 => bytes[4 * index..][..4].copy_from_slice(&value.to_le_bytes()),
        Dtype::I32 => bytes[4 * index..][..4].copy_from_slice(&(value as i32).to_le_bytes()),
        other => panic!("{other:?}"),
    }
}

/// What the error says after the name of the file.
fn message(found: Result<Case, Error>) -> String {
    let text = found.expect_err("not golden data").to_string();
    text.split_once("case.safetensors").expect("the file is named").1.into()
}

#[test]
fn what_is_no_golden_data_is_refused_with_file_and_rule() {
    assert!(changed(|_, _| ()).is_ok());

    let absent = Case::read(Path::new("none/case.safetensors")).unwrap_err();
    assert_eq!(absent.to_string(), "cannot read none/case.safetensors");
    assert!(std::error::Error::source(&absent).is_some());
    let text = Case::read(&fixture("README.md")).unwrap_err();
    assert!(text.to_string().ends_with("README.md is not a safetensors file"));

    let no_loss = message(changed(|tensors, _| drop(tensors.remove("graddepth_means"))));
    assert_eq!(no_loss, " has no tensor graddepth_means");
    let half = changed(|tensors, _| {
        let (dtype, _, bytes) = tensors.get_mut("sh").unwrap();
        *dtype = Dtype::F16;
        bytes.truncate(6);
    });
    assert_eq!(message(half), ": tensor sh has type F16, expected F64, F32, I32 or U8");
    let flat = message(changed(|tensors, _| tensors.get_mut("W2").unwrap().1 = vec![32 * 32]));
    assert_eq!(flat, ": tensor W2 has shape [1024], expected [32, 32]");
    let size = message(changed(|tensors, _| set(tensors, "size_wh", 0, 31.0)));
    assert!(size.ends_with("has shape [32, 32, 3], expected [32, 31, 3]"), "{size}");
    let empty = message(changed(|tensors, _| set(tensors, "size_wh", 1, -1.0)));
    assert_eq!(empty, ": number 1 of tensor size_wh is -1, expected at least 1");
    let axes = message(changed(|tensors, _| set(tensors, "config", 8, 2.0)));
    assert_eq!(axes, ": number 8 of tensor config is 2, expected 0 or 1");
    let skew = message(changed(|tensors, _| set(tensors, "K", 1, 0.5)));
    assert_eq!(skew, ": number 1 of tensor K is 0.5, expected 0");
    let threshold = message(changed(|tensors, _| set(tensors, "config", 3, f32::NAN)));
    assert_eq!(threshold, ": number 3 of tensor config is NaN, expected a finite number");
    let degree = changed(|tensors, _| {
        let (_, shape, bytes) = tensors.get_mut("sh").unwrap();
        *shape = vec![1, 25, 3];
        bytes.resize(25 * 3 * 4, 0);
    });
    assert_eq!(message(degree), ": 25 SH coefficients per channel, expected 1, 4, 9 or 16");
    let mirrored = changed(|tensors, _| set(tensors, "viewmat", 0, -1.0)).unwrap_err();
    assert!(matches!(mirrored, Error::Camera { .. }));
    let floors = changed(|_, metadata| drop(metadata.insert("f32_naive".into(), "{".into())));
    assert!(matches!(floors, Err(Error::Floors { .. })));
}

#[test]
fn floors_are_those_of_the_metadata() {
    let case = changed(|_, metadata| {
        let floors = r#"{"image_unambiguous": 0.5, "grad_quats": 0.25}"#;
        metadata.insert("f32_naive".into(), floors.into());
    });
    let case = case.unwrap();
    assert_eq!(case.f32_image_floor, Some(0.5));
    for loss in &case.losses {
        for gradient in &loss.gradients {
            let known = loss.name == "grad" && gradient.variable.name() == "quats";
            assert_eq!(gradient.f32_floor, known.then_some(0.25));
        }
    }
    let without = changed(|_, metadata| drop(metadata.remove("f32_naive"))).unwrap();
    assert_eq!(without.f32_image_floor, None);
}

#[test]
fn a_case_in_other_axes_is_the_same_picture_in_standard_ones() {
    let mut case = Case::read(&fixture("c_rand200_sh3.safetensors")).unwrap();
    let background = case.background.map(f64::from);
    case.profile.sh_axes = ShAxes::E3nn;
    let image = render(&case.gaussians, &case.camera, background, &case.profile).image;
    let same = compare(case.expected.image.iter().copied(), image.iter().copied(), &[]).unwrap();
    assert!(same.max_abs > 0.1, "the axes matter: {same:?}");
    for loss in &mut case.losses {
        let found = backward(&case.gaussians, &case.camera, background, &case.profile, &loss.weights);
        for gradient in &mut loss.gradients {
            gradient.values = found.by(gradient.variable);
        }
    }

    let standard = case.in_standard_axes();
    assert_eq!(standard.profile.sh_axes, ShAxes::Standard);
    let found = render(&standard.gaussians, &standard.camera, background, &standard.profile).image;
    // Quaternions were rounded to f32.
    let deviation = compare(image, found, &standard.ambiguous).unwrap();
    assert!(deviation.max_abs <= f32_bound(&deviation, None), "{deviation:?}");
    for loss in &standard.losses {
        let found =
            backward(&standard.gaussians, &standard.camera, background, &standard.profile, &loss.weights);
        for golden in &loss.gradients {
            let deviation = compare(golden.values.iter().copied(), found.by(golden.variable), &[]).unwrap();
            let (bound, of) = (f32_gradient_bound(&deviation, golden), golden.variable);
            assert!(deviation.max_abs <= bound, "{of:?}: {deviation:?}, bound {bound:e}");
        }
    }
}

//! Golden data made by an independent f64 program. Two of its cases are left to the example `check_case` of gs-raster,
//! to keep the repository small.

use gs_reference::tolerance::{
    AMBIGUOUS, REFERENCE_IMAGE, REFERENCE_INTERMEDIATE, REFERENCE_LOSS, reference_gradient_bound,
};
use gs_reference::{
    Case, Projected, Reference, ReferenceGradients, backward, compare, compare_exactly, compare_to_size,
    project, render,
};
use std::path::{Path, PathBuf};

fn files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/gs-raster");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the fixtures are in the repository")
        .map(|entry| entry.expect("a folder can be listed").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "safetensors"))
        .collect();
    files.sort();
    assert_eq!(files.len(), 21, "golden cases");
    files
}

pub(crate) fn cases() -> impl Iterator<Item = (String, Case)> {
    files().into_iter().map(|file| {
        let name = file.file_stem().expect("a file").to_string_lossy().into_owned();
        (name, Case::read(&file).expect("a golden case"))
    })
}

fn rendered(case: &Case) -> Reference {
    render(&case.gaussians, &case.camera, case.background.map(f64::from), &case.profile)
}

/// The gradients of the case's loss number `loss`.
fn differentiated(case: &Case, loss: usize) -> ReferenceGradients {
    let (background, weights) = (case.background.map(f64::from), &case.losses[loss].weights);
    backward(&case.gaussians, &case.camera, background, &case.profile, weights)
}

#[test]
fn images_equal_the_golden_ones() {
    for (name, case) in cases() {
        let (found, expected) = (rendered(&case), &case.expected);
        let outputs = [
            ("image", &expected.image, &found.image),
            ("alpha", &expected.alpha, &found.alpha),
            ("transmittance", &expected.transmittance, &found.transmittance),
            ("depth_sum", &expected.depth_sum, &found.depth_sum),
            ("depth", &expected.depth, &found.depth),
        ];
        for (output, expected, found) in outputs {
            let deviation = compare_to_size(expected, found).unwrap();
            assert!(deviation.max_abs <= REFERENCE_IMAGE, "{name} {output}: {deviation:?}");
        }
        compare_exactly(&expected.contributors, &found.contributors)
            .unwrap_or_else(|e| panic!("{name} contributors: {e}"));
        compare_exactly(&expected.last, &found.last).unwrap_or_else(|e| panic!("{name} last: {e}"));
    }
}

#[test]
fn losses_equal_the_golden_ones() {
    // Tighter than the images, which are stored as f32.
    for (name, case) in cases() {
        let found = rendered(&case);
        for loss in &case.losses {
            let weights = &loss.weights;
            let (mut sum, mut magnitudes) = (0.0, 0.0);
            for (weights, found) in [
                (&weights.image, &found.image),
                (&weights.alpha, &found.alpha),
                (&weights.depth_sum, &found.depth_sum),
            ] {
                for (weight, found) in weights.iter().zip(found) {
                    sum += weight * found;
                    magnitudes += (weight * found).abs();
                }
            }
            let error = (sum - loss.value).abs();
            assert!(error <= REFERENCE_LOSS * magnitudes, "{name} loss of {}: {error:e}", loss.name);
        }
    }
}

#[test]
fn intermediates_equal_the_golden_ones() {
    for (name, case) in cases() {
        let n = case.gaussians.len();
        let (mut means, mut conics) = (vec![0.0; n * 2], vec![0.0; n * 3]);
        let (mut rgb, mut opacities) = (vec![0.0; n * 3], vec![0.0; n]);
        let mut seen: Vec<Projected> =
            (0..n).filter_map(|i| project(&case.gaussians, i, &case.camera, &case.profile)).collect();
        seen.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index)));
        assert!(
            seen.iter().map(|gaussian| gaussian.index as i32).eq(case.expected.order.iter().copied()),
            "{name}: order"
        );
        for gaussian in seen {
            let i = gaussian.index;
            means[2 * i..2 * i + 2].copy_from_slice(&gaussian.mean.to_array());
            conics[3 * i..3 * i + 3].copy_from_slice(&gaussian.conic);
            rgb[3 * i..3 * i + 3].copy_from_slice(&gaussian.rgb);
            opacities[i] = gaussian.opacity;
        }
        let expected = &case.expected;
        let stages = [
            ("means", &expected.means, means),
            ("conics", &expected.conics, conics),
            ("rgb", &expected.rgb, rgb),
            ("opacities", &expected.opacities, opacities),
        ];
        for (stage, expected, found) in stages {
            let deviation = compare(expected.iter().copied(), found, &[]).unwrap();
            let bound = REFERENCE_INTERMEDIATE * deviation.largest;
            assert!(deviation.max_abs <= bound, "{name} {stage}: {deviation:?}");
        }
    }
}

#[test]
fn gradients_equal_the_golden_ones() {
    for (name, case) in cases() {
        for (i, loss) in case.losses.iter().enumerate() {
            let found = differentiated(&case, i);
            assert_eq!(loss.gradients.len(), [12, 5][i], "{name}: variables");
            for golden in &loss.gradients {
                let of = format!("{name} {}_{}", loss.name, golden.variable.name());
                let deviation =
                    compare(golden.values.iter().copied(), found.by(golden.variable), &[]).unwrap();
                println!(
                    "{of}: {:.1e} of {:.1e}, cosine {}",
                    deviation.max_abs, deviation.largest, deviation.cosine
                );
                assert!(deviation.max_abs <= reference_gradient_bound(&deviation), "{of}: {deviation:?}");
            }
        }
    }
}

#[test]
fn a_wrong_scene_is_noticed() {
    let case = Case::read(&files()[1]).unwrap();
    let mut mutant = case.clone();
    mutant.gaussians.buffers_mut().0[0] += 1e-3;
    let deviation = compare_to_size(&case.expected.image, &rendered(&mutant).image).unwrap();
    assert!(deviation.max_abs > REFERENCE_IMAGE);
    for (i, loss) in case.losses.iter().enumerate() {
        let found = differentiated(&mutant, i);
        for golden in &loss.gradients {
            let deviation = compare(golden.values.clone(), found.by(golden.variable), &[]).unwrap();
            // Light that reaches the background does not depend much on one centre, but its gradient does.
            assert!(deviation.max_abs > reference_gradient_bound(&deviation), "{:?}", golden.variable);
        }
    }
}

#[test]
fn margins_mark_the_pixels_that_the_golden_data_marks() {
    // The threshold of the files is 5e-4 but for three ill-conditioned cases.
    for (name, case) in cases() {
        if ["e01", "e02", "e10"].iter().any(|ill| name.starts_with(ill)) {
            continue;
        }
        let ambiguous = rendered(&case).margin.into_iter().map(|margin| margin < AMBIGUOUS);
        assert!(ambiguous.eq(case.ambiguous), "{name}");
    }
}

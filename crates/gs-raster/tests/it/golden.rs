//! Cases computed by an independent f64 program. Two of its cases
//! are left to the example `check_case`, to keep the repository small: `d_rand2000_sh2` and `i_e3nn_sh`.

use crate::check::{check_rasterizer, check_reference};
use gs_raster::Rasterizer;
use gs_reference::Case;
use std::path::Path;

fn cases() -> Vec<(String, Case)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/gs-raster");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the fixtures are in the repository")
        .map(|entry| entry.expect("a folder can be listed").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "safetensors"))
        .collect();
    files.sort();
    assert_eq!(files.len(), 21, "golden cases");
    files
        .iter()
        .map(|file| {
            let name = file.file_stem().expect("a file").to_string_lossy().into_owned();
            (name, Case::read(file).expect("a golden case"))
        })
        .collect()
}

#[test]
fn every_case_is_within_tolerance() {
    for (name, case) in cases() {
        for row in check_rasterizer(&case, &mut Rasterizer::cpu()).into_iter().chain(check_reference(&case)) {
            assert!(row.holds(), "{name} {}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound);
        }
    }
}

#[test]
fn a_wrong_scene_is_noticed() {
    for (name, mut case) in cases().into_iter().take(6) {
        case.gaussians.buffers_mut().0.chunks_exact_mut(11).for_each(|row| row[0] += 1e-4);
        assert!(check_rasterizer(&case, &mut Rasterizer::cpu()).iter().any(|row| !row.holds()), "{name}");
    }
}

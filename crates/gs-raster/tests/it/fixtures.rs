//! The golden cases of the repository; shared with the example `hard_cases`.

use gs_reference::Case;
use std::path::Path;

/// Their names and the cases, by name.
pub(crate) fn cases() -> Vec<(String, Case)> {
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

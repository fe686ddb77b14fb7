//! Files of PyTorch give what went in; broken ones an error. What a pickle may do at all is tested by view-data's chunks.

use proptest::prelude::*;
use serde_json::Value as Json;
use std::io::Write;
use std::path::{Path, PathBuf};
use tensor_files::{Dtype, TensorFile, TorchError, TorchFile, TorchResult, TorchRule};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/torch-file").join(name)
}

/// Name, shape and values.
type Found = (String, Vec<u64>, Vec<f64>);

/// Every tensor of a file.
fn tensors(path: &Path) -> TorchResult<Vec<Found>> {
    let mut file = TorchFile::open(path)?;
    let state = file.state().unwrap_or_default();
    let state: Vec<_> = state.into_iter().map(|(name, tensor)| (name.to_owned(), tensor)).collect();
    let mut found = Vec::new();
    for (name, tensor) in state {
        // Broken files may state any shape.
        assert!(tensor.count() < 1 << 20);
        found.push((name, tensor.shape().to_vec(), file.numbers(&tensor)?));
    }
    Ok(found)
}

#[test]
fn every_format_gives_what_was_saved() {
    let expected: Json = serde_json::from_slice(&std::fs::read(fixture("expected.json")).unwrap()).unwrap();
    let expected = &expected["tensors"].as_object().unwrap();
    for (file, count) in
        [("state.pt", expected.len()), ("state_legacy.pt", expected.len()), ("state_python2.pt", 3)]
    {
        let found = tensors(&fixture(file)).unwrap();
        assert_eq!(found.len(), count, "{file}");
        for (name, shape, values) in found {
            let expected = &expected[&name];
            assert_eq!(serde_json::json!(shape), expected["shape"], "{file} {name}");
            assert_eq!(serde_json::json!(values), expected["values"], "{file} {name}");
        }
    }
}

#[test]
fn numbers_have_their_type_and_place() {
    let mut file = TorchFile::open(&fixture("state_legacy.pt")).unwrap();
    let bytes = std::fs::read(file.path()).unwrap();
    assert_eq!(file.length(), bytes.len() as u64);
    let find = |file: &TorchFile, name: &str| {
        file.state().unwrap().into_iter().find(|(found, _)| *found == name).unwrap().1
    };
    let count = find(&file, "count");
    assert_eq!((count.dtype(), file.integers(&count).unwrap()), (Dtype::I64, vec![7, -8]));
    let rows = find(&file, "rows");
    let (offset, length) = file.locate(&rows).unwrap();
    let values: Vec<f64> = bytes[offset as usize..][..length as usize]
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&b| f64::from(f32::from_le_bytes(b)))
        .collect();
    assert!(rows.is_contiguous() && values == file.numbers(&rows).unwrap());
    assert!(!find(&file, "columns").is_contiguous());
    assert!(file.pickle().items(file.pickle().root()).is_none());
}

/// The rule that a file of these bytes breaks.
fn rule(bytes: &[u8]) -> TorchRule {
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), bytes).expect("written");
    match tensors(file.path()) {
        Err(TorchError::Torch { rule, .. }) => rule,
        other => panic!("expected a broken rule, found {other:?}"),
    }
}

#[test]
fn rules_of_the_old_format_are_named() {
    let whole = std::fs::read(fixture("state_python2.pt")).unwrap();
    let replaced = |from: &[u8], to: &[u8]| {
        let at = whole.windows(from.len()).position(|window| window == from).unwrap();
        [&whole[..at], to, &whole[at + from.len()..]].concat()
    };
    assert_eq!(rule(&replaced(b"M\xe9\x03.", b"M\xea\x03.")), TorchRule::LegacyVersion);
    assert_eq!(
        rule(&replaced(b"little_endian\x88", b"little_endian\x89")),
        TorchRule::ByteOrder { found: "big".into() }
    );
    let keys = b"\x80\x02](U\x010U\x011U\x012e.";
    for broken in [
        &b"\x80\x02](U\x010U\x011U\x013e."[..],
        b"\x80\x02](U\x010U\x011U\x010e.",
        b"\x80\x02](U\x010K\x01e.",
        b"\x80\x02N.",
    ] {
        assert_eq!(rule(&replaced(keys, broken)), TorchRule::LegacyKeys);
    }
    let absent = rule(&replaced(keys, b"\x80\x02](U\x010U\x011e."));
    assert_eq!(absent, TorchRule::MissingEntry { entry: "storage 2".into() });
    // The length of the first storage, which has 54 elements.
    let length = [keys, &54_u64.to_le_bytes()[..]].concat();
    let states = |count: u64| rule(&replaced(&length, &[keys, &count.to_le_bytes()[..]].concat()));
    assert!(matches!(states(u64::MAX), TorchRule::EntryRange { end: u64::MAX, .. }));
    assert!(matches!(states(1 << 60), TorchRule::EntryRange { .. }));
    assert!(matches!(states(53), TorchRule::EntryRange { .. } | TorchRule::StorageSize { .. }));
    // A pair of three, and a list that a second dictionary asks for again.
    assert_eq!(
        rule(b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}(U\x0dlittle_endian\x88u.\x80\x02ccollections\nOrderedDict\n](](K\x01K\x02K\x03ee\x85R."),
        TorchRule::Call { at: 83, what: "OrderedDict" }
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn damaged_files_are_read_or_refused(
        which in 0..3_usize, at: prop::sample::Index, change: u8, cut: prop::sample::Index, is_cut: bool,
    ) {
        let name = ["state.pt", "state_legacy.pt", "state_python2.pt"][which];
        let mut bytes = std::fs::read(fixture(name)).unwrap();
        if is_cut {
            bytes.truncate(cut.index(bytes.len()));
        } else {
            let at = at.index(bytes.len());
            bytes[at] ^= change;
        }
        let whole = std::fs::read(fixture(name)).unwrap() == bytes;
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &bytes).unwrap();
        let result = tensors(file.path());
        // The archive's directory is at its end, and the old format's numbers are.
        prop_assert!(!is_cut || whole || result.is_err());
    }
}

/// An archive of one tensor of three numbers, `w`, whose storage is of the named type.
fn archive(storage: &str, elements: &[u8]) -> tempfile::NamedTempFile {
    let text = |text: &str| [b"X", &(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let pickle = [
        &b"\x80\x02}"[..],
        &text("w"),
        b"ctorch._utils\n_rebuild_tensor_v2\n((",
        &text("storage"),
        format!("ctorch\n{storage}\n").as_bytes(),
        &text("0"),
        &text("cpu"),
        b"K\x03tQK\x00K\x03\x85K\x01\x85\x89ccollections\nOrderedDict\n)RtRs.",
    ]
    .concat();
    let file = tempfile::NamedTempFile::new().expect("a file");
    let mut zip = zip::ZipWriter::new(file.reopen().expect("the same file"));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in [("data.pkl", &pickle[..]), ("byteorder", b"little"), ("data/0", elements)] {
        zip.start_file(format!("archive/{name}"), stored).expect("an entry");
        zip.write_all(bytes).expect("written");
    }
    zip.finish().expect("an archive");
    file
}

#[test]
fn halves_are_read() {
    // 1.5, -2 and infinity, as IEEE 754 binary16 and as the upper half of binary32.
    let half = [0x00, 0x3e, 0x00, 0xc0, 0x00, 0x7c];
    let brain = [0xc0, 0x3f, 0x00, 0xc0, 0x80, 0x7f];
    for (storage, dtype, bytes) in
        [("HalfStorage", Dtype::F16, half), ("BFloat16Storage", Dtype::BF16, brain)]
    {
        let saved = archive(storage, &bytes);
        let mut file = TorchFile::open(saved.path()).unwrap();
        let tensor = file.state().unwrap()[0].1;
        assert_eq!((tensor.dtype(), tensor.shape()), (dtype, &[3][..]));
        assert_eq!(file.numbers(&tensor).unwrap(), [1.5, -2.0, f64::INFINITY]);
        let (mut file, tensors) = TensorFile::open(saved.path()).unwrap();
        assert_eq!((tensors[0].name.as_str(), &tensors[0].shape[..]), ("w", &[3][..]));
        assert_eq!(file.values(&tensors[0]).unwrap(), [1.5, -2.0, f32::INFINITY]);
        // Four bytes of what should be six.
        let cut = archive(storage, &bytes[..4]);
        let mut file = TorchFile::open(cut.path()).unwrap();
        let tensor = file.state().unwrap()[0].1;
        let error = file.numbers(&tensor).unwrap_err();
        assert!(matches!(error, TorchError::Torch { rule: TorchRule::StorageSize { size: 2, .. }, .. }));
    }
    let saved = archive("CharStorage", &[1, 2, 3]);
    let error = TorchFile::open(saved.path()).map(|_| ()).unwrap_err();
    assert!(matches!(error, TorchError::Torch { rule: TorchRule::StorageType { .. }, .. }), "{error}");
}

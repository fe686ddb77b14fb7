//! The evaluation index.

use crate::folder::{Folder, chain, three_frames};
use view_data::{Error, EvaluationIndex, IndexRule, read_index};

fn read(text: &str) -> view_data::Result<EvaluationIndex> {
    let folder = Folder::new();
    let path = folder.path("index.json");
    std::fs::write(&path, text).unwrap();
    read_index(&path)
}

#[track_caller]
fn check_error(text: &str, expected: &str) {
    let message = chain(&read(text).unwrap_err());
    assert!(message.contains("index.json: ") && message.contains(expected), "{message:?} lacks {expected:?}");
}

const ENTRY: &str = r#"{"context": [0, 2], "target": [1]}"#;

#[test]
fn windows_are_sorted_and_null_entries_dropped() {
    let text = format!(
        r#"{{"fox/10": {ENTRY}, "fox/2": {ENTRY}, "ant/b": {ENTRY}, "fox/x": null, "5aca87f95a9412c6": {ENTRY},
             "fox/3": {{"context": [4, 1], "target": [1, 3], "overlap": 0.7}}}}"#
    );
    let index = read(&text).unwrap();
    let keys: Vec<_> = index.windows.iter().map(|window| (&*window.scene, &*window.key)).collect();
    assert_eq!(
        keys,
        [
            ("5aca87f95a9412c6", "5aca87f95a9412c6"),
            ("ant", "ant/b"),
            ("fox", "fox/2"),
            ("fox", "fox/3"),
            ("fox", "fox/10")
        ]
    );
    assert_eq!(index.dropped.iter().map(|dropped| &*dropped.key).collect::<Vec<_>>(), ["fox/x"]);
    assert!(!index.dropped[0].reason.is_empty());
    let window = &index.windows[3];
    assert_eq!((&*window.context, &*window.target), ([4, 1].as_slice(), [1, 3].as_slice()));
    assert_eq!((window.overlap(), index.windows[2].overlap()), (vec![1], vec![]));
}

#[test]
fn what_is_written_is_read() {
    let text = format!(r#"{{"fox/10": {ENTRY}, "fox/2": {ENTRY}, "b": {ENTRY}}}"#);
    let windows = read(&text).unwrap().windows;
    let folder = Folder::new();
    let path = folder.path("written/index.json");
    view_data::write_index(&path, &windows).unwrap();
    assert_eq!(read_index(&path).unwrap().windows, windows);
    assert!(
        chain(&view_data::write_index(&folder.path(""), &windows).unwrap_err()).contains("cannot be written")
    );
}

#[test]
fn broken_files_name_the_entry() {
    check_error("", "not valid JSON");
    check_error("[1]", "expected an object");
    check_error("{}", "index: has no entries");
    check_error(&format!(r#"{{"a/0": {ENTRY}, "b/0": {ENTRY}, "a/0": null}}"#), "a/0: key occurs twice");
    for entry in ["[0, 1]", "7", r#"{"context": [0]}"#, r#"{"context": 0, "target": [1]}"#] {
        check_error(&format!(r#"{{"a/0": {entry}}}"#), "a/0: entry is not null or an object with lists");
    }
    for position in ["-1", "0.5", "\"1\"", "1e30", "null"] {
        check_error(
            &format!(r#"{{"a/0": {{"context": [0], "target": [{position}]}}}}"#),
            "a/0: entry is not",
        );
    }
    check_error(r#"{"a/0": {"context": [], "target": [1]}}"#, "a/0: context is empty");
    check_error(r#"{"a/0": {"context": [0], "target": []}}"#, "a/0: target is empty");
    check_error(
        r#"{"a/0": {"context": [3, 1, 3], "target": [2]}}"#,
        "a/0: context names frame position 3 twice",
    );
    assert!(matches!(read_index(std::path::Path::new("no/such/index.json")), Err(Error::Read { .. })));
    let text = format!(r#"{{"a/0": {ENTRY}}}"#);
    for cut in 0..text.len() {
        assert!(matches!(read(&text[..cut]), Err(Error::Json { .. })), "{cut}");
    }
}

#[test]
fn windows_are_checked_against_the_data_set() {
    let folder = Folder::new();
    folder.json(&three_frames());
    let mut dataset = folder.open().unwrap();
    dataset.name = "fox".to_owned();
    let text = format!(r#"{{"fox/0": {ENTRY}, "bee/0": {ENTRY}, "bee/1": {ENTRY}, "cat/1": {ENTRY}}}"#);
    let index = read(&text).unwrap();
    assert_eq!(index.windows_of(&dataset).unwrap(), [&index.windows[3]]);
    dataset.name = "dog".to_owned();
    let message = index.windows_of(&dataset).unwrap_err().to_string();
    assert!(message.ends_with("index: no usable entry for scene dog, only for: bee, cat, fox"), "{message}");

    let index = read(r#"{"dog/7": {"context": [0, 1], "target": [2, 3]}}"#).unwrap();
    let error = index.windows_of(&dataset).unwrap_err();
    assert!(
        error.to_string().ends_with("dog/7: target names frame position 3, but dog has 3 frames (0 to 2)")
    );
    assert!(matches!(error, Error::Index { rule: IndexRule::Position { position: 3, .. }, .. }));
}

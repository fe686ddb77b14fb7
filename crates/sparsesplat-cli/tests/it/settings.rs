//! What a user says is done, or refused: no setting is dropped in silence.

use crate::tiny::{Tiny, call, read_json};
use std::fs;
use std::path::Path;

/// Asserts that a call is refused and names every part.
fn refused(arguments: &[&str], parts: &[&str]) {
    let called = call(arguments);
    assert_eq!(called.code, Some(2), "{arguments:?}: {}{}", called.stdout, called.stderr);
    assert!(parts.iter().all(|part| called.stderr.contains(part)), "no {parts:?} in: {}", called.stderr);
}

#[test]
fn a_device_is_refused_where_nothing_is_rendered() {
    for command in [&["train-depth", "-o", "run"][..], &["bench", "knn"], &["bench", "isa"], &["weights"]] {
        refused(&[command, &["--device", "cpu"]].concat(), &["--device", "renders nothing"]);
    }
}

#[test]
fn settings_of_data_on_disk_are_refused_where_scenes_are_simulated() {
    let tiny = Tiny::new();
    let root = tiny.root();
    let (root, folder) = (root.to_str().unwrap(), tiny.beside("run"));
    let folder = folder.to_str().unwrap();
    refused(&["train", "-o", folder, "--root", root], &["--root", "--dataset"]);
    assert!(!Path::new(folder).exists(), "a folder without a run");
    refused(&["ablate", "head", "-o", folder, "--root", root], &["--root", "--dataset"]);
    refused(&["tradeoff", "--quick", "--root", root], &["--root", "--dataset"]);
    refused(&["paper", "main", "--root", root], &["--root", "--dataset"]);
    for (name, value) in [("--root", root), ("--views", "4"), ("--windows", "2")] {
        refused(&["eval", "--dataset", "simulated", name, value], &[name, "simulated"]);
    }
    let on_disk = ["--dataset", "nerfstudio", "--root", root];
    refused(&[&["eval", "--scenes", "3"], &on_disk[..]].concat(), &["--scenes", "simulated"]);
    refused(&[&["tradeoff", "--quick", "--scenes", "3"], &on_disk[..]].concat(), &["--scenes"]);
    for name in ["--scenes", "--wild-scenes", "--first-seed"] {
        let alone = ["train", "-o", folder, "--simulated-share", "0", name, "3"];
        refused(&[&alone, &on_disk[..]].concat(), &[name, "simulated"]);
    }
    refused(&["train", "-o", folder, "--simulated-share", "0.2"], &["--simulated-share", "--dataset"]);
    refused(&[&["train", "-o", folder, "--simulated-share", "1"], &on_disk[..]].concat(), &["below 1"]);
}

#[test]
fn settings_that_others_leave_without_an_effect_are_refused() {
    let tiny = Tiny::new();
    let (root, scene) = (tiny.root(), tiny.beside("scene.ply"));
    let base = ["reconstruct", root.to_str().unwrap(), "-o", scene.to_str().unwrap()];
    for (more, part) in [
        (["--allocation", "pixel-aligned", "--gaussians", "1k"], "--gaussians"),
        (["--allocation", "pixel-aligned", "--tau", "1"], "--tau"),
        (["--allocation", "merged", "--tau", "1"], "--tau"),
        (["--allocation", "voxel-aligned", "--sampler", "fixed"], "--sampler"),
        (["--allocation", "laplacian", "--smooth-weight", "1"], "--smooth-weight"),
        (["--corrector", "default", "--looks", "1"], "--corrector"),
        (["--corrector", "default", "--head", "closed-form"], "--corrector"),
        (["--allocation", "merged", "--corrector", "default"], "--corrector"),
        (["--backbone", "given-depth", "--depth-range", "1,2"], "--depth-range"),
    ] {
        refused(&[&base[..], &more].concat(), &[part, "no effect"]);
    }
    let folder = tiny.beside("");
    let merge = ["tradeoff", "--merge", folder.to_str().unwrap()];
    for (name, value) in [("--gaussians", "1k"), ("--dataset", "nerfstudio"), ("--size", "48x32")] {
        refused(&[&merge[..], &[name, value]].concat(), &[name, "--merge"]);
    }
    let replica = ["simulate", "--seed", "1", "--format", "replica", "--pictures", "png", "-o"];
    refused(&[&replica[..], &[scene.to_str().unwrap()]].concat(), &["--pictures", "JPEG"]);
    let index = tiny.path("evaluation_index.json");
    let indexed = ["eval", "--dataset", "nerfstudio", "--root", root.to_str().unwrap(), "--index"];
    for name in ["--views", "--windows"] {
        refused(&[&indexed[..], &[index.to_str().unwrap(), name, "2"]].concat(), &[name, "--index"]);
    }
}

#[test]
fn a_number_of_views_counts_for_more_than_an_index_that_lies_there() {
    let tiny = Tiny::new();
    let (root, json) = (tiny.root(), tiny.beside("eval.json"));
    assert!(tiny.path("evaluation_index.json").is_file());
    let context = |more: &[&str]| {
        let [root, json] = [&root, &json].map(|path| path.to_str().unwrap());
        let shared = ["eval", "--dataset", "nerfstudio", "--root", root, "--json", json];
        let rest =
            ["--gaussians", "500", "--depth-range", "hint", "--head", "closed-form", "--device", "cpu"];
        call(&[&shared[..], &rest, more].concat()).succeeded();
        read_json(Path::new(json))["scenes"][0]["context"].as_array().unwrap().len()
    };
    assert_eq!(context(&[]), 6);
    assert_eq!(context(&["--views", "4"]), 4);
    fs::write(tiny.path("evaluation_index.json"), r#"{"tiny/0": {"context": [0, 2], "target": [1]}}"#)
        .unwrap();
    assert_eq!(context(&[]), 2);
    assert_eq!(context(&["--windows", "1", "--views", "3"]), 3);
}

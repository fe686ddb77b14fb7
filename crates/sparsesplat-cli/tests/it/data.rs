//! Data sets: simulated, written, read, reconstructed.

use crate::tiny::{Called, Tiny, call, read_json};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// A generated scene in a layout.
fn simulate(format: &str, target: &Path) -> Called {
    let target = target.to_str().unwrap();
    call(&[
        "simulate",
        "--seed",
        "3",
        "--kind",
        "desk",
        "--size",
        "96x64",
        "--samples",
        "1",
        "--pictures",
        "jpeg",
        "--format",
        format,
        "-o",
        target,
    ])
}

#[test]
fn all_layouts_of_a_scene_give_one_and_the_same_reconstruction() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenes: Vec<Vec<u8>> = Vec::new();
    let mut hashes: Vec<Value> = Vec::new();
    for (format, dataset) in [
        ("nerfstudio", "nerfstudio"),
        ("colmap", "colmap"),
        ("colmap-text", "colmap"),
        ("replica", "replica"),
    ] {
        let root = folder.path().join(format).join("desk-3");
        let target = if format == "replica" { root.parent().unwrap() } else { &root };
        fs::create_dir_all(root.parent().unwrap()).unwrap();
        simulate(format, target).succeeded();
        let (index, ply) = (root.join("evaluation_index.json"), folder.path().join(format!("{format}.ply")));
        let json = folder.path().join("eval.json");
        let [root, index, ply, json] = [&root, &index, &ply, &json].map(|path| path.to_str().unwrap());
        call(&[
            "reconstruct",
            root,
            "--index",
            index,
            "--window",
            "desk-3/0",
            "--gaussians",
            "2k",
            "-o",
            ply,
        ])
        .succeeded();
        call(&["eval", "--dataset", dataset, "--root", root, "--gaussians", "1k", "--json", json])
            .succeeded();
        scenes.push(fs::read(ply).unwrap());
        let figures: Value = serde_json::from_slice(&fs::read(json).unwrap()).unwrap();
        hashes.push(figures["data_sha256"].clone());
    }
    for (scene, hash) in scenes.iter().zip(&hashes) {
        assert_eq!(hash, &hashes[0]);
        assert!(hash.as_str().is_some_and(|hash| hash.len() == 64));
        assert!(*scene == scenes[0], "the reconstructions differ");
    }
}

#[test]
fn the_same_seed_gives_the_same_pictures_and_nothing_is_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    simulate("nerfstudio", &a).succeeded();
    simulate("nerfstudio", &b).succeeded();
    for file in ["transforms.json", "images/frame_00004.jpg", "depth/frame_00004.exr"] {
        assert_eq!(fs::read(a.join(file)).unwrap(), fs::read(b.join(file)).unwrap(), "{file}");
    }
    let again = simulate("nerfstudio", &a);
    assert_eq!(again.code, Some(2));
    assert!(again.stderr.contains("not empty"));
}

#[test]
fn a_described_scene_is_photographed_as_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (ron, first, second) = (path("desk.ron"), path("first"), path("second"));
    let small = ["--size", "48x32", "--samples", "1", "--frames", "2"];
    let generated = ["simulate", "--seed", "5", "--write-scene", &ron, "-o", &first];
    call(&[&generated[..], &small].concat()).succeeded();
    // The description has the size and the number of frames that were asked for.
    call(&["simulate", &ron, "--seed", "5", "-o", &second]).succeeded();
    for file in ["images/frame_00001.png", "depth/frame_00001.exr"] {
        let [a, b] = [&first, &second].map(|folder| fs::read(Path::new(folder).join(file)).unwrap());
        assert!(a == b, "{file}");
    }
    for (text, expected) in [("(version: 1, sky: 3)", "desk.ron"), ("(version: 9)", "version")] {
        fs::write(&ron, text).unwrap();
        let refused = call(&["simulate", &ron, "-o", &path("third")]);
        assert_eq!(refused.code, Some(2));
        let message = &refused.stderr;
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
}

#[test]
fn what_is_expected_of_a_data_set_is_explained() {
    let empty = tempfile::tempdir().unwrap();
    let empty = empty.path().to_str().unwrap();
    for (dataset, expected) in [
        ("replica", "traj.txt"),
        ("dl3dv", "transforms.json"),
        ("re10k", "index.json"),
        ("tum", "groundtruth.txt"),
    ] {
        for root in [&[][..], &["--root", empty]] {
            let refused = call(&[&["eval", "--dataset", dataset][..], root].concat());
            let message = &refused.stderr;
            assert_eq!(refused.code, Some(2), "{message}");
            assert!(message.contains(expected) && message.contains("Get it: http"), "{message}");
        }
    }
}

#[test]
fn a_scene_far_from_the_origin_is_as_good_as_one_near_it() {
    let tiny = Tiny::new();
    let (root, json) = (tiny.root(), tiny.beside("eval.json"));
    let [root, json_path] = [&root, &json].map(|path| path.to_str().unwrap());
    let psnr = || {
        let eval =
            ["eval", "--dataset", "nerfstudio", "--root", root, "--gaussians", "2k", "--device", "cpu"];
        let more = ["--depth-range", "hint", "--head", "closed-form", "--json", json_path];
        let called = call(&[&eval[..], &more].concat()).succeeded();
        (read_json(&json)["mean"]["psnr_all"].as_f64().unwrap(), called.stderr)
    };
    let (near, said) = psnr();
    assert!(!said.contains("subtracted"), "{said}");
    tiny.edit(|value| {
        for frame in value["frames"].as_array_mut().unwrap() {
            for (row, by) in [(0, 5e5), (1, 5e6)] {
                let entry = &mut frame["transform_matrix"][row][3];
                *entry = (entry.as_f64().unwrap() + by).into();
            }
        }
    });
    let (far, said) = psnr();
    assert!(said.contains("(500000, 5000000, 0) was subtracted"), "{said}");
    assert!((far - near).abs() < 0.05, "{near} dB near, {far} dB far");
}

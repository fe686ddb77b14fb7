//! DepthSplat's network from a file of weights, as a user calls it. The weights follow a rule: what they say of depth means nothing.

use crate::tiny::{Called, RANGE, Tiny, call, read_json};
use depth_backbone::{DepthSplat, Scales, Variant, Vit};
use safetensors::tensor::{Dtype, TensorView, serialize_to_file};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// A checkpoint, written once for all tests, under its names in published files.
fn checkpoint() -> &'static Path {
    static FILE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = FILE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("network.safetensors");
        let variant = Variant { scales: Scales::Eighth, vit: Vit::Small };
        let weights = DepthSplat::untrained_weights(variant, "").unwrap();
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let bytes: Vec<Vec<u8>> = weights.iter().map(|weight| bytes(&weight.values)).collect();
        let views = weights.iter().zip(&bytes).map(|(weight, bytes)| {
            let view = TensorView::new(Dtype::F32, weight.shape.clone(), bytes).unwrap();
            (format!("encoder.{}", weight.name), view)
        });
        serialize_to_file(views, None, &path).unwrap();
        (folder, path)
    });
    path
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn photographs_become_gaussians_by_either_head() {
    let tiny = Tiny::new();
    let (root, output, json) = (tiny.root(), tiny.beside("scene.ply"), tiny.beside("scene.json"));
    let reconstruct = |more: &[&str]| {
        let shared =
            ["reconstruct", text(&root), "-o", text(&output), "--views", "3", "--depth-range", RANGE];
        let shared = [
            &shared[..],
            &["--backbone", "depthsplat", "--weights", text(checkpoint()), "--json", text(&json)],
        ];
        call(&[&shared.concat(), more].concat())
    };
    // The closed form is the default head: there are no weights for these features.
    reconstruct(&["--gaussians", "700"]).succeeded();
    let found = read_json(&json);
    assert_eq!(found["counts"]["total"], 700);
    assert!(found["seconds"]["backbone"].as_f64().unwrap() > 0.0, "{found}");

    reconstruct(&["--head", "depthsplat", "--allocation", "pixel-aligned", "--far-shell", "off"]).succeeded();
    let found = read_json(&json);
    assert_eq!(found["counts"]["total"], 3 * 120 * 80);
    assert_eq!(found["counts"]["shell"], 0);
    let header = fs::read(&output).unwrap();
    let header = String::from_utf8_lossy(&header[..2000]).into_owned();
    assert!(header.contains("element vertex 28800") && header.contains("f_rest_23"), "{header}");

    let Called { code, stderr, .. } = reconstruct(&["--head", "depthsplat"]);
    assert!(code == Some(2) && stderr.contains("pixel-aligned"), "{stderr}");
}

#[test]
fn a_cache_changes_nothing_and_is_shared_with_training() {
    let folder = tempfile::tempdir().unwrap();
    let (cache, json) = (folder.path().join("cache"), folder.path().join("eval.json"));
    let eval = || {
        let shared =
            ["eval", "--dataset", "simulated", "--size", "48x32", "--gaussians", "300", "--device", "cpu"];
        let backbone = ["--backbone", "depthsplat", "--weights", text(checkpoint()), "--depth-range", RANGE];
        let files = ["--cache", text(&cache), "--json", text(&json)];
        call(&[&shared[..], &backbone, &files].concat()).succeeded();
        read_json(&json)["mean"]["psnr_held_out"].as_f64().unwrap()
    };
    let first = eval();
    let files = || {
        let all = fs::read_dir(&cache).unwrap().map(|entry| entry.unwrap().path());
        all.filter(|path| text(path).ends_with(".geometry.safetensors")).collect::<Vec<PathBuf>>()
    };
    assert_eq!(files().len(), 1);
    assert_eq!(eval(), first);
    assert_eq!(files().len(), 1);

    // A head is trained on the network's features, and its weights belong to them alone.
    let (config, run) = (folder.path().join("short.ron"), folder.path().join("run"));
    fs::write(&config, "(steps: 1, batch: 1, density: (0.05, 0.1), neighbours: 3, targets: 1)").unwrap();
    let train = ["train", "-o", text(&run), "--config", text(&config), "--size", "48x32", "--scenes", "1"];
    let backbone = ["--backbone", "depthsplat", "--weights", text(checkpoint()), "--cache", text(&cache)];
    call(&[&train[..], &backbone, &["--validation-scenes", "1", "--device", "cpu"]].concat()).succeeded();
    // The scene that was measured, one to train on, one to validate on.
    assert_eq!(files().len(), 3);
    let head = run.join("weights.safetensors");
    let shared =
        ["eval", "--dataset", "simulated", "--size", "48x32", "--gaussians", "300", "--depth-range", RANGE];
    let with = |more: &[&str]| call(&[&shared[..], more].concat());
    with(&["--backbone", "depthsplat", "--weights", text(checkpoint()), text(&head)]).succeeded();
    let Called { code, stderr, .. } = with(&["--weights", text(&head)]);
    assert!(code == Some(1) && stderr.contains("trained on features"), "{stderr}");
}

#[test]
fn weights_that_are_missing_or_of_another_kind_are_explained() {
    let tiny = Tiny::new();
    let (root, output, nowhere) = (tiny.root(), tiny.beside("scene.ply"), tiny.beside("nowhere"));
    let reconstruct = |more: &[&str]| {
        call(&[&["reconstruct", text(&root), "-o", text(&output), "--views", "3"][..], more].concat())
    };
    let Called { code, stderr, .. } = reconstruct(&["--weights", text(checkpoint())]);
    assert!(code == Some(2) && stderr.contains("--backbone depthsplat"), "{stderr}");
    let twice = ["--backbone", "depthsplat", "--weights", text(checkpoint()), text(checkpoint())];
    let Called { code, stderr, .. } = reconstruct(&twice);
    assert!(code == Some(2) && stderr.contains("both of a network"), "{stderr}");
    let Called { code, stderr, .. } = reconstruct(&["--weights", text(&nowhere)]);
    assert!(code == Some(2) && stderr.contains("nowhere"), "{stderr}");
    let Called { code, stderr, .. } = reconstruct(&["--head", "depthsplat", "--allocation", "pixel-aligned"]);
    assert!(code == Some(2) && stderr.contains("no head of its own"), "{stderr}");

    // Nothing lies where weights are looked for.
    let empty = tempfile::tempdir().unwrap();
    let binary = || {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_sparsesplat"));
        command.env("SPARSESPLAT_WEIGHTS", empty.path());
        command
    };
    let called = binary()
        .args(["reconstruct", text(&root), "-o", text(&output), "--backbone", "depthsplat"])
        .output()
        .unwrap();
    let stderr = String::from_utf8(called.stderr).unwrap();
    assert!(called.status.code() == Some(2), "{stderr}");
    for part in ["weights --fetch small-dl3dv", text(empty.path()), "huggingface.co"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    let listed = |arguments: &[&str]| {
        let called = binary().args(arguments).output().unwrap();
        assert!(called.status.success());
        String::from_utf8(called.stdout).unwrap()
    };
    fs::write(empty.path().join("depthsplat-gs-small-re10k-256x256-view2-cfeab6b1.pth"), b"").unwrap();
    let list = listed(&["weights"]);
    let line = list.lines().find(|line| line.starts_with("small-re10k")).unwrap();
    assert!(line.contains("yes") && list.contains("CC BY-NC"), "{list}");
    assert!(listed(&["doctor"]).contains("there: small-re10k"));
}

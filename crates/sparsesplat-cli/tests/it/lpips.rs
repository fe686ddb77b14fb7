//! LPIPS in tables and in the loss, with untrained weights by a rule.

use crate::lpips_recipe::{tensors, values, write};
use crate::tiny::{Called, call, read_json};
use image_metrics::LpipsNetwork;
use std::fs;
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Weights of the smallest network: the features in one file, what weighs them in another.
fn write_weights(features: &Path, linear: &Path) {
    let all = tensors(LpipsNetwork::SqueezeNet).into_iter().map(|(name, shape)| {
        let values = values(&name, &shape);
        (name, shape, values)
    });
    let (first, second): (Vec<_>, Vec<_>) = all.partition(|(name, ..)| name.starts_with("net"));
    write(features, &first);
    write(linear, &second);
}

#[test]
fn lpips_is_measured_where_weights_are_given_and_names_its_network() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (features, linear, json) = (at("features.safetensors"), at("linear.safetensors"), at("eval.json"));
    write_weights(&features, &linear);
    let eval = |weights: &[&Path]| {
        let mut words = vec!["eval", "--dataset", "simulated", "--size", "60x40", "--gaussians", "500"];
        words.extend(["--head", "closed-form", "--device", "cpu", "--json", text(&json)]);
        if !weights.is_empty() {
            words.push("--lpips-weights");
            words.extend(weights.iter().map(|path| text(path)));
        }
        call(&words)
    };
    let Called { stdout, .. } = eval(&[&linear, &features]).succeeded();
    assert!(stdout.contains("LPIPS (squeeze)"), "{stdout}");
    let found = read_json(&json);
    assert_eq!(found["lpips_network"], "squeeze");
    assert!(found["mean"]["lpips_held_out"].as_f64().unwrap() > 0.0, "{found}");

    let Called { stdout, .. } = eval(&[]).succeeded();
    assert!(stdout.contains("LPIPS (no weights)"), "{stdout}");
    let found = read_json(&json);
    assert!(found["lpips_network"].is_null() && found["mean"]["lpips_held_out"].is_null());

    // In the tables of sweeps, too.
    let (paper, weights) = (at("paper.json"), [text(&linear), text(&features)]);
    let words =
        ["paper", "replica", "--scenes", "0", "--size", "60x40", "--head", "closed-form", "--seeds", "0"];
    let more = ["--device", "cpu", "--json", text(&paper), "--lpips-weights"];
    let Called { stdout, .. } = call(&[&words[..], &more, &weights].concat()).succeeded();
    assert!(stdout.contains("LPIPS (squeeze)") && stdout.contains("LPIPS (vgg)"), "{stdout}");
    let found = read_json(&paper);
    assert_eq!(found["lpips_network"], "squeeze");
    assert!(found["rows"].as_array().unwrap().iter().all(|row| row["lpips_held_out"].as_f64() > Some(0.0)));

    let Called { code, stderr, .. } = eval(&[&linear]);
    assert!(code == Some(2) && !stderr.contains("panicked"), "{stderr}");
    let Called { code, stderr, .. } = eval(&[&at("nothing.pth")]);
    assert!(code == Some(2) && stderr.contains("nothing.pth"), "{stderr}");
}

#[test]
fn lpips_in_the_loss_is_another_run() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (features, linear, config) = (at("features.safetensors"), at("linear.safetensors"), at("short.ron"));
    write_weights(&features, &linear);
    fs::write(
        &config,
        "(steps: 2, batch: 1, density: (0.05, 0.1), neighbours: 5, targets: 1, contexts: 0, lambda: 0.5)",
    )
    .unwrap();
    let (output, cache) = (at("run"), at("cache"));
    let train = |output: &Path, more: &[&str]| {
        let mut words = vec!["train", "-o", text(output), "--config", text(&config), "--cache", text(&cache)];
        words.extend(["--size", "60x40", "--scenes", "1", "--validation-scenes", "1", "--device", "cpu"]);
        words.extend(more);
        call(&words)
    };
    let weights = ["--lpips-weights", text(&features), text(&linear)];
    let losses = |output: &Path| -> Vec<f64> {
        let log = fs::read_to_string(output.join("log.jsonl")).unwrap();
        let lines = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        lines.filter_map(|line| line["loss"].as_f64()).collect()
    };
    train(&output, &weights).succeeded();
    let with_lpips = losses(&output);
    let Called { code, stderr, .. } = train(&output, &["--resume"]);
    assert!(code == Some(2) && stderr.contains("structural term"), "{stderr}");
    let without = at("without");
    train(&without, &[]).succeeded();
    let without = losses(&without);
    assert!(with_lpips.len() == 2 && without.iter().zip(&with_lpips).all(|(a, b)| a != b), "{with_lpips:?}");
}

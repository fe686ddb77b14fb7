//! `tradeoff`: the sweep, its interruption, its shards.

use crate::tiny::{Called, RANGE, Tiny, read_json};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::tempdir;

/// Calls the command, outside any cluster.
fn tradeoff(arguments: &[&str], environment: &[(&str, &str)]) -> Called {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sparsesplat"));
    for variable in
        ["SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_COUNT", "JOB_COMPLETION_INDEX", "JOB_COMPLETIONS"]
    {
        command.env_remove(variable);
    }
    let output = command
        .arg("tradeoff")
        .args(arguments)
        .args(["--device", "cpu"])
        .envs(environment.iter().copied())
        .output()
        .unwrap();
    Called {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// A quick sweep over tiny simulated scenes; `scenes` beside that of the demo.
fn quick<'a>(scenes: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let arguments =
        ["--quick", "--scenes", scenes, "--size", "48x32", "--gaussians", "1k", "--depth-range", RANGE];
    [&arguments, more].concat()
}

fn lines(path: &Path) -> Vec<Value> {
    fs::read_to_string(path).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// What does not depend on the clock: point to PSNR, SSIM, Gaussians and size, with all their digits.
fn quality(path: &Path) -> BTreeMap<String, [String; 4]> {
    let json = read_json(path);
    let row = |row: &Value| {
        let figures =
            ["psnr_held_out", "ssim_held_out", "gaussians", "ply_bytes"].map(|key| row[key].to_string());
        (row["point"].as_str().unwrap().to_owned(), figures)
    };
    json["rows"].as_array().unwrap().iter().map(row).collect()
}

fn refused(called: &Called, parts: &[&str]) {
    assert_eq!(called.code, Some(2), "{}{}", called.stdout, called.stderr);
    assert!(parts.iter().all(|part| called.stderr.contains(part)), "no {parts:?} in: {}", called.stderr);
    assert!(!called.stderr.contains("panicked"), "{}", called.stderr);
}

#[test]
fn a_sweep_writes_all_that_is_asked_for_and_goes_on_where_it_was_cut() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let [kept, json, csv, markdown, report] = ["kept", "a.json", "a.csv", "a.md", "a.html"].map(path);
    let files = ["-o", &kept, "--json", &json, "--csv", &csv, "--markdown", &markdown, "--report", &report];
    let called = tradeoff(&quick("0", &files), &[]).succeeded();
    assert!(called.stdout.contains("pixel-aligned PSNR"), "{}", called.stdout);

    let record = read_json(Path::new(&json));
    let points = record["rows"].as_array().unwrap();
    let names: Vec<&str> = points.iter().map(|row| row["point"].as_str().unwrap()).collect();
    for name in [
        "entropy-1k",
        "random-10k",
        "laplacian-2k",
        "merged-1k",
        "voxel-aligned-2k",
        "pixel-aligned",
        "K=5",
        "bernoulli",
        "half-size",
        "closed-form-2k",
    ] {
        assert!(names.contains(&name), "{name}");
    }
    for row in points {
        for key in
            ["psnr_held_out", "ssim_held_out", "seconds_to_gaussians", "frames_per_second", "ply_bytes"]
        {
            assert!(row[key].as_f64().is_some_and(|figure| figure > 0.0), "{}: {key}", row["point"]);
        }
    }
    assert!(points.iter().any(|row| row["on_front_of_seconds"] == true && row["pareto"] == true));
    assert!(points.iter().all(|row| row["lpips_held_out"].is_null()) && record["lpips_network"].is_null());
    let curves: Vec<&str> =
        record["shares"].as_array().unwrap().iter().map(|share| share["curve"].as_str().unwrap()).collect();
    let expected = ["entropy", "laplacian", "random", "merged", "voxel-aligned", "entropy, closed form"];
    assert_eq!(curves, expected);
    assert_eq!(record["windows"], serde_json::json!(["courtyard/0"]));
    assert!(record["recipe"]["config"]["points"][0]["method"]["neighbours"].is_u64());

    let journal = PathBuf::from(&kept).join("points-0-of-1.jsonl");
    let all = lines(&journal);
    assert_eq!(all.len(), 1 + points.len());
    // Single runs are short enough for one pause of the machine to matter.
    let (mut stages, mut totals) = (0.0, 0.0);
    for run in &all[1..] {
        let seconds = run["seconds"].as_object().unwrap();
        let total = seconds["total"].as_f64().unwrap();
        stages += seconds.values().map(|value| value.as_f64().unwrap()).sum::<f64>() - total;
        totals += total;
    }
    assert!((stages - totals).abs() <= 0.05 * totals, "stages {stages} s, in all {totals} s");

    let page = fs::read_to_string(&report).unwrap();
    assert!(
        page.contains("<svg") && page.contains("type=\"range\"") && page.contains("data:image/jpeg;base64,")
    );
    assert!(!page.contains("http://") || !page.replace("http://www.w3.org/2000/svg", "").contains("http"));
    assert_eq!(fs::read_to_string(&csv).unwrap().lines().count(), 1 + points.len());
    let text = fs::read_to_string(&markdown).unwrap();
    assert!(text.contains("a-seconds.svg") && text.contains("pixel-aligned") && text.contains("Machine: "));
    assert!(folder.path().join("a-seconds.svg").is_file());

    // Cut in the middle of a line, as a killed process leaves it.
    let before = quality(Path::new(&json));
    let text = fs::read_to_string(&journal).unwrap();
    let end: usize = text.lines().take(4).map(|line| line.len() + 1).sum();
    fs::write(&journal, &text[..end + 40]).unwrap();
    tradeoff(&quick("0", &["-o", &kept, "--json", &json]), &[]).succeeded();
    // Two runs with one seed, to the last digit.
    assert_eq!(quality(Path::new(&json)), before);
    let again = lines(&journal);
    assert_eq!((again.len(), &again[..4]), (all.len(), &all[..4]));

    let other = tradeoff(&quick("0", &["-o", &kept, "--seeds", "7"]), &[]);
    refused(&other, &["points-0-of-1.jsonl", "another recipe"]);
    fs::write(&journal, "").unwrap();
    refused(&tradeoff(&quick("0", &["-o", &kept]), &[]), &["points-0-of-1.jsonl", "first line"]);
}

#[test]
fn shards_give_what_one_run_gives() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let [whole, shards, together, merged] = ["whole.json", "shards", "together", "merged.json"].map(path);
    tradeoff(&quick("1", &["--head", "closed-form", "--json", &whole]), &[]).succeeded();
    tradeoff(&quick("1", &["--head", "closed-form", "-o", &shards, "--shard", "1/2"]), &[]).succeeded();
    refused(&tradeoff(&["--merge", &shards], &[]), &["shard 0/2 is not there"]);
    let kubernetes = [("JOB_COMPLETION_INDEX", "0"), ("JOB_COMPLETIONS", "2")];
    let called = tradeoff(&quick("1", &["--head", "closed-form", "-o", &together]), &kubernetes).succeeded();
    assert!(called.stdout.contains("shard      0/2: 1 of 2 windows"), "{}", called.stdout);
    tradeoff(&["--merge", &shards, &together, "--json", &merged], &[]).succeeded();
    assert_eq!(quality(Path::new(&merged)), quality(Path::new(&whole)));

    let journal = Path::new(&together).join("points-0-of-2.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    fs::write(&journal, text.replace("\"threads\":", "\"threads\":1")).unwrap();
    refused(&tradeoff(&["--merge", &shards, &together], &[]), &["points-", "recipe.threads"]);
}

#[test]
fn a_window_that_fails_is_named_and_the_exit_code_says_so() {
    let tiny = Tiny::new();
    let index = r#"{"tiny/0": {"context": [4], "target": [5]}}"#;
    fs::write(tiny.path("evaluation_index.json"), index).unwrap();
    let (root, json) = (tiny.root(), tiny.beside("a.json"));
    let [root, json_path] = [&root, &json].map(|path| path.to_str().unwrap());
    let called = tradeoff(&["--quick", "--dataset", "nerfstudio", "--root", root, "--json", json_path], &[]);
    assert_eq!(called.code, Some(1), "{}{}", called.stdout, called.stderr);
    assert!(
        called.stderr.contains("dropped tiny/0") && called.stdout.contains("failed"),
        "{}",
        called.stderr
    );
    assert_eq!(read_json(&json)["dropped"][0]["name"], "tiny/0");
}

#[test]
fn arguments_that_make_no_sense_are_refused() {
    let folder = tempdir().unwrap();
    let output = folder.path().to_str().unwrap();
    for bad in ["", "2", "2/2", "-1/2", "a/b", "0/0"] {
        refused(&tradeoff(&["-o", output, "--shard", bad], &[]), &["--shard", "I/N"]);
    }
    refused(&tradeoff(&["--shard", "0/2"], &[]), &["--output"]);
    refused(&tradeoff(&["--tau", "1"], &[]), &["--tau"]);
    refused(&tradeoff(&["--allocation", "pixel-aligned"], &[]), &["pixel-aligned"]);
    refused(&tradeoff(&["--merge", output, "--quick"], &[]), &["cannot be used with"]);
    refused(&tradeoff(&["--merge", output], &[]), &["points-I-of-N.jsonl"]);
    refused(&tradeoff(&["--merge", "no/such/folder"], &[]), &["no/such/folder"]);
    refused(&tradeoff(&["--weights", "no/such/file", "--quick"], &[]), &["no/such/file"]);
    refused(&tradeoff(&["--dataset", "nerfstudio"], &[]), &["--root"]);
    let slurm = [("SLURM_ARRAY_TASK_ID", "1"), ("SLURM_ARRAY_TASK_COUNT", "2")];
    refused(&tradeoff(&["--quick"], &slurm), &["shard 1/2", "--output"]);
    refused(&tradeoff(&["--quick"], &slurm[..1]), &["SLURM_ARRAY_TASK_COUNT"]);
    refused(&tradeoff(&["--quick"], &[("JOB_COMPLETION_INDEX", "1")]), &["JOB_COMPLETIONS"]);
}

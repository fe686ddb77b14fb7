//! Training and its ablations, as short as they get, and what other commands do with the weights.

use crate::tiny::{Called, RANGE, Tiny, call, read_json};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Values of the tensors of a safetensors file: what comes after its header.
fn values(path: &Path) -> Vec<u8> {
    let bytes = fs::read(path).unwrap();
    let header = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    bytes[8 + header..].to_vec()
}

#[test]
fn a_run_that_is_killed_goes_on_and_its_weights_reconstruct() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let config = at("short.ron");
    fs::write(&config, "(steps: 3, batch: 1, density: (0.05, 0.1), neighbours: 5, targets: 1)").unwrap();
    let (run, cache) = (at("run"), at("cache"));
    let train = |more: &[&str]| {
        let shared = [
            "train",
            "-o",
            text(&run),
            "--config",
            text(&config),
            "--cache",
            text(&cache),
            "--size",
            "60x40",
            "--scenes",
            "1",
            "--validation-scenes",
            "1",
            "--save-every",
            "1",
            "--device",
            "cpu",
        ];
        call(&[&shared[..], more].concat())
    };
    let json = at("train.json");
    train(&["--json", text(&json)]).succeeded();
    let record = read_json(&json);
    assert_eq!((&record["steps"], &record["windows"]), (&3.into(), &1.into()));
    assert_eq!(record["recipe"]["config"]["neighbours"], 5);
    assert!(record["validation"][0]["psnr"].as_f64().unwrap() > 5.0, "{record}");
    let whole = values(&run.join("weights.safetensors"));
    let log = fs::read_to_string(run.join("log.jsonl")).unwrap();
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(lines[0]["recipe"]["config"]["steps"] == 3);
    assert_eq!(lines.iter().filter(|line| line["loss"].is_number()).count(), 3);
    assert!(lines.last().unwrap()["validation"][0]["psnr"].as_f64().unwrap() > 5.0);
    assert!(fs::read_to_string(run.join("curve.svg")).unwrap().contains("</svg>"));
    assert!(run.join("validation/step-000003.png").exists());

    // The mean of two runs, without a step: here of one run and itself.
    let none = at("none.ron");
    fs::write(&none, "(steps: 0, neighbours: 5)").unwrap();
    let weights = run.join("weights.safetensors");
    let shared =
        ["train", "--cache", text(&cache), "--size", "60x40", "--scenes", "1", "--validation-scenes", "1"];
    let mean = at("mean");
    let own =
        ["--config", text(&none), "--from", text(&weights), "--from", text(&weights), "-o", text(&mean)];
    call(&[&shared[..], &own, &["--device", "cpu"]].concat()).succeeded();
    assert_eq!(values(&mean.join("weights.safetensors")), whole);
    let mean = fs::read_to_string(mean.join("log.jsonl")).unwrap();
    let last: Value = serde_json::from_str(mean.lines().last().unwrap()).unwrap();
    assert_eq!(last["validation"], lines.last().unwrap()["validation"]);

    // Nobody begins anew over a run that is there without saying so.
    let Called { code, stderr, .. } = train(&[]);
    assert!(code == Some(2) && stderr.contains("--resume"), "{stderr}");

    // Nothing is left to do; the log is as it was, and the weights too, though a kill may have left earlier ones.
    fs::write(run.join("weights.safetensors"), b"of an earlier step").unwrap();
    train(&["--resume"]).succeeded();
    assert_eq!(fs::read_to_string(run.join("log.jsonl")).unwrap(), log);
    assert_eq!(values(&run.join("weights.safetensors")), whole);

    // Other settings are another run.
    fs::write(&config, "(steps: 4)").unwrap();
    let Called { code, stderr, .. } = train(&["--resume"]);
    assert!(code == Some(2) && stderr.contains("configuration"), "{stderr}");
    fs::write(&config, "(stepps: 4)").unwrap();
    let Called { code, stderr, .. } = train(&[]);
    assert!(code == Some(2) && stderr.contains("stepps"), "{stderr}");

    fs::write(&config, "(steps: 4, rates: (learning_rate: 1e-4))").unwrap();
    let Called { code, stderr, .. } = train(&["--first-seed", "500"]);
    assert!(code == Some(2) && stderr.contains("--first-seed") && stderr.contains("500 to 500"), "{stderr}");
    let Called { code, stderr, .. } = train(&["--first-seed", "490", "--wild-scenes", "10"]);
    assert!(code == Some(2) && stderr.contains("490 to 500"), "{stderr}");

    // Wrong settings are told before a window is prepared, with the file and exit code 2.
    let prepared = fs::read_dir(&cache).unwrap().count();
    for (settings, part) in [("density: (0.5, 0.1)", "density"), ("neighbours: 1000000", "neighbours")] {
        fs::write(&config, format!("({settings})")).unwrap();
        let Called { code, stderr, .. } = train(&["--first-seed", "2000"]);
        assert!(code == Some(2) && stderr.contains("short.ron") && stderr.contains(part), "{stderr}");
    }
    assert_eq!(fs::read_dir(&cache).unwrap().count(), prepared);

    // Another process in the folder.
    fs::write(&config, "(steps: 3)").unwrap();
    let lock = gs_scene::lock_file(&run.join("run.lock")).unwrap();
    assert!(lock.is_some());
    let Called { code, stderr, .. } = train(&["--resume"]);
    assert!(code == Some(2) && stderr.contains("another process"), "{stderr}");
    drop(lock);

    let weights = run.join("weights.safetensors");
    let json = at("eval.json");
    let eval = |weights: &Path| {
        call(&[
            "eval",
            "--dataset",
            "simulated",
            "--size",
            "60x40",
            "--gaussians",
            "500",
            "--device",
            "cpu",
            "--json",
            text(&json),
            "--weights",
            text(weights),
        ])
    };
    eval(&weights).succeeded();
    assert!(read_json(&json)["mean"]["psnr_held_out"].as_f64().unwrap() > 8.0);
    let broken = at("broken.safetensors");
    fs::write(&broken, &fs::read(&weights).unwrap()[..1000]).unwrap();
    let Called { code, stderr, .. } = eval(&broken);
    assert!(
        code != Some(0) && stderr.contains("broken.safetensors") && !stderr.contains("panicked"),
        "{stderr}"
    );
}

#[test]
fn photographs_and_simulated_scenes_are_trained_on_together() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (photographs, config, json) = (at("photographs"), at("short.ron"), at("train.json"));
    let simulate =
        ["simulate", "--seed", "3", "--kind", "desk", "--size", "60x40", "--samples", "1", "--frames", "14"];
    call(&[&simulate[..], &["-o", text(&photographs)]].concat()).succeeded();
    fs::write(&config, "(steps: 4, batch: 1, density: (0.05, 0.1), neighbours: 5, targets: 1)").unwrap();
    let train = |run: &str, share: &str| {
        let (run, cache) = (at(run), at("cache"));
        let files = ["train", "-o", text(&run), "--config", text(&config), "--cache", text(&cache)];
        let sizes = ["--size", "60x40", "--validation-scenes", "1", "--device", "cpu", "--json", text(&json)];
        let data = ["--dataset", "nerfstudio", "--root", text(&photographs), "--simulated-share", share];
        let scenes: &[&str] = if share == "0" { &[] } else { &["--scenes", "1"] };
        call(&[&files[..], &sizes, &data, scenes].concat()).succeeded();
        let record = read_json(&json);
        (
            record["windows"].as_u64().unwrap(),
            record["data_sha256"].clone(),
            values(&run.join("weights.safetensors")),
        )
    };
    let (windows, hash, weights) = train("mixed", "0.5");
    assert!(windows >= 3, "{windows}: some of photographs and one simulated");
    assert_eq!(train("again", "0.5"), (windows, hash.clone(), weights.clone()));
    // Another share is other data; photographs alone are one window less.
    let (same, other_share, other_weights) = train("seldom", "0.1");
    assert!(same == windows && other_share != hash && other_weights != weights);
    let (fewer, alone, _) = train("alone", "0");
    assert!(fewer == windows - 1 && alone != hash);
}

#[test]
fn rows_of_an_ablation_are_trained_once_and_measured_each() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (config, json) = (at("short.ron"), at("rows.json"));
    fs::write(&config, "(steps: 1, batch: 1, density: (0.05, 0.1), targets: 1, contexts: 0)").unwrap();
    let (output, cache) = (at("rows"), at("cache"));
    let ablate_from = |first_seed: &str, rows: &str| {
        let mut words = vec!["ablate", "neighbours", "--rows", rows, "-o", text(&output)];
        words.extend(["--config", text(&config), "--cache", text(&cache), "--json", text(&json)]);
        words.extend(["--size", "60x40", "--scenes", "1", "--evaluation-size", "60x40", "--device", "cpu"]);
        words.extend(["--evaluation-scenes", "1", "--gaussians", "500", "--seeds", "0,1,0"]);
        words.extend(["--first-seed", first_seed]);
        call(&words)
    };
    let Called { code, stderr, .. } = ablate_from("0", "K=0");
    assert!(code == Some(2) && stderr.contains("--first-seed"), "measured on what is trained on: {stderr}");
    let ablate = |rows: &str| ablate_from("1000", rows);
    let one = fs::read_to_string(&config).unwrap();
    fs::write(&config, one.replace("steps: 1", "steps: 0")).unwrap();
    let Called { code, stderr, .. } = ablate("K=0");
    assert!(code == Some(2) && stderr.contains("steps: 0") && stderr.contains("--steps"), "{stderr}");
    fs::write(&config, one.replace("steps: 1", "steps: 1, looks: 3")).unwrap();
    let Called { code, stderr, .. } = ablate("K=0");
    assert!(code == Some(2) && stderr.contains("leave looks out"), "{stderr}");
    fs::write(&config, one).unwrap();
    let Called { code, stderr, .. } = ablate("K=0,K=7");
    assert!(code == Some(2) && stderr.contains("K=7") && stderr.contains("K=30"), "{stderr}");
    ablate("K=0,K=5").succeeded();
    let rows = read_json(&json)["rows"].clone();
    for (row, neighbours) in rows.as_array().unwrap().iter().zip([0, 5]) {
        assert!(
            row["neighbours"] == neighbours && row["steps"] == 1 && row["gaussians"].as_f64() == Some(500.0),
            "{row}"
        );
        assert!(row["psnr_held_out"].as_f64().unwrap() > 5.0 && row["spread"].is_object(), "{row}");
        let trained = output.join(format!("attention-entropy-k{neighbours}-seed0/weights.safetensors"));
        assert!(trained.exists(), "{}", trained.display());
    }
    // Without the paper's method there is nothing to compare with.
    assert_eq!(read_json(&json)["compared"], serde_json::json!([]));
    // What is trained stays as it is; figures are those of before.
    let before = values(&output.join("attention-entropy-k5-seed0/weights.safetensors"));
    ablate("K=5").succeeded();
    assert_eq!(values(&output.join("attention-entropy-k5-seed0/weights.safetensors")), before);
    let again = &read_json(&json)["rows"][0];
    assert_eq!(again["psnr_held_out"], rows[1]["psnr_held_out"]);
    // What was measured is kept beside the weights, and is read instead of measured again.
    let kept = output.join("attention-entropy-k5-seed0/simulated.json");
    let text = fs::read_to_string(&kept).unwrap();
    let psnr = read_json(&kept)["psnr"].clone();
    fs::write(&kept, text.replacen(&psnr.to_string(), "12.5", 1)).unwrap();
    ablate("K=5").succeeded();
    assert_eq!(read_json(&json)["rows"][0]["psnr_held_out"], 12.5);
    // A file that is cut off is measured anew.
    fs::write(&kept, &text[..text.len() / 2]).unwrap();
    ablate("K=5").succeeded();
    assert_eq!(read_json(&json)["rows"][0]["psnr_held_out"], psnr);
}

#[test]
fn shards_of_an_ablation_share_out_its_rows_and_the_whole_table_comes_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (config, json) = (at("short.ron"), at("rows.json"));
    fs::write(
        &config,
        "(steps: 1, batch: 1, feedback: false, density: (0.05, 0.1), targets: 1, contexts: 0)",
    )
    .unwrap();
    let (output, cache) = (at("rows"), at("cache"));
    let ablate = |more: &[&str]| {
        let mut words = vec!["ablate", "neighbours", "--rows", "K=20,covisible,mixed", "-o", text(&output)];
        words.extend(["--config", text(&config), "--cache", text(&cache), "--json", text(&json)]);
        words.extend(["--size", "60x40", "--scenes", "1", "--evaluation-size", "60x40", "--device", "cpu"]);
        words.extend(["--evaluation-scenes", "2", "--gaussians", "300", "--seeds", "0"]);
        words.extend(["--parametrisation", "paper"]);
        call(&[&words[..], more].concat())
    };
    for wrong in ["2/2", "1", "a/b", "0/0", "+0/2"] {
        let Called { code, stderr, .. } = ablate(&["--shard", wrong]);
        assert!(code == Some(2) && stderr.contains("--shard"), "{wrong}: {stderr}");
    }
    ablate(&["--shard", "0/2"]).succeeded();
    let names = |record: &serde_json::Value| -> Vec<String> {
        let rows = record["rows"].as_array().unwrap();
        rows.iter().map(|row| row["row"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names(&read_json(&json)), ["K=20", "mixed"]);
    let Called { stdout, .. } = ablate(&["--shard", "1/2"]).succeeded();
    assert_eq!(names(&read_json(&json)), ["covisible"]);
    assert!(stdout.contains("compared   nothing: the row K=20"), "{stdout}");
    let Called { stdout, .. } = ablate(&["--training-seeds", "0,1"]).succeeded();
    let record = read_json(&json);
    assert_eq!(names(&record), ["K=20", "covisible", "mixed", "K=20", "covisible", "mixed"]);
    let compared = record["compared"].as_array().unwrap();
    assert_eq!(compared.len(), 2);
    for one in compared {
        assert!(
            one["scenes"] == "simulated" && one["scene_count"] == 2 && one["reference"] == "K=20",
            "{one}"
        );
        assert!(one["interval"].is_number() && one["claim_of_paper"] == "-", "{one}");
        assert_eq!(one["by_training_seed"].as_object().unwrap().len(), 2, "{one}");
    }
    assert!(stdout.contains("can be told apart"), "{stdout}");
    for (name, covisible) in [("k20", 0), ("k20-covisible20", 20), ("k20-covisible10", 10)] {
        let weights = output.join(format!("attention-entropy-{name}-paper-seed0/weights.safetensors"));
        let weights = attn_head::Weights::read(&weights).unwrap();
        assert_eq!(weights.metadata.get("covisible").map_or(0, |said| said.parse().unwrap()), covisible);
        assert_eq!(weights.metadata["parametrisation"], "paper");
    }
}

#[test]
fn learned_depth_sees_photographs_and_is_scored_on_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (photographs, config, cache, json) =
        (at("photographs"), at("short.ron"), at("cache"), at("train.json"));
    let simulate = ["simulate", "--kind", "desk", "--size", "96x64", "--samples", "1", "--frames", "14"];
    call(&[&simulate[..], &["--seed", "3", "-o", text(&photographs)]].concat()).succeeded();
    let train = |run: &str, more: &[&str]| {
        let run = at(run);
        let files = ["train-depth", "-o", text(&run), "--config", text(&config), "--cache", text(&cache)];
        let more = [&["--size", "96x64", "--validation-scenes", "1", "--json", text(&json)], more].concat();
        call(&[&files[..], &more].concat()).succeeded();
        (read_json(&json), run.join("weights.safetensors"))
    };
    fs::write(&config, "(steps: 2, batch: 1, crop: (24, 16))").unwrap();
    let data = ["--dataset", "nerfstudio", "--root", text(&photographs)];
    let scenes = ["--scenes", "1", "--wild-scenes", "0"];
    let (mixed, weights) =
        train("mixed", &[&data[..], &scenes, &["--validation-root", text(&photographs)]].concat());
    let (alone, other) = train("alone", &[&data[..], &["--simulated-share", "0"]].concat());
    assert_eq!(mixed["views"].as_u64().unwrap(), alone["views"].as_u64().unwrap() + 6);
    assert!(mixed["data_sha256"] != alone["data_sha256"] && values(&weights) != values(&other));
    assert!(alone["validation"].get("photographs").is_none(), "{alone}");
    let stereo = &mixed["validation"]["photographs"]["stereo"];
    assert!(stereo["confident"].as_f64().unwrap() > 0.0, "{mixed}");
    // Weights are scored as they are.
    fs::write(&config, "(steps: 0)").unwrap();
    let scored = ["--from", text(&weights), "--validation-root", text(&photographs)];
    let (scored, _) = train("scored", &[&scored[..], &scenes].concat());
    let [scored, mixed] = [scored, mixed].map(|record| record["validation"]["photographs"].clone());
    assert_eq!(scored["stereo"], mixed["stereo"]);
    // Files of weights have half the digits.
    let relative = |scores: &serde_json::Value| scores["learned"]["relative"].as_f64().unwrap();
    assert!((relative(&scored) - relative(&mixed)).abs() < 0.01 * relative(&mixed), "{scored} {mixed}");
    // Without measured depth the photographs are compared with each other; they cannot be scored.
    let file = photographs.join("transforms.json");
    let mut transforms = read_json(&file);
    for frame in transforms["frames"].as_array_mut().unwrap() {
        frame.as_object_mut().unwrap().remove("depth_file_path").unwrap();
    }
    fs::write(&file, transforms.to_string()).unwrap();
    let only_photographs = [&data[..], &["--simulated-share", "0"]].concat();
    fs::write(&config, "(steps: 2, batch: 1, crop: (24, 16))").unwrap();
    let (compared, weights) = train("compared", &only_photographs);
    assert_eq!(compared["views"], alone["views"]);
    fs::write(&config, "(steps: 2, batch: 1, crop: (24, 16), photometric: 0, agreement: 0)").unwrap();
    let (_, untaught) = train("untaught", &only_photographs);
    assert!(values(&weights) != values(&untaught));
    let no = at("no");
    let scored = ["train-depth", "-o", text(&no), "--size", "96x64", "--validation-root", text(&photographs)];
    let Called { code, stderr, .. } = call(&[&scored[..], &["--cache", text(&cache)]].concat());
    assert!(code == Some(1) && stderr.contains("measured depth"), "{code:?} {stderr}");
    let no = at("none");
    let refused = ["train-depth", "-o", text(&no), "--dataset", "nerfstudio"];
    let Called { code, stderr, .. } = call(&refused);
    assert!(code == Some(2) && stderr.contains("--root"), "{stderr}");
    let Called { code, stderr, .. } = call(&[&refused[..3], &["--root", text(&photographs)]].concat());
    assert!(code == Some(2) && stderr.contains("--root"), "{stderr}");
}

#[test]
fn learned_depth_is_trained_resumed_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let config = at("short.ron");
    fs::write(&config, "(steps: 2, batch: 1, crop: (24, 16))").unwrap();
    let (run, cache, json) = (at("run"), at("cache"), at("train.json"));
    let train = |more: &[&str]| {
        let (run, config, cache) = (text(&run), text(&config), text(&cache));
        let files = ["train-depth", "-o", run, "--config", config, "--cache", cache];
        let size = ["--size", "60x40", "--scenes", "1", "--wild-scenes", "0", "--validation-scenes", "1"];
        call(&[&files[..], &size, more].concat())
    };
    train(&["--save-every", "1", "--json", text(&json)]).succeeded();
    let record = read_json(&json);
    assert_eq!((&record["steps"], &record["views"]), (&2.into(), &6.into()));
    assert!(record["validation"]["learned"]["relative"].as_f64().unwrap() < 0.5, "{record}");
    let weights = run.join("weights.safetensors");
    let whole = values(&weights);
    fs::write(&weights, b"of an earlier step").unwrap();
    train(&["--resume"]).succeeded();
    assert_eq!(values(&weights), whole);

    let Called { code, stderr, .. } = train(&[]);
    assert!(code == Some(2) && stderr.contains("--resume"), "{stderr}");
    let Called { code, stderr, .. } = train(&["--first-seed", "500"]);
    assert!(code == Some(2) && stderr.contains("--first-seed"), "{stderr}");
    fs::write(&config, "(batch: 0)").unwrap();
    let Called { code, stderr, .. } = train(&["--resume"]);
    assert!(code == Some(2) && stderr.contains("short.ron") && stderr.contains("batch"), "{stderr}");

    let tiny = Tiny::new();
    let found = text(&weights);
    tiny.reconstruct(&["--depth", found, "--depth-range", RANGE]).succeeded();
    tiny.reconstruct(&["--depth", "learned", "--depth-range", RANGE]).succeeded();
    let broken = at("broken.safetensors");
    fs::write(&broken, &fs::read(&weights).unwrap()[..1000]).unwrap();
    for (arguments, part) in [
        (["--depth", text(&broken)], "broken.safetensors"),
        (["--depth", "nonsense"], "stereo, learned"),
        (["--backbone=given-depth", "--depth=learned"], "--depth"),
    ] {
        let Called { code, stderr, .. } = tiny.reconstruct(&arguments);
        assert!(code == Some(2) && stderr.contains(part), "{stderr}");
    }
}

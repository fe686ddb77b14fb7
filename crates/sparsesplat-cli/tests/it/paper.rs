//! `paper`: the paper's tables beside ours.

use crate::tiny::{Called, RANGE, Tiny, call, read_json};
use serde_json::Value;
use std::fs;

/// Calls the command on the tiny data set, in closed form.
fn paper(tiny: &Tiny, words: &[&str]) -> Called {
    let root = tiny.root();
    let data = ["--dataset", "nerfstudio", "--root", root.to_str().unwrap(), "--depth-range", RANGE];
    let method = ["--head", "closed-form", "--device", "cpu", "--seeds", "3"];
    call(&[&["paper"], words, &data, &method].concat())
}

#[test]
fn tables_have_the_papers_figures_beside_ours_and_say_of_what() {
    let tiny = Tiny::new();
    let (json, markdown) = (tiny.beside("paper.json"), tiny.beside("paper.md"));
    let files = ["--json", json.to_str().unwrap(), "--markdown", markdown.to_str().unwrap()];
    let called = paper(&tiny, &[&["main", "runtime", "primitives"], &files[..]].concat()).succeeded();
    let record = read_json(&json);
    let tables = record["tables"].as_array().unwrap();
    let row = |table: usize, key: &str, name: &str| -> &Value {
        tables[table]["rows"].as_array().unwrap().iter().find(|row| row[key] == name).unwrap()
    };
    assert_eq!(tables.len(), 3);
    let ours = row(0, "point", "entropy-10k");
    assert_eq!(ours["paper"]["psnr_held_out"], 21.29);
    assert_eq!(ours["ours"]["gaussians"], 10_000.0);
    let point = record["rows"].as_array().unwrap().iter().find(|row| row["point"] == "merged-40k").unwrap();
    assert_eq!(row(0, "point", "merged-40k")["ours"]["psnr_held_out"], point["psnr_held_out"]);
    assert_eq!(row(0, "paper_row", "GGN")["point"], "merged-150k");
    assert_eq!(row(2, "paper_row", "SplaTAM, RGB-D")["ours"], Value::Null);

    // The stages of a row add up to its total; what is in no stage is within 5 % over all rows.
    let (mut between, mut totals) = (0.0, 0.0);
    for row in tables[1]["rows"].as_array().unwrap() {
        let figures = row["ours"].as_object().unwrap();
        let total = figures["milliseconds_total"].as_f64().unwrap();
        let sum: f64 = figures.values().map(|value| value.as_f64().unwrap()).sum::<f64>() - total;
        assert!((sum - total).abs() < 1e-6 * total, "{figures:?}");
        between += figures["milliseconds_between"].as_f64().unwrap();
        totals += total;
    }
    assert!(between.abs() <= 0.05 * totals, "{between} of {totals} ms are in no stage");

    for text in [called.stdout, fs::read_to_string(&markdown).unwrap()] {
        for part in [
            "DepthSplat",
            "LPIPS (no weights)",
            "context 0, 2, 4, 6, 8, 10; held out 1, 3, 5, 7, 9",
            "120x80",
            "Seeds of the sampling: 3.",
            "Nothing was dropped.",
            "sha256",
        ] {
            assert!(text.contains(part), "no {part:?} in: {text}");
        }
    }
}

#[test]
fn a_table_can_be_made_of_a_sweep_that_is_done_and_names_what_was_dropped() {
    let tiny = Tiny::new();
    let index = r#"{"tiny/0": {"context": [0, 2, 4, 6, 8, 10], "target": [1]}, "tiny/1": {"context": [4], "target": [5]}}"#;
    fs::write(tiny.path("evaluation_index.json"), index).unwrap();
    let kept = tiny.beside("kept");
    let kept = kept.to_str().unwrap();
    let first = paper(&tiny, &["frames", "-o", kept]);
    assert_eq!(first.code, Some(1), "{}{}", first.stdout, first.stderr);
    assert!(first.stdout.contains("Dropped, and in no mean: tiny/1"), "{}", first.stdout);
    let again = call(&["paper", "frames", "--merge", kept]);
    assert_eq!((again.code, again.stdout), (first.code, first.stdout));

    let nothing = call(&["paper"]);
    assert_eq!(nothing.code, Some(2), "{}", nothing.stderr);
}

#[test]
fn mapping_systems_stand_beside_streams() {
    let tiny = Tiny::new();
    let file = |name: &str| tiny.beside(name);
    let text = |path: &std::path::Path| path.to_str().unwrap().to_owned();
    let published = call(&["paper", "mapping"]).succeeded();
    for part in ["SplaTAM", "38.83", "RTX 4090", "No stream was given"] {
        assert!(published.stdout.contains(part), "no {part:?} in: {}", published.stdout);
    }

    let (record, other) = (text(&file("stream.json")), text(&file("other.json")));
    let stream = ["stream", "--demo", "--size", "48x32", "--frames", "5", "--cap", "2k", "-o"];
    let map = text(&file("map.ply"));
    call(&[&stream[..], &[&map, "--evaluate", "--json", &record]].concat()).succeeded();
    let json = text(&file("mapping.json"));
    let called = call(&["paper", "mapping", "--stream", &record, &record, "--json", &json]).succeeded();
    assert!(called.stdout.contains("sparsesplat stream, poses given"), "{}", called.stdout);
    let (table, of_stream) = (read_json(json.as_ref()), read_json(record.as_ref()));
    assert_eq!(table["published"].as_array().unwrap().len(), 5);
    // The mean of one stream with itself.
    assert_eq!(table["ours"]["mapped"]["psnr"], of_stream["measured"]["mapped"]["psnr"]);
    assert_eq!(table["ours"]["inputs"].as_array().unwrap().len(), 2);

    let note = "5 frames of 48x32, measured depth, cap 2 000";
    assert!(table["notes"].to_string().contains(note), "{}", table["notes"]);
    let mut resumed = of_stream.clone();
    resumed["first_frame"] = 3.into();
    let resumed_record = text(&file("resumed.json"));
    fs::write(&resumed_record, resumed.to_string()).unwrap();
    fs::write(&other, "{}").unwrap();
    call(&[&stream[..], &[&map, "--json", &record]].concat()).succeeded();
    for (words, why) in [
        (vec!["mapping", "--stream", &other], "not a record of"),
        (vec!["mapping", "--stream", &record], "with --evaluate"),
        (vec!["mapping", "--stream", &resumed_record], "not the record of a whole stream"),
        (vec!["mapping", "main"], "apart"),
        (vec!["mapping", "--scenes", "1"], "--scenes has no effect"),
        (vec!["frames", "--stream", &record], "--stream has no effect"),
    ] {
        let called = call(&[&["paper"], &words[..]].concat());
        assert!(called.code == Some(2) && called.stderr.contains(why), "{words:?}: {}", called.stderr);
    }
}

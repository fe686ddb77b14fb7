//! The benches, on sizes that take no time: rows, keys, and arguments that are refused.

use crate::tiny::{Called, call, read_json};
use serde_json::{Value, json};

/// Whether kiddo is built in.
const PEERS: bool = cfg!(feature = "peers");

/// The table and the JSON file of a bench of one run on two threads. (A run takes a while to warm up.)
fn bench(name: &str, more: &[&str]) -> (String, Value) {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("bench.json");
    let arguments = ["bench", name, "--runs", "1", "--threads", "2", "--json", json.to_str().unwrap()];
    let called = call(&[&arguments[..], more].concat()).succeeded();
    (called.stdout, read_json(&json))
}

/// Asserts what holds for the rows of every bench.
fn check(row: &Value, bench: &str) {
    assert_eq!(row["bench"], bench);
    let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
    let [least, median, most] = ["seconds_min", "seconds", "seconds_max"].map(number);
    assert!(0.0 < least && least <= median && median <= most, "{row}");
    assert!(number("n") > 0.0 && number("threads") > 0.0, "{row}");
    assert!(row.get("k").is_some() && row.get("peak_rss_bytes").is_some(), "{row}");
    assert!(row["case"].is_string(), "{row}");
}

/// Implementation and case of every row of one of the benches on the processor; `on_two` has those on two threads alone.
fn labels(rows: &Value, bench: &str, on_two: bool) -> Vec<(String, String)> {
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let rows = rows.as_array().unwrap().iter();
    rows.filter(|row| !on_two || row["threads"] == 2)
        .map(|row| {
            check(row, bench);
            assert!(row["seconds_each"].as_f64().unwrap() > 0.0, "{row}");
            (text(&row["impl"]), text(&row["case"]))
        })
        .collect()
}

#[test]
fn neighbours_have_a_row_for_every_set() {
    let (table, found) =
        bench("knn", &["--counts", "50,200", "--neighbours", "3,7", "--case", "surfaces,uniform"]);
    let labels = labels(&found["rows"], "knn", false);
    let of = |implementation: &str, case: &str| {
        labels.iter().filter(|label| (&*label.0, &*label.1) == (implementation, case)).count()
    };
    let peers = if PEERS { 4 } else { 0 };
    for case in ["surfaces", "uniform"] {
        assert_eq!((of("ours", case), of("kiddo", case)), (4, peers), "{case}");
    }
    let growth = found["growth"].as_array().unwrap();
    assert_eq!(growth.len(), if PEERS { 8 } else { 4 });
    assert_eq!((&growth[0]["smallest_n"], &growth[0]["largest_n"]), (&json!(50), &json!(200)));
    assert!(growth[0]["times"].as_f64().unwrap() > 0.0);
    for row in found["rows"].as_array().unwrap() {
        assert_eq!(row["times_ours"].is_number(), row["impl"] == "kiddo", "{row}");
        assert!(row["k"] == 3 || row["k"] == 7, "{row}");
        assert_eq!(row["threads"], 2);
    }
    assert_eq!(table.contains("--features") || table.contains("feature `peers`"), !PEERS, "{table}");
    assert_eq!(found["recipe"]["config"]["neighbours"], json!([3, 7]));
}

#[test]
fn the_backbone_has_a_row_for_every_stage_and_number_of_views() {
    let (table, found) = bench("backbone", &["--size", "64x32", "--views", "2,3"]);
    let rows = found["rows"].as_array().unwrap();
    for views in [2, 3] {
        let of = |row: &&Value| row["n"] == views;
        let stages: Vec<&str> = rows.iter().filter(of).map(|row| row["case"].as_str().unwrap()).collect();
        assert_eq!(stages[0], "whole pass");
        for stage in
            ["cnn", "transformer", "vit", "cost volume", "regressor", "upsampler", "feature upsampler"]
        {
            assert!(stages.contains(&stage) && table.contains(stage), "{stage}: {stages:?}");
        }
        let flop = |row: &Value| row["flop"].as_f64().unwrap();
        let parts: f64 = rows.iter().filter(of).skip(1).map(flop).sum();
        assert_eq!(flop(rows.iter().find(of).unwrap()), parts);
    }
    rows.iter().for_each(|row| check(row, "backbone"));
    assert!(found["gemm_flop_per_second"].as_f64().unwrap() > 0.0);
    let Called { code, stderr, .. } = call(&["bench", "backbone", "--layout", "s3"]);
    assert!(code == Some(2) && stderr.contains("s1_u8l8"), "{stderr}");
}

#[test]
fn entropy_has_a_row_for_every_picture_border_and_sampler() {
    let (_, found) = bench("entropy", &["--size", "40x30", "--budgets", "300"]);
    let on_two = labels(&found["rows"], "entropy", true);
    assert_eq!(2 * on_two.len(), labels(&found["rows"], "entropy", false).len(), "one thread, and two");
    for content in ["textured", "flat", "noise"] {
        for border in ["reflect", "clip"] {
            for implementation in ["ours", "ours-naive"] {
                let label = (implementation.to_owned(), format!("entropy, {content}, {border}"));
                assert!(on_two.contains(&label), "{label:?}");
            }
        }
    }
    for case in ["budget of 300", "fixed sample of 300", "bernoulli sample of 300"] {
        assert!(on_two.contains(&("ours".to_owned(), case.to_owned())), "{case}");
    }
    let naive = found["rows"].as_array().unwrap().iter().filter(|row| row["impl"] == "ours-naive");
    assert!(naive.clone().count() == 12 && naive.clone().all(|row| row["times_ours"].is_number()));
    assert!(found["rows"].as_array().unwrap().iter().all(|row| row["n"] == 6 * 40 * 30));
}

#[test]
fn anchors_have_a_row_for_all_that_can_be_asked_for() {
    let (_, found) = bench("backproject", &["--size", "40x30", "--anchors", "1001"]);
    let on_two = labels(&found["rows"], "backproject", true);
    let cases: Vec<&str> = on_two.iter().map(|(_, case)| &**case).collect();
    let expected = [
        "positions, rays, footprints",
        "+ normals",
        "+ colours",
        "+ 32 features, quarter width",
        "+ 32 features, full width",
    ];
    assert_eq!(cases, expected);
    assert!(found["rows"].as_array().unwrap().iter().all(|row| row["n"] == 1001));
}

#[test]
fn the_renderer_has_a_row_for_every_case() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("raster.json");
    let arguments = ["bench", "raster", "--counts", "500,pixels", "--size", "60x40", "--runs", "2"];
    let more = ["--device", "cpu", "--threads", "2", "--json", json.to_str().unwrap()];
    let called = call(&[&arguments[..], &more].concat()).succeeded();
    assert!(called.stdout.contains("frames/s") && called.stdout.contains("triad"), "{}", called.stdout);

    let found = read_json(&json);
    let rows = found["rows"].as_array().unwrap();
    let of = |case: &str| rows.iter().filter(|row| row["case"] == case).collect::<Vec<_>>();
    // Two counts on one thread and on two; features once.
    assert_eq!((of("forward").len(), of("forward+backward").len()), (4, 4));
    for feature in
        ["plain, SH degree 2", "SH degree 0", "SH degree 3", "depth", "antialias", "gradients", "ellipsoids"]
    {
        let row = of(feature);
        assert_eq!(row.len(), 1, "{feature}");
        assert_eq!((&row[0]["n"], &row[0]["threads"]), (&500.into(), &2.into()), "{feature}");
        assert!(row[0]["times_plain"].as_f64().unwrap() > 0.0, "{feature}");
    }
    for row in rows {
        assert_eq!((&row["impl"], &row["device"]), (&"ours".into(), &"cpu".into()));
        check(row, "raster");
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
        assert!(number("visible") > 0.0 && number("intersections") >= number("visible"), "{row}");
        assert!(number("frames_per_second") > 0.0 && number("bytes_per_second") > 0.0, "{row}");
    }
    assert_eq!(found["memory_bandwidth"].as_array().unwrap().len(), 2);
    assert!(found["recipe"]["config"]["counts"] == serde_json::json!([500, "pixels"]));
}

#[test]
fn the_head_has_rows_for_both_forms_and_for_training() {
    let limits = ["--plain-up-to", "50", "--plain-training-up-to", "30"];
    let shape = ["--heads", "max-pool,attention", "--counts", "30,40,90", "--neighbours", "5"];
    let (table, found) = bench("head", &[shape.as_slice(), &limits].concat());
    let labels = labels(&found["rows"], "head", false);
    let mut expected = Vec::new();
    for [forward, training] in
        [["forward, max-pool", "training, max-pool"], ["forward, attention", "training, attention"]]
    {
        let ours = [("candle", "16 matrix products"), ("ours", forward), ("ours", training)];
        let plain = [("ours-naive", forward), ("ours-naive", training)];
        expected.extend(ours.into_iter().chain(plain).chain(ours).chain([plain[0]]).chain(ours));
    }
    assert_eq!(labels.iter().map(|(a, b)| (&**a, &**b)).collect::<Vec<_>>(), expected);
    let rates = found["rates"].as_array().unwrap();
    assert_eq!(rates.len(), 18);
    for rate in rates {
        let number = |key: &str| rate[key].as_f64().unwrap();
        assert!(number("flop") > 1e6 && number("flop_per_second") > 0.0 && number("share") > 0.0, "{rate}");
    }
    assert!(found["rows"][3]["times_ours"].as_f64().unwrap() > 0.0);
    assert!(table.contains("GFLOP/s"), "{table}");
}

#[test]
fn bench_lists_what_there_is_and_refuses_the_rest() {
    let list = call(&["bench"]).succeeded().stdout;
    for name in ["knn ", "entropy ", "backproject ", "head ", "raster "] {
        assert!(list.lines().any(|line| line.starts_with(name)), "{name}: {list}");
    }
    for arguments in [
        &["bench", "nothing"][..],
        &["bench", "knn", "--counts", "0"],
        &["bench", "knn", "--counts", "many"],
        &["bench", "knn", "--neighbours", "0"],
        &["bench", "knn", "--case", "spiral"],
        &["bench", "knn", "--runs", "0"],
        &["bench", "entropy", "--budgets", "-1"],
        &["bench", "entropy", "--size", "448"],
        &["bench", "entropy", "--runs", "0"],
        &["bench", "backproject", "--anchors", "0"],
        &["bench", "backproject", "--anchors", "601", "--size", "10x10"],
        &["bench", "backproject", "--size", "10x0"],
        &["bench", "head", "--counts", "0"],
        &["bench", "raster", "--counts", "0"],
        &["bench", "raster", "--counts", "many"],
        &["bench", "raster", "--runs", "0"],
        &["bench", "raster", "--size", "0x3"],
    ] {
        let Called { code, stderr, .. } = call(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {stderr}");
        assert!(stderr.starts_with("error: ") && !stderr.contains("panicked"), "{stderr}");
    }
}

use super::*;
use crate::measure::Views;
use crate::sweep::Axis;
use evaluate::Seconds;
use serde_json::json;
use sparsesplat::{Stage, StageSeconds};
use tempfile::tempdir;

pub(crate) fn label(point: &str, axis: Axis, allocation: &str, base: bool) -> Label {
    let count = (allocation != "pixel-aligned").then_some(1000);
    Label { point: point.to_owned(), axis, allocation: allocation.to_owned(), count, draws: true, base }
}

pub(crate) fn header(windows: &[&str], points: &[Label], seeds: &[u64]) -> Header {
    Header {
        recipe: json!({
            "command": ["sparsesplat", "tradeoff"], "config": { "seeds": seeds }, "machine": { "memory_bytes": 1, "cpu": "x" }
        }),
        shard: Shard::WHOLE,
        windows: windows.iter().map(|&window| window.to_owned()).collect(),
        points: points.to_vec(),
        seeds: seeds.to_vec(),
        lpips_network: None,
        dropped: Vec::new(),
    }
}

fn views() -> Views {
    Views { context: vec![0, 2], targets: vec![1], size: (48, 32), data_sha256: "1234".to_owned() }
}

pub(crate) fn measured(window: &str, seed: u64, point: &str, gaussians: usize, psnr: f64) -> Measured {
    let stages = StageSeconds::of_each(|stage| match stage {
        Stage::Backbone => 1.0,
        Stage::Knn => 1e-6 * gaussians as f64,
        _ => 0.0,
    });
    let seconds = Seconds { stages, total: 1.5, render: 0.25, ..Seconds::default() };
    Measured {
        window: window.to_owned(),
        views: Box::new(views()),
        seed,
        point: point.to_owned(),
        gaussians,
        psnr_held_out: Some(psnr).filter(|psnr| psnr.is_finite()),
        ssim_held_out: Some(0.1 + 0.2),
        lpips_held_out: None,
        seconds,
        seconds_per_frame: Some(1e-7 * gaussians as f64),
        ply_bytes: 68 * gaussians as u64,
        peak_rss_bytes: None,
    }
}

fn small() -> Header {
    header(
        &["a/0", "b/0"],
        &[label("p", Axis::Budget, "entropy", true), label("q", Axis::Sampler, "entropy", false)],
        &[0],
    )
}

fn entry(window: &str, point: &str) -> Entry {
    Entry::Measured(measured(window, 0, point, 100, 20.0 / 3.0))
}

#[test]
fn what_was_measured_is_found_again_to_the_last_digit() {
    let folder = tempdir().unwrap();
    let mut journal = Journal::open(folder.path(), &small()).unwrap();
    journal.push(entry("a/0", "p")).unwrap();
    journal
        .push(Entry::Failed(Failed { window: "b/0".into(), point: None, seed: 0, reason: "no".into() }))
        .unwrap();
    assert!(journal.has("a/0", 0, "p") && !journal.has("a/0", 0, "q") && !journal.has("b/0", 0, "p"));
    drop(journal);
    let journal = Journal::open(folder.path(), &small()).unwrap();
    // What failed is tried again.
    assert_eq!(journal.entries(), [entry("a/0", "p")]);
    assert_eq!(journal.measured(), 1);
    // And until then is not done: the failure is no longer in the file.
    drop(journal);
    let error = Shards::read(&[folder.path().to_path_buf()]).unwrap_err().to_string();
    assert!(error.contains("1 of 4 points"), "{error}");
}

#[test]
fn one_process_at_a_time_measures_a_shard() {
    let folder = tempdir().unwrap();
    let first = Journal::open(folder.path(), &small()).unwrap();
    let second = Journal::open(folder.path(), &small());
    assert!(matches!(second, Err(SweepError::Busy { .. })), "{second:?}");
    let half = Header { shard: Shard { index: 0, count: 2 }, ..small() };
    assert!(Journal::open(folder.path(), &half).is_ok(), "another shard");
    drop(first);
    assert!(Journal::open(folder.path(), &small()).is_ok());
}

#[test]
fn a_torn_last_line_is_discarded_and_written_anew() {
    let folder = tempdir().unwrap();
    let path = folder.path().join(journal_name(Shard::WHOLE));
    let mut journal = Journal::open(folder.path(), &small()).unwrap();
    journal.push(entry("a/0", "p")).unwrap();
    let whole = fs::read(&path).unwrap();
    journal.push(entry("a/0", "q")).unwrap();
    drop(journal);
    let all = fs::read(&path).unwrap();
    let garbage = [&whole[..], b"\0\0\0\0\n"].concat();
    for torn in [&all[..all.len() - 1], &all[..whole.len() + 3], &garbage] {
        fs::write(&path, torn).unwrap();
        let mut journal = Journal::open(folder.path(), &small()).unwrap();
        assert_eq!(journal.entries(), [entry("a/0", "p")]);
        journal.push(entry("a/0", "q")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), all);
    }
}

#[test]
fn files_that_are_no_journals_are_refused_by_name() {
    let folder = tempdir().unwrap();
    let path = folder.path().join(journal_name(Shard::WHOLE));
    drop(Journal::open(folder.path(), &small()).unwrap());
    let header_line = fs::read_to_string(&path).unwrap();
    let other = |text: &str| {
        fs::write(&path, text).unwrap();
        Journal::open(folder.path(), &small()).unwrap_err().to_string()
    };
    for text in ["", "\n", "{}\n", "not json\n", header_line.trim_end(), "\0\0\0"] {
        let error = other(text);
        assert!(error.contains("points-0-of-1.jsonl") && error.contains("first line"), "{text:?}: {error}");
    }
    let zero = header_line.replace("\"count\":1", "\"count\":0");
    assert!(other(&zero).contains("first line"));
    let line = serde_json::to_string(&entry("a/0", "p")).unwrap();
    let error = other(&format!("{header_line}garbage\n{line}\n"));
    assert!(error.contains(".jsonl:2:") && error.contains("JSON"), "{error}");
    for (text, part) in [("a/0\"", "c/9\""), ("\"p\"", "\"z\""), ("\"seed\":0", "\"seed\":7")] {
        let strange = line.replace(text, part);
        let error = other(&format!("{header_line}{strange}\n{line}\n"));
        assert!(error.contains(".jsonl:2:") && error.contains("is not one of"), "{error}");
    }
}

#[test]
fn another_recipe_is_refused_and_says_where_it_differs() {
    let folder = tempdir().unwrap();
    drop(Journal::open(folder.path(), &small()).unwrap());
    let mut other = small();
    other.recipe["config"]["seeds"] = json!([0, 1]);
    let error = Journal::open(folder.path(), &other).unwrap_err().to_string();
    assert!(error.contains("recipe.config.seeds is [0] there and [0,1] here"), "{error}");
    let mut same = small();
    same.recipe["command"] = json!(["elsewhere"]);
    same.recipe["machine"]["memory_bytes"] = json!(2);
    assert!(Journal::open(folder.path(), &same).is_ok());
}

#[test]
fn points_of_other_views_are_refused() {
    let folder = tempdir().unwrap();
    let mut journal = Journal::open(folder.path(), &small()).unwrap();
    journal.push(entry("a/0", "p")).unwrap();
    assert!(journal.check_data("a/0", "1234").is_ok() && journal.check_data("b/0", "5678").is_ok());
    let error = journal.check_data("a/0", "5678").unwrap_err().to_string();
    assert!(error.contains("data_sha256 of a/0 is 1234 there and 5678 here"), "{error}");
}

/// The folders of two shards of a sweep, the second with only some of its entries.
fn shards(complete: bool) -> (tempfile::TempDir, Vec<PathBuf>) {
    let folder = tempdir().unwrap();
    let folders: Vec<PathBuf> = (0..2).map(|i| folder.path().join(i.to_string())).collect();
    for (index, window) in ["a/0", "b/0"].into_iter().enumerate() {
        let header = Header { shard: Shard { index, count: 2 }, ..small() };
        fs::create_dir(&folders[index]).unwrap();
        let mut journal = Journal::open(&folders[index], &header).unwrap();
        journal.push(entry(window, "p")).unwrap();
        if complete || index == 0 {
            journal.push(entry(window, "q")).unwrap();
        }
    }
    (folder, folders)
}

#[test]
fn shards_are_joined_in_order() {
    let (_kept, mut folders) = shards(true);
    folders.reverse();
    let merged = Shards::read(&folders).unwrap();
    assert_eq!(merged.entries, [entry("a/0", "p"), entry("a/0", "q"), entry("b/0", "p"), entry("b/0", "q")]);
    assert_eq!(merged.header, small());
}

#[test]
fn shards_that_are_missing_open_doubled_or_foreign_are_named() {
    let refused = |folders: &[PathBuf]| Shards::read(folders).unwrap_err().to_string();
    let (_kept, folders) = shards(false);
    assert!(refused(&folders[..1]).contains("shard 1/2 is not there"));
    assert!(refused(&folders).contains("shard 1/2 has 1 of 2 points"));
    assert!(refused(&[]).contains("no folder"));
    let (_kept, folders) = shards(true);
    let doubled = [folders[0].clone(), folders[0].clone(), folders[1].clone()];
    assert!(refused(&doubled).contains("both shard 0/2"));
    let empty = tempdir().unwrap();
    assert!(refused(&[empty.path().to_path_buf()]).contains("points-I-of-N.jsonl"));
    let path = folders[1].join("points-1-of-2.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"cpu\":\"x\"", "\"cpu\":\"y\"")).unwrap();
    let error = refused(&folders);
    assert!(error.contains("points-1-of-2.jsonl") && error.contains("recipe.machine.cpu"), "{error}");
}

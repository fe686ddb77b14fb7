//! `stream`: data sets, standard input, watched folders, interruptions.

use crate::tiny::{Called, call, read_json};
use gs_scene::View;
use mapper::{Config, Mapper};
use scene_sim::{Kind, Traced, generate, photograph};
use serde_json::{Value, json};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Frames of a walk through a room.
static FRAMES: LazyLock<Vec<View>> = LazyLock::new(|| {
    let room = generate(Kind::Room, 1);
    let mut walk = room.photographs.clone().unwrap();
    (walk.width, walk.height, walk.samples, walk.count) = (96, 64, 1, 10);
    let traced = Traced::new(&room).unwrap();
    (0..walk.count).map(|i| photograph(&traced, &walk, i, 0).unwrap().view).collect()
});

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A frame as the protocol has it, without its length.
fn encoded(view: &View, time: f64) -> Vec<u8> {
    let camera = view.camera();
    let lens = camera.intrinsics();
    let rows: Vec<Vec<f64>> = (0..3)
        .map(|row| {
            let r = camera.rotation().row(row);
            vec![r.x, r.y, r.z, camera.translation()[row]]
        })
        .collect();
    let header = json!({
        "name": view.name(), "time": time, "width": lens.width, "height": lens.height, "fl_x": lens.fx, "fl_y": lens.fy,
        "cx": lens.cx, "cy": lens.cy, "world_to_camera": rows, "depth": true,
    });
    let mut bytes = (header.to_string() + "\n").into_bytes();
    bytes.extend(view.image().to_rgb8());
    bytes.extend(view.depth().unwrap().data().iter().flat_map(|z| z.to_le_bytes()));
    bytes
}

fn send(to: &mut impl Write, bytes: &[u8]) {
    to.write_all(&(bytes.len() as u32).to_le_bytes()).unwrap();
    to.write_all(bytes).unwrap();
    to.flush().unwrap();
}

/// The command with standard input open.
fn begun(folder: &TempDir, more: &[&str]) -> (Child, PathBuf) {
    let map = folder.path().join("map.ply");
    (listening(&map, &[&["--cap", "2k", "--tau", "0.3"], more].concat()), map)
}

/// The command with standard input open, and where its map goes.
fn listening(map: &Path, more: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
        .args(["stream", "-", "-o", text(map)])
        .args(more)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn ended(child: Child) -> Called {
    let output = child.wait_with_output().unwrap();
    Called {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// The map of a mapper that gets these frames as the protocol rounds them.
fn mapped(mut mapper: Mapper, views: &[View]) -> Mapper {
    for view in views {
        let image =
            gs_scene::Image::from_rgb8(view.image().width(), view.image().height(), &view.image().to_rgb8());
        let view = View::new(view.name(), image.unwrap(), *view.camera(), view.depth().cloned()).unwrap();
        mapper.push(&view.into()).unwrap();
    }
    mapper
}

fn new() -> Mapper {
    Mapper::new(Config { cap: 2_000, tau: 0.3, ..Config::default() }).unwrap()
}

/// Waits until a file is there.
fn appears(path: &Path) {
    let begin = Instant::now();
    while !path.exists() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{} does not appear", path.display());
        sleep(Duration::from_millis(5));
    }
}

#[test]
fn the_demo_maps_a_dwelling_and_measures_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let [map, log, record, plot] = ["map.ply", "log.jsonl", "record.json", "plot.svg"].map(file);
    let words = ["stream", "--demo", "--size", "72x48", "--frames", "60", "--cap", "1500", "--tau", "0.2"];
    let more = ["-o", text(&map), "--log", text(&log), "--json", text(&record), "--plot", text(&plot)];
    let called = call(&[&words[..], &more, &["--evaluate", "--batch"]].concat()).succeeded();
    assert!(called.stdout.contains("between") && called.stdout.contains("snapshot"), "{}", called.stdout);
    let record = read_json(&record);
    assert_eq!((&record["frames"], &record["refused"]), (&json!(60), &json!(0)));
    assert_eq!(record["gaussians"], gs_scene::read_ply(&map).unwrap().len());
    assert!(record["measured"]["mapped"]["psnr"].as_f64().unwrap() > 14.0, "{record}");
    assert!(record["measured"]["batch"]["between"]["psnr"].as_f64().unwrap() > 10.0, "{record}");
    let lines: Vec<Value> =
        fs::read_to_string(&log).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), record["keyframes"]);
    for line in &lines {
        assert!(line["gaussians"].as_u64().unwrap() <= 1500 && line["bytes"].as_u64().unwrap() <= 1500 * 68);
        assert!(line["psnr_after"].as_f64().unwrap() > line["psnr_before"].as_f64().unwrap_or(0.0) - 1.0);
    }
    assert!(fs::read_to_string(&plot).unwrap().contains("keyframes"));
}

#[test]
fn a_data_set_is_resumed_to_the_bytes_of_an_uninterrupted_run() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let data = file("room");
    let words =
        ["simulate", "--seed", "1", "--kind", "room", "--size", "96x64", "--frames", "9", "--samples", "1"];
    call(&[&words[..], &["-o", text(&data)]].concat()).succeeded();
    let [whole, part, rest] = ["whole.ply", "part.ply", "rest.ply"].map(file);
    let stream = |more: &[&str]| call(&[&["stream", text(&data)], more].concat());
    let settings = ["--cap", "1k", "--tau", "0.3"];
    stream(&[&settings[..], &["-o", text(&whole)]].concat()).succeeded();
    stream(&[&settings[..], &["-o", text(&part), "--frames", "4"]].concat()).succeeded();
    let snapshot = file("part.snapshot");
    stream(&["--resume", text(&snapshot), "-o", text(&rest)]).succeeded();
    assert!(fs::read(&whole).unwrap() == fs::read(&rest).unwrap());
    assert!(fs::read(&whole).unwrap() != fs::read(&part).unwrap());

    let refused = |more: &[&str], part: &str| {
        let called = stream(more);
        assert_eq!(called.code, Some(2), "{}", called.stderr);
        assert!(called.stderr.contains(part), "no {part:?} in {}", called.stderr);
    };
    refused(&["--resume", text(&snapshot), "--cap", "5k", "-o", text(&rest)], "--cap has no effect");
    refused(&["--resume", text(&whole), "-o", text(&rest)], "whole.ply: snapshot");
    refused(&["--tau", "0", "-o", text(&rest)], "setting tau");
    refused(&["--batch", "-o", text(&rest)], "--evaluate");
}

#[test]
fn frames_of_a_slow_producer_make_the_map_that_they_should() {
    let folder = tempfile::tempdir().unwrap();
    let (mut child, map) = begun(&folder, &[]);
    let mut input = child.stdin.take().unwrap();
    for (i, view) in FRAMES[..3].iter().enumerate() {
        let bytes = encoded(view, i as f64);
        input.write_all(&(bytes.len() as u32).to_le_bytes()).unwrap();
        for part in bytes.chunks(20_000) {
            input.write_all(part).unwrap();
            input.flush().unwrap();
            sleep(Duration::from_millis(20));
        }
    }
    drop(input);
    ended(child).succeeded();
    assert_eq!(gs_scene::read_ply(&map).unwrap(), *mapped(new(), &FRAMES[..3]).map());
}

#[test]
fn a_producer_that_dies_or_sends_garbage_leaves_the_map_so_far() {
    let expected = mapped(new(), &FRAMES[..2]);
    // Dies within a frame, loses the beat, or says at first what is no stream.
    let cut = encoded(&FRAMES[2], 2.0);
    let mut half = (cut.len() as u32).to_le_bytes().to_vec();
    half.extend(&cut[..cut.len() / 2]);
    for (after, reason) in [(&half[..], "ended within frame 2"), (&[0xee; 300][..], "expected at most")] {
        let folder = tempfile::tempdir().unwrap();
        let (mut child, map) = begun(&folder, &[]);
        let mut input = child.stdin.take().unwrap();
        FRAMES[..2].iter().for_each(|view| send(&mut input, &encoded(view, 0.0)));
        // The reader may have gone before the last byte.
        let _ = input.write_all(after);
        drop(input);
        let called = ended(child);
        assert_eq!(called.code, Some(1), "{}", called.stderr);
        assert!(called.stderr.contains(reason), "no {reason:?} in {}", called.stderr);
        assert_eq!(gs_scene::read_ply(&map).unwrap(), *expected.map());
    }
    let folder = tempfile::tempdir().unwrap();
    let (mut child, map) = begun(&folder, &[]);
    let _ = child.stdin.take().unwrap().write_all(b"GET / HTTP/1.1\r\n\r\n");
    let called = ended(child);
    assert_eq!((called.code, map.exists()), (Some(2), false), "{}", called.stderr);
}

#[test]
fn frames_that_cannot_be_used_are_said_and_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let (mut child, map) = begun(&folder, &[]);
    let mut input = child.stdin.take().unwrap();
    send(&mut input, &encoded(&FRAMES[0], 5.0));
    send(&mut input, b"{\"name\": \"nonsense\"}\n");
    send(&mut input, &encoded(&FRAMES[1], 4.0));
    let nan = String::from_utf8_lossy(&encoded(&FRAMES[1], 5.0)).replacen("[[", "[[NaN,", 1);
    send(&mut input, nan.as_bytes());
    send(&mut input, &encoded(&FRAMES[1], 6.0));
    drop(input);
    let called = ended(child).succeeded();
    for part in ["missing field `width`", "its time is 4 s", "not used: standard input, frame 3"] {
        assert!(called.stderr.contains(part), "no {part:?} in {}", called.stderr);
    }
    assert!(called.stdout.contains("1 refused, 2 not readable"), "{}", called.stdout);
    assert_eq!(gs_scene::read_ply(&map).unwrap(), *mapped(new(), &FRAMES[..2]).map());
}

#[test]
fn a_watched_folder_gives_its_frames_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let incoming = folder.path().join("incoming");
    fs::create_dir(&incoming).unwrap();
    let map = folder.path().join("map.ply");
    let child = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
        .args(["stream", text(&incoming), "--watch", "-o", text(&map), "--cap", "2k", "--tau", "0.3"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    for (i, view) in FRAMES[..4].iter().enumerate() {
        let hidden = incoming.join("next.part");
        let bytes = if i == 2 { b"garbage".to_vec() } else { encoded(view, i as f64) };
        fs::write(&hidden, bytes).unwrap();
        fs::rename(&hidden, incoming.join(format!("{i:03}.frame"))).unwrap();
    }
    fs::write(incoming.join("end"), b"").unwrap();
    let called = ended(child).succeeded();
    assert!(called.stderr.contains("002.frame: no line of JSON"), "{}", called.stderr);
    let expected = [&FRAMES[..2], &FRAMES[3..4]].concat();
    assert_eq!(gs_scene::read_ply(&map).unwrap(), *mapped(new(), &expected).map());

    // Nothing comes, and that is waited for only so long.
    let empty = folder.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let called = call(&["stream", text(&empty), "--watch", "--idle", "1", "-o", text(&map)]);
    assert_eq!(called.code, Some(2), "{}", called.stderr);
    assert!(called.stderr.contains("there were no frames"), "{}", called.stderr);
    let called = call(&["stream", text(&map), "--watch", "-o", text(&folder.path().join("other.ply"))]);
    assert_eq!(called.code, Some(2), "{}", called.stderr);
}

#[cfg(unix)]
#[test]
fn an_interrupt_writes_map_and_snapshot_and_a_kill_leaves_the_last_snapshot() {
    let signal = |child: &Child, name: &str| {
        assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
    };
    for name in ["-INT", "-KILL"] {
        let folder = tempfile::tempdir().unwrap();
        let (mut child, map) = begun(&folder, &["--snapshot-every", "1"]);
        let snapshot = folder.path().join("map.snapshot");
        let mut input = child.stdin.take().unwrap();
        FRAMES[..4].iter().for_each(|view| send(&mut input, &encoded(view, 0.0)));
        appears(&snapshot);
        if name == "-INT" {
            // All four are mapped before.
            let begin = Instant::now();
            while Mapper::resume(&snapshot).unwrap().frames() < 3 && begin.elapsed() < Duration::from_secs(60)
            {
                sleep(Duration::from_millis(20));
            }
        }
        signal(&child, name);
        let called = ended(child);
        if name == "-INT" {
            let called = called.succeeded();
            assert!(called.stdout.contains("--resume goes on"), "{}", called.stdout);
            assert_eq!(gs_scene::read_ply(&map).unwrap(), *Mapper::resume(&snapshot).unwrap().map());
        } else {
            assert_eq!((called.code, map.exists()), (None, false));
        }
        // Whole, and it goes on to the map of a run that was never interrupted.
        let at = Mapper::resume(&snapshot).unwrap().frames();
        assert!((1..=4).contains(&at));
        let (mut child, map) = begun_again(&folder, &snapshot);
        let mut input = child.stdin.take().unwrap();
        FRAMES[at..6].iter().for_each(|view| send(&mut input, &encoded(view, 0.0)));
        drop(input);
        ended(child).succeeded();
        assert_eq!(gs_scene::read_ply(&map).unwrap(), *mapped(new(), &FRAMES[..6]).map());
    }
}

/// The command, resumed, with standard input open.
#[cfg(unix)]
fn begun_again(folder: &TempDir, snapshot: &Path) -> (Child, PathBuf) {
    let map = folder.path().join("resumed.ply");
    (listening(&map, &["--resume", text(snapshot)]), map)
}

//! `view`, pages beside reports, and `render --path`.

use crate::tiny::{RANGE, Tiny, call, read_json};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A scene of 500 Gaussians with its report, and its photographs.
fn reconstructed() -> Tiny {
    let tiny = Tiny::new();
    let report = tiny.beside("scene-report.html");
    tiny.reconstruct(&["--gaussians", "500", "--depth-range", RANGE, "--report", text(&report)]).succeeded();
    tiny
}

#[test]
fn a_page_holds_scene_cameras_and_photographs() {
    let tiny = reconstructed();
    let (scene, root, page) = (tiny.beside("scene.ply"), tiny.root(), tiny.beside("page.html"));
    let json = tiny.beside("view.json");
    let words = ["view", text(&scene), "--cameras", text(&root), "--photographs", "3", "-o", text(&page)];
    let called = call(&[&words[..], &["--json", text(&json)]].concat()).succeeded();
    assert!(called.stdout.contains("cameras    11, 3 with their photographs"), "{}", called.stdout);
    let html = fs::read_to_string(&page).unwrap();
    assert_eq!(read_json(&json)["bytes"], html.len());
    assert_eq!(html.matches("\"photograph\":\"data:image/jpeg").count(), 3);
    assert_eq!(html.matches("<figure>").count(), 3);
    // Without cameras the page lies beside the scene; with every bit it is larger.
    let called = call(&["view", text(&scene)]).succeeded();
    assert!(called.stdout.contains("scene.html"), "{}", called.stdout);
    let compact = fs::metadata(tiny.beside("scene.html")).unwrap().len();
    call(&["view", text(&scene), "--exact"]).succeeded();
    assert!(fs::metadata(tiny.beside("scene.html")).unwrap().len() > compact + 40_000);

    // The report links to its own page.
    let report = fs::read_to_string(tiny.beside("scene-report.html")).unwrap();
    assert!(report.contains("href=\"scene-report-view.html\""));
    assert!(fs::read_to_string(tiny.beside("scene-report-view.html")).unwrap().contains("\"photograph\":"));
}

#[test]
fn wrong_input_of_view_is_told() {
    let tiny = Tiny::new();
    let scene = tiny.beside("scene.ply");
    let refused = |words: &[&str], parts: &[&str]| {
        let called = call(words);
        assert_eq!(called.code, Some(2), "{}{}", called.stdout, called.stderr);
        assert!(parts.iter().all(|part| called.stderr.contains(part)), "no {parts:?} in {}", called.stderr);
    };
    refused(&["view", text(&scene)], &["scene.ply"]);
    fs::write(&scene, b"not a scene").unwrap();
    refused(&["view", text(&scene)], &["scene.ply", "not a PLY file"]);
    gs_scene::write_ply(&scene, &gs_scene::Gaussians::empty(0).unwrap()).unwrap();
    refused(&["view", text(&scene), "-o", text(&scene)], &["--output", "scene.ply"]);
    refused(&["view", text(&scene), "--cameras", text(&tiny.beside("gone"))], &["gone"]);
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    refused(&["view", text(&scene), "--serve", "--port", &port], &[&port, "taken"]);
    // A scene without Gaussians has a page, too.
    call(&["view", text(&scene)]).succeeded();
}

#[test]
fn a_served_page_arrives_with_its_scene() {
    let tiny = reconstructed();
    let mut server = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
        .args(["view", text(&tiny.beside("scene.ply")), "--serve", "--port", "0"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(server.stdout.take().unwrap()).lines();
    let line = said.find(|line| line.as_ref().unwrap().contains("http://127.0.0.1:")).unwrap().unwrap();
    let host = line.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
    let ask = |path: &str| {
        let mut stream = TcpStream::connect(&host).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    };
    let page = String::from_utf8(ask("/")).unwrap();
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("data-source=\"scene.bin\""));
    let scene = ask("/scene.bin");
    let body = scene.windows(4).position(|end| end == b"\r\n\r\n").unwrap() + 4;
    assert_eq!(scene.len() - body, 500 * (12 + 16 + 6 + 2 + 24));
    server.kill().unwrap();
    server.wait().unwrap();
}

#[test]
fn a_path_gives_frames_and_says_whether_there_is_a_video() {
    let tiny = reconstructed();
    let (scene, root) = (tiny.beside("scene.ply"), tiny.root());
    let mut first = Vec::new();
    for path in ["orbit", "cameras"] {
        let output = tiny.beside(path);
        let words =
            ["render", text(&scene), "--cameras", text(&root), "-o", text(&output), "--device", "cpu"];
        // Nothing is on this PATH.
        let called = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
            .args(words)
            .args(["--path", path, "--frames", "3"])
            .env("PATH", tiny.root())
            .output()
            .unwrap();
        let (said, warned) =
            (String::from_utf8_lossy(&called.stdout), String::from_utf8_lossy(&called.stderr));
        assert!(called.status.success() && said.contains("3 frames"), "{said}{warned}");
        assert!(warned.contains("no video: ffmpeg is not on the PATH"), "{warned}");
        let frames: Vec<_> =
            (0..3).map(|i| fs::read(output.join(format!("frame-0000{i}.png"))).unwrap()).collect();
        assert!(frames[0] != frames[1] && frames[1] != frames[2]);
        assert_eq!(fs::read_dir(&output).unwrap().count(), 3);
        first.push(frames[0].clone());
    }
    assert!(first[0] != first[1]);
    let called = call(&["render", text(&scene), "--cameras", text(&root), "-o", "x", "--frames", "3"]);
    assert_eq!(called.code, Some(2), "--frames is for --path: {}", called.stderr);
}

/// What ffmpeg is given, by a program of that name.
#[cfg(unix)]
#[test]
fn a_video_is_made_of_the_frames_and_a_failure_leaves_none() {
    use std::os::unix::fs::PermissionsExt;
    let tiny = reconstructed();
    let tools = tiny.beside("tools");
    fs::create_dir(&tools).unwrap();
    let output = tiny.beside("out");
    let (scene, root) = (tiny.beside("scene.ply"), tiny.root());
    let run = |script: &str| {
        let ffmpeg = tools.join("ffmpeg");
        fs::write(&ffmpeg, script).unwrap();
        fs::set_permissions(&ffmpeg, fs::Permissions::from_mode(0o755)).unwrap();
        Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
            .args(["render", text(&scene), "--cameras", text(&root), "-o", text(&output), "--device", "cpu"])
            .args(["--path", "orbit", "--frames", "2"])
            .env("PATH", &tools)
            .output()
            .unwrap()
    };
    let failed = run("#!/bin/sh\nfor last; do :; done\n: > \"$last\"\necho broken pipe dream >&2\nexit 3\n");
    assert_eq!(failed.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&failed.stderr).contains("broken pipe dream"));
    assert_eq!(fs::read_dir(&output).unwrap().count(), 2, "the frames alone");
    let made = run("#!/bin/sh\nfor last; do :; done\necho \"$@\" > \"$last\"\n");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let given = fs::read_to_string(output.join("path.mp4")).unwrap();
    assert!(given.contains("-framerate 30") && given.contains("frame-%05d.png"), "{given}");
}

//! Where results go: what is written over, and what never is.

use crate::tiny::{Called, RANGE, Tiny, call};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

fn refused(called: &Called, parts: &[&str]) {
    assert_eq!(called.code, Some(2), "{}{}", called.stdout, called.stderr);
    assert!(parts.iter().all(|part| called.stderr.contains(part)), "no {parts:?} in: {}", called.stderr);
}

/// Arguments of the smallest reconstruction of a data set, and more.
fn small<'a>(root: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    let shared = ["reconstruct", root.to_str().unwrap(), "--gaussians", "500", "--depth-range", RANGE];
    [&shared, more].concat()
}

#[cfg(unix)]
#[test]
fn results_go_through_links_devices_and_fifos_and_to_standard_output() {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let tiny = Tiny::new();
    let root = tiny.root();
    let text = |name: &str| tiny.beside(name).to_str().unwrap().to_owned();

    // The scene into the target of a link, JSON into a FIFO.
    fs::write(tiny.beside("target.ply"), b"old").unwrap();
    symlink("target.ply", tiny.beside("link.ply")).unwrap();
    let fifo = text("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let reader = std::thread::spawn({
        let fifo = fifo.clone();
        move || fs::read(fifo).unwrap()
    });
    call(&small(&root, &["-o", &text("link.ply"), "--json", &fifo])).succeeded();
    let json: serde_json::Value = serde_json::from_slice(&reader.join().unwrap()).unwrap();
    assert_eq!(json["gaussians"], 500.0);
    assert!(fs::metadata(&fifo).unwrap().file_type().is_fifo());
    assert!(tiny.beside("link.ply").is_symlink());
    let scene = fs::read(tiny.beside("target.ply")).unwrap();
    assert!(scene.starts_with(b"ply\n"));

    // The same scene on standard output, what is said on standard error; nothing is called `-`.
    symlink("/dev/stdout", tiny.beside("out")).unwrap();
    for output in ["-", "/dev/stdout", &text("out")] {
        let called = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
            .args(small(&root, &["-o", output, "--json", "/dev/null"]))
            .current_dir(tiny.beside(""))
            .output()
            .unwrap();
        let said = String::from_utf8(called.stderr).unwrap();
        assert!(called.status.success(), "{said}");
        assert!(called.stdout == scene, "{output}: {} bytes", called.stdout.len());
        assert!(said.contains("scene      standard output"), "{said}");
    }
    assert!(!tiny.beside("-").exists());
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    refused(&call(&small(&root, &["-o", "-", "--json", "-"])), &["--output", "--json"]);
}

#[test]
fn a_path_given_twice_or_read_is_refused_before_the_work() {
    let tiny = Tiny::new();
    let root = tiny.root();
    let text = |name: &str| tiny.beside(name).to_str().unwrap().to_owned();
    let (same, other) = (text("same"), text("tiny/../same"));
    refused(&call(&small(&root, &["-o", &same, "--json", &other])), &["same", "--output", "--json"]);
    refused(&call(&small(&root, &["-o", &same, "--report", &same])), &["same", "--output", "--report"]);

    let weights = text("weights.safetensors");
    fs::write(&weights, b"anything").unwrap();
    let called = call(&small(&root, &["-o", &weights, "--weights", &weights]));
    refused(&called, &["weights.safetensors", "--output", "reads"]);
    for file in ["transforms.json", "images/view-03.png", "evaluation_index.json"] {
        let path = tiny.path(file);
        let before = fs::read(&path).unwrap();
        let output = path.to_str().unwrap();
        refused(&call(&small(&root, &["-o", output])), &[file, "reads"]);
        refused(&call(&small(&root, &["-o", &same, "--json", output])), &[file, "--json"]);
        refused(&call(&["check-data", root.to_str().unwrap(), "--report", output]), &[file, "--report"]);
        let eval = ["eval", "--dataset", "nerfstudio", "--root", root.to_str().unwrap(), "--json", output];
        refused(&call(&eval), &[file, "--json"]);
        assert!(fs::read(&path).unwrap() == before, "{file}");
    }
    assert!(!tiny.beside("same").exists());
}

#[test]
fn pictures_do_not_take_the_place_of_photographs_or_of_each_other() {
    let tiny = Tiny::new();
    let root = tiny.root();
    let scene = tiny.beside("scene.ply");
    call(&small(&root, &["-o", scene.to_str().unwrap()])).succeeded();
    let photograph = fs::read(tiny.path("images/view-01.png")).unwrap();
    let images = tiny.path("images");
    let render = |output: &Path| {
        let [scene, root, output] = [&scene, &root, output].map(|path| path.to_str().unwrap());
        call(&["render", scene, "--cameras", root, "-o", output, "--device", "cpu", "--positions", "1,2"])
    };
    refused(&render(&images), &["view-01.png", "reads"]);
    assert!(fs::read(tiny.path("images/view-01.png")).unwrap() == photograph);

    fs::rename(tiny.path("images/view-02.png"), tiny.path("images/view-01-alpha.png")).unwrap();
    tiny.edit(|value| value["frames"][2]["file_path"] = "images/view-01-alpha.png".into());
    refused(&render(&tiny.beside("out")), &["view-01-alpha.png", "\"view-01\"", "--positions"]);
    assert!(!tiny.beside("out").exists());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_an_error_and_a_reader_that_goes_away_is_none() {
    let tiny = Tiny::new();
    let root = tiny.root();
    for arguments in
        [&["train", "--print-config"][..], &["check-data", root.to_str().unwrap(), "--pairs", "1"]]
    {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let called = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
            .args(arguments)
            .stdout(Stdio::from(full))
            .output()
            .unwrap();
        let said = String::from_utf8(called.stderr).unwrap();
        assert_eq!(called.status.code(), Some(1), "{said}");
        assert!(said.contains("standard output: cannot write") && said.contains("lost"), "{said}");
    }
    let mut child = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
        .args(["train", "--print-config"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
    // Nobody to tell either: still no panic.
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_sparsesplat"));
    let status = command.args(["train", "--print-config"]).stdout(full()).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(1));
}

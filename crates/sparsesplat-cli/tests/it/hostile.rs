//! Wrong input: a message that names file and rule, exit code 2, never a panic.

use crate::tiny::{Called, RANGE, Tiny, call};
use serde_json::{Value, json};
use std::fs;

/// Asserts that a call was refused with a message that holds every part.
fn refused(called: &Called, parts: &[&str]) {
    let Called { code, stdout, stderr } = called;
    assert_eq!(*code, Some(2), "{stdout}{stderr}");
    assert!(stderr.starts_with("error: "), "{stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    for part in parts {
        assert!(stderr.contains(part), "no {part:?} in: {stderr}");
    }
}

/// Asserts that a reconstruction is refused after a change of the data set, on one line, and writes no scene.
fn check(change: impl FnOnce(&Tiny), more: &[&str], parts: &[&str]) {
    let tiny = Tiny::new();
    change(&tiny);
    let called = tiny.reconstruct(more);
    refused(&called, parts);
    assert_eq!(called.stderr.lines().count(), 1, "{}", called.stderr);
    assert!(!tiny.beside("scene.ply").exists());
}

#[test]
fn a_missing_image() {
    check(
        |tiny| fs::remove_file(tiny.path("images/view-04.png")).unwrap(),
        &["--views", "11"],
        &["view-04", "missing"],
    );
}

#[test]
fn no_intrinsics() {
    let drop_focal = |value: &mut Value| {
        value.as_object_mut().unwrap().retain(|key, _| !key.starts_with("fl_"));
    };
    check(|tiny| tiny.edit(drop_focal), &[], &["transforms.json", "no intrinsics", "fl_x"]);
}

#[test]
fn a_pose_that_is_not_a_number() {
    let broken = |tiny: &Tiny| {
        let path = tiny.path("transforms.json");
        tiny.edit(|value| value["frames"][3]["transform_matrix"][1][3] = json!(123_456.5));
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains("123456.5"));
        fs::write(&path, text.replace("123456.5", "NaN")).unwrap();
    };
    check(broken, &[], &["transforms.json", "view-03"]);
    let infinite = |value: &mut Value| value["frames"][3]["transform_matrix"][0][0] = json!(1e300);
    check(|tiny| tiny.edit(infinite), &[], &["transforms.json", "view-03"]);
}

#[test]
fn one_view_only() {
    let keep_one = |value: &mut Value| value["frames"].as_array_mut().unwrap().truncate(1);
    check(|tiny| tiny.edit(keep_one), &[], &["tiny", "6 views asked for"]);
    check(|tiny| tiny.edit(keep_one), &["--views", "1"], &["views"]);
    check(|_| {}, &["--views", "1", "--depth-range", RANGE], &["at least two views"]);
    check(|_| {}, &["--views", "12"], &["12 views asked for", "11 frames"]);
}

#[test]
fn images_of_different_sizes() {
    let odd_one_out = |tiny: &Tiny| {
        let image = gs_scene::Image::filled(60, 40, [0.5; 3]).unwrap();
        report_parts::Picture::of_image(&image).save(&tiny.path("images/view-02.png")).unwrap();
    };
    check(odd_one_out, &["--views", "11"], &["different sizes", "view-02", "60x40", "120x80", "--size"]);
}

#[test]
fn truncated_pictures() {
    let cut = |tiny: &Tiny| {
        for i in 0..11 {
            let path = tiny.path(&format!("images/view-{i:02}.png"));
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        }
    };
    check(cut, &[], &["view-", ".png", "decoded"]);
}

/// As where pictures are missing: the scene is made of others, and what is left out is told.
#[test]
fn chosen_pictures_that_are_broken_are_left_out() {
    let tiny = Tiny::new();
    let reconstruct = || tiny.reconstruct(&["--views", "3", "--gaussians", "300", "--depth-range", RANGE]);
    let chosen = |called: &Called| -> Vec<String> {
        let line = called.stdout.lines().find(|line| line.starts_with("views ")).unwrap();
        line.split_once(": ").unwrap().1.split(", ").map(str::to_owned).collect()
    };
    let first = chosen(&reconstruct().succeeded());
    let broken = &first[..2];
    for name in broken {
        let path = tiny.path(&format!("images/{name}.png"));
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    }
    let called = reconstruct().succeeded();
    let next = chosen(&called);
    assert_eq!(next.len(), 3);
    assert!(next.iter().all(|name| !broken.contains(name)), "{next:?}");
    let mut told: Vec<&str> = called.stderr.lines().filter(|line| line.contains("decoded")).collect();
    assert!(told.iter().all(|line| line.contains("not used: view-")), "{}", called.stderr);
    let warnings = told.len();
    told.sort_unstable();
    told.dedup();
    assert!(warnings > 0 && told.len() == warnings, "{}", called.stderr);
    // Frames that somebody names are used or refused.
    let index = tiny.path("evaluation_index.json");
    let position = |name: &String| name.strip_prefix("view-").unwrap().parse::<usize>().unwrap();
    let context: Vec<usize> = first.iter().map(position).collect();
    let target: Vec<usize> = (0..11).filter(|i| !context.contains(i)).collect();
    fs::write(&index, json!({"tiny/0": {"context": context, "target": target}}).to_string()).unwrap();
    refused(
        &tiny.reconstruct(&["--index", index.to_str().unwrap(), "--window", "tiny/0"]),
        &["view-", "decoded"],
    );
}

#[test]
fn files_that_are_not_what_they_should_be() {
    check(
        |tiny| fs::write(tiny.path("transforms.json"), "{\"frames\": [").unwrap(),
        &[],
        &["transforms.json", "JSON"],
    );
    check(
        |tiny| fs::remove_file(tiny.path("transforms.json")).unwrap(),
        &[],
        &["tiny", "11 pictures", "poses", "colmap", "transforms.json"],
    );
    check(|tiny| fs::remove_dir_all(tiny.root()).unwrap(), &[], &["tiny", "cannot read"]);
    check(|_| {}, &["--backbone", "given-depth"], &["no measured depth", "view-"]);
}

#[test]
fn an_index_that_does_not_fit() {
    let tiny = Tiny::new();
    let index = tiny.path("evaluation_index.json");
    let index = index.to_str().unwrap();
    refused(&tiny.reconstruct(&["--index", index, "--window", "tiny/7"]), &["no window", "tiny/7", "tiny/0"]);
    refused(
        &tiny.reconstruct(&["--index", "nowhere.json", "--window", "tiny/0"]),
        &["nowhere.json", "cannot read"],
    );
    refused(&tiny.reconstruct(&["--index", index]), &["--window"]);
    fs::write(index, r#"{"tiny/0": {"context": [0, 99], "target": [1]}}"#).unwrap();
    refused(&tiny.reconstruct(&["--index", index, "--window", "tiny/0"]), &["99", "11 frames"]);
}

#[test]
fn a_broken_scene() {
    let tiny = Tiny::new();
    let scene = tiny.beside("scene.ply");
    tiny.reconstruct(&["--gaussians", "500", "--depth-range", RANGE]).succeeded();
    let bytes = fs::read(&scene).unwrap();
    let (root, output) = (tiny.root(), tiny.beside("out"));
    let render = || {
        let (scene, root, output) =
            (scene.to_str().unwrap(), root.to_str().unwrap(), output.to_str().unwrap());
        call(&["render", scene, "--cameras", root, "-o", output])
    };
    fs::write(&scene, &bytes[..bytes.len() - 5]).unwrap();
    refused(&render(), &["scene.ply", "truncated"]);
    fs::write(&scene, b"not a scene").unwrap();
    refused(&render(), &["scene.ply", "not a PLY file"]);
    fs::remove_file(&scene).unwrap();
    refused(&render(), &["scene.ply"]);
    assert!(!output.exists());
}

#[test]
fn gaussians_that_cannot_be_drawn_are_counted() {
    let tiny = Tiny::new();
    let (scene, root, output, json) =
        (tiny.beside("scene.ply"), tiny.root(), tiny.beside("out"), tiny.beside("render.json"));
    let mut gaussians = gs_scene::Gaussians::empty(0).unwrap();
    for opacity in [1.0, f32::INFINITY, f32::NAN] {
        gaussians.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [0.0; 3], opacity, &[0.5; 3]);
    }
    gs_scene::write_ply(&scene, &gaussians).unwrap();
    let [scene, root, output, json_path] = [&scene, &root, &output, &json].map(|path| path.to_str().unwrap());
    let render = ["render", scene, "--cameras", root, "-o", output, "--positions", "1", "--device", "cpu"];
    let called = call(&[&render[..], &["--json", json_path]].concat()).succeeded();
    assert!(called.stderr.contains("2 of 3 Gaussians cannot be drawn"), "{}", called.stderr);
    assert_eq!(crate::tiny::read_json(&json)["rejected"], 2);
}

#[test]
fn names_of_files_do_not_speak_to_the_terminal() {
    let tiny = Tiny::new();
    tiny.edit(|value| {
        value["frames"][3]["file_path"] = format!("images/\u{1b}[2J{}.png", "x".repeat(99_999)).into();
    });
    let called = tiny.reconstruct(&["--views", "11"]);
    refused(&called, &["missing", r"\u{1b}[2J", "more characters"]);
    assert!(!called.stderr.contains('\u{1b}') && called.stderr.len() < 10_000, "{}", called.stderr.len());
}

#[test]
fn arguments_out_of_range() {
    let tiny = Tiny::new();
    for (arguments, part) in [
        (["--gaussians", "0"], "--gaussians"),
        (["--gaussians", "many"], "--gaussians"),
        (["--tau", "-1"], "--tau"),
        (["--views", "0"], "--views"),
        (["--depth-range", "5,2"], "--depth-range"),
        (["--neighbours", "0"], "--neighbours"),
        (["--depth-planes", "0"], "--depth-planes"),
        (["--depth-planes", "1"], "2 or more"),
        (["--depth-planes", "1000000000"], "planes"),
        (["--size", "0x3"], "--size"),
        (["--threads", "0"], "--threads"),
        (["--threads", "100000"], "expected at most"),
        (["--seed", "-1"], "invalid digit"),
        (["--far-shell", "maybe"], "--far-shell"),
        (["--no-such-option", "1"], "--no-such-option"),
    ] {
        refused(&tiny.reconstruct(&arguments), &[part]);
    }
    refused(&tiny.reconstruct(&["--gaussians", "1k", "--tau", "1"]), &["cannot be used with"]);
    refused(&tiny.reconstruct(&["--refine", "5", "--refine-seconds", "1"]), &["cannot be used with"]);
    refused(&tiny.reconstruct(&["--refine", "-1"]), &["-1"]);
    refused(&tiny.reconstruct(&["--refine", "5", "--corrector", "none.safetensors"]), &["none.safetensors"]);
    let planes_of_no_stereo = ["--backbone", "given-depth", "--depth-planes", "64"];
    refused(&tiny.reconstruct(&planes_of_no_stereo), &["--depth-planes", "plane-sweep"]);
    refused(&tiny.reconstruct(&["--refine-seconds", "nan"]), &["--refine-seconds"]);
    refused(
        &call(&["eval", "--dataset", "simulated", "--refine-plot", "x.svg"]),
        &["--refine-plot", "--refine"],
    );
    refused(&call(&["eval", "--dataset", "nerfstudio"]), &["--root"]);
    let endless = u64::MAX.to_string();
    refused(&call(&["eval", "--dataset", "simulated", "--scenes", &endless]), &["--scenes"]);
    refused(&call(&["demo", "--depth-range", "hint"]), &["no hint"]);
}

#[test]
fn outputs_that_cannot_be_written_are_told_before_the_work() {
    let tiny = Tiny::new();
    // A file where a folder should be: not even root can write into it.
    fs::write(tiny.beside("plain"), b"").unwrap();
    let inside = tiny.beside("plain/x");
    let (inside, root) = (inside.to_str().unwrap(), tiny.root());
    let root = root.to_str().unwrap();
    refused(&call(&["reconstruct", root, "-o", inside]), &["plain", "cannot write"]);
    refused(&call(&["demo", "-o", inside]), &["plain", "cannot write"]);
    refused(&tiny.reconstruct(&["--json", inside]), &["plain", "cannot write"]);
    refused(&tiny.reconstruct(&["--report", inside]), &["plain", "cannot write"]);
    refused(&call(&["reconstruct", root, "-o", root]), &["is a folder"]);
    refused(&call(&["eval", "--dataset", "simulated", "--report", inside]), &["plain", "cannot write"]);
}

#[test]
fn roots_without_anything_to_evaluate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    refused(&call(&["eval", "--dataset", "nerfstudio", "--root", path]), &[path, "transforms.json"]);
    refused(
        &call(&["eval", "--dataset", "nerfstudio", "--root", "no/such/folder"]),
        &["no/such/folder", "cannot"],
    );
}

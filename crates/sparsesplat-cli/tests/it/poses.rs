//! Photographs without poses: what the commands say, and, with the engine, what they make.

use crate::tiny::{Called, Tiny, call};
use std::fs;

/// A data set whose poses are taken away.
fn unposed() -> Tiny {
    let tiny = Tiny::new();
    fs::remove_file(tiny.path("transforms.json")).unwrap();
    tiny
}

fn refused(called: &Called, parts: &[&str]) {
    let Called { code, stdout, stderr } = called;
    assert_eq!(*code, Some(2), "{stdout}{stderr}");
    for part in parts {
        assert!(stderr.contains(part), "no {part:?} in: {stderr}");
    }
}

#[test]
fn photographs_without_poses_are_told_what_to_type() {
    let tiny = unposed();
    refused(&tiny.reconstruct(&[]), &["11 pictures without the poses", "sparsesplat poses", "--poses"]);
}

#[test]
fn options_without_effect_are_refused() {
    let tiny = unposed();
    refused(&tiny.reconstruct(&["--keep-all"]), &["--keep-all has no effect", "--poses"]);
    let (input, output) = (tiny.path(""), tiny.beside("scene"));
    let poses = |more: &[&str]| {
        let mut words =
            vec!["poses".into(), input.clone().into_os_string(), "-o".into(), output.clone().into()];
        words.extend(more.iter().map(std::ffi::OsString::from));
        call(&words)
    };
    refused(&poses(&["--frames", "7"]), &["--frames has no effect", "video"]);
    refused(&poses(&["--from", "-1"]), &["--from"]);
    assert!(!output.exists());
}

#[cfg(feature = "openmvg")]
#[test]
fn photographs_become_a_scene_in_one_go_and_their_poses_serve_again() {
    use report_parts::Picture;
    use scene_windows::{SimulatedScene, simulated_window};

    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let window = simulated_window(SimulatedScene::Courtyard, (240, 160)).unwrap();
    for view in window.context.iter().chain(&window.targets) {
        let file = folder.path().join(format!("photos/{}.png", view.name()));
        Picture::of_image(view.image()).save(&file).unwrap();
    }
    let (photos, scene, json) = (at("photos"), at("scene.ply"), at("result.json"));
    let words = ["reconstruct", &photos, "--poses", "--gaussians", "2k", "-o", &scene, "--json", &json];
    let first = call(&words).succeeded();
    assert!(
        first.stdout.contains("poses      ") && first.stdout.contains("engine openmvg"),
        "{}",
        first.stdout
    );
    let record: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    let seconds = record["seconds"]["poses"].as_f64().unwrap();
    assert!(
        seconds > 0.0
            && record["poses"]["seconds"] == seconds
            && record["seconds"]["total"].as_f64().unwrap() > seconds
    );
    assert_eq!(record["poses"]["estimate"]["verdict"]["registered"], 11);
    let bytes = fs::read(&scene).unwrap();
    let again = call(&words).succeeded();
    assert!(again.stdout.contains("made from the same input before"), "{}", again.stdout);
    assert_eq!(fs::read(&scene).unwrap(), bytes);
    // Any command takes them.
    let poses = at("scene-poses");
    call(&["check-data", &poses]).succeeded();
    call(&["reconstruct", &poses, "--gaussians", "2k", "-o", &at("again.ply")]).succeeded();
    refused(&call(&["poses", &photos, "-o", &poses]), &["scene-poses", "not empty"]);
}

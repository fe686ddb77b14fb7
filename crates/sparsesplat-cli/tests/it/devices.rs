//! Where pictures are rendered, and what is said about it.

use crate::tiny::{Called, RANGE, Tiny, call, read_json};
use serde_json::Value;
use std::process::Command;

/// A scene of a thousand Gaussians, and the arguments that render two views of it into `folder` with a result beside it.
fn render_arguments(tiny: &Tiny, folder: &str, device: &str) -> Vec<String> {
    let text = |file: &str| tiny.beside(file).to_str().unwrap().to_owned();
    let (scene, root, output, json) =
        (text("scene.ply"), text("tiny"), text(folder), text(&format!("{folder}.json")));
    [
        "render",
        &scene,
        "--cameras",
        &root,
        "-o",
        &output,
        "--positions",
        "1,4",
        "--device",
        device,
        "--json",
        &json,
    ]
    .map(str::to_owned)
    .to_vec()
}

fn scene(tiny: &Tiny) {
    let called = tiny.reconstruct(&["--gaussians", "1k", "--depth-range", RANGE]).succeeded();
    assert!(!called.stdout.contains("rendered"), "nothing was rendered: {}", called.stdout);
}

/// Calls the binary where no graphics driver is to be found.
fn call_without_drivers(arguments: &[String]) -> Called {
    let output = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
        .args(arguments)
        .env("VK_DRIVER_FILES", "/nonexistent")
        .env("VK_ICD_FILENAMES", "/nonexistent")
        .output()
        .unwrap();
    Called {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

#[test]
fn the_record_names_the_device() {
    let tiny = Tiny::new();
    scene(&tiny);
    let called = call(&render_arguments(&tiny, "cpu", "cpu")).succeeded();
    assert!(called.stdout.contains("rendered   on the CPU"), "{}", called.stdout);
    let device = &read_json(&tiny.beside("cpu.json"))["device"];
    assert_eq!((&device["name"], &device["kind"]), (&"cpu".into(), &"cpu".into()));
    assert!(device["fallback"].is_null(), "the CPU was asked for: {device}");
}

// Other systems have graphics drivers that no variable hides.
#[cfg(target_os = "linux")]
#[test]
fn without_a_gpu_auto_takes_the_cpu_in_silence_and_gpu_is_refused() {
    let tiny = Tiny::new();
    scene(&tiny);
    let Called { code, stderr, .. } = call_without_drivers(&render_arguments(&tiny, "auto", "auto"));
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    let device = &read_json(&tiny.beside("auto.json"))["device"];
    assert_eq!(device["kind"], "cpu");
    assert!(device["fallback"].as_str().unwrap().contains("no GPU"), "{device}");

    let Called { code, stderr, .. } = call_without_drivers(&render_arguments(&tiny, "gpu", "gpu"));
    assert_eq!(code, Some(2), "{stderr}");
    assert!(stderr.starts_with("error: no GPU to render on"), "{stderr}");
    assert!(!tiny.beside("gpu/view-01.png").exists());

    let json = tiny.beside("doctor.json");
    let doctor = ["doctor", "--json", json.to_str().unwrap()].map(str::to_owned);
    let Called { code, stdout, .. } = call_without_drivers(&doctor);
    assert_eq!(code, Some(0), "{stdout}");
    assert!(stdout.contains("shaders    not tested: no GPU"), "{stdout}");
    let found = read_json(&json);
    assert_eq!((&found["passed"], &found["gpu"]), (&true.into(), &Value::Null));
    assert_eq!(
        (&found["shaders"]["result"], &found["adapters"]),
        (&"not_tested".into(), &Value::Array(vec![]))
    );
}

#[test]
#[ignore = "gpu"]
fn pictures_of_gpu_and_cpu_agree() {
    let tiny = Tiny::new();
    scene(&tiny);
    for device in ["cpu", "gpu"] {
        call(&render_arguments(&tiny, device, device)).succeeded();
    }
    let device = &read_json(&tiny.beside("gpu.json"))["device"];
    for key in ["name", "backend", "driver"] {
        assert!(device[key].as_str().is_some_and(|text| !text.is_empty() && text != "cpu"), "{device}");
    }
    // Depth is shown on a ramp of colours, where neighbours are several steps apart.
    for file in ["view-01.png", "view-04.png", "view-01-alpha.png", "view-04-alpha.png"] {
        let picture = |folder: &str| image::open(tiny.beside(folder).join(file)).unwrap().to_rgb8();
        let (cpu, gpu) = (picture("cpu"), picture("gpu"));
        assert_eq!(cpu.dimensions(), gpu.dimensions());
        // Two roundings of nearly the same number.
        let worst = cpu.as_raw().iter().zip(gpu.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst <= Some(1), "{file}: {worst:?}");
    }
    assert!(call(&["doctor", "--device", "gpu"]).succeeded().stdout.contains("shaders    passed on"));
}

#[test]
fn a_device_that_is_none_is_refused() {
    let Called { code, stderr, .. } = call(&["render", "--device", "tpu"]);
    assert_eq!(code, Some(2), "{stderr}");
    assert!(stderr.starts_with("error: ") && stderr.contains("--device"), "{stderr}");
}

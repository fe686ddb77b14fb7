//! Where pictures are rendered, and what is said about it; how fast.

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
fn the_bench_has_a_row_for_every_case() {
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
        assert_eq!(
            (&row["bench"], &row["impl"], &row["device"]),
            (&"raster".into(), &"ours".into(), &"cpu".into())
        );
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
        let [least, median, most] = ["seconds_min", "seconds", "seconds_max"].map(number);
        assert!(0.0 < least && least <= median && median <= most, "{row}");
        assert!(number("visible") > 0.0 && number("intersections") >= number("visible"), "{row}");
        assert!(number("frames_per_second") > 0.0 && number("bytes_per_second") > 0.0, "{row}");
        assert!(row.get("k").is_some() && row.get("peak_rss_bytes").is_some(), "{row}");
    }
    assert_eq!(found["memory_bandwidth"].as_array().unwrap().len(), 2);
    assert!(found["recipe"]["config"]["counts"] == serde_json::json!([500, "pixels"]));
}

#[test]
fn bench_lists_what_there_is_and_refuses_the_rest() {
    let list = call(&["bench"]).succeeded().stdout;
    assert!(list.lines().any(|line| line.starts_with("raster ")), "{list}");
    for arguments in [
        &["bench", "nothing"][..],
        &["bench", "raster", "--counts", "0"],
        &["bench", "raster", "--counts", "many"],
        &["bench", "raster", "--runs", "0"],
        &["bench", "raster", "--size", "0x3"],
        &["render", "--device", "tpu"],
    ] {
        let Called { code, stderr, .. } = call(arguments);
        assert_eq!(code, Some(2), "{stderr}");
        assert!(stderr.starts_with("error: ") && !stderr.contains("panicked"), "{stderr}");
    }
}

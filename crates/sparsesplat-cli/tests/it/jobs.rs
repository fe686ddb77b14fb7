//! What the commands do when all is well.

use crate::tiny::{RANGE, SIZE, Tiny, call, read_json, window};
use evaluate::{Method, Runner, render_view};
use gs_raster::Rasterizer;
use gs_scene::{read_ply, write_ply};
use serde_json::Value;
use sparsesplat::{Budget, Config, DepthRange};
use std::fs;
use std::path::Path;
use std::process::Command;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

#[test]
fn the_scene_has_as_many_gaussians_as_asked() {
    let tiny = Tiny::new();
    let json = tiny.beside("result.json");
    let arguments = ["--gaussians", "3k", "--depth-range", RANGE, "--views", "5", "--exposure", "common"];
    let arguments = [&arguments[..], &["--json", json.to_str().unwrap()]].concat();
    let called = tiny.reconstruct(&arguments).succeeded();
    assert!(called.stdout.contains("far shell"), "{}", called.stdout);
    let n = read_ply(&tiny.beside("scene.ply")).unwrap().len();
    assert!((2970..=3030).contains(&n), "{n}");
    let result = read_json(&json);
    assert_eq!((number(&result["gaussians"]), number(&result["views"])), (n as f64, 5.0));
    for key in [
        "load",
        "backbone",
        "sampling",
        "backproject",
        "knn",
        "feedback",
        "head",
        "decode",
        "refine",
        "write",
        "total",
    ] {
        assert!(number(&result["seconds"][key]) >= 0.0, "{key}");
    }
    for key in ["command", "git", "seed", "threads", "machine", "config", "versions"] {
        assert!(result["recipe"].get(key).is_some(), "{key}");
    }
    assert_eq!(result["recipe"]["config"]["exposure"], "common");
    assert!(result.get("peak_rss_bytes").is_some());
    assert_eq!(result["choice"]["context"].as_array().unwrap().len(), 5);
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let tiny = Tiny::new();
    let scene = |more: &[&str]| {
        let arguments = [&["--gaussians", "1500", "--depth-range", RANGE], more].concat();
        tiny.reconstruct(&arguments).succeeded();
        fs::read(tiny.beside("scene.ply")).unwrap()
    };
    let one = scene(&["--threads", "1"]);
    assert!(one == scene(&["--threads", "2"]), "1 and 2 threads differ");
    assert!(one != scene(&["--seed", "1"]), "the seed has no effect");
}

#[test]
fn a_written_and_read_scene_renders_as_before() {
    let tiny = Tiny::new();
    let config = Config {
        budget: Budget::Gaussians(2000),
        depth_range: DepthRange::Known { near: 2.0, far: 20.0 },
        ..Config::default()
    };
    let runner = Runner::new(Method::feed_forward(config)).unwrap();
    let outcome = runner.reconstruct(window(), &mut Rasterizer::cpu(), &mut |_| {}).unwrap();
    let scene = outcome.prediction.gaussians;
    let path = tiny.beside("scene.ply");
    write_ply(&path, &scene).unwrap();
    let read = read_ply(&path).unwrap();

    let output = tiny.beside("pictures");
    let (root, positions) = (tiny.root(), "1,4");
    let [scene_path, root, folder] = [&path, &root, &output].map(|path| path.to_str().unwrap());
    call(&["render", scene_path, "--cameras", root, "-o", folder, "--positions", positions]).succeeded();
    assert_eq!(fs::read_dir(&output).unwrap().count(), 2 * 3);
    let arguments = ["--positions", "1", "--ellipsoids", "--device", "cpu"];
    call(&[&["render", scene_path, "--cameras", root, "-o", folder], &arguments[..]].concat()).succeeded();
    let solid = image::open(output.join("view-01-ellipsoids.png")).unwrap().to_rgb8();
    let blended = image::open(output.join("view-01.png")).unwrap().to_rgb8();
    assert!(solid.as_raw() != blended.as_raw() && solid.as_raw().iter().any(|&value| value > 0));

    for (view, name) in [(&window().targets[0], "view-01"), (&window().context[2], "view-04")] {
        assert_eq!(view.name(), name);
        let mut rasterizer = Rasterizer::cpu();
        let before = render_view(&mut rasterizer, &scene, view.camera()).unwrap().image;
        let after = render_view(&mut rasterizer, &read, view.camera()).unwrap().image;
        let worst = before.data().iter().zip(after.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst <= 1e-3, "{name}: {worst}");
        let decoder = image::open(output.join(format!("{name}.png"))).unwrap().to_rgb8();
        assert_eq!((decoder.width() as usize, decoder.height() as usize), SIZE);
        // The camera went through a file: a colour may fall on the other side of a rounding.
        let pixels = decoder.as_raw().iter().zip(before.to_rgb8());
        assert!(pixels.map(|(a, b)| a.abs_diff(b)).max() <= Some(1), "{name}");
    }
}

#[test]
fn an_evaluation_has_figures_for_every_window_and_names_what_it_dropped() {
    let tiny = Tiny::new();
    let index = r#"{"tiny/0": {"context": [0, 2, 4, 6], "target": [1, 3]}, "tiny/1": {"context": [4], "target": [5]}}"#;
    fs::write(tiny.path("evaluation_index.json"), index).unwrap();
    let json = tiny.beside("eval.json");
    let report = tiny.beside("report.html");
    let root = tiny.beside("");
    let [root, json_path, report_path] = [&root, &json, &report].map(|path| path.to_str().unwrap());
    let called = call(&[
        "eval",
        "--dataset",
        "nerfstudio",
        "--root",
        root,
        "--gaussians",
        "1500",
        "--depth-range",
        "hint",
        "--seeds",
        "0,1",
        "--json",
        json_path,
        "--report",
        report_path,
    ]);
    // A window with one view cannot be reconstructed: it is dropped, and the exit code says so.
    assert_eq!(called.code, Some(1), "{}{}", called.stdout, called.stderr);
    assert!(called.stderr.contains("dropped tiny/1"), "{}", called.stderr);
    assert!(called.stdout.contains("tiny/0") && called.stdout.contains('±'), "{}", called.stdout);

    let result = read_json(&json);
    assert_eq!(result["dropped"][0]["name"], "tiny/1");
    assert!(result["dropped"][0]["reason"].as_str().unwrap().contains("two views"));
    let scenes = result["scenes"].as_array().unwrap();
    assert_eq!(scenes.len(), 1);
    for row in [&scenes[0], &result["mean"]] {
        assert!(number(&row["psnr_held_out"]) > 5.0);
        assert!(number(&row["ssim_held_out"]) > 0.0);
        assert!(number(&row["psnr_all"]) > 5.0);
        assert!(row["lpips_held_out"].is_null());
        assert!(number(&row["seconds"]["render"]) > 0.0);
        assert!(number(&row["spread"]["psnr_held_out"]) > 0.0);
    }
    assert_eq!(scenes[0]["targets"], serde_json::json!([1, 3]));
    assert!(number(&result["baselines"]["nearest_view"]["psnr_held_out"]) > 5.0);

    let page = fs::read_to_string(&report).unwrap();
    assert!(page.contains("tiny/0") && page.contains("data:image/jpeg;base64,") && page.contains("<svg"));
    assert!(!page.contains("http://") && !page.contains("https://") && !page.contains("<script"));
}

#[test]
fn refinement_makes_the_scene_better_and_says_how() {
    let tiny = Tiny::new();
    let index = r#"{"tiny/0": {"context": [0, 2, 4, 6, 8, 10], "target": [3, 7]}}"#;
    fs::write(tiny.path("evaluation_index.json"), index).unwrap();
    let (json, plot) = (tiny.beside("eval.json"), tiny.beside("refine.svg"));
    let (folder, depth) = (tiny.beside(""), ["--depth-range", "hint"]);
    let [folder, json_path, plot_path] = [&folder, &json, &plot].map(|path| path.to_str().unwrap());
    let eval = ["eval", "--dataset", "nerfstudio", "--root", folder, "--gaussians", "2k", "--device", "cpu"];
    let refine = ["--refine", "20", "--json", json_path, "--refine-plot", plot_path];
    let called = call(&[&eval[..], &depth, &refine].concat()).succeeded();
    assert!(
        called.stdout.contains("PSNR before refinement") && called.stdout.contains("refined PSNR"),
        "{}",
        called.stdout
    );
    let scene = &read_json(&json)["scenes"][0];
    let (before, after) = (number(&scene["psnr_held_out_feed_forward"]), number(&scene["psnr_held_out"]));
    assert!(after > before + 0.3, "{before} dB before, {after} dB after");
    assert!(number(&scene["seconds"]["refine"]) > 0.0);
    let refinement = &scene["seeds"][0]["refinement"];
    let steps = refinement["steps"].as_array().unwrap();
    assert_eq!((steps.len(), number(&refinement["undone"])), (20, 0.0));
    assert!(number(&steps[19]["psnr_context"]) > number(&refinement["psnr_start"]));
    let curve = refinement["curve"].as_array().unwrap();
    // The curve begins with the scene that is refined, which is not corrected; the pass alone is.
    assert_eq!(number(&curve[0]["step"]), 0.0);
    assert!(before > number(&curve[0]["psnr_held_out"]), "{before}");
    assert_eq!(scene["seeds"][0]["corrected_by"], refinement["corrected"]["by"]);
    let pass = ["--json", json_path];
    call(&[&eval[..], &depth, &pass].concat()).succeeded();
    let passed = &read_json(&json)["scenes"][0];
    assert_eq!(number(&passed["psnr_held_out"]), before);
    assert!(passed["seeds"][0]["corrected_by"].as_str().unwrap().contains("refined-grid"));
    // The steps, and then the correction, which takes none of them.
    let [.., last, corrected] = &curve[..] else { panic!("a curve of points") };
    assert_eq!([last, corrected].map(|point| number(&point["step"])), [20.0; 2]);
    assert!(number(&corrected["seconds"]) > number(&last["seconds"]));
    assert_eq!(corrected["psnr_held_out"], scene["psnr_held_out"]);
    assert!(refinement["corrected"]["by"].as_str().unwrap().contains("refined-grid"));
    assert!(fs::read_to_string(&plot).unwrap().contains("tiny"));
    assert!(number(&scene["gaussians"]) <= 2000.0);

    // Without --report nothing else is rendered.
    let scene = |more: &[&str]| {
        let arguments = [&["--gaussians", "1k", "--depth-range", RANGE, "--device", "cpu"], more].concat();
        let called = tiny.reconstruct(&arguments).succeeded();
        (called.stdout, read_ply(&tiny.beside("scene.ply")).unwrap())
    };
    let (said, refined) = scene(&["--refine", "5"]);
    assert!(said.contains("refined    5 steps") && said.contains("then corrected"), "{said}");
    let (said, uncorrected) = scene(&["--refine", "5", "--corrector", "off"]);
    assert!(!said.contains("corrected") && uncorrected != refined, "{said}");
    assert!(refined == scene(&["--refine", "5", "--threads", "1"]).1, "threads make a difference");
    // Without a step it is the scene of the pass, which is corrected too; none of its Gaussians is too faint to be drawn.
    let (said, unrefined) = scene(&["--refine-seconds", "0"]);
    assert!(said.contains("refined    0 steps") && said.contains("then corrected"), "{said}");
    let (said, passed) = scene(&[]);
    assert!(!said.contains("refined") && passed == unrefined, "{said}");
    assert!(passed != scene(&["--corrector", "off"]).1);
}

#[test]
fn cameras_that_refinement_found_are_kept_as_a_data_set() {
    let tiny = Tiny::new();
    let refine = |folder: &Path| {
        let settings = ["--gaussians", "1k", "--depth-range", RANGE, "--device", "cpu", "--refine", "12"];
        let kept = ["--refine-poses", "--refined-poses", folder.to_str().unwrap()];
        tiny.reconstruct(&[&settings[..], &kept].concat())
    };
    let folder = tiny.beside("refined");
    assert!(refine(&folder).succeeded().stdout.contains("data set   "));
    let [given, found] = [tiny.root(), folder.clone()].map(|root| view_data::open(&root, None).unwrap());
    assert_eq!((found.frames.len(), found.offset), (6, None));
    for frame in &found.frames {
        let before = given.frames.iter().find(|other| other.name == frame.name).unwrap();
        let shift = frame.position.distance(before.position);
        assert!(shift > 0.0 && shift < 0.1, "{}: {shift}", frame.name);
    }
    // What lies there stays.
    let refused = refine(&folder);
    assert!(refused.code != Some(0) && refused.stderr.contains("refined"), "{}", refused.stderr);
}

#[test]
fn the_demo_writes_scene_pictures_and_report() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("demo");
    let arguments = [
        "demo",
        "--size",
        "120x80",
        "--gaussians",
        "2k",
        "--depth-range",
        RANGE,
        "-o",
        output.to_str().unwrap(),
    ];
    let called = call(&arguments).succeeded();
    assert!(called.stdout.contains("report.html"), "{}", called.stdout);
    assert_eq!(read_ply(&output.join("scene.ply")).unwrap().len(), 2000);
    let result = read_json(&output.join("result.json"));
    assert!(number(&result["psnr_held_out"]) > number(&result["psnr_nearest_view"]) - 3.0);
    let report = fs::read_to_string(output.join("report.html")).unwrap();
    assert!(report.contains("view-05") && report.contains("href=\"view.html\""));
    assert!(called.stdout.contains("view.html") && output.join("view.html").is_file());
    assert!(output.join("images/view-05-rendered.png").is_file());
    // No temporary file is left behind.
    assert!(
        fs::read_dir(&output).unwrap().all(|entry| !entry
            .unwrap()
            .path()
            .to_string_lossy()
            .ends_with(".tmp"))
    );
}

#[test]
fn help_teaches_and_the_doctor_passes() {
    for command in ["demo", "reconstruct", "render", "view", "convert", "eval", "bench"] {
        let help = call(&[command, "--help"]).succeeded().stdout;
        assert!(help.contains("Examples:") && help.contains(&format!("sparsesplat {command}")), "{help}");
    }
    assert!(call(&["--help"]).succeeded().stdout.contains("sparsesplat demo"));
    assert!(call(&["doctor"]).succeeded().stdout.contains("self-test  passed"));
    assert_eq!(call::<&str>(&[]).code, Some(2));
}

#[test]
fn recipes_name_the_commit_of_the_program_wherever_it_runs() {
    // Another repository, whose commit is nobody's business.
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join(".git")).unwrap();
    fs::write(folder.path().join(".git/HEAD"), "0123456789abcdef0123456789abcdef01234567\n").unwrap();
    let scene = ["simulate", "--seed", "1", "--kind", "desk", "--size", "16x16", "--frames", "4"];
    let simulate = [&scene[..], &["--samples", "1", "-o", "desk", "--json", "made.json"]].concat();
    let called = Command::new(env!("CARGO_BIN_EXE_sparsesplat"))
        .args(simulate)
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(called.status.success(), "{}", String::from_utf8_lossy(&called.stderr));
    let said = read_json(&folder.path().join("made.json"))["recipe"]["git"].clone();
    let head = |arguments: &[&str]| {
        let output =
            Command::new("git").args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().ok()?;
        output.status.success().then(|| String::from_utf8(output.stdout).unwrap().trim().to_owned())
    };
    // Where this is no checkout, the package names its commit, or nothing does.
    match head(&["ls-files", "--error-unmatch", "build.rs"]).and_then(|_| head(&["rev-parse", "HEAD"])) {
        Some(commit) => assert_eq!(said, commit),
        None => assert!(said == "unknown" || said.as_str().is_some_and(|said| said.len() == 40), "{said}"),
    }
}

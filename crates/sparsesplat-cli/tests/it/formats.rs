//! Scenes in every file format, through the commands of a user.

use crate::tiny::{RANGE, Tiny, call, read_json};
use splat_formats::{Format, HalfTurn, half_turn, read_scene};
use std::fs;

#[test]
fn every_format_is_written_converted_rendered_and_described() {
    let tiny = Tiny::new();
    let (root, text) = (tiny.root(), |name: &str| tiny.beside(name).to_str().unwrap().to_owned());
    let root = root.to_str().unwrap();
    let reconstruct = |output: &str| {
        call(&["reconstruct", root, "--gaussians", "500", "--depth-range", RANGE, "-o", output]).succeeded()
    };
    reconstruct(&text("scene.ply"));
    let said = reconstruct(&text("direct.spz"));
    assert!(said.stderr.contains("direct.spz: opacity is rounded to 8 bits"), "{}", said.stderr);
    for format in Format::ALL {
        let name = format!("made.{}", format.extension());
        let (path, json) = (text(&name), text("convert.json"));
        let said = call(&["convert", &text("scene.ply"), &path, "--json", &json]).succeeded();
        assert_eq!(said.stdout.contains("loses "), format != Format::Ply, "{}", said.stdout);
        let record = read_json(&tiny.beside("convert.json"));
        assert_eq!(record["gaussians"], 500);
        assert_eq!(record["written"], format.extension());
        assert_eq!(record["losses"].as_array().unwrap().is_empty(), format == Format::Ply);
        let said = call(&["check-data", &path]).succeeded().stdout;
        assert!(said.contains("500") && said.contains("extent"), "{said}");
        let pictures = text(&format!("pictures-{}", format.extension()));
        let render =
            ["render", &path, "--cameras", root, "-o", &pictures, "--positions", "1", "--device", "cpu"];
        call(&render).succeeded();
        call(&["view", &path, "-o", &text("page.html"), "--device", "cpu"]).succeeded();
    }
    let [plain, made] = ["scene.ply", "made.ply"].map(|name| fs::read(tiny.beside(name)).unwrap());
    assert!(plain == made, "PLY keeps every bit");
    let [direct, made] = ["direct.spz", "made.spz"].map(|name| fs::read(tiny.beside(name)).unwrap());
    assert!(direct == made, "one writer, the same bytes");
    // What is kept looks like it: axes that are mixed up, or colours, do not.
    let picture = |format: Format| {
        let path = tiny.beside(&format!("pictures-{}/view-01.png", format.extension()));
        image::open(path).unwrap().to_rgb8()
    };
    let exact = picture(Format::Ply);
    for (format, most) in
        [(Format::CompressedPly, 3.0), (Format::Spz, 3.0), (Format::Splat, 12.0), (Format::Glb, 0.01)]
    {
        let found = picture(format);
        let apart: f64 =
            exact.as_raw().iter().zip(found.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
        let mean = apart / exact.as_raw().len() as f64;
        assert!(mean < most, "{format}: pictures differ by {mean} of 255");
    }

    call(&["convert", &text("scene.ply"), &text("turned.ply"), "--half-turn", "x"]).succeeded();
    let mut turned = read_scene(&tiny.beside("turned.ply")).unwrap().gaussians;
    half_turn(&mut turned, HalfTurn::X);
    assert_eq!(turned, read_scene(&tiny.beside("scene.ply")).unwrap().gaussians);
}

#[test]
fn a_scene_goes_back_to_the_world_that_its_poses_were_estimated_in() {
    let tiny = Tiny::new();
    let text = |name: &str| tiny.beside(name).to_str().unwrap().to_owned();
    let mut scene = gs_scene::Gaussians::empty(0).unwrap();
    scene.push([0.5, 1.0, -2.0], [1.0, 0.0, 0.0, 0.0], [0.25, 0.5, 0.75], 1.0, &[0.5; 3]);
    gs_scene::write_ply(&tiny.beside("scene.ply"), &scene).unwrap();
    // The world was moved by -(1, 2, 3), turned from y up to z up, and halved.
    let record = r#"{"levelling": {"up": "horizon", "rotation": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "origin": [1, 2, 3], "scale": 0.5}}"#;
    fs::create_dir(tiny.beside("scene-poses")).unwrap();
    fs::write(tiny.beside("scene-poses/poses.json"), record).unwrap();
    for of in ["scene-poses", "scene-poses/poses.json"] {
        call(&["convert", &text("scene.ply"), &text("back.ply"), "--undo-levelling", &text(of)]).succeeded();
        let back = read_scene(&tiny.beside("back.ply")).unwrap().gaussians;
        let row = back.geometry();
        // 2 (x, z, -y) + (1, 2, 3).
        for (found, expected) in row.iter().zip([2.0, -2.0, 1.0]) {
            assert!((found - expected).abs() < 1e-6, "{row:?}");
        }
        let scales = [0.25, 0.5, 0.75].map(|log: f32| log + 2f32.ln());
        assert!(
            row[7..10].iter().zip(scales).all(|(found, expected)| (found - expected).abs() < 1e-6),
            "{row:?}"
        );
    }
    fs::write(tiny.beside("scene-poses/poses.json"), "{}").unwrap();
    let called =
        call(&["convert", &text("scene.ply"), &text("x.ply"), "--undo-levelling", &text("scene-poses")]);
    assert_eq!(called.code, Some(2));
    assert!(called.stderr.contains("poses.json: no levelling to undo"), "{}", called.stderr);
    assert!(!tiny.beside("x.ply").exists());
}

#[test]
fn what_cannot_be_converted_is_refused() {
    let tiny = Tiny::new();
    let text = |name: &str| tiny.beside(name).to_str().unwrap().to_owned();
    let mut scene = gs_scene::Gaussians::empty(0).unwrap();
    scene.push([0.0, f32::NAN, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 1.0, &[0.5; 3]);
    gs_scene::write_ply(&tiny.beside("nan.ply"), &scene).unwrap();
    let refused = |arguments: &[&str], parts: &[&str]| {
        let called = call(arguments);
        assert_eq!(called.code, Some(2), "{}{}", called.stdout, called.stderr);
        assert!(parts.iter().all(|part| called.stderr.contains(part)), "no {parts:?} in: {}", called.stderr);
    };
    let nan = text("nan.ply");
    refused(&["convert", &nan, &text("x.spz")], &["SPZ", "Gaussian 0: position is NaN"]);
    refused(&["convert", &nan, &text("x.obj")], &["x.obj", ".spz"]);
    refused(&["convert", &nan, &nan], &["nan.ply", "reads"]);
    refused(&["convert", &text("absent.spz"), &text("x.ply")], &["absent.spz", "cannot read"]);
    fs::write(tiny.beside("broken.glb"), b"glTF\x02\0\0\0\x0c\0\0\0").unwrap();
    refused(&["convert", &text("broken.glb"), &text("x.ply")], &["broken.glb", "glTF", "truncated"]);
    refused(&["check-data", &text("broken.glb")], &["broken.glb", "truncated"]);
    let root = tiny.root();
    refused(&["reconstruct", root.to_str().unwrap(), "-o", &text("x.obj")], &["x.obj", "extension"]);
    assert!(!tiny.beside("x.spz").exists() && !tiny.beside("x.ply").exists());
    // A scene of which nothing can be drawn is a finding, not wrong input.
    assert_eq!(call(&["check-data", &nan]).code, Some(1));
    // Without an extension a scene is PLY.
    call(&["convert", &nan, &text("plain")]).succeeded();
    assert!(fs::read(tiny.beside("plain")).unwrap().starts_with(b"ply\n"));
}

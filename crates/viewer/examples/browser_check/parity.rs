//! Frames of the page against gs-raster's CPU path and gs-reference.

use crate::devtools::Browser;
use crate::{Wrong, address};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DVec3};
use gs_raster::{ELLIPSOID_OPACITY_MIN, ELLIPSOID_SIGMA, Rasterizer, RenderSettings, Style, near_plane};
use gs_reference::tolerance::{AMBIGUOUS, AMBIGUOUS_ELLIPSOID, F32_ELLIPSOID, f32_bound};
use gs_reference::{Case, Deviation, Mismatch, Solid, compare};
use gs_scene::{Camera, Gaussians, Intrinsics, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, sh_coefficients};
use serde_json::Value;
use std::io;
use std::path::Path;
use viewer::{Near, Page, Precision, Shot, packed, unpacked};

/// Size at which a reconstruction is compared with the reference.
const SMALL: (usize, usize) = (144, 96);

/// A frame of the page.
pub(crate) struct Frame {
    planes: Planes,
    pub(crate) visible: u64,
    pub(crate) rejected: u64,
    pub(crate) passes: Value,
}

/// The pixels of a frame.
struct Planes {
    image: Vec<f32>,
    transmittance: Vec<f32>,
    /// Σ w and Σ w z.
    depth: Option<[Vec<f32>; 2]>,
}

impl Planes {
    fn alpha(&self) -> Vec<f32> {
        self.transmittance.iter().map(|t| 1.0 - t).collect()
    }

    /// Expected depth.
    fn expected_depth(&self) -> Vec<f32> {
        let [weights, sums] = self.depth.as_ref().expect("a view with depth");
        weights.iter().zip(sums).map(|(&w, &sum)| if w > 0.0 { sum / w } else { 0.0 }).collect()
    }
}

/// The page's first camera as it is there.
const CAMERA: &str = "JSON.parse(document.getElementById('data').textContent).shots[0].camera";

/// Draws a view of the page's first camera, at another size if one is given, into the buffer, and reads it back.
pub(crate) fn frame(
    browser: &mut Browser,
    view: &str,
    size: Option<(usize, usize)>,
    measure: bool,
) -> io::Result<Frame> {
    let intrinsics = match size {
        Some((width, height)) => {
            let shown = camera(&browser.evaluate(CAMERA)?)?;
            serde_json::to_string(&shown.intrinsics().resized(width, height))?
        }
        None => "{}".to_owned(),
    };
    let expression = format!(
        "(async () => {{
          const camera = {CAMERA};
          Object.assign(camera.intrinsics, {intrinsics});
          const frame = await viewer.frame('{view}', camera, {measure});
          const bytes = new Uint8Array(frame.pixels.buffer);
          let text = '';
          for (let at = 0; at < bytes.length; at += 32768) text += String.fromCharCode(...bytes.subarray(at, at + 32768));
          return {{ ...frame, n: camera.intrinsics.width * camera.intrinsics.height, pixels: btoa(text) }};
        }})()"
    );
    let value = browser.evaluate(&expression)?;
    let numbers = floats(&value["pixels"])?;
    let n = value["n"].as_u64().unwrap_or(0) as usize;
    let planes = split(&numbers, n);
    let count = |name: &str| value[name].as_u64().unwrap_or(u64::MAX);
    Ok(Frame {
        planes,
        visible: count("visible"),
        rejected: count("rejected"),
        passes: value["passes"].clone(),
    })
}

/// The numbers of a frame's pixels by plane.
fn split(numbers: &[f32], n: usize) -> Planes {
    let (colours, depths) = numbers.split_at(4 * n);
    Planes {
        image: colours.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect(),
        transmittance: colours.chunks_exact(4).map(|pixel| pixel[3]).collect(),
        depth: (depths.len() == 2 * n).then(|| [depths[..n].to_vec(), depths[n..].to_vec()]),
    }
}

/// The Gaussians that the page draws, which are fewer than it has where its slider says so.
pub(crate) fn shown_scene(browser: &mut Browser) -> io::Result<Gaussians> {
    let value = browser.evaluate(
        "(() => {
          const { degree, geometry, sh } = viewer.scene;
          const text = rows => {
            const bytes = new Uint8Array(rows.buffer);
            let text = '';
            for (let at = 0; at < bytes.length; at += 32768) text += String.fromCharCode(...bytes.subarray(at, at + 32768));
            return btoa(text);
          };
          return { degree, geometry: text(geometry), sh: text(sh) };
        })()",
    )?;
    let degree = value["degree"].as_u64().unwrap_or(0) as usize;
    let (geometry, sh) = (floats(&value["geometry"])?, floats(&value["sh"])?);
    let mut scene = Gaussians::empty(degree).map_err(io::Error::other)?;
    let rows = geometry.chunks_exact(Gaussians::GEOMETRY).zip(sh.chunks_exact(3 * sh_coefficients(degree)));
    for (row, sh) in rows {
        let part = |range: std::ops::Range<usize>| &row[range];
        let three = |range| part(range).try_into().expect("three columns");
        let quaternion = part(QUATERNION).try_into().expect("four columns");
        scene.push(three(MEAN), quaternion, three(LOG_SCALE), row[OPACITY_LOGIT], sh);
    }
    Ok(scene)
}

/// Numbers that the page gives as base64.
fn floats(value: &Value) -> io::Result<Vec<f32>> {
    let bytes = STANDARD.decode(value.as_str().unwrap_or_default()).map_err(io::Error::other)?;
    Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes"))).collect())
}

/// One output beside what it should be.
struct Row {
    output: &'static str,
    deviation: Result<Deviation, Mismatch>,
    bound: f64,
}

/// Worst share of a bound that was used.
#[derive(Default)]
struct Worst(f64);

impl Worst {
    fn judge(&mut self, of: &str, row: &Row, wrong: &mut Wrong) {
        match &row.deviation {
            Ok(deviation) => {
                self.0 = self.0.max(deviation.max_abs / row.bound);
                if deviation.max_abs > row.bound {
                    wrong.push(format!("{of}, {}: {deviation:?}, bound {:.1e}", row.output, row.bound));
                }
            }
            Err(problem) => wrong.push(format!("{of}, {}: {problem}", row.output)),
        }
    }
}

fn settings(case: &Case) -> RenderSettings {
    let profile = &case.profile;
    RenderSettings {
        style: Style::Blended,
        background: case.background,
        near: profile.near as f32,
        far: profile.far as f32,
        antialias: profile.antialias,
        compensation_min: profile.compensation_min as f32,
        depth: true,
        alpha_max: profile.alpha_max as f32,
        alpha_min: profile.alpha_min as f32,
        transmittance_min: profile.transmittance_min as f32,
        eps2d: profile.eps2d as f32,
    }
}

/// Every golden case as a page of its own, all three views.
pub(crate) fn fixtures(browser: &mut Browser, folder: &Path, wrong: &mut Wrong) -> io::Result<()> {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/gs-raster");
    let mut files: Vec<_> =
        std::fs::read_dir(fixtures)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "safetensors"));
    files.sort();
    let (mut golden, mut cpu, mut solid) = (Worst::default(), Worst::default(), Worst::default());
    let (mut compared, mut ellipsoid_pixels) = (0, 0);
    for file in &files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let case = Case::read(file).map_err(io::Error::other)?.in_standard_axes();
        let settings = settings(&case);
        let shots = [Shot { name: name.clone(), camera: case.camera, photograph: None }];
        let (near, precision) = (Near::OfSettings, Precision::Full);
        let page = Page {
            title: &name,
            gaussians: &case.gaussians,
            shots: &shots,
            start: 0,
            stills: &[],
            settings,
            near,
            precision,
        };
        let path = folder.join("case.html");
        std::fs::write(&path, page.html().map_err(io::Error::other)?)?;
        browser.open(&address(&path)?)?;
        browser.wait_for("globalThis.viewer?.frames > 0")?;
        let on_cpu =
            Rasterizer::cpu().render(&case.gaussians, &case.camera, &settings).map_err(io::Error::other)?;
        let expected = &case.expected;
        for view in ["colour", "depth"] {
            let Frame { planes: found, rejected, .. } = frame(browser, view, None, false)?;
            let (alpha, of) = (found.alpha(), format!("{name}, {view}"));
            let row = |output, expected: &[f64], found: &[f32], floor| {
                let deviation = compare(expected.iter().copied(), found.iter().copied(), &case.ambiguous);
                let bound = deviation.as_ref().map_or(0.0, |deviation| f32_bound(deviation, floor));
                Row { output, deviation, bound }
            };
            let wide = |values: &[f32]| -> Vec<f64> { values.iter().map(|&value| value.into()).collect() };
            let mut rows = vec![
                row("image", &expected.image, &found.image, case.f32_image_floor),
                row("alpha", &expected.alpha, &alpha, None),
                row("transmittance", &expected.transmittance, &found.transmittance, None),
            ];
            let mut beside = vec![
                row("image", &wide(on_cpu.image.data()), &found.image, case.f32_image_floor),
                row("alpha", &wide(&on_cpu.alpha), &alpha, None),
            ];
            if view == "depth" {
                let depth = found.expected_depth();
                let sums = &found.depth.as_ref().expect("a view with depth")[1];
                rows.push(row("depth", &expected.depth, &depth, None));
                rows.push(row("depth sum", &expected.depth_sum, sums, None));
                beside.push(row("depth", &wide(on_cpu.depth.as_ref().expect("asked for")), &depth, None));
            }
            rows.iter().for_each(|row| golden.judge(&of, row, wrong));
            beside.iter().for_each(|row| cpu.judge(&format!("{of}, CPU"), row, wrong));
            if rejected != on_cpu.stats.rejected as u64 {
                wrong.push(format!("{of}: {} rejected, {} on the CPU", rejected, on_cpu.stats.rejected));
            }
            compared += 1;
        }
        let found = frame(browser, "ellipsoids", None, false)?.planes;
        let drawn = Solid { sigma: ELLIPSOID_SIGMA.into(), opacity_min: ELLIPSOID_OPACITY_MIN.into() };
        let background = case.background.map(f64::from);
        let truth =
            gs_reference::render_ellipsoids(&case.gaussians, &case.camera, background, &case.profile, drawn);
        let masked: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS_ELLIPSOID).collect();
        let left = masked.iter().filter(|&&masked| !masked).count();
        ellipsoid_pixels += left;
        let planes = [
            ("image", truth.image, found.image.clone()),
            ("alpha", truth.alpha, found.alpha()),
            ("depth", truth.depth, found.expected_depth()),
        ];
        for (output, expected, found) in planes.into_iter().filter(|_| left > 0) {
            let deviation = compare(expected, found, &masked);
            let bound =
                deviation.as_ref().map_or(0.0, |deviation| F32_ELLIPSOID * deviation.largest.max(1.0));
            solid.judge(&format!("{name}, ellipsoids"), &Row { output, deviation, bound }, wrong);
        }
    }
    println!(
        "fixtures   {} cases, {compared} blended frames; worst share of the bound: golden data {:.2}, CPU {:.2}; ellipsoids {:.2} in {ellipsoid_pixels} pixels",
        files.len(),
        golden.0,
        cpu.0,
        solid.0
    );
    if files.len() != 21 || ellipsoid_pixels == 0 {
        wrong.push(format!(
            "{} golden cases, {ellipsoid_pixels} pixels of ellipsoids: expected 21 and some",
            files.len()
        ));
    }
    Ok(())
}

/// A reconstruction: what the page draws of its packed scene against the CPU on the same numbers, and what packing costs.
pub(crate) fn scene(browser: &mut Browser, scene: &Path, page: &Path, wrong: &mut Wrong) -> io::Result<()> {
    let gaussians = gs_scene::read_ply(scene).map_err(io::Error::other)?;
    let bytes = packed(&gaussians, Precision::Compact);
    let kept = unpacked(&gaussians, Precision::Compact, &bytes).map_err(io::Error::other)?;
    browser.open(&address(page)?)?;
    browser.wait_for("globalThis.viewer?.frames > 0")?;
    let shown = camera(&browser.evaluate(CAMERA)?)?;
    // The reference looks at every Gaussian in every pixel.
    let camera =
        shown.with_intrinsics(shown.intrinsics().resized(SMALL.0, SMALL.1)).map_err(io::Error::other)?;
    let draw = |scene: &Gaussians, near: f32, style| {
        let settings = RenderSettings { style, near, depth: true, ..RenderSettings::default() };
        Rasterizer::cpu().render(scene, &camera, &settings).map_err(io::Error::other)
    };
    let near = near_plane(&kept, &camera);
    let exact = draw(&gaussians, near_plane(&gaussians, &camera), Style::Blended)?;
    let on_cpu = draw(&kept, near, Style::Blended)?;
    let profile = gs_reference::Profile { near: near.into(), ..gs_reference::Profile::default() };
    // Where decisions are close is the naive renderer's to say. The picture is that of the twins, which sort by depths in f32 as all
    // passes do: of 40k Gaussians some have depths that are equal in f32 and not in f64.
    let margin = gs_reference::render(&kept, &camera, [0.0; 3], &profile).margin;
    let view = gs_reference::chain::View::new(&kept, &camera, [0.0; 3], &profile, true);
    let truth = split(&gs_reference::chain::forward(&view).pixels.pixels, camera.width() * camera.height());
    let masked: Vec<bool> = margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
    let left = masked.iter().filter(|&&masked| !masked).count();
    let Frame { planes: found, visible, .. } = frame(browser, "depth", Some(SMALL), false)?;
    let (mut reference, mut cpu) = (Worst::default(), Worst::default());
    let depth = found.expected_depth();
    let planes = [
        ("image", truth.image.clone(), on_cpu.image.data(), found.image.clone()),
        ("alpha", truth.alpha(), &on_cpu.alpha, found.alpha()),
        ("depth", truth.expected_depth(), on_cpu.depth.as_ref().expect("asked for"), depth),
    ];
    for (output, truth, beside, found) in planes {
        let row = |deviation: Result<Deviation, Mismatch>| {
            let bound = deviation.as_ref().map_or(0.0, |deviation| f32_bound(deviation, None));
            Row { output, deviation, bound }
        };
        reference.judge(
            "scene, reference",
            &row(compare(truth.iter().copied(), found.iter().copied(), &masked)),
            wrong,
        );
        cpu.judge("scene, CPU", &row(compare(beside.iter().copied(), found.iter().copied(), &masked)), wrong);
    }
    if visible == 0 {
        wrong.push("scene: nothing is visible".to_owned());
    }
    let psnr = image_metrics::psnr(&exact.image, &on_cpu.image).map_err(io::Error::other)?;
    println!(
        "scene      {} Gaussians, {left} of {} pixels compared; worst share of the bound: gs-reference {:.2}, CPU {:.2}",
        gaussians.len(),
        masked.len(),
        reference.0,
        cpu.0
    );
    println!(
        "packing    {} bytes, {psnr:.1} dB between the pictures of the packed and the exact scene",
        bytes.len()
    );
    Ok(())
}

/// A camera as the page has it.
fn camera(value: &Value) -> io::Result<Camera> {
    let numbers = |name: &str| -> Vec<f64> {
        value[name].as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
    };
    let intrinsics: Intrinsics = serde_json::from_value(value["intrinsics"].clone())?;
    let (rotation, translation) = (numbers("rotation"), numbers("translation"));
    let rotation: [f64; 9] =
        rotation.try_into().map_err(|_| io::Error::other("a rotation has nine numbers"))?;
    let translation: [f64; 3] = translation.try_into().map_err(|_| io::Error::other("three numbers"))?;
    let rotation = DMat3::from_cols_array(&rotation).transpose();
    Camera::new(intrinsics, rotation, DVec3::from_array(translation)).map_err(io::Error::other)
}

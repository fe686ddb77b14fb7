//! Keys, mouse, sliders and files, as a person uses them.

use crate::devtools::Browser;
use crate::{Wrong, address};
use serde_json::{Value, json};
use std::io;
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

/// Place, direction and mode of the view.
const STATE: &str = "JSON.stringify([viewer.state.pose.place, viewer.state.pose.R, viewer.state.mode])";

/// Drives every control of a page with photographs and several cameras.
pub(crate) fn drive(browser: &mut Browser, folder: &Path, page: &Path, wrong: &mut Wrong) -> io::Result<()> {
    browser.open(&address(page)?)?;
    browser.wait_for("globalThis.viewer?.frames > 0")?;
    rest(browser)?;
    browser.screenshot(&folder.join("viewer-colour.png"))?;

    for (name, key, code) in [
        ("forward", "w", "KeyW"),
        ("left", "a", "KeyA"),
        ("up", "e", "KeyE"),
        ("turn", "ArrowLeft", "ArrowLeft"),
    ] {
        changes(browser, wrong, name, |browser| {
            press(browser, "keyDown", key, code)?;
            sleep(Duration::from_millis(300));
            press(browser, "keyUp", key, code)
        })?;
    }
    changes(browser, wrong, "R goes back", |browser| tap(browser, "r", "KeyR"))?;
    changes(browser, wrong, "a drag orbits", |browser| drag(browser, 0))?;
    changes(browser, wrong, "a shift drag pans", |browser| drag(browser, 8))?;
    changes(browser, wrong, "the wheel", |browser| {
        browser.call(
            "Input.dispatchMouseEvent",
            json!({"type": "mouseWheel", "x": 700, "y": 400, "deltaX": 0, "deltaY": -240}),
        )?;
        sleep(Duration::from_millis(200));
        Ok(())
    })?;
    changes(browser, wrong, "two fingers", pinch)?;
    browser.screenshot(&folder.join("viewer-moved.png"))?;
    for (key, mode) in [("2", "ellipsoids"), ("3", "depth"), ("4", "opacity"), ("1", "colour")] {
        changes(browser, wrong, mode, |browser| tap(browser, key, &format!("Digit{key}")))?;
        rest(browser)?;
        if browser.evaluate("viewer.state.mode")? != json!(mode) {
            wrong.push(format!("key {key} does not show {mode}"));
        }
        browser.screenshot(&folder.join(format!("viewer-{mode}-moved.png")))?;
    }
    changes(browser, wrong, "a button of a mode", |browser| click(browser, "[data-mode=depth]"))?;
    changes(browser, wrong, "N goes to the next camera", |browser| tap(browser, "n", "KeyN"))?;
    changes(browser, wrong, "the button of the previous camera", |browser| click(browser, "#before"))?;
    tap(browser, "1", "Digit1")?;

    // The photograph beside the picture.
    expect(
        browser,
        wrong,
        "!document.getElementById('compare-row').hidden",
        "a camera with a photograph offers it",
    )?;
    slide(browser, "compare", 0.5)?;
    expect(
        browser,
        wrong,
        "!document.getElementById('photograph').hidden && document.getElementById('photograph').naturalWidth > 0",
        "the slider shows the photograph",
    )?;
    browser.screenshot(&folder.join("viewer-photograph.png"))?;
    slide(browser, "compare", 0.0)?;

    // First n of N. A quarter of 40k goes into a file, to be measured beside a reconstruction of as many.
    let all = browser.evaluate("viewer.scene.n")?;
    for (position, name) in [(0.0, "fewest"), (0.625, "quarter")] {
        slide(browser, "amount", position)?;
        rest(browser)?;
        browser.screenshot(&folder.join(format!("viewer-{name}.png")))?;
    }
    let first = crate::parity::shown_scene(browser)?;
    let file = folder.join("first.ply");
    gs_scene::write_ply(&file, &first).map_err(io::Error::other)?;
    println!("first n    {} of {all} Gaussians in {}", first.len(), file.display());
    expect(
        browser,
        wrong,
        &format!("viewer.scene.n > 1000 && viewer.scene.n < {all}"),
        "the slider draws fewer Gaussians",
    )?;
    slide(browser, "amount", 1.0)?;
    expect(browser, wrong, &format!("viewer.scene.n === {all}"), "the slider goes back to all Gaussians")?;

    click(browser, "#measure")?;
    rest(browser)?;
    expect(
        browser,
        wrong,
        "document.querySelectorAll('#passes tr').length >= 7 || document.getElementById('passes').textContent.includes('no timestamps')",
        "the passes' times are listed",
    )?;
    browser.screenshot(&folder.join("viewer-times.png"))?;
    click(browser, "#measure")?;

    // The picture as a file: what the page hands to the browser is a PNG that is not black.
    browser.evaluate(
        "(() => { const make = URL.createObjectURL; URL.createObjectURL = blob => { globalThis.saved = blob; return make(blob); }; })()",
    )?;
    click(browser, "#save")?;
    browser.wait_for("Boolean(globalThis.saved)")?;
    expect(
        browser,
        wrong,
        "(async () => { const picture = await createImageBitmap(saved); const c = new OffscreenCanvas(picture.width, picture.height).getContext('2d');
           c.drawImage(picture, 0, 0); const data = c.getImageData(0, 0, picture.width, picture.height).data;
           let sum = 0; for (let i = 0; i < data.length; i += 4) sum += data[i]; return saved.type === 'image/png' && sum / (data.length / 4) > 8; })()",
        "the saved PNG shows the scene",
    )?;

    if let Some(fetched) = browser
        .requests
        .iter()
        .find(|url| !["file:", "data:", "blob:"].iter().any(|kind| url.starts_with(kind)))
    {
        wrong.push(format!("the page fetches {fetched}"));
    }
    drop_files(browser, folder, wrong)
}

/// Another scene dropped onto the page, and a file that is none.
fn drop_files(browser: &mut Browser, folder: &Path, wrong: &mut Wrong) -> io::Result<()> {
    let mut scene = gs_scene::Gaussians::empty(3).map_err(io::Error::other)?;
    for i in 0..60 {
        let turn = f64::from(i) * 0.4;
        let mean = [turn.cos() as f32, 0.05 * i as f32 - 1.5, turn.sin() as f32];
        let mut sh = vec![0.0; 48];
        sh[0] = 1.5;
        sh[1] = 0.03 * i as f32;
        sh[5] = 0.4;
        scene.push(mean, [1.0, 0.1, 0.2, 0.3], [-2.0, -3.0, -2.5], 3.0, &sh);
    }
    let good = folder.join("dropped.ply");
    gs_scene::write_ply(&good, &scene).map_err(io::Error::other)?;
    let bad = folder.join("dropped.txt");
    std::fs::write(&bad, "no scene")?;
    drop_file(browser, &bad)?;
    browser.wait_for("!document.getElementById('message').hidden")?;
    expect(
        browser,
        wrong,
        "/^dropped.txt: not a PLY file \\(the first line is not \"ply\"\\)\\. .*sparsesplat convert/.test(document.getElementById('message').textContent)",
        "a file that is no scene is told, and what makes one",
    )?;
    drop_file(browser, &good)?;
    browser.wait_for("viewer.scene.n === 60")?;
    rest(browser)?;
    expect(
        browser,
        wrong,
        "document.getElementById('message').hidden && document.querySelector('#panel h1').textContent === 'dropped.ply'",
        "a dropped scene replaces the other",
    )?;
    expect(
        browser,
        wrong,
        "document.getElementById('status').textContent.startsWith('60 Gaussians, 60 in view')",
        "all of the dropped scene is in view",
    )?;
    browser.screenshot(&folder.join("viewer-dropped.png"))
}

/// A browser without WebGPU: a message and pictures.
pub(crate) fn without_webgpu(
    browser: &mut Browser,
    folder: &Path,
    page: &Path,
    wrong: &mut Wrong,
) -> io::Result<()> {
    browser.open(&address(page)?)?;
    browser.wait_for("!document.getElementById('fallback').hidden")?;
    expect(
        browser,
        wrong,
        "document.getElementById('panel').hidden && /WebGPU/.test(document.getElementById('why').textContent)",
        "without WebGPU the page says so",
    )?;
    expect(
        browser,
        wrong,
        "document.querySelectorAll('#stills img').length > 0 && [...document.querySelectorAll('#stills img')].every(one => one.complete && one.naturalWidth > 0)",
        "without WebGPU there are pictures",
    )?;
    browser.screenshot(&folder.join("viewer-fallback.png"))?;
    // The browser's own warning that it has no WebGPU is what this is about; its words depend on the version.
    let expected = ["Failed to create WebGPU Context Provider", "No available adapters"];
    browser.complaints.retain(|complaint| !expected.iter().any(|words| complaint.contains(words)));
    wrong.append(&mut browser.complaints);
    Ok(())
}

fn expect(browser: &mut Browser, wrong: &mut Wrong, expression: &str, rule: &str) -> io::Result<()> {
    if browser.evaluate(expression)? != Value::Bool(true) {
        let says = browser.evaluate("document.getElementById('status').textContent + ' | ' + document.getElementById('message').textContent")?;
        wrong.push(format!("it does not hold that {rule} (the page says {says})"));
    }
    Ok(())
}

/// Does something that must change the view, and draw it.
fn changes(
    browser: &mut Browser,
    wrong: &mut Wrong,
    name: &str,
    act: impl FnOnce(&mut Browser) -> io::Result<()>,
) -> io::Result<()> {
    rest(browser)?;
    let (before, frames) = (browser.evaluate(STATE)?, browser.evaluate("viewer.frames")?);
    act(browser)?;
    rest(browser)?;
    if browser.evaluate(STATE)? == before {
        wrong.push(format!("{name}: the view does not change"));
    }
    if browser.evaluate("viewer.frames")? == frames {
        wrong.push(format!("{name}: nothing is drawn"));
    }
    Ok(())
}

/// Waits until nothing is drawn any more.
fn rest(browser: &mut Browser) -> io::Result<()> {
    sleep(Duration::from_millis(50));
    browser.wait_for("!viewer.busy")
}

fn press(browser: &mut Browser, kind: &str, key: &str, code: &str) -> io::Result<()> {
    browser.call("Input.dispatchKeyEvent", json!({"type": kind, "key": key, "code": code})).map(drop)
}

fn tap(browser: &mut Browser, key: &str, code: &str) -> io::Result<()> {
    press(browser, "keyDown", key, code)?;
    press(browser, "keyUp", key, code)
}

fn mouse(browser: &mut Browser, kind: &str, x: f64, y: f64, modifiers: u32, buttons: u32) -> io::Result<()> {
    let params = json!({
        "type": kind, "x": x, "y": y, "modifiers": modifiers, "button": "left", "buttons": buttons, "clickCount": 1
    });
    browser.call("Input.dispatchMouseEvent", params).map(drop)
}

fn drag(browser: &mut Browser, modifiers: u32) -> io::Result<()> {
    mouse(browser, "mousePressed", 700.0, 400.0, modifiers, 1)?;
    for step in 1..=4 {
        mouse(
            browser,
            "mouseMoved",
            700.0 + 20.0 * f64::from(step),
            400.0 + 6.0 * f64::from(step),
            modifiers,
            1,
        )?;
    }
    mouse(browser, "mouseReleased", 780.0, 424.0, modifiers, 0)
}

fn pinch(browser: &mut Browser) -> io::Result<()> {
    let touch = |kind: &str, reach: f64| {
        let points = if kind == "touchEnd" {
            json!([])
        } else {
            json!([{"x": 700.0 - reach, "y": 400.0, "id": 1}, {"x": 700.0 + reach, "y": 420.0, "id": 2}])
        };
        json!({"type": kind, "touchPoints": points})
    };
    for (kind, reach) in [("touchStart", 60.0), ("touchMove", 80.0), ("touchMove", 100.0), ("touchEnd", 0.0)]
    {
        browser.call("Input.dispatchTouchEvent", touch(kind, reach))?;
    }
    Ok(())
}

fn click(browser: &mut Browser, selector: &str) -> io::Result<()> {
    let place = browser.evaluate(&format!(
        "(() => {{ const box = document.querySelector('{selector}').getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
    ))?;
    let [x, y] = [0, 1].map(|i| place[i].as_f64().unwrap_or(0.0));
    mouse(browser, "mousePressed", x, y, 0, 1)?;
    mouse(browser, "mouseReleased", x, y, 0, 0)
}

/// Moves a slider with the mouse.
fn slide(browser: &mut Browser, id: &str, position: f64) -> io::Result<()> {
    let bar = browser.evaluate(&format!(
        "(() => {{ const slider = document.getElementById('{id}'), box = slider.getBoundingClientRect(); return [box.x, box.y + box.height / 2, box.width, Number(slider.value)]; }})()"
    ))?;
    let [x, y, width, old] = [0, 1, 2, 3].map(|i| bar[i].as_f64().unwrap_or(0.0));
    // The handle is about 16 pixels wide, and stays within the bar.
    let at = |share: f64| x + 8.0 + share * (width - 16.0);
    mouse(browser, "mousePressed", at(old), y, 0, 1)?;
    mouse(browser, "mouseMoved", at(0.5 * (old + position)), y, 0, 1)?;
    let beyond = if position <= 0.0 {
        -12.0
    } else if position >= 1.0 {
        12.0
    } else {
        0.0
    };
    mouse(browser, "mouseMoved", at(position) + beyond, y, 0, 1)?;
    mouse(browser, "mouseReleased", at(position) + beyond, y, 0, 0)
}

fn drop_file(browser: &mut Browser, file: &Path) -> io::Result<()> {
    for kind in ["dragEnter", "dragOver", "drop"] {
        let data = json!({"items": [], "files": [file], "dragOperationsMask": 1});
        browser.call("Input.dispatchDragEvent", json!({"type": kind, "x": 700, "y": 400, "data": data}))?;
    }
    Ok(())
}

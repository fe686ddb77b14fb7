//! The page in a real browser: frames against gs-raster's CPU path and gs-reference, controls, no network.
//!
//! `browser_check BROWSER FOLDER [SCENE.ply PAGE.html]`: `cargo xtask browser-test` calls it. Screenshots go into the folder.

mod controls;
mod devtools;
mod parity;

use devtools::Browser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Size at which a scene must be shown within [`SHOWN_WITHIN`].
const SIZE: (u32, u32) = (320, 240);
/// Milliseconds from the start of the navigation to the first frame.
const SHOWN_WITHIN: f64 = 2000.0;
/// Largest page of a scene of 40k Gaussians, bytes.
const PAGE_MAX: u64 = 4_000_000;

/// What was found wrong.
pub(crate) type Wrong = Vec<String>;

fn main() -> ExitCode {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let (browser, folder, scene) = match &arguments[..] {
        [browser, folder] => (browser, folder, None),
        [browser, folder, scene, page] => (browser, folder, Some((scene, page))),
        _ => {
            eprintln!("usage: browser_check BROWSER FOLDER [SCENE.ply PAGE.html]");
            return ExitCode::from(2);
        }
    };
    match check(browser, folder, scene) {
        Ok(wrong) => {
            println!("viewer: {} problems", wrong.len());
            wrong.iter().for_each(|wrong| println!("  {wrong}"));
            if wrong.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn check(program: &Path, folder: &Path, scene: Option<(&PathBuf, &PathBuf)>) -> std::io::Result<Wrong> {
    std::fs::create_dir_all(folder)?;
    let folder = &std::fs::canonicalize(folder)?;
    let mut wrong = Wrong::new();
    let mut browser = Browser::start(program, folder, true, SIZE)?;
    parity::fixtures(&mut browser, folder, &mut wrong)?;
    if let Some((scene, page)) = scene {
        parity::scene(&mut browser, scene, page, &mut wrong)?;
        drop(browser);
        // A browser that has compiled nothing yet.
        std::fs::remove_dir_all(folder.join("profile"))?;
        browser = Browser::start(program, folder, true, SIZE)?;
        time(&mut browser, page, &mut wrong)?;
        drop(browser);
        browser = Browser::start(program, folder, true, (1100, 720))?;
        controls::drive(&mut browser, folder, page, &mut wrong)?;
    }
    wrong.append(&mut browser.complaints);
    drop(browser);
    if let Some((_, page)) = scene {
        let mut browser = Browser::start(program, folder, false, (1100, 720))?;
        controls::without_webgpu(&mut browser, folder, page, &mut wrong)?;
    }
    Ok(wrong)
}

/// The address of a file.
pub(crate) fn address(page: &Path) -> std::io::Result<String> {
    Ok(format!("file://{}", std::fs::canonicalize(page)?.display()))
}

/// How large the page is, how long until it shows something, and what the passes take.
fn time(browser: &mut Browser, page: &Path, wrong: &mut Wrong) -> std::io::Result<()> {
    let bytes = std::fs::metadata(page)?.len();
    println!("page       {bytes} bytes");
    if bytes > PAGE_MAX {
        wrong.push(format!("the page has {bytes} bytes, at most {PAGE_MAX} are allowed"));
    }
    browser.open(&address(page)?)?;
    browser.wait_for("globalThis.viewer?.frames > 0")?;
    let shown = browser.evaluate("viewer.shownAfter")?.as_f64().unwrap_or(f64::INFINITY);
    println!("shown      after {shown:.0} ms at {} x {}", SIZE.0, SIZE.1);
    if shown > SHOWN_WITHIN {
        wrong.push(format!("shown after {shown:.0} ms, at most {SHOWN_WITHIN:.0} are allowed"));
    }
    let size = Some((SIZE.0 as usize, SIZE.1 as usize));
    for view in ["colour", "depth", "ellipsoids"] {
        // The second frame: pipelines are compiled and buffers are there.
        parity::frame(browser, view, size, false)?;
        let frame = parity::frame(browser, view, size, true)?;
        let passes = frame.passes.as_object().map(|passes| {
            passes
                .iter()
                .map(|(name, ms)| format!("{name} {:.1}", ms.as_f64().unwrap_or(f64::NAN)))
                .collect::<Vec<_>>()
        });
        println!(
            "{view:<10} ms by pass: {}",
            passes.map_or("no timestamps".to_owned(), |passes| passes.join(", "))
        );
    }
    Ok(())
}

//! `cargo xtask browser-test`: reports and the viewer opened in a real browser.
//!
//! The viewer's page of a demo is driven by the example `browser_check` of the crate viewer. Of reports, a copy of each page gets a script that looks at it as laid out and writes down what is wrong; the browser without a window
//! prints the page afterwards. Whatever the page says on the console is wrong, too.

use crate::run::{cargo, exit_code};
use std::env;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Programs that are looked for, after the one that the variable names.
const NAMES: [&str; 5] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"];
const VARIABLE: &str = "CHROMIUM";

const NO_BROWSER: &str = "\
error: no browser: none of chromium, chromium-browser, google-chrome, google-chrome-stable, chrome is on the PATH
  Debian: apt-get install chromium; or CHROMIUM=/path/to/it cargo xtask browser-test";

/// How long a page may take.
const LIMIT: Duration = Duration::from_secs(90);

/// Before everything else on the page: errors from the first script on.
const BEFORE: &str = "<script>
const wrong = [];
addEventListener('error', event => wrong.push(`error: ${event.message || event.target.tagName + ' does not load'}`), true);
addEventListener('unhandledrejection', event => wrong.push(`rejected: ${event.reason}`));
</script>
";

/// After everything else: what a reader would see. Each rule is one that a page has broken.
const AFTER: &str = "<script>
addEventListener('load', () => {
  const box = element => element.getBoundingClientRect();
  const plots = [...document.querySelectorAll('svg')];
  const pictures = [...document.images];
  if (plots.length + pictures.length === 0) wrong.push('neither a plot nor a picture is there');
  plots.forEach((plot, i) => {
    const name = `plot ${i + 1}`, frame = box(plot);
    if (frame.width < 300 || frame.height < 40) wrong.push(`${name} is ${frame.width} x ${frame.height} pixels`);
    const drawn = [...plot.querySelectorAll('path, polyline, circle, rect, line, polygon')].filter(one => box(one).width + box(one).height > 0);
    if (drawn.length < 3) wrong.push(`${name} has ${drawn.length} visible parts`);
    if (/NaN|Infinity/.test(plot.innerHTML)) wrong.push(`${name} has coordinates that are no numbers`);
    const texts = [...plot.querySelectorAll('text')].filter(text => text.textContent.trim());
    texts.forEach((text, j) => {
      const a = box(text), said = JSON.stringify(text.textContent.trim());
      if (a.left < frame.left - 1 || a.right > frame.right + 1 || a.top < frame.top - 1 || a.bottom > frame.bottom + 1)
        wrong.push(`${name}: ${said} is cut off`);
      for (const other of texts.slice(0, j)) {
        const b = box(other);
        const shared = Math.min(a.right, b.right) - Math.max(a.left, b.left), below = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (shared > 1 && below > 4) wrong.push(`${name}: ${said} lies on ${JSON.stringify(other.textContent.trim())}`);
      }
    });
  });
  for (const picture of pictures)
    if (!picture.complete || picture.naturalWidth === 0) wrong.push(`picture ${JSON.stringify(picture.alt)} is not shown`);
  document.querySelectorAll('.slides').forEach((show, i) => {
    const slider = show.querySelector('input[type=range]'), slides = [...show.querySelectorAll('.slide')];
    for (const value of [slider.max, slider.min]) {
      slider.value = value;
      slider.dispatchEvent(new Event('input'));
      const seen = slides.map((slide, at) => box(slide).height > 0 ? at : -1).filter(at => at >= 0);
      if (seen.join() !== value) wrong.push(`slider ${i + 1} at ${value} shows slides [${seen}] of ${slides.length}`);
    }
  });
  for (const fetched of performance.getEntriesByType('resource'))
    if (!fetched.name.startsWith('data:')) wrong.push(`fetches ${fetched.name}`);
  const report = document.createElement('pre');
  report.id = 'browser-test';
  report.textContent = [`${plots.length} plots, ${pictures.length} pictures`, ...wrong].join('\\n');
  document.body.append(report);
});
</script>
";

/// Opens `pages`, or pages that `make` writes into a folder where none are given, and says what is wrong with them.
pub(crate) fn run(root: &Path, pages: &[OsString], make: impl Fn(&Path) -> Option<Vec<PathBuf>>) -> ExitCode {
    let Some(browser) = browser() else {
        eprintln!("{NO_BROWSER}");
        return ExitCode::FAILURE;
    };
    let folder = root.join("target/browser-test");
    let mut pages: Vec<PathBuf> = pages.iter().map(PathBuf::from).collect();
    let all = pages.is_empty();
    if all {
        match fs::create_dir_all(&folder).ok().and_then(|()| make(&folder)) {
            Some(made) => pages = made,
            None => {
                eprintln!("error: the pages to look at could not be made");
                return ExitCode::FAILURE;
            }
        }
    }
    let mut failed = false;
    for page in &pages {
        match look(&browser, page, &folder) {
            Ok(Seen { summary, wrong }) => {
                println!("{}: {summary}, {} problems", page.display(), wrong.len());
                wrong.iter().for_each(|wrong| println!("  {wrong}"));
                failed |= !wrong.is_empty();
            }
            Err(error) => {
                eprintln!("error: {}: {error}", page.display());
                failed = true;
            }
        }
    }
    if all {
        failed |= viewer(root, &browser, &folder.join("viewer")) != ExitCode::SUCCESS;
    }
    if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// The viewer on the golden cases of gs-raster, and on a demo of 40k Gaussians with its controls.
fn viewer(root: &Path, browser: &Path, folder: &Path) -> ExitCode {
    const CHECK: [&str; 7] =
        ["run", "--quiet", "--release", "--package", "viewer", "--example", "browser_check"];
    let demo = folder.join("demo");
    let words = ["-o".into(), demo.clone().into(), "--device".into(), "cpu".into()];
    if crate::forward(root, "demo", &words) != ExitCode::SUCCESS {
        return ExitCode::FAILURE;
    }
    let mut check = cargo(CHECK);
    check.arg("--").args([browser, folder, &demo.join("scene.ply"), &demo.join("view.html")]);
    exit_code(check.current_dir(root).status())
}

/// The browser: what the variable names, or the first that is found.
fn browser() -> Option<PathBuf> {
    if let Some(named) = env::var_os(VARIABLE) {
        return Some(named.into());
    }
    let path = env::var_os("PATH")?;
    let folders: Vec<PathBuf> = env::split_paths(&path).collect();
    NAMES
        .iter()
        .flat_map(|name| folders.iter().map(move |folder| folder.join(name)))
        .find(|path| path.is_file())
}

/// What a page looks like.
#[derive(Debug, PartialEq, Eq)]
struct Seen {
    /// How much is there.
    summary: String,
    /// What is wrong, one entry each.
    wrong: Vec<String>,
}

fn look(browser: &Path, page: &Path, folder: &Path) -> io::Result<Seen> {
    let text = fs::read_to_string(page)?;
    fs::create_dir_all(folder)?;
    let copy = fs::canonicalize(folder)?.join("probed.html");
    fs::write(&copy, probed(&text)?)?;
    let (dom, log) = (folder.join("dom.html"), folder.join("browser.log"));
    let mut child = Command::new(browser)
        .args(["--headless", "--disable-gpu", "--hide-scrollbars", "--window-size=1280,1600"])
        // Containers give no sandbox; the pages are our own.
        .args(["--no-sandbox", "--enable-logging=stderr", "--virtual-time-budget=10000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", fs::canonicalize(folder)?.join("profile").display()))
        .arg(format!("file://{}", copy.display()))
        .stdout(Stdio::from(fs::File::create(&dom)?))
        .stderr(Stdio::from(fs::File::create(&log)?))
        .spawn()?;
    let begin = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if begin.elapsed() > LIMIT {
            child.kill()?;
            child.wait()?;
            return Err(io::Error::other(format!("not done after {} s", LIMIT.as_secs())));
        }
        sleep(Duration::from_millis(50));
    };
    if !status.success() {
        return Err(io::Error::other(format!("the browser failed ({status}), see {}", log.display())));
    }
    let log = String::from_utf8_lossy(&fs::read(&log)?).into_owned();
    seen(&String::from_utf8_lossy(&fs::read(&dom)?), &log)
}

/// A page with the scripts in it.
fn probed(page: &str) -> io::Result<String> {
    let no = |tag: &str| io::Error::other(format!("no {tag} in it"));
    let head = page.find("<head>").ok_or_else(|| no("<head>"))? + "<head>".len();
    let body = page.rfind("</body>").ok_or_else(|| no("</body>"))?;
    Ok([&page[..head], BEFORE, &page[head..body], AFTER, &page[body..]].concat())
}

/// What the scripts found, and what was said on the console.
fn seen(dom: &str, log: &str) -> io::Result<Seen> {
    const OPEN: &str = "<pre id=\"browser-test\">";
    let report = dom.rfind(OPEN).map(|start| &dom[start + OPEN.len()..]);
    let report = report.and_then(|rest| rest.split_once("</pre>")).map(|(report, _)| report);
    let report = report.ok_or_else(|| io::Error::other("the page was not loaded to its end"))?;
    let mut lines = report.lines().map(str::to_owned);
    let summary = lines.next().unwrap_or_default();
    let console = log.lines().filter(|line| line.contains(":CONSOLE")).map(|line| format!("console: {line}"));
    Ok(Seen { summary, wrong: lines.chain(console).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_stand_around_the_page() {
        let page = probed("<html><head><title>x</title></head><body><p>y</p></body></html>").unwrap();
        let places = ["addEventListener('error'", "<title>", "<p>y", "browser-test", "</body>"]
            .map(|part| page.find(part));
        assert!(places.windows(2).all(|pair| pair[0] < pair[1]) && places[0].is_some(), "{places:?}");
        assert!(probed("<p>no page</p>").is_err());
    }

    #[test]
    fn what_is_wrong_comes_from_the_page_and_from_the_console() {
        let dom = "<body><pre id=\"browser-test\">2 plots, 1 pictures\nplot 1 is 0 x 0 pixels</pre></body>";
        let log = "[1:2:INFO:headless.cc(1)] started\n[1:2:INFO:CONSOLE(7)] \"Uncaught\", source: file (7)\n";
        let found = seen(dom, log).unwrap();
        assert_eq!(found.summary, "2 plots, 1 pictures");
        assert_eq!(found.wrong.len(), 2);
        assert!(found.wrong[1].contains("Uncaught"));
        assert!(seen("<body></body>", "").is_err());
    }
}

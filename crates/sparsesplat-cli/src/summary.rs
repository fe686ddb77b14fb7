//! What commands say on standard output, or on standard error where a result takes standard output.

use crate::failure::{Failure, Outcome};
use evaluate::{Figures, Method, Refinement, WindowFigures};
use report_parts::count;
use sparsesplat::{Allocation, Budget};
use std::io::{self, ErrorKind, Write};
use std::sync::OnceLock;

/// Set where a result takes standard output: what is said then goes to standard error.
static TAKEN: OnceLock<()> = OnceLock::new();
/// Why standard output took no more.
static FAILED: OnceLock<io::Error> = OnceLock::new();

/// From here on, what is said goes to standard error: a result takes standard output.
pub(crate) fn leave_standard_output() {
    TAKEN.get_or_init(|| ());
}

/// Set where only errors are said.
static ONLY_ERRORS: OnceLock<()> = OnceLock::new();

/// From here on, [`print`] and [`warn`] say nothing: another rank of the same run does.
#[cfg(feature = "candle")]
pub(crate) fn say_errors_only() {
    ONLY_ERRORS.get_or_init(|| ());
}

/// Prints text. That it could not be printed is told by [`finish`].
pub(crate) fn print(text: &str) {
    if ONLY_ERRORS.get().is_some() {
        return;
    }
    if TAKEN.get().is_some() {
        tell(text);
    } else if let Err(error) = io::stdout().write_all(readable(text).as_bytes()) {
        FAILED.get_or_init(|| error);
    }
}

/// Prints text on standard error. If that fails, nobody is left to be told.
pub(crate) fn tell(text: &str) {
    let text: Vec<String> = readable(text).split_inclusive('\n').map(shortened).collect();
    let _ = io::stderr().write_all(text.concat().as_bytes());
}

/// Text as a terminal may have it: names come from files, and those may hold what moves its cursor or changes its colours.
fn readable(text: &str) -> String {
    let is_control = |letter: char| letter.is_control() && letter != '\n' && letter != '\t';
    let show = |letter: char| {
        if is_control(letter) { letter.escape_default().to_string() } else { letter.to_string() }
    };
    if text.contains(is_control) { text.chars().map(show).collect() } else { text.to_owned() }
}

/// A line of which people see both ends: a name from a file may be of any length.
fn shortened(line: &str) -> String {
    const LONGEST: usize = 4000;
    const END: usize = 500;
    let length = line.chars().count();
    if length <= LONGEST {
        return line.to_owned();
    }
    let start: String = line.chars().take(LONGEST - END).collect();
    let end: String = line.chars().skip(length - END).collect();
    format!("{start} [... {} more characters ...] {end}", length - LONGEST)
}

/// Something that must not be overlooked.
pub(crate) fn warn(what: &str) {
    if ONLY_ERRORS.get().is_none() {
        tell(&format!("warning: {what}\n"));
    }
}

/// Whether all that was printed has arrived. A reader that has gone away (`| head`) is no error.
pub(crate) fn finish() -> Outcome {
    let flushed = io::stdout().flush();
    match FAILED.get().or(flushed.as_ref().err()) {
        Some(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::work(format!("standard output: cannot write, what was to be said is lost: {error}")))
        }
        _ => Ok(()),
    }
}

/// Prints a line.
pub(crate) fn print_line(text: &str) {
    print(&format!("{text}\n"));
}

/// How many Gaussians, where they come from, with and without the shell.
pub(crate) fn counts_line(figures: &WindowFigures) -> String {
    let counts = &figures.counts;
    let views: Vec<String> = counts.per_view.iter().map(|&n| count(n as f64)).collect();
    format!(
        "Gaussians  {} with the far shell ({}), {} without; per view: {}",
        count(counts.total as f64),
        count(counts.shell as f64),
        count((counts.total - counts.shell) as f64),
        views.join(", ")
    )
}

/// Warns where fewer Gaussians came about than were asked for: no more can than there are pixels.
pub(crate) fn shortfall(figures: &WindowFigures, method: &Method) -> Option<String> {
    let Budget::Gaussians(asked) = method.predict.budget else { return None };
    let (total, allocation) = (figures.counts.total, method.predict.allocation);
    // The count of an allocation by voxels is near what is asked for, not equal; every pixel is no count that was asked for.
    let is_short = total + total / 20 < asked && allocation != Allocation::PixelAligned;
    is_short.then(|| {
        format!(
            "{} Gaussians instead of the {} that were asked for: the photographs have no more pixels to make them of",
            count(total as f64),
            count(asked as f64)
        )
    })
}

/// PSNR and SSIM of held-out views, where some were measured.
pub(crate) fn held_out_line(figures: &WindowFigures) -> Option<String> {
    let Figures { psnr_held_out, ssim_held_out, .. } = &figures.figures;
    psnr_held_out
        .is_finite()
        .then(|| format!("held out   PSNR {psnr_held_out:.2} dB, SSIM {ssim_held_out:.3}"))
}

/// What refinement did, if there was one.
pub(crate) fn refinement_line(figures: &WindowFigures) -> Option<String> {
    let Refinement { report, corrected, .. } = figures.refinement.as_ref()?;
    let psnr = report.steps.last().map_or(report.psnr_start, |step| step.psnr_context);
    let mut line = format!(
        "refined    {} steps, {:.2} s: from {:.2} to {psnr:.2} dB on the photographs",
        report.steps.len(),
        report.seconds,
        report.psnr_start
    );
    if report.stopped == Some(refine::Stopped::NothingGained) {
        line += "; stopped, nothing more was gained";
    }
    if let Some(corrected) = corrected {
        line += &format!("; then corrected ({:.2} s of these {:.2} s)", corrected.seconds, report.seconds);
    }
    if !report.poses.is_empty() {
        let largest = report.poses.iter().fold(0.0f64, |largest, change| largest.max(change.degrees));
        let focal = report
            .poses
            .iter()
            .map(|change| change.focal)
            .max_by(|a, b| a.ln().abs().total_cmp(&b.ln().abs()));
        let focal = focal.map_or(0.0, |factor| 100.0 * (factor - 1.0));
        line += &format!("; cameras turned by up to {largest:.2} degrees, focal length {focal:+.1} %");
    }
    if report.undone > 0 {
        line += &format!("; {} steps were not finite and undone", report.undone);
    }
    if !report.pruned.is_empty() {
        line +=
            &format!("; {} Gaussians became invisible and were dropped", count(report.pruned.len() as f64));
    }
    Some(line)
}

/// Time by stage.
pub(crate) fn seconds_line(figures: &WindowFigures) -> String {
    let seconds = &figures.figures.seconds;
    let ran = seconds.by_name().filter(|(_, seconds)| *seconds > 0.0);
    let stages: Vec<String> = ran.map(|(name, seconds)| format!("{name} {seconds:.3}")).collect();
    format!("seconds    {:.2} in all: {}", seconds.total, stages.join(", "))
}

/// Most memory held at once, where the system says.
pub(crate) fn memory_line(bytes: Option<u64>) -> String {
    match bytes {
        Some(bytes) => format!("memory     {:.2} GB at most", bytes as f64 / 1e9),
        None => "memory     not known on this system".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_do_not_speak_to_the_terminal() {
        assert_eq!(readable("a\tb\nö"), "a\tb\nö");
        assert_eq!(readable("\u{1b}[2J\u{7}\r\u{9b}"), r"\u{1b}[2J\u{7}\r\u{9b}");
        assert_eq!(shortened("short\n"), "short\n");
        let long = format!("start{}end\n", "ö".repeat(100_000));
        let shown = shortened(&long);
        assert!(
            shown.starts_with("start") && shown.ends_with("end\n") && shown.chars().count() < 4100,
            "{}",
            shown.len()
        );
    }
}

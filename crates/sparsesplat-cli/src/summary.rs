//! What commands say on standard output.

use evaluate::{WindowFigures, count};
use std::io::Write;

/// Prints text. A reader that has gone away (`| head`) is no error.
pub(crate) fn print(text: &str) {
    let _ = std::io::stdout().write_all(text.as_bytes());
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

/// What refinement did, if there was one.
pub(crate) fn refinement_line(figures: &WindowFigures) -> Option<String> {
    let report = &figures.refinement.as_ref()?.report;
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
    let ran = seconds.stages().into_iter().filter(|(_, seconds)| *seconds > 0.0);
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

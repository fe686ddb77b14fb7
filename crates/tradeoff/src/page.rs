//! The self-contained HTML page of a sweep: text, plots, tables, and pictures of every point under a slider.

use super::SweepError;
use super::document::{SHARES, points_table, share_table, statements, windows_in_words};
use super::pictures::Pictures;
use super::plot::tradeoff_plots;
use super::summary::{Row, Summary};
use report_parts::page::{document, escape, jpeg_source, table, tile};
use report_parts::{count, decibel, number};
use std::fmt::Write;

/// Shows one point of each window at a time; without it all are shown.
const SCRIPT: &str = "<script>
for (const show of document.querySelectorAll('.slides')) {
  const points = [...show.querySelectorAll('.slide')];
  const slider = show.querySelector('input');
  const at = () => points.forEach((point, i) => { point.hidden = i !== Number(slider.value); });
  slider.parentElement.hidden = false;
  slider.addEventListener('input', at);
  at();
}
</script>
";

/// The page; `windows` are all of the sweep, in its order, `recipe` is JSON.
///
/// # Errors
/// If a picture that was kept cannot be read.
pub fn tradeoff_page(
    summary: &Summary,
    machine: &str,
    windows: &[String],
    pictures: &Pictures,
    recipe: &str,
) -> Result<String, SweepError> {
    let mut body = format!(
        "<p class=\"soft\">One method, varied along one axis at a time, on {}. {}</p>\n",
        escape(&windows_in_words(summary)),
        escape(machine)
    );
    if !summary.dropped.is_empty() {
        let dropped: Vec<String> =
            summary.dropped.iter().map(|dropped| format!("{}: {}", dropped.name, dropped.reason)).collect();
        let _ = writeln!(body, "<p class=\"warning\">Without figures: {}</p>", escape(&dropped.join("; ")));
    }
    body.push_str(&tiles(summary));
    body.push_str("<ul>\n");
    for said in statements(summary) {
        let _ = writeln!(body, "<li>{}</li>", escape(&said));
    }
    body.push_str("</ul>\n");
    for (_, title, svg) in tradeoff_plots(summary) {
        let _ =
            writeln!(body, "<section><h2>{}</h2>\n<div class=\"plot\">{svg}</div></section>", escape(title));
    }
    body.push_str(
        "<p class=\"soft\">Ringed points are on the Pareto front: no other point has more quality at the same cost or less. Points with \
         measured depth, and points that differ only in rendering, are left out of the front.</p>\n",
    );
    let mut shown = 0;
    for position in pictures.windows() {
        if let Some(window) = windows.get(position).filter(|window| summary.windows.contains(window)) {
            body.push_str(&slides(summary, window, position, pictures)?);
            shown += 1;
        }
    }
    if shown < summary.windows.len() {
        let _ = writeln!(
            body,
            "<p class=\"soft\">{} more windows are measured and not shown.</p>",
            summary.windows.len() - shown
        );
    }
    if !summary.shares.is_empty() {
        body.push_str("<h2>How many Gaussians for the quality of one per pixel</h2>\n");
        body.push_str(&table(&share_table(summary), SHARES));
    }
    body.push_str("<h2>Every point</h2>\n");
    body.push_str(&table(
        &points_table(summary),
        "PSNR in dB of held-out views; seconds from photographs to Gaussians",
    ));
    let _ =
        writeln!(body, "<p class=\"soft\">{} {}</p>", escape(summary.protocol), escape(summary.measured_as));
    if shown > 0 {
        body.push_str(SCRIPT);
    }
    Ok(document("What accuracy costs in time", &body, recipe))
}

/// The base's figures.
fn tiles(summary: &Summary) -> String {
    let Some(base) = summary.points.iter().find(|row| row.label.base && row.failed.is_none()) else {
        return String::new();
    };
    let mut html = String::from("<div class=\"tiles\">\n");
    html.push_str(&tile(&base.label.point, "the base that is varied"));
    html.push_str(&tile(&format!("{} dB", decibel(base.psnr_held_out)), "PSNR of views never seen"));
    html.push_str(&tile(
        &format!("{} s", number(base.seconds_to_gaussians, 2)),
        "from photographs to Gaussians",
    ));
    html.push_str(&tile(&number(base.frames_per_second, 1), "frames per second"));
    html.push_str(&tile(&format!("{} MB", number(base.ply_bytes / 1e6, 1)), "file"));
    html.push_str("</div>\n");
    html
}

/// The pictures of one window: photograph, rendering and error of each point.
fn slides(
    summary: &Summary,
    window: &str,
    position: usize,
    pictures: &Pictures,
) -> Result<String, SweepError> {
    let mut slides: Vec<(&Row, [Vec<u8>; 2])> = Vec::new();
    for row in summary.points.iter().filter(|row| row.failed.is_none()) {
        let rendering = pictures.read(position, &row.label.point)?;
        let error = pictures.read(position, &format!("{}-error", row.label.point))?;
        if let (Some(rendering), Some(error)) = (rendering, error) {
            slides.push((row, [rendering, error]));
        }
    }
    let Some(photograph) = pictures.read(position, "photograph")?.filter(|_| !slides.is_empty()) else {
        return Ok(String::new());
    };
    let mut html = format!(
        "<section class=\"slides\"><h2>{}</h2>\n<p hidden><input type=\"range\" min=\"0\" max=\"{}\" value=\"{}\" \
         aria-label=\"point of the sweep\"></p>\n<div class=\"pair\"><div>{}</div>\n<div>\n",
        escape(window),
        slides.len() - 1,
        slides.iter().position(|(row, _)| row.label.base).unwrap_or(0),
        image(&photograph, "photograph, held out"),
    );
    for (row, [rendering, error]) in &slides {
        let _ = write!(
            html,
            "<div class=\"slide\"><p class=\"target\">{} <span>{} Gaussians; means of the sweep: {} dB, {} s</span></p>\n\
             <div class=\"row two\">{}{}</div></div>\n",
            escape(&row.label.point),
            count(row.gaussians),
            decibel(row.psnr_held_out),
            number(row.seconds_to_gaussians, 2),
            image(rendering, "rendering"),
            image(error, "error"),
        );
    }
    html.push_str("</div></div></section>\n");
    Ok(html)
}

fn image(jpeg: &[u8], caption: &str) -> String {
    format!(
        "<figure><img alt=\"{caption}\" src=\"{}\"><figcaption>{caption}</figcaption></figure>",
        jpeg_source(jpeg)
    )
}

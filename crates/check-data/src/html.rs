//! The page of a check: one file that needs no network.

mod plot;

use super::report::{CameraSummary, CheckReport, Finding, RangeSource, Severity};
use plot::{overlap_plot, side_plot, top_plot};
use report_parts::page::{escape, jpeg_source, shell, tile};
use std::fmt::{Display, Write};

/// The report as a page: what was found, the cameras from above and from the side, who overlaps whom, how
/// every reading of the poses fits, some pictures. Everything is inside: styles, drawings (SVG) and pictures
/// (JPEG).
///
/// The drawings look along the mean of the cameras' y axes, whatever the file calls up.
#[must_use]
pub fn layout_html(report: &CheckReport) -> String {
    let title = escape(&report.name);
    let mut page = format!(
        "<h1>{title}</h1>\n<p class=\"soft\">{}, {}</p>\n",
        escape(&report.format),
        escape(&report.file)
    );
    tiles(&mut page, report);
    findings(&mut page, &report.findings);
    if !report.cameras.is_empty() {
        page.push_str("<h2>Cameras</h2>\n");
        page.push_str(
            "<p>Each camera is drawn with its field of view; the colour runs along the list of frames. Dots \
             are points of the \
             scene. Cameras with findings of their own are ringed.</p>\n<div class=\"halves\">\n",
        );
        for (caption, plot) in [("From above", top_plot(report)), ("From the side", side_plot(report))] {
            let _ = writeln!(page, "<figure>{plot}<figcaption>{caption}</figcaption></figure>");
        }
        page.push_str("</div>\n");
        let last = report.cameras.len() - 1;
        let _ = writeln!(
            page,
            "<div class=\"legend\"><span>{}<i class=\"ramp\" \
             style=\"background:linear-gradient(90deg,{})\"></i>{}</span></div>",
            escape(&report.cameras[0].name),
            (0..=8).map(|k| plot::path_colour(f64::from(k) / 8.0)).collect::<Vec<_>>().join(","),
            escape(&report.cameras[last].name)
        );
    }
    if let Some(overlap) = &report.overlap {
        page.push_str("<h2>Overlap</h2>\n");
        let _ = write!(
            page,
            "<p>An arc joins two frames of the list if each sees at least half of what the other shows (by \
             the depths above, \
             without occlusion). Groups: {}. Colours are groups.</p>\n<figure>{}</figure>\n",
            overlap.components.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
            overlap_plot(report, overlap)
        );
    }
    readings(&mut page, report);
    frames(&mut page, &report.cameras);
    thumbnails(&mut page, report);
    shell(&format!("Check of {}", report.name), include_str!("html/check.css"), &page)
}

fn tiles(page: &mut String, report: &CheckReport) {
    page.push_str("<div class=\"tiles\">\n");
    let mut tile = |value: String, meaning: &str| page.push_str(&tile(&value, meaning));
    tile(format!("{} / {}", report.pictures.decoded, report.frames), "pictures read, of frames");
    if let Some(size) = report.pictures.sizes.first() {
        let more = report.pictures.sizes.len() - 1;
        let others = if more > 0 { format!("pixels, and {more} more sizes") } else { "pixels".to_owned() };
        tile(format!("{}x{}", size.width, size.height), &others);
    }
    let [narrow, wide] = report.lens.field_of_view;
    let field = if wide - narrow < 0.5 {
        format!("{wide:.0}\u{b0}")
    } else {
        format!("{narrow:.0}\u{2013}{wide:.0}\u{b0}")
    };
    tile(field, "horizontal field of view");
    if let Some([Some(median), Some(p90)]) = report.poses.readings.first().map(|r| [r.median, r.p90]) {
        tile(format!("{median:.2} / {p90:.2} px"), "epipolar distance as read, median / 90 %");
    }
    if let Some(range) = &report.range {
        let [near, far] = range.near_far;
        tile(format!("{near}\u{2013}{far}"), &format!("depth range, from {}", source(range.source)));
    }
    if let Some(depth) = report.depth.as_ref().and_then(|depth| depth.consistent) {
        tile(format!("{:.1} %", 100.0 * depth), "of warped depth agrees within 2 %");
    }
    page.push_str("</div>\n");
}

fn source(source: RangeSource) -> &'static str {
    match source {
        RangeSource::Measured => "measured depth",
        RangeSource::Points => "points",
        RangeSource::Stated => "the file",
        RangeSource::Matches => "matches",
        RangeSource::Poses => "the poses alone",
    }
}

fn severity(severity: Severity) -> &'static str {
    match severity {
        Severity::Ok => "ok",
        Severity::Note => "note",
        Severity::Warning => "warning",
        Severity::Error => "error",
    }
}

fn findings(page: &mut String, findings: &[Finding]) {
    page.push_str(
        "<h2>Findings</h2>\n<div class=\"scroll\"><table \
     class=\"text\"><tr><th></th><th>where</th><th>rule</th><th>what</th></tr>\n",
    );
    for finding in findings {
        let name = severity(finding.severity);
        let _ = writeln!(
            page,
            "<tr><td><span class=\"badge {name}\">{name}</span></td><td \
             class=\"place\">{}</td><td><code>{}</code></td><td>{}</td></tr>",
            escape(&finding.place),
            finding.rule,
            escape(&finding.text)
        );
    }
    page.push_str("</table></div>\n");
}

fn cell(value: Option<impl Display>) -> String {
    value.map_or_else(|| "\u{2013}".to_owned(), |value| value.to_string())
}

fn readings(page: &mut String, report: &CheckReport) {
    if report.poses.readings.is_empty() {
        return;
    }
    let _ = write!(
        page,
        "<h2>Readings of the poses</h2>\n<p>Epipolar distance of {} matches in {} pairs of pictures, under \
         the poses as read and as \
         the usual misreadings would have them. A right reading has a distance well below a pixel, and the \
         scene in front of the \
         cameras.</p>\n<div class=\"scroll\"><table><tr><th>reading</th><th>median px</th><th>90 % \
         px</th><th>in front</th></tr>\n",
        report.poses.matches, report.poses.pairs
    );
    for (i, score) in report.poses.readings.iter().enumerate() {
        let name = serde_json::to_value(score.reading).ok();
        let name = name.as_ref().and_then(|value| value.as_str()).unwrap_or_default().replace('-', " ");
        let _ = writeln!(
            page,
            "<tr{}><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            if i == 0 { " class=\"mean\"" } else { "" },
            escape(&name),
            cell(score.median.map(|v| format!("{v:.3}"))),
            cell(score.p90.map(|v| format!("{v:.3}"))),
            cell(score.in_front.map(|v| format!("{:.0} %", 100.0 * v)))
        );
    }
    page.push_str("</table></div>\n");
}

fn frames(page: &mut String, cameras: &[CameraSummary]) {
    let _ = write!(
        page,
        "<details><summary>All {} frames</summary>\n<div \
         class=\"scroll\"><table><tr><th>frame</th><th>x</th><th>y</th><th>z</th>\
         <th>matches</th><th>epipolar px</th><th>largest \
         share</th><th>group</th><th>brightness</th><th>sharpness</th></tr>\n",
        cameras.len()
    );
    for camera in cameras {
        let [x, y, z] = camera.position;
        let _ = writeln!(
            page,
            "<tr><td>{}</td><td>{x:.3}</td><td>{y:.3}</td><td>{z:.3}</td>\
             <td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&camera.name),
            camera.matches,
            cell(camera.epipolar.map(|v| format!("{v:.2}"))),
            cell(camera.shared.map(|v| format!("{:.0} %", 100.0 * v))),
            cell(camera.component.map(|group| group + 1)),
            cell(camera.brightness.map(|v| format!("{v:.2}"))),
            cell(camera.sharpness.map(|v| format!("{v:.0}")))
        );
    }
    page.push_str("</table></div></details>\n");
}

fn thumbnails(page: &mut String, report: &CheckReport) {
    if report.thumbnails.is_empty() {
        return;
    }
    page.push_str("<h2>Some pictures</h2>\n<div class=\"thumbs\">\n");
    for thumbnail in &report.thumbnails {
        let name = escape(&report.cameras[thumbnail.frame].name);
        let _ = writeln!(
            page,
            "<figure><img width=\"{}\" height=\"{}\" alt=\"picture of {name}\" \
             src=\"{}\">\
             <figcaption>{name}</figcaption></figure>",
            thumbnail.width,
            thumbnail.height,
            jpeg_source(&thumbnail.jpeg)
        );
    }
    page.push_str("</div>\n");
}

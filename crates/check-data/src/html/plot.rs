//! Drawings of the cameras and of their overlaps, as SVG.

use crate::readings::median;
use crate::report::{CameraSummary, CheckReport, OverlapSummary, Severity};
use glam::{DVec2, DVec3};
use report_parts::page::escape;
use std::fmt::Write;

const WIDTH: f64 = 620.0;
const HEIGHT: f64 = 460.0;
const BORDER: f64 = 26.0;
/// Frusta are so long, as a share of the drawing.
const FRUSTUM: f64 = 0.045;
/// Cameras that are drawn, at most.
const MAX_CAMERAS: usize = 1500;
/// Arcs that are drawn, at most.
const MAX_ARCS: usize = 6000;

/// Colour of a frame that is so far along the list, 0..1: dark blue over red to yellow.
pub(super) fn path_colour(t: f64) -> String {
    // Turbo and its like are rainbows; this runs from dark to light, and both ends show on light and dark
    // pages.
    const STOPS: [[f64; 3]; 5] = [
        [60.0, 60.0, 180.0],
        [140.0, 50.0, 170.0],
        [205.0, 65.0, 115.0],
        [235.0, 120.0, 60.0],
        [240.0, 190.0, 50.0],
    ];
    let position = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let low = (position as usize).min(STOPS.len() - 2);
    let mix = |c: usize| {
        (STOPS[low][c] + (STOPS[low + 1][c] - STOPS[low][c]) * (position - low as f64)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

const GROUPS: [&str; 6] = ["#2f6f8f", "#c05621", "#6b8f2f", "#8f2f6f", "#8f7a2f", "#4a4a9a"];

/// The directions of a drawing: right and down on the page.
struct Axes {
    right: DVec3,
    down: DVec3,
}

/// From above: down the mean y axis of the cameras; and from the side, along the horizontal direction in
/// which the cameras spread least.
fn axes(report: &CheckReport) -> [Axes; 2] {
    let sum = |column: usize| -> DVec3 {
        report.cameras.iter().map(|camera| DVec3::from_array(camera.axes[column])).sum()
    };
    let down = sum(1).try_normalize().unwrap_or(DVec3::Y);
    let flat = |v: DVec3| (v - down * v.dot(down)).try_normalize();
    // Two horizontal directions, turned so that the cameras spread most along the first.
    let first = flat(sum(0)).unwrap_or_else(|| down.any_orthonormal_vector());
    let second = first.cross(down);
    let count = report.cameras.len().max(1) as f64;
    let positions: Vec<DVec3> = report.cameras.iter().map(|c| DVec3::from_array(c.position)).collect();
    let mean = positions.iter().sum::<DVec3>() / count;
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    for position in positions {
        let (a, b) = ((position - mean).dot(first), (position - mean).dot(second));
        (aa, ab, bb) = (aa + a * a, ab + a * b, bb + b * b);
    }
    let angle = 0.5 * (2.0 * ab).atan2(aa - bb);
    let right = first * angle.cos() + second * angle.sin();
    [Axes { right, down: right.cross(down) }, Axes { right, down }]
}

pub(super) fn top_plot(report: &CheckReport) -> String {
    plot(report, &axes(report)[0], "cameras from above")
}

pub(super) fn side_plot(report: &CheckReport) -> String {
    plot(report, &axes(report)[1], "cameras from the side")
}

fn plot(report: &CheckReport, axes: &Axes, description: &str) -> String {
    let flat = |p: [f64; 3]| {
        let p = DVec3::from_array(p);
        DVec2::new(p.dot(axes.right), p.dot(axes.down))
    };
    let stride = report.cameras.len().div_ceil(MAX_CAMERAS).max(1);
    let cameras: Vec<(usize, &CameraSummary)> = report.cameras.iter().enumerate().step_by(stride).collect();
    let centres: Vec<DVec2> = cameras.iter().map(|(_, camera)| flat(camera.position)).collect();
    let points: Vec<DVec2> = report.points.iter().map(|&point| flat(point)).collect();
    let window = Window::around(&centres, &points);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" \
         aria-label=\"{description}\">\n<g class=\"dots\">"
    );
    for point in points.iter().map(|point| window.place(*point)).filter(|p| Window::shows(*p)) {
        let _ = write!(svg, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"1\"/>", point.x, point.y);
    }
    svg.push_str("</g>\n");
    let mut path = String::new();
    let mut outside = 0;
    let last = (report.cameras.len().max(2) - 1) as f64;
    for (&(i, camera), centre) in cameras.iter().zip(&centres) {
        let place = window.place(*centre);
        if !Window::shows(place) {
            outside += 1;
            continue;
        }
        let _ = write!(path, "{}{:.1} {:.1}", if path.is_empty() { "M" } else { "L" }, place.x, place.y);
        frustum(&mut svg, camera, place, axes, &path_colour(i as f64 / last), is_bad(report, camera));
    }
    let _ = writeln!(svg, "<path class=\"path\" d=\"{path}\"/>");
    scale_bar(&mut svg, &window);
    if outside > 0 {
        let _ = writeln!(svg, "<text x=\"{BORDER}\" y=\"18\">{outside} cameras are far outside</text>");
    }
    svg.push_str("</svg>\n");
    svg
}

/// Whether a finding that matters names the frame.
fn is_bad(report: &CheckReport, camera: &CameraSummary) -> bool {
    let suffix = format!("({})", camera.name);
    report.findings.iter().any(|f| f.severity >= Severity::Warning && f.place.ends_with(&suffix))
        || report.layout.outliers.contains(&camera.name)
}

fn frustum(svg: &mut String, camera: &CameraSummary, place: DVec2, axes: &Axes, colour: &str, bad: bool) {
    let [x, y, z] = camera.axes.map(DVec3::from_array);
    let [half_x, half_y] = camera.half_field.map(|half| half.min(3.0));
    let length = FRUSTUM * WIDTH / (1.0 + half_x * half_x + half_y * half_y).sqrt();
    let corner = |sx: f64, sy: f64| {
        let ray = (z + x * (sx * half_x) + y * (sy * half_y)) * length;
        place + DVec2::new(ray.dot(axes.right), ray.dot(axes.down))
    };
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let mut path = String::new();
    for (k, here) in corners.iter().enumerate() {
        let next = corners[(k + 1) % 4];
        let _ = write!(
            path,
            "M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}",
            place.x, place.y, here.x, here.y, next.x, next.y
        );
    }
    if bad {
        let _ = write!(svg, "<circle class=\"bad\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"9\"/>", place.x, place.y);
    }
    let _ = writeln!(
        svg,
        "<g stroke=\"{colour}\" fill=\"{colour}\"><title>{}</title><path fill=\"none\" d=\"{path}\"/>\
         <circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\"/></g>",
        escape(&camera.name),
        place.x,
        place.y
    );
}

/// What part of the plane the drawing shows.
struct Window {
    middle: DVec2,
    /// Pixels per scene unit.
    scale: f64,
}

impl Window {
    /// Holds nearly all cameras and most points. A few far ones must not shrink the rest to a dot.
    fn around(centres: &[DVec2], points: &[DVec2]) -> Self {
        let Some((low, high)) = inner(centres, 0.02) else { return Self { middle: DVec2::ZERO, scale: 1.0 } };
        let (low, high) = match inner(points, 0.05) {
            // Points of the background may be far away: never more than four times the cameras' own extent.
            Some((from, to)) => {
                let reach =
                    DVec2::splat(4.0 * (high - low).max_element().max(1e-3 * (to - from).max_element()));
                (low.min(from.max(low - reach)), high.max(to.min(high + reach)))
            }
            None => (low, high),
        };
        let room = DVec2::new(WIDTH, HEIGHT) - DVec2::splat(2.0 * (BORDER + FRUSTUM * WIDTH));
        let extent = high - low;
        let scale = (room / extent.max(DVec2::splat(1e-12 * (1.0 + high.abs().max_element())))).min_element();
        Self { middle: 0.5 * (low + high), scale }
    }

    fn place(&self, p: DVec2) -> DVec2 {
        (p - self.middle) * self.scale + 0.5 * DVec2::new(WIDTH, HEIGHT)
    }

    fn shows(p: DVec2) -> bool {
        p.x >= 0.0 && p.y >= 0.0 && p.x <= WIDTH && p.y <= HEIGHT
    }
}

/// Corners of the box that holds all but a share of the values at each end of each axis, and no value more
/// than ten times as far from the median as half of them.
fn inner(points: &[DVec2], share: f64) -> Option<(DVec2, DVec2)> {
    if points.is_empty() {
        return None;
    }
    let bounds = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|p| p[axis]).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let middle = median(values.clone())?;
        let typical = median(values.iter().map(|v| (v - middle).abs()).collect())?;
        // Small sets show all that is not an outlier.
        let cut = if values.len() < 50 { 0.0 } else { share };
        let quantile = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
        let reach = if typical > 0.0 { 10.0 * typical } else { f64::INFINITY };
        Some((quantile(cut).max(middle - reach), quantile(1.0 - cut).min(middle + reach)))
    };
    let ((left, right), (top, bottom)) = (bounds(0)?, bounds(1)?);
    Some((DVec2::new(left, top), DVec2::new(right, bottom)))
}

fn scale_bar(svg: &mut String, window: &Window) {
    let length = 0.2 * WIDTH / window.scale;
    let unit = 10f64.powf(length.log10().floor());
    let round = [5.0, 2.0, 1.0].into_iter().map(|k| k * unit).find(|v| *v <= length).unwrap_or(unit);
    let (y, right) = (HEIGHT - 12.0, BORDER + round * window.scale);
    if !(right.is_finite() && right < WIDTH) {
        return;
    }
    let name = if (1e-3..1e5).contains(&round) { format!("{round}") } else { format!("{round:.0e}") };
    let _ = writeln!(
        svg,
        "<path class=\"scale\" d=\"M{BORDER} {y}L{right:.1} {y}\"/><text x=\"{:.1}\" \
         y=\"{:.1}\">{name}</text>",
        right + 6.0,
        y + 4.0
    );
}

/// The frames along a line, arcs between those that share half of their content.
pub(super) fn overlap_plot(report: &CheckReport, overlap: &OverlapSummary) -> String {
    const WIDE: f64 = 1180.0;
    let count = report.cameras.len();
    let x = |i: usize| BORDER + (WIDE - 2.0 * BORDER) * i as f64 / (count.max(2) - 1) as f64;
    let longest = overlap.edges.iter().map(|[a, b]| x(*b) - x(*a)).fold(0.0, f64::max);
    let tall = (0.5 * longest).clamp(40.0, 220.0);
    let squash = if longest > 0.0 { tall / longest } else { 0.5 };
    let (base, height) = (tall + 14.0, tall + 40.0);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDE} {height:.0}\" width=\"{WIDE}\" height=\"{height:.0}\" role=\"img\" \
         aria-label=\"overlap of the frames\">\n"
    );
    let group = |i: usize| report.cameras[i].component.unwrap_or(0);
    let stride = overlap.edges.len().div_ceil(MAX_ARCS).max(1);
    let opacity = (40.0 / (overlap.edges.len().max(1) as f64).sqrt()).clamp(0.06, 0.6) * 0.5;
    let _ = write!(svg, "<g fill=\"none\" stroke-opacity=\"{opacity:.2}\">");
    for [a, b] in overlap.edges.iter().step_by(stride) {
        let radius = 0.5 * (x(*b) - x(*a));
        let _ = write!(
            svg,
            "<path stroke=\"{}\" d=\"M{:.1} {base}A{radius:.1} {:.1} 0 0 1 {:.1} {base}\"/>",
            GROUPS[group(*a) % GROUPS.len()],
            x(*a),
            2.0 * radius * squash,
            x(*b)
        );
    }
    svg.push_str("</g>\n");
    for (i, camera) in report.cameras.iter().enumerate().step_by(count.div_ceil(MAX_CAMERAS).max(1)) {
        let _ = write!(
            svg,
            "<circle fill=\"{}\" cx=\"{:.1}\" cy=\"{base}\" r=\"3\"><title>{}</title></circle>",
            GROUPS[group(i) % GROUPS.len()],
            x(i),
            escape(&camera.name)
        );
    }
    if let (Some(first), Some(last)) = (report.cameras.first(), report.cameras.last()) {
        let y = base + 20.0;
        let _ = write!(
            svg,
            "\n<text x=\"{BORDER}\" y=\"{y}\">{}</text><text x=\"{}\" y=\"{y}\" \
             text-anchor=\"end\">{}</text>",
            escape(&first.name),
            WIDE - BORDER,
            escape(&last.name)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

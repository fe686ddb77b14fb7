//! The plots of a sweep as SVG.

use super::breakdown::breakdown;
use super::summary::{Row, Summary};
use super::sweep::Axis;
use crate::chart::{COLOURS, Drawn, SIZE, axes, legend, line, marks, range, style, svg};
use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Colour of the front.
const FRONT: RGBColor = BLACK;

/// The plots, each with a name for files and a title: quality over time, quality over Gaussians, frames per second over Gaussians, and
/// where the time goes.
#[must_use]
pub fn tradeoff_plots(summary: &Summary) -> Vec<(&'static str, &'static str, String)> {
    vec![
        ("seconds", "Quality over time", svg(SIZE, |area| over_seconds(area, summary))),
        ("gaussians", "Quality over Gaussians", svg(SIZE, |area| over_gaussians(area, summary))),
        ("frames", "Rendering over Gaussians", svg(SIZE, |area| frames(area, summary))),
        ("stages", "Where the time goes", breakdown(summary)),
    ]
}

/// Points with a PSNR.
fn shown(summary: &Summary) -> impl Iterator<Item = &Row> {
    summary.points.iter().filter(|row| row.failed.is_none() && row.psnr_held_out.is_finite())
}

fn front(summary: &Summary, on: fn(&Row) -> bool, cost: fn(&Row) -> f64) -> Vec<(f64, f64)> {
    let mut front: Vec<(f64, f64)> =
        shown(summary).filter(|row| on(row)).map(|row| (cost(row), row.psnr_held_out)).collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    front
}

/// The steps of a front: between two of its points nothing is better than the cheaper one.
fn steps(front: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut path = Vec::new();
    for pair in front.windows(2) {
        path.extend([pair[0], (pair[1].0, pair[0].1)]);
    }
    path.extend(front.last());
    path
}

fn over_seconds(area: &DrawingArea<SVGBackend<'_>, Shift>, summary: &Summary) -> Drawn {
    let seconds = |row: &Row| row.seconds_to_gaussians;
    // Beyond it the front alone goes on: refinement takes as long as one likes.
    let times = range(shown(summary).map(seconds), 0.06);
    let psnrs = range(shown(summary).map(|row| row.psnr_held_out), 0.08);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(52)
        .build_cartesian_2d(times.start.max(0.0)..times.end, psnrs)?;
    axes(&mut chart, "seconds from photographs to Gaussians", "PSNR of held-out views, dB")?;
    let front = front(summary, |row| row.on_front_of_seconds, seconds);
    line(&mut chart, "nothing is better and faster", &steps(&front), style(FRONT, 1), 0)?;
    let curves = summary.curves();
    for (i, (name, rows)) in curves.iter().enumerate() {
        let points: Vec<(f64, f64)> = rows.iter().map(|row| (seconds(row), row.psnr_held_out)).collect();
        line(&mut chart, name, &points, style(COLOURS[i % COLOURS.len()], if i == 0 { 3 } else { 1 }), 3)?;
    }
    let others = shown(summary).filter(|row| {
        !matches!(row.label.axis, Axis::Allocation | Axis::Renderer)
            && !curves.iter().any(|(_, rows)| rows.contains(row))
    });
    for row in others {
        let at = (seconds(row), row.psnr_held_out);
        marks(&mut chart, &[at], style(COLOURS[6], 1), 3)?;
        label(&mut chart, at, &row.label.point, COLOURS[6])?;
    }
    rings(&mut chart, &front)?;
    if let Some((_, rows)) = curves.first() {
        for row in rows {
            label(&mut chart, (seconds(row), row.psnr_held_out), &row.label.point, COLOURS[0])?;
        }
    }
    legend(&mut chart, SeriesLabelPosition::LowerRight)
}

/// A logarithmic range around the positive numbers.
fn logarithmic(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let around = range(values.filter(|value| *value > 0.0).map(f64::log10), 0.05);
    10f64.powf(around.start)..10f64.powf(around.end)
}

fn over_gaussians(area: &DrawingArea<SVGBackend<'_>, Shift>, summary: &Summary) -> Drawn {
    let count = |row: &Row| row.gaussians;
    let rows = || shown(summary).filter(|row| matches!(row.label.axis, Axis::Budget | Axis::Allocation));
    let mut chart =
        ChartBuilder::on(area).margin(12).x_label_area_size(40).y_label_area_size(52).build_cartesian_2d(
            logarithmic(rows().map(count)).log_scale(),
            range(rows().map(|row| row.psnr_held_out), 0.08),
        )?;
    axes(&mut chart, "Gaussians", "PSNR of held-out views, dB")?;
    for (i, (name, rows)) in summary.curves().iter().enumerate() {
        let points: Vec<(f64, f64)> = rows.iter().map(|row| (count(row), row.psnr_held_out)).collect();
        line(&mut chart, name, &points, style(COLOURS[i % COLOURS.len()], if i == 0 { 3 } else { 2 }), 3)?;
    }
    if let Some(aligned) = summary.pixel_aligned().filter(|row| row.psnr_held_out.is_finite()) {
        let (low, high) = (rows().map(count).fold(f64::INFINITY, f64::min), aligned.gaussians);
        let level = [(low, aligned.psnr_held_out), (high, aligned.psnr_held_out)];
        let dashes = DashedPathElement::new(level.into_iter(), 6, 5, style(COLOURS[6], 1));
        let key = style(COLOURS[6], 1);
        chart
            .draw_series(std::iter::once(dashes))?
            .label("pixel-aligned")
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], key));
        marks(&mut chart, &level[1..], style(COLOURS[6], 1), 5)?;
    }
    let front = front(
        summary,
        |row| row.on_front_of_gaussians && matches!(row.label.axis, Axis::Budget | Axis::Allocation),
        count,
    );
    rings(&mut chart, &front)?;
    legend(&mut chart, SeriesLabelPosition::LowerRight)
}

fn frames(area: &DrawingArea<SVGBackend<'_>, Shift>, summary: &Summary) -> Drawn {
    let rate = |row: &Row| row.frames_per_second;
    let rows = || shown(summary).filter(|row| matches!(row.label.axis, Axis::Budget | Axis::Allocation));
    let mut chart =
        ChartBuilder::on(area).margin(12).x_label_area_size(40).y_label_area_size(60).build_cartesian_2d(
            logarithmic(rows().map(|row| row.gaussians)).log_scale(),
            logarithmic(rows().map(rate)).log_scale(),
        )?;
    axes(&mut chart, "Gaussians", "frames per second")?;
    for (i, (name, rows)) in summary.curves().iter().enumerate() {
        let points: Vec<(f64, f64)> = rows.iter().map(|row| (row.gaussians, rate(row))).collect();
        line(&mut chart, name, &points, style(COLOURS[i % COLOURS.len()], 2), 3)?;
    }
    if let Some(aligned) = summary.pixel_aligned() {
        let at = [(aligned.gaussians, rate(aligned))];
        line(&mut chart, "pixel-aligned", &at, style(COLOURS[6], 1), 5)?;
    }
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

/// Rings around the points of a front.
fn rings<X, Y>(chart: &mut crate::chart::Chart<'_, '_, X, Y>, front: &[(f64, f64)]) -> Drawn
where
    X: plotters::coord::ranged1d::Ranged<ValueType = f64>,
    Y: plotters::coord::ranged1d::Ranged<ValueType = f64>,
{
    let ring = ShapeStyle { filled: false, ..style(FRONT, 1) };
    marks(chart, front, ring, 7)
}

/// A point's name above it.
fn label<X, Y>(
    chart: &mut crate::chart::Chart<'_, '_, X, Y>,
    at: (f64, f64),
    name: &str,
    colour: RGBColor,
) -> Drawn
where
    X: plotters::coord::ranged1d::Ranged<ValueType = f64>,
    Y: plotters::coord::ranged1d::Ranged<ValueType = f64>,
{
    let font = ("sans-serif", 12).into_font().color(&colour).pos(Pos::new(HPos::Left, VPos::Bottom));
    let text = EmptyElement::at(at) + Text::new(name.to_owned(), (6, -3), font);
    chart.draw_series(std::iter::once(text))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tradeoff::summary::tests::summary;

    #[test]
    fn every_plot_is_whole_and_names_its_curves() {
        for (name, title, svg) in tradeoff_plots(&summary(&[20.0, 22.0, 23.0], 22.5)) {
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{name} {title}");
            assert!(svg.contains("entropy") || svg.contains("knn"), "{name}");
            assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{name}");
        }
    }

    #[test]
    fn nothing_to_draw_is_an_empty_plot() {
        for psnrs in [&[][..], &[f64::NAN], &[20.0]] {
            assert!(
                tradeoff_plots(&summary(psnrs, f64::NAN)).iter().all(|(_, _, svg)| svg.contains("</svg>"))
            );
        }
    }

    #[test]
    fn a_front_has_steps() {
        assert_eq!(steps(&[(1.0, 5.0), (2.0, 7.0)]), [(1.0, 5.0), (2.0, 5.0), (2.0, 7.0)]);
        assert!(steps(&[]).is_empty());
    }
}

//! The plots of a sweep as SVG.

use super::breakdown::breakdown;
use super::front::pareto_front;
use super::summary::{Row, Summary};
use plotters::coord::ranged1d::Ranged;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use report_parts::chart::{
    Area, COLOURS, Chart, Counts, Drawn, NEUTRAL, Names, SIZE, Seconds, axes, beside, chart_on, legend, line,
    marks, range, style, svg,
};
use report_parts::labels::place;
use sparsesplat::Stage;

/// Colour of the front.
const FRONT: RGBColor = BLACK;

/// The plots, each with a name for files and a title: quality over time, the same without the
/// backbone, quality over Gaussians, frames per second over Gaussians, and
/// where the time goes.
#[must_use]
pub fn tradeoff_plots(summary: &Summary) -> Vec<(&'static str, &'static str, String)> {
    vec![
        ("seconds", "Quality over time", svg(SIZE, |area| over_seconds(area, summary))),
        (
            "after-backbone",
            "Quality over time after the backbone",
            svg(SIZE, |area| after_backbone(area, summary)),
        ),
        ("gaussians", "Quality over Gaussians", svg(SIZE, |area| over_gaussians(area, summary))),
        ("frames", "Rendering over Gaussians", svg(SIZE, |area| frames(area, summary))),
        ("stages", "Where the time goes", breakdown(summary)),
    ]
}

/// Points with a PSNR.
fn shown(summary: &Summary) -> impl Iterator<Item = &Row> {
    summary.points.iter().filter(|row| row.failed.is_none() && row.psnr_held_out.is_finite())
}

/// The front of quality over seconds, in order of the seconds.
fn front_of_seconds(summary: &Summary) -> Vec<(f64, f64)> {
    let on_front = shown(summary).filter(|row| row.on_front_of_seconds);
    let mut front: Vec<(f64, f64)> =
        on_front.map(|row| (row.seconds_to_gaussians, row.psnr_held_out)).collect();
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

fn over_seconds(area: &Area<'_>, summary: &Summary) -> Drawn {
    let seconds = |row: &Row| row.seconds_to_gaussians;
    let rivals = || shown(summary).filter(|row| row.label.axis.competes());
    let times = Seconds::around(rivals().map(seconds), f64::INFINITY);
    let (area, side) = beside(area);
    let qualities = range(rivals().map(|row| row.psnr_held_out), 0.08);
    let mut chart = chart_on(&area).build_cartesian_2d(times, qualities)?;
    let mut names = Names::new();
    axes(&mut chart, "seconds from photographs to Gaussians", PSNR)?;
    let front = front_of_seconds(summary);
    line(&mut chart, &mut names, "nothing is better and faster", &steps(&front), style(FRONT, 1), 0)?;
    curves(&mut chart, &mut names, summary, seconds)?;
    rings(&mut chart, &front)?;
    others(&mut chart, summary, seconds, &steps(&front))?;
    legend(&side, &names)
}

fn after_backbone(area: &Area<'_>, summary: &Summary) -> Drawn {
    let seconds =
        |row: &Row| row.seconds_to_gaussians - row.seconds.stages[Stage::Backbone] - row.seconds.load;
    let rivals = || shown(summary).filter(|row| row.label.axis.competes());
    let (area, side) = beside(area);
    let qualities = range(rivals().map(|row| row.psnr_held_out), 0.08);
    let times = Seconds::around(rivals().map(seconds), 0.0);
    let mut chart = chart_on(&area).build_cartesian_2d(times, qualities)?;
    let mut names = Names::new();
    axes(&mut chart, "seconds after loading and the backbone", PSNR)?;
    curves(&mut chart, &mut names, summary, seconds)?;
    others(&mut chart, summary, seconds, &[])?;
    legend(&side, &names)
}

const PSNR: &str = "PSNR of held-out views, dB";

/// A line per allocation, PSNR over a cost.
fn curves<X, Y>(
    chart: &mut Chart<'_, '_, X, Y>,
    names: &mut Names,
    summary: &Summary,
    cost: fn(&Row) -> f64,
) -> Drawn
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    for (i, (name, rows)) in summary.curves().iter().enumerate() {
        let points: Vec<(f64, f64)> = rows.iter().map(|row| (cost(row), row.psnr_held_out)).collect();
        line(chart, names, name, &points, style(COLOURS[i % COLOURS.len()], if i == 0 { 3 } else { 2 }), 3)?;
    }
    Ok(())
}

/// Rivals that are on no line, by name; names avoid the curves and `front`.
fn others<X, Y>(
    chart: &mut Chart<'_, '_, X, Y>,
    summary: &Summary,
    cost: fn(&Row) -> f64,
    front: &[(f64, f64)],
) -> Drawn
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    let curves = summary.curves();
    let is_other =
        |row: &&Row| row.label.axis.competes() && !curves.iter().any(|(_, rows)| rows.contains(row));
    let others: Vec<&Row> = shown(summary).filter(is_other).collect();
    let position = |row: &Row| (cost(row), row.psnr_held_out);
    let pixel = |row: &Row| chart.backend_coord(&position(row));
    let names: Vec<(&str, (i32, i32))> =
        others.iter().map(|row| (row.label.point.as_str(), pixel(row))).collect();
    let alone = others.iter().map(|row| vec![pixel(row)]);
    let lines = curves.iter().map(|(_, rows)| rows.iter().map(|row| pixel(row)).collect());
    let front = front.iter().map(|point| chart.backend_coord(point)).collect();
    let lines: Vec<Vec<(i32, i32)>> = alone.chain(lines).chain([front]).collect();
    let (columns, rows) = chart.plotting_area().get_pixel_range();
    let places = place(&names, &lines, [columns.start, rows.start, columns.end, rows.end]);
    for (row, place) in others.into_iter().zip(places) {
        marks(chart, &[position(row)], style(NEUTRAL, 1), 3)?;
        let font = ("sans-serif", 12).into_font().color(&NEUTRAL).pos(Pos::new(HPos::Left, VPos::Top));
        let text = EmptyElement::at(position(row)) + Text::new(row.label.point.clone(), place.corner, font);
        chart.draw_series(std::iter::once(text))?;
        if let Some(end) = place.leader {
            let leader = EmptyElement::at(position(row)) + PathElement::new([(0, 0), end], style(NEUTRAL, 1));
            chart.draw_series(std::iter::once(leader))?;
        }
    }
    Ok(())
}

fn over_gaussians(area: &Area<'_>, summary: &Summary) -> Drawn {
    let count = |row: &Row| row.gaussians;
    let rows = || shown(summary).filter(|row| row.label.is_of_counts());
    let (area, side) = beside(area);
    let qualities = range(rows().map(|row| row.psnr_held_out), 0.08);
    let mut chart = chart_on(&area).build_cartesian_2d(Counts::around(rows().map(count)), qualities)?;
    let mut names = Names::new();
    axes(&mut chart, "Gaussians", PSNR)?;
    curves(&mut chart, &mut names, summary, count)?;
    if let Some(aligned) = summary.pixel_aligned().filter(|row| row.psnr_held_out.is_finite()) {
        let (low, high) = (rows().map(count).fold(f64::INFINITY, f64::min), aligned.gaussians);
        let level = [(low, aligned.psnr_held_out), (high, aligned.psnr_held_out)];
        let dashes = DashedPathElement::new(level, 6, 5, style(NEUTRAL, 1));
        chart.draw_series(std::iter::once(dashes))?;
        names.push(("pixel-aligned".to_owned(), style(NEUTRAL, 1)));
        marks(&mut chart, &level[1..], style(NEUTRAL, 1), 5)?;
    }
    // Of what is drawn: refined points, which would beat most of it, are not.
    let drawn: Vec<(f64, f64)> = rows().map(|row| (count(row), row.psnr_held_out)).collect();
    let front: Vec<(f64, f64)> = pareto_front(&drawn).into_iter().map(|i| drawn[i]).collect();
    rings(&mut chart, &front)?;
    legend(&side, &names)
}

fn frames(area: &Area<'_>, summary: &Summary) -> Drawn {
    let rate = |row: &Row| row.frames_per_second;
    let rows = || shown(summary).filter(|row| row.label.is_of_counts());
    let (area, side) = beside(area);
    let counts = Counts::around(rows().map(|row| row.gaussians));
    let mut chart = chart_on(&area).build_cartesian_2d(counts, 0.0..range(rows().map(rate), 0.1).end)?;
    let mut names = Names::new();
    axes(&mut chart, "Gaussians", "frames per second")?;
    for (i, (name, rows)) in summary.curves().iter().enumerate() {
        let points: Vec<(f64, f64)> = rows.iter().map(|row| (row.gaussians, rate(row))).collect();
        line(&mut chart, &mut names, name, &points, style(COLOURS[i % COLOURS.len()], 2), 3)?;
    }
    if let Some(aligned) = summary.pixel_aligned() {
        let point = [(aligned.gaussians, rate(aligned))];
        line(&mut chart, &mut names, "pixel-aligned", &point, style(NEUTRAL, 1), 5)?;
    }
    legend(&side, &names)
}

/// Rings around the points of a front.
fn rings<X, Y>(chart: &mut Chart<'_, '_, X, Y>, front: &[(f64, f64)]) -> Drawn
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    let ring = ShapeStyle { filled: false, ..style(FRONT, 1) };
    marks(chart, front, ring, 7)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::summary;

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

//! Plots as SVG, with their text as text.

use crate::WindowRow;
use crate::figures::{CurvePoint, mean};
use plotters::prelude::*;
use std::error::Error;

/// Width and height, pixels.
pub(crate) const SIZE: (u32, u32) = (820, 460);
/// Colours that are told apart by people who do not see red and green (Okabe & Ito).
pub(crate) const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// Held-out PSNR over the seconds of refinement, a line per scene and one for their mean: at each measured
/// step the means over seeds and windows. Windows that stopped before the others are shown up to there.
#[must_use]
pub fn refinement_plot(windows: &[WindowRow]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for window in windows {
        if !names.contains(&window.scene()) {
            names.push(window.scene());
        }
    }
    let mut lines: Vec<(String, Vec<CurvePoint>)> = Vec::new();
    for name in names {
        let of_scene = windows.iter().filter(|window| window.scene() == name);
        let curves: Vec<&[CurvePoint]> = of_scene
            .flat_map(|window| &window.seeds)
            .filter_map(|run| run.refinement.as_ref())
            .map(|refinement| refinement.curve.as_slice())
            .collect();
        lines.push((name.to_owned(), mean_curve(&curves)));
    }
    let scenes = lines.len();
    if scenes > 1 {
        let curves: Vec<&[CurvePoint]> = lines.iter().map(|(_, curve)| curve.as_slice()).collect();
        lines.push(("mean".to_owned(), mean_curve(&curves)));
    }
    let mut svg = String::new();
    match draw(&mut svg, &lines, scenes) {
        Ok(()) => svg,
        // Writing into a string does not fail, and the coordinates are finite.
        Err(error) => unreachable!("a plot is drawn into memory: {error}"),
    }
}

/// Point by point mean of curves, as far as all of them go.
fn mean_curve(curves: &[&[CurvePoint]]) -> Vec<CurvePoint> {
    let length = curves.iter().map(|curve| curve.len()).min().unwrap_or(0);
    let at = |i: usize| {
        let of = |value: fn(&CurvePoint) -> f64| mean(curves.iter().map(|curve| value(&curve[i])));
        CurvePoint {
            step: curves[0][i].step,
            seconds: of(|p| p.seconds),
            psnr_context: of(|p| p.psnr_context),
            psnr_held_out: of(|p| p.psnr_held_out),
        }
    };
    (0..length).map(at).collect()
}

/// `scenes` of the lines are scenes, one more would be their mean.
fn draw(svg: &mut String, lines: &[(String, Vec<CurvePoint>)], scenes: usize) -> Result<(), Box<dyn Error>> {
    let points = || lines.iter().flat_map(|(_, curve)| curve).filter(|point| point.psnr_held_out.is_finite());
    let longest = points().map(|point| point.seconds).fold(0.0, f64::max).max(1e-3);
    let low = points().map(|point| point.psnr_held_out).fold(f64::INFINITY, f64::min);
    let high = points().map(|point| point.psnr_held_out).fold(f64::NEG_INFINITY, f64::max);
    let (low, high) = if low <= high { (low.floor(), high.ceil() + 0.5) } else { (0.0, 1.0) };

    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(48)
        // Room for the legend beside the lines.
        .build_cartesian_2d(0.0..longest * 1.18, low..high)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("seconds of refinement")
        .y_desc("PSNR of held-out views, dB")
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .draw()?;
    for (i, (name, curve)) in lines.iter().enumerate() {
        let is_mean = i >= scenes;
        let colour = if is_mean { BLACK } else { COLOURS[i % COLOURS.len()] };
        let style =
            ShapeStyle { color: colour.to_rgba(), filled: true, stroke_width: if is_mean { 3 } else { 2 } };
        let at = |point: &CurvePoint| (point.seconds, point.psnr_held_out);
        let shown = || curve.iter().filter(|point| point.psnr_held_out.is_finite());
        chart
            .draw_series(LineSeries::new(shown().map(at), style))?
            .label(name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        chart.draw_series(shown().map(|point| Circle::new(at(point), 2, style)))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 13))
        .draw()?;
    area.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Refinement;
    use crate::figures::tests::row;

    fn window(name: &str, psnrs: &[f64]) -> WindowRow {
        let point = |(i, &psnr_held_out): (usize, &f64)| CurvePoint {
            step: i,
            seconds: i as f64,
            psnr_context: 0.0,
            psnr_held_out,
        };
        let mut window = row(name, &[20.0]);
        let curve = psnrs.iter().enumerate().map(point).collect();
        window.seeds[0].refinement = Some(Refinement { report: refine::Report::default(), curve });
        window
    }

    #[test]
    fn every_scene_and_the_mean_have_a_line() {
        let svg = refinement_plot(&[window("fox/0", &[20.0, 22.0]), window("den/0", &[18.0, 18.5, 19.0])]);
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        for text in ["fox", "den", "mean", "seconds of refinement"] {
            assert!(svg.contains(text), "{text}");
        }
        // A mark per point: two of one scene, three of the other, two of the mean.
        assert_eq!(svg.matches("<circle").count(), 2 + 3 + 2);
    }

    #[test]
    fn curves_of_different_lengths_are_averaged_as_far_as_all_go() {
        let (a, b) = (window("a/0", &[20.0, 22.0, 23.0]), window("a/1", &[18.0, 20.0]));
        let curve = |w: &WindowRow| w.seeds[0].refinement.as_ref().unwrap().curve.clone();
        let mean = mean_curve(&[&curve(&a), &curve(&b)]);
        assert_eq!(mean.iter().map(|p| p.psnr_held_out).collect::<Vec<_>>(), [19.0, 21.0]);
    }

    #[test]
    fn nothing_to_draw_is_an_empty_plot() {
        for windows in [vec![], vec![row("a/0", &[20.0])], vec![window("a/0", &[f64::NAN])]] {
            assert!(refinement_plot(&windows).contains("</svg>"));
        }
    }
}

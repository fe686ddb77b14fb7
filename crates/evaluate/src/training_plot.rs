//! The curve of a training run as SVG.

use crate::plot::{COLOURS, SIZE};
use plotters::prelude::*;
use std::error::Error;

/// Steps that a point of the loss is the mean of: single steps see single windows.
const WINDOW: usize = 50;

/// Loss over steps (means of 50), and below it how far the head is above the closed form on held-out views: a line of
/// (step, dB) per name.
#[must_use]
pub fn training_plot(loss: &[(f64, f64)], gains: &[(String, Vec<(f64, f64)>)]) -> String {
    let mut svg = String::new();
    match draw(&mut svg, loss, gains) {
        Ok(()) => svg,
        // Writing into a string does not fail, and the coordinates are finite.
        Err(error) => unreachable!("a plot is drawn into memory: {error}"),
    }
}

/// Lowest and highest of some numbers, apart from each other.
fn range(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let margin = (0.08 * (high - low)).max(1e-6);
    low - margin..high + margin
}

fn draw(
    svg: &mut String,
    loss: &[(f64, f64)],
    gains: &[(String, Vec<(f64, f64)>)],
) -> Result<(), Box<dyn Error>> {
    let finite = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        points.iter().copied().filter(|(step, value)| step.is_finite() && value.is_finite()).collect()
    };
    let mean = |points: &[(f64, f64)]| {
        let n = points.len() as f64;
        (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n)
    };
    let loss: Vec<(f64, f64)> = finite(loss).chunks(WINDOW).map(mean).collect();
    let gains: Vec<(&str, Vec<(f64, f64)>)> =
        gains.iter().map(|(name, points)| (name.as_str(), finite(points))).collect();
    let steps = || loss.iter().chain(gains.iter().flat_map(|(_, points)| points)).map(|p| p.0);
    let last = steps().fold(1.0, f64::max);

    let area = SVGBackend::with_string(svg, (SIZE.0, 2 * SIZE.1)).into_drawing_area();
    area.fill(&WHITE)?;
    let halves = area.split_evenly((2, 1));
    let panel = |half: usize, values: std::ops::Range<f64>, title: &str| {
        let mut chart = ChartBuilder::on(&halves[half])
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..last * 1.02, values)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("steps")
            .y_desc(title)
            .label_style(("sans-serif", 14))
            .axis_desc_style(("sans-serif", 15))
            .draw()?;
        Ok::<_, Box<dyn Error>>(chart)
    };
    let style =
        |i: usize| ShapeStyle { color: COLOURS[i % COLOURS.len()].to_rgba(), filled: true, stroke_width: 2 };
    let mut upper = panel(0, range(loss.iter().map(|p| p.1)), "loss, means of 50 steps")?;
    upper.draw_series(LineSeries::new(loss.iter().copied(), style(0)))?;
    let values = gains.iter().flat_map(|(_, points)| points).map(|p| p.1).chain([0.0]);
    let mut lower = panel(1, range(values), "held-out PSNR above the closed form, dB")?;
    for (i, (name, points)) in gains.iter().enumerate() {
        let style = style(i);
        lower
            .draw_series(LineSeries::new(points.iter().copied(), style))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        lower.draw_series(points.iter().map(|&point| Circle::new(point, 3, style)))?;
    }
    lower
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

    #[test]
    fn there_is_a_line_per_density_and_a_mark_per_validation() {
        let loss: Vec<(f64, f64)> = (1..=120).map(|step| (f64::from(step), 1.0 / f64::from(step))).collect();
        let gains = [
            ("density 0.02".to_owned(), vec![(50.0, 0.4), (100.0, 0.8)]),
            ("density 0.1".to_owned(), vec![]),
        ];
        let svg = training_plot(&loss, &gains);
        assert!(svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("density 0.02") && svg.contains("density 0.1") && svg.contains("steps"));
        assert_eq!(svg.matches("<circle").count(), 2);
    }

    #[test]
    fn what_is_not_finite_or_not_there_is_not_drawn() {
        for loss in [vec![], vec![(1.0, f64::NAN)], vec![(1.0, 0.5)]] {
            assert!(training_plot(&loss, &[]).contains("</svg>"));
        }
    }
}

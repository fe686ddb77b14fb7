//! The curve of a training run as SVG.

use plotters::prelude::*;
use report_parts::chart::{
    Area, COLOURS, Drawn, Names, SIZE, axes, beside, chart_on, legend, line, range, style, svg,
};

/// Steps that a point of the loss is the mean of: single steps see single windows.
const WINDOW: usize = 50;

/// Loss over steps (means of 50), and below it how far the head is above the closed form on held-out views, or a corrector above the refined scenes: a line of
/// (step, dB) per name.
#[must_use]
pub fn training_plot(loss: &[(f64, f64)], gains: &[(String, Vec<(f64, f64)>)]) -> String {
    svg((SIZE.0, 2 * SIZE.1), |area| draw(area, loss, gains))
}

fn draw(area: &Area<'_>, loss: &[(f64, f64)], gains: &[(String, Vec<(f64, f64)>)]) -> Drawn {
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

    let halves: Vec<_> = area.split_evenly((2, 1)).iter().map(beside).collect();
    let panel = |half: usize, values: std::ops::Range<f64>, title: &str| {
        let mut chart = chart_on(&halves[half].0).build_cartesian_2d(0.0..last * 1.02, values)?;
        axes(&mut chart, "steps", title)?;
        Drawn::Ok(chart)
    };
    let mut upper = panel(0, range(loss.iter().map(|p| p.1), 0.08), "loss, means of 50 steps")?;
    upper.draw_series(LineSeries::new(loss.iter().copied(), style(COLOURS[0], 2)))?;
    let values = gains.iter().flat_map(|(_, points)| points).map(|p| p.1).chain([0.0]);
    let mut lower = panel(1, range(values, 0.08), "held-out PSNR above what it starts from, dB")?;
    let mut names = Names::new();
    for (i, (name, points)) in gains.iter().enumerate() {
        line(&mut lower, &mut names, name, points, style(COLOURS[i % COLOURS.len()], 2), 3)?;
    }
    legend(&halves[1].1, &names)
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

//! The plot of refinement as SVG, its text as text.

use evaluate::{CurvePoint, WindowRow, mean};
use plotters::prelude::*;
use report_parts::chart::{
    Area, COLOURS, Drawn, Names, SIZE, axes, beside, chart_on, legend, line, style, svg,
};

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
    svg(SIZE, |area| draw(area, &lines, scenes))
}

/// Mean of curves at the steps that all of them have.
fn mean_curve(curves: &[&[CurvePoint]]) -> Vec<CurvePoint> {
    let mean_point = |step: usize, corrected: bool| {
        let alike = |point: &&CurvePoint| (point.step, point.corrected) == (step, corrected);
        let points = curves.iter().map(|curve| curve.iter().find(alike));
        let points: Vec<&CurvePoint> = points.collect::<Option<_>>()?;
        let average = |value: fn(&CurvePoint) -> f64| mean(points.iter().map(|point| value(point)));
        Some(CurvePoint {
            step,
            corrected,
            seconds: average(|p| p.seconds),
            psnr_context: average(|p| p.psnr_context),
            psnr_held_out: average(|p| p.psnr_held_out),
        })
    };
    curves
        .first()
        .into_iter()
        .flat_map(|curve| curve.iter())
        .filter_map(|point| mean_point(point.step, point.corrected))
        .collect()
}

/// `scenes` of the lines are scenes, one more would be their mean.
fn draw(area: &Area<'_>, lines: &[(String, Vec<CurvePoint>)], scenes: usize) -> Drawn {
    let points = || lines.iter().flat_map(|(_, curve)| curve).filter(|point| point.psnr_held_out.is_finite());
    let longest = points().map(|point| point.seconds).fold(0.0, f64::max).max(1e-3);
    let low = points().map(|point| point.psnr_held_out).fold(f64::INFINITY, f64::min);
    let high = points().map(|point| point.psnr_held_out).fold(f64::NEG_INFINITY, f64::max);
    let (low, high) = if low <= high { (low.floor(), high.ceil() + 0.5) } else { (0.0, 1.0) };

    let (area, side) = beside(area);
    let mut chart = chart_on(&area).build_cartesian_2d(0.0..longest * 1.04, low..high)?;
    let mut names = Names::new();
    axes(&mut chart, "seconds of refinement", "PSNR of held-out views, dB")?;
    for (i, (name, curve)) in lines.iter().enumerate() {
        let is_mean = i >= scenes;
        let style = if is_mean { style(BLACK, 3) } else { style(COLOURS[i % COLOURS.len()], 2) };
        let shown = curve.iter().filter(|point| point.psnr_held_out.is_finite());
        let shown: Vec<(f64, f64)> = shown.map(|point| (point.seconds, point.psnr_held_out)).collect();
        line(&mut chart, &mut names, name, &shown, style, 2)?;
    }
    legend(&side, &names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::row;
    use evaluate::Refinement;

    fn window(name: &str, psnrs: &[f64]) -> WindowRow {
        let point = |(i, &psnr_held_out): (usize, &f64)| CurvePoint {
            step: i,
            seconds: i as f64,
            corrected: false,
            psnr_context: 0.0,
            psnr_held_out,
        };
        let mut window = row(name, &[20.0]);
        let curve = psnrs.iter().enumerate().map(point).collect();
        window.seeds[0].refinement = Some(Refinement {
            report: refine::Report::default(),
            corrected: None,
            curve,
            cameras: Vec::new(),
        });
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
        // A corrected scene has a point of its own beside that of its last step.
        let mut corrected = window("fox/0", &[20.0, 22.0, 23.0]);
        let curve = &mut corrected.seeds[0].refinement.as_mut().unwrap().curve;
        (curve[2].step, curve[2].corrected) = (curve[1].step, true);
        let found = mean_curve(&[curve, curve]);
        assert_eq!(found.iter().map(|p| p.psnr_held_out).collect::<Vec<_>>(), [20.0, 22.0, 23.0]);
        let curve = |w: &WindowRow| w.seeds[0].refinement.as_ref().unwrap().curve.clone();
        let mean = mean_curve(&[&curve(&a), &curve(&b)]);
        assert_eq!(mean.iter().map(|p| p.psnr_held_out).collect::<Vec<_>>(), [19.0, 21.0]);
        // One that ran out of time between two marks.
        let mut late = curve(&b);
        late[1].step = 2;
        let mean = mean_curve(&[&curve(&a), &late]);
        assert_eq!(
            mean.iter().map(|p| (p.step, p.psnr_held_out)).collect::<Vec<_>>(),
            [(0, 19.0), (2, 21.5)]
        );
    }

    #[test]
    fn nothing_to_draw_is_an_empty_plot() {
        for windows in [vec![], vec![row("a/0", &[20.0])], vec![window("a/0", &[f64::NAN])]] {
            assert!(refinement_plot(&windows).contains("</svg>"));
        }
    }
}

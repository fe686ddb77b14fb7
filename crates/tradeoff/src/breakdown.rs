//! Seconds by stage as stacked bars, one per point of the budget.

use super::summary::{Row, Summary};
use super::sweep::Axis;
use evaluate::Seconds;
use report_parts::chart::COLOURS;
use report_parts::colour;
use report_parts::page::escape;
use sparsesplat::Stage;
use std::fmt::Write;

/// A stage's time, seconds.
type Time = fn(&Seconds) -> f64;

/// Stages as the bars show them, the paper's names where it has them. After the looks come correction, refinement and writing.
const STAGES: [(&str, Time); 8] = [
    ("load", |s| s.load),
    ("backbone", |s| s.stages[Stage::Backbone]),
    ("exposure, shell, sampling", |s| {
        s.stages[Stage::Exposure] + s.stages[Stage::Shell] + s.stages[Stage::Sampling]
    }),
    ("back-projection", |s| s.stages[Stage::Backproject]),
    ("knn", |s| s.stages[Stage::Knn]),
    ("feedback", |s| s.stages[Stage::Feedback]),
    ("head, decoding", |s| s.stages[Stage::Head] + s.stages[Stage::Decode]),
    ("looks and after", |s| s.stages[Stage::Looks] + s.stages[Stage::Correction] + s.refine + s.write),
];

const NAME: f64 = 130.0;
const BAR: f64 = 680.0;
const ROW: usize = 30;
const TOP: usize = 46;

/// The bars as SVG.
pub(super) fn breakdown(summary: &Summary) -> String {
    let is_shown = |row: &&Row| row.failed.is_none() && row.label.axis == Axis::Budget;
    let rows: Vec<&Row> = summary.points.iter().filter(is_shown).collect();
    let longest = rows.iter().map(|row| row.seconds_to_gaussians).fold(f64::MIN_POSITIVE, f64::max);
    let height = TOP + ROW * rows.len().max(1) + 8;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 910 {height}\" width=\"910\" height=\"{height}\" role=\"img\" \
         aria-label=\"wall time by stage\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"910\" height=\"{height}\" fill=\"#ffffff\"/>\n"
    );
    let mut left = 12.0;
    for (i, (name, _)) in STAGES.iter().enumerate() {
        let _ = writeln!(
            svg,
            "<rect x=\"{left:.0}\" y=\"12\" width=\"12\" height=\"12\" fill=\"{}\"/><text x=\"{:.0}\" y=\"23\" fill=\"#1d1f24\">{name}</text>",
            colour(i),
            left + 17.0
        );
        left += 30.0 + 6.1 * name.len() as f64;
    }
    for (i, row) in rows.iter().enumerate() {
        let top = TOP + i * ROW;
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\" fill=\"#1d1f24\">{}</text>",
            NAME - 8.0,
            top + 15,
            escape(&row.label.point)
        );
        let mut left = NAME;
        for (stage, (name, value)) in STAGES.iter().enumerate() {
            let seconds = value(&row.seconds);
            let width = BAR * seconds / longest;
            let _ = writeln!(
                svg,
                "<rect x=\"{left:.2}\" y=\"{top}\" width=\"{width:.2}\" height=\"20\" fill=\"{}\"><title>{name} {seconds:.3} s</title></rect>",
                colour(stage)
            );
            left += width;
        }
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{}\" fill=\"#1d1f24\">{:.2} s</text>",
            left + 8.0,
            top + 15,
            row.seconds_to_gaussians
        );
    }
    svg.push_str("</svg>\n");
    svg
}

fn colour(stage: usize) -> String {
    let colour = COLOURS[stage % COLOURS.len()];
    colour::hex([colour.0, colour.1, colour.2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::summary;

    #[test]
    fn there_is_a_bar_of_all_stages_per_budget() {
        let svg = breakdown(&summary(&[20.0, 21.0], 22.0));
        assert_eq!(svg.matches("<title>knn").count(), 3);
        assert!(svg.contains("pixel-aligned"));
    }

    #[test]
    fn the_bars_leave_no_stage_out() {
        // Powers of two: a sum says which stages are in it.
        let mut seconds = Seconds { load: 1.0, refine: 2.0, write: 4.0, ..Seconds::default() };
        for (stage, power) in Stage::ALL.into_iter().zip(3..) {
            seconds.stages[stage] = 2_f64.powi(power);
        }
        let all: f64 = seconds.by_name().map(|(_, time)| time).sum();
        assert_eq!(STAGES.iter().map(|(_, time)| time(&seconds)).sum::<f64>(), all);
    }
}

//! Gaussians, memory and latency over the frames.

use super::measure::Row;
use report_parts::chart::{
    COLOURS, NEUTRAL, Names, SIZE, axes, beside, chart_on, legend, line, marks, range, style, svg,
};

/// The plot as SVG: above Gaussians and memory as shares of their limits, below seconds per frame.
pub(super) fn plot(rows: &[Row], cap: usize) -> String {
    let most_memory = rows.iter().filter_map(|row| row.rss_bytes).max().unwrap_or(1) as f64;
    let along = |value: &dyn Fn(&Row) -> Option<f64>| -> Vec<(f64, f64)> {
        rows.iter().filter_map(|row| Some((row.frame as f64, value(row)?))).collect()
    };
    let gaussians = along(&|row| Some(100.0 * row.gaussians as f64 / cap as f64));
    let memory = along(&|row| Some(100.0 * row.rss_bytes? as f64 / most_memory));
    let keyframes = along(&|row| row.is_keyframe.then_some(row.seconds));
    let others = along(&|row| (!row.is_keyframe).then_some(row.seconds));
    let frames = 0.0..rows.last().map_or(1.0, |row| row.frame as f64 + 1.0);
    svg((SIZE.0, 2 * SIZE.1), |area| {
        let (above, below) = area.split_vertically(SIZE.1);
        let (area, side) = beside(&above);
        let mut chart = chart_on(&area).build_cartesian_2d(frames.clone(), 0.0..105.0)?;
        let mut names = Names::new();
        axes(&mut chart, "frame", "percent")?;
        let name = format!("Gaussians, of {}", report_parts::count(cap as f64));
        line(&mut chart, &mut names, &name, &gaussians, style(COLOURS[0], 2), 0)?;
        let name = format!("memory, of {:.0} MB", most_memory / 1e6);
        line(&mut chart, &mut names, &name, &memory, style(COLOURS[1], 2), 0)?;
        legend(&side, &names)?;
        let (area, side) = beside(&below);
        let seconds = range(rows.iter().map(|row| row.seconds).chain([0.0]), 0.05);
        let mut chart = chart_on(&area).build_cartesian_2d(frames.clone(), 0.0..seconds.end)?;
        axes(&mut chart, "frame", "seconds")?;
        let mut names = Names::new();
        for (name, points, colour) in
            [("keyframes", &keyframes, COLOURS[2]), ("other frames", &others, NEUTRAL)]
        {
            marks(&mut chart, points, style(colour, 1), 2)?;
            names.push((name.to_owned(), style(colour, 2)));
        }
        legend(&side, &names)
    })
}

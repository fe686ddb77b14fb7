//! A row of figures for tests: PSNR by seed, and nothing else.

use evaluate::{Figures, WindowFigures, WindowRow};
use scene_windows::Window;
use sparsesplat::Counts;

pub(crate) fn row(name: &str, psnrs: &[f64]) -> WindowRow {
    let run = |(seed, &psnr_held_out): (usize, &f64)| WindowFigures {
        seed: seed as u64,
        figures: Figures { psnr_held_out, ..Figures::mean(&[]) },
        counts: Counts { total: 0, per_view: vec![], shell: 0 },
        tau: None,
        depth_range: (1.0, 2.0),
        exposure: vec![],
        corrected_by: None,
        refinement: None,
        per_target: vec![],
    };
    let window = Window {
        name: name.to_owned(),
        context: Vec::new(),
        targets: Vec::new(),
        context_positions: vec![0, 2],
        target_positions: vec![1],
        load_seconds: 0.0,
    };
    WindowRow::new(&window, psnrs.iter().enumerate().map(run).collect())
}

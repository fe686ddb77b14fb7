//! The table of an evaluation.

use evaluate::{Figures, MeanRow, Spread, WindowRow};
use report_parts::{Table, count, decibel, lpips_column, number};

/// The table of an evaluation: a row per window if `with_windows`, a row per scene, the mean. The column of LPIPS names
/// its network, or that there were no weights for one.
#[must_use]
pub fn figures_table(
    windows: &[WindowRow],
    scenes: &[MeanRow],
    mean: &MeanRow,
    lpips_network: Option<&str>,
    with_windows: bool,
) -> Table {
    // Results with and without refinement never share a column.
    let refined = windows.iter().any(|window| window.seeds.iter().any(|run| run.refinement.is_some()));
    let quality: &[&str] =
        if refined { &["PSNR before refinement", "SSIM", "refined PSNR", "SSIM"] } else { &["PSNR", "SSIM"] };
    let lpips = lpips_column(lpips_network);
    let head = [
        &["scene", "Gaussians", "shell"],
        quality,
        &[lpips.as_str(), "PSNR all", "nearest view", "gain", "seconds"],
    ];
    let mut table = Table::new(&head.concat(), 1);
    for scene in scenes {
        if with_windows {
            for window in windows.iter().filter(|window| window.scene() == scene.name) {
                table.push(cells(&window.name, &window.figures, window.spread, refined));
            }
        }
        let name = match (with_windows, scene.members) {
            (false, _) => scene.name.clone(),
            (true, 1) => continue,
            (true, members) => format!("{} (mean of {members})", scene.name),
        };
        table.push(cells(&name, &scene.figures, scene.spread, refined));
    }
    if scenes.len() > 1 {
        let name = format!("mean of {} scenes", mean.members);
        table.push(cells(&name, &mean.figures, mean.spread, refined));
    }
    table
}

fn cells(name: &str, figures: &Figures, spread: Option<Spread>, refined: bool) -> Vec<String> {
    let with =
        |text: String, spread: Option<f64>, digits: usize| match spread.filter(|spread| spread.is_finite()) {
            Some(spread) => format!("{text} ±{spread:.digits$}"),
            None => text,
        };
    let mut cells = vec![name.to_owned(), count(figures.gaussians), count(figures.gaussians_shell)];
    if refined {
        cells.push(decibel(figures.psnr_held_out_feed_forward));
        cells.push(number(figures.ssim_held_out_feed_forward, 3));
    }
    cells.extend([
        with(decibel(figures.psnr_held_out), spread.map(|s| s.psnr_held_out), 2),
        with(number(figures.ssim_held_out, 3), spread.map(|s| s.ssim_held_out), 3),
        number(figures.lpips_held_out.unwrap_or(f64::NAN), 3),
        decibel(figures.psnr_all),
        decibel(figures.psnr_nearest_view),
        signed(figures.psnr_held_out - figures.psnr_nearest_view),
        number(figures.seconds.total, 2),
    ]);
    cells
}

fn signed(value: f64) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{value:+.2}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::row;
    use evaluate::means;

    #[test]
    fn windows_scenes_and_mean_have_rows() {
        let windows = [row("a/0", &[10.0, 11.0]), row("a/1", &[20.0, 20.0]), row("b/0", &[f64::NAN, 3.0])];
        let (scenes, mean) = means(&windows);
        let names = |with_windows| -> Vec<String> {
            let table = figures_table(&windows, &scenes, &mean, None, with_windows);
            table.rows().iter().map(|row| row[0].clone()).collect()
        };
        assert_eq!(names(true), ["a/0", "a/1", "a (mean of 2)", "b/0", "mean of 2 scenes"]);
        assert_eq!(names(false), ["a", "b", "mean of 2 scenes"]);
        let table = figures_table(&windows, &scenes, &mean, None, true);
        assert_eq!(table.rows()[0][3], "10.50 ±0.71");
        assert_eq!(table.rows()[3][3], "-");
    }
}

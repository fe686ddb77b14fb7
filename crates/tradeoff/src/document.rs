//! A sweep in words, as tables, as CSV and as Markdown.

use super::front::Knee;
use super::measure::Views;
use super::paper::{Comparison, PaperTable};
use super::share::Reached;
use super::summary::{Row, Share, Summary};
use evaluate::Seconds;
use report_parts::{Table, count, decibel, lpips_column, number};
use scene_windows::Dropped;
use sparsesplat::Stage;
use std::fmt::Write;

/// What was found, in sentences.
#[must_use]
pub fn statements(summary: &Summary) -> Vec<String> {
    let mut said = Vec::new();
    if let Some(knee) = &summary.knee_of_seconds {
        said.push(format!(
            "{} and saves {} s ({}).",
            costs(knee),
            number(knee.saved, 2),
            percent(knee.share)
        ));
    }
    if let Some(knee) = &summary.knee_of_gaussians {
        let saved = count(knee.saved);
        said.push(format!("{} and saves {saved} Gaussians ({}).", costs(knee), percent(knee.share)));
    }
    said.extend(too_many(summary));
    for Share { curve, aligned, reached, share, paper } in &summary.shares {
        let goal = format!("the pixel-aligned PSNR ({} dB)", decibel(*aligned));
        let paper = paper.map_or(String::new(), |paper| format!("; the paper says {}", percent(paper)));
        said.push(match (reached, share) {
            (Reached::At { gaussians }, Some(fraction)) => {
                let n = count(*gaussians);
                format!("{curve} reaches {goal} at {n} Gaussians, {} of its count{paper}.", percent(*fraction))
            }
            (Reached::AtOnce { gaussians }, Some(fraction)) => format!(
                "{curve} has {goal} already at {} Gaussians, the fewest that were measured: {} of its count or less{paper}.",
                count(*gaussians),
                percent(*fraction)
            ),
            _ => format!("{curve} does not reach {goal} at any count that was measured{paper}."),
        });
    }
    said
}

/// Where the base's curve is best, if one Gaussian per pixel is clearly worse: a share that is small because of that is no merit of few.
fn too_many(summary: &Summary) -> Option<String> {
    const CLEARLY: f64 = 0.05;
    let aligned = summary.pixel_aligned()?;
    let (curve, rows) = summary.curves().into_iter().next()?;
    let best = rows.into_iter().max_by(|a, b| a.psnr_held_out.total_cmp(&b.psnr_held_out))?;
    let above = best.psnr_held_out - aligned.psnr_held_out;
    (above > CLEARLY).then(|| {
        format!(
            "{curve} is best at {} Gaussians, {} dB above one per pixel; more Gaussians than that cost quality here.",
            count(best.gaussians),
            decibel(above)
        )
    })
}

fn costs(knee: &Knee) -> String {
    format!(
        "Along the counts, returns diminish most after {}: it is {} dB below the best count ({})",
        knee.point,
        decibel(knee.decibels),
        knee.best
    )
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn with_spread(value: f64, digits: usize, spread: Option<f64>) -> String {
    match spread {
        Some(spread) => format!("{} ±{spread:.digits$}", number(value, digits)),
        None => number(value, digits),
    }
}

/// How the shares are to be read.
pub(super) const SHARES: &str = "\
Between measured counts PSNR is interpolated linearly over the logarithm of the count. Each curve is compared with one Gaussian per \
pixel by the same head. Merged Gaussians and those of the closed form are not corrected. The paper's 22 % are 150k of 688k Gaussians (24.20 against 24.17 dB on DL3DV). They compare two networks: \
DepthSplat, trained for one Gaussian per pixel, and a head trained with entropy sampling. Here both ends of a curve have the same \
backbone and the same head. A learned head that was trained on few pixels is not at its best with one anchor per pixel; the closed \
form was trained for neither. If random pixels also reach the pixel-aligned PSNR, the share tells how redundant one Gaussian per \
pixel is. The gain from choosing pixels is the distance between the curves at equal count.";

/// A row per point: what it costs and what it gives.
#[must_use]
pub fn points_table(summary: &Summary) -> Table {
    let lpips = lpips_column(summary.lpips_network.as_deref());
    let head = [
        "point",
        "axis",
        "Gaussians",
        "PSNR",
        "SSIM",
        &lpips,
        "seconds",
        "backbone",
        "knn",
        "feedback",
        "head",
        "frames/s",
        "memory MB",
        "PLY MB",
        "front",
    ];
    let mut table = Table::new(&head, 2);
    for row in &summary.points {
        let mut cells = vec![row.label.point.clone(), row.label.axis.name().to_owned()];
        if row.failed.is_some() {
            cells.extend(head[2..].iter().map(|_| "-".to_owned()));
            let last = cells.len() - 1;
            "failed".clone_into(&mut cells[last]);
            table.push(cells);
            continue;
        }
        let megabytes = |bytes: f64| number(bytes / 1e6, if bytes < 1e7 { 1 } else { 0 });
        cells.extend([
            count(row.gaussians),
            with_spread(row.psnr_held_out, 2, row.spread.map(|spread| spread.psnr_held_out)),
            with_spread(row.ssim_held_out, 3, row.spread.map(|spread| spread.ssim_held_out)),
            number(row.lpips_held_out.unwrap_or(f64::NAN), 3),
            number(row.seconds_to_gaussians, 2),
            number(row.seconds.stages[Stage::Backbone], 2),
            number(row.seconds.stages[Stage::Knn], 3),
            number(row.seconds.stages[Stage::Feedback], 3),
            number(row.seconds.stages[Stage::Head], 3),
            number(row.frames_per_second, 1),
            row.peak_rss_bytes.map_or_else(|| "-".to_owned(), |bytes| megabytes(bytes as f64)),
            megabytes(row.ply_bytes),
            front(row).to_owned(),
        ]);
        table.push(cells);
    }
    table
}

/// Which fronts a point is on.
fn front(row: &Row) -> &'static str {
    match (row.on_front_of_seconds, row.on_front_of_gaussians) {
        (true, true) => "time, count",
        (true, false) => "time",
        (false, true) => "count",
        (false, false) => "",
    }
}

/// What each allocation needs for the pixel-aligned PSNR.
#[must_use]
pub fn share_table(summary: &Summary) -> Table {
    let mut table = Table::new(&["curve", "Gaussians", "share of pixel-aligned", "paper"], 1);
    for share in &summary.shares {
        let (n, fraction) = match (share.reached, share.share) {
            (Reached::At { gaussians }, Some(fraction)) => (count(gaussians), percent(fraction)),
            (Reached::AtOnce { gaussians }, Some(fraction)) => {
                (format!("{} or less", count(gaussians)), format!("{} or less", percent(fraction)))
            }
            _ => ("not reached".to_owned(), "not reached".to_owned()),
        };
        let paper = share.paper.map_or_else(|| "-".to_owned(), percent);
        table.push(vec![share.curve.clone(), n, fraction, paper]);
    }
    table
}

/// One line per point, every figure with all its digits; what is not known is empty.
#[must_use]
pub fn csv(summary: &Summary) -> String {
    let mut text = String::from(
        "point,axis,allocation,base,gaussians,psnr_held_out,psnr_spread,ssim_held_out,ssim_spread,lpips_held_out,seconds_to_gaussians",
    );
    let stages = |row: &Row| row.seconds.by_name();
    let names = Seconds::default().by_name().map(|(name, _)| name);
    for name in names {
        let _ = write!(text, ",seconds_{name}");
    }
    text.push_str(
        ",frames_per_second,ply_bytes,peak_rss_bytes,on_front_of_seconds,on_front_of_gaussians,failed\n",
    );
    let figure = |value: f64| if value.is_finite() { value.to_string() } else { String::new() };
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\"").replace(['\n', '\r'], " "));
    for row in &summary.points {
        let mut cells = vec![
            quoted(&row.label.point),
            row.label.axis.name().to_owned(),
            quoted(&row.label.allocation),
            row.label.base.to_string(),
            figure(row.gaussians),
            figure(row.psnr_held_out),
            row.spread.map_or(String::new(), |spread| figure(spread.psnr_held_out)),
            figure(row.ssim_held_out),
            row.spread.map_or(String::new(), |spread| figure(spread.ssim_held_out)),
            row.lpips_held_out.map_or(String::new(), figure),
            figure(row.seconds_to_gaussians),
        ];
        cells.extend(stages(row).map(|(_, seconds)| figure(seconds)));
        cells.extend([
            figure(row.frames_per_second),
            figure(row.ply_bytes),
            row.peak_rss_bytes.map_or(String::new(), |bytes| bytes.to_string()),
            row.on_front_of_seconds.to_string(),
            row.on_front_of_gaussians.to_string(),
            row.failed.as_deref().map_or(String::new(), quoted),
        ]);
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    text
}

/// What a table has to say of its figures: views, size, seeds, what was dropped and why, and of which data.
#[must_use]
pub fn stated(summary: &Summary) -> Vec<String> {
    let list = |indices: &[usize]| indices.iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
    let window = |(name, views): (&String, &Views)| {
        let Views { context, targets, size: (width, height), .. } = views;
        format!("{name} ({width}x{height}; context {}; held out {})", list(context), list(targets))
    };
    let windows: Vec<String> = summary.windows.iter().zip(&summary.views).map(window).collect();
    let dropped = |dropped: &Dropped| format!("{}: {}", dropped.name, dropped.reason.replace('\n', " "));
    let dropped: Vec<String> = summary.dropped.iter().map(dropped).collect();
    vec![
        format!("All figures are for the held-out views. Windows: {}.", windows.join("; ")),
        format!("Seeds of the sampling: {}.", seeds_in_words(summary)),
        match dropped.as_slice() {
            [] => "Nothing was dropped.".to_owned(),
            dropped => format!("Dropped, and in no mean: {}.", dropped.join("; ")),
        },
        format!("Data: sha256 {}.", summary.data_sha256),
    ]
}

/// A table of the paper as Markdown, with what there is to say of its figures.
#[must_use]
pub fn comparison_markdown(comparison: &Comparison, summary: &Summary) -> String {
    let mut text = format!("{}\n", comparison.to_table().to_markdown());
    for note in comparison.notes.iter().chain(&stated(summary)) {
        let _ = writeln!(text, "{note}");
    }
    text
}

fn seeds_in_words(summary: &Summary) -> String {
    summary.seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ")
}

/// The whole sweep as Markdown. `machine` says on what, `command` how; `plots` are `(title, path)` of pictures beside the document.
#[must_use]
pub fn to_markdown(summary: &Summary, machine: &str, command: &str, plots: &[(&str, String)]) -> String {
    let mut text = String::from("# What accuracy costs in time\n\n");
    let scenes = windows_in_words(summary);
    let _ = writeln!(
        text,
        "One method is varied along one axis at a time, on {scenes}. This command wrote the page:\n\n```sh\n{command}\n```\n"
    );
    let _ = writeln!(text, "Machine: {machine}.\n\n{} {}\n", summary.protocol, summary.measured_as);
    let _ = writeln!(text, "{}\n", stated(summary).join(" "));
    text.push_str("## In short\n\n");
    for said in statements(summary) {
        let _ = writeln!(text, "- {said}");
    }
    for (title, path) in plots {
        let _ = writeln!(text, "\n## {title}\n\n![{title}]({path})");
    }
    let _ = writeln!(
        text,
        "\nRinged points are on the Pareto front: no other point has more quality at the same cost or less. The name of a point says what \
         differs from the base, which is {}. Points with measured depth, and points that differ only in rendering, are left out of the front. \
         *Looks and after* are looks, correction, refinement and writing.\n",
        summary.points.iter().find(|row| row.label.base).map_or("none", |row| &row.label.point)
    );
    if !summary.shares.is_empty() {
        let _ = writeln!(
            text,
            "## How many Gaussians for the quality of one per pixel\n\n{}\n{SHARES}\n",
            share_table(summary).to_markdown()
        );
    }
    let comparisons = PaperTable::ALL.map(|table| Comparison::new(table, summary));
    let shown: Vec<&Comparison> = comparisons.iter().filter(|comparison| comparison.has_ours()).collect();
    if !shown.is_empty() {
        text.push_str("## The paper's tables with our figures beside them\n\n");
        for comparison in shown {
            let table = comparison.to_table().to_markdown();
            let _ = writeln!(text, "### {}\n\n{table}", comparison.table.title());
            let _ = writeln!(text, "{}\n", comparison.notes.join(" "));
        }
    }
    let _ = write!(text, "## Every point\n\n{}", points_table(summary).to_markdown());
    text
}

/// How many windows, of which scenes, with which seeds.
#[must_use]
pub(super) fn windows_in_words(summary: &Summary) -> String {
    let plural = |n: usize, what: &str| if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") };
    format!(
        "{} ({}), {} {}",
        plural(summary.windows.len(), "window"),
        summary.windows.join(", "),
        if summary.seeds.len() == 1 { "seed" } else { "seeds" },
        seeds_in_words(summary)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::summary;

    #[test]
    fn knees_and_shares_are_said_in_words() {
        let summary = summary(&[20.0, 22.8, 23.0], 22.9);
        let said = statements(&summary).join("\n");
        assert!(
            said.contains("most after entropy-10k: it is 0.20 dB below the best count (entropy-100k)"),
            "{said}"
        );
        assert!(said.contains("saves 90 000 Gaussians (90.0 %)"), "{said}");
        assert!(
            said.contains("entropy reaches the pixel-aligned PSNR (22.90 dB) at 31 623 Gaussians"),
            "{said}"
        );
        assert!(said.contains("the paper says 22.0 %"), "{said}");
        assert!(said.contains("entropy is best at 100 000 Gaussians, 0.10 dB above one per pixel"), "{said}");
    }

    #[test]
    fn a_share_that_is_not_reached_is_said_so() {
        let summary = summary(&[20.0, 21.0], 25.0);
        let said = statements(&summary).join("\n");
        assert!(said.contains("does not reach") && !said.contains("is best at"), "{said}");
        assert_eq!(share_table(&summary).rows()[0][1..3], ["not reached", "not reached"]);
        let easy = crate::summary::tests::summary(&[20.0, 21.0], 19.0);
        assert!(statements(&easy).join("\n").contains("1 000 Gaussians, the fewest"));
    }

    #[test]
    fn documents_have_a_row_per_point_and_name_what_failed() {
        let mut summary = summary(&[20.0, 21.0], 22.0);
        summary.points[0].failed = Some("a \"reason\",\nwith a break".to_owned());
        summary.dropped.push(Dropped { name: "gone/0".into(), reason: "no file".into(), failed: true });
        let text = csv(&summary);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 1 + summary.points.len());
        assert!(lines[1].ends_with("\"a \"\"reason\"\", with a break\""), "{}", lines[1]);
        assert!(lines[2..].iter().all(|line| line.split(',').count() == lines[0].split(',').count()));
        let plots = [("Quality over time", "x-seconds.svg".to_owned())];
        let markdown = to_markdown(&summary, "a machine", "cargo xtask tradeoff", &plots);
        for part in [
            "a machine",
            "cargo xtask tradeoff",
            "![Quality over time](x-seconds.svg)",
            "gone/0: no file",
            "held out 1)",
            "DepthSplat",
        ] {
            assert!(markdown.contains(part), "{part}");
        }
        assert_eq!(points_table(&summary).rows()[0].last().unwrap(), "failed");
    }
}

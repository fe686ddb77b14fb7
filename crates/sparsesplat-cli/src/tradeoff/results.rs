//! What a sweep hands out: table, sentences, files, exit code.

use super::Files;
use crate::arguments::Common;
use crate::failure::{OrFail, Outcome};
use crate::output::{self, named};
use crate::summary::{print, print_line};
use crate::sweep::Swept;
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use tradeoff::{Summary, csv, points_table, statements, to_markdown, tradeoff_page, tradeoff_plots};

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: &'a Value,
    #[serde(flatten)]
    summary: &'a Summary,
}

/// Prints and writes what is asked for; a failure of some part of the sweep is the command's.
pub(super) fn deliver(swept: &Swept, files: &Files, common: &Common) -> Outcome {
    let Swept { header, summary, pictures, .. } = swept;
    print(&points_table(summary).to_text());
    for said in statements(summary) {
        print_line(&said);
    }
    print_line(&format!("measured   on {}", swept.machine()));
    if let Some(path) = &common.json {
        output::write_json(path, &Record { recipe: &header.recipe, summary })?;
    }
    if let Some(path) = &files.csv {
        output::write_text(path, &csv(summary))?;
        print_line(&format!("table      {}", named(path)));
    }
    if let Some(path) = &files.markdown {
        let plots = write_plots(summary, path)?;
        output::write_text(path, &to_markdown(summary, &swept.machine(), &swept.command(), &plots))?;
        print_line(&format!("document   {}", named(path)));
    }
    if let Some(path) = &files.report {
        let recipe = output::to_json(&header.recipe)?;
        let page = tradeoff_page(summary, &swept.machine(), &header.windows, pictures, &recipe).or_work()?;
        output::write_text(path, &page)?;
        print_line(&format!("report     {}", named(path)));
    }
    swept.verdict()
}

/// Writes the plots beside a document; their titles, and their paths as seen from there.
fn write_plots(summary: &Summary, document: &Path) -> Outcome<Vec<(&'static str, String)>> {
    let stem = document.file_stem().unwrap_or_default().to_string_lossy();
    let mut written = Vec::new();
    for (name, title, svg) in tradeoff_plots(summary) {
        let file = format!("{stem}-{name}.svg");
        output::write_text(&document.with_file_name(&file), &svg)?;
        written.push((title, file));
    }
    Ok(written)
}

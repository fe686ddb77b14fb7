//! What a sweep hands out: table, sentences, files, exit code.

use super::Files;
use crate::arguments::Common;
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::summary::{print, print_line};
use evaluate::tradeoff::{
    Header, Pictures, Summary, csv, points_table, statements, to_markdown, tradeoff_page, tradeoff_plots,
};
use serde::Serialize;
use serde_json::Value;
use std::path::Path;

/// A sweep that is done.
pub(super) struct Results<'a> {
    pub(super) header: &'a Header,
    pub(super) summary: &'a Summary,
    pub(super) pictures: &'a Pictures,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: &'a Value,
    #[serde(flatten)]
    summary: &'a Summary,
}

impl Results<'_> {
    /// Prints and writes what is asked for; a failure of some part of the sweep is the command's.
    pub(super) fn deliver(&self, files: &Files, common: &Common) -> Outcome {
        let Self { header, summary, pictures } = *self;
        print(&points_table(summary).to_text());
        for said in statements(summary) {
            print_line(&said);
        }
        print_line(&format!("measured   on {}", self.machine()));
        if let Some(path) = &common.json {
            output::write_json(path, &Record { recipe: &header.recipe, summary })?;
        }
        if let Some(path) = &files.csv {
            output::write_text(path, &csv(summary))?;
            print_line(&format!("table      {}", path.display()));
        }
        if let Some(path) = &files.markdown {
            let plots = self.write_plots(path)?;
            output::write_text(path, &to_markdown(summary, &self.machine(), &self.command(), &plots))?;
            print_line(&format!("document   {}", path.display()));
        }
        if let Some(path) = &files.report {
            let recipe = output::to_json(&header.recipe)?;
            let page =
                tradeoff_page(summary, &self.machine(), &header.windows, pictures, &recipe).or_work()?;
            output::write_text(path, &page)?;
            print_line(&format!("report     {}", path.display()));
        }
        match summary.failures() {
            0 => Ok(()),
            n => Err(Failure::work(format!(
                "{n} windows, scenes or points have no figures: they are named with the reason"
            ))),
        }
    }

    /// Writes the plots beside a document; their titles, and their paths as seen from there.
    fn write_plots(&self, document: &Path) -> Outcome<Vec<(&'static str, String)>> {
        let stem = document.file_stem().unwrap_or_default().to_string_lossy();
        let mut written = Vec::new();
        for (name, title, svg) in tradeoff_plots(self.summary) {
            let file = format!("{stem}-{name}.svg");
            output::write_text(&document.with_file_name(&file), &svg)?;
            written.push((title, file));
        }
        Ok(written)
    }

    /// On what it was measured, in words.
    fn machine(&self) -> String {
        let recipe = &self.header.recipe;
        let text = |value: &Value| value.as_str().map_or_else(|| "unknown".to_owned(), str::to_owned);
        let machine = &recipe["machine"];
        let device = &recipe["config"]["device"];
        let rendered = match device["kind"].as_str() {
            Some("cpu") | None => "the CPU".to_owned(),
            Some(kind) => format!("{} ({kind}, {})", text(&device["name"]), text(&device["driver"])),
        };
        format!(
            "{}, {} threads, {}, {}; rendered on {rendered}; {} build",
            text(&machine["cpu"]),
            recipe["threads"],
            text(&machine["os"]),
            text(&machine["arch"]),
            text(&recipe["config"]["build"])
        )
    }

    /// The command as somebody else would type it.
    fn command(&self) -> String {
        let arguments = self.header.recipe["command"].as_array().map_or(&[][..], Vec::as_slice);
        let words = arguments.iter().skip(1).filter_map(Value::as_str);
        format!("cargo xtask {}", words.collect::<Vec<_>>().join(" "))
    }
}

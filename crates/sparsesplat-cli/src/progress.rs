//! Progress on standard error, where it is a terminal.

use crate::summary::{tell, warn};
use evaluate::Step;
use indicatif::{ProgressBar, ProgressStyle};
use sparsesplat::Stage;
use std::io::IsTerminal;
use std::time::Duration;

/// A line that says what is being done; nothing at all where standard error is not a terminal.
pub(crate) struct Progress(ProgressBar);

impl Progress {
    /// A line for `steps` steps; with one step only what is being done is shown.
    pub(crate) fn new(steps: usize) -> Self {
        if !std::io::stderr().is_terminal() {
            return Self(ProgressBar::hidden());
        }
        let bar = ProgressBar::new(steps as u64);
        let template = if steps > 1 {
            "{spinner} [{elapsed_precise}] {wide_bar} {pos}/{len} {eta_precise} {msg}"
        } else {
            "{spinner} [{elapsed_precise}] {msg}"
        };
        // A template that does not parse would be a slip in the line above; the default bar does as well.
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.enable_steady_tick(Duration::from_millis(120));
        Self(bar)
    }

    /// What is being done now.
    pub(crate) fn say(&self, what: impl Into<String>) {
        self.0.set_message(what.into());
    }

    /// Something that must not be overlooked, on a line of its own; said without a terminal, too.
    pub(crate) fn warn(&self, what: &str) {
        self.0.suspend(|| warn(what));
    }

    /// What a user should know of a scene's data: what they list and is not used, and in which frame the result is.
    pub(crate) fn warn_of_data(&self, scene: &str, plan: &scene_windows::Plan) {
        if let Some([x, y, z]) = plan.offset() {
            self.warn(&format!(
                "{scene}: lies far from the origin, where the 32-bit numbers of a PLY file are too coarse: ({x}, {y}, {z}) was subtracted \
                 from all positions; add it to those of the scene to bring them back into the world of the data"
            ));
        }
        self.warn_of_ledger(scene, plan.ledger());
    }

    /// What a data set lists and does not use: the first few, and how many more.
    pub(crate) fn warn_of_ledger(&self, scene: &str, ledger: &[view_data::Dropped]) {
        const SHOWN: usize = 5;
        for entry in ledger.iter().take(SHOWN) {
            self.warn(&format!("{scene}: not used: {}: {}", entry.key, entry.reason));
        }
        if ledger.len() > SHOWN {
            self.warn(&format!("{scene}: not used: {} more; check-data lists them", ledger.len() - SHOWN));
        }
    }

    /// A line of its own that stays.
    pub(crate) fn line(&self, what: &str) {
        self.0.suspend(|| tell(&format!("{what}\n")));
    }

    /// So many steps were done before.
    pub(crate) fn set(&self, done: usize) {
        self.0.set_position(done as u64);
        self.0.reset_eta();
    }

    /// One step is done.
    pub(crate) fn step(&self) {
        self.0.inc(1);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// What a step does, for people.
pub(crate) fn describe(step: Step) -> String {
    let what = match step {
        Step::Load => "reading photographs",
        Step::Predict(Stage::Backbone) => "estimating depth",
        Step::Predict(Stage::Exposure) => "levelling exposure",
        Step::Predict(Stage::Sampling) => "choosing pixels",
        Step::Predict(Stage::Backproject) => "placing anchors",
        Step::Predict(Stage::Knn) => "finding neighbours",
        Step::Predict(Stage::Feedback | Stage::Looks) => "comparing with the photographs",
        Step::Predict(Stage::Head | Stage::Decode | Stage::Shell) => "making Gaussians",
        Step::Predict(Stage::Correction) => "correcting Gaussians",
        Step::Refine { progress, psnr_context } => {
            const WIDTH: usize = 20;
            let done = (progress * WIDTH as f64) as usize;
            let bar: String = (0..WIDTH).map(|i| if i < done { '#' } else { '.' }).collect();
            return format!("refining {bar} {psnr_context:.2} dB on the photographs");
        }
        Step::Render => "rendering",
        _ => "working",
    };
    what.to_owned()
}

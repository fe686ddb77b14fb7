//! Which windows a command measures on.

use crate::arguments::{positive, size};
use crate::datasets::Dataset;
use crate::failure::{Failure, Outcome};
use crate::given::Given;
use clap::Args;
use scene_sim::Kind;
use scene_windows::{Dropped, Plan, Reading, SIMULATED_SIZE, SimulatedScene, Windows};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Where windows come from, and how their pictures are read.
#[derive(Debug, Clone, Args)]
pub(crate) struct Source {
    /// Folder of one scene, or of several scenes
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Context and target views of each window [default: evaluation_index.json in the folder of each scene, if there is one]
    #[arg(long, value_name = "FILE", requires = "root", hide_short_help = true)]
    index: Option<PathBuf>,
    /// Number of context views; if given, evaluation_index.json in the folder of a scene is not used
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 6, conflicts_with = "index")]
    views: usize,
    /// Number of windows along the path of each scene; if given, evaluation_index.json in its folder is not used [default: 3 for layouts of
    /// videos, else one window of views chosen by their overlap]
    #[arg(long, value_name = "N", value_parser = positive, conflicts_with = "index", hide_short_help = true)]
    windows: Option<usize>,
    /// Scale and crop photographs to this size [default: their size on disk]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
}

/// The windows that are asked for, what is left out of them, and how they are read.
pub(crate) struct Planned {
    pub(crate) plans: Vec<Plan>,
    pub(crate) dropped: Vec<Dropped>,
    pub(crate) reading: Reading,
}

/// The generated scenes of some seeds.
pub(crate) fn simulated(seeds: Range<u64>, size: (usize, usize)) -> Vec<Plan> {
    seeds.map(|seed| Plan::simulated(SimulatedScene::Generated(Kind::of_seed(seed), seed), size)).collect()
}

/// The files that windows are read from.
pub(crate) fn files_of(plans: &[Plan]) -> Vec<PathBuf> {
    // Windows of one scene lie side by side.
    let mut files: Vec<PathBuf> = plans.iter().flat_map(Plan::files).collect();
    files.sort_unstable();
    files.dedup();
    files
}

impl Source {
    /// The files that are named.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        self.index.as_deref().into_iter()
    }

    /// The windows of a data set; `generated` simulated scenes stand beside that of the demo.
    pub(crate) fn plan(
        &self,
        dataset: Dataset,
        generated: usize,
        depth_hint: bool,
        given: &Given,
    ) -> Outcome<Planned> {
        dataset.refuse_without_effect(given)?;
        let reading = Reading { format: None, size: self.size, depth_hint };
        if dataset == Dataset::Simulated {
            if depth_hint {
                return Err(Failure::input(
                    "simulated scenes have no hint: --depth-range takes estimate or NEAR,FAR here",
                ));
            }
            let size = self.size.unwrap_or(SIMULATED_SIZE);
            let mut plans = vec![Plan::simulated(SimulatedScene::Courtyard, size)];
            plans.extend(simulated(0..generated as u64, size));
            return Ok(Planned { plans, dropped: Vec::new(), reading });
        }
        let Some(root) = &self.root else {
            let explanation = dataset.explanation();
            return Err(Failure::lines(format!("--dataset needs --root DIR\n{explanation}")));
        };
        let reading = Reading { format: dataset.format(root), ..reading };
        let found = match &self.index {
            Some(index) => Plan::of_index(root, index, reading),
            None => {
                // What is typed counts for more than a file that lies there.
                let index = !given.has("views") && !given.has("windows");
                let windows = Windows { views: self.views, along: self.windows, index };
                Plan::below(root, windows, reading)
            }
        };
        let (plans, dropped) = found.map_err(|error| match error {
            scene_windows::Error::Data(view_data::Error::NoLayout { .. } | view_data::Error::Read { .. }) => {
                let problem = Failure::sorted(error);
                Failure::lines(format!("{problem}\n{}", dataset.explanation()))
            }
            error => Failure::sorted(error),
        })?;
        Ok(Planned { plans, dropped, reading })
    }
}

//! What is varied, and what the paper found.

use crate::failure::{Failure, Outcome};
use attn_head::Kind;
use clap::ValueEnum;
use serde::Serialize;
use sparsesplat::{Allocation, Sampler};
use train::Config;

/// What is varied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum What {
    /// Choice of pixels: entropy, random, Laplacian, as many per cell of 2x2 (even); drawn evenly or independently
    Sampling,
    /// Number of neighbours: 0, 5, 10, 20, 30; by distance, by co-visibility, or half of each
    Neighbours,
    /// Kind of head: edge convolution, MLP, max pooling, attention, grid
    Head,
}

/// The row whose training failed in the paper.
pub(super) const FAILED_IN_PAPER: &str = "max-pool";

/// A row: its name, how it differs, and the paper's PSNR, SSIM and LPIPS (none where it has no such row or its training failed).
pub(super) struct Row {
    pub(super) name: &'static str,
    pub(super) vary: fn(&mut Config),
    pub(super) paper: Option<[f64; 3]>,
}

impl What {
    /// All rows; the reference row is first. Each sets all that its ablation varies, whatever the settings of the training say.
    fn rows(self) -> Vec<Row> {
        let row = |name, paper, vary| Row { name, vary, paper };
        match self {
            Self::Sampling => vec![
                row("entropy", Some([22.36, 0.718, 0.262]), |c| {
                    (c.allocation, c.sampler) = (Allocation::Entropy, Sampler::Fixed);
                }),
                row("random", Some([21.50, 0.696, 0.288]), |c| {
                    (c.allocation, c.sampler) = (Allocation::Random, Sampler::Fixed);
                }),
                row("laplacian", Some([21.95, 0.705, 0.267]), |c| {
                    (c.allocation, c.sampler) = (Allocation::Laplacian, Sampler::Fixed);
                }),
                row("even", None, |c| {
                    (c.allocation, c.sampler) = (Allocation::Random, Sampler::Systematic);
                }),
                row("entropy-independent", None, |c| {
                    (c.allocation, c.sampler) = (Allocation::Entropy, Sampler::Bernoulli);
                }),
                row("random-independent", None, |c| {
                    (c.allocation, c.sampler) = (Allocation::Random, Sampler::Bernoulli);
                }),
            ],
            Self::Neighbours => vec![
                row("K=20", Some([22.36, 0.718, 0.262]), |c| (c.neighbours, c.covisible) = (20, 0)),
                row("K=0", Some([21.53, 0.683, 0.291]), |c| (c.neighbours, c.covisible) = (0, 0)),
                row("K=5", Some([22.23, 0.713, 0.267]), |c| (c.neighbours, c.covisible) = (5, 0)),
                row("K=10", Some([22.34, 0.717, 0.264]), |c| (c.neighbours, c.covisible) = (10, 0)),
                row("K=30", Some([22.38, 0.718, 0.261]), |c| (c.neighbours, c.covisible) = (30, 0)),
                row("covisible", None, |c| (c.neighbours, c.covisible) = (20, 20)),
                row("mixed", None, |c| (c.neighbours, c.covisible) = (20, 10)),
            ],
            Self::Head => vec![
                row("attention", Some([22.36, 0.718, 0.263]), |c| c.head = Kind::Attention),
                row("edge-conv", Some([20.78, 0.664, 0.329]), |c| c.head = Kind::EdgeConv),
                row("mlp", Some([21.47, 0.683, 0.299]), |c| c.head = Kind::Mlp),
                row(FAILED_IN_PAPER, None, |c| c.head = Kind::MaxPool),
                row("grid", None, |c| c.head = Kind::Grid),
            ],
        }
    }

    /// The row with which the others are compared: the paper's method.
    pub(super) fn reference(self) -> &'static str {
        self.rows()[0].name
    }

    /// The paper's PSNR of a row less that of the reference, dB.
    pub(super) fn difference_in_paper(self, name: &str) -> Option<f64> {
        let rows = self.rows();
        let psnr = |row: &Row| row.paper.map(|[psnr, _, _]| psnr);
        Some(psnr(rows.iter().find(|row| row.name == name)?)? - psnr(&rows[0])?)
    }

    /// The rows of these names, or all.
    pub(super) fn wanted(self, asked: &[String]) -> Outcome<Vec<Row>> {
        let mut rows = self.rows();
        let names: Vec<&str> = rows.iter().map(|row| row.name).collect();
        if let Some(unknown) = asked.iter().find(|asked| !names.contains(&asked.as_str())) {
            let names = names.join(", ");
            return Err(Failure::input(format!("--rows: there is no {unknown}, but {names}")));
        }
        rows.retain(|row| asked.is_empty() || asked.iter().any(|asked| asked == row.name));
        Ok(rows)
    }
}

/// The folder of a row among those of other rows, seeds and ablations: equal settings have the same.
pub(super) fn folder_of(config: &Config) -> String {
    let name = |value: serde_json::Result<serde_json::Value>| {
        value.ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
    };
    let mut parts = vec![
        name(serde_json::to_value(config.head)),
        name(serde_json::to_value(config.allocation)),
        format!("k{}", config.neighbours),
    ];
    if config.covisible > 0 {
        parts.push(format!("covisible{}", config.covisible));
    }
    if config.sampler != Sampler::default() {
        parts.push(name(serde_json::to_value(config.sampler)));
    }
    if config.parametrisation != sparsesplat::learned::Parametrisation::default() {
        parts.push(config.parametrisation.name().to_owned());
    }
    parts.push(format!("seed{}", config.seed));
    parts.join("-")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn rows_of_all_ablations_have_names_and_folders_of_their_own_but_the_method_itself() {
        let mut folders = BTreeSet::new();
        let mut rows = 0;
        for what in What::value_variants() {
            let all = what.rows();
            let names: BTreeSet<&str> = all.iter().map(|row| row.name).collect();
            assert_eq!(names.len(), all.len(), "{what:?}");
            rows += all.len();
            folders.extend(all.iter().map(|row| {
                // Whatever the settings are, an ablation's rows differ from each other.
                let mut config = Config { sampler: Sampler::Bernoulli, covisible: 3, ..Config::default() };
                (row.vary)(&mut config);
                config.check().unwrap();
                let mut config = Config::default();
                (row.vary)(&mut config);
                folder_of(&config)
            }));
        }
        assert_eq!(folders.len(), rows - 2, "entropy, K = 20 and attention are one: {folders:?}");
    }

    #[test]
    fn differences_of_the_paper_are_those_to_its_method() {
        let found = What::Head.difference_in_paper("mlp").unwrap();
        assert!((found + 0.89).abs() < 1e-9, "{found}");
        assert_eq!(What::Head.difference_in_paper("max-pool"), None);
        assert_eq!(What::Sampling.difference_in_paper("entropy"), Some(0.0));
        assert_eq!(What::Neighbours.reference(), "K=20");
    }
}

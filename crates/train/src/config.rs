use crate::{Error, Rates, Result};
use attn_head::Kind;
use serde::{Deserialize, Serialize};
use sparsesplat::learned::Parametrisation;
use sparsesplat::{Allocation, Sampler};

/// Everything that decides what training makes of a set of windows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How the head gathers neighbours.
    pub head: Kind,
    /// What the outputs of the head mean.
    pub parametrisation: Parametrisation,
    /// Neighbours K.
    pub neighbours: usize,
    /// How many of them are chosen by co-visibility, the others by distance.
    pub covisible: usize,
    /// Whether the head sees feedback: what rendering the closed form into the context views says of each anchor. Without it, as in the
    /// paper, it is faster and worse.
    pub feedback: bool,
    /// 1 compares the Gaussians of the head. With N, N - 1 rounds of gradient steps on the context views follow first, as in a prediction. The
    /// gradient treats their change as a constant (first order, as in ForeSplat, arXiv 2605.22020).
    pub looks: usize,
    /// Empty trains a head. Otherwise a corrector is trained: it sees scenes that the default head and its looks made, refined by one of these
    /// numbers of steps (0: as they are), all equally often. Repeated numbers count repeatedly. Validation takes the first.
    pub refined: Vec<usize>,
    /// How many passes a refined scene serves, on average: to make one takes longer than a pass. The scenes of all windows are kept in memory.
    pub reuse: usize,
    /// Which pixels become anchors.
    pub allocation: Allocation,
    /// How pixels are drawn.
    pub sampler: Sampler,
    /// Smallest and largest number of Gaussians as a share of the context views' pixels; each pass draws one between,
    /// evenly in its logarithm, so that one model serves all budgets.
    pub density: [f64; 2],
    /// Largest relative error that is added to confirmed depth, in half of the passes (three times that where depth is
    /// filled in): a head that has met nothing but good depth does not mend bad.
    pub depth_error: f64,
    /// Share of the passes in which the window is seen in other colours: simulated scenes are warmer and of less contrast than photographs.
    pub recolour: f64,
    /// Steps in all; with none the weights that a run begins with are all that it makes.
    pub steps: usize,
    /// Windows per step, one after the other (paper: 2).
    pub batch: usize,
    /// Held-out views of a window that are compared per pass.
    pub targets: usize,
    /// Context views of a window that are compared besides.
    pub contexts: usize,
    /// Weight λ of the structural term.
    pub lambda: f32,
    /// Weight of the mean square of what the head adds to colours by direction (SH of degree 1 and 2): without it that is more than serves
    /// on views that a run has not met.
    pub direction: f32,
    /// Share that is kept of what the weights that a run begins with add to colours by direction. With `steps: 0` those weights, so
    /// changed, are what the run makes.
    pub keep_direction: f32,
    /// How fast weights move.
    pub rates: Rates,
    /// Seed of the weights and of everything that is drawn.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            head: Kind::Attention,
            parametrisation: Parametrisation::Correction,
            neighbours: 20,
            covisible: 0,
            feedback: true,
            looks: 1,
            refined: Vec::new(),
            reuse: 3,
            allocation: Allocation::Entropy,
            sampler: Sampler::Fixed,
            density: [0.01, 0.25],
            depth_error: 0.0,
            recolour: 0.0,
            steps: 6000,
            batch: 2,
            targets: 2,
            contexts: 1,
            lambda: 0.02,
            direction: 0.0,
            keep_direction: 1.0,
            rates: Rates::default(),
            seed: 0,
        }
    }
}

/// Most windows per step: more make a step that takes hours.
const LARGEST_BATCH: usize = 1000;

impl Config {
    /// Whether every setting is within its range; [`Trainer::new`](crate::Trainer::new) asks as well.
    ///
    /// # Errors
    /// If one is not.
    pub fn check(&self) -> Result<()> {
        let refuse = |setting, found: String, expected| Err(Error::Setting { setting, found, expected });
        let [low, high] = self.density;
        if !(low > 0.0 && low <= high && high <= 1.0) {
            return refuse(
                "density",
                format!("{low} to {high}"),
                "two shares above 0 and up to 1, smaller first",
            );
        }
        if !(0.0..=0.2).contains(&self.depth_error) {
            return refuse("depth_error", self.depth_error.to_string(), "a share from 0 to 0.2");
        }
        if !(0.0..=1.0).contains(&self.recolour) {
            return refuse("recolour", self.recolour.to_string(), "a share from 0 to 1");
        }
        if self.allocation == Allocation::Merged {
            let expected =
                "one that decides before the head: merging comes after it, trained is what is merged";
            return refuse("allocation", "merged".to_owned(), expected);
        }
        if self.covisible > self.neighbours {
            return refuse("covisible", self.covisible.to_string(), "at most `neighbours`");
        }
        if self.looks == 0 {
            return refuse("looks", "0".to_owned(), "1 or more: the first is the head's");
        }
        if self.reuse == 0 {
            return refuse("reuse", "0".to_owned(), "1 or more");
        }
        let alone = (self.feedback, self.looks, self.covisible, self.parametrisation)
            == (true, 1, 0, Parametrisation::Correction);
        if !self.refined.is_empty() && !alone {
            let found = format!(
                "feedback {}, looks {}, covisible {}, parametrisation {}",
                self.feedback,
                self.looks,
                self.covisible,
                self.parametrisation.name()
            );
            let expected =
                "with it feedback, 1 look, 0 covisible neighbours and the parametrisation correction";
            return refuse("refined", found, expected);
        }
        if self.batch > LARGEST_BATCH {
            return refuse(
                "batch",
                self.batch.to_string(),
                "at most 1000 windows per step, which come one after the other",
            );
        }
        if self.batch == 0 || (self.targets, self.contexts) == (0, 0) {
            let found = format!("batch {}, {} targets, {} contexts", self.batch, self.targets, self.contexts);
            return refuse("batch, targets, contexts", found, "something to compare");
        }
        if !(0.0..=1.0).contains(&self.lambda) {
            return refuse("lambda", self.lambda.to_string(), "a share from 0 to 1");
        }
        if !(self.direction >= 0.0 && self.direction.is_finite()) {
            return refuse("direction", self.direction.to_string(), "a weight of 0 or more");
        }
        if !(0.0..=1.0).contains(&self.keep_direction) {
            return refuse("keep_direction", self.keep_direction.to_string(), "a share from 0 to 1");
        }
        // Of the features, which the backbone decides, any number will do here.
        attn_head::Config { kind: self.head, geometry: 1, image: 1, neighbours: self.neighbours }.check()?;
        self.rates.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corrector_of_nothing_or_of_what_goes_on_is_refused() {
        let corrector = Config { refined: vec![60], ..Config::default() };
        assert!(corrector.check().is_ok());
        assert!(Config { refined: vec![60, 0], ..corrector.clone() }.check().is_ok());
        let error = Config { reuse: 0, ..corrector.clone() }.check().unwrap_err().to_string();
        assert!(error.contains("reuse"), "{error}");
        for wrong in [
            Config { looks: 2, ..corrector.clone() },
            Config { feedback: false, ..corrector.clone() },
            Config { covisible: 3, ..corrector.clone() },
            Config { parametrisation: Parametrisation::Paper, ..corrector },
        ] {
            let error = wrong.check().unwrap_err().to_string();
            assert!(error.contains("refined"), "{error}");
        }
    }
}

use crate::config::LARGEST_FEATURES;
use crate::draw::uniform;
use crate::{Config, Error, LAST_LAYER, Layout, Parameter, Result, WeightFault, WeightProblem};
#[cfg(feature = "candle")]
use candle_core::{DType, Device, Tensor};
use std::collections::BTreeMap;

/// A head's shape and its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Shape.
    pub config: Config,
    /// All numbers, one tensor after the other as [`Layout`] says.
    pub values: Vec<f32>,
    /// What else belongs with them: of what the features consist, how the head was trained.
    pub metadata: BTreeMap<String, String>,
}

impl Weights {
    /// Where training begins: linear layers uniform within 1/sqrt(inputs), weights and biases, as PyTorch does by
    /// default; LayerNorm 1 and 0. The last layer is 0, so that an untrained head changes nothing.
    ///
    /// # Errors
    /// If the configuration is out of its ranges.
    pub fn initial(config: Config, seed: u64) -> Result<Self> {
        let salt = seed.to_string();
        Self::by(config, |weight, bias| {
            let Some(&inputs) = weight.shape.get(1) else {
                return (vec![1.0; weight.len()], vec![0.0; bias.len()]);
            };
            let bound = if weight.name.starts_with(LAST_LAYER) { 0.0 } else { 1.0 / (inputs as f64).sqrt() };
            let draw = |p: &Parameter| {
                // `+ 0.0` makes no minus zeros of a bound of zero.
                uniform(&salt, &p.name, p.len()).map(|u| (bound * u + 0.0) as f32).collect()
            };
            (draw(weight), draw(bias))
        })
    }

    /// Weights by a rule instead of training: reproducible in any language (`fixtures/attn-head/make_attn.py`), spread
    /// so that every part of the head matters to its result. Implementations are compared with them; the outputs mean
    /// nothing. Another salt gives other weights.
    ///
    /// # Errors
    /// If the configuration is out of its ranges.
    pub fn recipe(config: Config, salt: &str) -> Result<Self> {
        Self::by(config, |weight, bias| {
            let (offset, largest) = match weight.shape.get(1) {
                Some(&inputs) => (0.0, (3.0 / inputs as f64).sqrt()),
                None => (1.0, 0.1),
            };
            let draw = |p: &Parameter, offset: f64, largest: f64| {
                uniform(salt, &p.name, p.len()).map(|u| (offset + largest * u) as f32).collect()
            };
            (draw(weight, offset, largest), draw(bias, 0.0, 0.1))
        })
    }

    /// Values of each weight and its bias.
    fn by(config: Config, values: impl Fn(&Parameter, &Parameter) -> (Vec<f32>, Vec<f32>)) -> Result<Self> {
        config.check()?;
        let layout = Layout::new(&config);
        let mut all = Vec::with_capacity(layout.len);
        for [weight, bias] in layout.parameters.as_chunks().0 {
            let (weight, bias) = values(weight, bias);
            all.extend(weight);
            all.extend(bias);
        }
        Ok(Self { config, values: all, metadata: BTreeMap::new() })
    }

    /// The weights of a head that sees further geometric features, behind those that this one sees, and ignores them: its outputs are
    /// the same. From there training can go on.
    ///
    /// # Errors
    /// If these weights do not fit their configuration, or `geometry`, the number of features, is smaller or beyond its range.
    pub fn widened(&self, geometry: usize) -> Result<Self> {
        self.check()?;
        let config = Config { geometry, ..self.config };
        config.check()?;
        if geometry < self.config.geometry {
            let allowed = self.config.geometry..=LARGEST_FEATURES;
            return Err(Error::Setting { setting: "geometry", found: geometry, allowed });
        }
        let [narrow, wide] = [&self.config, &config].map(Layout::new);
        let mut values = vec![0.0; wide.len];
        for (from, to) in narrow.parameters.iter().zip(&wide.parameters) {
            // A row per output; of all but the layer that takes these features they are of equal length.
            let rows = from.shape[0];
            let [width, wider] = [from, to].map(|parameter| parameter.len() / rows);
            let rows_of = &self.values[from.offset..][..from.len()];
            let rows_to = &mut values[to.offset..][..to.len()];
            for (from, to) in rows_of.chunks_exact(width).zip(rows_to.chunks_exact_mut(wider)) {
                to[..width].copy_from_slice(from);
            }
        }
        Ok(Self { config, values, metadata: self.metadata.clone() })
    }

    /// That the configuration is within its ranges, that there are as many numbers as it asks for, and that all are
    /// finite.
    ///
    /// # Errors
    /// Naming what does not fit.
    pub fn check(&self) -> Result<()> {
        self.config.check()?;
        let layout = Layout::new(&self.config);
        if self.values.len() != layout.len {
            return Err(Error::Length { what: "weights", expected: layout.len, found: self.values.len() });
        }
        let infinite = |p: &&Parameter| self.values[p.offset..][..p.len()].iter().any(|v| !v.is_finite());
        let problem = |p: &Parameter| WeightProblem { name: p.name.clone(), fault: WeightFault::NotFinite };
        let problems: Vec<_> = layout.parameters.iter().filter(infinite).map(problem).collect();
        if problems.is_empty() { Ok(()) } else { Err(Error::Weights { problems }) }
    }

    /// The numbers as a tensor `[len]`, of which a [`Network`](crate::plain::Network) is made; a `Var` of it can be
    /// trained.
    ///
    /// # Errors
    /// Those of candle.
    #[cfg(feature = "candle")]
    pub fn to_tensor(&self, dtype: DType, device: &Device) -> Result<Tensor> {
        Ok(Tensor::from_slice(&self.values, self.values.len(), device)?.to_dtype(dtype)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Head, Inputs, Kind};

    const CONFIG: Config = Config { kind: Kind::Attention, geometry: 9, image: 64, neighbours: 20 };

    /// The first draws of `blocks.0.attn.q.weight` without a salt.
    const EXPECTED: [f64; 4] =
        [-0.7669627666473389, 0.7670637369155884, -0.11970973014831543, 0.5869464874267578];

    fn tensor<'a>(weights: &'a Weights, name: &str) -> &'a [f32] {
        let layout = Layout::new(&weights.config);
        let parameter = layout.parameters.iter().find(|p| p.name == name).unwrap();
        &weights.values[parameter.offset..][..parameter.len()]
    }

    /// What the generator of the golden files prints.
    #[test]
    fn recipe_is_that_of_the_generator() {
        let draws: Vec<f64> = uniform("", "blocks.0.attn.q.weight", 4).collect();
        assert_eq!(draws, EXPECTED);
        let weights = Weights::recipe(CONFIG, "").unwrap();
        let scaled = EXPECTED.map(|u| (u * (3.0_f64 / 128.0).sqrt()) as f32);
        assert_eq!(tensor(&weights, "blocks.0.attn.q.weight")[..4], scaled);
        assert_ne!(Weights::recipe(CONFIG, "a").unwrap().values, weights.values);
    }

    #[test]
    fn initial_weights_are_pytorchs_but_for_the_last_layer() {
        let weights = Weights::initial(CONFIG, 7).unwrap();
        weights.check().unwrap();
        assert!(tensor(&weights, "out.2.weight").iter().all(|v| v.to_bits() == 0));
        assert!(tensor(&weights, "blocks.2.norm2.weight").iter().all(|v| *v == 1.0));
        assert!(tensor(&weights, "norm.bias").iter().all(|v| *v == 0.0));
        for (name, inputs) in [("phi_g.0.weight", 9.0_f32), ("blocks.1.ffn.2.bias", 512.0)] {
            let bound = 1.0 / inputs.sqrt();
            let largest = tensor(&weights, name).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            assert!((0.9 * bound..=bound).contains(&largest), "{name}: {largest}");
        }
        assert_ne!(Weights::initial(CONFIG, 8).unwrap(), weights);
    }

    #[test]
    fn widened_weights_ignore_what_they_did_not_see() {
        for kind in Kind::ALL {
            let config = Config { kind, neighbours: 2, ..CONFIG };
            let narrow = Weights::recipe(config, "narrow").unwrap();
            assert_eq!(narrow.widened(config.geometry).unwrap(), narrow);
            let wide = narrow.widened(config.geometry + 3).unwrap();
            let outputs = |weights: Weights, geometry: &[f32]| {
                let (image, neighbours) = (vec![0.2; 3 * config.image], [1, 2, 0, 2, 0, 1]);
                let relative = [[0.3, -0.2, 0.5]; 6];
                let inputs = Inputs {
                    n: 3,
                    k: 2,
                    geometry,
                    image: &image,
                    neighbours: &neighbours,
                    relative: &relative,
                    cells: &[[0, 0], [0, 0], [2, 0]],
                };
                Head::new(weights).unwrap().run(&inputs).unwrap()
            };
            let seen: Vec<f32> = (0..3 * config.geometry).map(|i| (i as f32).sin()).collect();
            let further = |row: &[f32]| [row, &[7.0, -3.0, 0.5]].concat();
            let all: Vec<f32> = seen.chunks_exact(config.geometry).flat_map(further).collect();
            let (before, after) = (outputs(narrow.clone(), &seen), outputs(wide, &all));
            let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-5 * a.abs().max(1.0);
            assert!(before.iter().zip(&after).all(near), "{kind:?}: {before:?} {after:?}");
            assert!(matches!(narrow.widened(8), Err(Error::Setting { setting: "geometry", found: 8, .. })));
            assert!(matches!(narrow.widened(usize::MAX), Err(Error::Setting { .. })));
        }
    }

    #[test]
    fn weights_that_do_not_fit_are_named() {
        let mut weights = Weights::initial(CONFIG, 7).unwrap();
        let offset = Layout::new(&CONFIG).parameters.iter().find(|p| p.name == "out.0.bias").unwrap().offset;
        weights.values[offset] = f32::NAN;
        assert_eq!(
            weights.check().unwrap_err().to_string(),
            "the weights do not fit: out.0.bias holds a value that is not finite"
        );
        weights.values.pop();
        assert!(matches!(weights.check(), Err(Error::Length { what: "weights", .. })));
        let config = Config { image: usize::MAX, ..CONFIG };
        let error = Weights::initial(config, 0).unwrap_err().to_string();
        assert_eq!(error, format!("image is {}, expected 1 to 4096", usize::MAX));
    }
}

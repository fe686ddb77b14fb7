//! The formulas of the README, anchor by anchor and pair by pair in f64.

use crate::case::Case;
use attn_head::{Config, Inputs, Kind, Layout, Weights};
use std::collections::HashMap;

struct Oracle {
    parameters: HashMap<String, (usize, Vec<f64>)>,
}

impl Oracle {
    fn new(weights: &Weights) -> Self {
        let parameters = Layout::new(&weights.config).parameters.into_iter().map(|p| {
            let values = weights.values[p.offset..][..p.len()].iter().map(|v| f64::from(*v)).collect();
            (p.name, (p.shape[p.shape.len() - 1], values))
        });
        Self { parameters: parameters.collect() }
    }

    fn linear(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let (inputs, weight) = &self.parameters[&format!("{name}.weight")];
        let (_, bias) = &self.parameters[&format!("{name}.bias")];
        assert_eq!(*inputs, x.len(), "{name}");
        let rows = weight.chunks(x.len()).zip(bias);
        rows.map(|(row, b)| row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b).collect()
    }

    fn norm(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let (_, weight) = &self.parameters[&format!("{name}.weight")];
        let (_, bias) = &self.parameters[&format!("{name}.bias")];
        let mean = x.iter().sum::<f64>() / 128.0;
        let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 128.0;
        let scale = 1.0 / (variance + 1e-5).sqrt();
        x.iter().zip(weight.iter().zip(bias)).map(|(x, (w, b))| (x - mean) * scale * w + b).collect()
    }

    fn mlp(&self, name: &str, x: &[f64], activation: fn(f64) -> f64) -> Vec<f64> {
        let hidden: Vec<f64> = self.linear(&format!("{name}.0"), x).into_iter().map(activation).collect();
        self.linear(&format!("{name}.2"), &hidden)
    }

    /// What anchor i learns from `others`, without itself: features and relative positions.
    fn message(&self, kind: Kind, block: &str, i: &[f64], others: &[(&[f64], [f64; 3])]) -> Vec<f64> {
        let name = |part: &str| format!("{block}.{part}");
        let all: Vec<(&[f64], [f64; 3])> =
            std::iter::once((i, [0.0; 3])).chain(others.iter().copied()).collect();
        match kind {
            Kind::Attention => self.attend(block, i, &all),
            Kind::EdgeConv => largest(all.iter().map(|(j, d)| {
                let edge: Vec<f64> = j.iter().zip(i).map(|(j, i)| j - i).collect();
                self.mlp(&name("edge"), &[i, &edge, d].concat(), relu)
            })),
            Kind::MaxPool => {
                let pooled =
                    largest(all.iter().map(|(j, d)| self.mlp(&name("pool"), &[j, &d[..]].concat(), relu)));
                self.linear(&name("join"), &[i, &pooled].concat())
            }
            Kind::Mlp => {
                let mut joined = i.to_vec();
                for (j, d) in others {
                    joined.extend(self.linear(&name("message"), &[j, &d[..]].concat()));
                }
                self.mlp(&name("mix"), &joined, relu)
            }
        }
    }

    fn attend(&self, block: &str, i: &[f64], all: &[(&[f64], [f64; 3])]) -> Vec<f64> {
        let linear = |part: &str, x: &[f64]| self.linear(&format!("{block}.attn.{part}"), x);
        let q = linear("q", i);
        let pairs: Vec<_> = all
            .iter()
            .map(|(j, d)| (linear("k", j), linear("v", j), self.mlp(&format!("{block}.attn.delta"), d, relu)))
            .collect();
        let mut o = vec![0.0; 128];
        for head in 0..4 {
            let columns = 32 * head..32 * head + 32;
            let logits: Vec<f64> = pairs
                .iter()
                .map(|(k, _, delta)| columns.clone().map(|c| (q[c] - k[c] + delta[c]) * q[c]).sum::<f64>())
                .map(|dot| dot / 32.0_f64.sqrt())
                .collect();
            let highest = logits.iter().copied().fold(f64::MIN, f64::max);
            let sum: f64 = logits.iter().map(|l| (l - highest).exp()).sum();
            for (logit, (_, v, delta)) in logits.iter().zip(&pairs) {
                let alpha = (logit - highest).exp() / sum;
                columns.clone().for_each(|c| o[c] += alpha * (v[c] + delta[c]));
            }
        }
        linear("proj", &o)
    }

    fn run(&self, config: &Config, inputs: &Inputs<'_>) -> Vec<f64> {
        let rows = |values: &[f32], width: usize| -> Vec<Vec<f64>> {
            values.chunks(width).map(|row| row.iter().map(|v| f64::from(*v)).collect()).collect()
        };
        let (g, v) = (rows(inputs.geometry, config.geometry), rows(inputs.image, config.image));
        let embed = |(g, v): (&Vec<f64>, &Vec<f64>)| {
            [self.mlp("phi_g", g, relu), self.mlp("phi_v", v, relu)].concat()
        };
        let mut x: Vec<Vec<f64>> = g.iter().zip(&v).map(embed).collect();
        for layer in 0..3 {
            let block = format!("blocks.{layer}");
            let h: Vec<Vec<f64>> = x.iter().map(|x| self.norm(&format!("{block}.norm1"), x)).collect();
            for (i, x) in x.iter_mut().enumerate() {
                let others: Vec<(&[f64], [f64; 3])> = (i * inputs.k..(i + 1) * inputs.k)
                    .map(|at| {
                        (h[inputs.neighbours[at] as usize].as_slice(), inputs.relative[at].map(f64::from))
                    })
                    .collect();
                add(x, &self.message(config.kind, &block, &h[i], &others));
                let ffn = self.mlp(&format!("{block}.ffn"), &self.norm(&format!("{block}.norm2"), x), gelu);
                add(x, &ffn);
            }
        }
        x.iter().flat_map(|x| self.mlp("out", &self.norm("norm", x), gelu)).collect()
    }
}

fn add(x: &mut [f64], y: &[f64]) {
    x.iter_mut().zip(y).for_each(|(x, y)| *x += y);
}

fn relu(x: f64) -> f64 {
    x.max(0.0)
}

/// x Phi(x), the error function by the series whose terms are all of one sign.
fn gelu(x: f64) -> f64 {
    let z = x / 2.0_f64.sqrt();
    let (mut term, mut sum, mut n) = (z, z, 1.0);
    // Beyond 6 it is 1 in f64, and the series long.
    while z.abs() < 6.0 && term.abs() > 1e-18 * sum.abs() {
        term *= 2.0 * z * z / (2.0 * n + 1.0);
        sum += term;
        n += 1.0;
    }
    let erf =
        if z.abs() < 6.0 { 2.0 / std::f64::consts::PI.sqrt() * (-z * z).exp() * sum } else { z.signum() };
    x * (0.5 + 0.5 * erf)
}

fn largest(rows: impl Iterator<Item = Vec<f64>>) -> Vec<f64> {
    let larger = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect();
    rows.reduce(larger).unwrap()
}

/// The outputs of a case with its weights.
pub(crate) fn run(case: &Case) -> Vec<f64> {
    Oracle::new(&case.weights()).run(&case.config, &case.inputs())
}

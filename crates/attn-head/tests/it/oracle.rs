//! The heads in f64, anchor by anchor and pair by pair, as the formulas of the README are written.

use attn_head::{CELL_WIDTH, Config, HEAD_WIDTH, HEADS, Kind, Layout, WIDTH};

/// What `attn_head::Inputs` holds.
#[derive(Debug, Clone)]
pub(crate) struct Case {
    pub(crate) config: Config,
    pub(crate) n: usize,
    pub(crate) k: usize,
    pub(crate) weights: Vec<f64>,
    pub(crate) geometry: Vec<f64>,
    pub(crate) image: Vec<f64>,
    pub(crate) neighbours: Vec<u32>,
    pub(crate) relative: Vec<[f64; 3]>,
    pub(crate) cells: Vec<[u32; 2]>,
}

/// Outputs, and the largest logit met on the way.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) out: Vec<f64>,
    pub(crate) largest_logit: f64,
}

impl Case {
    pub(crate) fn at(&self, name: &str) -> std::ops::Range<usize> {
        let parameters = Layout::new(&self.config).parameters;
        let p = parameters.iter().find(|p| p.name == name).expect("a parameter of the head");
        p.offset..p.offset + p.len()
    }

    fn linear(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let weight = &self.weights[self.at(&format!("{name}.weight"))];
        let bias = &self.weights[self.at(&format!("{name}.bias"))];
        let row = |o: usize| weight[o * x.len()..][..x.len()].iter().zip(x).map(|(w, x)| w * x).sum::<f64>();
        bias.iter().enumerate().map(|(o, b)| row(o) + b).collect()
    }

    fn norm(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let weight = &self.weights[self.at(&format!("{name}.weight"))];
        let bias = &self.weights[self.at(&format!("{name}.bias"))];
        let mean = x.iter().sum::<f64>() / x.len() as f64;
        let variance = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / x.len() as f64;
        let scaled = x.iter().map(|v| (v - mean) / (variance + 1e-5).sqrt());
        scaled.zip(weight).zip(bias).map(|((v, w), b)| v * w + b).collect()
    }

    fn perceptron(&self, name: &str, x: &[f64], activation: impl Fn(f64) -> f64) -> Vec<f64> {
        let hidden: Vec<f64> = self.linear(&format!("{name}.0"), x).into_iter().map(activation).collect();
        self.linear(&format!("{name}.2"), &hidden)
    }

    /// Itself, where it stands, and its neighbours.
    fn pairs(&self, i: usize) -> Vec<(usize, [f64; 3])> {
        let others = i * self.k..(i + 1) * self.k;
        let others = others.map(|s| (self.neighbours[s] as usize, self.relative[s]));
        std::iter::once((i, [0.0; 3])).chain(others).collect()
    }

    /// What anchor `i` learns from all pairs, of normalized features `h`; of the kinds without attention.
    fn message(&self, block: &str, h: &[Vec<f64>], i: usize) -> Vec<f64> {
        let name = |part: &str| format!("{block}.{part}");
        let pairs = self.pairs(i);
        match self.config.kind {
            Kind::Attention => unreachable!("see `attention`"),
            Kind::EdgeConv => largest(pairs.iter().map(|(j, d)| {
                let edge: Vec<f64> = h[*j].iter().zip(&h[i]).map(|(j, i)| j - i).collect();
                self.perceptron(&name("edge"), &[&h[i], &edge[..], d].concat(), relu)
            })),
            Kind::MaxPool => {
                let joined = |(j, d): &(usize, [f64; 3])| [&h[*j], &d[..]].concat();
                let pooled =
                    largest(pairs.iter().map(|pair| self.perceptron(&name("pool"), &joined(pair), relu)));
                self.linear(&name("join"), &[&h[i], &pooled[..]].concat())
            }
            Kind::Mlp => {
                let mut joined = h[i].clone();
                for (j, d) in &pairs[1..] {
                    joined.extend(self.linear(&name("message"), &[&h[*j], &d[..]].concat()));
                }
                self.perceptron(&name("mix"), &joined, relu)
            }
            Kind::Grid => {
                let mut means = Vec::new();
                for level in 0..2 {
                    let same = (0..self.n).filter(|&j| self.cells[j][level] == self.cells[i][level]);
                    let all: Vec<_> = same.map(|j| self.linear(&name("cell"), &h[j])).collect();
                    let mean = |c: usize| all.iter().map(|row| row[c]).sum::<f64>() / all.len() as f64;
                    means.extend((level * CELL_WIDTH..(level + 1) * CELL_WIDTH).map(mean));
                }
                self.linear(&name("join"), &means)
            }
        }
    }

    /// The messages of attention, and the largest logit.
    fn attention(&self, block: &str, h: &[Vec<f64>]) -> (Vec<Vec<f64>>, f64) {
        let name = |part: &str| format!("{block}.attn.{part}");
        let all = |part: &str| h.iter().map(|h| self.linear(&name(part), h)).collect::<Vec<_>>();
        let (query, key, value) = (all("q"), all("k"), all("v"));
        let mut largest = 0.0_f64;
        let message = |i: usize| {
            let pairs = self.pairs(i);
            let delta: Vec<_> = pairs.iter().map(|(_, r)| self.perceptron(&name("delta"), r, relu)).collect();
            let mut mixed = vec![0.0; WIDTH];
            for c in 0..HEADS {
                let dims = c * HEAD_WIDTH..(c + 1) * HEAD_WIDTH;
                let logit = |(&(j, _), delta): (&(usize, [f64; 3]), &Vec<f64>)| {
                    let terms = dims.clone().map(|d| (query[i][d] - key[j][d] + delta[d]) * query[i][d]);
                    terms.sum::<f64>() / (HEAD_WIDTH as f64).sqrt()
                };
                let logits: Vec<f64> = pairs.iter().zip(&delta).map(logit).collect();
                let most = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                largest = logits.iter().fold(largest, |m, l| m.max(l.abs()));
                let weights: Vec<f64> = logits.iter().map(|l| (l - most).exp()).collect();
                let sum: f64 = weights.iter().sum();
                for ((&(j, _), delta), weight) in pairs.iter().zip(&delta).zip(&weights) {
                    for d in dims.clone() {
                        mixed[d] += weight / sum * (value[j][d] + delta[d]);
                    }
                }
            }
            self.linear(&name("proj"), &mixed)
        };
        let messages = (0..self.n).map(message).collect();
        (messages, largest)
    }

    /// The head as its definition says.
    pub(crate) fn run(&self) -> Outcome {
        let mut largest_logit = 0.0_f64;
        let part = |values: &[f64], width: usize, i: usize| values[i * width..][..width].to_vec();
        let mut x: Vec<Vec<f64>> = (0..self.n)
            .map(|i| {
                let geometry = part(&self.geometry, self.config.geometry, i);
                let image = part(&self.image, self.config.image, i);
                let mut row = self.perceptron("phi_g", &geometry, relu);
                row.extend(self.perceptron("phi_v", &image, relu));
                row
            })
            .collect();
        for layer in 0..self.config.kind.layers() {
            let block = format!("blocks.{layer}");
            let h: Vec<_> = x.iter().map(|x| self.norm(&format!("{block}.norm1"), x)).collect();
            let messages = if self.config.kind == Kind::Attention {
                let (messages, largest) = self.attention(&block, &h);
                largest_logit = largest_logit.max(largest);
                messages
            } else {
                (0..self.n).map(|i| self.message(&block, &h, i)).collect()
            };
            for (x, message) in x.iter_mut().zip(messages) {
                add(x, &message);
                let normal = self.norm(&format!("{block}.norm2"), x);
                add(x, &self.perceptron(&format!("{block}.ffn"), &normal, gelu));
            }
        }
        let out = x.iter().flat_map(|x| self.perceptron("out", &self.norm("norm", x), gelu)).collect();
        Outcome { out, largest_logit }
    }
}

fn largest(rows: impl Iterator<Item = Vec<f64>>) -> Vec<f64> {
    let larger = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect();
    rows.reduce(larger).unwrap()
}

fn add(to: &mut [f64], values: &[f64]) {
    to.iter_mut().zip(values).for_each(|(t, v)| *t += v);
}

fn relu(x: f64) -> f64 {
    x.max(0.0)
}

/// x Φ(x), of the normal distribution.
pub(crate) fn gelu(x: f64) -> f64 {
    x * (1.0 + erf(x / std::f64::consts::SQRT_2)) / 2.0
}

/// The error function to some 1e-15: its series where that converges well, a continued fraction of its complement
/// elsewhere.
fn erf(x: f64) -> f64 {
    let a = x.abs();
    let value = if a < 3.0 {
        // 2/sqrt(π) e^(-a²) Σ 2ⁿ a^(2n+1) / (1 · 3 · … · (2n+1)): all terms are positive.
        let (mut term, mut sum) = (a, a);
        for n in 1..120 {
            term *= 2.0 * a * a / f64::from(2 * n + 1);
            sum += term;
        }
        std::f64::consts::FRAC_2_SQRT_PI * (-a * a).exp() * sum
    } else {
        let fraction = (1..80).rev().fold(a, |f, n| a + f64::from(n) / 2.0 / f);
        1.0 - (-a * a).exp() / (std::f64::consts::PI.sqrt() * fraction)
    };
    value.copysign(x)
}

#[test]
fn erf_has_its_known_values() {
    for (x, expected) in [
        (0.0, 0.0),
        (0.5, 0.520_499_877_813_046_5),
        (-1.0, -0.842_700_792_949_714_9),
        (2.9, 0.999_958_902_121_901),
        (3.1, 0.999_988_351_342_633),
        (6.0, 1.0),
    ] {
        assert!((erf(x) - expected).abs() < 2e-14, "erf({x}) = {}", erf(x));
    }
}

//! The network: a U-Net (Ronneberger et al. 2015) of residual blocks, from half the picture's size to 1/32 of it.

use super::grid::Grid;
use cpu_kernels::{Isa, Packed, Rows, multiply, multiply_transposed};

/// Channels of each level; each has half the width and height of the one before.
const LEVELS: [usize; 5] = [32, 48, 64, 64, 64];

/// One layer: a convolution with a bias.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Layer {
    pub(crate) name: String,
    /// Width and height of its window: 1 or 3.
    pub(crate) side: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// Where its weights `[side, side, inputs, outputs]` begin among all numbers; its bias follows them.
    pub(crate) offset: usize,
}

impl Layer {
    /// Number of weights, the bias not included.
    pub(crate) fn weights(&self) -> usize {
        self.side * self.side * self.inputs * self.outputs
    }
}

/// One step; its outcome is the node after those of the steps before. Node 0 is the input.
#[derive(Debug, Clone, Copy)]
enum Step {
    /// A layer on a node, after ReLU if `relu`; `plus` is added to the outcome.
    Convolve { layer: usize, from: usize, relu: bool, plus: Option<usize> },
    /// A node at half its size.
    Halve { from: usize },
    /// A node at twice its size, added to another one.
    Double { from: usize, plus: usize },
}

/// Layers and the steps that use them.
#[derive(Debug, Clone)]
pub(crate) struct Architecture {
    pub(crate) layers: Vec<Layer>,
    steps: Vec<Step>,
    /// The last step that reads each node.
    last_use: Vec<usize>,
    /// How many numbers the layers have.
    pub(crate) len: usize,
}

impl Architecture {
    pub(crate) fn new(inputs: usize, outputs: usize) -> Self {
        let mut new = Self { layers: Vec::new(), steps: Vec::new(), last_use: Vec::new(), len: 0 };
        let mut node = new.convolve("stem".into(), 3, (inputs, LEVELS[0]), 0, false, None);
        let mut skips = Vec::new();
        for (level, pair) in LEVELS.windows(2).enumerate() {
            skips.push(node);
            let half = new.push(Step::Halve { from: node });
            node = new.convolve(format!("down.{level}"), 3, (pair[0], pair[1]), half, false, None);
            node = new.block(&format!("encoder.{level}"), pair[1], node);
        }
        node = new.block("middle", LEVELS[LEVELS.len() - 1], node);
        for (level, pair) in LEVELS.windows(2).enumerate().rev() {
            let narrowed = new.convolve(format!("up.{level}"), 1, (pair[1], pair[0]), node, false, None);
            let joined = new.push(Step::Double { from: narrowed, plus: skips[level] });
            node = new.block(&format!("decoder.{level}"), pair[0], joined);
        }
        new.convolve("out".into(), 1, (LEVELS[0], outputs), node, true, None);
        new.last_use = vec![0; new.steps.len() + 1];
        for (i, step) in new.steps.iter().enumerate() {
            let (from, plus) = match *step {
                Step::Convolve { from, plus, .. } => (from, plus),
                Step::Halve { from } => (from, None),
                Step::Double { from, plus } => (from, Some(plus)),
            };
            new.last_use[from] = i;
            plus.into_iter().for_each(|plus| new.last_use[plus] = i);
        }
        new
    }

    fn push(&mut self, step: Step) -> usize {
        self.steps.push(step);
        self.steps.len()
    }

    fn convolve(
        &mut self,
        name: String,
        side: usize,
        (inputs, outputs): (usize, usize),
        from: usize,
        relu: bool,
        plus: Option<usize>,
    ) -> usize {
        let layer = Layer { name, side, inputs, outputs, offset: self.len };
        self.len += layer.weights() + outputs;
        self.layers.push(layer);
        self.push(Step::Convolve { layer: self.layers.len() - 1, from, relu, plus })
    }

    /// A residual block: x + W₂ relu(W₁ relu(x)).
    fn block(&mut self, name: &str, channels: usize, from: usize) -> usize {
        let first = self.convolve(format!("{name}.first"), 3, (channels, channels), from, true, None);
        self.convolve(format!("{name}.second"), 3, (channels, channels), first, true, Some(from))
    }

    /// The network on `input`.
    pub(crate) fn run(&self, weights: &Prepared, input: Grid) -> Grid {
        let mut nodes: Vec<Option<Grid>> = vec![None; self.steps.len() + 1];
        nodes[0] = Some(input);
        for (i, step) in self.steps.iter().enumerate() {
            nodes[i + 1] =
                Some(self.step(*step, weights, |node| nodes[node].as_ref().expect("a node in use")));
            // What nobody reads any more makes room.
            for (node, grid) in nodes.iter_mut().enumerate().take(i + 1) {
                if self.last_use[node] == i {
                    *grid = None;
                }
            }
        }
        nodes.pop().flatten().expect("the last step's outcome")
    }

    /// The network on `input`, with all nodes; the last is the outcome.
    pub(crate) fn record(&self, weights: &Prepared, input: Grid) -> Vec<Grid> {
        let mut nodes = vec![input];
        for step in &self.steps {
            let next = self.step(*step, weights, |node| &nodes[node]);
            nodes.push(next);
        }
        nodes
    }

    fn step<'a>(&self, step: Step, weights: &Prepared, node: impl Fn(usize) -> &'a Grid) -> Grid {
        match step {
            Step::Convolve { layer, from, relu, plus } => {
                let (bias, packed) = (&weights.biases[layer], &weights.forward[layer]);
                let rectified = relu.then(|| node(from).relu(weights.isa));
                convolve(
                    rectified.as_ref().unwrap_or_else(|| node(from)),
                    packed,
                    Some(bias),
                    plus.map(&node),
                )
            }
            Step::Halve { from } => node(from).halved(),
            Step::Double { from, plus } => {
                let mut out = node(plus).clone();
                out.add_doubled(node(from));
                out
            }
        }
    }

    /// Gradients of all numbers, from the recorded nodes and the gradient of the outcome.
    pub(crate) fn backward(&self, weights: &Prepared, nodes: &[Grid], outcome: Grid) -> Vec<f32> {
        let isa = weights.isa;
        let mut all = vec![0.0; self.len];
        let mut gradients: Vec<Option<Grid>> = vec![None; nodes.len()];
        gradients[self.steps.len()] = Some(outcome);
        let give = |gradients: &mut Vec<Option<Grid>>, to: usize, by: &dyn Fn(&mut Grid)| {
            by(gradients[to].get_or_insert_with(|| nodes[to].like(nodes[to].channels)));
        };
        for (i, step) in self.steps.iter().enumerate().rev() {
            let gradient = gradients[i + 1].take().expect("every node leads to the outcome");
            match *step {
                Step::Convolve { layer, from, relu, plus } => {
                    if let Some(plus) = plus {
                        give(&mut gradients, plus, &|to| to.add(&gradient));
                    }
                    let convolution = &self.layers[layer];
                    let rectified = relu.then(|| nodes[from].relu(isa));
                    let into = &mut all[convolution.offset..][..convolution.weights() + convolution.outputs];
                    weight_gradients(
                        isa,
                        convolution.side,
                        rectified.as_ref().unwrap_or(&nodes[from]),
                        &gradient,
                        into,
                    );
                    if from > 0 {
                        let back = convolve(&gradient, &weights.flipped[layer], None, None);
                        give(&mut gradients, from, &|to| {
                            if relu { to.add_where_positive(&back, &nodes[from]) } else { to.add(&back) }
                        });
                    }
                }
                Step::Halve { from } => {
                    let back = nodes[from].halved_backward(&gradient);
                    give(&mut gradients, from, &|to| to.add(&back));
                }
                Step::Double { from, plus } => {
                    let back = gradient.doubled_backward();
                    give(&mut gradients, from, &|to| to.add(&back));
                    give(&mut gradients, plus, &|to| to.add(&gradient));
                }
            }
        }
        all
    }
}

/// A convolution, plus a bias and another grid. `packed` has a matrix per row of the window.
fn convolve(input: &Grid, packed: &[Packed], bias: Option<&[f32]>, plus: Option<&Grid>) -> Grid {
    let channels = packed[0].columns();
    let mut out = input.like(channels);
    for y in 0..input.height {
        let row = out.row_mut(y);
        if let Some(plus) = plus {
            row.copy_from_slice(plus.row(y));
        }
        if let Some(bias) = bias {
            for pixel in row.chunks_exact_mut(channels) {
                pixel.iter_mut().zip(bias).for_each(|(out, bias)| *out += bias);
            }
        }
        for (down, matrix) in packed.iter().enumerate() {
            multiply(input.windows(y, packed.len(), down), matrix, row, channels, true);
        }
    }
    out
}

/// Adds the gradients of a layer's weights `[side, side, inputs, outputs]`, and of its bias behind them.
fn weight_gradients(isa: Isa, side: usize, input: &Grid, gradient: &Grid, into: &mut [f32]) {
    let (channels, block) = (gradient.channels, side * input.channels * gradient.channels);
    let (weights, bias) = into.split_at_mut(side * block);
    for y in 0..input.height {
        let row = gradient.row(y);
        for pixel in row.chunks_exact(channels) {
            bias.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
        }
        let row = Rows::new(row, input.width, channels);
        for (down, weights) in weights.chunks_exact_mut(block).enumerate() {
            multiply_transposed(isa, input.windows(y, side, down), row, weights, channels);
        }
    }
}

/// All numbers of a network, packed for products.
#[derive(Debug, Clone)]
pub(crate) struct Prepared {
    isa: Isa,
    biases: Vec<Vec<f32>>,
    /// Per layer, per row of its window.
    forward: Vec<Vec<Packed>>,
    /// The same for gradients: windows turned upside down, inputs and outputs swapped. Empty if they are not wanted.
    flipped: Vec<Vec<Packed>>,
}

impl Prepared {
    /// Packs `values`, which are as many as the architecture has; also for gradients if they are wanted.
    pub(crate) fn new(isa: Isa, architecture: &Architecture, values: &[f32], gradients: bool) -> Self {
        assert_eq!(values.len(), architecture.len, "numbers of the network");
        let mut new = Self { isa, biases: Vec::new(), forward: Vec::new(), flipped: Vec::new() };
        for layer in &architecture.layers {
            let &Layer { side, inputs, outputs, offset, .. } = layer;
            let weights = &values[offset..][..layer.weights()];
            new.biases.push(values[offset + layer.weights()..][..outputs].to_vec());
            let matrix = |rows: &[f32]| Packed::rows(isa, Rows::new(rows, side * inputs, outputs));
            new.forward.push(weights.chunks_exact(side * inputs * outputs).map(matrix).collect());
            if gradients {
                let turned = |down: usize| {
                    Packed::new(isa, side * outputs, inputs, |k, input| {
                        let (right, output) = (k / outputs, k % outputs);
                        let place = (side - 1 - down) * side + side - 1 - right;
                        weights[(place * inputs + input) * outputs + output]
                    })
                };
                new.flipped.push((0..side).map(turned).collect());
            }
        }
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: &mut u64) -> f32 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    fn random(width: usize, height: usize, channels: usize, seed: &mut u64) -> Grid {
        let mut grid = Grid::new(width, height, channels);
        for y in 0..height {
            grid.row_mut(y).iter_mut().for_each(|v| *v = noise(seed));
        }
        grid
    }

    /// A convolution by its definition.
    fn plainly(input: &Grid, side: usize, weights: &[f32], bias: &[f32], plus: Option<&Grid>) -> Grid {
        let outputs = bias.len();
        let mut out = input.like(outputs);
        for y in 0..input.height {
            for x in 0..input.width {
                for o in 0..outputs {
                    let mut sum =
                        f64::from(bias[o]) + plus.map_or(0.0, |plus| f64::from(plus.pixel(x, y)[o]));
                    for down in 0..side {
                        for right in 0..side {
                            let from = |centre: usize, by: usize| (centre + by).checked_sub(side / 2);
                            let (Some(u), Some(v)) = (from(x, right), from(y, down)) else { continue };
                            if u < input.width && v < input.height {
                                for (i, value) in input.pixel(u, v).iter().enumerate() {
                                    let weight =
                                        weights[((down * side + right) * input.channels + i) * outputs + o];
                                    sum += f64::from(*value) * f64::from(weight);
                                }
                            }
                        }
                    }
                    out.pixel_mut(x, y)[o] = sum as f32;
                }
            }
        }
        out
    }

    #[test]
    fn convolutions_equal_their_definition_under_every_set_and_at_every_size() {
        let mut seed = 1;
        for (width, height) in [(1, 1), (2, 1), (1, 3), (7, 5), (17, 4)] {
            for side in [1, 3] {
                let (inputs, outputs) = (5, 19);
                let input = random(width, height, inputs, &mut seed);
                let plus = random(width, height, outputs, &mut seed);
                let weights: Vec<f32> =
                    (0..side * side * inputs * outputs).map(|_| noise(&mut seed)).collect();
                let bias: Vec<f32> = (0..outputs).map(|_| noise(&mut seed)).collect();
                let expected = plainly(&input, side, &weights, &bias, Some(&plus));
                for isa in Isa::available() {
                    let packed: Vec<Packed> = weights
                        .chunks_exact(side * inputs * outputs)
                        .map(|rows| Packed::rows(isa, Rows::new(rows, side * inputs, outputs)))
                        .collect();
                    let found = convolve(&input, &packed, Some(&bias), Some(&plus));
                    for y in 0..height {
                        for (a, b) in found.row(y).iter().zip(expected.row(y)) {
                            assert!((a - b).abs() < 1e-4, "{isa} {width}x{height} {side}: {a} {b}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn gradients_equal_finite_differences() {
        let mut seed = 7;
        let architecture = Architecture::new(6, 5);
        let mut values: Vec<f32> = (0..architecture.len).map(|_| 0.08 * noise(&mut seed)).collect();
        let input = random(21, 18, 6, &mut seed);
        let direction = random(21, 18, 5, &mut seed);
        let loss = |values: &[f32]| -> f64 {
            let out =
                architecture.run(&Prepared::new(Isa::in_use(), &architecture, values, false), input.clone());
            let dot = |y| out.row(y).iter().zip(direction.row(y)).map(|(a, b)| f64::from(*a) * f64::from(*b));
            (0..18).flat_map(dot).sum()
        };
        let prepared = Prepared::new(Isa::in_use(), &architecture, &values, true);
        let nodes = architecture.record(&prepared, input.clone());
        let gradient = architecture.backward(&prepared, &nodes, direction.clone());
        // Along the gradient of each layer, where the slope is its length.
        for layer in &architecture.layers {
            let range = layer.offset..layer.offset + layer.weights() + layer.outputs;
            let expected = gradient[range.clone()].iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
            let step = 2e-3;
            let mut moved_loss = |by: f64| {
                let before = values[range.clone()].to_vec();
                for (value, along) in values[range.clone()].iter_mut().zip(&gradient[range.clone()]) {
                    *value += (by * f64::from(*along) / expected) as f32;
                }
                let found = loss(&values);
                values[range.clone()].copy_from_slice(&before);
                found
            };
            let found = (moved_loss(step) - moved_loss(-step)) / (2.0 * step);
            assert!((found - expected).abs() < 0.02 * expected, "{}: {found} {expected}", layer.name);
        }
    }

    #[test]
    fn nodes_that_are_dropped_early_change_nothing() {
        let mut seed = 3;
        let architecture = Architecture::new(4, 3);
        let values: Vec<f32> = (0..architecture.len).map(|_| 0.1 * noise(&mut seed)).collect();
        let prepared = Prepared::new(Isa::in_use(), &architecture, &values, false);
        for (width, height) in [(1, 1), (3, 2), (33, 9)] {
            let input = random(width, height, 4, &mut seed);
            let nodes = architecture.record(&prepared, input.clone());
            assert_eq!(nodes.last().unwrap(), &architecture.run(&prepared, input));
        }
    }
}

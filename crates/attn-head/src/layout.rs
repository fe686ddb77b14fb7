use crate::{CELL_WIDTH, Config, Kind, MESSAGE, OUTPUTS, WIDTH};

/// Name of the last layer, whose weight and bias have a row per output.
pub const LAST_LAYER: &str = "out.2";

/// One tensor among the weights.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parameter {
    /// Name in files, as PyTorch would have it: `blocks.0.attn.q.weight`.
    pub name: String,
    /// Shape, row-major; a linear layer's weight is `[outputs, inputs]`.
    pub shape: Vec<usize>,
    /// Where it begins among all the weights' numbers.
    pub offset: usize,
}

impl Parameter {
    /// Numbers in it.
    #[must_use]
    pub fn len(&self) -> usize {
        // A configuration beyond its ranges must not overflow here; whoever makes weights checks it.
        self.shape.iter().fold(1, |product, n| product.saturating_mul(*n))
    }

    /// Whether it has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Which tensors a head has, in the order in which [`Weights::values`](crate::Weights::values) holds them: each weight
/// is followed by its bias.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// The tensors.
    pub parameters: Vec<Parameter>,
    /// Numbers in all of them.
    pub len: usize,
}

impl Layout {
    /// The tensors of a head.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let mut layout = Self { parameters: Vec::new(), len: 0 };
        layout.linear("phi_g.0", config.geometry, WIDTH / 2);
        layout.linear("phi_g.2", WIDTH / 2, WIDTH / 2);
        layout.linear("phi_v.0", config.image, WIDTH / 2);
        layout.linear("phi_v.2", WIDTH / 2, WIDTH / 2);
        (0..config.kind.layers()).for_each(|layer| layout.block(config, &format!("blocks.{layer}")));
        layout.norm("norm");
        layout.linear("out.0", WIDTH, WIDTH);
        layout.linear(LAST_LAYER, WIDTH, OUTPUTS);
        layout
    }

    fn block(&mut self, config: &Config, block: &str) {
        self.norm(&format!("{block}.norm1"));
        match config.kind {
            Kind::Attention => {
                for name in ["q", "k", "v"] {
                    self.linear(&format!("{block}.attn.{name}"), WIDTH, WIDTH);
                }
                self.linear(&format!("{block}.attn.delta.0"), 3, WIDTH);
                self.linear(&format!("{block}.attn.delta.2"), WIDTH, WIDTH);
                self.linear(&format!("{block}.attn.proj"), WIDTH, WIDTH);
            }
            Kind::EdgeConv => {
                self.linear(&format!("{block}.edge.0"), 2 * WIDTH + 3, WIDTH);
                self.linear(&format!("{block}.edge.2"), WIDTH, WIDTH);
            }
            Kind::MaxPool => {
                self.linear(&format!("{block}.pool.0"), WIDTH + 3, WIDTH);
                self.linear(&format!("{block}.pool.2"), WIDTH, WIDTH);
                self.linear(&format!("{block}.join"), 2 * WIDTH, WIDTH);
            }
            Kind::Mlp => {
                // Without neighbours there is nothing to shorten.
                if config.neighbours > 0 {
                    self.linear(&format!("{block}.message"), WIDTH + 3, MESSAGE);
                }
                let inputs = WIDTH.saturating_add(config.neighbours.saturating_mul(MESSAGE));
                self.linear(&format!("{block}.mix.0"), inputs, WIDTH);
                self.linear(&format!("{block}.mix.2"), WIDTH, WIDTH);
            }
            Kind::Grid => {
                self.linear(&format!("{block}.cell"), WIDTH, 2 * CELL_WIDTH);
                self.linear(&format!("{block}.join"), 2 * CELL_WIDTH, WIDTH);
            }
        }
        self.norm(&format!("{block}.norm2"));
        self.linear(&format!("{block}.ffn.0"), WIDTH, config.kind.hidden());
        self.linear(&format!("{block}.ffn.2"), config.kind.hidden(), WIDTH);
    }

    fn push(&mut self, name: String, shape: Vec<usize>) {
        let parameter = Parameter { name, shape, offset: self.len };
        self.len = self.len.saturating_add(parameter.len());
        self.parameters.push(parameter);
    }

    fn linear(&mut self, name: &str, inputs: usize, outputs: usize) {
        self.push(format!("{name}.weight"), vec![outputs, inputs]);
        self.push(format!("{name}.bias"), vec![outputs]);
    }

    fn norm(&mut self, name: &str) {
        self.push(format!("{name}.weight"), vec![WIDTH]);
        self.push(format!("{name}.bias"), vec![WIDTH]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_lie_one_behind_the_other_and_heads_are_of_comparable_size() {
        let mut sizes = Vec::new();
        for kind in Kind::ALL {
            let layout = Layout::new(&Config { kind, geometry: 9, image: 64, neighbours: 20 });
            let mut end = 0;
            for pair in layout.parameters.chunks(2) {
                let [weight, bias] = pair else { panic!("a weight without bias") };
                assert_eq!((weight.offset, bias.offset), (end, end + weight.len()));
                assert_eq!(bias.shape, weight.shape[..1]);
                end = bias.offset + bias.len();
            }
            assert_eq!(end, layout.len);
            sizes.push(layout.len);
        }
        // The grid is small on purpose.
        assert_eq!(sizes.pop(), Some(134_246));
        let (least, most) = (sizes.iter().min().unwrap(), sizes.iter().max().unwrap());
        assert!(*most < *least * 5 / 4, "{sizes:?}");
    }
}

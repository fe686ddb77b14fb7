use crate::{Config, Kind, LAYERS, OUTPUTS, WIDTH};

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
        self.shape.iter().product()
    }

    /// Whether it has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Which tensors a head has, in the order in which [`Weights::values`] holds them.
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
        match config.kind {
            Kind::Attention => (0..LAYERS).for_each(|layer| layout.attention(&format!("blocks.{layer}"))),
            Kind::Mlp | Kind::EdgeConv | Kind::MaxPool => {}
        }
        layout.norm("norm");
        layout.linear("out.0", WIDTH, WIDTH);
        layout.linear("out.2", WIDTH, OUTPUTS);
        layout
    }

    fn attention(&mut self, block: &str) {
        self.norm(&format!("{block}.norm1"));
        for name in ["q", "k", "v"] {
            self.linear(&format!("{block}.attn.{name}"), WIDTH, WIDTH);
        }
        self.linear(&format!("{block}.attn.delta.0"), 3, WIDTH);
        self.linear(&format!("{block}.attn.delta.2"), WIDTH, WIDTH);
        self.linear(&format!("{block}.attn.proj"), WIDTH, WIDTH);
        self.norm(&format!("{block}.norm2"));
        self.linear(&format!("{block}.ffn.0"), WIDTH, 4 * WIDTH);
        self.linear(&format!("{block}.ffn.2"), 4 * WIDTH, WIDTH);
    }

    fn push(&mut self, name: String, shape: Vec<usize>) {
        let parameter = Parameter { name, shape, offset: self.len };
        self.len += parameter.len();
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

/// A head's shape and its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Shape.
    pub config: Config,
    /// All numbers, one tensor after the other as [`Layout`] says.
    pub values: Vec<f32>,
}

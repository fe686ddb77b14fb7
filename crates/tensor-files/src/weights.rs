//! What is wrong with weights, tensor by tensor.

/// What is wrong with a tensor among the weights.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum WeightFault {
    /// It is needed, and it is not there.
    Missing,
    /// It is there, and nothing has a use for it.
    Unexpected,
    /// Two tensors are one and the same.
    Twice,
    /// It has another shape.
    Shape {
        /// What is needed.
        expected: Vec<usize>,
        /// What is there.
        found: Vec<usize>,
    },
    /// It holds numbers of another type.
    Type {
        /// What is needed.
        expected: safetensors::Dtype,
        /// What it holds.
        found: safetensors::Dtype,
    },
    /// It holds a NaN or an infinity.
    NotFinite,
    /// A constant of a published metric that has another value.
    Constant,
}

/// A tensor that does not fit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WeightProblem {
    /// Its name.
    pub name: String,
    /// What is wrong.
    pub fault: WeightFault,
}

impl std::fmt::Display for WeightProblem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { name, fault } = self;
        match fault {
            WeightFault::Missing => write!(f, "{name} is missing"),
            WeightFault::Unexpected => write!(f, "{name} is unexpected"),
            WeightFault::Twice => write!(f, "{name} is there twice"),
            WeightFault::Shape { expected, found } => {
                write!(f, "{name} has shape {found:?}, expected {expected:?}")
            }
            WeightFault::Type { expected, found } => {
                write!(f, "{name} holds {found:?}, expected {expected:?}")
            }
            WeightFault::NotFinite => write!(f, "{name} holds a value that is not finite"),
            WeightFault::Constant => write!(f, "{name} differs from the published metric's"),
        }
    }
}

/// The first problems, and how many more there are.
#[must_use]
pub fn first_few(problems: &[WeightProblem]) -> String {
    const SHOWN: usize = 5;
    let mut text = problems.iter().take(SHOWN).map(ToString::to_string).collect::<Vec<_>>().join("; ");
    if problems.len() > SHOWN {
        text += &format!("; and {} more", problems.len() - SHOWN);
    }
    text
}

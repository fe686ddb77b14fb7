use crate::Quantity;
use std::fmt;

/// What a format does not keep of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Loss {
    /// A quantity is rounded.
    Rounded {
        /// Which.
        quantity: Quantity,
        /// Bits of each of its numbers.
        bits: u32,
        /// Largest change of a number, in the unit of `unit`.
        error: f64,
        /// What `error` counts.
        unit: &'static str,
    },
    /// Numbers beyond the range of the format are set to its end.
    Clipped {
        /// Which quantity.
        quantity: Quantity,
        /// Number of Gaussians with such a number.
        gaussians: usize,
        /// Number of all Gaussians.
        of: usize,
        /// The range.
        range: [f64; 2],
    },
    /// Numbers that are rounded to the end of their range, from which they are not found again.
    Saturated {
        /// Which quantity.
        quantity: Quantity,
        /// Number of Gaussians with such a number.
        gaussians: usize,
        /// Number of all Gaussians.
        of: usize,
    },
    /// SH coefficients are dropped: colours no longer change with the viewing direction.
    ShDropped {
        /// The highest degree that the scene has, and loses.
        degree: usize,
    },
    /// The Gaussians get another order.
    Order,
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rounded { quantity, bits, error, unit } => {
                write!(f, "{quantity} is rounded to {bits} bits: by up to {error:.2e} {unit}")
            }
            Self::Clipped { quantity, gaussians, of: total, range: [from, to] } => {
                write!(
                    f,
                    "{quantity} is clipped to {from:.3e} .. {to:.3e} in {gaussians} of {total} Gaussians"
                )
            }
            Self::Saturated { quantity, gaussians, of: total } => {
                write!(f, "{quantity} is rounded to 0 or 1 in {gaussians} of {total} Gaussians")
            }
            Self::ShDropped { degree } => write!(
                f,
                "spherical harmonics of degree 1 to {degree} are dropped: colour no longer changes with the viewing direction"
            ),
            Self::Order => write!(f, "the order of the Gaussians changes"),
        }
    }
}

/// Counts Gaussians with a number out of a range.
pub(crate) struct Clipping {
    quantity: Quantity,
    range: [f64; 2],
    gaussians: usize,
}

impl Clipping {
    pub(crate) fn new(quantity: Quantity, range: [f64; 2]) -> Self {
        Self { quantity, range, gaussians: 0 }
    }

    pub(crate) fn count(&mut self, numbers: impl IntoIterator<Item = f64>) {
        let [from, to] = self.range;
        self.gaussians += usize::from(numbers.into_iter().any(|value| !(from..=to).contains(&value)));
    }

    pub(crate) fn loss(&self, total: usize) -> Option<Loss> {
        let Self { quantity, range, gaussians } = *self;
        (gaussians > 0).then_some(Loss::Clipped { quantity, gaussians, of: total, range })
    }
}
